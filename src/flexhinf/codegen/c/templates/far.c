/* How many quarter turns are in a large angle, and the rest, by Payne and Hanek (1983) */
static NOINLINE uint32_t @{name}(@{R} size, @{R} *rest)
{
    static const uint32_t two_over_pi[8] = {
        0u, 0xa2f9836eu, 0x4e441529u, 0xfc2757d1u, 0xf534ddc0u, 0xdb629599u, 0x3c439041u, 0xfe5163abu
    };
    int exponent = 0;
    const @{R} whole = frexpf(size, &exponent) * 16777216.0f;
    const uint32_t first = (uint32_t)exponent + 6u;
    const uint32_t shift = 32u - (first % 32u);
    uint64_t bits[3];
    uint64_t turns;
    uint32_t quarter;
    if (isfinite(size) == 0) {
        *rest = size - size;
        return 0u;
    }
    for (int i = 0; i < 3; ++i) {
        const uint32_t word = (first / 32u) + (uint32_t)i;
        const uint64_t two = ((uint64_t)two_over_pi[word] << 32u) | two_over_pi[word + 1u];
        bits[i] = ((two >> shift) & 0xffffffffu) * (uint32_t)whole;
    }
    turns = (bits[0] << 32u) + bits[1] + (bits[2] >> 32u);
    quarter = (uint32_t)(turns >> 62u);
    turns &= 0x3fffffffffffffffu;
    if (turns < 0x2000000000000000u) {
        *rest = (@{R})turns * 3.40612158e-19f;
    } else {
        turns = 0x4000000000000000u - turns;
        *rest = (@{R})turns * -3.40612158e-19f;
        quarter += 1u;
    }
    return quarter;
}
