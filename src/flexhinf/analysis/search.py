"""The largest value of a function over a box; and peaks and zeros of functions of frequency, on a grid and refined
between its points.

`climb` is implicit filtering [kelley2011] over the unit box, from several starts at once. Around each start the
function is evaluated at ± one step along every axis. Central differences give the gradient, second differences the
curvature along each axis. The search tries points along the gradient, the corner in its direction, a Newton step and an
extrapolation of the last moves. The best point becomes the next centre; if none is better, the step is reduced to a
quarter. So the search follows the gradient while the step is long, and ends as a search on a shrinking grid. The
function need not be smooth or continuous; a settling time is neither. Every round is one call with the
points of all searches, so that lanes and threads are full. Searches that reach one point are merged.
"""

# Not checked strictly: rows of arrays that are unpacked have no type.
# pyright: reportUnknownArgumentType=false, reportUnknownVariableType=false

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

#: First step and the factor of the next one, as fractions of the box; the last one is not shorter than the third.
FIRST_STEP, FACTOR, LAST_STEP = 0.25, 0.25, 2.0**-13

#: Lengths of the steps along the gradient, in steps of the differences.
LENGTHS = (0.5, 1.0, 2.0, 4.0)

#: Lengths of the extrapolation of the last moves, which follows a ridge.
AHEAD = (1.0, 3.0)

#: Searches closer than this distance, in units of the smaller step, are merged.
NEAR = 0.25

#: Rounds, at most.
SEARCH_ROUNDS = 200


class Climbed(NamedTuple):
    """The end of a search from several starts."""

    point: np.ndarray  # (d,)
    value: float
    evaluations: int  # of all searches
    together: int  # searches that ended at this point


@dataclass(eq=False)
class _Climber:
    point: np.ndarray  # the centre
    value: float
    step: float = FIRST_STEP
    starts: int = 1  # that it stands for
    before: tuple[np.ndarray, ...] = ()  # its last two centres

    def differences(self) -> np.ndarray:  # (2d, d)
        moves = self.step * np.eye(len(self.point))
        return np.clip(self.point + np.vstack([moves, -moves]), 0.0, 1.0)

    def trials(self, values: np.ndarray) -> np.ndarray:
        """Trial points (K, d) from the values (2d,) at the points of the differences."""
        d, around = len(self.point), self.differences()
        ahead, behind = around[:d].diagonal() - self.point, self.point - around[d:].diagonal()
        here = self.value if np.isfinite(self.value) else 0.0
        up, down = (np.where(np.isfinite(v), v - here, 0.0) for v in (values[:d], values[d:]))
        slope = (up - down) / (ahead + behind)
        largest = np.abs(slope).max()
        if not (np.isfinite(self.value) and largest > 0.0):
            return self.point[None, :]
        direction, longest = slope / largest, LENGTHS[-1] * self.step
        with np.errstate(divide="ignore", invalid="ignore"):
            curve = (up / ahead + down / behind) / (0.5 * (ahead + behind))  # nan or inf at a face of the box
            newton = np.where(np.isfinite(curve) & (curve < 0.0), -slope / curve, longest * np.sign(slope))
        trials = [
            *(self.point + length * self.step * direction for length in LENGTHS),
            np.where(slope > 0.0, 1.0, np.where(slope < 0.0, 0.0, self.point)),
            self.point + np.clip(newton, -longest, longest),
            self.point + np.where(up > np.maximum(down, 0.0), ahead, np.where(down > 0.0, -behind, 0.0)),
            *(self.point + way * (self.point - old) for old in self.before for way in AHEAD),
        ]
        return np.clip(trials, 0.0, 1.0)

    def take(self, points: np.ndarray, values: np.ndarray) -> None:
        best = int(np.argmax(values))
        if values[best] > self.value:
            self.before = (self.point, *self.before[:1])
            self.point, self.value = points[best], float(values[best])
        else:
            self.step *= FACTOR


def climb(
    function: Callable[[np.ndarray], np.ndarray],
    starts: np.ndarray,
    progress: Callable[[int, float], None] = lambda runs, best: None,
) -> Climbed:
    """The best point of all searches from starts (S, d); a start itself where nothing is better.

    The function takes points (N, d) inside the unit box to values (N,); −inf where there is none, inf ends the search.
    `progress` is called after every round with the evaluations so far and the best value.
    """

    def valued(groups: list[np.ndarray]) -> list[np.ndarray]:
        return np.split(function(np.vstack(groups)), np.cumsum([len(group) for group in groups])[:-1])

    searches = [_Climber(point, float(value)) for point, value in zip(starts, function(starts))]
    evaluations, best = len(starts), max(searches, key=lambda search: search.value)
    for _ in range(SEARCH_ROUNDS):
        searches = _merged(searches)
        best = max(searches, key=lambda search: search.value)
        progress(evaluations, best.value)
        active = [search for search in searches if search.step >= LAST_STEP]
        if not active or np.isposinf(best.value):
            break
        around = [search.differences() for search in active]
        values = valued(around)
        trials = [search.trials(part) for search, part in zip(active, values)]
        for search, *parts in zip(active, around, trials, values, valued(trials)):
            search.take(np.vstack(parts[:2]), np.concatenate(parts[2:]))
        evaluations += sum(map(len, around)) + sum(map(len, trials))
    return Climbed(best.point, best.value, evaluations, best.starts)


