"""Metrics of a response: of a step, of tracking, of a load; everything that judges a run uses them.

Functions take arrays of time and of the true position. Reductions compute the metrics of `Trajectory.metrics`, and a
user's own, while runs go on: their memory is a few numbers, which every sample updates, so that no signal is stored.
Their `update` is traced and compiled like a model: NumPy code on any element, choices by `flexhinf.scalars.where`,
`maximum` and so on.
"""

# NumPy's `where` of unpacked rows has no type.
# pyright: reportUnknownArgumentType=false
from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial, reduce
from itertools import pairwise
from typing import Any, NamedTuple, TypedDict, cast

import numpy as np

from flexhinf.arrays import Vector
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.loop.controller.memory import Told
from flexhinf.scalars import maximum, minimum, where
from flexhinf.validation import unknown_name, value_text

#: What counts as rest at the end of a run, s; and the smallest travel that a motion is measured by, as a fraction of
#: the largest travel of all joints.
WINDOW, MIN_TRAVEL = 0.3, 0.05

#: Half width of the settling band, as a fraction of the step: ±2 %.
SETTLING_BAND = 0.02

#: Fractions of the step between which the rise time is taken.
RISE = (0.1, 0.9)

#: Fraction of the run, at its end, over which the steady-state error is taken.
TAIL = 0.10

#: Fraction of a long run, at its end, in which an oscillation that has not died out is looked for.
OSCILLATION_TAIL = 0.5

#: A period begins where a signal rises through this fraction of the amplitude above its middle, after it was as far
#: below. Vibrations on a slow oscillation are then no periods of their own.
HYSTERESIS = 0.5

#: A mode that falls below 1/e within so many samples is no oscillation.
LASTING = 2.0

#: Relative rounding of times, and of the edge of the settling band.
ROUNDING = 1e-9

#: A path is straight if no point of it is further from the way between its ends, in units of the travel.
STRAIGHT = 1e-12


@dataclass(frozen=True)
class StepShape:
    """Where a command steps: from `initial` to `final` at the time `at`, s."""

    initial: float
    final: float
    at: float

    @property
    def height(self) -> float:
        """Signed size of the step."""
        return self.final - self.initial


def step_shape(time: np.ndarray, position: np.ndarray, reference: np.ndarray) -> StepShape | None:
    """The step in a command (N,): from the command (or the position, if it steps at once) to where it ends; None for a
    command that still moves in the last tenth of the run, which is no step."""
    final = float(reference[-1])
    if np.any(tail_of(reference) != final):
        return None
    changes = np.flatnonzero(reference != reference[0])
    initial, at = (reference[0], time[changes[0]]) if len(changes) else (position[0], time[0])
    return StepShape(float(initial), final, float(at))


class RunMetrics(TypedDict):
    """What `Trajectory.metrics` has; None where the run has no such number, all of one that diverged."""

    overshoot_percent: float | None
    settling_time_s: float | None
    rise_time_s: float | None
    steady_state_error: float | None
    peak_input: float | None
    tracking_rmse: float | None
    estimation_rmse: list[float] | None  # one per estimated state


def no_metrics() -> RunMetrics:
    """Of a run that diverged."""
    return cast("RunMetrics", dict.fromkeys(RunMetrics.__annotations__))


def step_metrics(time: np.ndarray, position: np.ndarray, shape: StepShape | None) -> dict[str, float | None]:
    """Overshoot, settling time and rise time of a step, from arrays (N,).

    ``overshoot_percent``: per cent of the step, in its direction, from the command on. ``settling_time_s``: last time
    outside ±2 % of the step, counted from the command; None if the position is outside at the end of the run.
    ``rise_time_s``: from the first crossing of 10 % of the step to the first one of 90 %, interpolated between
    samples; None if 90 % is not reached. A step of height zero and a command that is no step (None) have none of them.
    """
    if shape is None or shape.height == 0.0:
        return {"overshoot_percent": None, "settling_time_s": None, "rise_time_s": None}
    start, last = int(np.argmax(time >= shape.at)), len(time) - 1
    beyond = position - shape.final
    way = 1.0 + beyond / shape.height
    crossings: list[Any] = []
    for level in RISE:
        k = next(iter(start + np.flatnonzero(way[start:] >= level)), -1)
        crossings += [k, way[k], way[max(k - 1, 0)]]
    outside = start + _last_outside(beyond[start:], shape.height)
    kept = np.array([[0.0, beyond[start:].max(), beyond[start:].min(), outside, 0.0, *crossings]]).T
    rows = _stepped_metrics(
        kept, shape.height, start, shape.at, last, lambda k: time[np.maximum(k, 0).astype(int)]
    )
    return {name: float(row[0]) if np.isfinite(row[0]) else None for name, row in rows.items()}


