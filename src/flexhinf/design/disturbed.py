"""What torques on the links do to the robot at its goal."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.design.bench import Bench
from flexhinf.design.response import Response, run_to
from flexhinf.loop import Step
from flexhinf.robot.signals import signal_names

__all__ = ["LOAD_SHARE", "Disturbed", "default_load", "disturbed_response"]

#: Default torque: this share of what the motors give at the peak input of the step.
LOAD_SHARE = 0.1

#: The torques begin at this share of the run.
BEGINNING = 0.1

#: A joint has recovered when it stays within this share of its largest deviation.
RECOVERED = 0.05


@dataclass(frozen=True, eq=False)
class Disturbed:
    """A run with torques on all links.

    Attributes
    ----------
    response : Response
        At rest at the goal, until the torques begin.
    load : (n,)
        N·m or N.
    at : float
        When they begin, s.
    """

    response: Response
    load: np.ndarray
    at: float

    @property
    def metrics(self) -> list[dict[str, Any]]:
        """Peak deviation, time to recover (None if it does not) and remaining error of each joint."""
        if self.response.diverged is not None:
            return [{} for _ in self.load]
        time = self.response.run.time
        after = time >= self.at
        rows = []
        for joint, goal in enumerate(self.response.goal):
            away = np.abs(self.response.positions[after, joint] - goal)
            outside = np.flatnonzero(away > RECOVERED * away.max())
            back = None if len(outside) and outside[-1] == len(away) - 1 else 0.0
            if back is not None and len(outside):
                back = float(time[after][outside[-1]] - self.at)
            rows.append(
                {
                    "load": float(self.load[joint]),
                    "peak_deviation": float(away.max()),
                    "recovery_time_s": back,
                    "remaining": float(away[-max(1, len(away) // 10) :].max()),
                }
            )
        return rows


def default_load(per_input: np.ndarray, peak: np.ndarray) -> np.ndarray:
    """A tenth of the torque (n,) that the motors give at the peak inputs of the step, signed alike."""
    return LOAD_SHARE * per_input * np.maximum(peak, LOAD_SHARE * peak.max())


def disturbed_response(
    bench: Bench, load: np.ndarray, duration: float, law: Any = None, plant: Any = None
) -> Disturbed:
    """Constant torques on all links from a tenth of the run on."""
    at = round(BEGINNING * duration / bench.specification.period) * bench.specification.period
    names = signal_names("link_torque", bench.robot.joint_names)
    torques = {name: Step(float(torque), at=at) for name, torque in zip(names, load)}
    x, u = bench.rest(bench.goal)
    loop = bench.loop(bench.controller(bench.goal, law=law), plant)
    response = run_to(
        loop, bench.goal, bench.goal, disturbance=torques, noise=bench.noise, duration=duration,
        initial_state=x, initial_input=u, seed=bench.specification.seed,
    )  # fmt: skip
    return Disturbed(response, load, at)
