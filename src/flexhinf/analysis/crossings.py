"""Where a function of frequency crosses a level."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

__all__ = ["crossings"]

#: Halvings of a bracket: to the last digits.
HALVINGS = 50


def crossings(function: Callable[[np.ndarray], np.ndarray], grid: np.ndarray) -> list[tuple[int, float]]:
    """Zeros between neighbouring points of a grid at which a branch changes its sign.

    Parameters
    ----------
    function : callable
        Frequencies (F,) → real values (F, k), one column per branch, each continuous.
    grid : (F,) array
        Ascending.

    Returns
    -------
    list of (branch, frequency)
    """
    signs = np.sign(function(grid))
    rows, branches = np.nonzero((signs[1:] != signs[:-1]) & (signs[1:] * signs[:-1] <= 0.0))
    if not len(rows):
        return []
    low, high, before = grid[rows], grid[rows + 1], signs[rows, branches]
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        same = np.sign(function(middle))[np.arange(len(rows)), branches] == before
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return list(zip(branches.tolist(), (0.5 * (low + high)).tolist(), strict=True))