def load_metrics(
    time: np.ndarray, position: np.ndarray, *, command: float, step: float, start: float
) -> dict[str, float | None]:
    """Response of a position (N,), held at a command, to a disturbance that begins at `start` (s, inside the run).

    The band of 2 % is of the command's step, signed or not; where the command makes none, of a reference step that is
    stated beside the result. A disturbance that starts after the run, and a step without height, are refused.

    ``peak_deviation``: largest distance from the command.
    ``recovery_time_s``: from `start` to the last time outside ±2 % of the step; 0 if the position never leaves the
    band, None if it is outside at the end of the run.
    ``remaining_error``: largest distance from the command in the last tenth of the run.
    """
    after = time >= start * (1.0 - ROUNDING)
    if not np.any(after):
        raise InvalidInput(
            "The disturbance starts after the run.",
            f"expected start <= {time[-1]:g} s, got {start:g} s",
            "a longer run",
        )
    refuse_if(
        not (np.isfinite(step) and step != 0.0),
        "The recovery time needs the size of a step.",
        f"expected a step other than zero, of which 2 % are the band, got {value_text(step)}",
        "step=0.1 as a reference, stated beside the result",
    )
    deviation = position[after] - command
    k = _last_outside(deviation, step)
    return {
        "peak_deviation": float(peak_of(deviation)),
        "recovery_time_s": None
        if k == len(deviation) - 1
        else float(time[after][k] - start)
        if k >= 0
        else 0.0,
        "remaining_error": steady_state_error(position, np.full(len(position), command)),
    }


def steady_state_error(position: np.ndarray, reference: np.ndarray) -> float:
    """Largest |error| in the last tenth of a run, of arrays (N,)."""
    return float(peak_of(tail_of(position - reference)))


def peak_of(signal: np.ndarray) -> np.ndarray:
    """Largest magnitude of each column of a signal (N, …), as the peak input of each motor."""
    return np.abs(signal).max(axis=0)


def rms(errors: np.ndarray) -> float:
    """Root of the mean square of errors (N,)."""
    largest = float(peak_of(errors))  # of numbers whose squares are not finite too
    return largest * float(np.sqrt(np.mean((errors / largest) ** 2))) if 0.0 < largest < np.inf else largest


# Of a motion of several joints
def largest_travel(travel: np.ndarray, slides: np.ndarray, span: np.ndarray) -> np.ndarray:
    """Largest travel of all joints, (n,), each in the unit of its joint.

    A joint of the other kind counts by its share of the joint range. `travel` and `span`, the length of the range, are
    (n,), rad or m; `slides`, (n,) of bool. A joint whose range is not finite counts among joints of its own kind only.
    """
    known = np.isfinite(span)
    share = np.divide(travel, span, out=np.zeros(len(travel)), where=known)
    other = np.where(known, span, 0.0)
    return np.array([np.where(slides == kind, travel, own * share).max() for kind, own in zip(slides, other)])


def wrong_way(position: np.ndarray, reference: np.ndarray, travel: float) -> float:
    """How far a position (N,) leaves the range of its reference (M,) on the start's side, in per cent of a travel.

    The start's side is the end of the range that is nearer to the first reference.
    """
    low, high, start = reference.min(), reference.max(), reference[0]
    beyond = low - position.min() if high - start >= start - low else position.max() - high
    return 100.0 * max(0.0, float(beyond)) / travel


