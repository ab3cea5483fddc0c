"""Sine and cosine as C functions.

In double the operations are those of `flexhinf.codegen.emit.sines`, with fused multiply-adds (FUSED) and without, so
that machine code and C agree to the last bit, in vectors too. Angles beyond the reach, and what is not finite, go to
the library.

In float nothing goes to the library, whose time nobody bounds. Up to 1e4 an angle is reduced by Cody and Waite's method
in four parts of π/2, of which three have 11 bits: their products with the number of quarter turns are exact. Beyond, it
is reduced by Payne and Hanek's, in integers. The polynomials are minimax on |r| <= π/4, with relative errors of 2^-28
and 2^-33; a sine or cosine is within three units of its last place.
"""

from __future__ import annotations

import math

from flexhinf.codegen.c.algebra import Real, constant
from flexhinf.codegen.emit.sines import COSINE, HALF_PI, REACH, ROUNDER, SINE

#: Far angles in float: 2/π in binary behind 32 zeros, from which 96 bits are taken so that their product with the 24
#: bits of the angle is the number of quarter turns but for multiples of four. Of the 62 bits behind the point some 32
#: are left where an angle is nearest to a multiple of π/2.
FAR = """static NOINLINE uint32_t {name}(float size, float *rest)
{
    static const uint32_t two_over_pi[8] = {
        0u, 0xa2f9836eu, 0x4e441529u, 0xfc2757d1u, 0xf534ddc0u, 0xdb629599u, 0x3c439041u, 0xfe5163abu
    };
    int exponent = 0;
    const float whole = frexpf(size, &exponent) * 16777216.0f;
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
        *rest = (float)turns * {unit};
    } else {
        turns = 0x4000000000000000u - turns;
        *rest = (float)turns * -{unit};
        quarter += 1u;
    }
    return quarter;
}""".replace("{unit}", "3.40612158e-19f")  # π/2 of 2^62

#: The sine of `size`, of at least 0, and so many quarter turns.
TURNED = """static float {name}(float size, uint32_t turned)
{
    uint32_t quarter = turned;
    float r, z;
    if (size <= 1.0e4f) {
        const float turns = FMA(size, 0.636619772f, 0.5f);
        const uint32_t whole = (uint32_t)turns;
        const float k = (float)whole;
        r = FMA(-k, 1.5703125f, size);
        r = FMA(-k, 4.83751297e-4f, r);
        r = FMA(-k, 7.54953362e-8f, r);
        r = FMA(-k, 2.56334407e-12f, r);
        quarter += whole;
    } else {
        quarter += {far}(size, &r);
    }
    z = r * r;
    if ((quarter % 2u) == 0u) {
        r = FMA(z * r, FMA(z, FMA(z, -1.9515124e-4f, 8.332159e-3f), -1.6666655e-1f), r);
    } else {
        r = FMA(z * z, FMA(z, FMA(z, 2.4432975e-5f, -1.3887314e-3f), 4.1666646e-2f), FMA(z, -0.5f, 1.0f));
    }
    return ((quarter % 4u) < 2u) ? r : -r;
}"""


def far(name: str) -> str:
    """How many quarter turns are in a large angle, and the rest, by Payne and Hanek (1983)."""
    return FAR


def turned(name: str, beyond: str) -> str:
    """The sine of size + turned·π/2, for a size of at least 0."""
    return TURNED.replace("{far}", beyond)


def short_function(name: str, cosine: bool, of: str) -> str:
    """sin or cos in float."""
    if cosine:
        lines = [f"return {of}(fabsf(x), 1u);"]
    else:
        lines = [f"return {of}(fabsf(x), 0u) * copysignf(1.0f, x);"]
    text = "\n".join(f"    {line}" for line in lines)
    return f"static float {name}(float x)\n{{\n{text}\n}}"


