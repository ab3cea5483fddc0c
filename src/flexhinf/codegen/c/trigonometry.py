"""Sine and cosine without the library: the same bits on every machine with a fused multiply-add, and in vectors.

With it, the operations are those of `flexhinf.codegen.emit.trigonometry`, so that machine code and C agree to the last
bit. Without, π/2 is a sum of parts of 33 bits: r = x − k·π/2 with k below 2²⁰, so that every product with k is exact.
Arguments beyond, and those that are not finite, go to the library.
"""

from __future__ import annotations

import math

from flexhinf.codegen.c.numbers import Real, constant
from flexhinf.codegen.emit.trigonometry import COSINE, HALF_PI, REACH, ROUNDER, SINE

__all__ = ["function", "row_function"]

#: π/2 for products that are rounded, and the largest |x| for it.
SHORT_HALF_PI = (
    float.fromhex("0x1.921fb544p+0"), float.fromhex("0x1.0b4611a6p-34"), float.fromhex("0x1.3198a2e037073p-69"),
)  # fmt: skip
SHORT_REACH = 1e6


def function(name: str, cosine: bool, real: Real) -> str:
    """``name_near(x)`` for what is reduced here, and ``name(x)`` for all numbers; of the type double."""

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

    rounder = number(ROUNDER)
    odd, even = ("s", "c") if cosine else ("c", "s")
    negative = (
        f"m > {number(0.5)} && m < {number(2.5)}" if cosine else f"(m > {number(1.5)}) != (x < {number(0.0)})"
    )
    return f"""static {{R}} {name}_near({{R}} x)
{{
    const {{R}} size = {{fabs}}(x);
    const {{R}} k = FMA(size, {number(2.0 / math.pi)}, {rounder}) - {rounder};
    const {{R}} m = k - {number(4.0)} * (((k * {number(0.25)} - {number(0.375)}) + {rounder}) - {rounder});
#ifdef FUSED
    const {{R}} r = {rest(HALF_PI)};
#else
    const {{R}} r = {rest(SHORT_HALF_PI)};
#endif
    const {{R}} z = r * r;
    const {{R}} s = FMA({horner(SINE)}, z * r, r);
    const {{R}} c = FMA({horner(COSINE)}, z * z, FMA(z, {number(-0.5)}, {number(1.0)}));
    const {{R}} value = (m * (m - {number(2.0)}) < {number(0.0)} || m > {number(2.5)}) ? {odd} : {even};
    return ({negative}) ? -value : value;
}}

static {{R}} {name}({{R}} x)
{{
#ifdef FUSED
    const {{R}} reach = {number(REACH)};
#else
    const {{R}} reach = {number(SHORT_REACH)};
#endif
    return ({{fabs}}(x) <= reach) ? {name}_near(x) : {"cos" if cosine else "sin"}(x);
}}"""


def row_function(name: str, one: str, lanes: int) -> str:
    """``void name(x, out)``: the function `one` of a row of lanes."""
    return f"""static void {name}(const {{R}} *restrict x, {{R}} *restrict out)
{{
    int far = 0;
    for (int l = 0; l < {lanes}; ++l) {{
        out[l] = {one}_near(x[l]);
    }}
    for (int l = 0; l < {lanes}; ++l) {{
        far += !({{fabs}}(x[l]) <= {SHORT_REACH!r});
    }}
    if (far > 0) {{
        for (int l = 0; l < {lanes}; ++l) {{
            out[l] = {one}(x[l]);
        }}
    }}
}}"""
