"""A scalar CasADi expression that lives safely inside NumPy object arrays.

``casadi.SX`` is itself array-like, which confuses NumPy inside object arrays; `Symbol` is the thin wrapper which makes
slicing, ``@``, ``np.outer`` and ``np.sin`` work. An operation that is not listed here raises.

Functions that are not smooth dispatch on the element, or refuse by name: NumPy's own ``where``, ``sign``, ``clip`` and
``maximum`` compare elements, which a symbol, a truncated polynomial or an interval cannot answer with yes or no.

Small dense linear algebra on any element (``np.linalg`` takes floats only) is loops over indices, for matrices of the
size of a state vector. A matrix that is not positive semidefinite gives NaN, which the callers turn into an error or a
status: a kernel cannot raise.
"""

from __future__ import annotations

from collections.abc import Callable
from numbers import Real
from typing import Any, cast

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from flexhinf.arrays import Elements
from flexhinf.errors import InvalidInput


def _lift(value: object) -> ca.SX | None:
    """The SX of a Symbol or of a real number; None for anything else (NumPy then broadcasts)."""
    if isinstance(value, Symbol):
        return value.sx
    return ca.SX(float(cast(float, value))) if isinstance(value, (Real, np.bool_)) else None


# `SX.unary` and `SX.binary` build the same nodes as the operators and functions of CasADi, which look for the type of
# their arguments first and take ten times as long.
def _unary(operation: int) -> Callable[[Symbol], Symbol]:
    def method(self: Symbol) -> Symbol:
        return Symbol(ca.SX.unary(operation, self.sx))

    return method


def _binary(operation: int, reflected: bool = False) -> Callable[[Symbol, Any], Symbol]:
    def method(self: Symbol, other: Any) -> Symbol:
        value = _lift(other)
        if value is None:
            return NotImplemented
        left, right = (value, self.sx) if reflected else (self.sx, value)
        return Symbol(ca.SX.binary(operation, left, right))

    return method


class Symbol:
    """One scalar symbolic expression.

    Parameters
    ----------
    sx : casadi.SX
        A 1 × 1 expression.
    """

    __slots__ = ("sx",)
    __hash__ = None  # pyright: ignore[reportAssignmentType]  # == builds an expression, so a Symbol cannot be a key

    def __init__(self, sx: ca.SX) -> None:
        self.sx = sx

    __add__, __radd__ = _binary(ca.OP_ADD), _binary(ca.OP_ADD, True)
    __sub__, __rsub__ = _binary(ca.OP_SUB), _binary(ca.OP_SUB, True)
    __mul__, __rmul__ = _binary(ca.OP_MUL), _binary(ca.OP_MUL, True)
    __truediv__, __rtruediv__ = _binary(ca.OP_DIV), _binary(ca.OP_DIV, True)
    __pow__, __rpow__ = _binary(ca.OP_POW), _binary(ca.OP_POW, True)
    __neg__, __abs__ = _unary(ca.OP_NEG), _unary(ca.OP_FABS)
    __lt__, __le__ = _binary(ca.OP_LT), _binary(ca.OP_LE)
    __gt__, __ge__ = _binary(ca.OP_LT, True), _binary(ca.OP_LE, True)  # a > b is b < a
    __eq__ = _binary(ca.OP_EQ)  # pyright: ignore[reportAssignmentType]
    __ne__ = _binary(ca.OP_NE)  # pyright: ignore[reportAssignmentType]
    __and__, __or__ = _binary(ca.OP_AND), _binary(ca.OP_OR)
    __invert__ = _unary(ca.OP_NOT)

    def __pos__(self) -> Symbol:
        return self

    # NumPy's ufuncs on object arrays call the method of the same name.
    sin, cos, tan = _unary(ca.OP_SIN), _unary(ca.OP_COS), _unary(ca.OP_TAN)
    arcsin, arccos, arctan = _unary(ca.OP_ASIN), _unary(ca.OP_ACOS), _unary(ca.OP_ATAN)
    sinh, cosh, tanh = _unary(ca.OP_SINH), _unary(ca.OP_COSH), _unary(ca.OP_TANH)
    arcsinh, arccosh, arctanh = _unary(ca.OP_ASINH), _unary(ca.OP_ACOSH), _unary(ca.OP_ATANH)
    exp, log, sqrt = _unary(ca.OP_EXP), _unary(ca.OP_LOG), _unary(ca.OP_SQRT)
    expm1, log1p = _unary(ca.OP_EXPM1), _unary(ca.OP_LOG1P)
    # np.floor and np.ceil go through the math module.
    __floor__, __ceil__ = _unary(ca.OP_FLOOR), _unary(ca.OP_CEIL)
    arctan2, hypot = _binary(ca.OP_ATAN2), _binary(ca.OP_HYPOT)

    def log10(self) -> Symbol:
        """Decimal logarithm."""
        return Symbol(ca.log(self.sx) / np.log(10.0))

    def conjugate(self) -> Symbol:
        """The symbol itself: it is real."""
        return self

    def __bool__(self) -> bool:
        raise InvalidInput(
            "A symbolic expression has no truth value, so `if`, `max`, `np.where` cannot branch on it.",
            f"expected arithmetic or a function of flexhinf.scalars, got a branch on {self!r}",
            "flexhinf.scalars.where, maximum, minimum, clip, sign or absolute; to compare whole arrays, "
            "np.greater(x, y, dtype=object)",
        )

    def __float__(self) -> float:
        if self.sx.is_constant():
            return float(self.sx)
        raise InvalidInput(
            "A symbolic expression is not a number.",
            f"expected arithmetic on the element, got float({self!r}) (math.sin and float arrays do that)",
            "np.sin instead of math.sin; np.array([...]) of the elements instead of filling a float array",
        )

    def __repr__(self) -> str:
        text = str(self.sx)
        return f"Symbol({text if len(text) < 60 else text[:57] + '...'})"


