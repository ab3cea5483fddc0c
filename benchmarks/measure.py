"""Timing on a noisy machine: the two sides take turns, and the ratio of their medians is what counts."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass

__all__ = ["Timing", "alternate", "ratio", "rounds", "timed"]


@dataclass(frozen=True)
class Timing:
    """Seconds per unit of work: smallest and median over the repetitions."""

    best: float
    median: float


def timed(work: Callable[[], object], units: int = 1, repetitions: int = 9, warm: int = 1) -> Timing:
    """Time `work`, which does `units` units of work."""
    return alternate({"": (work, units)}, repetitions, warm)[""]


def alternate(
    works: dict[str, tuple[Callable[[], object], int]], repetitions: int = 9, warm: int = 1
) -> dict[str, Timing]:
    """Time several works in turns A B A B …, so that drift hits all of them."""
    seconds = rounds(works, repetitions, warm)
    return {name: Timing(min(values), statistics.median(values)) for name, values in seconds.items()}


def rounds(
    works: dict[str, tuple[Callable[[], object], int]],
    repetitions: int = 9,
    warm: int = 1,
    clock: Callable[[], float] = time.perf_counter,
) -> dict[str, list[float]]:
    """Seconds per unit of several works in turns, one number for each round.

    With `time.thread_time` as the clock, what other processes take does not count.
    """
    for work, _ in works.values():
        for _ in range(warm):
            work()
    seconds: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(repetitions):
        for name, (work, units) in works.items():
            start = clock()
            work()
            seconds[name].append((clock() - start) / units)
    return seconds


def ratio(first: list[float], second: list[float]) -> float:
    """The median of the ratios of paired rounds: what slows a machine for a while slows both."""
    return statistics.median(a / b for a, b in zip(first, second, strict=True))
