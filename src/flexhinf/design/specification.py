"""What is asked for: everything that has a part in a design, with a default for each."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput

__all__ = ["ESTIMATORS", "PRESETS", "TORQUE_NOISE", "Specification"]

ESTIMATORS = ("ukf", "ekf", "observer", "none")
PRESETS = ("paper", "damped", "robust")

#: Default variance of the velocities per sample: with the default R^n the estimator is then so fast that a load on the
#: link moves it little more than with the true state fed back, see docs/design.md.
TORQUE_NOISE = 1e-7

#: A delay is a whole number of samples, to this part of one.
WHOLE = 1e-6


@dataclass(frozen=True)
class Specification:
    """Options of ``flexhinf design``; what is None is chosen by a stated rule.

    Parameters
    ----------
    pose, start : sequence of float, optional
        Goal, and where the step to it starts: link positions, rad or m. By default the robot's home, and a
        small step from the goal.
    via : sequence of poses
        Poses between start and goal at which a law is made too; the controller switches to that whose pose is nearest
        to the command, without a jump of the input.
    preset : {"paper", "damped", "robust"}, optional
        Where the weights come from, see `flexhinf.design.presets.choose`.
    bandwidth : float, or one per joint, optional
        At least, rad/s: where |command → link position| falls below 1/√2, for the robot and its tolerances.
    damping : float, optional
        Damping ratio of every oscillation at least, vibrations above all, for the robot and its tolerances.
    peak_effort : float, optional
        Of every input at most in the step, V or N·m.
    overshoot : float
        Of every link position at most in the step, per cent.
    penalty : Penalty, mapping or weights, optional
        Instead of a preset.
    effort : float, optional
        R2; by default the penalty's own.
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
    estimator : {"ukf", "ekf", "observer", "none"}
    period : float
        s.
    process_noise, torque_noise : float, optional
        Of R^v per sample: q on every state, and on the velocities alone, where torques that no model knows act. Without
        either, `TORQUE_NOISE`.
    measurement_noise : float
        R^n of a measured position (rad² or m²).
    saturation : float, optional
        ± limit of every input.
    extras : sequence of str
        What the true plant has beside the model, see `flexhinf.robot.extras`.
    delay, quantisation : float
        Of the inputs, s, and of the measurements, in their unit; the estimator knows of neither.
    load : float, optional
        Torque on every link in the disturbance response, N·m or N; a tenth of what the motors give at the peak input of
        the step.
    draws : int, optional
        Robots within their tolerances that the step is run on; 200, or 20 with many states.
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
    via: Sequence[Sequence[float]] = ()
    preset: str | None = None
    bandwidth: Any = None
    damping: float | None = None
    peak_effort: float | None = None
    overshoot: float = 5.0
    penalty: Any = None
    effort: float | None = None
    gamma_ratio: float = 1.5
    checked_gamma_ratio: float = 1.6
    checked_penalty: Any = None
    degrees: Sequence[int] | None = None
    measured: Sequence[str] = ("link_position",)
    disturbances: Sequence[str] | None = None
    command: bool = False
    estimator: str = "ukf"
    period: float = 1e-3
    process_noise: float | None = None
    torque_noise: float | None = None
    measurement_noise: float = 1e-8
    saturation: float | None = None
    extras: Sequence[str] = ()
    delay: float = 0.0
    quantisation: float = 0.0
    load: float | None = None
    draws: int | None = None
    rays: int | None = None
    duration: float | None = None
    seed: int = 0
    compare_rigid: bool = True
    mujoco: bool = False

    def __post_init__(self) -> None:
        positive = (
            "checked_gamma_ratio",
            "measurement_noise",
            "saturation",
            "peak_effort",
            "overshoot",
        )
        for name in (*positive, "effort", "duration"):
            value = getattr(self, name)
            _require(name, value, value is None or value > 0.0, "a number > 0")
        _require(
            "gamma_ratio",
            self.gamma_ratio,
            self.gamma_ratio > 1.0,
            "a number > 1, γ over the smallest feasible",
        )
        bands = (
            [] if self.bandwidth is None else np.atleast_1d(np.asarray(self.bandwidth, dtype=float)).tolist()
        )
        _require("bandwidth", self.bandwidth, all(0.0 < b < math.inf for b in bands), "rad/s > 0")
        _require("preset", self.preset, self.preset is None or self.preset in PRESETS, ", ".join(PRESETS))
        _require(
            "damping", self.damping, self.damping is None or 0.0 <= self.damping < 1.0, "a ratio from 0 to 1"
        )
        for name in ("delay", "quantisation"):
            _require(name, getattr(self, name), getattr(self, name) >= 0.0, "a number >= 0")
        _require("load", self.load, self.load is None or math.isfinite(self.load), "a torque")
        _require("draws", self.draws, self.draws is None or self.draws >= 0, "an integer >= 0")
        for name in ("process_noise", "torque_noise"):
            value = getattr(self, name)
            _require(name, value, value is None or value >= 0.0, "a variance >= 0")
        _require("estimator", self.estimator, self.estimator in ESTIMATORS, ", ".join(ESTIMATORS))
        _require("period", self.period, 1e-5 <= self.period <= 1.0, "1e-5 to 1 s")
        late = self.delay / self.period
        _require("delay", self.delay, abs(late - round(late)) <= WHOLE, f"a multiple of {self.period:g} s")
        _require("rays", self.rays, self.rays is None or self.rays >= 0, "an integer >= 0")
        _require("seed", self.seed, 0 <= self.seed < 2**63, "an integer >= 0")
        if self.degrees is not None:
            fine = len(self.degrees) > 0 and all(2 <= degree <= 12 for degree in self.degrees)
            _require("degrees", list(self.degrees), fine, "integers from 2 to 12, of V")
            object.__setattr__(self, "degrees", tuple(sorted(set(self.degrees))))

    @property
    def effort_limit(self) -> float | None:
        """The largest input that is allowed, by what was asked for and by the motors; None for no limit."""
        limits = [limit for limit in (self.peak_effort, self.saturation) if limit is not None]
        return min(limits, default=None)

    @property
    def noises(self) -> tuple[float, float]:
        """Variance per sample on every state, and on the velocities alone."""
        everywhere, torques = self.process_noise, self.torque_noise
        if everywhere is None and torques is None:
            return 0.0, TORQUE_NOISE
        return everywhere or 0.0, torques or 0.0


def _require(name: str, value: Any, holds: bool, expected: str) -> None:
    finite = not isinstance(value, float) or math.isfinite(value)
    if not (holds and finite):
        option = f"--{name.replace('_', '-')}"
        raise InvalidInput(
            f"The {name.replace('_', ' ')} cannot be used.",
            f"expected {expected}, got {value!r}",
            f"{option} …",
        )
