"""Metrics of a campaign's runs: standard ones, a user's own functions, and requirements by which rows are judged.

A run comes to its end, is unstable, diverges, or is not run.

With a limited input or in a short run, an unstable loop need not reach infinite numbers. So the time after the last
change of command and disturbance is divided into thirds. A tracked state is unstable if its swing (largest minus
smallest value) in the last third

- is wider than the settling band of ±2 % of its step,
- is at least `UNDAMPED` of that in the second third,
- and goes over the same values in both (it oscillates without end), or is further from the command than in the second
  third: all of the time, or by more than the step.

A state whose step is less than 5 % of the largest one, or none, has the band of the largest. A run without a step, or
whose command or disturbance changes in its last tenth, is not judged.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeAlias

import numpy as np

from flexhinf.arrays import Element, Elements
from flexhinf.errors import InvalidInput
from flexhinf.loop import Ensemble, EnsembleResult, Instant, Reduction, Trajectory
from flexhinf.loop.simulation.inputs import sample_disturbance
from flexhinf.loop.simulation.metrics import MIN_TRAVEL, TAIL, CommandFacts, Place, band_of
from flexhinf.loop.simulation.places import tracked_place
from flexhinf.scalars import maximum, minimum, where
from flexhinf.validation import one_of, value_text

#: Values of a row's status.
COMPLETED, UNSTABLE, DIVERGED, NOT_RUN = "completed", "unstable", "diverged", "not run"

#: An oscillation whose swing falls to less than this fraction from one third of the run to the next one is damped.
UNDAMPED = 0.9

#: Initial memory of a state: its first value, then smallest and largest value minus the command in each window.
_EMPTY = (0.0, np.inf, -np.inf, np.inf, -np.inf)


def stability_reduction(ensemble: Ensemble) -> Reduction:
    """Reduction to ``unstable`` (N,), 0 or 1, of N runs at once; its bits are those of `is_unstable`."""
    command, plant, controller = ensemble.command, ensemble.plant, ensemble.controller
    places = tuple(tracked_place(plant, controller, name) for name in controller.judged)
    signals = [ensemble.commands]
    if ensemble.disturbance is not None:
        stages = sample_disturbance(
            ensemble.disturbance, command.period, command.samples, 1, plant.disturbances
        )
        signals.append(stages[:, 0, 0])
    start = (*_windows(signals, command.samples), *_EMPTY * len(places))
    return Reduction(start, partial(_update, places), partial(_result, places), ("rest", places))


def is_unstable(run: Trajectory) -> bool:
    """Whether a run that came to its end is unstable, by the criterion of this module."""
    commands, names = run.signals["reference"], run.names["reference"]
    first, second = _windows([commands, run.signals["disturbance"]], len(run.time))
    if first == second:
        return False
    kept: list[list[float]] = []
    heights: list[float] = []
    for name in run.judged:
        command, position = commands[:, names.index(name)], run.tracked(name)
        heights.append(command[-1] - (command[0] if np.any(command != command[0]) else position[0]))
        beyond = position - command[-1]
        kept.append([f(part) for part in (beyond[first:second], beyond[second:]) for f in (np.min, np.max)])
    return bool(kept) and bool(_unstable(np.array(kept)[:, :, None], np.array(heights)[:, None])[0])


def _windows(signals: Sequence[np.ndarray], samples: int) -> tuple[int, int]:
    """First samples of the last two thirds of the time in which these signals (N, …) are constant; both are `samples`
    if that time is less than the last tenth."""
    moving = [np.flatnonzero(np.any(values != values[-1], axis=1)) for values in signals]
    still = max((int(places[-1]) + 1 for places in moving if len(places)), default=0)
    steady = samples - still
    moved = steady < max(TAIL * samples, 3)
    return (samples, samples) if moved else (still + steady // 3, still + 2 * steady // 3)


def _update(places: Sequence[Place], kept: Elements, now: Instant) -> Elements:
    """Update the memory of `stability_reduction` with one sample: both windows, then five numbers of each state."""
    first, second = kept[0], kept[1]
    updated: list[Element] = [first, second]
    for k, place in enumerate(places):
        begun, low, high, last_low, last_high = kept[2 + 5 * k : 7 + 5 * k]
        position, channel = getattr(now, place.kind)[place.column], place.command
        initial = where(now.change[channel] > 0.5, now.first[channel], position)
        beyond = position - now.last[channel]
        late = now.step >= second
        early = where(late, 0.0, where(now.step >= first, 1.0, 0.0)) > 0.5
        updated += [
            where(now.step > 0.5, begun, initial),
            where(early, minimum(low, beyond), low),
            where(early, maximum(high, beyond), high),
            where(late, minimum(last_low, beyond), last_low),
            where(late, maximum(last_high, beyond), last_high),
        ]
    return np.array(updated)


def _result(places: Sequence[Place], kept: np.ndarray, command: CommandFacts) -> dict[str, np.ndarray]:
    states = kept[2:].reshape(len(places), len(_EMPTY), kept.shape[1])
    last = np.array([command.last[place.command] for place in places])
    return {"unstable": _unstable(states[:, 1:], last[:, None] - states[:, 0]).astype(float)}


def _unstable(extremes: np.ndarray, heights: np.ndarray) -> np.ndarray:
    """Which runs (N,) are unstable: from extremes of each state in both windows (K, 4, N), and its step (K, N)."""
    low, high, last_low, last_high = np.moveaxis(extremes, 1, 0)
    with np.errstate(invalid="ignore", over="ignore"):  # windows without samples are infinite
        swing, last_swing = high - low, last_high - last_low
        size = np.abs(heights)
        largest = size.max(axis=0, initial=0.0)
        size = np.where(size > MIN_TRAVEL * largest, size, largest)
        band = band_of(size)
        wide = (last_swing > 2.0 * band) & (band > 0.0) & (last_swing >= UNDAMPED * swing)
        shared = np.minimum(high, last_high) - np.maximum(low, last_low)
        nearest = np.where(last_low * last_high <= 0.0, 0.0, np.minimum(np.abs(last_low), np.abs(last_high)))
        far, farthest = (np.maximum(np.abs(a), np.abs(b)) for a, b in ((low, high), (last_low, last_high)))
        away = (nearest > far) | (farthest > np.maximum(far, size))
        return np.any(wide & (away | (shared >= 0.5 * np.minimum(swing, last_swing))), axis=0)


#: Trajectory → a number, or numbers by name.
MetricFunction: TypeAlias = Callable[[Trajectory], float | Mapping[str, float | None] | None]


@dataclass(frozen=True, eq=False)
class Metrics:
    """Metrics of a run: a function with the names and units of its values."""

    units: Mapping[str, str]  # Unit of each metric by name, "" where it has none
    # Trajectory → numbers by name, or one number if there is one name; called for completed runs only. A value may be
    # infinite (of a run that never settles); None or NaN: the run has no such number.
    # None: the metrics exist in lanes only
    function: MetricFunction | None
    # The same numbers, (N,) by name, of N runs in lanes, without their signals. Without this function runs are made a
    # few at a time and their signals are stored
    reduced: Callable[[EnsembleResult], Mapping[str, np.ndarray]] | None = None
    reductions: Sequence[Reduction] = ()  # Reductions that `reduced` needs besides those of `Loop.ensemble`
    # Names among `units` that belong to one part, such as one joint; another metric is the worst of all parts. They are
    # judged like others, and reports list them separately
    parts: Sequence[str] = ()

    def __call__(self, run: Trajectory) -> dict[str, float]:
        """The numbers of one run, NaN where it has none; InvalidInput if the function returns something else."""
        if self.function is None:
            raise InvalidInput(
                f"The metrics {list(self.units)} are computed in lanes only.",
                "expected samples without a plant, command or disturbance of their own",
                "a draw of parameters, initial states and loads",
            )
        result = self.function(run)
        if isinstance(result, Mapping):
            stated = result
        else:
            stated = dict.fromkeys(self.units, result) if len(self.units) == 1 else {}
        try:
            values = {name: stated[name] for name in self.units}
            return {name: math.nan if value is None else float(value) for name, value in values.items()}
        except (KeyError, TypeError, ValueError) as error:
            raise InvalidInput(
                "A metric does not give numbers.",
                f"expected a number for each of {list(self.units)}, got {value_text(stated)}",
                "a function of a Trajectory that returns a float",
            ) from error


def _tracking(run: Trajectory) -> dict[str, float | None]:
    rows = [run.metrics(name) for name in run.judged]
    stepped = [row for row in rows if row["overshoot_percent"] is not None]
    times = {
        name: max((math.inf if (value := row[name]) is None else value for row in stepped), default=None)
        for name in ("settling_time_s", "rise_time_s")
    }
    others = {
        name: max((value for row in rows if (value := row[name]) is not None), default=None)
        for name in ("overshoot_percent", "steady_state_error", "peak_input", "tracking_rmse")
    }
    return {**others, **times, "estimation_rmse": max(rows[0]["estimation_rmse"] or (), default=math.nan)}


def _tracking_in_lanes(result: EnsembleResult) -> dict[str, np.ndarray]:
    rows = list(result.by_state.values())
    worst = {name: np.fmax.reduce([row[name] for row in rows]) for name in rows[0]}
    errors = result.common["estimation_rmse"]
    largest = np.fmax.reduce(errors, axis=1) if errors.size else np.full(len(result.codes), math.nan)
    return {**worst, "peak_input": result.common["peak_input"], "estimation_rmse": largest}


def _doubtful(run: Trajectory) -> int:
    return run.doubtful_samples


def _doubtful_in_lanes(result: EnsembleResult) -> dict[str, np.ndarray]:
    return {"doubtful_samples": result.doubtful_samples}


def _stopped(run: Trajectory) -> dict[str, float]:
    return {"stop_sample": float(run.counts.stop_sample), "stop_reasons": float(run.counts.stop_bits)}


def _stopped_in_lanes(result: EnsembleResult) -> dict[str, np.ndarray]:
    return {"stop_sample": result.counts.stop_sample, "stop_reasons": result.counts.stop_bits}


STANDARD_UNITS = {
    "overshoot_percent": "%",
    "settling_time_s": "s",
    "rise_time_s": "s",
    "steady_state_error": "",
    "peak_input": "",
    "tracking_rmse": "",
    "estimation_rmse": "",
}

#: The metrics of `Trajectory.metrics`, each the worst of all tracked states; of the estimates the largest error.
STANDARD = Metrics(STANDARD_UNITS, _tracking, _tracking_in_lanes)

#: Samples at which the estimate was in doubt, of an estimator that says so: see `flexhinf.Controller.doubtful_samples`.
DOUBTFUL = Metrics({"doubtful_samples": ""}, _doubtful, _doubtful_in_lanes)

#: The first sample, from 1 on, at which a protective stop would have begun, 0 for none; and why, bits of
#: `flexhinf.stops.Stop`.
STOPPED = Metrics({"stop_sample": "", "stop_reasons": ""}, _stopped, _stopped_in_lanes)


def known_metric(name: str, known: Sequence[str]) -> str:
    """Check the name of a metric; InvalidInput lists the known ones."""
    one_of(
        f"There is no metric {name!r}.",
        name,
        known,
        "one of these, or a function of your own (metrics={'name': function})",
    )
    return name


#: Names of standard metrics, `Metrics`, and functions by name: one of these, or several. None: the standard ones.
MetricPart: TypeAlias = str | Metrics | Mapping[str, MetricFunction]
MetricsLike: TypeAlias = MetricPart | Sequence[MetricPart] | None


def chosen_metrics(metrics: MetricsLike, tracked: bool, doubts: bool, stops: bool) -> tuple[Metrics, ...]:
    """A campaign's metrics, from names, `Metrics`, functions by name, or a sequence of these; None: the standard
    ones, where a state is `tracked`, `DOUBTFUL` where the estimator says when it `doubts`, and `STOPPED` where the
    controller's protection says when it `stops`."""
    flags = zip((STANDARD, DOUBTFUL, STOPPED), (tracked, doubts, stops))
    possible = tuple(metrics for metrics, there in flags if there)
    if metrics is None:
        return possible
    parts = [metrics] if isinstance(metrics, (Metrics, Mapping, str)) else list(metrics)
    known = [name for one in possible for name in one.units]
    names = [known_metric(part, known) for part in parts if isinstance(part, str)]
    some = [(one, {name: one.units[name] for name in names if name in one.units}) for one in possible]
    chosen = [replace(one, units=units) for one, units in some if units]
    chosen += [part for part in parts if isinstance(part, Metrics)]
    for part in [part for part in parts if not isinstance(part, (str, Metrics))]:
        if not hasattr(part, "items"):  # such as a function alone
            raise _unnamed(getattr(part, "__name__", part))
        for name, function in part.items():
            if not callable(function) or not str(name).isidentifier():
                raise _unnamed(name)
            chosen.append(Metrics({name: ""}, function))
    return tuple(chosen)