def record(name: str, code: int, operands: int) -> None:
    """Let NumPy's function of a name, of one operand or two, build an operation of CasADi on symbols from now on."""
    setattr(Symbol, name, _unary(code) if operands == 1 else _binary(code))


def _dispatch(
    name: str, numeric: Callable[..., Elements], symbolic: Callable[..., ca.SX], text: str
) -> Callable[..., Any]:
    def operation(*elements: Any) -> Any:  # numbers, or elements of one kind
        kinds: set[type[Any]] = {
            type(e) for e in elements if not isinstance(e, (float, int, bool, np.generic))
        }
        if not kinds:
            return numeric(*elements)[()]
        if kinds == {Symbol}:
            return Symbol(symbolic(*(e.sx if isinstance(e, Symbol) else ca.SX(float(e)) for e in elements)))
        offender = next(kind for kind in kinds if kind is not Symbol)
        if method := getattr(offender, f"piecewise_{name}", None):
            return method(*elements)
        raise InvalidInput(
            f"The function {name} is not smooth, so it is not defined on {offender.__name__} elements.",
            f"expected numbers or symbols, got {offender.__name__}",
            "a smooth model for the synthesis (tanh instead of sign); piecewise ones in the true plant only",
        )

    def function(*arguments: Any) -> Any:  # arrays, or single elements
        numbers = all(np.asarray(a).dtype != object for a in arguments)
        return (numeric if numbers else np.frompyfunc(operation, len(arguments), 1))(*arguments)

    function.__name__, function.__doc__ = name, text
    return function


def _chosen(condition: ca.SX, first: ca.SX, other: ca.SX) -> ca.SX:
    return ca.if_else(condition, first, other)


where = _dispatch(
    "where",
    np.where,
    _chosen,
    """``a`` where the condition holds, else ``b``; both branches are evaluated.

    A condition on symbols compares elements (``x[0] > 0``), or arrays by ``np.greater(x, y, dtype=object)``:
    the operators of NumPy's arrays want yes or no.
    """,
)


def _is_simple(x: ca.SX) -> bool:
    """Whether products with it are not rounded. CasADi moves other factors into a choice between a number and a plain
    zero, which would change how they are rounded; it does not see that flag (1 − flag) is a zero too."""
    return x.is_constant() and float(x) in (0.0, 1.0, -1.0)


def _masked_numbers(flag: ArrayLike, x: ArrayLike) -> Elements:
    return np.where(np.asarray(flag) > 0.5, x, np.multiply(flag, 1.0 - np.asarray(flag)))


def _masked(flag: ca.SX, x: ca.SX) -> ca.SX:
    return ca.if_else(flag > 0.5, x, 0.0 if _is_simple(x) else flag * (1.0 - flag))


masked = _dispatch(
    "masked",
    _masked_numbers,
    _masked,
    "``x`` where the flag is 1, and zero where it is 0, also for an ``x`` that is not finite.",
)


def _larger(x: ca.SX, y: ca.SX) -> ca.SX:
    """As NumPy has it: where neither comparison holds, one of them is NaN. fmax of C would drop that one."""
    return ca.if_else(x > y, x, ca.if_else(x <= y, y, x + y))


def _smaller(x: ca.SX, y: ca.SX) -> ca.SX:
    return ca.if_else(x < y, x, ca.if_else(x >= y, y, x + y))


def _clipped(x: ca.SX, low: ca.SX, high: ca.SX) -> ca.SX:
    if low.is_constant() and high.is_constant() and float(low) <= float(high):
        return ca.if_else(x < low, low, ca.if_else(x > high, high, x))
    return _smaller(_larger(x, low), high)


