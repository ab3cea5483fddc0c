"""Ray subdivision on one cube face: from ρ = 0 outwards each direction is proved, interval by interval, until V > c.

The columns of an array of cells are t, h and the two ends of the interval of ρ in units of the reach: dyadic numbers of
at most 24 bits, so cuts are exact, and intervals adjoin bit for bit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from flexhinf.certify.checker.bounds import CentredForm, Face
from flexhinf.certify.checker.guidance import axis_to_cut, refuse
from flexhinf.certify.checker.residual import require
from flexhinf.certify.checker.second_route import CellSample, EveryCell

BATCH = 64
_GROWTH = 2.0  # of the interval of ρ after a cell that was accepted
_NARROW, _SHORT = 2.0**-40, 2.0**-24  # half widths and intervals that are not cut: parts would not be exact


@dataclass(frozen=True)
class Verification:
    """Result of the checker, or of one face of it: whether it is proved, why not, and statistics of the proof.

    Attributes
    ----------
    reason : str
        Why not, else empty.
    cells, accepted, with_level : int
        Cells that were looked at, that were accepted, and of these the ones that needed V ≤ c.
    resampled, every_cell : int, bool
        Cells that were proved a second time, in rationals and balls; whether these are all, and all at which the level
        set ended.
    faces : int
        Of the cube: n where V and r are even but for rounding, else 2n.
    corners : int
        Of quotients and parameters, at which r is a negative definite quadratic form in exact rationals; then there are
        no cells. 0 where cells decide.
    starts : int
        Intervals of amplitudes whose starts were shown to be inside.
    gradient_law, peaks : bool, tuple of float
        Whether 4. of the theorem is proved too; the bounds of 8., in the inputs' units, empty where it is not proved.
    rounding : float
        Largest allowance for rounding in r/ρ².
    """

    proved: bool
    reason: str = ""
    cells: int = 0
    accepted: int = 0
    with_level: int = 0
    resampled: int = 0
    every_cell: bool = False
    faces: int = 0
    corners: int = 0
    starts: int = 0
    gradient_law: bool = False
    peaks: tuple[float, ...] = ()
    rounding: float = 0.0
    cpu_s: float = 0.0


def subdivide_face(
    face: Face, chosen: CellSample | EveryCell, *, tick: Callable[[int], None] = lambda cells: None
) -> Verification:
    """Prove that each direction of a face is finished after accepted cells that adjoin from ρ = 0 on, or raise a
    `Refusal`."""
    n, reach = face.proof.n, face.proof.claim.reach
    stack = np.r_[np.zeros(n - 1), np.ones(n - 1), 0.0, 1.0][:, None]  # the whole face, and all of ρ
    count, accepted, with_level, rounding = 0, 0, 0, 0.0
    while stack.shape[1]:
        stack, cells = stack[:, :-BATCH], stack[:, -BATCH:]
        bounds = face.bounds(cells[: n - 1], cells[n - 1 : -2], cells[-2] * reach, cells[-1] * reach)
        finished = bounds.finished
        good = bounds.proved & ~finished & (cells[-2] < 1.0)
        undecided = ~good & ~finished
        refuse(face.face, cells, undecided, bounds, reach)
        chosen.offer(cells, good, finished, bounds, reach)
        bad, form = cells[:, undecided], CentredForm(*(part[:, undecided] for part in bounds.form))
        stack = np.hstack(
            [stack, _further(cells[:, good]), *_cut(bad, axis_to_cut(face.proof.table, form, bad))]
        )

        count, accepted = count + len(good), accepted + int(good.sum())
        with_level += int((good & ~(bounds.largest < 0)).sum())
        rounding = max(rounding, float(bounds.rounding[good].max(initial=0.0)))
        tick(len(good))
    return Verification(
        True, cells=count, accepted=accepted, with_level=with_level, resampled=chosen.count, rounding=rounding
    )


def _further(cells: np.ndarray) -> np.ndarray:
    """The intervals that adjoin those of accepted cells; from the reach on they are empty, and can only be finished."""
    return np.vstack([cells[:-2], cells[-1], np.minimum(1.0, cells[-1] + _GROWTH * (cells[-1] - cells[-2]))])


def _cut(cells: np.ndarray, axis: np.ndarray) -> list[np.ndarray]:
    """What covers cells that were not accepted, whichever axes are chosen: the inner half of ρ, which its outer part
    follows, or both halves of a t_i; a `Refusal` where halves are not exact any more."""
    require(
        not (
            (cells[len(cells) // 2 - 1 : -2] < _NARROW).any()
            or ((cells[-1] - cells[-2] < _SHORT) & (cells[-2] < 1.0)).any()
        ),
        "cells are too small to be cut",
    )
    axis = np.clip(axis, 0, len(cells) // 2 - 1)
    inner, first, second = cells[:, axis == 0], *(cells[:, axis > 0] for _ in range(2))
    inner[-1] = (inner[-2] + inner[-1]) / 2
    i, j = axis[axis > 0] - 1, np.arange(len(first.T))
    h = len(cells) // 2 - 1 + i
    for half, sign in ((first, -1), (second, 1)):
        half[h, j] /= 2
        half[i, j] += sign * half[h, j]
    return [inner, first, second]
