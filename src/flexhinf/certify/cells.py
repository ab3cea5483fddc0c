"""Bounds of V, of its growth and of r on cells, with the allowance for rounding.

A cell is a face z_f = ±ρ of a cube, ρ in [ρ_a, ρ_b], and a box |t_j − t_j⁰| ≤ h_j of the other z_j = ρ t_j. Every
number that decides is a bound of a polynomial in (ρ, t), re-expanded about the middle of the cell and scaled to it, so
that its variables lie in [−1, 1]: the constant, plus max(c, 0) of every coefficient whose exponents are all even, plus
|c| of the others. Monomials of degree above 3 in t are not re-expanded in ρ; they are taken at the middle, plus what
each degree can change up to ρ_b.

**Rounding.** A bound is a sum of products of the coefficients with powers of t⁰, h and ρ, computed in doubles, fused
or not. Because |t_j⁰| + h_j ≤ 1, the absolute values of all these products add up to at most
M(ρ_b) = Σ_k ρ_b^(k−2) Σ|coefficients of degree k|: synthetic division makes (|t⁰| + h)^β of |t|^β, and the shift in ρ
makes (ρ_m + δ)^p = ρ_b^p of ρ^p. Each product passes at most K roundings, so the error is at most K u/(1 − K u) · M
with u = 2⁻⁵³. K is counted in `roundings`; the allowance is 2 K u M. Dyadic t, h and ρ make the cells themselves exact.
Nothing overflows or underflows unnoticed: sizes are checked once, with the tables, and 1e-300 times the largest factor
is added for what underflows (1e6 operations lose at most 5e-324 each). A NaN never counts as a bound: all comparisons
are ordered, and max(a, 0) of NaN is NaN.

The proof itself: branch and bound over cells that follow each other outwards along rays.

Every bundle of rays (a box of directions on a face) starts at radius 0. A cell of it is accepted where V grows along
every ray and r < 0 wherever V ≤ level; then the next cell of the bundle follows it outwards, twice as long. A bundle is
finished if V > level on the inner end of its cell. A cell that is neither accepted nor finished is halved, in radius or
in the direction that adds most to the bound.

When all bundles are finished, every ray from 0 has one radius up to which V < level. The radius depends continuously on
the direction, because V grows along the ray. So these rays fill a compact set, the component of {V ≤ level} around 0.
On it V > 0 and r < 0 except at 0, as the theorem requires.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass, replace
from itertools import accumulate, product
from math import prod
from operator import mul
from typing import Any

import numpy as np

from flexhinf.arrays import Matrix, Vector
from flexhinf.certify.certificate import polynomial_at
from flexhinf.certify.inequality import BoxExcess, Inequality, QuotientTable, Rational, by_parity, parity
from flexhinf.certify.kernel import (
    LOW,
    OUTPUTS,
    TASK,
    CellShape,
    MonomialLayout,
    kernel_of,
    monomials_of,
)
from flexhinf.certify.problem_to_claim import nearest_double, terms_of
from flexhinf.codegen.loops import LANES
from flexhinf.errors import NumericalFailure
from flexhinf.processors import thread_count

#: A NumPy record array; type checkers do not know its fields.
Records = Any

_PARTS = 16  # number of tasks of a batch, for threads
_VALUE = 2.0**-100  # K u times this exceeds what the balls of a table leave out
_LARGEST = 1e150
_ORDER = 4  # smallest degree M of the polynomial in ℓ that approximates a quotient
_ASYMMETRY = 1e-9  # opposite faces are treated together up to this fraction of terms of the wrong parity


def cells_of(face: np.ndarray, t: np.ndarray, h: np.ndarray, inner: np.ndarray, outer: np.ndarray) -> Records:
    """N cells as records; t and h are middle and half widths (N, n − 1) of the box of directions, radii in units of the
    reach. All but the faces are dyadic."""
    d = t.shape[1:]
    return np.rec.fromarrays(
        [face, t, h, inner, outer],
        [("face", int), ("t", float, d), ("h", float, d), ("inner", float), ("outer", float)],
    )


class CellBounds:
    """The tables of one inequality in max|z_i| ≤ reach (few bits), and the kernel that reads them.

    `extent` are the largest |ℓ_j| for which the functions are enclosed.
    """

    def __init__(self, inequality: Inequality, reach: float, extent: Sequence[float]) -> None:
        self.n, self.reach, claim = inequality.n, reach, inequality.certificate
        self.box = BoxExcess(claim, reach) if any(p.low < p.high for p in claim.parameters) else None
        self.lines = inequality.forms(inequality.functions)
        signs = [*map(parity, inequality.functions)]
        pairs = [  # for each function its terms, and whether the even ones are kept; if Φ is odd, S is even
            (inequality.value, True),
            (inequality.polynomial, True),
            *((factor, sign == -1) for factor, sign in zip(inequality.factors, signs)),
        ]
        split = [by_parity(terms, even) for terms, even in pairs]
        sizes = [[sum(abs(nearest_double(v)) for v in part.values()) for part in pair] for pair in split]
        # V(−z) = V(z) and r(−z) = r(z) but for rounding, which then is added to the allowance
        self.symmetric = 0 not in signs and all(odd <= _ASYMMETRY * (even + odd) for even, odd in sizes)
        if not self.symmetric:
            split = [(terms, Rational()) for terms, _ in pairs]
        self.faces = [*product(range(self.n), (1,) if self.symmetric else (1, -1))]
        (value, whole, *factors), odd = zip(*split)
        highest = max(map(sum, whole))
        self.tables, powers = list[QuotientTable](), list[Rational]()
        for factor, function, most in zip(factors, inequality.functions, extent):
            order = max(_ORDER, highest - max(map(sum, factor), default=2))
            self.tables.append(QuotientTable(function, most, order))
            line = inequality.moved(inequality.line(function.slope))
            powers += map(terms_of, accumulate([line] * order, mul, initial=inequality.z.from_dict(factor)))
        every = sorted({k for part in (whole, *powers) for k in map(sum, part)})
        degrees = [_degrees(factor) or (2,) for factor in factors]
        self.shape = shape = CellShape(self.n, _degrees(value), degrees, every, [*map(_degrees, powers)])
        self.value_table = self._table(value, shape.value)
        self.quotient_table = np.hstack(
            [self._table(part, layout) for part, layout in zip(factors, shape.quotients)]
            or [np.zeros((len(self.faces), 1))]
        )
        which, place = np.array(shape.columns).T
        self.table = np.ascontiguousarray(
            np.stack([self._table(part, shape.whole) for part in (whole, *powers)])[which, :, place].T
        )
        self._highest = max(every[-1], max(map(sum, inequality.value)), max(map(sum, inequality.polynomial)))

        def sums(terms: Rational) -> np.ndarray:
            return np.bincount(  # by degree, on each face the same
                np.array([sum(key) for key in terms], dtype=int),
                [abs(nearest_double(value)) for value in terms.values()],
                self._highest + 1,
            ) * (1 + 1e-12)

        self._value_sizes, self._odd_value, self._odd_whole, *self._odd_factors = map(sums, (value, *odd))
        self._whole_sizes, self._factor_sizes = [*map(sums, (whole, *powers))], [*map(sums, factors)]
        self.value_terms = [(key, nearest_double(number)) for key, number in inequality.value.items()]
        scale = max(self.reach, 1.0) ** shape.longest.degrees[-1] * max(
            (np.nanmax(np.abs(table.rows), initial=1.0) for table in self.tables), default=1.0
        )
        largest = (
            max(float(np.abs(table).sum()) for table in (self.value_table, self.quotient_table, self.table))
            * scale
        )
        self._underflow = 1e-300 * scale
        if not (largest < _LARGEST and scale < _LARGEST and 1 / self.reach < _LARGEST):
            raise NumericalFailure(
                "The numbers of the inequality are too large for a proof in double precision.",
                f"expected sums below {_LARGEST:g}, got {largest:.3g}",
                "states in units of about their own size",
            )
        self._compile()

    # Tables -------------------------------------------------------------------------------------
    def _table(self, terms: Rational, layout: MonomialLayout) -> np.ndarray:
        table = np.zeros((len(self.faces), layout.count))
        values = {key: nearest_double(value) for key, value in terms.items() if sum(key) in layout.degrees}
        for row, (variable, sign) in zip(table, self.faces):
            for key, value in values.items():
                row[layout.place[sum(key), key[:variable] + key[variable + 1 :]]] = (
                    value * sign ** key[variable]
                )
        return table

    @property
    def roundings(self) -> int:
        """K, an upper bound of the number of rounded operations on a term of a bound."""
        shape = self.shape
        highest = shape.longest.degrees[-1]
        monomials, low = (len(monomials_of(shape.directions, k)) for k in (highest, min(LOW, highest)))
        table, shifts = 2 * (len(shape.terms) + 1), 2 * (shape.directions + 1) * highest
        powers = 14 * highest  # h^β, ρᵏ, sums over k, the shift in ρ, the half width's powers, dyadic radii
        return table + shifts + powers + monomials + low * (highest + 1) + 64

    # The kernel ---------------------------------------------------------------------------------
    def _compile(self) -> None:
        shape = self.shape
        self._function = kernel_of(shape)
        lines = [layout.shift_lines() for layout in (shape.value, *shape.quotients, shape.whole)]
        edges = np.cumsum([0, *map(len, lines)])
        every = [line for part in lines for line in part]
        places = np.cumsum([0, *(rows.size for _, _, rows in every)])
        segments = [(variable, length, len(rows), at) for (variable, length, rows), at in zip(every, places)]
        # for each monomial another one times one variable that it is; then which variables it has, as doubles
        monomials = shape.longest.monomials
        links = np.zeros((len(monomials), 2), dtype=np.int64)
        for b, beta in enumerate(monomials[1:], 1):
            j = next(j for j, e in enumerate(beta) if e)
            links[b] = monomials.index((*beta[:j], beta[j] - 1, *beta[j + 1 :])), j
        masks = (np.array(monomials).reshape(len(monomials), shape.directions) > 0).astype(float)
        self._constants = {
            "value_table": self.value_table,
            "quotient_table": self.quotient_table,
            "table": self.table,
            "segments": np.array([*edges, *np.ravel(segments)], dtype=np.int64),
            "lines": np.concatenate([*(rows.ravel() for _, _, rows in every), [0]]).astype(np.int32),
            "links": links,
            "masks": masks,
        }

    # Cells --------------------------------------------------------------------------------------
    def bound(self, cells: Records, level: float, pool: ThreadPoolExecutor | None = None) -> Records:
        """Records of `OUTPUTS` and `score` for each cell; the same for any number of threads."""
        mine = [np.flatnonzero(cells.face == face) for face in range(len(self.faces))]
        padded = [np.append(cell, np.repeat(cell[:1], -len(cell) % LANES)) for cell in mine]
        filled = np.concatenate(padded)  # empty lanes repeat the first cell of their face
        faces = np.repeat(np.arange(len(mine)), [len(part) // LANES for part in padded])
        slot = np.empty(len(cells), dtype=np.int64)
        slot[filled[::-1]] = np.arange(len(filled))[::-1]  # of each cell the first
        rows, names = self.rows(cells), self.shape.outputs
        score = np.zeros((self.n, len(cells)))
        if self.box is not None:
            numbers = np.array([2 * variable + (sign < 0) for variable, sign in self.faces])
            added, score = self.box(
                numbers[cells.face], cells.t.T, cells.h.T, cells.inner * self.reach, cells.outer * self.reach
            )
            rows[:, self.shape.inputs["rounding"]] += added
        inputs, outputs = (_aligned(len(faces), size, LANES) for size in (rows.shape[1], names["count"]))
        inputs[:] = rows[filled].reshape(len(faces), LANES, -1).transpose(0, 2, 1)
        arrays = self._constants | {
            "faces": faces.astype(np.int64),
            "inputs": inputs,
            "outputs": outputs,
            "level": float(level),
        }

        def run(first: int, last: int) -> None:
            task = arrays | {"first": first, "last": last, "work": _aligned(self.shape.work["count"], LANES)}
            self._function(*(task[name] for name in TASK))

        if pool is None:
            run(0, len(faces))
        else:
            edges = np.linspace(0, len(faces), _PARTS + 1).astype(np.int64).tolist()
            list(pool.map(run, edges[:-1], edges[1:]))
        results = outputs.transpose(0, 2, 1).reshape(len(filled), -1)[slot]
        results[:, names["score"] :] += score.T
        return results.view([*((name, float) for name in OUTPUTS), ("score", float, (self.n,))])[:, 0].view(
            np.recarray
        )

    def rows(self, cells: Records) -> np.ndarray:
        """The kernel's inputs (N, rows) for each cell. Radii are exact: fractions and the reach have few bits."""
        inner, outer = cells.inner * self.reach, cells.outer * self.reach
        middle, unit, face = (inner + outer) / 2, 2 * self.roundings * 2.0**-53, cells.face
        half, degrees = np.maximum(outer - middle, middle - inner), np.arange(self._highest + 1)
        powers = outer[:, None] ** degrees * (1 + 1e-12)
        lowered = np.hstack([np.zeros((len(face), 2)), powers[:, :-2]])

        def allowed(size: np.ndarray, odd: np.ndarray) -> np.ndarray:
            return unit * size + odd * (1 + 1e-12) + self._underflow

        size, odd = lowered @ self._whole_sizes[0], lowered @ self._odd_whole
        errors, coefficients, sizes = list[Vector](), list[Matrix](), iter(self._whole_sizes[1:])
        for j, (form, table) in enumerate(zip(self.lines, self.tables)):
            slope = np.stack([np.delete(form, variable) for variable, _ in self.faces])
            at = np.array([sign * form[variable] for variable, sign in self.faces])[face]
            at, wide = at + (slope[face] * cells.t).sum(1), (np.abs(slope[face]) * cells.h).sum(1)
            low, high, pad = at - wide, at + wide, 1e-13 * np.abs(form).sum() * outer + 1e-300
            low = np.minimum(low * inner, low * outer) - pad
            high = np.maximum(high * inner, high * outer) + pad
            rows, error = table.enclose(low, high)
            for row in rows.T:
                size = size + (np.abs(row) + _VALUE) * (lowered @ next(sizes))
            if self.symmetric:
                odd = odd + table.largest * (lowered @ self._odd_factors[j])
            size = size + np.where(np.isfinite(error), error, 0.0) * (lowered @ self._factor_sizes[j])
            errors.append(error)
            coefficients.append(rows)
        scalars = [
            *(inner, outer, middle, half),
            allowed(powers @ self._value_sizes, powers @ self._odd_value),  # of V, of its growth, of r
            allowed(lowered @ (degrees * self._value_sizes), lowered @ (degrees * self._odd_value)),
            allowed(size, odd),
            *errors,
        ]
        return np.hstack([cells.t, cells.h, np.stack(scalars, axis=1), *coefficients])


