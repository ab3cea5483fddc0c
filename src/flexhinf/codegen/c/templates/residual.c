/* e - C x - v with the rounding of sums and products */
static void @{name}(const @{R} *rows, const @{R} *slope, @{R} *target, int count, int p, int n)
{
    for (int q = 0; q < count; ++q) {
        const @{R} *row = rows + q * (n + 2 * p);
        for (int i = 0; i < p; ++i) {
            @{R} high = row[i], low = @{zero}, other = -row[p + n + i];
            for (int j = 0; j <= n; ++j) {
                const @{R} sum = high + other, part = sum - high;
                low += (high - (sum - part)) + (other - part);
                high = sum;
                if (j < n) {
                    const @{R} x = row[p + j], c = slope[i * n + j];
                    other = -(c * x);
#ifdef FUSED
                    low -= FMA(c, x, other);
#else
                    const @{R} xs = @{split} * x, cs = @{split} * c;
                    const @{R} x1 = xs - (xs - x), c1 = cs - (cs - c);
                    low -= ((c1 * x1 + other) + c1 * (x - x1) + (c - c1) * x1) + (c - c1) * (x - x1);
#endif
                }
            }
            target[q * p + i] = (fabs@{f}(low - low) <= @{zero}) ? high + low : high;
        }
    }
}
