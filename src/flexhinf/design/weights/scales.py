"""Weights from a target frequency per joint and a damping weight, scaled by what each motor moves.

For a motor that moves the inertia M + J against a damping d, uᵀu costs as much as (w q)² at the angular frequency ω if
w = |(M + J) ω² − i d ω| per unit of input. So R2 = 1, and each joint has

    w_position = ω √((M + J)² ω² + d²) / k,   w_velocity = w_position / 2ω,   w_integral = w_position ω / 2

with k the torque per unit of input, all at the goal pose. The vibration has a weight of its own, on the rate of the
spring's torque: a spring between M and J alone, its motor paid with uᵀu, gets the damping ratio ζ from a weight
2 ζ ω_v J/k on the rate of its twist, ω_v² = K (1/M + 1/J); on the rate of its torque that is

    w_torque_rate = 2 ζ ω_v J / (k K).

It hardly touches the slow motion. The search is over the target frequency ω of each joint and one damping weight ζ.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.design.modes import stiffness_and_inertia
from flexhinf.plant import Penalty

__all__ = ["INTEGRAL_WEIGHT", "VELOCITY_WEIGHT", "JointScales"]

#: Weight of the integral over that of the position times ω; weight of the velocities over that of the position per ω.
INTEGRAL_WEIGHT, VELOCITY_WEIGHT = 0.5, 0.5


@dataclass(frozen=True, eq=False)
class JointScales:
    """What weights are scaled by, at a pose.

    Attributes
    ----------
    stiffness, link_inertia, motor_inertia : (n,)
        K, M, J of each joint; M is the diagonal of the links' inertia at the pose.
    damping : (n,)
        Of each motor, back-EMF included, N·m·s/rad.
    per_input : (n,)
        Torque per unit of input.
    held : float
        Lowest frequency at which the links vibrate while the motors are held, rad/s.
    """

    stiffness: np.ndarray
    link_inertia: np.ndarray
    motor_inertia: np.ndarray
    damping: np.ndarray
    per_input: np.ndarray
    held: float

    @staticmethod
    def of(plant: Any, equilibrium: tuple[np.ndarray, np.ndarray]) -> JointScales:
        """Of a robot's plant at equilibrium."""
        stiffness, inertia = stiffness_and_inertia(plant, equilibrium)
        n = len(stiffness)
        a, b, _, _ = plant.linearise(*equilibrium)
        motors, links = np.diag(inertia)[n:], inertia[:n, :n]
        held = np.linalg.eigvals(np.linalg.solve(links, np.diag(stiffness))).real.min()
        return JointScales(
            stiffness,
            np.diag(links),
            motors,
            -np.diag(a[3 * n : 4 * n, 3 * n : 4 * n]) * motors,
            np.abs(np.diag(b[3 * n : 4 * n]) * motors),
            float(np.sqrt(held)),
        )

    @property
    def vibration(self) -> np.ndarray:
        """ω_v (n,), rad/s."""
        return np.sqrt(self.stiffness * (1.0 / self.link_inertia + 1.0 / self.motor_inertia))

    def weights(self, target_frequency: np.ndarray, damping: float | np.ndarray) -> dict[str, np.ndarray]:
        """Weight (n,) by name.

        Parameters
        ----------
        target_frequency : (n,)
            ω of each joint, rad/s.
        damping : float or (n,)
            ζ, of all joints or of each; 0 leaves the rates of the springs' torques free.
        """
        total = self.link_inertia + self.motor_inertia
        position = target_frequency * np.hypot(total * target_frequency, self.damping) / self.per_input
        velocity = VELOCITY_WEIGHT * position / target_frequency
        twist_rate = 2.0 * damping * self.vibration * self.motor_inertia / self.per_input
        return {
            "link_position": position,
            "link_velocity": velocity,
            "motor_velocity": velocity,
            "joint_torque_rate": twist_rate / self.stiffness,
            "link_position_integral": INTEGRAL_WEIGHT * position * target_frequency,
        }

    def rows(self, target_frequency: np.ndarray, damping: float | np.ndarray) -> np.ndarray:
        """h(x) = C x of the same weights, for (q1, q̇1, q2, q̇2, ∫): (5n, 5n); without rows of zeros."""
        n, w = len(self.stiffness), self.weights(target_frequency, damping)
        rows = np.zeros((5 * n, 5 * n))
        for k, name in enumerate(
            ("link_position", "link_velocity", "", "motor_velocity", "link_position_integral")
        ):
            if name:
                np.fill_diagonal(rows[k * n : (k + 1) * n, k * n : (k + 1) * n], w[name])
        rate, place = w["joint_torque_rate"] * self.stiffness, slice(2 * n, 3 * n)
        rows[place, n : 2 * n], rows[place, 3 * n : 4 * n] = -np.diag(rate), np.diag(rate)
        return rows[np.any(rows != 0.0, axis=1)]

    def penalty(self, target_frequency: np.ndarray, damping: float | np.ndarray) -> Penalty:
        """The same as a penalty of the robot with R2 = 1."""
        named = {
            name: weight.tolist() if len(weight) > 1 else float(weight[0])
            for name, weight in self.weights(np.asarray(target_frequency, dtype=float), damping).items()
            if np.any(weight)
        }
        return Penalty(named, 1.0)
