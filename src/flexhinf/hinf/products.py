"""Products of homogeneous polynomials with many monomials, in machine code.

Σ_c left_c(x) right_c(x): every pair of monomials is one sum over c, which is added to the monomial it belongs to. The
sums of some rows (monomials of `left`) and eight columns (of `right`) stay in registers, and are added up at once.

*Threads*. Monomials are shared out by their first index, the smaller one of the first indices of the pair. So a thread
has to itself what it adds to: the rows of its group of first indices with all columns from there on, then all later
rows with the columns of the group. Every sum is made in one order, whatever the threads.
"""

from __future__ import annotations

from functools import cache, lru_cache

import numpy as np

from flexhinf.codegen.loops import DOUBLE, INT, LANES, VECTOR, LoopText, NativeFunction, fields, wide
from flexhinf.polynomial import algebra, basis

LARGE = 300_000  # pairs of monomials from which machine code pays
_KEPT = 6_000_000  # places in a table that is worth keeping
#: Share of the monomials that a group has, unless one first index has more: of products, of derivatives.
_SHARE, _LARGE_SHARE = 0.07, 0.3


def table_memory(n: int, degree: int) -> int:
    """Bytes of the tables of all products to a degree: those that are kept, and the largest one while it is made."""
    sizes: list[int] = []
    for a, b in ((k - b, b) for k in range(3, degree + 1) for b in range(1, k // 2 + 1)):
        pairs = basis.count(n, a) * basis.count(n, b)
        sizes.append(pairs if pairs <= LARGE else basis.count(n, a) * basis.count(n, b - 1))
    kept = sum(size for size in sizes if size <= _KEPT)
    return 4 * min(kept, 64 * _KEPT) + 8 * max(sizes, default=0)  # `basis.merge` keeps 64


def product(left: np.ndarray, right: np.ndarray, n: int, a: int, b: int) -> np.ndarray:
    """Σ_c left_c(x) right_c(x) of degrees `a` and `b` ≥ 1, as `flexhinf.polynomial.algebra.product`."""
    if len(left) * right.shape[1] <= LARGE:
        return algebra.product(left, right, n, a, b)
    active = np.flatnonzero(right.any(axis=0))
    if len(left) < right.shape[1] < 2 * len(active):
        return _added(right.T, left.T, n, b, a, np.arange(len(left)))
    return _added(left, right, n, a, b, active)


def square(rows: np.ndarray, signs: np.ndarray, n: int, a: int) -> np.ndarray:
    """½ Σ_c s_c w_c(x)² for w_c of degree `a`, the columns of `rows`: every pair of monomials once."""
    right = rows.T * signs[:, None]
    if len(rows) ** 2 <= LARGE:
        return algebra.product(rows, 0.5 * right, n, a, a)
    return _added(rows, right, n, a, a, np.arange(len(rows)), symmetric=True)


def derivative(entries: np.ndarray, matrix: np.ndarray, n: int, k: int) -> np.ndarray:
    """Monomial coefficients of V_x A x, for tensor entries of V, homogeneous of degree `k`."""
    weights = k * basis.multiplicity(n, k - 1)
    if len(weights) * n <= LARGE:
        return algebra.product(algebra.gradient(entries, n, k), matrix, n, k - 1, 1)
    return _added(entries, matrix, n, k - 1, 1, np.arange(n), weights)


def _added(
    left: np.ndarray,
    right: np.ndarray,
    n: int,
    a: int,
    b: int,
    active: np.ndarray,
    weights: np.ndarray | None = None,
    symmetric: bool = False,
) -> np.ndarray:
    """The product with the `active` columns; with `weights`, `left` are tensor entries whose gradient is formed."""
    total, size = np.zeros(basis.count(n, a + b)), basis.count(n, a) * basis.count(n, b - 1)
    merged = (basis.merge if size <= _KEPT else basis.merge.__wrapped__)(n, a, b - 1)
    earlier = total if weights is None else np.zeros(len(total))
    cuts = list(_groups(n, a + b, _SHARE if weights is None else _LARGE_SHARE))
    first, bounds = basis.offsets(n, a)[cuts].tolist(), np.searchsorted(active, basis.offsets(n, b)[cuts])
    packed, columns, chunks = _packed(right, active, bounds)
    rows_of = (left, *(stride // left.itemsize for stride in left.strides))
    if weights is not None:
        rows_of = np.ascontiguousarray(left), basis.insertion(n, a + 1), weights
    ends = basis.removal(n, b)[columns, -1], basis.indices(n, b)[columns, -1].astype(np.int32)
    function, height = _compiled(weights is not None)
    tables = (
        *rows_of,
        len(right),
        packed,
        *ends,
        merged,
        merged.shape[1],
        basis.insertion(n, a + b),
        n,
        total,
        earlier,
    )
    known = fields(*tables)

    def group(g: int) -> None:
        own, later, final = (first[g], first[g + 1]), (first[g + 1], first[-1]), chunks[-1]
        if weights is not None:  # what begins in an earlier group has one pair only
            parts = ((*own, 0, final, chunks[g], 1.0),)
        elif symmetric:
            parts = (*own, chunks[g], chunks[g + 1], 0, 0.5), (*own, chunks[g + 1], final, 0, 1.0)
        else:
            parts = (*own, chunks[g], final, 0, 1.0), (*later, chunks[g], chunks[g + 1], 0, 1.0)
        room = np.empty(height * len(right))
        for part in parts:
            function.run(known, fields(room, *part))

    algebra.run_all(group, ((g,) for g in range(len(cuts) - 1)), large=True)
    if weights is not None:
        total += earlier
    return total


def _packed(
    right: np.ndarray, active: np.ndarray, bounds: np.ndarray
) -> tuple[np.ndarray, np.ndarray, list[int]]:
    """Columns as vectors (vectors, rows, lanes), the column of every lane, and the first vector of each group.

    A group begins a new vector. A lane left over is the last column of the group, times zero.
    """
    number = np.diff(bounds)
    vectors = -(-number // LANES)
    chunks = np.concatenate([[0], np.cumsum(vectors)])
    lane: np.ndarray = np.arange(LANES * int(chunks[-1]))
    size, start, begin = (
        np.repeat(each, LANES * vectors) for each in (number, bounds[:-1], LANES * chunks[:-1])
    )
    columns = active[start + np.minimum(lane - begin, size - 1)]
    packed = np.empty((chunks[-1], len(right), LANES))
    packed.transpose(1, 0, 2)[:] = right[:, columns].reshape(len(right), -1, LANES)
    packed.transpose(0, 2, 1)[(lane - begin >= size).reshape(-1, LANES)] = 0.0
    return packed, columns, chunks.tolist()


@lru_cache(64)
def _groups(n: int, k: int, share: float) -> tuple[int, ...]:
    """Cuts of the first index, from 0 to n; a group has its share of the monomials, or one first index."""
    start, cuts = basis.offsets(n, k), [0]
    for j in range(1, n):
        if start[j + 1] - start[cuts[-1]] > share * start[n]:
            cuts.append(j)
    return *cuts, n


@cache
def _compiled(gathers: bool) -> tuple[NativeFunction, int]:
    """The function of a group, and the rows it takes at a time."""
    height = 12 if wide() else 6
    source = "Left Opening Weights" if gathers else "Left stride step"
    text = LoopText(
        "add_products",
        f"{source} inner Right Prefix Last Merged prefixes Insertion n Total Earlier "
        "Room top bottom begin end split =scale",
    )
    left, second, third, inner, right, prefix, last, merged, prefixes, insertion, n, *others = text.fields()
    total, earlier, room, top, bottom, begin, end, split, scale = others
    sums, final = text.room(VECTOR, height), bottom - 1
    with text.loop(top, bottom, height) as row:
        for q in range(height):
            at = (row + q).least(final)
            if gathers:
                opening, weight = second.at(INT, at * n), third.load(DOUBLE, at)
                with text.loop(0, inner) as c:
                    room.store(left.load(DOUBLE, opening.load(INT, c)) * weight, c * height + q)
            else:
                numbers = left.at(DOUBLE, at * second)
                with text.loop(0, inner) as c:
                    room.store(numbers.load(DOUBLE, c * third), c * height + q)
        rows = (bottom - row).least(height)
        with text.loop(begin, end) as chunk:
            parts = [text.sum() for _ in range(height)]
            block = right.at(VECTOR, chunk * inner)
            with text.loop(0, inner) as c:
                numbers, vector = room.at(DOUBLE, c * height), block.load(VECTOR, c * LANES)
                for q, part in enumerate(parts):
                    part.set(text.fused(numbers.load(DOUBLE, q).all_lanes(), vector, part.get()))
            for q, part in enumerate(parts):
                sums.store(part.get() * scale.all_lanes(), q * LANES)
            column = chunk * LANES
            into = [(prefix.load(INT, column + lane), last.load(INT, column + lane)) for lane in range(LANES)]
            into_all = chunk.compare("slt", split).choose(earlier, total)
            with text.loop(0, rows) as q:
                ranks, numbers = merged.at(INT, (row + q) * prefixes), sums.at(VECTOR, q)
                for lane, (begins, ends) in enumerate(into):
                    target = into_all.at(DOUBLE, insertion.load(INT, ranks.load(INT, begins) * n + ends))
                    target.store(target.load(DOUBLE) + numbers.load(DOUBLE, lane))
    return NativeFunction(text), height
