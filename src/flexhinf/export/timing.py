"""When the samples of a run were made: lateness, computing time, missed deadlines, and where they lay."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

#: Percentiles by which jitter is told; the last one is the largest value.
PERCENTILES = {"p50": 50.0, "p99": 99.0, "p99.9": 99.9, "p99.99": 99.99, "max": 100.0}


class MissedSpan(NamedTuple):
    """Missed deadlines one after the other.

    Attributes
    ----------
    begin : float
        Time of the first sample, s.
    worst : float
        By how much the latest input of them came after its deadline, s.
    """

    begin: float
    samples: int
    worst: float


@dataclass(frozen=True, eq=False)
class Timing:
    """Times of every sample, s, on the monotonic clock of the system.

    Sample k is due at its time in the run; `woken`, `ready` and `over` count from that moment. Samples are not left
    out: after a delay they are made one after the other until the schedule is met again, as late as they then are. A
    run that is not in real time is due when it gets there: its lateness is zero.

    Attributes
    ----------
    real_time : bool
        Whether the samples waited for the clock.
    time : (N,)
        Of the run.
    woken : (N,)
        Lateness: when the sample began.
    computed : (N,)
        How long the controller's step took.
    ready : (N,)
        When the input was there.
    over : (N,)
        When the simulated robot had made its step and everything was recorded.
    elapsed : float
        From the beginning of the first sample to the end of the last one.
    """

    period: float
    real_time: bool
    time: np.ndarray
    woken: np.ndarray
    computed: np.ndarray
    ready: np.ndarray
    over: np.ndarray
    elapsed: float

    @property
    def missed(self) -> np.ndarray:
        """Samples (N,) whose input was not there before the next sample was due."""
        return self.ready > self.period

    @property
    def overrun(self) -> np.ndarray:
        """Samples (N,) that ended after the next one was due, the simulation of the robot included."""
        return self.over > self.period

    @property
    def slowness(self) -> float:
        """Elapsed time over the time of the run: 1 in real time."""
        return self.elapsed / (self.period * max(1, len(self.time)))

    def missed_spans(self) -> list[MissedSpan]:
        """Where the missed deadlines lay, those with the latest input first."""
        missed = np.concatenate([[False], self.missed, [False]]).astype(int)
        edges = np.flatnonzero(np.diff(missed)).reshape(-1, 2)
        spans = [
            MissedSpan(float(self.time[a]), int(b - a), float(self.ready[a:b].max() - self.period))
            for a, b in edges
        ]
        return sorted(spans, key=lambda span: -span.worst)


def percentiles(values: np.ndarray) -> dict[str, float]:
    """`PERCENTILES` of values (N,): each is a value that occurred, the smallest one that so many are not above.

    Of fewer than 10,000 values the 99.99th percentile is the largest one.
    """
    ordered = np.sort(np.asarray(values, dtype=float))
    places = [max(0, int(np.ceil(share / 100.0 * len(ordered) - 1e-9)) - 1) for share in PERCENTILES.values()]
    return {name: float(ordered[place]) for name, place in zip(PERCENTILES, places, strict=True)}
