"""Normal numbers of a counter: one algorithm, evaluated on arrays or written into a kernel, with the same bits.

SX has no integers, so kernels have it as text and not traced. Sums and products are not fused: every operation is one
that IEEE 754 rounds correctly, so that the bits are the same on every processor.

Any step, channel and sample can ask for its own number alone, so results do not depend on lanes, threads or batches,
and one sample can be replayed alone. The generator is Philox4x32-10 of Salmon, Moraes, Dror & Shaw, "Parallel random
numbers: as easy as 1, 2, 3", SC 2011; its counter is (step, channel, sample, 0) and its key the seed. Box and Muller's
transform makes a normal number of two uniform ones, without a branch.

Of 53 random bits n − 1 the uniform number n/2⁵³ lies in (0, 1]. Its logarithm is fdlibm's (e_log.c): n = 2ᵏ m with m in
[√½, √2), s = (m − 1)/(m + 1), and log m by a polynomial in s². The cosine of a whole turn is a sine within a quarter
turn, cos 2πt = sin π(|2t − 1| − ½) for t in (0, 1], of which the Taylor polynomial of degree 21 is right to 2e-18.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import ClassVar, Protocol, TypeVar, overload

import numpy as np

#: In a class that has a method `float`.
Real = float

ROUNDS = 10
MULTIPLIERS = (0xD2511F53, 0xCD9E8D57)
WEYL = (0x9E3779B9, 0xBB67AE85)
LOW = 0xFFFFFFFF
#: Bits of √½, above which a significand is in its range; and the bits that hold a significand.
SQRT_HALF, MANTISSA = 0x3FE6A09E00000000, (1 << 52) - 1
#: log 2 in two parts, of which the first has 20 zeros at its end: its product with an exponent is exact.
LN2 = (6.93147180369123816490e-01, 1.90821492927058770002e-10)
#: log((1 + s)/(1 − s)) = 2s + s·R(s²): coefficients of s¹⁴ down to s² of R.
LOGARITHM = (
    1.479819860511658591e-01,
    1.531383769920937332e-01,
    1.818357216161805012e-01,
    2.222219843214978396e-01,
    2.857142874366239149e-01,
    3.999999999940941908e-01,
    6.666666666666735130e-01,
)
#: sin x = x + x³ S(x²): coefficients of x¹⁸ down to x⁰ of S.
SINE = tuple((-1.0) ** k / math.factorial(2 * k + 1) for k in range(10, 0, -1))
#: A whole turn in units of 2⁻⁵³ of it, rad each.
TURN = 2.0 * math.pi * 2.0**-53

#: What stands for 64-bit integers or numbers: arrays of them, or the name of a value in a text.
Word = TypeVar("Word")


class Arithmetic(Protocol[Word]):
    """What the algorithm needs: operations of LLVM by their names, of words and constants; see `Arrays`."""

    def whole(self, operation: str, left: Word | int, right: Word | int, /) -> Word:
        """Of integers, unsigned but for "ashr"."""
        ...

    def real(self, operation: str, left: Word | float, right: Word | float, /) -> Word:
        """Of numbers."""
        ...

    def to_float(self, integer: Word, /) -> Word:
        """A signed integer of at most 53 bits as a number, exactly."""
        ...

    def bits(self, number: Word, /) -> Word:
        """The bits of a number."""
        ...

    def float(self, bits: Word, /) -> Word:
        """The number of these bits."""
        ...

    def root(self, number: Word, /) -> Word:
        """The square root."""
        ...


@overload
def seed_key(seed: int) -> tuple[int, int]: ...
@overload
def seed_key(seed: np.ndarray) -> tuple[np.ndarray, np.ndarray]: ...
def seed_key(seed: int | np.ndarray) -> tuple[int, int] | tuple[np.ndarray, np.ndarray]:
    """The low and the high word, of 32 bits each, of a seed below 2⁶⁴, or of several as an array of 64 bits."""
    if isinstance(seed, np.ndarray):
        return seed & np.uint64(0xFFFFFFFF), seed >> np.uint64(32)
    return seed & 0xFFFFFFFF, (seed >> 32) & 0xFFFFFFFF


class Arrays:
    """Operations on NumPy arrays of 64-bit integers and numbers, named as in LLVM; the algorithm stands here once:
    `flexhinf.codegen.emit.writer.Writer` has the same as text."""

    WHOLE: ClassVar[dict[str, Callable[[np.ndarray, np.ndarray], np.ndarray]]] = {
        "add": np.add,
        "sub": np.subtract,
        "mul": np.multiply,
        "and": np.bitwise_and,
        "xor": np.bitwise_xor,
        "shl": np.left_shift,
        "lshr": np.right_shift,
        "ashr": lambda left, right: (left.view(np.int64) >> right.view(np.int64)).view(np.uint64),
    }
    REAL: ClassVar[dict[str, np.ufunc]] = {
        "fadd": np.add,
        "fsub": np.subtract,
        "fmul": np.multiply,
        "fdiv": np.divide,
    }

    def whole(self, operation: str, left: np.ndarray | int, right: np.ndarray | int, /) -> np.ndarray:
        """An operation on integers, unsigned but for "ashr"."""
        return self.WHOLE[operation](np.asarray(left, np.uint64), np.asarray(right, np.uint64))

    def real(self, operation: str, left: np.ndarray | Real, right: np.ndarray | Real, /) -> np.ndarray:
        """An operation on numbers."""
        return self.REAL[operation](left, right)

    def to_float(self, integer: np.ndarray, /) -> np.ndarray:
        """A signed integer of at most 53 bits as a number, exactly."""
        return integer.view(np.int64).astype(float)

    def bits(self, number: np.ndarray, /) -> np.ndarray:
        """The bits of a number."""
        return number.view(np.uint64)

    def float(self, bits: np.ndarray, /) -> np.ndarray:
        """The number of these bits."""
        return bits.view(np.float64)

    def root(self, number: np.ndarray, /) -> np.ndarray:
        """The square root."""
        return np.sqrt(number)


ARRAYS = Arrays()


def philox(run: Arithmetic[Word], counter: Sequence[Word | int], key: Sequence[Word | int]) -> list[Word]:
    """Four random words of 32 bits, in 64, for each counter of four such words; the key has two.

    Arguments are integers, or integer arrays that broadcast. In between, what is above 32 bits means nothing.
    """
    block = list(counter)
    for turn in range(ROUNDS):
        low, high = (
            run.whole("mul", run.whole("and", word, LOW), factor)
            for word, factor in zip((block[0], block[2]), MULTIPLIERS)
        )
        keys = [run.whole("add", k, turn * weyl) for k, weyl in zip(key, WEYL)] if turn else key
        block = [
            run.whole("xor", run.whole("xor", run.whole("lshr", high, 32), block[1]), keys[0]),
            high,
            run.whole("xor", run.whole("xor", run.whole("lshr", low, 32), block[3]), keys[1]),
            low,
        ]
    return [run.whole("and", word, LOW) for word in block]


def normal(run: Arithmetic[Word], counter: Sequence[Word | int], key: Sequence[Word | int]) -> Word:
    """A number N(0, 1) for each counter, by Box and Muller's transform of 53-bit uniforms. Nothing is fused."""
    block = philox(run, counter, key)
    first, second = (  # n of two uniform numbers n/2⁵³, 1 … 2⁵³, as integers
        run.whole("add", run.whole("xor", run.whole("shl", high, 21), run.whole("lshr", low, 11)), 1)
        for high, low in (block[:2], block[2:])
    )
    return run.real("fmul", run.root(run.real("fmul", _logarithm(run, first), -2.0)), _cosine(run, second))


