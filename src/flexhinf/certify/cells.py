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
Nothing overflows or underflows unnoticed: sizes are checked once, in `_checked`, and 1e-300 times the largest factor is
added for what underflows (1e6 operations lose at most 5e-324 each). A NaN is no bound that holds: all comparisons are
ordered, and max(a, 0) of NaN is NaN.

The proof itself: branch and bound over cells that march outwards along rays.

Every bundle of rays (a box of directions on a face) starts at radius 0. A cell of it is accepted where V grows along
every ray and r < 0 wherever V ≤ level; then the next cell of the bundle follows it outwards, twice as long. A bundle is
finished where V > level on the inner end of its cell. A cell that is neither is halved, in radius or in the direction
that adds most to the bound.

When all bundles are finished, every ray from 0 has one radius up to which V < level, and it depends continuously on
the direction, because V grows along the ray. So these rays fill a compact set, the component of {V ≤ level} around 0,
and on it V > 0 and r < 0 but at 0: what the theorem asks for.
"""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Self

import numpy as np

from flexhinf.certify.box import BoxExcess
from flexhinf.certify.evaluation import polynomial_values
from flexhinf.certify.inequality import (
    Inequality,
    QuotientTable,
    Rational,
    by_parity,
    is_symmetric,
    parity,
    quotient_table,
    times_powers,
)
from flexhinf.certify.kernel import LANES, LOW, POINTERS, Layout, Shape, kernel_text, monomials_of
from flexhinf.certify.problem_to_claim import nearest_double
from flexhinf.codegen import machine
from flexhinf.codegen.compiler import cached
from flexhinf.errors import NumericalFailure

_PARTS = 16  # a batch is cut into so many tasks for threads
_UNIT = 2.0**-53
_SMALLEST = 1e-300
_VALUE = 2.0**-100  # K u times this exceeds what the balls of a table leave out
_LARGEST = 1e150
_ORDER = 4  # least degree M of the polynomial in ℓ that stands for a quotient
_ENTRY = "flexhinf_cells"


class _PerCell:
    """A dataclass whose fields are arrays with a row for each of N cells."""

    def __len__(self) -> int:
        return len(next(iter(vars(self).values())))

    def chosen(self, places: np.ndarray) -> Self:
        """Some of them, as copies."""
        return type(self)(*(rows[places] for rows in vars(self).values()))

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """All cells of several lists."""
        return cls(*map(np.concatenate, zip(*(vars(part).values() for part in parts))))


@dataclass
class Cells(_PerCell):
    """N cells; t and h are middle and half widths (N, n − 1) of the box of directions, radii in units of the reach.

    All but the faces are dyadic.
    """

    face: np.ndarray
    t: np.ndarray
    h: np.ndarray
    inner: np.ndarray
    outer: np.ndarray


@dataclass
class Bounds(_PerCell):
    """Results of the kernel; each of shape (N,) but `score`."""

    least_value: np.ndarray  # V ≥ this on the inner end of the cell
    growth: np.ndarray  # ∂V/∂ρ /ρ ≥ this on the cell
    upper: np.ndarray  # r/ρ² ≤ this on the cell
    upper_inside: np.ndarray  # r/ρ² ≤ this where V ≤ level
    centre: np.ndarray  # r/ρ² in the middle, up to the allowance
    allowance: np.ndarray
    value: np.ndarray  # V in the middle
    value_range: np.ndarray  # how far it goes from there
    growth_at_centre: np.ndarray  # ∂V/∂ρ /ρ in the middle
    score: np.ndarray  # (N, n): how much the radius and each t_j add to `upper`


class CellBounds:
    """The tables of one inequality, and the kernel that reads them.

    Parameters
    ----------
    reach : float
        Largest radius; few bits.
    extent : sequence of float
        Largest |ℓ_j| for which the functions are enclosed.
    box : BoxExcess, optional
        What the parameters' box adds to r; without, all have one value.
    """

    def __init__(
        self, inequality: Inequality, reach: float, extent: Sequence[float], box: BoxExcess | None = None
    ) -> None:
        self.n, self.reach, self.box = inequality.n, reach, box
        self.forms = np.array([[nearest_double(a) for a in q.form] for q in inequality.quotients])
        self.symmetric = is_symmetric(inequality)
        self.faces = [
            (face, sign) for face in range(self.n) for sign in ((1,) if self.symmetric else (1, -1))
        ]

        def kept(terms: Rational, even: bool) -> tuple[Rational, Rational]:
            return by_parity(terms, even) if self.symmetric else (terms, {})

        value, value_odd = kept(inequality.value, True)
        whole, whole_odd = kept(inequality.polynomial, True)
        factors = [kept(q.factor, parity(q.function) == -1) for q in inequality.quotients]  # Φ odd: S even
        highest = max(map(sum, whole))
        self.tables: list[QuotientTable] = []
        powers: list[Rational] = []
        for (factor, _), quotient, most in zip(factors, inequality.quotients, extent):
            order = max(_ORDER, highest - max(map(sum, factor), default=2))
            self.tables.append(quotient_table(quotient.function, most, order))
            powers += times_powers(factor, quotient.form, order)
        every = sorted({k for part in (whole, *powers) for k in map(sum, part)})
        terms = [_degrees(part) for part in powers]
        self.shape = shape = Shape(
            self.n, _degrees(value), [_degrees(factor) or (2,) for factor, _ in factors], every, terms
        )
        self.value_table = self._table(value, shape.value)
        quotients = [self._table(part, layout) for (part, _), layout in zip(factors, shape.quotients)]
        self.quotient_table = np.hstack(quotients) if quotients else np.zeros((len(self.faces), 1))
        parts = [self._table(part, shape.whole) for part in (whole, *powers)]
        self._value_sizes = _sums_on_faces(self.value_table, shape.value)
        self._whole_sizes = np.stack([_sums_on_faces(part, shape.whole) for part in parts])
        self._factor_sizes = [_sums_on_faces(q, layout) for q, layout in zip(quotients, shape.quotients)]
        columns = []
        for group in shape.whole.groups:
            for b in range(group.count):
                for i, k in enumerate(group.degrees):
                    place = group.offset + b * len(group.degrees) + i
                    columns.append((0, place))
                    columns += [(1 + q, place) for q, degrees in enumerate(shape.terms) if k in degrees]
        which, place = np.array(columns).T
        self.table = np.ascontiguousarray(np.stack(parts)[which, :, place].T)
        self._highest = max(every[-1], max(map(sum, inequality.value)), max(map(sum, inequality.polynomial)))
        odd = [value_odd, whole_odd, *(part for _, part in factors)]
        sums = np.zeros((len(odd), self._highest + 1))  # of absolute coefficients, by degree
        for row, part in zip(sums, odd):
            for key, coefficient in part.items():
                row[sum(key)] += abs(nearest_double(coefficient))
        self._odd_value, self._odd_whole, *self._odd_factors = sums * (1 + 1e-12)
        self._exponents = np.array(list(inequality.value))
        self._coefficients = np.array([nearest_double(value) for value in inequality.value.values()])
        self._check_sizes()
        self._compile()

    # Tables -------------------------------------------------------------------------------------
    def _table(self, terms: Rational, layout: Layout) -> np.ndarray:
        """Coefficients (faces, count) of a polynomial on the faces, rounded to doubles."""
        table = np.zeros((len(self.faces), layout.count))
        values = {key: nearest_double(value) for key, value in terms.items() if sum(key) in layout.degrees}
        for row, (variable, sign) in zip(table, self.faces):
            for key, value in values.items():
                beta = key[:variable] + key[variable + 1 :]
                row[layout.place[sum(key), beta]] = value if sign > 0 or key[variable] % 2 == 0 else -value
        return table

    def _check_sizes(self) -> None:
        """Raise where doubles could overflow or underflow unnoticed."""
        highest = self.shape.longest.degrees[-1]
        rows = max((np.nanmax(np.abs(table.rows), initial=1.0) for table in self.tables), default=1.0)
        scale = max(self.reach, 1.0) ** highest * rows
        tables = self.value_table, self.quotient_table, self.table
        largest = max(float(np.abs(table).sum()) for table in tables) * scale
        self._underflow = _SMALLEST * scale
        if not (largest < _LARGEST and scale < _LARGEST and 1 / self.reach < _LARGEST):
            raise NumericalFailure(
                "The numbers of the inequality are too large for a proof in double precision.",
                f"expected sums below {_LARGEST:g}, got {largest:.3g}",
                "states in units of about their own size",
            )

    @property
    def roundings(self) -> int:
        """K, an upper bound of the rounded operations through which a term passes on its way into a bound."""
        shape = self.shape
        highest = shape.longest.degrees[-1]
        monomials = len(monomials_of(shape.directions, highest))
        low = len(monomials_of(shape.directions, min(LOW, highest)))
        table = 2 * (len(shape.terms) + 1)
        shifts = 2 * (shape.directions + 1) * highest
        powers = 14 * highest  # h^β, ρᵏ, sums over k, the shift in ρ, the half width's powers, dyadic radii
        return table + shifts + powers + monomials + low * (highest + 1) + 64

    # The kernel ---------------------------------------------------------------------------------
    def _compile(self) -> None:
        shape = self.shape
        text, host = kernel_text(shape, _ENTRY), machine.host()
        parts = ("certify", text, host.triple, host.cpu, host.features, host.version)
        self._code = cached(
            parts, lambda: machine.assemble(text, 3), lambda image: machine.Code(image, _ENTRY, {})
        )
        self._entry = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_void_p)(self._code.address)
        segments, lines, edges, place = [], [], [0], 0
        for layout in (shape.value, *shape.quotients, shape.whole):
            for variable, length, rows in layout.shift_lines():
                segments += [variable, length, len(rows), place]
                lines.append(rows.ravel())
                place += rows.size
            edges.append(len(segments) // 4)
        # for each monomial another one times one variable that it is; then which variables it has, as doubles
        monomials = shape.longest.monomials
        number = {beta: b for b, beta in enumerate(monomials)}
        links = np.zeros((len(monomials), 2), dtype=np.int64)
        for b, beta in enumerate(monomials[1:], 1):
            j = next(j for j, e in enumerate(beta) if e)
            links[b] = number[(*beta[:j], beta[j] - 1, *beta[j + 1 :])], j
        masks = (np.array(monomials).reshape(len(monomials), shape.directions) > 0).astype(float)
        self._constants = {
            "value_table": self.value_table, "quotient_table": self.quotient_table, "table": self.table,
            "segments": np.array([*edges, *segments], dtype=np.int64),
            "lines": np.concatenate([*lines, [0]]).astype(np.int32),
            "signs": np.concatenate([links.ravel(), masks.ravel().view(np.int64)]),
        }  # fmt: skip

    # Cells --------------------------------------------------------------------------------------
    def bound(self, cells: Cells, level: float, pool: ThreadPoolExecutor | None = None) -> Bounds:
        """Bounds on cells; the same for any number of threads."""
        order = np.argsort(cells.face, kind="stable")
        counts = np.bincount(cells.face, minlength=len(self.faces))
        groups = -(-counts // LANES)
        starts = np.cumsum(groups) - groups
        rank = np.arange(len(order)) - np.repeat(np.cumsum(counts) - counts, counts)
        slot = np.empty(len(order), dtype=np.int64)
        slot[order] = starts[cells.face[order]] * LANES + rank
        total = int(groups.sum())
        faces = np.repeat(np.arange(len(self.faces)), groups)
        filled = np.zeros(total * LANES, dtype=np.int64)  # empty lanes repeat the first cell of their face
        first = order[np.minimum(np.cumsum(counts) - counts, len(order) - 1)]
        filled[:] = np.repeat(first[faces], LANES)
        filled[slot] = np.arange(len(cells))
        rows, names = self.rows(cells), self.shape.outputs
        score = np.zeros((self.n, len(cells)))
        if self.box is not None:
            radii = cells.inner * self.reach, cells.outer * self.reach
            numbers = np.array([2 * variable + (sign < 0) for variable, sign in self.faces])
            added, score = self.box(numbers[cells.face], cells.t.T, cells.h.T, *radii)
            rows[:, self.shape.inputs["rounding"]] += added
        inputs = _aligned(total * rows.shape[1] * LANES).reshape(total, rows.shape[1], LANES)
        inputs[:] = rows[filled].reshape(total, LANES, -1).transpose(0, 2, 1)
        size = names["count"]
        outputs = _aligned(total * size * LANES).reshape(total, size, LANES)
        arrays = self._constants | {
            "faces": faces.astype(np.int64), "inputs": inputs, "outputs": outputs, "level": np.array([level])
        }  # fmt: skip

        def run(first: int, last: int) -> None:
            whole = arrays | {"work": _aligned(self.shape.work["count"] * LANES)}
            addresses = [whole[name].ctypes.data for name in POINTERS[2:]]
            self._entry(np.array([first, last, *addresses], dtype=np.int64).ctypes.data)

        if pool is None:
            run(0, len(faces))
        else:
            edges = np.linspace(0, len(faces), _PARTS + 1).astype(np.int64).tolist()
            for future in [pool.submit(run, a, b) for a, b in pairwise(edges) if b > a]:
                future.result()
        found = outputs.transpose(0, 2, 1).reshape(total * LANES, size)[slot]
        single = {name: found[:, names[name]] for name in list(names)[:-2]}
        return Bounds(**single, score=found[:, names["score"] :] + score.T)

    def point(self, cells: Cells, place: int) -> np.ndarray:
        """The middle of one cell, z (n,)."""
        variable, sign = self.faces[int(cells.face[place])]
        radius = self.reach * (cells.inner[place] + cells.outer[place]) / 2
        return np.insert(cells.t[place] * radius, variable, sign * radius)

    def values(self, points: np.ndarray) -> np.ndarray:
        """V at points z (N, n), not rounded in any direction."""
        return polynomial_values(self._exponents, self._coefficients, points)

    def rows(self, cells: Cells) -> np.ndarray:
        """The kernel's inputs (N, rows) for each cell. Radii are exact: fractions and the reach have few bits."""
        inner, outer = cells.inner * self.reach, cells.outer * self.reach
        middle = (inner + outer) / 2
        half = np.maximum(outer - middle, middle - inner)
        unit = 2 * self.roundings * _UNIT
        face = cells.face
        powers = outer[:, None] ** np.arange(self._highest + 1) * (1 + 1e-12)
        lowered = np.hstack([np.zeros((len(face), 2)), powers[:, :-2]])

        def allowed(in_value: np.ndarray, odd: np.ndarray) -> np.ndarray:
            return unit * in_value.sum(1) + odd.sum(1) * (1 + 1e-12) + self._underflow

        def magnitude(sizes: np.ndarray) -> np.ndarray:
            return (sizes[face] * lowered[:, : sizes.shape[1]]).sum(1)

        degrees = np.arange(self._value_sizes.shape[1])
        in_value = self._value_sizes[face]
        value_rounding = allowed(in_value * powers[:, degrees], self._odd_value * powers)
        odd_growth = self._odd_value * np.arange(self._highest + 1) * lowered
        growth_rounding = allowed(in_value * degrees * lowered[:, degrees], odd_growth)
        size, odd = magnitude(self._whole_sizes[0]), (self._odd_whole * lowered).sum(1)
        errors, coefficients, sizes = [], [], iter(self._whole_sizes[1:])
        for j, (form, table) in enumerate(zip(self.forms, self.tables)):
            slope = np.stack([np.delete(form, variable) for variable, _ in self.faces])
            at = np.array([sign * form[variable] for variable, sign in self.faces])[face]
            at = at + (slope[face] * cells.t).sum(1)
            wide = (np.abs(slope[face]) * cells.h).sum(1)
            pad = 1e-13 * np.abs(form).sum() * outer + 1e-300
            low, high = at - wide, at + wide
            low, high = (
                np.minimum(low * inner, low * outer) - pad,
                np.maximum(high * inner, high * outer) + pad,
            )
            rows, error = table.enclose(low, high)
            for row in rows.T:
                size = size + (np.abs(row) + _VALUE) * magnitude(next(sizes))
            if self.symmetric:
                odd = odd + table.largest * (self._odd_factors[j] * lowered).sum(1)
            size = size + np.where(np.isfinite(error), error, 0.0) * magnitude(self._factor_sizes[j])
            errors.append(error)
            coefficients.append(rows)
        rounding = unit * size + odd * (1 + 1e-12) + self._underflow
        scalars = [inner, outer, middle, half, value_rounding, growth_rounding, rounding, *errors]
        return np.hstack([cells.t, cells.h, np.stack(scalars, axis=1), *coefficients])