def _unnamed(name: object) -> InvalidInput:
    return InvalidInput(
        "A metric needs a name and a function.",
        f"expected a name that is a Python identifier and a function of a run, got {value_text(name)}",
        "metrics={'largest_torque': lambda run: abs(run.signals['input']).max()}",
    )


_REQUIREMENT = re.compile(r"\s*(\w+)\s*(<=|>=|≤|≥)\s*(\S+)\s*\Z")


@dataclass(frozen=True)
class MetricLimit:
    """A limit of one metric."""

    metric: str
    limit: float
    at_most: bool = True

    @staticmethod
    def of(text: str, metrics: Sequence[str]) -> MetricLimit:
        """Read ``overshoot_percent<=5``; InvalidInput for another form, metric, or no number."""
        match, limit = _REQUIREMENT.match(text), math.nan
        with suppress(ValueError):
            limit = float(match[3]) if match else math.nan
        if match is None or math.isnan(limit):
            raise InvalidInput(
                "The requirement cannot be read.",
                f"expected METRIC<=NUMBER or METRIC>=NUMBER, got {value_text(text)}",
                "overshoot_percent<=5",
            )
        return MetricLimit(known_metric(match[1], metrics), limit, match[2] in ("<=", "≤"))

    def text(self) -> str:
        """The requirement as text: ``overshoot_percent<=5``."""
        return f"{self.metric}{'<=' if self.at_most else '>='}{self.limit:g}"

    def met(self, values: np.ndarray) -> np.ndarray:
        """Whether values (N,) meet the requirement; NaN does not."""
        return values <= self.limit if self.at_most else values >= self.limit
