"""Branch and bound along rays: cells march outwards from ρ = 0 on each face until V exceeds the level everywhere."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from flexhinf.certify.checker.inequality import Bounds, FaceInequality

__all__ = ["Cell", "Marched", "Refusal", "march_face"]

BATCH = 64
_NARROWEST = 2.0**-15  # half width of the widest t_i: a direction that is not decided there is refused
_EXACT = 2.0**-40  # half width of any t_i, so that t ± h are doubles
_SHORTEST = 2.0**-24  # of an interval of ρ, in units of the reach
_FLAT = 0.02  # an interval of ρ shorter than this times the widest t_i is not split further
_GROWTH = 2.0  # of the interval of ρ after a cell that was accepted


@dataclass(frozen=True)
class Cell:
    """An accepted cell: face z_f = sign · ρ, t ± h, begin ≤ ρ ≤ end, and λ."""

    face: tuple[int, int]
    t: tuple[float, ...]
    h: tuple[float, ...]
    begin: float
    end: float
    multiplier: float

    def opposite(self) -> Cell:
        """The cell at −z."""
        return replace(self, face=(self.face[0], -self.face[1]), t=tuple(-t for t in self.t))


@dataclass(frozen=True)
class Marched:
    """Of one face: cells looked at, accepted, accepted by λ > 0; the largest allowance for rounding; a sample."""

    cells: int
    accepted: int
    with_level: int
    rounding: float
    sample: tuple[Cell, ...]


class Refusal(Exception):
    """A claim that is not proved, and why; with the place z, and V there, where it is about one."""

    def __init__(self, why: str, z: np.ndarray | None = None, value: float = float("nan")) -> None:
        super().__init__(why)
        self.z, self.value = z, value


@dataclass(frozen=True, eq=False)
class _Batch:
    """Columns t, h, begin, end of cells; ρ in units of the reach, so that all are dyadic and exact."""

    columns: np.ndarray
    n: int

    @property
    def t(self) -> np.ndarray:
        return self.columns[: self.n - 1]

    @property
    def h(self) -> np.ndarray:
        return self.columns[self.n - 1 : -2]


def march_face(
    face: FaceInequality,
    n: int,
    level: float,
    reach: float,
    *,
    sample: int,
    seed: int,
    tick: Callable[[int], None] = lambda cells: None,
    most: int = 10**8,
) -> Marched:
    """Prove one face, or raise a `Refusal`."""
    rng = np.random.default_rng([seed, face.face[0], face.face[1] + 1])
    stack = np.r_[np.zeros(n - 1), np.ones(n - 1), 0.0, 1.0][:, None]
    cells = accepted = with_level = 0
    rounding, kept = 0.0, []
    while stack.shape[1]:
        stack, batch = stack[:, :-BATCH], _Batch(stack[:, -BATCH:], n)
        begin, end = batch.columns[-2] * reach, batch.columns[-1] * reach
        bounds = face.bounds(batch.t, batch.h, begin, end)
        cells += len(end)
        tick(len(end))
        edge = batch.columns[-2] >= 1.0
        _refuse(face.face, batch, bounds, begin, end, level, edge)
        if cells > most:
            raise Refusal(f"undecided after {cells:,} cells")
        good = bounds.proved & ~edge & ~bounds.finished
        by_level = good & ~(bounds.largest < 0)
        with_level += int(by_level.sum())
        rounding = max(rounding, float(bounds.rounding[good].max(initial=0.0)))
        for i in np.flatnonzero(good):  # each accepted cell is in the sample with the same probability
            accepted += 1
            place = len(kept) if len(kept) < sample else int(rng.integers(accepted))
            if place < sample:
                multiplier = float(bounds.multiplier[i]) if by_level[i] else 0.0
                box = (tuple(batch.t[:, i].tolist()), tuple(batch.h[:, i].tolist()))
                cell = Cell(face.face, *box, float(begin[i]), float(end[i]), multiplier)
                kept[place : place + 1] = [cell]
        further = batch.columns[:, good]
        length = further[-1] - further[-2]
        further[-2] = further[-1]
        further[-1] = np.minimum(1.0, further[-1] + _GROWTH * length)
        bad = ~good & ~bounds.finished
        stack = np.hstack(
            [stack, further, *_split(batch.columns[:, bad], bounds.score[:, bad], edge[bad], n)]
        )
    return Marched(cells, accepted, with_level, rounding, tuple(kept))


def _refuse(
    face: tuple[int, int],
    batch: _Batch,
    bounds: Bounds,
    begin: np.ndarray,
    end: np.ndarray,
    level: float,
    edge: np.ndarray,
) -> None:
    """Raise where something is wrong, or a cell is too small to go on."""
    undecided = ~bounds.finished & ~(bounds.proved & ~edge)
    narrow = np.ones(len(end), bool)
    if batch.n > 1:
        narrow = (batch.h.max(0) < _NARROWEST) | (batch.h.min(0) < _EXACT)
    short = batch.columns[-1] - batch.columns[-2] < _SHORTEST
    inside = bounds.value < level
    allowance = bounds.remainder + bounds.rounding
    positive = np.isfinite(allowance) & (bounds.constant > 1e3 * allowance) & (bounds.least_growth > 0)
    for found, why in (
        (edge & undecided & (inside | narrow), "the level set reaches beyond the stated reach"),
        (undecided & inside & positive, "r > 0"),
        (undecided & ~edge & (short if batch.n == 1 else narrow | short), "a cell cannot be decided"),
    ):
        if found.any():
            i = int(np.flatnonzero(found)[0])
            z = np.insert(batch.t[:, i], face[0], face[1]) * (begin[i] + end[i]) / 2
            raise Refusal(why, z, float(bounds.value[i]))


def _split(columns: np.ndarray, score: np.ndarray, edge: np.ndarray, n: int) -> list[np.ndarray]:
    """Cells that were not accepted, cut in half: shorter in ρ, or two boxes of directions."""
    if not columns.shape[1]:
        return []
    h = columns[n - 1 : -2]
    axis = np.where(np.isfinite(score), score, 0.0).argmax(0)
    if n > 1:
        flat = (axis == 0) & (columns[-1] - columns[-2] < _FLAT * h.max(0))
        axis = np.where(flat | edge, 1 + h.argmax(0), axis)
    shorter = columns[:, axis == 0]
    shorter[-1] = (shorter[-2] + shorter[-1]) / 2
    result = [shorter]
    where = np.flatnonzero(axis > 0)
    for side in (-1.0, 1.0):
        half, i, j = columns[:, where], axis[where] - 1, np.arange(len(where))
        half[n - 1 + i, j] /= 2
        half[i, j] += side * half[n - 1 + i, j]
        result.append(half)
    return result