def _degrees(terms: Rational) -> tuple[int, ...]:
    return tuple(sorted({sum(key) for key in terms}))


def _aligned(*shape: int) -> np.ndarray:
    count = prod(shape)
    raw = np.zeros(count + 8)
    return raw[(-raw.ctypes.data % 64) // 8 :][:count].reshape(shape)


#: Called now and then with the number of cells done and the estimated share of the whole.
Progress = Callable[[int, float], None]

_TOGETHER = 4096  # cells bounded at a time
_NARROW = 0.02  # a cell whose length is below this times its width is split in a direction, not in radius
_SHORTEST, _THINNEST = 1e-5, 1e-4  # cells below this length and width are given up
_GROWTH = 2.0  # length of the next cell of a bundle over that of the accepted one
_ALONG = 100  # points of a ray at which V is evaluated before a violation inside the component is reported


class OutOfTime(Exception):
    """The time for a proof is over."""


def time_limit(seconds: float) -> Progress:
    """A progress callback that raises `OutOfTime` once this thread has used `seconds` more of CPU time."""
    end = time.thread_time() + seconds

    def watch(cells: int, share: float) -> None:
        if time.thread_time() > end:
            raise OutOfTime

    return watch


@dataclass(frozen=True)
class SearchOutcome:
    """Result of a search: proved, refuted or given up.

    `reason` is "proved"; "r > 0" or "V stops increasing" at a point of the region, which disproves; "undecided" where
    cells became too small, "not closed" where the region leaves the reach, and "too many cells".
    """

    proved: bool
    reason: str
    point: np.ndarray | None  # where, in coordinates z
    value: float  # V there
    residual: float  # r/ρ² there
    cells: int  # that were bounded


def search(
    bounds: CellBounds,
    level: float,
    *,
    most_cells: int = 100_000_000,
    threads: int | None = None,
    progress: Progress | None = None,
) -> SearchOutcome:
    """Prove the inequality on the component of {V ≤ level} around 0, or return the point at which that fails."""
    d, count = bounds.n - 1, len(bounds.faces)
    stack = [
        cells_of(np.arange(count), np.zeros((count, d)), np.ones((count, d)), np.zeros(count), np.ones(count))
    ]
    done, share, whole = 0, 0.0, count * 2.0**d
    threads = thread_count() if threads is None else threads
    with ThreadPoolExecutor(threads) if threads > 1 else nullcontext() as pool:
        while stack:
            parts, room = list[Records](), _TOGETHER
            while stack and room:
                part = stack.pop()
                stack += [part[:-room]] * (len(part) > room)
                parts.append(part[-room:])
                room -= len(parts[-1])
            cells = np.concatenate(parts).view(np.recarray)
            if done + len(cells) > most_cells:
                return SearchOutcome(False, "too many cells", None, float("nan"), float("nan"), done)
            results = bounds.bound(cells, level, pool)
            done += len(cells)
            outside = results.least_value > level
            accepted = ~outside & (results.growth > 0) & ((results.upper < 0) | (results.upper_inside < 0))
            accepted &= cells.inner < 1  # at the reach V may still be below the level
            failed, width = ~(outside | accepted), np.prod(2 * cells.h, axis=1) / whole
            share += float((width * np.where(outside, 1 - cells.inner, 0)).sum())
            share += float((width * np.where(accepted, cells.outer - cells.inner, 0)).sum())
            if failed.any():
                part, failing = results[failed], cells[failed]
                end = _disproved(bounds, failing, part, level) or _halves(bounds, failing, part)
                if isinstance(end, SearchOutcome):
                    return replace(end, cells=done)
                stack.append(end)
            if accepted.any():
                stack.append(_following(cells[accepted]))
            if progress is not None:
                progress(done, min(share, 1.0))
    return SearchOutcome(True, "proved", None, level, float("nan"), done)


def _following(cells: Records) -> Records:
    outer = np.minimum(cells.outer + _GROWTH * (cells.outer - cells.inner), 1.0)
    return cells_of(cells.face, cells.t, cells.h, cells.outer, outer)


def _outcome(
    bounds: CellBounds, cells: Records, results: Records, place: int, reason: str
) -> tuple[SearchOutcome, np.ndarray]:
    variable, sign = bounds.faces[int(cells.face[place])]
    radius = bounds.reach * (cells.inner[place] + cells.outer[place]) / 2
    point = np.insert(cells.t[place] * radius, variable, sign * radius)
    return SearchOutcome(
        False, reason, point, float(results.value[place]), float(results.centre[place]), 0
    ), point


def _disproved(bounds: CellBounds, cells: Records, results: Records, level: float) -> SearchOutcome | None:
    """A point of the region with r > 0 or with V decreasing along the ray, if the middle of a cell is such a point."""
    broken = (results.centre > results.allowance) & np.isfinite(results.allowance)
    stops = results.growth_at_centre < -bounds.rows(cells)[:, bounds.shape.inputs["growth_rounding"]]
    for place in np.flatnonzero((broken | stops) & (results.value < level * (1 - 1e-9))).tolist():
        outcome, point = _outcome(
            bounds, cells, results, place, "r > 0" if broken[place] else "V stops increasing"
        )
        ray = point[None] * np.linspace(0.0, 1.0, _ALONG + 1)[1:, None]
        if (polynomial_at(bounds.value_terms, ray) < level).all():
            return outcome
    return None


def _halves(bounds: CellBounds, cells: Records, results: Records) -> SearchOutcome | Records:
    """Halves of every cell; of a cell cut in ρ the inner half only. The outer half is made when the inner one is
    accepted."""
    length, d = cells.outer - cells.inner, bounds.n - 1
    score = np.where(results.score >= 0, results.score, 0.0)
    vague = ~np.isfinite(results.allowance) | ~(score.sum(1) > 0)
    chosen = np.argmax(score, axis=1)
    if d:
        widest, weighted = 1 + np.argmax(cells.h, axis=1), cells.h * np.where(score[:, 1:] > 0, 1.0, 0.5)
        chosen = np.where(vague, np.where(length < 0.5 * cells.h.max(axis=1), widest, 0), chosen)
        chosen = np.where(
            (chosen == 0) & (length < _NARROW * weighted.max(axis=1)), 1 + np.argmax(weighted, axis=1), chosen
        )
        chosen = np.where(length == 0, widest, chosen)
    small = np.column_stack([length, cells.h])[np.arange(len(cells)), chosen] < np.where(
        chosen > 0, _THINNEST, _SHORTEST
    )
    if small.any():
        place = int(np.flatnonzero(small)[0])
        return _outcome(
            bounds, cells, results, place, "not closed" if cells.inner[place] >= 1 else "undecided"
        )[0]
    along, *halves = (cells[side] for side in (chosen == 0, chosen > 0, chosen > 0))
    along.outer = (along.inner + along.outer) / 2
    for part, sign in zip(halves, (1, -1)):
        place = np.arange(len(part)), chosen[chosen > 0] - 1
        part.h[place] /= 2
        part.t[place] += sign * part.h[place]
    return np.concatenate([along, *halves]).view(np.recarray)
