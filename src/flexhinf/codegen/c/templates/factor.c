/* L^T of A = L L^T, row by row, zero rows for pivots that are zero */
static void @{name}_less(const @{R} *RESTRICT row, @{R} *RESTRICT other, @{R} factor, int count)
{
    for (int i = 0; i + 4 <= count; i += 4) {
        other[i] = FMA(-factor, row[i], other[i]);
        other[i + 1] = FMA(-factor, row[i + 1], other[i + 1]);
        other[i + 2] = FMA(-factor, row[i + 2], other[i + 2]);
        other[i + 3] = FMA(-factor, row[i + 3], other[i + 3]);
    }
    for (int i = count - count % 4; i < count; ++i) {
        other[i] = FMA(-factor, row[i], other[i]);
    }
}

static void @{name}(const @{R} *source, @{R} *target, int n)
{
    for (int i = 0; i < n * n; ++i) {
        target[i] = source[i];
    }
    for (int j = 1; j < n; ++j) {
        target[j * n] = fabs@{f}(source[j * n + j]);
    }
    for (int j = 0; j < n; ++j) {
        @{R} *row = target + j * n;
        const @{R} tolerance = @{tolerance} * (@{R})n;
        const @{R} moved = fabs@{f}(row[0]);
        const @{R} least = tolerance * fabs@{f}(source[j * n + j]);
        const @{R} inverse = (row[j] <= least && row[j] >= -tolerance * moved) ? @{zero} : @{one} / sqrt@{f}(row[j]);
        for (int i = j; i < n; ++i) {
            row[i] *= inverse;
        }
        for (int i = j + 1; i < n; ++i) {
            const @{R} ratio = row[i] * inverse;
            target[i * n] = FMA(ratio * ratio, moved, target[i * n]);
        }
        for (int k = j + 1; k < n; ++k) {
            @{name}_less(row + k, target + k * n + k, row[k], n - k);
        }
        for (int i = 0; i < j; ++i) {
            row[i] = @{zero};
        }
    }
}