maximum = _dispatch("maximum", np.maximum, _larger, "The larger of two elements; NaN where one is NaN.")
minimum = _dispatch("minimum", np.minimum, _smaller, "The smaller of two elements; NaN where one is NaN.")
sign = _dispatch("sign", np.sign, ca.sign, "−1, 0 or 1.")
absolute = _dispatch("absolute", np.abs, ca.fabs, "The absolute value.")
clip = _dispatch(
    "clip",
    np.clip,
    _clipped,
    "``x`` limited to [low, high]; `high` where that is below `low`, and NaN where one of the three is NaN.",
)


#: A pivot this small, times n, relative to what it is made of is zero: the matrix is singular to rounding.
PIVOT_TOLERANCE = 1e-14


def _empty_like(*arrays: Elements) -> Elements:
    dtype = object if any(np.asarray(a).dtype == object for a in arrays) else float
    return np.zeros(np.shape(arrays[0]), dtype=dtype)


def gram(columns: np.ndarray, weights: Elements, other: np.ndarray | None = None) -> np.ndarray:
    """Σ wᵢ aᵢ bᵢᵀ over columns; exactly symmetric when `other` is not given.

    `columns`, `other`: (n, s), (m, s), columns aᵢ and bᵢ (bᵢ = aᵢ by default). `weights`: (s,).
    """
    weighted = columns * weights
    if other is not None:
        return weighted @ other.T
    n = len(columns)
    result = np.zeros((n, n), dtype=weighted.dtype)
    for i in range(n):
        for j in range(i + 1):
            result[i, j] = result[j, i] = weighted[i] @ columns[j]
    return result


def cholesky(matrix: np.ndarray, tolerance: float = PIVOT_TOLERANCE) -> np.ndarray:
    """Lower L with L Lᵀ = matrix, for a positive semidefinite matrix (n, n).

    A pivot that is zero to rounding gives a zero column, so exactly known states (P = 0) are allowed; a
    negative one gives NaN.

    A pivot is what elimination leaves of a_jj: vᵀ A v with v = (−w, 1), w = A_j⁻¹ a_j. Rounding moves it by some units
    of the last place of Σᵢ vᵢ² aᵢᵢ, which may be many times a_jj where the entries before it are nearly singular. That
    sum is carried along: it grows by (l_ij / l_jj)² of its value at j with each column j. A pivot below zero is
    compared with it, one above zero with a_jj. Both times `tolerance` n of that is zero.
    """
    n = len(matrix)
    factor = _empty_like(matrix)
    moved = [abs(matrix[j, j]) for j in range(n)]
    for j in range(n):
        pivot = matrix[j, j] - factor[j, :j] @ factor[j, :j]
        small = pivot <= abs(matrix[j, j]) * (tolerance * n)
        singular = small & (pivot >= moved[j] * (-tolerance * n))
        with np.errstate(divide="ignore", invalid="ignore"):
            root = np.sqrt(pivot)
            inverse = where(singular, 0.0, 1.0 / root)
        factor[j, j] = where(singular, 0.0, root)
        for i in range(j + 1, n):
            factor[i, j] = (matrix[i, j] - factor[i, :j] @ factor[j, :j]) * inverse
            ratio = factor[i, j] * inverse
            moved[i] = moved[i] + ratio * ratio * moved[j]
    return factor


#: A column whose squares add up to less turns no row, and is zero below the diagonal: the reciprocal of such a number
#: need not be finite.
SMALLEST = 1e-290


#: 2²⁷ + 1: times a float, half of its bits.
SPLIT = 134217729.0


def householder(rows: np.ndarray, count: int) -> np.ndarray:
    """Q T for an orthogonal Q that makes the first `count` columns of T (m, k) zero below the diagonal.

    The rows that result have the same TᵀT. Row c of T is turned towards the rows t below it, with t_i their numbers in
    column c, until these are zero:

        r = (T_c, Σ tᵢ Tᵢ) (t_c, 1) / N,   Tᵢ − tᵢ y,   y = (Σ tᵢ Tᵢ / (N + t_c) + T_c) / N,   N² = t_c² + Σ tᵢ²,

    a reflection [golub2013] and a change of sign, so that rows that are nearly a triangle change little. First row c
    and that with the largest number in column c change places, if that is more than twice the number of row c:
    rounding then changes each row by parts of that row, however small [powell1969].
    """
    table = np.array(rows)
    wide = table.dtype if table.dtype == object else np.longdouble  # for sums of products
    for c in range(count):
        chosen = _largest(table[c:, c])
        pivot = where(chosen[:, None], table[c:], 0.0).sum(axis=0)
        table[c:] = where(chosen[:, None], table[c], table[c:])
        table[c] = pivot
        diagonal, t = table[c, c], table[c + 1 :, c].copy()
        square = t @ t
        whole = diagonal * diagonal + square
        empty = whole <= SMALLEST
        norm = np.sqrt(whole) * where(diagonal < 0.0, -1.0, 1.0)
        with np.errstate(all="ignore"):
            zero = (
                whole * whole
            )  # where the column is empty; CasADi would move a plain 0 into every product below
            part, inverse = (where(empty, zero, 1.0 / number) for number in (norm + diagonal, norm))
        first, others = table[c, c + 1 :].copy(), table[c + 1 :, c + 1 :]
        total = (t.astype(wide) @ others.astype(wide)).astype(table.dtype)
        table[c, c + 1 :] = first + (total - square * part * first) * inverse
        table[c + 1 :, c + 1 :] = others - np.outer(t, (total * part + first) * inverse)
        table[c, c] = where(empty, diagonal, norm)
        table[c + 1 :, c] = 0.0
    return table


