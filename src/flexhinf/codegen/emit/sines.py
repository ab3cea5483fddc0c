"""Sine and cosine in LLVM: one sequence of operations for one lane as for many, so that all give the same bits.

x is reduced by Cody and Waite's method in three parts, r = x - k·π/2 with |r| ≤ π/4, and the polynomials of fdlibm
(k_sin.c, k_cos.c) give sin r and cos r, of which the quadrant k mod 4 takes one. With fused multiply-adds the parts
have all digits; without, the first two have 33 bits: their products with a k below 2²⁰ are exact. Arguments beyond the
reach of their sum go to the C library.
"""

from __future__ import annotations

import math

from flexhinf.codegen.emit.writer import PURE, Writer
from flexhinf.codegen.program import PREFIX

#: π/2 as an unevaluated sum of float64 numbers, and the largest |x| that is reduced with it, of which x·2/π is known to
#: well below 1; with fused multiply-adds (True), and without (False).
HALF_PI = {
    True: tuple(map(float.fromhex, ("0x1.921fb54442d18p+0", "0x1.1a62633145c07p-54", "-0x1.f1976b7ed8fbcp-110"))),
    False: tuple(map(float.fromhex, ("0x1.921fb544p+0", "0x1.0b4611a6p-34", "0x1.3198a2e037073p-69"))),
}  # fmt: skip
REACH = {True: 2.0**30, False: 1e6}
# Adding it to |q| < 2^51 leaves the nearest integer in the low bits of the significand.
ROUNDER = 1.5 * 2.0**52
# sin r = r + r³·S(r²) and cos r = 1 - r²/2 + r⁴·C(r²) on |r| ≤ π/4, highest degree first.
SINE = (
    1.58969099521155010221e-10,
    -2.50507602534068634195e-08,
    2.75573137070700676789e-06,
    -1.98412698298579493134e-04,
    8.33333333332248946124e-03,
    -1.66666666666666324348e-01,
)
COSINE = (
    -1.13596475577881948265e-11,
    2.08757232129817482790e-09,
    -2.75573143513906633035e-07,
    2.48015872894767294178e-05,
    -1.38888888888741095749e-03,
    4.16666666666666019037e-02,
)


def is_far(writer: Writer, value: str) -> str:
    """Emit whether x is finite and beyond the reach of the reduction, in each lane."""
    lanes = writer.lanes
    size = writer.intrinsic("fabs", value)
    far = writer.compare("ogt", size, lanes.constant(REACH[writer.module.fused]))
    finite = writer.compare("olt", size, lanes.constant(math.inf))
    return writer.joined("and", far, finite)


def turn(caller: Writer, name: str, value: str, kind: str = "reduced") -> str:
    """sin x or cos x by a function of the module; "near" and "alone" are straight lines, for what is not `is_far`."""
    full = f"{PREFIX}{name}_{kind}{caller.lanes.width}"
    if full not in caller.module.definitions:
        writer = Writer(caller.module, caller.lanes)
        lanes, real = writer.lanes, writer.lanes.real
        result = within = _near(writer, "%x", name, kind == "alone")
        if kind == "reduced":  # the C library beyond the reach, behind a branch that is hardly ever taken
            far = is_far(writer, "%x")
            writer.place("beyond", f"br i1 {writer.any(far)}, label %beyond, label %done, !prof !0")
            exact = writer.select(far, writer.library(name, "%x"), within)
            writer.place("done", "br label %done")
            result = writer.let(f"phi {lanes.real} [ {within}, %entry ], [ {exact}, %beyond ]")
        writer.do(f"ret {real} {result}")
        head = f"define internal {real} @{full}({real} %x) alwaysinline {PURE} {{\nentry:"
        caller.module.define(full, head, writer.lines)
    return caller.call(full, value)


def _near(writer: Writer, x: str, name: str, alone: bool) -> str:
    """The function for |x| within the reach; NaN for NaN and infinities.

    Of the polynomials of the quadrants the right one is computed, if the function is `alone`; or both, which sine and
    cosine of one angle share. The bits are the same.
    """
    lanes = writer.lanes
    size = writer.intrinsic("fabs", x)
    shifted = writer.multiply_add(size, lanes.constant(2.0 / math.pi), lanes.constant(ROUNDER))
    quadrant = writer.bits(shifted)
    turns = writer.real("fneg", writer.real("fsub", shifted, lanes.constant(ROUNDER)))
    remainder = size
    for part in HALF_PI[writer.module.fused]:
        remainder = writer.multiply_add(turns, lanes.constant(part), remainder)
    odd = writer.compare_whole("ne", writer.whole("and", quadrant, 1), lanes.whole(0))
    square = writer.real("fmul", remainder, remainder)
    parabola = writer.multiply_add(square, lanes.constant(-0.5), lanes.constant(1.0))

    def total(value: str, *others: str) -> str:
        *coefficients, factor, summand = others
        for coefficient in coefficients:
            value = writer.multiply_add(value, square, coefficient)
        return writer.multiply_add(value, writer.real("fmul", square, factor), summand)

    # Either is a polynomial in r², times r² and a factor, and one number more.
    sin = [*map(lanes.constant, SINE), remainder, remainder]
    cos = [*map(lanes.constant, COSINE), square, parabola]
    at_odd, at_even = (cos, sin) if name == "sin" else (sin, cos)
    if alone:
        result = total(*(writer.select(odd, *pair) for pair in zip(at_odd, at_even)))
    else:
        result = writer.select(odd, total(*at_odd), total(*at_even))
    if name == "sin":
        flip = writer.whole("xor", writer.whole("shl", quadrant, 62), writer.bits(x))
    else:
        flip = writer.whole("shl", writer.whole("add", quadrant, 1), 62)
    sign = writer.whole("and", flip, -(2**63))
    return writer.float(writer.whole("xor", writer.bits(result), sign))
