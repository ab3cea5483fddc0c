"""Metrics of a response, from arrays of time and of the true position: of a step, of tracking, of a load.

Everything that judges a run uses these functions, so that each word has one definition.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.untrusted import value_text

#: Half width of the settling band, as a fraction of the step: ±2 %.
SETTLING_BAND = 0.02

#: Fractions of the step between which the rise time is taken.
RISE = (0.1, 0.9)

#: Fraction of the run, at its end, over which the steady-state error is taken.
TAIL = 0.10

#: Fraction of a long run, at its end, in which an oscillation that has not died out is looked for.
REST_TAIL = 0.5

#: A period begins where a signal rises through this fraction of the amplitude above its middle, after it was as far
#: below. Vibrations on a slow oscillation are then no periods of their own.
HYSTERESIS = 0.5

#: Smaller damping ratios are rounding of the eigenvalues and count as 0: the error bound ε‖A‖κ/|λ| of the solver
#: (κ: condition of the eigenvalue) is at most 8e-10 over the vibrations of all robots that come with flexhinf.
UNDAMPED = 1e-9

#: The edge of the settling band is inside it, whatever the rounding.
ROUNDING = 1e-9


def damping_ratio(poles: np.ndarray) -> np.ndarray:
    """−Re s/|s| of poles s (K,), 1/s; 0 at s = 0, and where the ratio is smaller than the eigenvalues' rounding."""
    sizes = np.abs(poles)
    ratios = np.divide(-np.real(poles), sizes, out=np.zeros(np.shape(sizes)), where=sizes > 0.0)
    return np.where(np.abs(ratios) < UNDAMPED, 0.0, ratios)


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
    """The step in a command: from the command (or the position, if it steps at once) to where it ends.

    Parameters
    ----------
    time, position, reference : ndarray, (N,)

    Returns
    -------
    StepShape or None
        None for a command that still moves in the last tenth of the run: it is no step.
    """
    final = float(reference[-1])
    if np.any(tail_of(reference) != final):
        return None
    changes = np.flatnonzero(reference != reference[0])
    if len(changes):
        return StepShape(float(reference[0]), final, float(time[changes[0]]))
    return StepShape(float(position[0]), final, float(time[0]))


def step_metrics(time: np.ndarray, position: np.ndarray, shape: StepShape | None) -> dict[str, float | None]:
    """Overshoot, settling time and rise time of a step.

    Parameters
    ----------
    time, position : ndarray, (N,)

    Returns
    -------
    dict
        ``overshoot_percent``: per cent of the step, in its direction, from the command on.
        ``settling_time_s``: last time outside ±2 % of the step, counted from the command; None if the position is
        outside at the end of the run.
        ``rise_time_s``: from the first crossing of 10 % of the step to the first one of 90 %, interpolated between
        samples; None if 90 % is not reached.
        A step of height zero and a command that is no step (None) have none of them.
    """
    if shape is None or shape.height == 0.0:
        return {"overshoot_percent": None, "settling_time_s": None, "rise_time_s": None}
    after = time >= shape.at
    time, position = time[after], position[after]
    beyond = (position - shape.final) / shape.height
    return {
        "overshoot_percent": 100.0 * max(0.0, float(beyond.max())),
        "settling_time_s": _last_outside(time, position - shape.final, shape.height, shape.at),
        "rise_time_s": _rise_time(time, 1.0 + beyond),
    }


