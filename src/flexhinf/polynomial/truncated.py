"""Algebra of truncated multivariate polynomials: sums, products and compositions up to a total degree.

A polynomial of a `Space` (n variables, degree D) is a `Support`, the ordered numbers of its monomials, and a
vector with one value per monomial. Monomials are numbered degree after degree, each degree in the order of
`basis.indices`, so the numbers of a full support are the places of the dense coefficient vector.

Model code multiplies polynomials that depend on few of the variables, or only linearly on some of them,
and it does so with the same supports each time it runs. Supports are therefore interned, and what depends
on them alone (which pairs of monomials meet, and where their product goes) is worked out once and kept: a
product is then two gathers and one summation by place.

Taylor coefficients of the elementary functions of one variable, about a point, to any degree.

Each function returns the coefficients c₀ … c_degree of φ(x₀ + t) = Σ cₖ tᵏ, shape (degree + 1,), by
closed form or by the recurrence of the function's differential equation. Where φ is not analytic, or not
real, it raises `InvalidInput`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from weakref import WeakValueDictionary

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.polynomial import basis

#: Pairs of monomials that a space may remember (24 bytes each) before it forgets what it worked out.
CACHED_PAIRS = 12_000_000

_SPACES: WeakValueDictionary[tuple[int, int], Space] = WeakValueDictionary()


def size(n: int, degree: int) -> int:
    """Number of monomials of degree 0 … `degree`, C(n+degree, degree); 0 for a negative degree."""
    return math.comb(n + degree, degree) if degree >= 0 else 0


def degree_slice(n: int, k: int) -> slice:
    """Where the monomials of degree exactly `k` are in a dense coefficient vector."""
    return slice(size(n, k - 1), size(n, k))


@lru_cache(16)  # what the last ones have worked out is kept; older ones live as long as their polynomials do
def space(n: int, degree: int) -> Space:
    """The polynomials in `n` variables through total degree `degree`; the same object each time."""
    return _SPACES.get((n, degree)) or _SPACES.setdefault((n, degree), Space(n, degree))


class Space:
    """Polynomials in `n` variables, truncated after total degree `degree`. Made by `space`, which interns it.

    `size` is the length of a dense coefficient vector; `zero` and `constant` are the supports without any monomial, and
    with the constant one only.
    """

    def __init__(self, n: int, degree: int) -> None:
        self.n, self.degree = n, degree
        self.edges = np.array([size(n, k - 1) for k in range(degree + 2)])
        self.size = int(self.edges[-1])
        self.cached, self._supports = 0, dict[bytes, Support]()
        self.zero, self.constant = (self.support(np.zeros(k, np.intp)) for k in (0, 1))

    def support(self, monomials: np.ndarray) -> Support:
        """The interned support of ascending monomial numbers, shape (N,)."""
        key = monomials.astype(np.int32).tobytes()
        return self._supports.get(key) or self._supports.setdefault(key, Support(self, monomials))

    def count_cached(self, pairs: int) -> None:
        """Count stored pairs; when they are too many, forget what every support has worked out."""
        self.cached += pairs
        if self.cached > CACHED_PAIRS:
            self.cached = pairs
            for support in self._supports.values():
                support.sums.clear()
                support.products.clear()
                support.steps = None


class Support:
    """Which monomials of a space a polynomial has. Made by `Space.support`, so equal supports are one object.

    `monomials` are ascending numbers (N,); those of degree k are at `monomials[edges[k]:edges[k + 1]]`.
    """

    def __init__(self, space: Space, monomials: np.ndarray) -> None:
        self.space, self.monomials = space, monomials
        self.edges: list[int] = np.searchsorted(monomials, space.edges).tolist()
        self.has_constant = self.edges[1] > 0
        self.sums, self.products = (
            dict[Support, tuple[Support, np.ndarray | None, np.ndarray | None]](),
            dict[Support, _Product](),
        )
        self.steps: list[_Product] | None = None

    def ranks(self, k: int) -> np.ndarray:
        """Ranks, in `basis.indices(n, k)`, of the monomials of degree `k`."""
        return self.monomials[self.edges[k] : self.edges[k + 1]] - self.space.edges[k]

    def sum(self, other: Support) -> tuple[Support, np.ndarray | None, np.ndarray | None]:
        """The union with `other`, and the places of each of the two in it; None for one that is the union itself."""
        result = self.sums.get(other)
        if result is None:
            union = np.union1d(self.monomials, other.monomials)
            support = self.space.support(union)
            left = None if self is support else np.searchsorted(union, self.monomials)
            right = None if other is support else np.searchsorted(union, other.monomials)
            result = self.sums[other] = support, left, right
            self.space.count_cached(len(union))
        return result

    def product(self, other: Support) -> _Product:
        """The products with `other` through the degree of the space."""
        table = self.products.get(other)
        if table is None:
            table = self.products[other] = _Product(self, other, self.space.degree)
            self.space.count_cached(table.pairs)
        return table

    def compositions(self) -> list[_Product]:
        """The products of Horner's rule for a series in a polynomial of this support (without constant)."""
        if self.steps is not None:
            return self.steps
        inner, steps, degree = self.space.constant, list[_Product](), self.space.degree
        lowest = next(k for k in range(degree + 1) if self.edges[k + 1] > 0)
        for k in reversed(range(degree // lowest)):
            steps.append(_Product(self, inner, degree - k * lowest, constant=True))
            inner = steps[-1].support
        self.steps = steps
        self.space.count_cached(sum(step.pairs for step in steps))  # which may forget them
        return steps


class _Product:
    """Which pairs of monomials of two supports meet within a degree, and the place of each product.

    With `constant` the result has the constant monomial in any case.
    """

    def __init__(self, a: Support, b: Support, limit: int, constant: bool = False) -> None:
        blocks = [np.zeros((3, 0), np.intp)]
        for i in range(limit + 1):
            for j in range(limit + 1 - i):
                rows, columns = slice(a.edges[i], a.edges[i + 1]), slice(b.edges[j], b.edges[j + 1])
                if rows.start < rows.stop and columns.start < columns.stop:
                    places = np.mgrid[rows, columns]
                    blocks.append(np.vstack([places.reshape(2, -1), _numbers(a, i, b, j).reshape(1, -1)]))
        self.left, self.right, target = np.hstack(blocks).astype(np.intp)
        self.pairs = len(target)
        present = np.zeros(a.space.size, bool)
        present[target] = True
        present[0] |= constant
        self.support = a.space.support(np.flatnonzero(present))
        self.size = len(self.support.monomials)
        self.places = (np.cumsum(present) - 1)[target]

    def __call__(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.bincount(self.places, a.take(self.left) * b.take(self.right), self.size)


def _numbers(a: Support, i: int, b: Support, j: int) -> np.ndarray:
    """Numbers of the products of the monomials of degree i of `a` (rows) and of degree j of `b` (columns)."""
    n = a.space.n
    if i > j:
        return _numbers(b, j, a, i).T
    tuples = basis.indices(n, i)[a.ranks(i)]
    merged = np.broadcast_to(b.ranks(j), (len(tuples), b.edges[j + 1] - b.edges[j]))
    for s in range(i):
        merged = basis.insertion(n, j + s + 1)[merged, tuples[:, s, None]]
    return merged.astype(np.intp) + a.space.edges[i + j]


def add(a: Support, x: np.ndarray, b: Support, y: np.ndarray) -> tuple[Support, np.ndarray]:
    """Sum of two polynomials of one space."""
    support, left, right = a.sum(b)
    if left is None and right is None:
        return support, x + y
    result = x.copy() if left is None else np.zeros(len(support.monomials))
    if left is not None:
        result[left] = x
    result[slice(None) if right is None else right] += y
    return support, result


def multiply(a: Support, x: np.ndarray, b: Support, y: np.ndarray) -> tuple[Support, np.ndarray]:
    """Product of two polynomials of one space, truncated after its degree."""
    plan = a.product(b)
    return plan.support, plan(x, y)


def compose(series: Sequence[float], a: Support, x: np.ndarray) -> tuple[Support, np.ndarray]:
    """Σ seriesₖ pᵏ for a polynomial p = (a, x) without constant term, truncated, by Horner's rule.

    The inner steps of the rule are multiplied by p again, once for each step that follows, so they are needed to lower
    degrees only: the whole rule costs little more than its last product. The series has degree + 1 Taylor coefficients.
    Monomials whose coefficient is exactly zero are dropped (half of them, for a sine about 0).
    """
    if not len(a.monomials) or not a.space.degree:
        support, result = a.space.constant, np.array([series[0]], dtype=float)
    else:
        steps = a.compositions()
        support, result = steps[-1].support, np.array([series[len(steps)]], dtype=float)
        for k, step in zip(reversed(range(len(steps))), steps, strict=True):
            result = step(x, result)
            result[0] = series[k]
    if not result.all():
        kept = np.flatnonzero(result)
        return a.space.support(support.monomials[kept]), result[kept]
    return support, result


SeriesCoefficients = Callable[[float, int], np.ndarray]

#: Where a function is real and analytic, if not everywhere: between two numbers.
DOMAINS = {
    "arcsin": (-1.0, 1.0, "inside (-1, 1)"),
    "arccos": (-1.0, 1.0, "inside (-1, 1)"),
    "arctanh": (-1.0, 1.0, "inside (-1, 1)"),
    "arccosh": (1.0, math.inf, "> 1"),
    "log": (0.0, math.inf, "> 0"),
    "log1p": (-1.0, math.inf, "> -1"),
    "log10": (0.0, math.inf, "> 0"),
    "sqrt": (0.0, math.inf, "> 0"),
}

#: Functions whose derivatives repeat: even ones are the first function, odd ones the second, with these signs.
CYCLES = {
    "sin": (math.sin, math.cos, (1, 1, -1, -1)),
    "cos": (math.cos, math.sin, (1, -1, -1, 1)),
    "sinh": (math.sinh, math.cosh, (1, 1, 1, 1)),
    "cosh": (math.cosh, math.sinh, (1, 1, 1, 1)),
    "exp": (math.exp, math.exp, (1, 1, 1, 1)),
    "expm1": (math.exp, math.exp, (1, 1, 1, 1)),
}

#: Inverse functions, φ' = ± qᵖ with a quadratic q = a + b x²: their value, a, b, p and the sign.
INVERSES = {
    "arcsin": (math.asin, 1, -1, -0.5, 1),
    "arccos": (math.acos, 1, -1, -0.5, -1),
    "arctan": (math.atan, 1, 1, -1.0, 1),
    "arcsinh": (math.asinh, 1, 1, -0.5, 1),
    "arccosh": (math.acosh, -1, 1, -0.5, 1),
    "arctanh": (math.atanh, 1, -1, -1.0, 1),
}


def _require(condition: bool, name: str, point: float, domain: str) -> None:
    if not condition:
        raise InvalidInput(
            f"The function {name} has no real Taylor series at the point of the expansion.",
            f"expected an argument {domain} there, got {point:.17g}",
            "another point of expansion, or a form of the model that is smooth at this one",
        )


def _integrated(first: float, derivative: np.ndarray, degree: int) -> np.ndarray:
    return np.append(first, derivative[:degree] / np.arange(1, degree + 1))


def _power_of_quadratic(q0: float, q1: float, q2: float, exponent: float, degree: int) -> np.ndarray:
    """Coefficients of y = qᵖ for q = q₀ + q₁ t + q₂ t², q₀ > 0.

    From q y' = p q' y: k q₀ yₖ = (p − k + 1) q₁ yₖ₋₁ + (2p − k + 2) q₂ yₖ₋₂.
    """
    y = np.zeros(degree + 1)
    y[0] = q0**exponent
    for k in range(1, degree + 1):
        y[k] = (exponent - k + 1) * q1 * y[k - 1]
        if k > 1:
            y[k] += (2 * exponent - k + 2) * q2 * y[k - 2]
        y[k] /= k * q0
    return y


def _tangent(name: str, x: float, degree: int) -> np.ndarray:
    """tan and tanh, y' = 1 ± y²; the slope of tanh is formed as 1 / cosh², which does not cancel."""
    if name == "tan":
        first, slope, sign = math.tan(x), 1.0 + math.tan(x) ** 2, 1.0
    else:
        slope = (2.0 / (math.exp(x) + math.exp(-x))) ** 2 if abs(x) < 300.0 else 0.0
        first, sign = math.tanh(x), -1.0
    y = np.array([first, slope, *[0.0] * (degree - 1)])[: degree + 1]
    for k in range(1, degree):
        y[k + 1] = sign * (y[: k + 1] @ y[k::-1]) / (k + 1)
    return y


def _series(name: str, x: float, degree: int) -> np.ndarray:
    _require(math.isfinite(x), name, x, "that is finite")
    low, high, domain = DOMAINS.get(name, (-math.inf, math.inf, ""))
    _require(low < x < high, name, x, domain)
    try:
        if name in CYCLES:
            even, odd, signs = CYCLES[name]
            values, powers = (even(x), odd(x)), range(degree + 1)
            result = np.array([signs[k % 4] * values[k % 2] for k in powers]) / np.array(
                [float(math.factorial(k)) for k in powers]
            )
            if name == "expm1":
                result[0] = math.expm1(x)
            return result
        if name in INVERSES:
            value, a, b, exponent, sign = INVERSES[name]
            q0 = 1 + x * x if a == b else (1 - x) * (1 + x) if a > 0 else (x - 1) * (x + 1)
            return _integrated(
                value(x), sign * _power_of_quadratic(q0, 2 * b * x, float(b), exponent, degree), degree
            )
        if name in ("tan", "tanh"):
            return _tangent(name, x, degree)
    except OverflowError:
        _require(False, name, x, "whose result is finite")
    if name == "sqrt":
        return power(x, 0.5, degree)
    if name == "log1p":
        return _integrated(math.log1p(x), power(1.0 + x, -1, degree), degree)
    natural = _integrated(math.log(x), power(x, -1, degree), degree)
    return natural / math.log(10.0) if name == "log10" else natural


def power(x: float, exponent: float, degree: int) -> np.ndarray:
    """x^exponent: any x for a whole exponent ≥ 0, x ≠ 0 for a negative one, x > 0 for a fraction."""
    name, exponent = "1/x" if exponent == -1 else f"x**{exponent:g}", float(exponent)
    _require(math.isfinite(x) and math.isfinite(exponent), name, x, "that is finite, and so the exponent,")
    try:
        whole, top = exponent.is_integer(), int(exponent)
        if whole and top >= 0:
            return np.array(
                [math.comb(top, k) * x ** (top - k) if k <= top else 0.0 for k in range(degree + 1)]
            )
        _require(x != 0.0 if whole else x > 0.0, name, x, "different from zero" if whole else "> 0")
        result = np.empty(degree + 1)
        result[0] = math.sqrt(x) if exponent == 0.5 else x**exponent
        for k in range(1, degree + 1):
            result[k] = result[k - 1] * (exponent - k + 1) / (k * x)
        return result
    except OverflowError:
        _require(False, name, x, "whose result is finite")
        raise


#: The functions of one variable, by NumPy's name.
FUNCTIONS: dict[str, SeriesCoefficients] = {
    name: partial(_series, name)
    for name in (*CYCLES, *INVERSES, "tan", "tanh", "log", "log1p", "log10", "sqrt")
}
