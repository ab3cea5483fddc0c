/* The sine of size + turned pi/2, for a size of at least 0 */
static @{R} @{name}(@{R} size, uint32_t turned)
{
    uint32_t quarter = turned;
    @{R} r, z;
    if (size <= 1.0e4f) {
        const @{R} turns = FMA(size, 0.636619772f, 0.5f);
        const uint32_t whole = (uint32_t)turns;
        const @{R} k = (@{R})whole;
        r = FMA(-k, 1.5703125f, size);
        r = FMA(-k, 4.83751297e-4f, r);
        r = FMA(-k, 7.54953362e-8f, r);
        r = FMA(-k, 2.56334407e-12f, r);
        quarter += whole;
    } else {
        quarter += @{far}(size, &r);
    }
    z = r * r;
    if ((quarter % 2u) == 0u) {
        r = FMA(z * r, FMA(z, FMA(z, -1.9515124e-4f, 8.332159e-3f), -1.6666655e-1f), r);
    } else {
        r = FMA(z * z, FMA(z, FMA(z, 2.4432975e-5f, -1.3887314e-3f), 4.1666646e-2f), FMA(z, -0.5f, 1.0f));
    }
    return ((quarter % 4u) < 2u) ? r : -r;
}