def load_metrics(
    time: np.ndarray, position: np.ndarray, *, command: float, step: float, start: float
) -> dict[str, float | None]:
    """What a disturbance does to a position that is held at a command.

    Parameters
    ----------
    time, position : ndarray, (N,)
    command : float
        The command that holds from `start` on.
    step : float
        The command's step (signed or not), of which the band of 2 % is taken. Where the command makes no step, a
        reference step that is stated beside the result.
    start : float
        When the disturbance starts, s, inside the run.

    Returns
    -------
    dict
        ``peak_deviation``: largest distance from the command.
        ``recovery_time_s``: from `start` to the last time outside ±2 % of the step; 0 if the position never leaves
        the band, None if it is outside at the end of the run.
        ``remaining_error``: largest distance from the command in the last tenth of the run.

    Raises
    ------
    InvalidInput
        If the disturbance starts after the run, or the step has no height.
    """
    after = time >= start * (1.0 - ROUNDING)
    if not np.any(after):
        raise InvalidInput(
            "The disturbance starts after the run.",
            f"expected start <= {time[-1]:g} s, got {start:g} s",
            "a longer run",
        )
    if not (np.isfinite(step) and step != 0.0):
        raise InvalidInput(
            "The recovery time needs the size of a step.",
            f"expected a step other than zero, of which 2 % are the band, got {value_text(step)}",
            "step=0.1 as a reference, stated beside the result",
        )
    deviation = position[after] - command
    return {
        "peak_deviation": float(np.abs(deviation).max()),
        "recovery_time_s": _last_outside(time[after], deviation, step, start),
        "remaining_error": steady_state_error(position, np.full(len(position), command)),
    }


def steady_state_error(position: np.ndarray, reference: np.ndarray) -> float:
    """Largest |error| in the last tenth of a run, of arrays (N,)."""
    error = position - reference
    return float(np.abs(tail_of(error)).max())


@dataclass(frozen=True)
class LimitCycle:
    """An oscillation that does not die out.

    Attributes
    ----------
    amplitude : float
        Half of the distance between its extremes.
    frequency : float or None
        Hz; None where there is not one whole period.
    """

    amplitude: float
    frequency: float | None


def limit_cycle(time: np.ndarray, position: np.ndarray) -> LimitCycle:
    """What still moves in the last half of a run at rest.

    Parameters
    ----------
    time, position : ndarray, (N,)

    Returns
    -------
    LimitCycle
        The frequency is that of whole periods between rises through the middle, with hysteresis.
    """
    time, position = tail_of(time, REST_TAIL), tail_of(position, REST_TAIL)
    low, high = float(position.min()), float(position.max())
    amplitude, deviation = 0.5 * (high - low), position - 0.5 * (high + low)
    side = np.where(
        deviation >= HYSTERESIS * amplitude, 1, np.where(deviation <= -HYSTERESIS * amplitude, -1, 0)
    )
    outside = np.flatnonzero(side)
    rises = outside[1:][np.diff(side[outside]) > 0]
    if amplitude == 0.0 or len(rises) < 2:
        return LimitCycle(amplitude, None)
    return LimitCycle(amplitude, float((len(rises) - 1) / (time[rises[-1]] - time[rises[0]])))


def tail_of(signal: np.ndarray, part: float = TAIL) -> np.ndarray:
    """The last part of a signal (N, …), one sample at least."""
    return signal[len(signal) - max(1, math.ceil(part * len(signal))) :]


def _last_outside(time: np.ndarray, deviation: np.ndarray, height: float, start: float) -> float | None:
    """Time from `start` to the last deviation outside ±2 % of the height; None if that is the last of all."""
    band = SETTLING_BAND * abs(height) * (1.0 + ROUNDING)
    outside = np.flatnonzero(np.abs(deviation) > band)
    if len(outside) == 0:
        return 0.0
    if outside[-1] == len(deviation) - 1:
        return None
    return float(time[outside[-1]] - start)


def _rise_time(time: np.ndarray, way: np.ndarray) -> float | None:
    """Between the first crossings of `RISE` by the fraction of the step that is done, (N,)."""
    crossings = []
    for level in RISE:
        reached = np.flatnonzero(way >= level)
        if len(reached) == 0:
            return None
        k = int(reached[0])
        back = (way[k] - level) / (way[k] - way[k - 1]) * (time[k] - time[k - 1]) if k else 0.0
        crossings.append(float(time[k] - back))
    return crossings[1] - crossings[0]
