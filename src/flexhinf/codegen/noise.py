"""Normal numbers of a counter, as arrays: the twin of what kernels compute themselves, with the same bits.

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
from functools import reduce
from typing import Any

import numpy as np

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


def seed_key(seed: int) -> tuple[int, int]:
    """The low and the high word, of 32 bits each, of a seed below 2⁶⁴."""
    return seed & 0xFFFFFFFF, (seed >> 32) & 0xFFFFFFFF


def philox(counter: tuple[Any, Any, Any, Any], key: tuple[int, int]) -> tuple[np.ndarray, ...]:
    """Four random words of 32 bits for each counter."""
    words = [np.asarray(c).astype(np.uint64) for c in np.broadcast_arrays(*counter)]
    factors = [np.uint64(factor) for factor in MULTIPLIERS]
    for turn in range(ROUNDS):
        first, second = factors[0] * words[0], factors[1] * words[2]
        keys = [np.uint64((int(k) + turn * weyl) & 0xFFFFFFFF) for k, weyl in zip(key, WEYL)]
        words = [
            (second >> np.uint64(32)) ^ words[1] ^ keys[0],
            second & np.uint64(LOW),
            (first >> np.uint64(32)) ^ words[3] ^ keys[1],
            first & np.uint64(LOW),
        ]
    return tuple(words)


def normal_numbers(seed: int, step: Any, channel: Any, sample: Any) -> np.ndarray:
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
    words = philox((step, channel, sample, 0), seed_key(seed))
    first, second = (_numerator(words[k], words[k + 1]) for k in (0, 2))
    return np.sqrt(_logarithm(first) * -2.0) * _cosine(second)


def _numerator(high: np.ndarray, low: np.ndarray) -> np.ndarray:
    return ((high << np.uint64(21)) ^ (low >> np.uint64(11))).astype(np.int64) + 1


def _polynomial(coefficients: tuple[float, ...], x: np.ndarray) -> np.ndarray:
    return reduce(
        lambda value, coefficient: value * x + coefficient, coefficients[1:], np.float64(coefficients[0])
    )


def _logarithm(numerator: np.ndarray) -> np.ndarray:
    above = numerator.astype(float).view(np.int64) - SQRT_HALF
    exponent = ((above >> 52) - 53).astype(float)
    f = ((above & MANTISSA) + SQRT_HALF).view(float) - 1.0
    s = f / (f + 2.0)
    square = s * s
    half = f * f * 0.5
    small = s * (half + square * _polynomial(LOGARITHM, square)) + exponent * LN2[1]
    return exponent * LN2[0] - (half - small - f)


def _cosine(numerator: np.ndarray) -> np.ndarray:
    x = (np.abs(numerator - (1 << 52)) - (1 << 51)).astype(float) * TURN
    square = x * x
    return x + square * x * _polynomial(SINE, square)