def _degrees(terms: Rational) -> tuple[int, ...]:
    """The degrees of a polynomial's terms, ascending."""
    return tuple(sorted({sum(key) for key in terms}))


def _sums_on_faces(table: np.ndarray, layout: Layout) -> np.ndarray:
    """Sums of absolute coefficients (faces, highest degree + 1)."""
    sums = np.zeros((len(table), layout.degrees[-1] + 1))
    for group in layout.groups:
        part = table[:, group.offset : group.offset + group.count * len(group.degrees)]
        sums[:, list(group.degrees)] += np.abs(part).reshape(len(table), group.count, -1).sum(1)
    return sums * (1 + 1e-12)


def _aligned(count: int) -> np.ndarray:
    """Zeros that start at a multiple of 64 bytes."""
    raw = np.zeros(count + 8)
    offset = (-raw.ctypes.data % 64) // 8
    return raw[offset : offset + count]


#: Called now and then with the number of cells done and the estimated share of the whole.
Progress = Callable[[int, float], None]

_TOGETHER = 4096  # cells bounded at a time
_NARROW = 0.02  # a cell shorter than this times its width is split across, not along
_SHORTEST, _THINNEST = 1e-5, 1e-4  # cells below this length and width are given up
_GROWTH = 2.0  # length of the next cell of a bundle over that of the accepted one
_ALONG = 100  # points of a ray at which V is looked at before a violation inside the component is claimed


