"""Algebra of homogeneous polynomials: monomials at points, gradients, products; and laws as plain data.

A polynomial is a mapping degree → *monomial coefficients* in the order of `basis.indices`, along the last axis. Only
degrees that occur are keys: a missing degree is exactly zero, which is how parity is used.

Large products run on all processors, with the same bits from any number of them: a BLAS that shares one product among
threads adds its terms in another order for another number of them, so products are cut into tiles of a fixed size, each
below where BLAS starts threads, and the tiles are shared.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.polynomial import basis
from flexhinf.processors import thread_count
from flexhinf.validation import read_only

_TILE_PRODUCTS = 200_000  # multiplications of a real tile: OpenBLAS starts threads from 262,144 on
_COMPLEX = 4  # and for complex numbers from a fourth of that on
_TILE_ROWS = 64
_LARGE = 20_000_000  # multiplications from which the tiles are worth a second thread


def tile_products(kind: np.dtype) -> int:
    """Multiplications that a product of numbers of this kind may take without BLAS sharing it among threads."""
    return _TILE_PRODUCTS // _COMPLEX if kind.kind == "c" else _TILE_PRODUCTS


def matrix_product(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """`left` (rows, inner) @ `right` (inner, columns), the same bits for any number of threads."""
    (rows, inner), columns = left.shape, right.shape[1]
    kind = np.result_type(left, right)
    most = tile_products(kind)
    if rows * inner * columns <= most:
        return left @ right
    wide = min(columns, max(1, most // (inner * min(rows, _TILE_ROWS))))
    high = max(1, most // (inner * wide))
    result = np.empty((rows, columns), kind)

    def multiply(top: int, begin: int) -> None:
        np.matmul(
            left[top : top + high],
            right[:, begin : begin + wide],
            out=result[top : top + high, begin : begin + wide],
        )

    run_all(
        multiply,
        ((top, begin) for top in range(0, rows, high) for begin in range(0, columns, wide)),
        large=rows * inner * columns > _LARGE,
    )
    return result


def run_all(task: Callable[..., None], arguments: Iterable[tuple[int, ...]], large: bool) -> None:
    """Call `task` on each tuple of arguments, in parallel if `large`; the calls must be independent.

    NumPy releases the interpreter while it gathers and multiplies, so plain threads are enough. Each takes what is next
    of a common list.
    """
    threads, waiting = thread_count() if large else 1, iter(list(arguments))

    def work(_: int = 0) -> None:
        for argument in waiting:
            task(*argument)

    if threads == 1:
        work()
        return
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(work, range(threads)))


_CACHED_TABLE = 4_000_000  # entries of a merge table that is worth keeping
_FEW = 64  # points up to which monomials are gathered from a table of factors
_ROWS = 64  # monomials of one factor whose products are formed at a time when no table is kept


def monomials(x: np.ndarray, degrees: Iterable[int]) -> dict[int, np.ndarray]:
    """All monomials of the given degrees at the points `x` (N, n): degree → (N, count(n, degree)).

    Each is one variable times a monomial of one degree less, so elements may be of any type that multiplies.
    """
    wanted, (points, n) = set(degrees), x.shape
    current = np.ones((points, 1), x.dtype)
    by_degree = {0: current} if 0 in wanted else {}
    for k in range(1, max(wanted, default=0) + 1):
        if points <= _FEW:  # one gather costs less than a product for each variable
            variable, lower = basis.factors(n, k)
            current = x[:, variable] * current[:, lower]
        else:
            (start, first), lower = (basis.offsets(n, k - 1), basis.offsets(n, k)), current
            current = np.empty((points, basis.count(n, k)), x.dtype)
            for j in range(n):
                np.multiply(x[:, j : j + 1], lower[:, start[j] :], out=current[:, first[j] : first[j + 1]])
        if k in wanted:
            by_degree[k] = current
    return by_degree


def evaluate(polynomial: Mapping[int, np.ndarray], x: np.ndarray) -> np.ndarray:
    """Values (N, …) of a polynomial, not empty, degree → (…, count(n, degree)), at the points `x` (N, n)."""
    shape, powers = next(iter(polynomial.values())).shape[:-1], monomials(x, polynomial)
    total = np.zeros((len(x), int(np.prod(shape))))
    for k, part in polynomial.items():
        total += powers[k] @ part.reshape(-1, part.shape[-1]).T
    return total.reshape(len(x), *shape)


def gradient(entries: np.ndarray, n: int, k: int) -> np.ndarray:
    """Monomial coefficients (count(n, k−1), n) of the partial derivatives of a homogeneous polynomial of degree k.

    ∂ᵢ of a symmetric tensor polynomial of degree k is k times the tensor with one index fixed to i. The `entries`
    (count(n, k),) are *tensor entries* (monomial coefficient divided by multiplicity).
    """
    return entries[basis.insertion(n, k)] * (k * basis.multiplicity(n, k - 1))[:, None]


def product(left: np.ndarray, right: np.ndarray, n: int, a: int, b: int) -> np.ndarray:
    """Sum of products Σ_c left_c(x) right_c(x) of homogeneous polynomials of degrees `a` and `b`: (count(n, a+b),).

    `left` is (count(n, a), c), `right` (c, count(n, b)). Every pair of monomials is one entry of a matrix product; the
    entries are then added up by the monomial they belong to. Columns of `right` that are zero are not visited.
    """
    rows, size = left.shape[0], basis.count(n, a + b)
    if rows * right.shape[1] <= _CACHED_TABLE:
        return np.bincount(basis.merge(n, a, b).ravel(), matrix_product(left, right).ravel(), size)
    # Without a table of all pairs: one monomial of `right` at a time, grouped by its last index.
    total, active = np.zeros(size), np.any(right, axis=0)
    prefixed, transposed = np.ascontiguousarray(basis.merge(n, a, b - 1).T), np.ascontiguousarray(left.T)
    last = basis.indices(n, b - 1)[:, -1] if b > 1 else np.zeros(1, int)
    for j in range(n):
        prefixes = np.flatnonzero(last <= j)
        columns = basis.insertion(n, b)[prefixes, j]
        prefixes, columns = prefixes[active[columns]], columns[active[columns]]
        appended = basis.insertion_columns(n, a + b)[j]
        for begin in range(0, len(columns), _ROWS):
            products = matrix_product(right[:, columns[begin : begin + _ROWS]].T, transposed)
            for prefix, row in zip(prefixes[begin : begin + _ROWS], products, strict=True):
                np.add.at(total, appended[prefixed[prefix]], row)
    return total


def add_part(polynomial: dict[int, np.ndarray], degree: int, part: np.ndarray) -> None:
    """Add a homogeneous part to a polynomial in place."""
    polynomial[degree] = polynomial[degree] + part if degree in polynomial else part


#: Parts of a sum of objects, as many as the latency of an addition asks for.
PARTS = 8


@dataclass(frozen=True, eq=False)
class PolynomialLaw:
    """u_i(x) = Σ_a coefficients[i, a] x^exponents[a], x (n,) and u (m,) deviations from the operating point.

    The exponents are all monomials of the degrees that occur, ascending, degree by degree; coefficients (m, Nmon).
    """

    n: int
    degrees: tuple[int, ...]
    coefficients: np.ndarray

    def __post_init__(self) -> None:
        self.__setstate__({"coefficients": self.coefficients})
        expected = sum(basis.count(self.n, k) for k in self.degrees)
        if self.coefficients.ndim != 2 or self.coefficients.shape[1] != expected:
            raise InvalidInput(
                "The coefficients of the law do not fit its monomials.",
                f"expected shape (inputs, {expected}), got {self.coefficients.shape}",
                f"one column per monomial of degrees {self.degrees} in {self.n} states",
            )

    def __setstate__(self, state: dict[str, object]) -> None:
        vars(self).update(read_only(state))

    @property
    def exponents(self) -> np.ndarray:
        """Exponent vectors, shape (Nmon, n)."""
        return np.concatenate([basis.exponents(self.n, k) for k in self.degrees])

    def evaluate(self, x: np.ndarray, coefficients: np.ndarray | None = None) -> np.ndarray:
        """The law (m,) at one state (n,) of floats, or of objects that multiply and add (symbols, intervals).

        Every monomial is one variable times a monomial of one degree less, shared by all inputs. Other `coefficients`
        (m, Nmon) than the law's own make a new law with the same monomials, which needs no recompilation.
        """
        coefficients = self.coefficients if coefficients is None else np.asarray(coefficients)
        powers = monomials(np.asarray(x)[None, :], self.degrees)
        row = np.concatenate([powers[k][0] for k in self.degrees])
        if row.dtype != object or not row.size:
            return coefficients @ row
        # Objects are added in eight parts, and those in pairs: an eighth of the latency of one sum after the other, and
        # the law lies between measurement and input.
        sums = [coefficients[:, k::PARTS] @ row[k::PARTS] for k in range(min(PARTS, row.size))]
        while len(sums) > 1:
            sums = [
                *(a + b for a, b in zip(sums[::2], sums[1::2], strict=False)),
                *sums[len(sums) - len(sums) % 2 :],
            ]
        return sums[0]
