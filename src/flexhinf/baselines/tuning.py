"""A law tuned over all its parameters for one cost, within stated limits.

The parameters are positive and searched on a logarithmic scale: first a Latin hypercube about the start, then the
simplex of [nelder1965] from the best two of it, because settling times jump and leave several local minima, and once
more from the best that was found, because a simplex may collapse on a limit. A limit that is exceeded adds to the
cost by its relative excess, so the simplex can slide along it; what is returned is the cheapest candidate that
exceeds none. The search is short: it finds a good law, not the best there is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import inf, isfinite, log
from typing import Any

import numpy as np

from flexhinf.errors import FlexhinfError, InvalidInput

__all__ = ["Candidate", "Judgement", "Tuning", "excess", "tune"]

#: Part of the way from the start to each bound, in logarithms, over which the first candidates are spread.
SPREAD = 0.5

#: Cost of an excess by a factor e: large against costs, which are near one, so that no limit is traded for cost.
PENALTY = 10.0

#: Cost of a candidate that could not be judged: more than that of any that could.
UNJUDGED = 1e6

#: A simplex begins from each of so many of the best coarse candidates, and another one from the best of all.
STARTS = 2

#: Factor by which each parameter is moved to begin the simplex.
SIMPLEX = 1.35


@dataclass(frozen=True)
class Judgement:
    """What a set of parameters comes to.

    Attributes
    ----------
    cost : float
        To be small; infinite where it is not known.
    excess : float
        Sum over the limits of ln(value / limit) where it is exceeded; 0 where all are kept, infinite where a limit
        cannot be checked (an unstable loop).
    reason : str
        Which limits are exceeded; empty for none.
    result : object
        What the caller wants to keep.
    """

    cost: float
    excess: float = 0.0
    reason: str = ""
    result: Any = None


@dataclass(frozen=True)
class Candidate:
    """Parameters that were tried, and what they came to.

    Attributes
    ----------
    parameters : mapping of str to float
    judgement : Judgement
    """

    parameters: Mapping[str, float]
    judgement: Judgement

    @property
    def feasible(self) -> bool:
        """Whether it keeps every limit and has a cost."""
        return self.judgement.excess == 0.0 and isfinite(self.judgement.cost)

    @property
    def order(self) -> tuple[float, float]:
        """Feasible ones first, by cost; then the others, by how far they exceed the limits."""
        j = self.judgement
        return (0.0, j.cost) if self.feasible else (1.0 + j.excess, j.cost)


@dataclass(frozen=True)
class Tuning:
    """What a search found.

    Attributes
    ----------
    best : Candidate
        The cheapest that keeps every limit; where none does, the one that exceeds them least.
    candidates : tuple of Candidate
        All that were tried, in order.
    """

    best: Candidate
    candidates: tuple[Candidate, ...]

    @property
    def feasible(self) -> bool:
        """Whether any candidate keeps every limit."""
        return self.best.feasible

    @property
    def reason(self) -> str:
        """Which limits the best candidate exceeds; empty if none."""
        return self.best.judgement.reason


def excess(value: float, limit: float) -> float:
    """ln(value / limit) where a value is above its limit, else 0; infinite for a value that is not finite."""
    if not isfinite(value):
        return inf
    return max(0.0, log(value / limit)) if value > 0.0 else 0.0


def tune(
    judge: Callable[[Mapping[str, float]], Judgement],
    start: Mapping[str, float],
    bounds: Mapping[str, tuple[float, float]],
    samples: int = 16,
    refinements: int = 40,
    seed: int = 0,
    others: Sequence[Mapping[str, float]] = (),
) -> Tuning:
    """Search the parameters of a law for the smallest cost within its limits.

    Parameters
    ----------
    judge : callable
        ``judge(parameters)`` → `Judgement`. A `FlexhinfError` makes the candidate infeasible, with its text as reason.
    start : mapping of str to float
        The first candidate; positive.
    bounds : mapping of str to (lower, upper)
        Of each parameter, with the start between them.
    samples, refinements : int
        Candidates of the Latin hypercube, and of all simplexes together, at most.
    seed : int
        Of the Latin hypercube.
    others : sequence of mapping of str to float
        Candidates that are tried beside the start, moved into the bounds: what similar laws were tuned to.

    Returns
    -------
    Tuning

    Raises
    ------
    InvalidInput
        If starts, bounds or counts do not fit each other.
    """
    _check(start, bounds, samples, refinements)
    names = tuple(start)
    low, high = np.log([bounds[name] for name in names]).T.reshape(2, -1)
    begin = np.log([start[name] for name in names])
    tried: list[Candidate] = []

    def cost(point: np.ndarray) -> float:
        values = np.exp(np.clip(point, low, high))
        tried.append(_judged(judge, {name: float(value) for name, value in zip(names, values)}))
        found = tried[-1].judgement
        beyond = float(np.abs(point - np.clip(point, low, high)).sum())
        if not isfinite(found.excess):
            return UNJUDGED + beyond
        return min(found.cost, UNJUDGED / 10.0) + PENALTY * (found.excess + beyond)

    given = [np.clip(np.log([values[name] for name in names]), low, high) for values in others]
    points = [begin, *given, *_spread(begin, low, high, samples, seed)]
    costs = [cost(point) for point in points]
    if names and refinements:
        each = -(-refinements // (STARTS + 1))
        ends = [_simplex(cost, points[place], low, high, each) for place in np.argsort(costs)[:STARTS]]
        _simplex(cost, min(ends, key=lambda end: end[1])[0], low, high, each)
    return Tuning(min(tried, key=lambda candidate: candidate.order), tuple(tried))


def _check(
    start: Mapping[str, float], bounds: Mapping[str, tuple[float, float]], samples: int, refinements: int
) -> None:
    fits = set(start) == set(bounds) and samples >= 0 and refinements >= 0
    if not fits or not all(0.0 < bounds[n][0] <= start[n] <= bounds[n][1] < inf for n in start):
        raise InvalidInput(
            "The search for parameters is not well posed.",
            f"expected positive starts within their bounds, got {dict(start)} and {dict(bounds)}, "
            f"{samples=}, {refinements=}",
            "tune(judge, {'bandwidth': 5.0}, {'bandwidth': (0.5, 50.0)})",
        )


def _judged(judge: Callable[[Mapping[str, float]], Judgement], values: Mapping[str, float]) -> Candidate:
    try:
        return Candidate(values, judge(values))
    except FlexhinfError as error:
        return Candidate(values, Judgement(inf, inf, str(error).splitlines()[0]))


def _spread(begin: np.ndarray, low: np.ndarray, high: np.ndarray, samples: int, seed: int) -> np.ndarray:
    """A Latin hypercube (samples, parameters) about the start, `SPREAD` of the way to the bounds."""
    from scipy.stats import qmc

    if not len(begin) or not samples:
        return np.zeros((0, len(begin)))
    lower, upper = begin + SPREAD * (low - begin), begin + SPREAD * (high - begin)
    cube = qmc.LatinHypercube(len(begin), rng=np.random.default_rng(seed)).random(samples)
    return lower + cube * (upper - lower)


def _simplex(
    cost: Callable[[np.ndarray], float], best: np.ndarray, low: np.ndarray, high: np.ndarray, refinements: int
) -> tuple[np.ndarray, float]:
    """The point where a simplex ends, and its cost."""
    from scipy.optimize import minimize

    step = np.log(SIMPLEX)
    corners = [best, *(best + np.where(best + step > high, -step, step) * axis for axis in np.eye(len(best)))]
    options = {
        "initial_simplex": np.clip(corners, low, high),
        "maxfev": refinements,
        "xatol": 1e-3,
        "fatol": 1e-4,
    }
    found = minimize(cost, best, method="Nelder-Mead", options=options)
    return found.x, float(found.fun)
