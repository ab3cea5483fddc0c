"""Sine and cosine in LLVM: one sequence of operations for one lane as for many, so that all give the same bits.

x is reduced by Cody and Waite's method in three parts, r = x - k·π/2 with |r| ≤ π/4, and the polynomials of fdlibm
(k_sin.c, k_cos.c) give sin r and cos r, of which the quadrant k mod 4 takes one. With fused multiply-adds the parts
have all digits; without, the first two have 33 bits: their products with a k below 2²⁰ are exact.

Arguments beyond the reach of their sum are reduced by Payne and Hanek's method (1983), in integers: the same bits
on every processor, and within one unit of the last place. 2/π in binary stands behind 64 zeros. 192 bits are taken from
it so that their product with the 53 bits of x is x·2/π but for multiples of four, and for 2⁻¹²⁶. Of that at least 62
bits are left where x is nearest to a multiple of π/2. r is a float64 and what is behind its digits.
"""

from __future__ import annotations

import math
from itertools import pairwise

from flexhinf.codegen.emit.writer import PURE, Lanes, Writer
from flexhinf.codegen.program import PREFIX

#: π/2 as an unevaluated sum of float64 numbers, and the largest |x| that is reduced with it, of which x·2/π is known to
#: well below 1; with fused multiply-adds (True), and without (False).
HALF_PI = {
    True: tuple(map(float.fromhex, ("0x1.921fb54442d18p+0", "0x1.1a62633145c07p-54", "-0x1.f1976b7ed8fbcp-110"))),
    False: tuple(map(float.fromhex, ("0x1.921fb544p+0", "0x1.0b4611a6p-34", "0x1.3198a2e037073p-69"))),
}  # fmt: skip
REACH = {True: 2.0**30, False: 1e6}
#: 2/π in hexadecimal digits behind the point; and π/2, times 2⁶³.
TWO_OVER_PI = (
    "A2F9836E4E441529FC2757D1F534DDC0DB6295993C439041FE5163ABDEBBC561B7246E3A424D"
    "D2E006492EEA09D1921CFE1DEB1CB129A73EE88235F52EBB4484E99C7026B45F7E413991D639"
    "835339F49C845F8BBDF9283B1FF897FFDE05980FEF2F118B5A0A6D1F6D367ECF27CB09B74F46"
    "3F669E5FEA2D7527BAC7EBE5F17B3D0739F78A5292EA6BFB5FB11F8D5D0856033046FC7B6BAB"
)
WHOLE_HALF_PI = 0xC90FDAA22168C235
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
        if kind == "reduced":  # beyond the reach, behind a branch that is hardly ever taken
            far = is_far(writer, "%x")
            writer.place("beyond", f"br i1 {writer.any(far)}, label %beyond, label %done, !prof !0")
            exact = writer.select(far, _far(writer, name, "%x"), within)
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
    return _signed(writer, name, result, quadrant, x)


def _signed(writer: Writer, name: str, result: str, quadrant: str, x: str) -> str:
    """With the sign of the quadrant, and that of x for a sine."""
    if name == "sin":
        flip = writer.whole("xor", writer.whole("shl", quadrant, 62), writer.bits(x))
    else:
        flip = writer.whole("shl", writer.whole("add", quadrant, 1), 62)
    sign = writer.whole("and", flip, -(2**63))
    return writer.float(writer.whole("xor", writer.bits(result), sign))


