"""The largest value of a function over the unit box, from several starts at once: implicit filtering [kelley2011].

Around each start the function is evaluated at ± one step along every axis. Central differences give the gradient,
second differences the curvature along each axis. Points along the gradient, the corner that it points to, a Newton
step and points ahead on the way of the last moves are tried, and the best of all becomes the next centre; where none
is better, the step is a quarter as long. So the gradient leads while the step is long, and what is left is a search
over a grid that shrinks: the function need neither be smooth nor free of jumps, as a settling time is not.

Every round is one call with the points of all searches, so that lanes and threads are full. Searches that come to one
point go on as one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

#: First step and the factor of the next one, as fractions of the box; the last one is not shorter than the third.
FIRST_STEP, FACTOR, LAST_STEP = 0.25, 0.25, 2.0**-13

#: Lengths of the steps along the gradient, in steps of the differences.
LENGTHS = (0.5, 1.0, 2.0, 4.0)

#: How far ahead points are tried on the way of the last moves, which follows a ridge.
AHEAD = (1.0, 3.0)

#: Searches at this distance are one, in the smaller one of their steps.
NEAR = 0.25

#: Rounds, at most.
ROUNDS = 200

Function = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class Climbed:
    """Where a search ended.

    Attributes
    ----------
    point : (d,) array
    evaluations : int
        Of all searches.
    together : int
        How many searches ended at this point.
    """

    point: np.ndarray
    value: float
    evaluations: int
    together: int


@dataclass(eq=False)
class _Search:
    """One search: its centre, the value there, its step, how many starts it stands for, and its last two centres."""

    point: np.ndarray
    value: float
    step: float = FIRST_STEP
    starts: int = 1
    before: tuple[np.ndarray, ...] = ()

    @property
    def ended(self) -> bool:
        return self.step < LAST_STEP

    def differences(self) -> np.ndarray:
        """Centre ± one step along each axis (2d, d), cut off at the box."""
        moves = self.step * np.eye(len(self.point))
        return np.clip(self.point + np.vstack([moves, -moves]), 0.0, 1.0)

    def trials(self, values: np.ndarray) -> np.ndarray:
        """Points (K, d) that the values (2d,) of the differences suggest."""
        d = len(self.point)
        around = self.differences()
        ahead, behind = around[:d].diagonal() - self.point, self.point - around[d:].diagonal()
        here = self.value if np.isfinite(self.value) else 0.0
        up, down = (np.where(np.isfinite(v), v - here, 0.0) for v in (values[:d], values[d:]))
        slope = (up - down) / (ahead + behind)
        largest = np.abs(slope).max()
        if not (np.isfinite(self.value) and largest > 0.0):
            return self.point[None, :]
        direction = slope / largest
        found = [self.point + length * self.step * direction for length in LENGTHS]
        found.append(np.where(slope > 0.0, 1.0, np.where(slope < 0.0, 0.0, self.point)))
        with np.errstate(divide="ignore", invalid="ignore"):
            curve = (up / ahead + down / behind) / (0.5 * (ahead + behind))  # nan or inf at a face of the box
            newton = np.where(
                np.isfinite(curve) & (curve < 0.0), -slope / curve, LENGTHS[-1] * self.step * np.sign(slope)
            )
        found.append(self.point + np.clip(newton, -LENGTHS[-1] * self.step, LENGTHS[-1] * self.step))
        better = np.where(up > np.maximum(down, 0.0), ahead, np.where(down > 0.0, -behind, 0.0))
        found.append(self.point + better)
        found += [self.point + way * (self.point - old) for old in self.before for way in AHEAD]
        return np.clip(found, 0.0, 1.0)

    def take(self, points: np.ndarray, values: np.ndarray) -> None:
        """Move to the best point, or look closer."""
        best = int(np.argmax(values))
        if values[best] > self.value:
            self.before = (self.point, *self.before[:1])
            self.point, self.value = points[best], float(values[best])
        else:
            self.step *= FACTOR


def climb(
    function: Function, starts: np.ndarray, progress: Callable[[int, float], None] = lambda runs, best: None
) -> Climbed:
    """The best point of all searches; a start itself where nothing is better.

    Parameters
    ----------
    function : callable
        Points (N, d) inside the unit box → values (N,); −inf where there is none, inf ends the search.
    starts : (S, d) array
    progress : callable, optional
        Called after every round with the evaluations so far and the best value.
    """
    values = function(starts)
    searches = [_Search(point, float(value)) for point, value in zip(starts, values)]
    evaluations, best = len(starts), max(searches, key=lambda one: one.value)
    for _ in range(ROUNDS):
        searches = _joined(searches)
        best = max(searches, key=lambda one: one.value)
        progress(evaluations, best.value)
        active = [one for one in searches if not one.ended]
        if not active or np.isposinf(best.value):
            break
        around = [one.differences() for one in active]
        found = _split(function, around)
        trials = [one.trials(part) for one, part in zip(active, found)]
        tried = _split(function, trials)
        for one, *parts in zip(active, around, trials, found, tried):
            one.take(np.vstack(parts[:2]), np.concatenate(parts[2:]))
        evaluations += sum(map(len, around)) + sum(map(len, trials))
    return Climbed(best.point, best.value, evaluations, best.starts)


def _split(function: Function, groups: list[np.ndarray]) -> list[np.ndarray]:
    """Values of groups of points, in one call."""
    values = function(np.vstack(groups))
    return np.split(values, np.cumsum([len(group) for group in groups])[:-1])


def _joined(searches: list[_Search]) -> list[_Search]:
    """One search for all that are near a better one."""
    kept: list[_Search] = []
    for one in sorted(searches, key=lambda one: -one.value):  # stable: the first start wins a tie
        near = [
            other for other in kept
            if np.abs(other.point - one.point).max() <= NEAR * min(one.step, other.step)
        ]  # fmt: skip
        if near:
            near[0].starts += one.starts
        else:
            kept.append(one)
    return kept


def corners(d: int) -> np.ndarray:
    """All corners (2^d, d) of the unit box."""
    return ((np.arange(1 << d)[:, None] >> np.arange(d)) & 1).astype(float)