class OutOfTime(Exception):
    """The time for a proof is over."""


def time_limit(seconds: float) -> Progress:
    """A progress callback that raises `OutOfTime` when this thread has used so many more seconds of CPU."""
    end = time.thread_time() + seconds

    def watch(cells: int, share: float) -> None:
        if time.thread_time() > end:
            raise OutOfTime

    return watch


@dataclass(frozen=True)
class Outcome:
    """How a search ended.

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
    threads: int = 1,
    progress: Progress | None = None,
) -> Outcome:
    """Prove the inequality on the component of {V ≤ level} around 0, or say where that fails."""
    d, faces = bounds.n - 1, len(bounds.faces)
    stack = [
        Cells(np.arange(faces), np.zeros((faces, d)), np.ones((faces, d)), np.zeros(faces), np.ones(faces))
    ]
    done, share = 0, 0.0
    whole = faces * 2.0**d
    with ThreadPoolExecutor(threads) if threads > 1 else nullcontext() as pool:
        while stack:
            cells = _next_batch(stack)
            if done + len(cells) > most_cells:
                return Outcome(False, "too many cells", None, float("nan"), float("nan"), done)
            found = bounds.bound(cells, level, pool)
            done += len(cells)
            outside = found.least_value > level
            accepted = ~outside & (found.growth > 0) & ((found.upper < 0) | (found.upper_inside < 0))
            failed = ~outside & ~accepted
            closing = accepted & (cells.inner >= 1)  # at the reach, and V may still be below the level
            failed |= closing
            accepted &= ~closing
            width = np.prod(2 * cells.h, axis=1) / whole
            share += float((width * np.where(outside, 1 - cells.inner, 0)).sum())
            share += float((width * np.where(accepted, cells.outer - cells.inner, 0)).sum())
            if failed.any():
                chosen = np.flatnonzero(failed)
                part, rest = found.chosen(chosen), cells.chosen(chosen)
                end = _disproved(bounds, rest, part, level) or _halves(bounds, rest, part)
                if isinstance(end, Outcome):
                    return replace(end, cells=done)
                stack.append(end)
            if accepted.any():
                stack.append(_following(cells.chosen(np.flatnonzero(accepted))))
            if progress is not None:
                progress(done, min(share, 1.0))
    return Outcome(True, "proved", None, level, float("nan"), done)


def _next_batch(stack: list[Cells]) -> Cells:
    """The cells that were put on the stack last, at most `_TOGETHER`."""
    parts, count = [], 0
    while stack and count < _TOGETHER:
        part = stack.pop()
        if count + len(part) > _TOGETHER:
            split = len(part) - (_TOGETHER - count)
            stack.append(part.chosen(np.arange(split)))
            part = part.chosen(np.arange(split, len(part)))
        parts.append(part)
        count += len(part)
    return Cells.joined(parts)


def _following(cells: Cells) -> Cells:
    """The intervals of ρ that follow accepted cells outwards."""
    length = cells.outer - cells.inner
    return replace(cells, inner=cells.outer, outer=np.minimum(cells.outer + _GROWTH * length, 1.0))


def _outcome(bounds: CellBounds, cells: Cells, found: Bounds, place: int, reason: str) -> Outcome:
    """A search that ended at the middle of a cell."""
    point = bounds.point(cells, place)
    return Outcome(False, reason, point, float(found.value[place]), float(found.centre[place]), 0)


def _disproved(bounds: CellBounds, cells: Cells, found: Bounds, level: float) -> Outcome | None:
    """A point of the region at which r > 0 or V decreases along the ray, if the middle of a cell is one."""
    broken = (found.centre > found.allowance) & np.isfinite(found.allowance)
    stops = found.growth_at_centre < -bounds.rows(cells)[:, bounds.shape.inputs["growth_rounding"]]
    inside = found.value < level * (1 - 1e-9)
    for place in np.flatnonzero((broken | stops) & inside):
        point = bounds.point(cells, int(place))
        values = bounds.values(point[None] * np.linspace(0.0, 1.0, _ALONG + 1)[1:, None])
        if (values < level).all():
            reason = "r > 0" if broken[place] else "V stops increasing"
            return _outcome(bounds, cells, found, int(place), reason)
    return None


def _halves(bounds: CellBounds, cells: Cells, found: Bounds) -> Outcome | Cells:
    """Both halves of every cell. Of a cell cut in ρ only the inner half: the outer one follows when it is accepted."""
    length, d = cells.outer - cells.inner, bounds.n - 1
    score = np.where(found.score >= 0, found.score, 0.0)
    vague = ~np.isfinite(found.allowance) | ~(score.sum(1) > 0)
    chosen = np.argmax(score, axis=1)
    if d:
        widest = 1 + np.argmax(cells.h, axis=1)
        width = cells.h.max(axis=1)
        chosen = np.where(vague, np.where(length < 0.5 * width, widest, 0), chosen)
        weighted = cells.h * np.where(score[:, 1:] > 0, 1.0, 0.5)
        across = 1 + np.argmax(weighted, axis=1)
        chosen = np.where((chosen == 0) & (length < _NARROW * weighted.max(axis=1)), across, chosen)
        chosen = np.where(length == 0, widest, chosen)
        size = np.where(chosen > 0, cells.h[np.arange(len(cells)), np.maximum(chosen - 1, 0)], length)
    else:
        chosen, size = np.zeros(len(cells), dtype=np.int64), length
    small = size < np.where(chosen > 0, _THINNEST, _SHORTEST)
    if small.any():
        place = int(np.flatnonzero(small)[0])
        reason = "not closed" if cells.inner[place] >= 1 else "undecided"
        return _outcome(bounds, cells, found, place, reason)
    along = cells.chosen(np.flatnonzero(chosen == 0))
    along.outer = (along.inner + along.outer) / 2
    places = np.flatnonzero(chosen > 0)
    parts = [along]
    for side in (1, -1):
        part = cells.chosen(places)
        row, column = np.arange(len(places)), chosen[places] - 1
        part.h[row, column] /= 2
        part.t[row, column] += side * part.h[row, column]
        parts.append(part)
    return Cells.joined(parts)
