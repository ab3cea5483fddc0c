"""The largest value of a function over a box, and with it the worst plant of a box for the worst disturbance.

`climb` is implicit filtering [kelley2011] over the unit box, from several starts at once. Around each start the
function is evaluated at ± one step along every axis. Central differences give the gradient, second differences the
curvature along each axis. Points along the gradient, the corner that it points to, a Newton step and points ahead on
the way of the last moves are tried, and the best of all becomes the next centre; where none is better, the step is a
quarter as long. So the gradient leads while the step is long, and what is left is a search over a grid that shrinks:
the function need neither be smooth nor free of jumps, as a settling time is not. Every round is one call with the
points of all searches, so that lanes and threads are full. Searches that come to one point go on as one.

`worst_gain` is a lower bound of the gain of one law over all plants of a box. Each plant runs about its own
equilibrium at the goal, from rest there: the deviations of state, input and integrals count from it, as in
`flexhinf.certify.proof`. Where the equilibrium moves by δ, integrals included, the law in these deviations is
k(x + δ) − k(δ). Plant and disturbance are improved in turn: the plant for a given disturbance by `climb`, which needs
no derivatives of the loop by its parameters, then the disturbance for that plant by power iteration, as
`worst_disturbance`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.analysis.batch import LawRows, equilibrium_integrals
from flexhinf.analysis.worst_disturbance import Attained, DisturbanceSearch, ascend_inside
from flexhinf.errors import FlexhinfError, NumericalFailure
from flexhinf.hinf import HJISolution
from flexhinf.plant import GeneralisedPlant, Law

#: First step and the factor of the next one, as fractions of the box; the last one is not shorter than the third.
FIRST_STEP, FACTOR, LAST_STEP = 0.25, 0.25, 2.0**-13

#: Lengths of the steps along the gradient, in steps of the differences.
LENGTHS = (0.5, 1.0, 2.0, 4.0)

#: How far ahead points are tried on the way of the last moves, which follows a ridge.
AHEAD = (1.0, 3.0)

#: Searches at this distance are one, in the smaller one of their steps.
NEAR = 0.25

#: Rounds, at most.
SEARCH_ROUNDS = 200


@dataclass(frozen=True, eq=False)
class Climbed:
    """Where a search ended: point (d,) and value, evaluations of all searches, and how many ended at this point."""

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
        trials = [self.point + length * self.step * direction for length in LENGTHS]
        trials.append(np.where(slope > 0.0, 1.0, np.where(slope < 0.0, 0.0, self.point)))
        with np.errstate(divide="ignore", invalid="ignore"):
            curve = (up / ahead + down / behind) / (0.5 * (ahead + behind))  # nan or inf at a face of the box
            longest = LENGTHS[-1] * self.step
            newton = np.where(np.isfinite(curve) & (curve < 0.0), -slope / curve, longest * np.sign(slope))
        trials.append(self.point + np.clip(newton, -longest, longest))
        better = np.where(up > np.maximum(down, 0.0), ahead, np.where(down > 0.0, -behind, 0.0))
        trials.append(self.point + better)
        trials += [self.point + way * (self.point - old) for old in self.before for way in AHEAD]
        return np.clip(trials, 0.0, 1.0)

    def take(self, points: np.ndarray, values: np.ndarray) -> None:
        """Move to the best point, or look closer."""
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
        """Values of groups of points, in one call."""
        return np.split(function(np.vstack(groups)), np.cumsum([len(group) for group in groups])[:-1])

    searches = [_Search(point, float(value)) for point, value in zip(starts, function(starts))]
    evaluations, best = len(starts), max(searches, key=lambda one: one.value)
    for _ in range(SEARCH_ROUNDS):
        searches = _joined(searches)
        best = max(searches, key=lambda one: one.value)
        progress(evaluations, best.value)
        active = [one for one in searches if one.step >= LAST_STEP]
        if not active or np.isposinf(best.value):
            break
        around = [one.differences() for one in active]
        values = valued(around)
        trials = [one.trials(part) for one, part in zip(active, values)]
        for one, *parts in zip(active, around, trials, values, valued(trials)):
            one.take(np.vstack(parts[:2]), np.concatenate(parts[2:]))
        evaluations += sum(map(len, around)) + sum(map(len, trials))
    return Climbed(best.point, best.value, evaluations, best.starts)


def _joined(searches: list[_Search]) -> list[_Search]:
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


def box_corners(d: int) -> np.ndarray:
    """All corners (2^d, d) of the unit box."""
    return ((np.arange(1 << d)[:, None] >> np.arange(d)) & 1).astype(float)


# The worst plant --------------------------------------------------------------------------------
#: Turns of plant and disturbance at most, and the growth of the gain below which they end.
ROUNDS, GROWTH = 4, 1e-3

#: Newton steps towards the integrals of an equilibrium at most, and the relative error of its input.
ITERATIONS, BALANCED = 20, 1e-12

#: Turns of each ascent of the disturbance.
TURNS = 6


class MovedLaw(Law):
    """A law in deviations from the equilibrium of another problem's plant at the goal: k(x + δ) − k(δ). A
    NumericalFailure says that no integrals make the law hold that plant there."""

    def __init__(self, law: Law, problem: GeneralisedPlant) -> None:
        self.law, self.state_names, self.input_names = law, tuple(law.state_names), tuple(law.input_names)
        self.operating_point = np.array(problem.operating_point, dtype=float)
        self.operating_input = np.array(problem.operating_input, dtype=float)
        n, rows = len(law.plant_states), LawRows(law)
        integrals = equilibrium_integrals(rows, self.operating_point[:n], self.operating_input)
        start = np.concatenate([self.operating_point[:n], integrals]) - law.operating_point
        moved, wanted = start.copy(), self.operating_input - law.operating_input
        for _ in range(
            ITERATIONS
        ):  # Newton's method: integrals with which the law gives the input that is wanted
            value, slope = rows(moved[None, :])
            gap = wanted - value[0]
            if np.abs(gap).max() <= BALANCED * max(1.0, np.abs(wanted).max()):
                self._data = np.concatenate([np.ravel(law.law_data), moved, value[0]])
                return
            moved[n:] += np.linalg.lstsq(slope[0][:, n:], gap, rcond=None)[0]
            if not np.all(np.isfinite(moved)):
                break
        raise NumericalFailure(
            "The law does not hold the plant at the goal.",
            f"no integrals near {np.array2string(start[n:], precision=6)} give the input that balances it",
            "another degree, or a law made for this goal",
        )

    @property
    def law_key(self) -> str:
        """That of the law: δ is data."""
        return f"moved {self.law.law_key}"

    @property
    def law_data(self) -> np.ndarray:
        """The law's, then δ (n,) and k(δ) (m,)."""
        return self._data

    def evaluate_law(self, x: Any, data: Any) -> Any:
        """k(x + δ) − k(δ)."""
        n, m = len(self.state_names), len(self.input_names)
        return self.law.evaluate_law(x + data[-n - m : -m], data[: -n - m]) - data[-m:]


