"""How fast a run of the nonlinear loop grows or decays, to be held against the eigenvalues."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import numpy as np

from flexhinf.paper.bench import Outcome

__all__ = ["LONG", "affordable", "growth_rate", "in_two_threads"]

#: Length of the runs, s: a growth of 0.07/s makes a factor of 8 in them, and 1.7 in 8 s.
LONG = 30.0

#: Early and late part of a run, as shares of it.
EARLY, LATE = (0.4, 0.6), (0.8, 1.0)

#: Samples that may be spent on a set of runs: 130 runs of 30 s at 1 kHz.
SAMPLES = 4_000_000

T = TypeVar("T")
R = TypeVar("R")


def affordable(wanted: int, period: float, duration: float = LONG) -> int:
    """How many runs to make of those wanted: all of them unless the period is far below 1 ms."""
    return max(1, min(wanted, int(SAMPLES * period / duration)))


def growth_rate(outcome: Outcome) -> tuple[float, float]:
    """(rate in 1/s, late RMS in rad/s) of the link's velocity; both infinite if the run diverged."""
    if outcome.diverged_at is not None:
        return np.inf, np.inf
    run = outcome.run
    velocity, end = run.signal("state", "link_velocity"), run.time[-1]
    sizes = []
    for first, last in (EARLY, LATE):
        part = velocity[(run.time >= first * end) & (run.time <= last * end)]
        sizes.append(max(float(np.sqrt(np.mean(part**2))), 1e-300))
    return float(np.log(sizes[1] / sizes[0]) / (end * (LATE[0] - EARLY[0]))), sizes[1]


def in_two_threads(function: Callable[[T], R], items: Sequence[T]) -> list[Any]:
    """The first alone, which compiles what the others share; compiled runs let the other thread go on."""
    if not items:
        return []
    first = function(items[0])
    with ThreadPoolExecutor(2) as pool:
        return [first, *pool.map(function, items[1:])]
