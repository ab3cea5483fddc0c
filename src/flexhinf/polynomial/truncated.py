"""Algebra of truncated multivariate polynomials: sums, products and compositions up to a total degree.

A polynomial of a `Space` (n variables, degree D) is a `Support`, the ordered numbers of its monomials, and a
vector with one value per monomial. Monomials are numbered degree after degree, each degree in the order of
`basis.indices`, so the numbers of a full support are the places of the dense coefficient vector.

Model code multiplies polynomials that depend on few of the variables, or only linearly on some of them,
and it does so with the same supports each time it runs. Supports are therefore interned, and what depends
on them alone (which pairs of monomials meet, and where their product goes) is worked out once and kept: a
product is then two gathers and one summation by place.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from math import comb
from typing import Any
from weakref import WeakValueDictionary

import numpy as np

from flexhinf.polynomial import basis

#: Pairs of monomials that a space may remember (24 bytes each) before it forgets what it worked out.
REMEMBERED_PAIRS = 12_000_000

_SPACES: WeakValueDictionary[tuple[int, int], Space] = WeakValueDictionary()


def size(n: int, degree: int) -> int:
    """Number of monomials of degree 0 … `degree`, C(n+degree, degree); 0 for a negative degree."""
    return comb(n + degree, degree) if degree >= 0 else 0


def degree_slice(n: int, k: int) -> slice:
    """Where the monomials of degree exactly `k` are in a dense coefficient vector."""
    return slice(size(n, k - 1), size(n, k))


@lru_cache(16)  # what the last ones have worked out is kept; older ones live as long as their polynomials do
def space(n: int, degree: int) -> Space:
    """The polynomials in `n` variables through total degree `degree`; the same object each time."""
    found = _SPACES.get((n, degree))
    if found is None:
        found = _SPACES[n, degree] = Space(n, degree)
    return found


class Space:
    """Polynomials in `n` variables, truncated after total degree `degree`. Made by `space`, which interns it.

    `size` is the length of a dense coefficient vector; `zero` and `constant` are the supports without any monomial, and
    with the constant one only.
    """

    def __init__(self, n: int, degree: int) -> None:
        self.n = n
        self.degree = degree
        self.edges = np.array([size(n, k - 1) for k in range(degree + 2)])
        self.size = int(self.edges[-1])
        self.remembered = 0
        self._supports: dict[bytes, Support] = {}
        self.zero = self.support(np.zeros(0, np.intp))
        self.constant = self.support(np.zeros(1, np.intp))

    def support(self, monomials: np.ndarray) -> Support:
        """The interned support of ascending monomial numbers, shape (N,)."""
        key = monomials.astype(np.int32).tobytes()
        found = self._supports.get(key)
        if found is None:
            found = self._supports.setdefault(key, Support(self, monomials))
        return found

    def remember(self, pairs: int) -> None:
        """Count stored pairs; when they are too many, forget what every support has worked out."""
        self.remembered += pairs
        if self.remembered > REMEMBERED_PAIRS:
            self.remembered = pairs
            for support in self._supports.values():
                support.sums.clear()
                support.products.clear()
                support.steps = None


class Support:
    """Which monomials of a space a polynomial has. Made by `Space.support`, so equal supports are one object.

    `monomials` are ascending numbers (N,); those of degree k are at `monomials[edges[k]:edges[k + 1]]`.
    """

    __slots__ = ("edges", "has_constant", "monomials", "products", "space", "steps", "sums")

    def __init__(self, space: Space, monomials: np.ndarray) -> None:
        self.space = space
        self.monomials = monomials
        self.edges: list[int] = np.searchsorted(monomials, space.edges).tolist()
        self.has_constant = self.edges[1] > 0
        self.sums: dict[Support, tuple[Support, Any, Any]] = {}
        self.products: dict[Support, _Product] = {}
        self.steps: list[_Product] | None = None

    def ranks(self, k: int) -> np.ndarray:
        """Ranks, in `basis.indices(n, k)`, of the monomials of degree `k`."""
        return self.monomials[self.edges[k] : self.edges[k + 1]] - self.space.edges[k]

    def sum(self, other: Support) -> tuple[Support, Any, Any]:
        """The union with `other`, and the places of each of the two in it; None for one that is the union itself."""
        found = self.sums.get(other)
        if found is None:
            union = np.union1d(self.monomials, other.monomials)
            support = self.space.support(union)
            left = None if self is support else np.searchsorted(union, self.monomials)
            right = None if other is support else np.searchsorted(union, other.monomials)
            found = self.sums[other] = support, left, right
            self.space.remember(len(union))
        return found

    def product(self, other: Support) -> _Product:
        """The products with `other` through the degree of the space."""
        found = self.products.get(other)
        if found is None:
            found = self.products[other] = _Product(self, other, self.space.degree)
            self.space.remember(found.pairs)
        return found

    def compositions(self) -> list[_Product]:
        """The products of Horner's rule for a series in a polynomial of this support (without constant)."""
        if self.steps is not None:
            return self.steps
        degree = self.space.degree
        lowest = next(k for k in range(degree + 1) if self.edges[k + 1] > 0)
        inner, steps = self.space.constant, []
        for k in reversed(range(degree // lowest)):
            step = _Product(self, inner, degree - k * lowest, constant=True)
            steps.append(step)
            inner = step.support
        self.steps = steps
        self.space.remember(sum(step.pairs for step in steps))
        return steps


class _Product:
    """Which pairs of monomials of two supports meet within a degree, and the place of each product.

    With `constant` the result has the constant monomial in any case.
    """

    __slots__ = ("left", "pairs", "places", "right", "size", "support")

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
        monomials = np.flatnonzero(present)
        self.support = a.space.support(monomials)
        self.size = len(monomials)
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
    if a is b:
        return a, x + y
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