def _far(caller: Writer, name: str, value: str) -> str:
    """The function of a finite x beyond the reach, in each lane; some number for others."""
    full, module = f"{PREFIX}{name}_far", caller.module
    if full not in module.definitions:
        writer = Writer(module, Lanes(1))
        quadrant, remainder, residue = _reduced(writer, "%x")
        square = writer.real("fmul", remainder, remainder)

        def series(coefficients: tuple[float, ...]) -> str:
            total = writer.lanes.constant(coefficients[0])
            for coefficient in coefficients[1:]:
                total = writer.multiply_add(total, square, writer.lanes.constant(coefficient))
            return total

        half = writer.real("fmul", square, 0.5)
        parabola = writer.real("fsub", 1.0, half)
        cubed = writer.real("fmul", square, remainder)
        tail = writer.multiply_add(series(SINE), cubed, writer.real("fmul", residue, parabola))
        sin = writer.real("fadd", remainder, tail)
        # What is lost in 1 - r²/2, which is the larger one, is exact.
        lost = writer.real("fsub", writer.real("fsub", 1.0, parabola), half)
        lost = writer.real("fsub", lost, writer.real("fmul", residue, remainder))
        fourth = writer.real("fmul", square, square)
        cos = writer.real("fadd", parabola, writer.multiply_add(series(COSINE), fourth, lost))
        odd = writer.compare_whole("ne", writer.whole("and", quadrant, 1), writer.lanes.whole(0))
        result = writer.select(odd, *((cos, sin) if name == "sin" else (sin, cos)))
        writer.do(f"ret double {_signed(writer, name, result, quadrant, '%x')}")
        head = f"define internal double @{full}(double %x) noinline {PURE} {{\nentry:"
        module.define(full, head, writer.lines)
    return caller.lanewise(full, value)


def _reduced(writer: Writer, x: str) -> tuple[str, str, str]:
    """The quadrant k mod 4, and r in two parts, of one |x| beyond the reach."""
    table, whole = f"{PREFIX}two_over_pi", writer.whole
    numbers = ", ".join(
        f"i64 {int('0' * 16 + TWO_OVER_PI, 16) >> 64 * k & 2**64 - 1}" for k in reversed(range(20))
    )
    writer.module.declarations[table] = f"@{table} = internal constant [20 x i64] [{numbers}]"

    def wide(operation: str, left: str, right: str | int) -> str:
        return writer.let(f"{operation} i128 {left}, {right}")

    def widened(word: str) -> str:
        return writer.let(f"zext i64 {word} to i128")

    def high(number: str, first: int = 64) -> str:
        return writer.let(f"trunc i128 {wide('lshr', number, first)} to i64")

    bits = whole("and", writer.bits(x), 2**63 - 1)
    first = whole("sub", whole("lshr", bits, 52), 1013)  # of the bits that are taken
    first = writer.select(writer.compare_whole("sgt", first, "0"), first, "0", "i64")  # one that is not far
    factor = widened(whole("or", whole("and", bits, 2**52 - 1), 2**52))
    index, shift = whole("lshr", first, 6), whole("and", first, 63)
    stored = [writer.read("i64", writer.at("i64", f"@{table}", whole("add", index, k))) for k in range(4)]
    taken = [
        whole(
            "or", whole("shl", left, shift), whole("lshr", whole("lshr", right, 1), whole("xor", shift, 63))
        )
        for left, right in pairwise(stored)
    ]
    turns = widened(high(wide("mul", factor, widened(taken[2]))))
    turns = wide("add", wide("mul", factor, widened(taken[1])), turns)
    turns = wide("add", turns, wide("shl", wide("mul", factor, widened(taken[0])), 64))
    quadrant = high(wide("add", turns, 2**125), 126)
    turns = wide("shl", turns, 2)
    sign = whole("and", high(turns), -(2**63))
    mirrored = writer.let(f"icmp slt i128 {turns}, 0")
    size = writer.let(f"select i1 {mirrored}, i128 {wide('sub', '0', turns)}, i128 {turns}")
    counting = "llvm.ctlz.i128"
    writer.module.declarations[counting] = f"declare i128 @{counting}(i128, i1)"
    zeros = writer.let(f"call i128 @{counting}(i128 {size}, i1 false)")
    leading = widened(high(wide("shl", size, zeros)))
    remainder = high(wide("mul", leading, f"{WHOLE_HALF_PI}"))
    scale = whole("shl", whole("sub", 1023 - 52, writer.let(f"trunc i128 {zeros} to i64")), 52)
    scale = writer.float(whole("or", scale, sign))
    digits = writer.real("fmul", writer.to_float(whole("lshr", remainder, 11)), scale)
    residue = writer.real("fmul", writer.to_float(whole("and", remainder, 2**11 - 1)), scale)
    return quadrant, digits, writer.real("fmul", residue, 2.0**-11)
