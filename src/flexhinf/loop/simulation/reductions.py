"""Numbers about a run that are computed while it goes on: the metrics of `Trajectory.metrics`, and a user's own.

A reduction remembers a few numbers, which every sample changes, so that nothing of the run is stored. Its `update` is
traced and compiled like a model: NumPy code on any element, choices by `flexhinf.scalars.where`, `maximum` and so on.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from flexhinf.loop.simulation.metrics import RISE, ROUNDING, SETTLING_BAND, TAIL, tail_of
from flexhinf.scalars import maximum, minimum, where


@dataclass(frozen=True, eq=False)
class Command:
    """What is known of the command before the run, for each of its r channels.

    Attributes
    ----------
    period : float
        s.
    samples : int
        Length of the run.
    first, last : (r,) array
        At the first and at the last sample.
    change : (r,) array
        The first sample at which it differs from the first one; 0 where none does.
    steps : (r,) array of bool
        Whether it stands still in the last tenth of the run, see `flexhinf.loop.step_shape`.
    """

    period: float
    samples: int
    first: np.ndarray
    last: np.ndarray
    change: np.ndarray
    steps: np.ndarray

    @classmethod
    def of(cls, commands: np.ndarray, period: float) -> Command:
        """Of an array (N, r)."""
        change = np.argmax(commands != commands[0], axis=0)
        steps = np.all(tail_of(commands) == commands[-1], axis=0)
        return cls(period, len(commands), commands[0], commands[-1], change, steps)

    @property
    def tail(self) -> int:
        """First sample of the last tenth of the run."""
        return self.samples - len(tail_of(np.empty(self.samples), TAIL))

    def vector(self) -> np.ndarray:
        """What a kernel is given of it, (1 + 3r,): the tail, first, last and change."""
        return np.concatenate([[self.tail], self.first, self.last, self.change])


@dataclass(frozen=True)
class Instant:
    """A sample of a run, as a reduction sees it; arrays of any element.

    Attributes
    ----------
    step : element
        Number of the sample: 0, 1, …
    state, estimate, output, input, reference : arrays
        As in `Trajectory.signals`: the state of the true plant, the estimate from this sample's measurement, the
        measurement, the input that the controller gives, the command.
    tail : element
        First sample of the last tenth of the run.
    first, last, change : (r,) arrays
        See `Command`.
    """

    step: Any
    state: Any
    estimate: Any
    output: Any
    input: Any
    reference: Any
    tail: Any
    first: Any
    last: Any
    change: Any


@dataclass(frozen=True, eq=False)
class Reduction:
    """Numbers about a run that each of its samples changes.

    Parameters
    ----------
    start : sequence of float
        What is remembered before the first sample, (k,).
    update : callable
        What is remembered (k,), and an `Instant`, to what is remembered then.
    result : callable
        What is remembered of N runs at their end, (k, N), and the `Command`, to arrays by name, (N,) or (N, j).
    key : hashable
        Reductions with the same key have the same update. By default the function itself.
    """

    start: Sequence[float]
    update: Callable[[Any, Instant], Any]
    result: Callable[[np.ndarray, Command], dict[str, np.ndarray]]
    key: Hashable = field(default=None)

    @property
    def code_key(self) -> Hashable:
        """What distinguishes the compiled code."""
        return (self.update if self.key is None else self.key), len(self.start)


def update_all(reductions: Sequence[Reduction], remembered: Any, now: Instant) -> Any:
    """What all reductions remember, one behind the other, after a sample."""
    parts, start = [], 0
    for reduction in reductions:
        size = len(reduction.start)
        parts.append(np.asarray(reduction.update(remembered[start : start + size], now)))
        start += size
    return np.concatenate(parts)


@dataclass(frozen=True)
class Place:
    """Where the true value of a tracked state is found, and its column of the command.

    Attributes
    ----------
    kind : {"state", "output", "estimate"}
    """

    kind: str
    column: int
    command: int

    def position(self, now: Instant) -> Any:
        """Its value."""
        return getattr(now, self.kind)[self.column]


def tracking_reductions(place: Place) -> tuple[Reduction, Reduction]:
    """The metrics of `Trajectory.metrics` that are about one tracked state; means of squares to their rounding."""
    step = Reduction(_STEP_START, partial(_step, place), partial(_step_metrics, place), ("step", place))
    error = Reduction((0.0, 0.0), partial(_error, place), _error_metrics, ("error", place))
    return step, error


def common_reductions(known: Sequence[tuple[int, int]]) -> tuple[Reduction, Reduction]:
    """The other metrics of `Trajectory.metrics`.

    Parameters
    ----------
    known : sequence of (int, int)
        Columns of each estimated state whose true value is known: in the estimate and in the true state.
    """
    pairs = tuple(known)
    peak = Reduction((0.0,), _peak, _peak_metric)
    return peak, Reduction((0.0,) * len(pairs), partial(_estimation, pairs), _rms, ("estimation", pairs))


#: Initial position, largest and smallest distance beyond the final command, last sample outside of the settling band,
#: fraction of the step at the sample before; for each level of the rise its sample, and the fraction then and before.
_STEP_START = (0.0, -np.inf, np.inf, -1.0, 0.0, *(-1.0, 0.0, 0.0) * len(RISE))


def _step(place: Place, kept: Any, now: Instant) -> Any:
    """As `flexhinf.loop.step_metrics`, of a sample after the other."""
    position, channel = place.position(now), place.command
    begun = where(now.change[channel] > 0.5, now.first[channel], position)
    initial = where(now.step > 0.5, kept[0], begun)
    return _stepped(kept, now.step, position, (initial, now.last[channel], now.change[channel]))


def _stepped(kept: Any, step: Any, position: Any, shape: tuple[Any, Any, Any]) -> Any:
    """One more sample of a step of this shape: where it begins, where it ends, and its first sample."""
    (_, high, low, outside, before, *crossings), (initial, final, change) = kept, shape
    height, beyond, after = final - initial, position - final, step >= change
    high, low = where(after, maximum(high, beyond), high), where(after, minimum(low, beyond), low)
    band = SETTLING_BAND * abs(height) * (1.0 + ROUNDING)
    outside = where(after, where(abs(beyond) > band, step, outside), outside)
    way = 1.0 + beyond / height
    found = []
    for k, level in enumerate(RISE):
        sample, at, last = crossings[3 * k : 3 * k + 3]
        new = where(after, where(sample < -0.5, where(way >= level, 1.0, 0.0), 0.0), 0.0)
        found += [where(new, step, sample), where(new, way, at), where(new, before, last)]
    return np.array([initial, high, low, outside, way, *found])


def _step_metrics(place: Place, kept: np.ndarray, command: Command) -> dict[str, np.ndarray]:
    """NaN where the command is no step, or of no height; infinite where the run does not settle or rise."""
    height = command.last[place.command] - kept[0]
    found = _stepped_metrics(kept, height, command.change[place.command], command)
    step = (height != 0.0) & command.steps[place.command]
    return {name: np.where(step, values, np.nan) for name, values in found.items()}


def _stepped_metrics(
    kept: np.ndarray, height: np.ndarray, start: float, command: Command
) -> dict[str, np.ndarray]:
    _, high, low, outside, _, *crossings = kept
    period = command.period
    with np.errstate(divide="ignore", invalid="ignore"):
        overshoot = 100.0 * np.maximum(0.0, np.where(height > 0.0, high, low) / height)
        settling = np.where(outside < start, 0.0, outside * period - start * period)
        settling[outside == command.samples - 1] = np.inf
        times = []
        for k, level in enumerate(RISE):
            sample, at, last = crossings[3 * k : 3 * k + 3]
            back = np.where(sample > start, (at - level) / (at - last), 0.0)
            times.append(np.where(sample < 0, np.inf, sample * period - back * period))
        rise = np.where(np.isinf(times[1]), np.inf, times[1] - times[0])
    return {"overshoot_percent": overshoot, "settling_time_s": settling, "rise_time_s": rise}


def step_reduction(state: int, begin: float, end: float) -> Reduction:
    """`flexhinf.loop.step_metrics` of a true state that steps from `begin` to `end` at once, whatever the command.

    Parameters
    ----------
    state : int
        Its column.
    begin, end : float
        Not equal; data, not code.
    """
    start = (begin, *_STEP_START[1:], end)
    return Reduction(start, partial(_fixed_step, state), _fixed_step_metrics, ("fixed step", state))


def _fixed_step(state: int, kept: Any, now: Instant) -> Any:
    *step, end = kept
    return np.array([*_stepped(step, now.step, now.state[state], (step[0], end, 0.0)), end])


def _fixed_step_metrics(kept: np.ndarray, command: Command) -> dict[str, np.ndarray]:
    return _stepped_metrics(kept[:-1], kept[-1] - kept[0], 0.0, command)


def _error(place: Place, kept: Any, now: Instant) -> Any:
    error = place.position(now) - now.reference[place.command]
    late = where(now.step >= now.tail, maximum(kept[0], abs(error)), kept[0])
    return np.array([late, kept[1] + error * error])


def _error_metrics(kept: np.ndarray, command: Command) -> dict[str, np.ndarray]:
    return {"steady_state_error": kept[0], "tracking_rmse": np.sqrt(kept[1] / command.samples)}


def _peak(kept: Any, now: Instant) -> Any:
    largest = kept[0]
    for u in now.input:
        largest = maximum(largest, abs(u))
    return np.array([largest])


def _peak_metric(kept: np.ndarray, command: Command) -> dict[str, np.ndarray]:
    return {"peak_input": kept[0]}


def _estimation(pairs: Sequence[tuple[int, int]], kept: Any, now: Instant) -> Any:
    errors = [now.estimate[one] - now.state[other] for one, other in pairs]
    return np.array([total + error * error for total, error in zip(kept, errors)])


def _rms(kept: np.ndarray, command: Command) -> dict[str, np.ndarray]:
    return {"estimation_rmse": np.sqrt(kept / command.samples).T}
