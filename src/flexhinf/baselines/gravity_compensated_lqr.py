"""LQR with the weight compensated exactly, through the springs: what a practitioner would try before any H∞."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.baselines.equilibrium_law import PlacedLaw, equilibrium_of
from flexhinf.baselines.gravity import GravityTorque
from flexhinf.baselines.joints import ElasticJoints, check_joints, elastic_joints
from flexhinf.baselines.linear_quadratic import checked_gain, lqr_gain
from flexhinf.plant import GeneralisedPlant


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class GravityCompensatedLQR(PlacedLaw):
    """κ(x) = k_u⁻¹ G(q) + K (q, q̇, θ − K_s⁻¹ G(q), θ̇ − K_s⁻¹ Ġ(q), e): the LQR of the weightless robot, and its weight.

    At link positions q the weight G(q) is held by the springs, wound up by K_s⁻¹ G(q), and by the inputs; the gain
    acts on the motors relative to that wind-up, which itself moves at the rate K_s⁻¹ ∂G/∂q q̇. About a reference,
    k = κ(x_d + δ) − κ(x_d), so every pose held is an equilibrium.

    Parameters
    ----------
    plant, equilibrium, integrate
        See `flexhinf.baselines.equilibrium_law.EquilibriumLaw`; the plant has elastic joints.
    gains : (n, states) array
        K, of the weightless robot.
    gravity : callable, optional
        ``gravity(q, p)`` → G, see `flexhinf.baselines.gravity.GravityTorque`; from the plant's flow by default.
    """

    gains: Any
    gravity: Callable[[Any, Any], Any] | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_joints(self.plant)
        object.__setattr__(
            self, "gains", checked_gain(self.gains, len(self.input_names), len(self.state_names))
        )

    @staticmethod
    def design(
        problem: GeneralisedPlant, effort: float = 1.0, gravity: Callable[[Any, Any], Any] | None = None
    ) -> GravityCompensatedLQR:
        """The LQR of the robot with g = 0 at the same pose, for the same penalty, with the weight of the robot.

        Parameters
        ----------
        problem : GeneralisedPlant
            Of a plant with a parameter ``gravity``, m/s².
        effort : float
            Factor of R2, see `lqr_gain`.
        gravity : callable, optional
            See the class.

        Raises
        ------
        InvalidInput
            If the plant has no elastic joints, or no parameter ``gravity``.
        NumericalFailure
            If the weightless robot has no LQR.
        """
        plant, (x, u) = problem.plant, equilibrium_of(problem)
        n = check_joints(plant)
        weightless = plant.with_parameters(gravity=np.zeros_like(plant.parameters.values.get("gravity", 0.0)))
        relaxed = np.concatenate([x[:n], np.zeros(n), x[:n], np.zeros(n)])
        light = replace(problem, plant=weightless, pose=None, equilibrium=(relaxed, np.zeros_like(u)))
        return GravityCompensatedLQR(
            plant=plant,
            equilibrium=(x, u),
            integrate=problem.integrate,
            gains=lqr_gain(light, effort),
            gravity=gravity,
        )

    @cached_property
    def joints(self) -> ElasticJoints:
        """The joints' numbers at the equilibrium."""
        return elastic_joints(self.plant, *self.equilibrium)

    @cached_property
    def _weight(self) -> GravityTorque:
        return GravityTorque(self.plant, self.gravity)

    @property
    def numbers(self) -> np.ndarray:
        """Gain, stiffness, torque per input, and the plant's parameters."""
        joints, p = self.joints, self.plant.parameters.vector()
        return np.concatenate([self.gains.ravel(), joints.stiffness, joints.torque_per_input, p])

    @property
    def law_key(self) -> str:
        """The code of G."""
        return f"LQR with gravity compensation {self._weight.key}"

    def feedback(self, x: Any, state: Any, input: Any, numbers: Any) -> Any:
        """k (n,) for a deviation x from the reference, of any element."""
        n, end = len(self.input_names), self.gains.size
        gain = numbers[:end].reshape(n, -1)
        stiffness, per_input, p = (
            numbers[end : end + n],
            numbers[end + n : end + 2 * n],
            numbers[end + 2 * n :],
        )
        states = self.plant.n
        torque, rate = self._weight.torque_and_rate(state[:n] + x[:n], state[n : 2 * n] + x[n : 2 * n], p)
        torque_d, rate_d = self._weight.torque_and_rate(state[:n], state[n : 2 * n], p)
        held, moving = torque - torque_d, rate - rate_d
        motor, speed = x[2 * n : 3 * n] - held / stiffness, x[3 * n : states] - moving / stiffness
        return held / per_input + gain @ np.concatenate([x[: 2 * n], motor, speed, x[states:]])
