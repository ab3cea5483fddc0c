"""Sine and cosine without the library: the same bits on every machine with a fused multiply-add, and in vectors.

With it, the operations are those of `flexhinf.codegen.emit.trigonometry`, so that machine code and C agree to the last
bit. Without, π/2 is a sum of parts of 33 bits: r = x − k·π/2 with k below 2²⁰, so that every product with k is exact.
Arguments beyond, and those that are not finite, go to the library.
"""

from __future__ import annotations

import math

from flexhinf.codegen.c.numbers import Real, constant
from flexhinf.codegen.emit.trigonometry import COSINE, HALF_PI, REACH, ROUNDER, SINE

#: π/2 for products that are rounded, and the largest |x| for it.
SHORT_HALF_PI = (
    float.fromhex("0x1.921fb544p+0"), float.fromhex("0x1.0b4611a6p-34"), float.fromhex("0x1.3198a2e037073p-69"),
)  # fmt: skip
SHORT_REACH = 1e6


def function(name: str, cosine: bool, real: Real) -> str:
    """``name(x)``: sin or cos; of the type double."""
    lines = "\n".join(f"    {line}" for line in _statements(real, "x", {cosine: "return"}))
    return f"""static {{R}} {name}({{R}} x)
{{
#ifdef FUSED
    const {{R}} reach = {constant(REACH, real)};
#else
    const {{R}} reach = {constant(SHORT_REACH, real)};
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
        ["const {R} *restrict x", *(f"{{R}} *restrict {place}" for place in results.values())]
    )
    return f"""static void {name}({arguments})
{{
    int far = 0;
    for (int l = 0; l < {lanes}; ++l) {{
{lines}
    }}
    for (int l = 0; l < {lanes}; ++l) {{
        far += !({{fabs}}(x[l]) <= {SHORT_REACH!r});
    }}
    if (far > 0) {{
        for (int l = 0; l < {lanes}; ++l) {{
{far}
        }}
    }}
}}""".replace("        #", "#")


def _statements(real: Real, x: str, results: dict[bool, str]) -> list[str]:
    """What is done with an x within the reach: reduced, two polynomials, one of them by the quadrant.

    Parameters
    ----------
    results : dict of bool to str
        What is said before the value of the sine (False) and the cosine (True).
    """

    def number(value: float) -> str:
        return constant(value, real)

    def horner(coefficients: tuple[float, ...]) -> str:
        text = number(coefficients[0])
        for coefficient in coefficients[1:]:
            text = f"FMA({text}, z, {number(coefficient)})"
        return text

    def rest(parts: tuple[float, float, float]) -> str:
        text = "size"
        for part in parts:
            text = f"FMA(-k, {number(part)}, {text})"
        return text

    def choice(cosine: bool) -> tuple[str, str]:
        """The value but for its sign, and when that is negative."""
        odd, even = ("s", "c") if cosine else ("c", "s")
        value = f"(m * (m - {number(2.0)}) < {number(0.0)} || m > {high}) ? {odd} : {even}"
        return value, f"m > {half} && m < {high}" if cosine else f"(m > {low}) != ({x} < {number(0.0)})"

    rounder = number(ROUNDER)
    half, low, high = number(0.5), number(1.5), number(2.5)
    lines = [
        f"const {{R}} size = {{fabs}}({x});",
        f"const {{R}} k = FMA(size, {number(2.0 / math.pi)}, {rounder}) - {rounder};",
        f"const {{R}} m = k - {number(4.0)} * (((k * {number(0.25)} - {number(0.375)}) + {rounder}) - {rounder});",
        "#ifdef FUSED",
        f"const {{R}} r = {rest(HALF_PI)};",
        "#else",
        f"const {{R}} r = {rest(SHORT_HALF_PI)};",
        "#endif",
        "const {R} z = r * r;",
        f"const {{R}} s = FMA({horner(SINE)}, z * r, r);",
        f"const {{R}} c = FMA({horner(COSINE)}, z * z, FMA(z, {number(-0.5)}, {number(1.0)}));",
    ]
    for cosine, said in results.items():
        (value, negative), short = choice(cosine), "cv" if cosine else "sv"
        lines += [f"const {{R}} {short} = {value};", f"{said} ({negative}) ? -{short} : {short};"]
    return lines
