"""The worst disturbance for the worst plant in a box: a lower bound of the gain of one law over all of them.

Each plant runs about its own equilibrium at the goal, from rest there: the deviations of state, input and integrals
count from it, as in `flexhinf.certify.proof`. Where the equilibrium moves by δ, integrals included, the law in
these deviations is k(x + δ) − k(δ).

Plant and disturbance are improved in turn: the plant for a given disturbance by `climb`, which needs no derivatives of
the loop by its parameters, then the disturbance for that plant by power iteration, as `worst_disturbance`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.analysis.batch import LawRows, equilibrium_integrals
from flexhinf.analysis.box_search import climb
from flexhinf.analysis.worst_disturbance import Attained, DisturbanceSearch, ascend_inside
from flexhinf.errors import FlexhinfError, NumericalFailure
from flexhinf.hinf import HJISolution
from flexhinf.plant import GeneralisedPlant, Law

#: Turns of plant and disturbance at most, and the growth of the gain below which they end.
ROUNDS, GROWTH = 4, 1e-3

#: Newton steps towards the integrals of an equilibrium at most, and the relative error of its input.
ITERATIONS, BALANCED = 20, 1e-12

#: Turns of each ascent of the disturbance.
TURNS = 6


class MovedLaw(Law):
    """A law in deviations from another plant's equilibrium: k(x + δ) − k(δ).

    Parameters
    ----------
    problem : GeneralisedPlant
        Of the other plant, about its equilibrium at the goal.

    Raises
    ------
    NumericalFailure
        If no integrals make the law hold that plant there.
    """

    def __init__(self, law: Law, problem: GeneralisedPlant) -> None:
        self.law, self.state_names, self.input_names = law, tuple(law.state_names), tuple(law.input_names)
        self.operating_point = np.array(problem.operating_point, dtype=float)
        self.operating_input = np.array(problem.operating_input, dtype=float)
        n = len(law.plant_states)
        rows = LawRows(law)
        integrals = equilibrium_integrals(rows, self.operating_point[:n], self.operating_input)
        moved = np.concatenate([self.operating_point[:n], integrals]) - law.operating_point
        moved = _balanced(rows, moved, self.operating_input - law.operating_input, n)
        self._data = np.concatenate([np.ravel(law.law_data), moved, rows(moved[None, :])[0][0]])

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


def _balanced(rows: LawRows, moved: np.ndarray, wanted: np.ndarray, n: int) -> np.ndarray:
    """Deviations (n + k,) near these, their integrals such that the law gives the input (m,) that is wanted.

    Raises
    ------
    NumericalFailure
        If Newton's method does not find them.
    """
    found = moved.copy()
    for _ in range(ITERATIONS):
        value, slope = rows(found[None, :])
        gap = wanted - value[0]
        if np.abs(gap).max() <= BALANCED * max(1.0, np.abs(wanted).max()):
            return found
        found[n:] += np.linalg.lstsq(slope[0][:, n:], gap, rcond=None)[0]
        if not np.all(np.isfinite(found)):
            break
    raise NumericalFailure(
        "The law does not hold the plant at the goal.",
        f"no integrals near {np.array2string(moved[n:], precision=6)} give the input that balances it",
        "another degree, or a law made for this goal",
    )


@dataclass(frozen=True, eq=False)
class WorstGain:
    """What was found.

    Attributes
    ----------
    point : (d,) array
        The plant, in the unit box.
    attained : Attained
        Its worst disturbance.
    runs : int
        Of the search over plants.
    """

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
    """The plant of a box, and the disturbance of it, with the largest ∫|z|²/∫|d|² that is found.

    Parameters
    ----------
    problem_at : callable
        Point (d,) of the unit box → the problem of that plant, about its own equilibrium. A `FlexhinfError`: there is
        none, and the plant is left out.
    law : HJISolution
        With the true state fed back.
    start : (d,) array
        The nominal plant.
    first : Attained
        Its worst disturbance, with which the search begins.
    level : float
        V of the deviation from each plant's own equilibrium stays below it.
    period, horizon : float
        s, those of `first`.
    starts : (S, d) array, optional
        Other plants at which the search begins too.
    """
    point = np.asarray(start, dtype=float)
    others = np.empty((0, len(point))) if starts is None else starts
    best, runs = WorstGain(point, first, 0), 0
    for _ in range(ROUNDS):
        d = _Coarse(problem_at, law, period, horizon, best.attained)
        found = climb(d.gains, np.vstack([best.point, others]))
        others, runs = others[:0], runs + found.evaluations
        search = DisturbanceSearch(
            problem_at(found.point), MovedLaw(law, problem_at(found.point)), None, period, horizon
        )
        attained = ascend_inside(search, d.at(search), level, TURNS, law)
        grown = attained.gain > best.attained.gain * (1.0 + GROWTH) and attained.largest_value <= level
        if attained.gain > best.attained.gain and attained.largest_value <= level:
            best = WorstGain(found.point, attained, runs)
        if not grown:
            break
    return WorstGain(best.point, best.attained, runs)


@dataclass(frozen=True, eq=False)
class _Coarse:
    """Gains of plants under one disturbance, at the period of the search."""

    problem_at: Callable[[np.ndarray], GeneralisedPlant]
    law: HJISolution
    period: float
    horizon: float
    attained: Attained

    def at(self, search: DisturbanceSearch) -> np.ndarray:
        """The disturbance (N, k) at the times of a search."""
        place = np.searchsorted(self.attained.times, search.search_runs.times + 1e-9, side="right") - 1
        return self.attained.disturbance[place]

    def gains(self, points: np.ndarray) -> np.ndarray:
        """(N,) of points (N, d); −inf where there is no such plant."""
        found = []
        for point in points:
            try:
                problem = self.problem_at(point)
                search = DisturbanceSearch(
                    problem, MovedLaw(self.law, problem), None, self.period, self.horizon
                )
                found.append(search.search_runs.attained(self.at(search)).gain)
            except FlexhinfError:
                found.append(-np.inf)
        return np.array(found)
