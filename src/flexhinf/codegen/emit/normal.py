"""Normal numbers of a counter, in lanes: Philox4x32-10, then Box and Muller's transform without a branch.

Formulas and constants are those of `flexhinf.codegen.noise`. SX has no integers, so this is emitted and not traced.
Sums and products are not fused here: every operation is one that IEEE 754 rounds correctly, so that the bits are those
of the NumPy text on every processor.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce

from flexhinf.codegen.emit.text import PURE, Writer
from flexhinf.codegen.noise import (
    LN2,
    LOGARITHM,
    LOW,
    MANTISSA,
    MULTIPLIERS,
    ROUNDS,
    SINE,
    SQRT_HALF,
    TURN,
    WEYL,
)
from flexhinf.codegen.program import PREFIX


def emit_normal(caller: Writer, step: str, channel: int, key: Sequence[str]) -> str:
    """Emit a number N(0, 1); returns the name of the result.

    `step`: Name of a 64-bit integer below 2³². `key`: Names of the sample, and of the low and the high word of the
    seed, likewise.
    """
    lanes = caller.lanes
    counter = (step, lanes.whole(channel), *key)
    arguments = ", ".join(f"{lanes.integer} {word}" for word in counter)
    return caller.let(f"call {lanes.real} @{_function(caller)}({arguments})")


def _function(caller: Writer) -> str:
    """Name of ``normal(step, channel, sample, low, high)``, emitted when first asked for."""
    full = f"{PREFIX}normal{caller.lanes.width}"
    if full not in caller.module.definitions:
        writer = Writer(caller.module, caller.lanes)
        whole, real = writer.lanes.integer, writer.lanes.real
        words = _philox(writer, ["%step", "%channel", "%sample", writer.lanes.whole(0)], ["%low", "%high"])
        first, second = (_numerator(writer, *words[k : k + 2]) for k in (0, 2))
        radius = writer.intrinsic(
            "sqrt", writer.real("fmul", _logarithm(writer, first), _constant(writer, -2.0))
        )
        writer.do(f"ret {real} {writer.real('fmul', radius, _cosine(writer, second))}")
        arguments = ", ".join(f"{whole} %{name}" for name in ("step", "channel", "sample", "low", "high"))
        head = f"define internal {real} @{full}({arguments}) noinline {PURE} {{"
        caller.module.definitions[full] = "\n".join([head, *writer.lines, "}"])
    return full


def _constant(writer: Writer, value: float) -> str:
    return writer.lanes.constant(value)


def _integer(writer: Writer, operation: str, left: str, right: str | int) -> str:
    return writer.whole(operation, left, writer.lanes.whole(right) if isinstance(right, int) else right)


def _philox(writer: Writer, words: list[str], key: list[str]) -> list[str]:
    """Four words of 32 bits, in 64. In between, what is above these bits means nothing."""

    def step(operation: str, left: str, right: str | int) -> str:
        return _integer(writer, operation, left, right)

    for turn in range(ROUNDS):
        low, high = (
            step("mul", step("and", word, LOW), factor)
            for word, factor in zip((words[0], words[2]), MULTIPLIERS)
        )
        keys = [step("add", k, turn * weyl) for k, weyl in zip(key, WEYL)] if turn else key
        words = [
            step("xor", step("xor", step("lshr", high, 32), words[1]), keys[0]),
            high,
            step("xor", step("xor", step("lshr", low, 32), words[3]), keys[1]),
            low,
        ]
    return [step("and", word, LOW) for word in words]


def _numerator(writer: Writer, high: str, low: str) -> str:
    """n of the uniform number n/2⁵³, 1 … 2⁵³, as an integer."""
    shifted = _integer(writer, "shl", high, 21)
    bits = _integer(writer, "xor", shifted, _integer(writer, "lshr", low, 11))
    return _integer(writer, "add", bits, 1)


def _float(writer: Writer, integer: str) -> str:
    """An integer of at most 53 bits as a number, exactly."""
    return writer.let(f"sitofp {writer.lanes.integer} {integer} to {writer.lanes.real}")


def _polynomial(writer: Writer, coefficients: tuple[float, ...], x: str) -> str:
    """Horner's rule, nothing fused."""

    def further(value: str, coefficient: float) -> str:
        return writer.real("fadd", writer.real("fmul", value, x), _constant(writer, coefficient))

    return reduce(further, coefficients[1:], _constant(writer, coefficients[0]))


def _logarithm(writer: Writer, numerator: str) -> str:
    """log(n/2⁵³)."""
    bits = writer.bits(_float(writer, numerator))
    above = _integer(writer, "sub", bits, SQRT_HALF)
    exponent = _float(writer, _integer(writer, "sub", _integer(writer, "ashr", above, 52), 53))
    rest = _integer(writer, "add", _integer(writer, "and", above, MANTISSA), SQRT_HALF)
    f = writer.real("fsub", writer.float(rest), _constant(writer, 1.0))
    s = writer.real("fdiv", f, writer.real("fadd", f, _constant(writer, 2.0)))
    square = writer.real("fmul", s, s)
    tail = writer.real("fmul", square, _polynomial(writer, LOGARITHM, square))
    half = writer.real("fmul", writer.real("fmul", f, f), _constant(writer, 0.5))
    # log m = f − (f²/2 − s(f²/2 + R)), and the parts of k·log 2 where they lose least.
    small = writer.real("fmul", s, writer.real("fadd", half, tail))
    small = writer.real("fadd", small, writer.real("fmul", exponent, _constant(writer, LN2[1])))
    small = writer.real("fsub", writer.real("fsub", half, small), f)
    return writer.real("fsub", writer.real("fmul", exponent, _constant(writer, LN2[0])), small)


def _cosine(writer: Writer, numerator: str) -> str:
    """cos(2π n/2⁵³)."""
    from_half = _integer(writer, "sub", numerator, 1 << 52)
    negative = _integer(writer, "ashr", from_half, 63)
    distance = _integer(writer, "sub", _integer(writer, "xor", from_half, negative), negative)
    quarter = _float(writer, _integer(writer, "sub", distance, 1 << 51))
    x = writer.real("fmul", quarter, _constant(writer, TURN))
    square = writer.real("fmul", x, x)
    cubed = writer.real("fmul", writer.real("fmul", square, x), _polynomial(writer, SINE, square))
    return writer.real("fadd", x, cubed)
