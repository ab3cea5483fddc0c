"""How a run ended: it came to its end, it is unstable, it diverged, or it was not run.

A loop whose input is limited, or whose time is short, need not diverge to numbers that are not finite to be unstable.
So the time from which on command and disturbance stand still is cut into thirds. A tracked state is unstable where its
swing (largest less smallest value) in the last third

- is wider than the settling band of ±2 % of its step,
- is at least `UNDAMPED` of that in the second third,
- and goes over the same values in both (it oscillates without end), or is further from the command than in the second
  third: all of the time, or by more than the step.

A state that makes no step has the band of the largest step. Nothing is said of a run without a step, or whose command
or disturbance moves in its last tenth: there the motion is asked for.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from flexhinf.loop import Ensemble, Instant, Reduction, Trajectory
from flexhinf.loop.signals.sampling import sample_disturbance
from flexhinf.loop.simulation.ensemble import tracked_place
from flexhinf.loop.simulation.metrics import ROUNDING, SETTLING_BAND, TAIL
from flexhinf.loop.simulation.reductions import Command, Place
from flexhinf.scalars import maximum, minimum, where

#: Values of a row's status.
COMPLETED, UNSTABLE, DIVERGED, NOT_RUN = "completed", "unstable", "diverged", "not run"

#: An oscillation whose swing falls to less than this fraction from one third of the run to the next one is damped.
UNDAMPED = 0.9

#: What a state remembers: its first value, then the smallest and the largest one in each window, less the command.
_EMPTY = (0.0, np.inf, -np.inf, np.inf, -np.inf)


def rest_reduction(ensemble: Ensemble) -> Reduction:
    """``unstable`` of N runs in lanes, (N,) of 0 and 1: what `is_unstable` says of each of them, bit by bit."""
    command, plant, controller = ensemble.command, ensemble.plant, ensemble.controller
    places = tuple(tracked_place(plant, controller, name) for name in controller.judged)
    given = [ensemble.commands]
    if ensemble.disturbance is not None:
        stages = sample_disturbance(
            ensemble.disturbance, command.period, command.samples, 1, plant.disturbances
        )
        given.append(stages[:, 0, 0])
    start = (*_windows(given, command.samples), *_EMPTY * len(places))
    return Reduction(start, partial(_update, places), partial(_result, places), ("rest", places))


def is_unstable(run: Trajectory) -> bool:
    """Whether a run that came to its end is unstable, see above."""
    commands, names = run.signals["reference"], run.names["reference"]
    first, second = _windows([commands, run.signals["disturbance"]], len(run.time))
    if first == second:
        return False
    kept, heights = [], []
    for name in run.judged:
        command, position = commands[:, names.index(name)], run.tracked(name)
        begun = command[0] if np.any(command != command[0]) else position[0]
        heights.append(command[-1] - begun)
        beyond = position - command[-1]
        kept.append([f(part) for part in (beyond[first:second], beyond[second:]) for f in (np.min, np.max)])
    return bool(kept) and bool(_unstable(np.array(kept)[:, :, None], np.array(heights)[:, None])[0])


def _windows(signals: Sequence[np.ndarray], samples: int) -> tuple[int, int]:
    """First samples of the last two thirds of the time in which these signals (N, …) stand still; both `samples` where
    that is less than the last tenth."""
    moving = [np.flatnonzero(np.any(values != values[-1], axis=1)) for values in signals]
    still = max((int(found[-1]) + 1 for found in moving if len(found)), default=0)
    rest = samples - still
    if rest < max(TAIL * samples, 3):
        return samples, samples
    return still + rest // 3, still + 2 * rest // 3


def _update(places: Sequence[Place], kept: Any, now: Instant) -> Any:
    """Both windows, then five numbers of each state."""
    first, second = kept[0], kept[1]
    found = [first, second]
    for k, place in enumerate(places):
        begun, low, high, last_low, last_high = kept[2 + 5 * k : 7 + 5 * k]
        position, channel = place.position(now), place.command
        initial = where(now.change[channel] > 0.5, now.first[channel], position)
        beyond = position - now.last[channel]
        late = now.step >= second
        early = where(late, 0.0, where(now.step >= first, 1.0, 0.0)) > 0.5
        found += [
            where(now.step > 0.5, begun, initial),
            where(early, minimum(low, beyond), low), where(early, maximum(high, beyond), high),
            where(late, minimum(last_low, beyond), last_low), where(late, maximum(last_high, beyond), last_high),
        ]  # fmt: skip
    return np.array(found)


def _result(places: Sequence[Place], kept: np.ndarray, command: Command) -> dict[str, np.ndarray]:
    states = kept[2:].reshape(len(places), len(_EMPTY), kept.shape[1])
    last = np.array([command.last[place.command] for place in places])
    return {"unstable": _unstable(states[:, 1:], last[:, None] - states[:, 0]).astype(float)}


def _unstable(extremes: np.ndarray, heights: np.ndarray) -> np.ndarray:
    """Of N runs (N,): smallest and largest values of each state in both windows (K, 4, N), and its step (K, N)."""
    low, high, last_low, last_high = np.moveaxis(extremes, 1, 0)
    with np.errstate(invalid="ignore"):  # windows without samples are infinite
        swing, last_swing = high - low, last_high - last_low
        size = np.abs(heights)
        band = SETTLING_BAND * np.where(size > 0.0, size, size.max(axis=0, initial=0.0)) * (1.0 + ROUNDING)
        wide = (last_swing > 2.0 * band) & (band > 0.0) & (last_swing >= UNDAMPED * swing)
        shared = np.minimum(high, last_high) - np.maximum(low, last_low)
        nearest = np.where(last_low * last_high <= 0.0, 0.0, np.minimum(np.abs(last_low), np.abs(last_high)))
        far, farthest = (np.maximum(np.abs(a), np.abs(b)) for a, b in ((low, high), (last_low, last_high)))
        away = (nearest > far) | (farthest > np.maximum(far, size))
        return np.any(wide & (away | (shared >= 0.5 * np.minimum(swing, last_swing))), axis=0)
