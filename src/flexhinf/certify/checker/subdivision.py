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
from flexhinf.certify.checker.second_route import Cell, EveryCell, Sample

BATCH = 64
_GROWTH = 2.0  # of the interval of ρ after a cell that was accepted
_NARROW, _SHORT = 2.0**-40, 2.0**-24  # half widths and intervals that are not cut: parts would not be exact


@dataclass(frozen=True)
class FaceResult:
    """Result on one face: cells looked at, accepted, accepted by λ > 0; the largest allowance for rounding; a sample of
    cells to be proved again, and how many were proved again on the way."""

    cells: int
    accepted: int
    with_level: int
    rounding: float
    sample: tuple[Cell, ...]
    again: int


def subdivide_face(
    face: Face,
    chosen: Sample | EveryCell,
    *,
    tick: Callable[[int], None] = lambda cells: None,
) -> FaceResult:
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
    return FaceResult(count, accepted, with_level, rounding, tuple(chosen.cells), chosen.count)


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
    i, j = axis[axis > 0] - 1, np.arange(first.shape[1])
    h = len(cells) // 2 - 1 + i
    first[h, j] /= 2
    second[h, j] /= 2
    first[i, j] -= first[h, j]
    second[i, j] += second[h, j]
    return [inner, first, second]
