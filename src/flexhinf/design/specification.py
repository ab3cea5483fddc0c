"""What is asked for: everything that has a part in a design, with a default for each."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from flexhinf.errors import InvalidInput

__all__ = ["ESTIMATORS", "Specification"]

ESTIMATORS = ("ukf", "ekf", "none")


@dataclass(frozen=True)
class Specification:
    """Options of ``flexhinf design``; what is None is chosen by a stated rule.

    Parameters
    ----------
    pose, start : sequence of float, optional
        Goal, and where the step to it starts: link positions, rad or m. By default the robot's home, and a
        small step from the goal.
    penalty : Penalty, mapping or weights, optional
        By default the robot's own, or else weights from a bandwidth, see `flexhinf.design.weights`.
    effort : float, optional
        R2; by default the penalty's own.
    bandwidth : float, optional
        Hz, of the weights where the penalty is ours.
    gamma_ratio, checked_gamma_ratio : float
        γ/γ* of the design, and of the inequality that is checked.
    checked_penalty : optional
        Of the inequality that is checked; 0.9 times the designed one by default.
    degrees : sequence of int, optional
        Of V; by the number of states.
    measured : sequence of str
        As for `Robot.plant`.
    disturbances : sequence of str, optional
        Torques that are disturbances of the synthesis; without them the command is (the paper's choice).
    command : bool
        Whether the command is one beside them.
    estimator : {"ukf", "ekf", "none"}
    period : float
        s.
    process_noise, measurement_noise : float
        q of R^v = q I, and R^n of a measured position (rad² or m²).
    saturation : float, optional
        ± limit of every input.
    extras : sequence of str
        What the true plant has beside the model, see `flexhinf.robot.extras`.
    rays : int, optional
        Of the sampled region; 0 leaves it out. By the number of states.
    duration : float, optional
        Of the step response, s; by the slowest mode.
    seed : int
    compare_rigid : bool
        Whether the same specification is designed on the rigid model too.
    mujoco : bool
        Whether the step is run on MuJoCo's plant too.

    Raises
    ------
    InvalidInput
        For a value outside its range.
    """

    pose: Sequence[float] | None = None
    start: Sequence[float] | None = None
    penalty: Any = None
    effort: float | None = None
    bandwidth: float | None = None
    gamma_ratio: float = 1.5
    checked_gamma_ratio: float = 1.6
    checked_penalty: Any = None
    degrees: Sequence[int] | None = None
    measured: Sequence[str] = ("link_position",)
    disturbances: Sequence[str] | None = None
    command: bool = False
    estimator: str = "ukf"
    period: float = 1e-3
    process_noise: float = 1e-10
    measurement_noise: float = 1e-8
    saturation: float | None = None
    extras: Sequence[str] = ()
    rays: int | None = None
    duration: float | None = None
    seed: int = 0
    compare_rigid: bool = True
    mujoco: bool = False

    def __post_init__(self) -> None:
        positive = ("bandwidth", "gamma_ratio", "checked_gamma_ratio", "measurement_noise", "saturation")
        for name in (*positive, "effort", "duration"):
            value = getattr(self, name)
            _require(name, value, value is None or value > 0.0, "a number > 0")
        _require("process_noise", self.process_noise, self.process_noise >= 0.0, "a variance >= 0")
        _require("estimator", self.estimator, self.estimator in ESTIMATORS, ", ".join(ESTIMATORS))
        _require("period", self.period, 1e-5 <= self.period <= 1.0, "1e-5 to 1 s")
        _require("rays", self.rays, self.rays is None or self.rays >= 0, "an integer >= 0")
        _require("seed", self.seed, 0 <= self.seed < 2**63, "an integer >= 0")
        if self.degrees is not None:
            fine = len(self.degrees) > 0 and all(2 <= degree <= 12 for degree in self.degrees)
            _require("degrees", list(self.degrees), fine, "integers from 2 to 12, of V")
            object.__setattr__(self, "degrees", tuple(sorted(set(self.degrees))))


def _require(name: str, value: Any, holds: bool, expected: str) -> None:
    finite = not isinstance(value, float) or math.isfinite(value)
    if not (holds and finite):
        option = f"--{name.replace('_', '-')}"
        raise InvalidInput(
            f"The {name.replace('_', ' ')} cannot be used.",
            f"expected {expected}, got {value!r}",
            f"{option} …",
        )