def _merged(searches: list[_Climber]) -> list[_Climber]:
    """The searches by falling values, those near to a better one merged with it; the first start wins a tie."""
    every = sorted(searches, key=lambda search: -search.value)
    points, steps = np.array([search.point for search in every]), np.array([search.step for search in every])
    kept: list[int] = []
    for k, search in enumerate(every):
        apart = np.abs(points[kept] - points[k]).max(axis=1, initial=0.0)
        near = np.flatnonzero(apart <= NEAR * np.minimum(steps[kept], steps[k]))
        if len(near):
            every[kept[int(near[0])]].starts += search.starts
        else:
            kept.append(k)
    return [every[k] for k in kept]


def box_corners(d: int) -> np.ndarray:
    """All corners (2^d, d) of the unit box."""
    return ((np.arange(1 << d)[:, None] >> np.arange(d)) & 1).astype(float)


# On a grid ------------------------------------------------------------------------------------------
#: Peaks that are refined: those above this fraction of the largest. Steps of the refinement at most.
HIGH, PEAK_STEPS = 0.9, 60

#: The golden section, and the interval of steps at which it replaces a parabola.
GOLDEN, EVERY = 0.381966, 3

#: Steps towards a zero at most.
ZERO_STEPS = 120

#: Relative growth of a peak, and relative width of a zero's bracket, at which refinement ends.
ACCURACY = 1e-12


def highest_peak(
    function: Callable[[np.ndarray], np.ndarray],
    grid: np.ndarray,
    values: np.ndarray | None = None,
    accuracy: float = ACCURACY,
) -> tuple[float, float]:
    """(largest value, where) of a function of frequencies (F,), every high peak on an ascending grid refined between
    its neighbours; its values on the grid may be known.

    The next point is the vertex of a parabola through three, every third time the golden section of the longer side.
    The refinement ends where the parabola rises above the largest value by less than the accuracy, relative to it.
    """
    values = function(grid) if values is None else values
    k = int(values.argmax())
    best, at = float(values[k]), float(grid[k])
    inside = values[1:-1]
    high = (inside >= values[:-2]) & (inside >= values[2:]) & (inside >= HIGH * best)
    places = np.flatnonzero(high) + np.array([[0], [1], [2]])
    if not places.size:
        return best, at
    x, y = grid[places], values[places]
    for turn in range(PEAK_STEPS):
        low, middle, up = x
        longer = np.where(middle - low > up - middle, low, up)
        new, parabolic = middle + GOLDEN * (longer - middle), turn % EVERY != EVERY - 1
        if parabolic:
            left, right = x[0] - x[1], x[2] - x[1]
            with np.errstate(all="ignore"):  # three points on a line have no vertex
                by_left, by_right = (y[0] - y[1]) / left, (y[2] - y[1]) / right
                curvature = (by_right - by_left) / (right - left)
                slope = by_left - curvature * left
                vertex, height = x[1] - 0.5 * slope / curvature, y[1] - 0.25 * slope**2 / curvature
            new = np.where((vertex > low) & (vertex < up), vertex, new)
            if np.all(height - y[1] <= accuracy * best):
                break
        # The larger of the inner two of four points, and its neighbours.
        x, y = np.vstack([x, new]), np.vstack([y, function(new)])
        order = np.argsort(x, axis=0, kind="stable")
        x, y = np.take_along_axis(x, order, axis=0), np.take_along_axis(y, order, axis=0)
        kept = y[1:3].argmax(axis=0) + np.array([[0], [1], [2]])
        x, y = np.take_along_axis(x, kept, axis=0), np.take_along_axis(y, kept, axis=0)
    which = int(y[1].argmax())
    return max((best, at), (float(y[1, which]), float(x[1, which])))


def crossings(
    function: Callable[[np.ndarray], np.ndarray], grid: np.ndarray, values: np.ndarray | None = None
) -> list[tuple[int, float]]:
    """Zeros (branch, frequency) between neighbouring points of an ascending grid (F,) at which a branch changes its
    sign.

    The function takes frequencies (F,) to real values (F, k), one column per branch, each continuous; on the grid they
    may be known.
    """
    values = function(grid) if values is None else values
    rows, branches = sign_changes(values)
    refined = refined_crossings(function, grid, values, rows, branches)
    return list(zip(branches.tolist(), refined, strict=True))


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
        zero = value == 0.0
        low, high = np.where((side > 0.0) | zero, middle, low), np.where((side < 0.0) | zero, middle, high)
        stays = np.where(side == last, 0.5, 1.0)
        below, above = np.where(side > 0.0, [value, above * stays], [below * stays, value])
        last = side
        if np.all(high - low <= accuracy * high):
            break
    return (0.5 * (low + high)).tolist()
