"""The proof itself: branch and bound over cells that march outwards along rays.

Every bundle of rays (a box of directions on a face) starts at radius 0. A cell of it is accepted where V grows along
every ray and r < 0 wherever V ≤ level; then the next cell of the bundle follows it outwards, twice as long. A bundle is
finished where V > level on the inner end of its cell. A cell that is neither is halved, in radius or in the direction
that adds most to the bound.

When all bundles are finished, every ray from 0 has one radius up to which V < level, and it depends continuously on
the direction, because V grows along the ray. So these rays fill a compact set, the component of {V ≤ level} around 0,
and on it V > 0 and r < 0 but at 0: what the theorem asks for.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass, replace

import numpy as np

from flexhinf.certify.cells import Bounds, CellBounds, Cells

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
    """A progress that raises `OutOfTime` once this thread has computed for so many seconds from now on."""
    end = time.thread_time() + seconds

    def watch(cells: int, share: float) -> None:
        if time.thread_time() > end:
            raise OutOfTime

    return watch


@dataclass(frozen=True)
class Outcome:
    """How a search ended.

    Attributes
    ----------
    reason : str
        "proved"; "r > 0" or "V stops increasing" at a point of the region, which disproves; "undecided" where cells
        became too small, "not closed" where the region leaves the reach, and "too many cells".
    point : ndarray, shape (n,), or None
        Where, in coordinates z.
    value, residual : float
        V there, and r/ρ².
    cells : int
        Cells that were bounded.
    """

    proved: bool
    reason: str
    point: np.ndarray | None
    value: float
    residual: float
    cells: int


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
            cells = _taken(stack)
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
                part = Bounds(*(getattr(found, name)[chosen] for name in Bounds.__dataclass_fields__))
                rest = cells.chosen(chosen)
                end = _disproved(bounds, rest, part, level)
                if end is None:
                    end, halves = _halves(bounds, rest, part, level)
                if end is not None:
                    return replace(end, cells=done)
                stack.append(halves)
            if accepted.any():
                stack.append(_following(cells.chosen(np.flatnonzero(accepted))))
            if progress is not None:
                progress(done, min(share, 1.0))
    return Outcome(True, "proved", None, level, float("nan"), done)


def _taken(stack: list[Cells]) -> Cells:
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
    """The next cells of the bundles, outwards."""
    length = cells.outer - cells.inner
    return replace(cells, inner=cells.outer, outer=np.minimum(cells.outer + _GROWTH * length, 1.0))


def _disproved(bounds: CellBounds, cells: Cells, found: Bounds, level: float) -> Outcome | None:
    """A point of the region at which r > 0 or V decreases along the ray, if the middle of a cell is one."""
    broken = (found.centre > found.allowance) & np.isfinite(found.allowance)
    stops = found.growth_at_centre < -bounds.growth_allowance(cells)
    inside = found.value < level * (1 - 1e-9)
    for place in np.flatnonzero((broken | stops) & inside):
        point = bounds.point(cells, int(place))
        values = bounds.values(point[None] * np.linspace(0.0, 1.0, _ALONG + 1)[1:, None])
        if (values < level).all():
            reason = "r > 0" if broken[place] else "V stops increasing"
            return Outcome(False, reason, point, float(found.value[place]), float(found.centre[place]), 0)
    return None


def _halves(bounds: CellBounds, cells: Cells, found: Bounds, level: float) -> tuple[Outcome | None, Cells]:
    """Both halves of every cell; of cells halved in radius the inner one, the outer one follows it when accepted."""
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
        end = Outcome(
            False,
            reason,
            bounds.point(cells, place),
            float(found.value[place]),
            float(found.centre[place]),
            0,
        )
        return end, cells
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
    return None, Cells.joined(parts)
