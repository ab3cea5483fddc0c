"""The one search over several numbers, for all that is tuned: weights, scalings, noise levels, laws. And bisection, for
a single number.

A criterion takes named positive numbers to a `Judgement`: by how much each limit is exceeded, and a cost. Of two
candidates the better one exceeds the limits by less in total; of those that keep every limit it has the smaller cost.
So no limit is traded for cost in the result. On its way the search may pass a limit, where a merit falls: the cost and
a large weight times the excess. Metrics may jump, be infinite or be unknown.

The search is that of [rosenbrock1960] on a logarithmic scale, from the best of all starts. It tries a step along each
of n orthonormal directions in turn. A step that is better is taken, and the next one in its direction is longer; one
that is not is halved and turned round. A turn ends with all its moves once more. Where all steps have become short, new
directions are taken: the first is the way come since the last ones, and the others are random and perpendicular to it,
so a search can slide along a limit that is askew. It is short: it comes to a good candidate, not to the best there is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import accumulate, groupby
from math import inf, isfinite, log
from typing import Any, TypeVar, cast

import numpy as np

from flexhinf.errors import FlexhinfError, refuse_if

#: First step, as a part of the way between the bounds, which counts up to so much, both in logarithms.
FIRST_STEP, WIDEST = 0.12, 6.0

#: Growth of a step that is taken; the longest step, relative to the first steps along the same directions, with which
#: new directions are taken; and that of a search that ends.
GROWTH, SHORT, LAST_STEP = 1.5, 0.3, 1.0 / 64.0

#: Weight of the excess in the merit: large against costs, which are near one; and what counts as an unknown cost.
PENALTY, UNKNOWN = 10.0, 1e5

#: What a value may exceed its limit by, relative.
ROUNDING = 1e-9


@dataclass(frozen=True)
class Judgement:
    """Evaluation of one set of parameters.

    `cost` is to be small, infinite where it is not known. `limits` have ln(value / limit) by the text that says which
    limit is exceeded: above 0 where it is, infinite where it cannot be checked. `result` is what the caller keeps.
    """

    cost: float
    limits: Mapping[str, float] = field(default_factory=dict[str, float])
    result: Any = None

    @property
    def excess(self) -> float:
        """Sum of what exceeds the limits; infinite where nothing does and the cost is not known."""
        return sum(max(0.0, beyond) for beyond in self.limits.values()) or (
            0.0 if isfinite(self.cost) else inf
        )

    @property
    def order(self) -> tuple[float, float]:
        """Sort key: by how far limits are exceeded, then by cost."""
        return self.excess, self.cost

    @property
    def merit(self) -> float:
        """What a search lowers, finite."""
        return min(self.cost, UNKNOWN) + PENALTY * min(self.excess, UNKNOWN)

    @property
    def reason(self) -> str:
        """The limits that are exceeded, empty for none."""
        return "; ".join(text for text, beyond in self.limits.items() if beyond > 0.0)


@dataclass(frozen=True)
class Candidate:
    """A set of parameters and its evaluation."""

    parameters: Mapping[str, float]
    judgement: Judgement

    @property
    def feasible(self) -> bool:
        """Whether it keeps every limit and has a cost."""
        return self.judgement.excess == 0.0

    @property
    def order(self) -> tuple[float, float]:
        """Sort key of its judgement."""
        return self.judgement.order


@dataclass(frozen=True)
class Optimum:
    """All candidates that a search tried, in order."""

    candidates: tuple[Candidate, ...]

    @property
    def best(self) -> Candidate:
        """The cheapest that keeps every limit; where none does, the one that exceeds them least."""
        return min(self.candidates, key=lambda candidate: candidate.order)

    @property
    def path(self) -> list[Candidate]:
        """Those that were better than all before, the best last."""
        orders = accumulate((candidate.order for candidate in self.candidates), min)
        return [
            next(group)[0] for _, group in groupby(zip(self.candidates, orders), key=lambda pair: pair[1])
        ]


def excess(value: float, limit: float) -> float:
    """ln(value / limit) where a value is above its limit, else 0; infinite for a value that is not finite.

    A value within rounding of its limit keeps it: the same value computed in another way does.
    """
    if not isfinite(value):
        return inf
    return 0.0 if value <= limit * (1.0 + ROUNDING) else log(value / limit)


def minimise(
    judge: Callable[[Mapping[str, float]], Judgement],
    start: Mapping[str, float],
    bounds: Mapping[str, tuple[float, float]],
    budget: int = 100,
    others: Sequence[Mapping[str, float]] = (),
    seed: int = 0,
) -> Optimum:
    """Search parameters for the smallest cost within their limits.

    Parameters
    ----------
    judge : callable
        ``judge(parameters)`` → `Judgement`. A `FlexhinfError` makes the candidate infeasible, with its text as reason.
    start, bounds : mappings of str to float, and to (lower, upper)
        The first candidate, positive, and the bounds that each parameter lies between.
    budget : int
        Candidates at most, besides the starts.
    others : sequence of mapping of str to float
        Candidates that are tried beside the start, moved into the bounds: for example results for similar laws.
    seed : int
        Of the directions.

    Raises `InvalidInput` if start, bounds and budget do not fit each other.
    """
    fits = set(start) == set(bounds) and budget >= 0
    refuse_if(
        not fits or not all(0.0 < bounds[n][0] <= start[n] <= bounds[n][1] < inf for n in start),
        "The search for parameters is not well posed.",
        f"expected starts within their bounds, got {dict(start)}, {dict(bounds)}, {budget=}",
        "minimise(judge, {'bandwidth': 5.0}, {'bandwidth': (0.5, 50.0)})",
    )
    n, candidates = len(start), list[Candidate]()
    low, high = np.log([bounds[name] for name in start]).T.reshape(2, -1)
    point, least = low, inf

    def better(x: np.ndarray, exact: Mapping[str, float] | None = None) -> bool:
        nonlocal point, least
        # exp(log(bound)) may lie a rounding beyond it, where a later search may not start
        parameters = exact or {n: float(np.clip(value, *bounds[n])) for n, value in zip(start, np.exp(x))}
        try:
            judgement = judge(parameters)
        except FlexhinfError as error:
            judgement = Judgement(inf, {str(error).splitlines()[0]: inf})
        candidates.append(Candidate(parameters, judgement))
        if judgement.merit >= least:
            return False
        point, least = x, judgement.merit
        return True

    for values in (start, *others):  # tried to the last bit
        exact = {name: float(np.clip(values[name], *bounds[name])) for name in start}
        better(np.log(list(exact.values())), exact)
    generator, most = np.random.default_rng(seed), len(candidates) + budget
    axes, steps, longest, origin = np.eye(n), np.ones(n), 1.0, point
    scale = FIRST_STEP * np.minimum(high - low, WIDEST)

    def attempt(move: np.ndarray) -> bool:
        x = np.clip(point + move, low, high)
        return len(candidates) < most and bool(np.any(np.abs(x - point) > ROUNDING)) and better(x)

    while n and longest > LAST_STEP and len(candidates) < most:
        before = point
        for k, axis in enumerate(axes):
            steps[k] *= GROWTH if attempt(steps[k] * scale * axis) else -0.5
        attempt(point - before)
        if np.abs(steps).max() < SHORT * longest:
            random = generator.standard_normal((n, n))
            if moved := bool(np.any(point != origin)):
                random[:, 0] = (point - origin) / np.maximum(scale, ROUNDING)
            longest *= 1.0 if moved else 0.5
            axes, origin = np.linalg.qr(random)[0].T, point
            steps[:] = longest
    return Optimum(tuple(candidates))


Size = TypeVar("Size", float, np.ndarray)
Accepted = TypeVar("Accepted")


def bisected(
    accepts: Callable[[Size], Accepted], good: Size, bad: Size, width: float, relative: bool = True
) -> tuple[Size, Accepted | None]:
    """The last value that is accepted between one that is and one that is not, numbers or arrays, to a width; and what
    `accepts` returned for it (None: no value between was accepted).

    `relative`: whether the width is relative; then the positive values are bisected on a logarithmic scale.
    """
    outcome = None
    while np.max(np.maximum(good / bad, bad / good) - 1.0 if relative else np.abs(good - bad)) > width:
        middle = cast(Size, np.sqrt(good * bad) if relative else 0.5 * (good + bad))
        if tried := accepts(middle):
            good, outcome = middle, tried
        else:
            bad = middle
    return good, outcome
