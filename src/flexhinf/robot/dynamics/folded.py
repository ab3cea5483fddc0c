"""Vectors and matrices of three on any element, with zeros and ones folded.

Placements of real robots are full of zeros and ones. Where a factor is such a number nothing is computed, so
that a traced seven-link arm has some 1400 operations instead of ten thousand, and a truncated
polynomial is never multiplied by zero. Elements are numbers, symbols, truncated polynomials, or whole NumPy
arrays of numbers (one entry per point).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

#: Three elements.
Vector = Sequence[Any]

#: Three rows of three elements.
Matrix = Sequence[Vector]

ZERO: Vector = (0.0, 0.0, 0.0)
IDENTITY: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

NUMBERS = (float, int)


def times(a: Any, b: Any) -> Any:
    """a · b."""
    if isinstance(b, NUMBERS):
        a, b = b, a
    if isinstance(a, NUMBERS):
        if a == 0:
            return 0.0
        if a == 1:
            return b
        if a == -1:
            return -b
    return a * b


def plus(a: Any, b: Any) -> Any:
    """a + b."""
    if isinstance(a, NUMBERS) and a == 0:
        return b
    if isinstance(b, NUMBERS) and b == 0:
        return a
    return a + b


def minus(a: Any, b: Any) -> Any:
    """a − b."""
    if isinstance(b, NUMBERS) and b == 0:
        return a
    if isinstance(a, NUMBERS) and a == 0:
        return -b
    return a - b


# Vectors ------------------------------------------------------------------------------------------
def dot(a: Vector, b: Vector) -> Any:
    """a · b."""
    return plus(plus(times(a[0], b[0]), times(a[1], b[1])), times(a[2], b[2]))


def cross(a: Vector, b: Vector) -> Vector:
    """a × b."""
    return (
        minus(times(a[1], b[2]), times(a[2], b[1])),
        minus(times(a[2], b[0]), times(a[0], b[2])),
        minus(times(a[0], b[1]), times(a[1], b[0])),
    )


def add(a: Vector, b: Vector) -> Vector:
    """a + b."""
    return tuple(map(plus, a, b))


def subtract(a: Vector, b: Vector) -> Vector:
    """a − b."""
    return tuple(map(minus, a, b))


def opposite(a: Vector) -> Vector:
    """−a."""
    return tuple(minus(0.0, x) for x in a)


def scaled(factor: Any, a: Vector) -> Vector:
    """factor · a."""
    return tuple(times(factor, x) for x in a)


# Matrices -----------------------------------------------------------------------------------------
def apply(m: Matrix, a: Vector) -> Vector:
    """m a."""
    return tuple(dot(row, a) for row in m)


def apply_transposed(m: Matrix, a: Vector) -> Vector:
    """mᵀ a."""
    return apply(transpose(m), a)


def transpose(m: Matrix) -> Matrix:
    """mᵀ."""
    return tuple(zip(*m, strict=True))


def product(m: Matrix, n: Matrix) -> Matrix:
    """m n."""
    columns = transpose(n)
    return tuple(tuple(dot(row, column) for column in columns) for row in m)


def add_matrices(m: Matrix, n: Matrix) -> Matrix:
    """m + n."""
    return tuple(map(add, m, n))


def subtract_matrices(m: Matrix, n: Matrix) -> Matrix:
    """m − n."""
    return tuple(map(subtract, m, n))


def skew(a: Vector) -> Matrix:
    """[a], with [a] b = a × b."""
    x, y, z = a
    return ((0.0, minus(0.0, z), y), (z, 0.0, minus(0.0, x)), (minus(0.0, y), x, 0.0))


def rotated_symmetric(r: Matrix, m: Matrix) -> Matrix:
    """r m rᵀ for a symmetric m; each entry is computed once."""
    half = product(r, m)
    return symmetric(lambda i, j: dot(half[i], r[j]))


def symmetric(entry: Callable[[int, int], Any]) -> Matrix:
    """A symmetric matrix from its entries (i, j) with i ≥ j."""
    (a,), (b, c), (d, e, f) = ([entry(i, j) for j in range(i + 1)] for i in range(3))
    return ((a, b, d), (b, c, e), (d, e, f))
