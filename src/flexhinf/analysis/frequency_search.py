"""Peaks and zeros of functions of frequency: found on a grid, and refined between its points."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

#: Peaks that are refined: those above this fraction of the largest. Steps of the refinement at most.
NEAR, PEAK_STEPS = 0.9, 60

#: The golden section, and how often it is taken instead of a parabola.
GOLDEN, EVERY = 0.381966, 3

#: Steps towards a zero at most.
ZERO_STEPS = 120

#: By what a peak still grows, relative to it, and the relative width of the bracket of a zero, where refinement ends.
ACCURACY = 1e-12


def highest_peak(
    function: Callable[[np.ndarray], np.ndarray],
    grid: np.ndarray,
    values: np.ndarray | None = None,
    accuracy: float = ACCURACY,
) -> tuple[float, float]:
    """(largest value, where) of a function, every high peak of a sweep refined between its neighbours.

    The next point is the vertex of a parabola through three, every third time the golden section of the longer side.

    Parameters
    ----------
    function : callable
        Frequencies (F,) → real values (F,).
    grid : (F,) array
        Ascending.
    values : (F,) array, optional
        Of the function on the grid, where they are known.
    accuracy : float
        By what the parabola rises above the largest value found, relative to it, where the refinement ends.
    """
    values = function(grid) if values is None else values
    k = int(values.argmax())
    best, at = float(values[k]), float(grid[k])
    inside = values[1:-1]
    high = (inside >= values[:-2]) & (inside >= values[2:]) & (inside >= NEAR * best)
    places = np.flatnonzero(high) + np.array([[0], [1], [2]])
    if not places.size:
        return best, at
    x, y = grid[places], values[places]
    for turn in range(PEAK_STEPS):
        low, middle, up = x
        longer = np.where(middle - low > up - middle, low, up)
        new, parabolic = middle + GOLDEN * (longer - middle), turn % EVERY != EVERY - 1
        if parabolic:
            vertex, height = _vertex(x, y)
            new = np.where((vertex > low) & (vertex < up), vertex, new)
            if np.all(height - y[1] <= accuracy * best):
                break
        x, y = _narrowed(np.vstack([x, new]), np.vstack([y, function(new)]))
    which = int(y[1].argmax())
    return max((best, at), (float(y[1, which]), float(x[1, which])))


def _vertex(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices of parabolas through three points each, (3, P), and their heights; NaN or infinite for lines."""
    left, right = x[0] - x[1], x[2] - x[1]
    with np.errstate(all="ignore"):
        by_left, by_right = (y[0] - y[1]) / left, (y[2] - y[1]) / right
        curvature = (by_right - by_left) / (right - left)
        slope = by_left - curvature * left
        return x[1] - 0.5 * slope / curvature, y[1] - 0.25 * slope**2 / curvature


def _narrowed(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of four points each, (4, P), the larger of the inner two and its neighbours, (3, P)."""
    order = np.argsort(x, axis=0, kind="stable")
    x, y = np.take_along_axis(x, order, axis=0), np.take_along_axis(y, order, axis=0)
    kept = y[1:3].argmax(axis=0) + np.array([[0], [1], [2]])
    return np.take_along_axis(x, kept, axis=0), np.take_along_axis(y, kept, axis=0)


def crossings(
    function: Callable[[np.ndarray], np.ndarray], grid: np.ndarray, values: np.ndarray | None = None
) -> list[tuple[int, float]]:
    """Zeros between neighbouring points of a grid at which a branch changes its sign.

    Parameters
    ----------
    function : callable
        Frequencies (F,) → real values (F, k), one column per branch, each continuous.
    grid : (F,) array
        Ascending.
    values : (F, k) array, optional
        Of the function on the grid, where they are known.

    Returns
    -------
    list of (branch, frequency)
    """
    values = function(grid) if values is None else values
    rows, branches = sign_changes(values)
    return list(
        zip(branches.tolist(), refined_crossings(function, grid, values, rows, branches), strict=True)
    )


def sign_changes(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(k, branch) of all changes of the sign from row k to the next, of (F, k) values."""
    signs = np.sign(values)
    rows, branches = np.nonzero((signs[1:] != signs[:-1]) & (signs[1:] * signs[:-1] <= 0.0))
    return rows, branches


def refined_crossings(
    function: Callable[[np.ndarray], np.ndarray],
    grid: np.ndarray,
    values: np.ndarray,
    rows: np.ndarray,
    branches: np.ndarray,
    accuracy: float = ACCURACY,
) -> list[float]:
    """The zero between grid[row] and grid[row + 1] of each branch whose sign changes there.

    False position with the weight of an end halved that stays (Illinois), every third time the middle of the bracket.
    """
    if not len(rows):
        return []
    low, high = grid[rows], grid[rows + 1]
    below, above = values[rows, branches], values[rows + 1, branches]
    which, last = np.arange(len(rows)), np.zeros(len(rows))
    for turn in range(ZERO_STEPS):
        middle = 0.5 * (low + high)
        if turn % EVERY != EVERY - 1:
            with np.errstate(all="ignore"):
                position = low - below * (high - low) / (above - below)
            # A little inside, so that the other end follows a zero that has been reached.
            margin = 0.4 * accuracy * high
            middle = np.where(np.isfinite(position), np.clip(position, low + margin, high - margin), middle)
        value = function(middle)[which, branches]
        side = np.where(np.sign(value) == np.sign(below), 1.0, -1.0)
        low, high = np.where(side > 0.0, middle, low), np.where((side < 0.0) | (value == 0.0), middle, high)
        low = np.where(value == 0.0, middle, low)
        stays = np.where(side == last, 0.5, 1.0)
        below, above = (
            np.where(side > 0.0, value, below * stays),
            np.where(side > 0.0, above * stays, value),
        )
        last = side
        if np.all(high - low <= accuracy * high):
            break
    return (0.5 * (low + high)).tolist()