def normal_numbers(
    seed: int, step: np.ndarray | int, channel: np.ndarray | int, sample: np.ndarray | int
) -> np.ndarray:
    """Independent N(0, 1) numbers, by Box and Muller's transform of 53-bit uniforms.

    Parameters
    ----------
    seed : int
        0 … 2⁶⁴ − 1.
    step, channel, sample : int or array of int, below 2³²
        Broadcast.

    Returns
    -------
    ndarray
        At most 8.6 in size.
    """
    return normal(ARRAYS, (step, channel, sample, 0), seed_key(seed))


def _polynomial(run: Arithmetic[Word], coefficients: tuple[float, ...], x: Word) -> Word:
    value = run.real("fadd", run.real("fmul", coefficients[0], x), coefficients[1])
    for coefficient in coefficients[2:]:
        value = run.real("fadd", run.real("fmul", value, x), coefficient)
    return value


def _logarithm(run: Arithmetic[Word], numerator: Word) -> Word:
    """log(n/2⁵³)."""
    real, whole = run.real, run.whole
    above = whole("sub", run.bits(run.to_float(numerator)), SQRT_HALF)
    exponent = run.to_float(whole("sub", whole("ashr", above, 52), 53))
    f = real("fsub", run.float(whole("add", whole("and", above, MANTISSA), SQRT_HALF)), 1.0)
    s = real("fdiv", f, real("fadd", f, 2.0))
    square = real("fmul", s, s)
    tail = real("fmul", square, _polynomial(run, LOGARITHM, square))
    half = real("fmul", real("fmul", f, f), 0.5)
    # log m = f − (f²/2 − s(f²/2 + R)), and the parts of k·log 2 where they lose least.
    small = real("fmul", s, real("fadd", half, tail))
    small = real("fadd", small, real("fmul", exponent, LN2[1]))
    small = real("fsub", real("fsub", half, small), f)
    return real("fsub", real("fmul", exponent, LN2[0]), small)


def _cosine(run: Arithmetic[Word], numerator: Word) -> Word:
    """cos(2π n/2⁵³)."""
    from_half = run.whole("sub", numerator, 1 << 52)
    negative = run.whole("ashr", from_half, 63)
    distance = run.whole("sub", run.whole("xor", from_half, negative), negative)
    x = run.real("fmul", run.to_float(run.whole("sub", distance, 1 << 51)), TURN)
    square = run.real("fmul", x, x)
    cubed = run.real("fmul", run.real("fmul", square, x), _polynomial(run, SINE, square))
    return run.real("fadd", x, cubed)