@dataclass(frozen=True, eq=False)
class WorstGain:
    """The plant, a point (d,) of the unit box, its worst disturbance, and the runs of the search over plants."""

    point: np.ndarray
    attained: Attained
    runs: int


def worst_gain(
    problem_at: Callable[[np.ndarray], GeneralisedPlant],
    law: HJISolution,
    start: np.ndarray,
    first: Attained,
    *,
    level: float,
    period: float,
    horizon: float,
    starts: np.ndarray | None = None,
) -> WorstGain:
    """The plant of a box, and the disturbance of it, with the largest ∫|z|²/∫|d|² that is found, under a law with the
    true state fed back.

    `problem_at` takes a point (d,) of the unit box to the problem of that plant, about its own equilibrium; where it
    raises a `FlexhinfError` there is none, and the plant is left out. The search begins at `start` (d,), the nominal
    plant, and at `starts` (S, d), with the worst disturbance `first` of the nominal plant, whose period and horizon,
    s, are given too. V of the deviation from each plant's own equilibrium stays below `level`.
    """
    point = np.asarray(start, dtype=float)
    others = np.empty((0, len(point))) if starts is None else starts
    best, runs = WorstGain(point, first, 0), 0

    def searched(point: np.ndarray) -> tuple[DisturbanceSearch, np.ndarray]:
        """The search of a plant, and the best disturbance (N, k) at its times."""
        problem = problem_at(point)
        search = DisturbanceSearch(problem, MovedLaw(law, problem), None, period, horizon)
        place = np.searchsorted(best.attained.times, search.search_runs.times + 1e-9, side="right") - 1
        return search, best.attained.disturbance[place]

    def gains(points: np.ndarray) -> np.ndarray:
        """Of plants (N, d) under the best disturbance, at the period of the search; −inf where there is none."""
        found = []
        for one in points:
            try:
                search, d = searched(one)
                found.append(search.search_runs.attained(d).gain)
            except FlexhinfError:
                found.append(-np.inf)
        return np.array(found)

    for _ in range(ROUNDS):
        found = climb(gains, np.vstack([best.point, others]))
        others, runs = others[:0], runs + found.evaluations
        search, d = searched(found.point)
        attained = ascend_inside(search, d, level, TURNS, law)
        grown = attained.gain > best.attained.gain * (1.0 + GROWTH) and attained.largest_value <= level
        if attained.gain > best.attained.gain and attained.largest_value <= level:
            best = WorstGain(found.point, attained, runs)
        if not grown:
            break
    return WorstGain(best.point, best.attained, runs)
