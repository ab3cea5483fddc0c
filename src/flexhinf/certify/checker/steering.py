"""Where the march looks next, and when it gives up: nothing here can make a claim proved.

A refusal is always sound, and so is each way to cut a cell.
"""

from __future__ import annotations

import numpy as np

from flexhinf.certify.checker.bounds import Bounds
from flexhinf.certify.checker.taylor import CentredForm, TaylorTable

_NARROWEST = 2.0**-15  # half width of the widest t_i: a direction that is not decided there is refused
_EXACT = 2.0**-40  # half width of any t_i, so that t ± h are doubles
_SHORTEST = 2.0**-24  # of an interval of ρ, in units of the reach
_FLAT = 0.02  # an interval of ρ shorter than this times the widest t_i is not cut further


class Refusal(Exception):
    """A claim that is not proved, and why; with the place z, and V there, where it is about one."""

    def __init__(self, why: str, z: np.ndarray | None = None, value: float = float("nan")) -> None:
        super().__init__(why)
        self.z, self.value = z, value


def refuse(
    face: tuple[int, int], cells: np.ndarray, undecided: np.ndarray, bounds: Bounds, reach: float
) -> None:
    """Raise where a cell that is neither finished nor proved is wrong at its centre, or too small to go on.

    The columns of `cells` are t, h, and the ends of the interval of ρ in units of the reach.
    """
    n = len(cells) // 2
    h, begin, end = cells[n - 1 : -2], cells[-2], cells[-1]
    edge, short = begin >= 1.0, end - begin < _SHORTEST
    narrow = (h.max(0) < _NARROWEST) | (h.min(0) < _EXACT) if n > 1 else np.ones(len(end), bool)
    inside = bounds.value < bounds.level
    allowance = bounds.remainder + bounds.rounding
    positive = np.isfinite(allowance) & (bounds.constant > 1e3 * allowance) & (bounds.least_growth > 0)
    for found, why in (
        (edge & undecided & (inside | narrow), "the level set reaches beyond the stated reach"),
        (undecided & inside & positive, "r > 0"),
        (undecided & ~edge & (short if n == 1 else narrow | short), "a cell cannot be decided"),
    ):
        if found.any():
            i = int(np.flatnonzero(found)[0])
            z = np.insert(cells[: n - 1, i], face[0], face[1]) * (begin[i] + end[i]) / 2 * reach
            raise Refusal(why, z, float(bounds.value[i]))


def axis_to_cut(table: TaylorTable, form: CentredForm, cells: np.ndarray) -> np.ndarray:
    """The variable of each cell that adds most to its bound beyond the constant: 0 for ρ, i for the i-th of the t."""
    h, length, edge = cells[table.n - 1 : -2], cells[-1] - cells[-2], cells[-2] >= 1.0
    size = np.abs(form.low) + form.radius
    score = np.abs(form.low[table.square]) + size[table.linear] / 4 + table.in_pair @ size[table.pairs]
    score += (table.terms[table.others] > 0).T.astype(float) @ size[table.others]
    tail = np.c_[np.zeros(len(table.tail_powers)), table.tail_powers > 0].T.astype(float)
    score += tail @ form.tail[:-1]
    score[0] += form.tail[-1]
    axis = np.where(np.isfinite(score), score, 0.0).argmax(0)
    if table.n == 1:
        return axis
    return np.where((axis == 0) & (length < _FLAT * h.max(0)) | edge, 1 + h.argmax(0), axis)
