/* Reflections that make the first columns zero below the diagonal */
static void @{name}(const @{R} *source, @{R} *target, int m, int k, int count, int triangle)
{
    for (int i = 0; i < m * k; ++i) {
        target[i] = source[i];
    }
    for (int c = 0; c < count; ++c) {
        const int rows = (triangle > 0) ? m - triangle + c + 1 : m;
        int top = c;
        @{R} best = fabs@{f}(target[c * k + c]), part[4] = { 0 };
        best += best;
        for (int i = c + 1; i < rows; ++i) {
            const @{R} size = fabs@{f}(target[i * k + c]);
            if (size > best) {
                best = size;
                top = i;
            }
        }
        for (int j = c; j < k; ++j) {
            const @{R} moved = target[top * k + j];
            target[top * k + j] = target[c * k + j];
            target[c * k + j] = moved;
        }
        for (int i = c + 1; i < rows; ++i) {
            part[i % 4] = FMA(target[i * k + c], target[i * k + c], part[i % 4]);
        }
        const @{R} diagonal = target[c * k + c], square = (part[0] + part[1]) + (part[2] + part[3]);
        const @{R} whole = FMA(diagonal, diagonal, square), size = sqrt@{f}(whole);
        const @{R} norm = (diagonal < @{zero}) ? -size : size;
        const @{R} share = (whole <= @{smallest}) ? @{zero} : @{one} / (norm + diagonal);
        const @{R} inverse = (whole <= @{smallest}) ? @{zero} : @{one} / norm;
        const @{R} less = -(square * share);
        for (int j = c + 1; j < k; ++j) {
            @{R} sum[4] = { 0 };
            for (int i = c + 1; i < rows; ++i) {
                sum[i % 4] = FMA(target[i * k + c], target[i * k + j], sum[i % 4]);
            }
            const @{R} all = (sum[0] + sum[1]) + (sum[2] + sum[3]), first = target[c * k + j];
            const @{R} turned = -(FMA(all, share, first) * inverse);
            target[c * k + j] = FMA(FMA(less, first, all), inverse, first);
            for (int i = c + 1; i < rows; ++i) {
                target[i * k + j] = FMA(target[i * k + c], turned, target[i * k + j]);
            }
        }
        target[c * k + c] = (whole <= @{smallest}) ? diagonal : norm;
        for (int i = c + 1; i < rows; ++i) {
            target[i * k + c] = @{zero};
        }
    }
}
