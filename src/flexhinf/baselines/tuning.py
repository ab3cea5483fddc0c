"""A law tuned over all its parameters for one cost, within stated limits.

The parameters are positive and searched on a logarithmic scale: by a Latin hypercube about the start; from the best of
it by covariance matrix adaptation [hansen2016], which samples round a mean and lets the ranking of the samples move it
and shape the next ones, because settling times jump and leave several local minima; and by the simplex of [nelder1965]
from the best candidate. A limit that is exceeded adds to the cost by its relative excess, so the search can slide along
it; the result is the cheapest candidate that exceeds none. The search is short: it finds a good law, not the best there
is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import inf, isfinite, log
from typing import Any

import numpy as np

from flexhinf.errors import FlexhinfError, InvalidInput

#: Standard deviation of the first samples, as a part of the way between the bounds, which counts up to so much, both in
#: logarithms.
SPREAD, WIDEST = 0.12, 6.0

#: One of so many samples belongs to a Latin hypercube about the start, from the best of which the adaptation begins.
COARSE = 4

#: Cost of an excess by a factor e: large against costs, which are near one, so that no limit is traded for cost.
PENALTY = 10.0

#: Cost of a candidate that could not be judged: more than that of any that could.
UNJUDGED = 1e6

#: What a value may exceed its limit by, relative.
ROUNDING = 1e-9

#: Factor by which each parameter is moved to begin the simplex.
SIMPLEX = 1.35


@dataclass(frozen=True)
class Judgement:
    """Evaluation of one set of parameters.

    `cost` is to be small, infinite where it is not known. `excess` is the sum over the limits of ln(value / limit)
    where it is exceeded; 0 where all are kept, infinite where a limit cannot be checked (an unstable loop). `reason`
    says which limits are exceeded, empty for none, and `result` is what the caller wants to keep.
    """

    cost: float
    excess: float = 0.0
    reason: str = ""
    result: Any = None


@dataclass(frozen=True)
class Candidate:
    """A set of parameters and its evaluation."""

    parameters: Mapping[str, float]
    judgement: Judgement

    @property
    def feasible(self) -> bool:
        """Whether it keeps every limit and has a cost."""
        return self.judgement.excess == 0.0 and isfinite(self.judgement.cost)

    @property
    def order(self) -> tuple[float, float]:
        """Sort key: feasible candidates first, by cost; then the others, by how far they exceed the limits."""
        j = self.judgement
        return (0.0, j.cost) if self.feasible else (1.0 + j.excess, j.cost)


@dataclass(frozen=True)
class Tuning:
    """All candidates that a search tried, in order, and the best: the cheapest that keeps every limit; where none
    does, the one that exceeds them least."""

    best: Candidate
    candidates: tuple[Candidate, ...]


def excess(value: float, limit: float) -> float:
    """ln(value / limit) where a value is above its limit, else 0; infinite for a value that is not finite.

    A value within rounding of its limit keeps it: where a limit is the design's own value, the design itself does.
    """
    if not isfinite(value):
        return inf
    return 0.0 if value <= limit * (1.0 + ROUNDING) else log(value / limit)


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
    start, bounds : mappings of str to float, and to (lower, upper)
        The first candidate, positive, and the bounds that each parameter lies between.
    samples, refinements : int
        Candidates of hypercube (without `others`) and covariance matrix adaptation together, and of the simplex, at
        most.
    seed : int
        Of the samples.
    others : sequence of mapping of str to float
        Candidates that are tried beside the start, moved into the bounds: for example results for similar laws.

    Raises `InvalidInput` if starts, bounds or counts do not fit each other.
    """
    fits = set(start) == set(bounds) and samples >= 0 and refinements >= 0
    if not fits or not all(0.0 < bounds[n][0] <= start[n] <= bounds[n][1] < inf for n in start):
        raise InvalidInput(
            "The search for parameters is not well posed.",
            f"expected starts within their bounds, got {dict(start)}, {dict(bounds)}, {samples=}, {refinements=}",
            "tune(judge, {'bandwidth': 5.0}, {'bandwidth': (0.5, 50.0)})",
        )
    names = tuple(start)
    low, high = np.log([bounds[name] for name in names]).T.reshape(2, -1)
    tried: list[Candidate] = []

    def cost(point: np.ndarray, exact: Mapping[str, float] | None = None) -> float:
        values = np.exp(np.clip(point, low, high)) if exact is None else [exact[name] for name in names]
        parameters = {name: float(value) for name, value in zip(names, values)}
        try:
            judgement = judge(parameters)
        except FlexhinfError as error:
            judgement = Judgement(inf, inf, str(error).splitlines()[0])
        tried.append(Candidate(parameters, judgement))
        beyond = float(np.abs(point - np.clip(point, low, high)).sum())
        if not isfinite(judgement.excess):
            return UNJUDGED + beyond
        return min(judgement.cost, UNJUDGED / 10.0) + PENALTY * (judgement.excess + beyond)

    exact = [{n: float(np.clip(values[n], *bounds[n])) for n in names} for values in (start, *others)]
    spread = 0 if others else samples // COARSE  # from values that are good elsewhere it begins at once
    points = [np.log([values[name] for name in names]) for values in exact]
    # Other laws' values are tried to the last bit.
    costs = [cost(point, values) for point, values in zip(points, exact)]
    if names and spread:
        from scipy.stats import qmc

        begin = np.log([start[name] for name in names])
        lower, upper = (begin + low) / 2.0, (begin + high) / 2.0
        cube = qmc.LatinHypercube(len(names), rng=np.random.default_rng(seed)).random(spread)
        scattered = lower + cube * (upper - lower)
        points, costs = [*points, *scattered], [*costs, *map(cost, scattered)]
    if names:
        first = points[int(np.argmin(costs))]
        mean, lowest = _adapted(cost, first, low, high, samples - spread, np.random.default_rng(seed))
        if refinements:
            from scipy.optimize import minimize

            best, step = first if min(costs) <= lowest else mean, np.log(SIMPLEX)
            corners = [
                best,
                *(best + np.where(best + step > high, -step, step) * axis for axis in np.eye(len(best))),
            ]
            options = {"initial_simplex": np.clip(corners, low, high), "maxfev": refinements}
            minimize(cost, best, method="Nelder-Mead", options={**options, "xatol": 1e-3, "fatol": 1e-4})
    return Tuning(min(tried, key=lambda candidate: candidate.order), tuple(tried))


