"""The plants of a loop: the model, the estimator's, the true one and its smooth part; and what lies between them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from flexhinf.design.estimators import noise_variances, sensor_steps
from flexhinf.design.joint_limits import JointLimits, joint_limits
from flexhinf.design.specification import Specification
from flexhinf.plant import Plant, sub_steps
from flexhinf.robot import MuJoCoPlant, Robot
from flexhinf.robot.extras import DRY

#: Largest step of MuJoCo's Runge–Kutta method times the fastest mode, rad.
MUJOCO_STEP = 0.1

#: Extras whose linearisation at standstill holds for more than the smallest motion. Dry friction and backlash are
#: left out of the linear loop: their slope at standstill holds only below the smoothing velocity, and there it would
#: count as damping that the moving robot does not have.
SMOOTH_EXTRAS = ("inductance", "joint_damping", "spring_hardening")

#: Estimators that may have dry friction in their model. The observer's gain belongs to a model without.
FRICTIONAL = ("ukf", "ekf")


@dataclass(frozen=True, eq=False)
class LoopPlants:
    """What of a loop there is before a law.

    Parameters
    ----------
    specification : Specification
        Sensors, quantisation, limits, extras and noise.
    """

    robot: Robot
    specification: Specification

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints."""
        return self.robot.joint_names

    @cached_property
    def model(self) -> Plant:
        """The nominal robot with the sensors: what the estimator assumes, but for dry friction."""
        return self.robot.plant(self.specification.measured)

    @property
    def dry_friction(self) -> tuple[str, ...]:
        """Extras of the true plant that are dry friction: the feedforward has them, the estimator on request."""
        return tuple(name for name in self.specification.extras if name in DRY)

    @cached_property
    def estimator_model(self) -> Plant:
        """The model of the running estimator: on request with dry friction, smoothed. At standstill its slope would
        count as damping, so linear figures are those of `model`."""
        s = self.specification
        known = s.friction_model and s.estimator in FRICTIONAL
        return self.robot.plant(s.measured, extras=self.dry_friction) if known else self.model

    @cached_property
    def true_plant(self) -> Plant:
        """The nominal robot with the extras."""
        s = self.specification
        return self.robot.plant(s.measured, extras=s.extras)

    def mujoco_plant(self, at: np.ndarray) -> MuJoCoPlant:
        """The same robot in MuJoCo, its step a tenth of a radian of the fastest mode's phase at a pose (n,), or less.

        Raises
        ------
        InvalidInput
            If MuJoCo is not installed, or does not express the extras.
        """
        s = self.specification
        fastest = self.true_plant.fastest_mode(*self.robot.operating_point(at, s.extras))
        step = s.period / sub_steps(s.period, fastest, MUJOCO_STEP)
        measured = None if s.estimator == "none" else s.measured
        return MuJoCoPlant(self.robot, measured=measured, step=step, extras=s.extras)

    @cached_property
    def smooth_plant(self) -> Plant:
        """The true plant without the extras that are not smooth at standstill: what the linear loop has."""
        s = self.specification
        smooth = tuple(name for name in s.extras if name in SMOOTH_EXTRAS)
        return self.true_plant if smooth == tuple(s.extras) else self.robot.plant(s.measured, extras=smooth)

    @property
    def left_out(self) -> tuple[str, ...]:
        """Extras of the true plant that the linear loop does not have."""
        return tuple(name for name in self.specification.extras if name not in SMOOTH_EXTRAS)

    @cached_property
    def limits(self) -> JointLimits:
        """Of inputs, speeds and positions: the specification's, or the robot's own."""
        return joint_limits(self.robot, self.specification)

    @cached_property
    def quantisation(self) -> np.ndarray | None:
        """Step of what is measured, (p,), or one number for the whole state that is fed back; None without any."""
        steps = sensor_steps(self.robot, self.specification)
        return steps if steps.any() else None

    @cached_property
    def noise(self) -> np.ndarray | None:
        """Standard deviations (p,) of the measurement noise; None where the true state is fed back."""
        s = self.specification
        return None if s.estimator == "none" else np.sqrt(noise_variances(self.model, s.measurement_noise))