def excursion(position: np.ndarray, pose: float, travel: float) -> float:
    """Largest distance of a position (N,) from where its joint should rest, in per cent of a travel."""
    return 100.0 * float(peak_of(position - pose)) / travel


def path_distance(positions: np.ndarray, path: np.ndarray, travel: np.ndarray) -> np.ndarray:
    """Largest distance (n,) of each joint from the nearest point of a path, of positions (N, n).

    The path (M, n) is straight between its points, whenever it is there. Nearest is what is so in units of `travel`
    (n,).
    """
    points, corners = positions / travel, path / travel
    straight = corners[[0, -1]]
    if np.abs(corners - _nearest(corners, *straight)).max() <= STRAIGHT:
        corners = straight
    nearest, distance = np.zeros_like(points), np.full(len(points), np.inf)
    for begin, end in pairwise(corners):
        at = _nearest(points, begin, end)
        squared = np.sum((points - at) ** 2, axis=1)
        nearer = squared < distance
        nearest[nearer], distance[nearer] = at[nearer], squared[nearer]
    return peak_of(points - nearest) * travel


def _nearest(points: np.ndarray, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The points (N, n) of the straight way between two points (n,) that are nearest to points (N, n)."""
    way = end - begin
    length = max(float(way @ way), np.finfo(float).tiny)
    return begin + np.clip((points - begin) @ way / length, 0.0, 1.0)[:, None] * way


def at_end(time: np.ndarray, signal: np.ndarray) -> np.ndarray:
    """The last `WINDOW` s of a signal (N, …)."""
    return signal[time > time[-1] - WINDOW + ROUNDING * max(float(time[-1]), 1.0)]


def remaining_error(time: np.ndarray, positions: np.ndarray, references: np.ndarray) -> np.ndarray:
    """Largest |error| in the last `WINDOW` s of a run, for each column of arrays (N, …)."""
    return peak_of(at_end(time, positions - references))


def ripple(time: np.ndarray, inputs: np.ndarray, limits: np.ndarray) -> np.ndarray:
    """Standard deviation (m,) of inputs (N, m) over the last `WINDOW` s of a run, in per cent of their limits (m,)."""
    return 100.0 * at_end(time, inputs).std(axis=0) / limits


class LimitCycle(NamedTuple):
    """An oscillation that does not die out."""

    amplitude: float  # half of the distance between its extremes
    frequency: float | None  # Hz; None where there is not one whole period


def limit_cycle(time: np.ndarray, position: np.ndarray) -> LimitCycle:
    """Limit cycle in the last half of a run at rest, from arrays (N,). Its frequency is that of whole periods between
    rises through the middle, with hysteresis."""
    time, position = tail_of(time, OSCILLATION_TAIL), tail_of(position, OSCILLATION_TAIL)
    low, high = float(position.min()), float(position.max())
    amplitude, deviation = 0.5 * (high - low), position - 0.5 * (high + low)
    far = HYSTERESIS * amplitude
    side = np.where(deviation >= far, 1, np.where(deviation <= -far, -1, 0))
    outside = np.flatnonzero(side)
    rises = outside[1:][np.diff(side[outside]) > 0]
    periodic = amplitude != 0.0 and len(rises) >= 2
    frequency = float((len(rises) - 1) / (time[rises[-1]] - time[rises[0]])) if periodic else None
    return LimitCycle(amplitude, frequency)


def tail_of(signal: np.ndarray, part: float = TAIL) -> np.ndarray:
    """The last part of a signal (N, …), one sample at least."""
    return signal[len(signal) - max(1, math.ceil(part * len(signal))) :]


def band_of(height: Any) -> Any:
    """Half width of the settling band of a step of this height; its edge is inside, whatever the rounding."""
    return SETTLING_BAND * abs(height) * (1.0 + ROUNDING)


def _last_outside(deviation: np.ndarray, height: float) -> int:  # of the settling band; −1 for none
    return int(max(np.flatnonzero(np.abs(deviation) > band_of(height)), default=-1))


@dataclass(frozen=True, eq=False)
class CommandFacts:
    """Facts about the command, known before the run, for each of its r channels: the period, s, and the samples of the
    run; the command at the first and at the last one; the first sample at which it differs from the first one, 0 where
    none does; and whether it stands still in the last tenth of the run, see `flexhinf.loop.step_shape`."""

    period: float
    samples: int
    first: np.ndarray
    last: np.ndarray
    change: np.ndarray
    steps: np.ndarray

    @classmethod
    def of(cls, commands: np.ndarray, period: float) -> CommandFacts:
        """Facts about a command (N, r)."""
        change = np.argmax(commands != commands[0], axis=0)
        steps = np.all(tail_of(commands) == commands[-1], axis=0)
        return cls(period, len(commands), commands[0], commands[-1], change, steps)

    def vector(self) -> np.ndarray:
        """Numbers of the command for a kernel, (1 + 3r,): the tail, first, last and change."""
        tail = self.samples - len(tail_of(np.empty(self.samples)))  # its first sample
        return np.concatenate([[tail], self.first, self.last, self.change])


@dataclass(frozen=True)
class Instant:
    """A sample of a run, as a reduction sees it; arrays of any element.

    `step` is its number 0, 1, …; the signals are as in `Trajectory.signals`: the state of the true plant, the estimate
    from this sample's measurement, the measurement, the input that the controller gives, the command. `tail` is the
    first sample of the last tenth of the run, and `first`, `last` and `change` (r,) are those of `CommandFacts`.
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
    """A metric that is computed while a run goes on: a few numbers that every sample updates.

    Parameters
    ----------
    start : sequence of float
        Memory before the first sample, (k,).
    update : callable
        Memory (k,) and `Instant` → memory after this sample (k,).
    result : callable
        Memories (k, N) of N runs at their end, and the `CommandFacts` → arrays by name, (N,) or (N, j).
    key : hashable
        Reductions with the same key have the same update. By default the function itself.
    """

    start: Sequence[float]
    update: Callable[[Any, Instant], Any]
    result: Callable[[np.ndarray, CommandFacts], dict[str, np.ndarray]]
    key: Hashable = field(default=None)

    def __post_init__(self) -> None:
        refuse_if(
            np.ndim(self.start) != 1,
            "A reduction does not say what it remembers.",
            f"expected a sequence of numbers as its start, got {value_text(self.start)}",
            "start=(0.0,) for one number",
        )

    def updated(self, memory: Any, now: Instant) -> Any:
        """Memory (k,) after a sample; InvalidInput where `update` gives another number of elements."""
        after = np.asarray(self.update(memory, now))
        refuse_if(
            after.shape != (len(self.start),),
            f"The reduction {getattr(self.update, '__qualname__', 'of a user')!r} changes the length of its memory.",
            f"expected {len(self.start)} numbers in a sequence, as its start has, got the shape {after.shape}",
            "a start with a number for each that `update` returns; np.array([…]) around a single one",
        )
        return after

    @property
    def code_key(self) -> Hashable:
        """Key of the compiled code."""
        return (self.update if self.key is None else self.key), len(self.start)


@dataclass(frozen=True, eq=False)
class EnsembleResult:
    """Metrics of N runs."""

    #: (N,), 0, or `CONTROL_FAILED` or `PLANT_FAILED` of `program`: whose numbers are no longer finite
    codes: np.ndarray
    diverged_at: np.ndarray  # (N,), time of the last sample of a run that diverged, s; else NaN
    sub_steps: np.ndarray  # (N,), Runge–Kutta steps per period
    by_state: Mapping[str, Mapping[str, np.ndarray]]  # metrics (N,) of each of `Controller.judged`, by name
    common: Mapping[str, np.ndarray]  # metrics (N,) or (N, j) of the whole run, by name
    kept: np.ndarray  # (N, T, k), signals at the ensemble's instants; NaN after a run diverged
    told: Told  # counts (N,) of the controllers

    @property
    def doubtful_samples(self) -> np.ndarray:
        """Samples at which the estimate was in doubt, (N,)."""
        return self.told.doubtful

    @property
    def completed(self) -> np.ndarray:
        """Which runs came to their end, (N,) of bool."""
        return self.codes == 0

    def metrics(self, name: str | None = None) -> dict[str, np.ndarray]:
        """Metrics (N,) of the first (or the named) tracked state, by the names of `Trajectory.metrics`; a state that is
        not tracked is refused.

        Where `Trajectory.metrics` has None they are NaN: for a command that is no step, and for runs that diverged. A
        settling time or a rise time is infinite where the run is not settled, or has not risen, at its end.
        `estimation_rmse` is (N, j), one column per estimated state whose true value is known.
        """
        name = next(iter(self.by_state), None) if name is None else name
        if name is not None and name not in self.by_state:
            raise unknown_name(f"{name!r} is not tracked.", name, tuple(self.by_state))
        return {**(self.by_state[name] if name is not None else {}), **self.common}

    def metrics_of(self, k: int, name: str | None = None) -> RunMetrics:
        """Metrics of the k-th run, with None as in `Trajectory.metrics`."""
        row = {key: values[k].tolist() for key, values in self.metrics(name).items()}
        known = [key for key, value in row.items() if isinstance(value, list) or np.isfinite(value)]
        whole = {key: row[key] if self.completed[k] and key in known else None for key in row}
        return cast("RunMetrics", whole)


class Place(NamedTuple):
    """Where the true value of a tracked state stands."""

    kind: str  # "state", "output" or "estimate"
    column: int  # of this signal
    command: int  # its column of the command


#: Initial position, largest and smallest distance beyond the final command, last sample outside of the settling band,
#: fraction of the step at the sample before; for each level of the rise its sample, and the fraction then and before.
_STEP_START = (0.0, -np.inf, np.inf, -1.0, 0.0, *(-1.0, 0.0, 0.0) * len(RISE))


def _stepped(kept: Any, step: Any, position: Any, shape: tuple[Any, Any, Any]) -> Any:
    """Memory of a step response after one more sample; the shape is where it begins, ends, and its first sample."""
    (_, high, low, outside, before, *crossings), (initial, final, change) = kept, shape
    height, beyond, after = final - initial, position - final, step >= change
    high, low = where(after, maximum(high, beyond), high), where(after, minimum(low, beyond), low)
    outside = where(after, where(abs(beyond) > band_of(height), step, outside), outside)
    way = 1.0 + beyond / height
    rises: list[Any] = []
    for k, level in enumerate(RISE):
        sample, at, last = crossings[3 * k : 3 * k + 3]
        new = where(after, where(sample < -0.5, where(way >= level, 1.0, 0.0), 0.0), 0.0)
        rises += [where(new, step, sample), where(new, way, at), where(new, before, last)]
    return np.array([initial, high, low, outside, way, *rises])


def _stepped_metrics(
    kept: np.ndarray, height: float | Vector, start: Any, at: Any, last: int, time: Callable[[Vector], Vector]
) -> dict[str, np.ndarray]:
    """Metrics of steps from their memories (k, N): heights; first sample and time, s; last sample; times of samples."""
    _, high, low, outside, _, *crossings = kept
    times: list[Vector] = []
    with np.errstate(divide="ignore", invalid="ignore"):
        overshoot = 100.0 * np.maximum(0.0, np.where(height > 0.0, high, low) / height)
        settling = np.where(outside < start, 0.0, time(outside) - at)
        settling[outside == last] = np.inf
        for k in range(len(RISE)):
            sample, way, before = crossings[3 * k : 3 * k + 3]
            back = np.where(sample > start, (way - RISE[k]) / (way - before), 0.0) * (
                time(sample) - time(sample - 1)
            )
            times.append(np.where(sample < 0, np.inf, time(sample) - back))
        rise = np.where(np.isinf(times[1]), np.inf, times[1] - times[0])
    return {"overshoot_percent": overshoot, "settling_time_s": settling, "rise_time_s": rise}


def updated_peak(kept: Any, signal: Any) -> Any:
    """The largest magnitude of a signal (`peak_of`) after one more sample."""
    return maximum(kept, abs(signal))


def updated_late_error(now: Instant, kept: Any, error: Any) -> Any:
    """The largest |error| in the last tenth of the run (`steady_state_error`) after one more sample."""
    return where(now.step >= now.tail, updated_peak(kept, error), kept)


# What reductions call are functions of this module, so that an ensemble can be pickled.
def tracking_reductions(place: Place) -> tuple[Reduction, Reduction]:
    """The metrics of `Trajectory.metrics` that are about one tracked state; means of squares to their rounding."""
    return (
        Reduction(_STEP_START, partial(_step, place), partial(_step_metrics, place), ("step", place)),
        Reduction((0.0, 0.0), partial(_error, place), _error_metrics, ("error", place)),
    )


def step_reduction(state: int, begin: float, end: float) -> Reduction:
    """`flexhinf.loop.step_metrics` of a true state (its column) that steps from `begin` to another `end` at once,
    whatever the command; both are data, not code. The column stands before each name: ``"0 overshoot_percent"``."""
    update, result = partial(_fixed_step, state), partial(_fixed_step_metrics, state)
    return Reduction((begin, *_STEP_START[1:], end), update, result, ("fixed step", state))


def common_reduction(known: Sequence[tuple[int, int]]) -> Reduction:
    """The other metrics of `Trajectory.metrics`; `known` are the columns, in the estimate and in the true state, of
    each estimated state whose true value is known."""
    pairs = tuple(known)
    return Reduction((0.0,) * (1 + len(pairs)), partial(_common, pairs), _common_metrics, ("common", pairs))


def _step(place: Place, kept: Any, now: Instant) -> Any:
    position, channel = getattr(now, place.kind)[place.column], place.command
    initial = where(now.step > 0.5, kept[0], where(now.change[channel] > 0.5, now.first[channel], position))
    return _stepped(kept, now.step, position, (initial, now.last[channel], now.change[channel]))


def _step_metrics(place: Place, kept: np.ndarray, command: CommandFacts) -> dict[str, np.ndarray]:
    height = command.last[place.command] - kept[0]
    start, last, period = command.change[place.command], command.samples - 1, command.period
    metrics = _stepped_metrics(kept, height, start, start * period, last, lambda sample: sample * period)
    step = (height != 0.0) & command.steps[place.command]  # NaN where the command has none
    return {name: np.where(step, values, np.nan) for name, values in metrics.items()}


def _fixed_step(state: int, kept: Any, now: Instant) -> Any:
    *step, end = kept
    return np.array([*_stepped(step, now.step, now.state[state], (step[0], end, 0.0)), end])


def _fixed_step_metrics(state: int, kept: np.ndarray, command: CommandFacts) -> dict[str, np.ndarray]:
    height, last = kept[-1] - kept[0], command.samples - 1
    metrics = _stepped_metrics(kept[:-1], height, 0.0, 0.0, last, lambda sample: sample * command.period)
    return {f"{state} {name}": values for name, values in metrics.items()}


def _error(place: Place, kept: Any, now: Instant) -> Any:
    error = getattr(now, place.kind)[place.column] - now.reference[place.command]
    return np.array([updated_late_error(now, kept[0], error), kept[1] + error * error])


def _error_metrics(kept: np.ndarray, command: CommandFacts) -> dict[str, np.ndarray]:
    return {"steady_state_error": kept[0], "tracking_rmse": np.sqrt(kept[1] / command.samples)}


def _common(pairs: Sequence[tuple[int, int]], kept: Any, now: Instant) -> Any:
    errors = [now.estimate[i] - now.state[j] for i, j in pairs]
    totals = [total + error * error for total, error in zip(kept[1:], errors)]
    return np.array([reduce(updated_peak, now.input, kept[0]), *totals])


def _common_metrics(kept: np.ndarray, command: CommandFacts) -> dict[str, np.ndarray]:
    return {"peak_input": kept[0], "estimation_rmse": np.sqrt(kept[1:] / command.samples).T}