def _adapted(
    cost: Callable[[np.ndarray], float],
    mean: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    samples: int,
    rng: np.random.Generator,
) -> tuple[np.ndarray, float]:
    n, best, lowest = len(mean), mean, inf
    count = 4 + int(3.0 * log(n))  # this and the other constants as in [hansen2016]
    weights = np.log((count + 1.0) / 2.0) - np.log(np.arange(1, count // 2 + 1))
    weights /= weights.sum()
    effective = 1.0 / float(weights @ weights)
    c_step = (effective + 2.0) / (n + effective + 5.0)
    damping = 1.0 + c_step + 2.0 * max(0.0, np.sqrt((effective - 1.0) / (n + 1.0)) - 1.0)
    c_path = (4.0 + effective / n) / (n + 4.0 + 2.0 * effective / n)
    c_one = 2.0 / ((n + 1.3) ** 2 + effective)
    c_many = min(1.0 - c_one, 2.0 * (effective - 2.0 + 1.0 / effective) / ((n + 2.0) ** 2 + effective))
    expected = np.sqrt(n) * (1.0 - 1.0 / (4.0 * n) + 1.0 / (21.0 * n**2))  # of the length of a normal vector
    scale, step, shape = np.minimum(high - low, WIDEST), SPREAD, np.eye(n)
    step_path, shape_path = np.zeros(n), np.zeros(n)
    for generation in range(1, samples // count + 1):
        sizes, axes = np.linalg.eigh(shape)
        root = axes * np.sqrt(np.maximum(sizes, 1e-12)) @ axes.T
        moves = rng.standard_normal((count, n)) @ root
        points = mean + step * scale * moves
        costs = np.array([cost(point) for point in points])
        order = np.argsort(costs, kind="stable")[: len(weights)]
        if costs[order[0]] < lowest:
            best, lowest = points[order[0]], float(costs[order[0]])
        chosen, move = moves[order], weights @ moves[order]
        mean = np.clip(mean + step * scale * move, low, high)
        normal = np.linalg.solve(root, move)
        step_path = (1.0 - c_step) * step_path + np.sqrt(c_step * (2.0 - c_step) * effective) * normal
        length, shape_path = float(np.linalg.norm(step_path)), (1.0 - c_path) * shape_path
        if length / np.sqrt(1.0 - (1.0 - c_step) ** (2 * generation)) < (1.4 + 2.0 / (n + 1.0)) * expected:
            shape_path = shape_path + np.sqrt(c_path * (2.0 - c_path) * effective) * move
        shape = (
            (1.0 - c_one - c_many) * shape
            + c_one * np.outer(shape_path, shape_path)
            + c_many * (chosen.T * weights) @ chosen
        )
        step *= float(np.exp(c_step / damping * (length / expected - 1.0)))
    return best, lowest
