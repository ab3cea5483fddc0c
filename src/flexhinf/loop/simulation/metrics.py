"""Figures of merit of a response, of the true position."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from flexhinf.errors import InvalidInput

if TYPE_CHECKING:
    from flexhinf.loop.simulation.trajectory import Trajectory

__all__ = ["StepShape", "disturbance_response", "loop_metrics", "step_response", "step_shape"]

#: Half width of the settling band, as a share of the step.
SETTLING_BAND = 0.02

#: Share of the run over which the steady-state error is taken.
TAIL = 0.10

#: The edge of the settling band is inside it, whatever the rounding.
ROUNDING = 1e-9


@dataclass(frozen=True)
class StepShape:
    """Where a command steps: from `initial` to `final` at the time `at`."""

    initial: float
    final: float
    at: float

    @property
    def height(self) -> float:
        """Signed size of the step."""
        return self.final - self.initial


def step_shape(time: np.ndarray, position: np.ndarray, reference: np.ndarray) -> StepShape | None:
    """The step in a command: from the command (or the position, if it steps at once) to where it rests.

    Parameters
    ----------
    time, position, reference : ndarray, (N,)

    Returns
    -------
    StepShape or None
        None for a command that is still moving in the last tenth of the run: it is no step.
    """
    final = float(reference[-1])
    if np.any(reference[-_tail(reference) :] != final):
        return None
    changes = np.flatnonzero(reference != reference[0])
    if len(changes):
        return StepShape(float(reference[0]), final, float(time[changes[0]]))
    return StepShape(float(position[0]), final, float(time[0]))


def step_response(time: np.ndarray, position: np.ndarray, shape: StepShape | None) -> dict[str, float | None]:
    """Overshoot and settling time of a step.

    Overshoot in per cent of the step, in its direction, from the command on. Settling is the last time
    outside ±2 % of the step, counted from the command; None if the position is outside at the end of the run.
    A step of height zero and a command that is no step have neither.
    """
    if shape is None or shape.height == 0.0:
        return {"overshoot_percent": None, "settling_time_s": None}
    after = time >= shape.at
    beyond = (position[after] - shape.final) / shape.height
    return {
        "overshoot_percent": 100.0 * max(0.0, float(beyond.max())),
        "settling_time_s": _last_outside(time[after], position[after] - shape.final, shape.height, shape.at),
    }


def _last_outside(time: np.ndarray, deviation: np.ndarray, height: float, start: float) -> float | None:
    """Time from `start` to the last deviation outside ±2 % of the height; None if that is the last of all."""
    band = SETTLING_BAND * abs(height) * (1.0 + ROUNDING)
    outside = np.flatnonzero(np.abs(deviation) > band)
    if len(outside) == 0:
        return 0.0
    if outside[-1] == len(deviation) - 1:
        return None
    return float(time[outside[-1]] - start)


def _tail(signal: np.ndarray) -> int:
    return max(1, math.ceil(TAIL * len(signal)))


def loop_metrics(run: Trajectory, name: str | None = None) -> dict[str, Any]:
    """Figures of merit of a run; see `Trajectory.metrics`."""
    tracked = [name for name in run.names.get("reference", ()) if name not in run.names["input"]]
    if not run.judged:
        raise InvalidInput(
            "Nothing is tracked in this run.", "expected a problem with integrate=(...)", "integrate a state"
        )
    if name is not None and name not in tracked:
        raise InvalidInput(
            f"{name!r} is not tracked.", f"expected one of {list(tracked)}", "one of these names"
        )
    name = run.judged[0] if name is None else name
    position, reference = run.tracked(name), run.signal("reference", name)
    error = position - reference
    inputs = run.signals["input"]
    known = [k for k in run.names["estimate"] if k in run.names.get("state", ())]
    rmse = [float(np.sqrt(np.mean((run.signal("estimate", k) - run.signal("state", k)) ** 2))) for k in known]
    return {
        **step_response(run.time, position, step_shape(run.time, position, reference)),
        "steady_state_error": float(np.abs(error[-_tail(error) :]).max()),
        "peak_input": float(np.abs(inputs).max()),
        "tracking_rmse": float(np.sqrt(np.mean(error**2))),
        "estimation_rmse": rmse,
    }


def disturbance_response(
    time: np.ndarray, position: np.ndarray, command: float, height: float, at: float
) -> dict[str, float | None]:
    """Peak deviation from the command after a disturbance starts, and time until it stays within 2 %.

    Parameters
    ----------
    time, position : ndarray, (N,)
    command, height : float
        The command that holds by then, and the step to it, of which the 2 % are.
    at : float
        Start of the disturbance, s, inside the run.
    """
    after = time >= at * (1.0 - ROUNDING)
    if not np.any(after):
        raise InvalidInput(
            "The disturbance starts after the run.",
            f"expected at <= {time[-1]:g} s, got {at:g} s",
            "a longer run",
        )
    deviation = position[after] - command
    return {
        "peak_deviation": float(np.abs(deviation).max()),
        "recovery_time_s": _last_outside(time[after], deviation, height, at),
    }