def function(name: str, cosine: bool, real: Real) -> str:
    """``name(x)``: sin or cos; of the type double."""
    lines = "\n".join(f"    {line}" for line in _statements(real, "x", {cosine: "return"}))
    return f"""static {{R}} {name}({{R}} x)
{{
#ifdef FUSED
    const {{R}} reach = {constant(REACH[True], real)};
#else
    const {{R}} reach = {constant(REACH[False], real)};
#endif
    if (!({{fabs}}(x) <= reach)) {{
        return {"cos" if cosine else "sin"}(x);
    }}
{lines}
}}""".replace("    #", "#")


def row_function(name: str, ones: dict[bool, str], real: Real, lanes: int) -> str:
    """``void name(x, sine, cosine)``, or with one result, of a row of lanes: as the functions `ones` of a number."""
    results = {cosine: ("cosine" if cosine else "sine") for cosine in sorted(ones)}
    statements = _statements(real, "x[l]", {cosine: f"{place}[l] =" for cosine, place in results.items()})
    lines = "\n".join(f"        {line}" for line in statements)
    far = "\n".join(f"            {place}[l] = {ones[cosine]}(x[l]);" for cosine, place in results.items())
    arguments = ", ".join(
        ["const {R} *RESTRICT x", *(f"{{R}} *RESTRICT {place}" for place in results.values())]
    )
    return f"""static void {name}({arguments})
{{
    int far = 0;
    for (int l = 0; l < {lanes}; ++l) {{
{lines}
    }}
    for (int l = 0; l < {lanes}; ++l) {{
        far += ({{fabs}}(x[l]) <= {REACH[False]!r}) ? 0 : 1;
    }}
    if (far > 0) {{
        for (int l = 0; l < {lanes}; ++l) {{
{far}
        }}
    }}
}}""".replace("        #", "#")


def _statements(real: Real, x: str, results: dict[bool, str]) -> list[str]:
    """Statements for an x within the reach: reduction, two polynomials, one of them by the quadrant.

    `results`: Text before the value of the sine (False) and the cosine (True).
    """

    def number(value: float) -> str:
        return constant(value, real)

    def horner(name: str, coefficients: tuple[float, ...]) -> list[str]:
        first, *others = map(number, coefficients)
        return [f"{{R}} {name} = {first};", *(f"{name} = FMA({name}, z, {other});" for other in others)]

    def remainder(parts: tuple[float, ...]) -> str:
        text = "size"
        for part in parts:
            text = f"FMA(-k, {number(part)}, {text})"
        return text

    def choice(cosine: bool) -> tuple[str, str, str]:
        """The value but for its sign, when a quadrant changes that, and the sign of x, which is that of zero too."""
        odd, even = ("s", "c") if cosine else ("c", "s")
        value = f"(m * (m - {number(2.0)}) < {number(0.0)} || m > {high}) ? {odd} : {even}"
        if cosine:
            return value, f"m > {half} && m < {high}", ""
        return value, f"m > {low}", f" * {{copysign}}({number(1.0)}, {x})"

    rounder = number(ROUNDER)
    half, low, high = number(0.5), number(1.5), number(2.5)
    lines = [
        f"const {{R}} size = {{fabs}}({x});",
        f"const {{R}} k = FMA(size, {number(2.0 / math.pi)}, {rounder}) - {rounder};",
        f"const {{R}} m = k - {number(4.0)} * (((k * {number(0.25)} - {number(0.375)}) + {rounder}) - {rounder});",
        "#ifdef FUSED",
        f"const {{R}} r = {remainder(HALF_PI[True])};",
        "#else",
        f"const {{R}} r = {remainder(HALF_PI[False])};",
        "#endif",
        "const {R} z = r * r;",
        *horner("odd", SINE),
        *horner("even", COSINE),
        "const {R} s = FMA(odd, z * r, r);",
        f"const {{R}} c = FMA(even, z * z, FMA(z, {number(-0.5)}, {number(1.0)}));",
    ]
    for cosine, said in results.items():
        (value, negative, sign), short = choice(cosine), "cv" if cosine else "sv"
        chosen = f"({negative}) ? -{short} : {short}"
        lines += [
            f"const {{R}} {short} = {value};",
            f"{said} ({chosen}){sign};" if sign else f"{said} {chosen};",
        ]
    return lines
