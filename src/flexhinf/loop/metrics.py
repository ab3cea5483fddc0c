"""Figures of merit of a response, of the true position."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from flexhinf.errors import InvalidInput

if TYPE_CHECKING:
    from flexhinf.loop.trajectory import Trajectory

__all__ = ["StepShape", "disturbance_response", "loop_metrics", "step_response", "step_shape"]

#: Half width of the settling band, as a share of the step.
SETTLING_BAND = 0.02

#: Share of the run over which the steady-state error is taken.
TAIL = 0.10


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


def step_shape(time: np.ndarray, position: np.ndarray, reference: np.ndarray) -> StepShape:
    """The step in a command: its first change, from the command (or the position, if it steps at once) before it."""
    changes = np.flatnonzero(reference != reference[0])
    if len(changes):
        return StepShape(float(reference[0]), float(reference[-1]), float(time[changes[0]]))
    return StepShape(float(position[0]), float(reference[-1]), float(time[0]))


def step_response(time: np.ndarray, position: np.ndarray, shape: StepShape) -> dict[str, float | None]:
    """Overshoot (per cent of the step, in its direction, from the command on) and settling time (2 %, from the command).

    Settling is None if the position is outside the band at the end of the run. A step of height zero has neither.
    """
    after = time >= shape.at - 1e-12
    if shape.height == 0.0 or not np.any(after):
        return {"overshoot_percent": None, "settling_time_s": None}
    progress = (position[after] - shape.initial) / shape.height
    outside = np.flatnonzero(np.abs(progress - 1.0) > SETTLING_BAND)
    overshoot = 100.0 * max(0.0, float(progress.max()) - 1.0)
    if len(outside) == 0:
        settling: float | None = 0.0
    elif outside[-1] == len(progress) - 1:
        settling = None
    else:
        settling = float(time[after][outside[-1]] - shape.at)
    return {"overshoot_percent": overshoot, "settling_time_s": settling}


def loop_metrics(run: Trajectory, name: str | None = None) -> dict[str, Any]:
    """Figures of merit of a run; see `Trajectory.metrics`."""
    tracked = run.names.get("reference", ())
    if not tracked:
        raise InvalidInput(
            "Nothing is tracked in this run.", "expected a problem with integrate=(...)", "integrate a state"
        )
    if name is not None and name not in tracked:
        raise InvalidInput(
            f"{name!r} is not tracked.", f"expected one of {list(tracked)}", "one of these names"
        )
    name = tracked[0] if name is None else name
    position, reference = run.tracked(name), run.signal("reference", name)
    error = position - reference
    tail = max(1, int(np.ceil(TAIL * len(error))))
    inputs = run.signals["input"]
    known = [k for k in run.names["estimate"] if k in run.names.get("state", ())]
    rmse = [float(np.sqrt(np.mean((run.signal("estimate", k) - run.signal("state", k)) ** 2))) for k in known]
    return {
        **step_response(run.time, position, step_shape(run.time, position, reference)),
        "steady_state_error": float(np.abs(error[-tail:]).max()),
        "peak_input": float(np.abs(inputs).max()),
        "tracking_rmse": float(np.sqrt(np.mean(error**2))),
        "estimation_rmse": rmse,
    }


def disturbance_response(
    time: np.ndarray, position: np.ndarray, command: float, height: float, at: float
) -> dict[str, float | None]:
    """Peak deviation from the command after a disturbance starts, and time to come back within 2 % of the step for good."""
    after = time >= at - 1e-12
    deviation = np.abs(position[after] - command)
    outside = np.flatnonzero(deviation > SETTLING_BAND * abs(height))
    if len(outside) == 0:
        recovery: float | None = 0.0
    elif outside[-1] == len(deviation) - 1:
        recovery = None
    else:
        recovery = float(time[after][outside[-1]] - at)
    return {"peak_deviation": float(deviation.max()), "recovery_time_s": recovery}