def _largest(column: np.ndarray) -> np.ndarray:
    """Flags, of which one is set: that of the first number of the largest magnitude; the first counts twice. A number
    that is zero whatever comes is never larger than another."""
    best, place = 2.0 * absolute(column[0]), 0
    tried = [k for k in range(1, len(column)) if not _is_always_zero(column[k])]
    for k in tried:
        size = absolute(column[k])
        larger = size > best
        best, place = where(larger, size, best), where(larger, k, place)
    return np.array([place == k if k in (0, *tried) else False for k in range(len(column))])


def _is_always_zero(number: object) -> bool:
    return number.sx.is_zero() if isinstance(number, Symbol) else isinstance(number, Real) and number == 0


def residual(rows: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """e − C x − v (s, p) of rows (e, x, v), in twice the digits of floats, rounded once.

    Sums and products of floats are carried with their rounding errors, which are floats [dekker1971]. Symbols are
    summed as they are: they simplify what finds those errors.

    Parameters
    ----------
    rows : (s, p + n + p) array
    slope : (p, n) array
    """
    p, n = np.shape(slope)
    e, x, v = rows[:, :p], rows[:, p : p + n], rows[:, p + n :]
    if _empty_like(rows, slope).dtype == object:
        return e - x @ np.transpose(slope) - v
    with np.errstate(all="ignore"):
        high, low = _two_sum(e, -v)
        for j in range(n):
            product, error = _two_product(np.outer(x[:, j], np.ones(p)), slope[:, j])
            high, lost = _two_sum(high, -product)
            low = (low - error) + lost
        return np.where(np.isfinite(low), high + low, high)


def _two_sum(a: Elements, b: Elements) -> tuple[Elements, Elements]:
    """a + b, rounded, and what rounding took."""
    total = a + b
    part = total - a
    return total, (a - (total - part)) + (b - part)


def _two_product(a: Elements, b: Elements) -> tuple[Elements, Elements]:
    """a b likewise: halves of 26 bits have exact products."""
    product, ((a1, a2), (b1, b2)) = a * b, (_halves(x) for x in (a, b))
    return product, ((a1 * b1 - product) + a1 * b2 + a2 * b1) + a2 * b2


def _halves(a: Elements) -> tuple[Elements, Elements]:
    shifted = SPLIT * a
    first = shifted - (shifted - a)
    return first, a - first


def solve_lower(factor: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve L X = B for lower-triangular L (n, n) and B (n,) or (n, k)."""
    solution = _empty_like(right, factor)
    for i in range(len(factor)):
        solution[i] = (right[i] - factor[i, :i] @ solution[:i]) / factor[i, i]
    return solution


def solve_lower_transposed(factor: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve Lᵀ X = B for lower-triangular L (n, n) and B (n,) or (n, k)."""
    solution = _empty_like(right, factor)
    for i in reversed(range(len(factor))):
        solution[i] = (right[i] - factor[i + 1 :, i] @ solution[i + 1 :]) / factor[i, i]
    return solution


def solve_definite(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """x (n,) of M x = b for a positive definite M (n, n), by M = L D Lᵀ: without roots, and without a test."""
    rows, x = [list(row) for row in matrix], list(right)
    n = len(x)
    inverse = [1.0 / rows[0][0]]
    for k in range(n):
        for i in range(k + 1, n):
            factor = rows[i][k] * inverse[k]
            for j in range(k + 1, i + 1):
                rows[i][j] = rows[i][j] - factor * rows[j][k]
            x[i] = x[i] - factor * x[k]
        if k + 1 < n:
            inverse.append(1.0 / rows[k + 1][k + 1])
    for k in reversed(range(n)):
        for i in range(k + 1, n):
            x[k] = x[k] - rows[i][k] * x[i]
        x[k] = x[k] * inverse[k]
    return np.array(x)
