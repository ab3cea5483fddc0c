"""Weights from a target frequency per joint and a damping weight, scaled by what each motor moves.

For a motor that moves the inertia M + J against a damping d, uᵀu costs as much as (w q)² at the angular frequency ω if
w = |(M + J) ω² − i d ω| per unit of input. So R2 = 1, and each joint has

    w_position = ω √((M + J)² ω² + d²) / k,   w_velocity = w_position / 2ω,   w_integral = w_position ω / 2

with k the torque per unit of input, all at the goal pose. The vibration has a weight of its own, on the rate of the
spring's torque: a spring between M and J alone, its motor paid with uᵀu, gets the damping ratio ζ from a weight
2 ζ ω_v J/k on the rate of its twist, ω_v² = K (1/M + 1/J); on the rate of its torque that is

    w_torque_rate = 2 ζ ω_v J / (k K).

It hardly touches the slow motion. A rigid joint has M + J in one, no vibration, and the weights of both velocities on
its link's. The search is over the target frequency ω of each joint and one damping weight ζ.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.design.modes import stiffness_and_inertia
from flexhinf.plant import Penalty
from flexhinf.robot.elastic import Layout

#: Weight of the integral over that of the position times ω; weight of the velocities over that of the position per ω.
INTEGRAL_WEIGHT, VELOCITY_WEIGHT = 0.5, 0.5


#: All joints have a spring, however many there are.
EVERY = Layout(0)


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
    layout : Layout, optional
        Which joints have a spring, all by default; of the others K is infinite, J zero and part of M.
    """

    stiffness: np.ndarray
    link_inertia: np.ndarray
    motor_inertia: np.ndarray
    damping: np.ndarray
    per_input: np.ndarray
    held: float
    layout: Layout = EVERY

    def __post_init__(self) -> None:
        if self.layout is EVERY:
            object.__setattr__(self, "layout", Layout(len(self.stiffness)))

    @staticmethod
    def of(plant: Any, equilibrium: tuple[np.ndarray, np.ndarray]) -> JointScales:
        """Of a robot's plant at equilibrium."""
        stiffness, inertia = stiffness_and_inertia(plant, equilibrium)
        layout = Layout.of(plant.states)
        n, elastic = layout.n, layout.elastic
        a, b, _, _ = plant.linearise(*equilibrium)
        motors, links = np.diag(inertia)[n:], inertia[:n, :n]
        free = links[np.ix_(elastic, elastic)]
        held = np.linalg.eigvals(np.linalg.solve(free, np.diag(stiffness[elastic]))).real.min()
        rows = slice(2 * n + len(elastic), layout.mechanical)
        damping, per_input = (
            layout.motors(np.diag(links @ of_links), np.diag(of_motors) * motors[elastic])
            for of_links, of_motors in (
                (-a[n : 2 * n, n : 2 * n], -a[rows, rows]),
                (b[n : 2 * n], b[rows][:, elastic]),
            )
        )
        return JointScales(
            stiffness, np.diag(links), motors, damping, np.abs(per_input), float(np.sqrt(held)), layout
        )

    @property
    def vibration(self) -> np.ndarray:
        """ω_v (n,), rad/s; of a rigid joint, which does not vibrate, the slowest of the others."""
        elastic, found = self.layout.elastic, np.zeros(self.layout.n)
        links, motors = self.link_inertia[elastic], self.motor_inertia[elastic]
        found[elastic] = np.sqrt(self.stiffness[elastic] * (1.0 / links + 1.0 / motors))
        return np.where(found > 0.0, found, found[elastic].min())

    @property
    def sides(self) -> tuple[np.ndarray, np.ndarray]:
        """Inertia before and behind each spring (n,); of a rigid joint half of its own each."""
        both = self.link_inertia, self.motor_inertia
        rigid = self.motor_inertia == 0.0
        return tuple(np.where(rigid, 0.5 * (both[0] + both[1]), side) for side in both)  # type: ignore[return-value]

    def weights(self, target_frequency: np.ndarray, damping: float | np.ndarray) -> dict[str, np.ndarray]:
        """Weight by name, (n,), or (e,) of what elastic joints have.

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
        elastic, both = self.layout.elastic, np.ones(len(velocity))
        both[list(self.layout.rigid)] = np.sqrt(2.0)
        motors, per_input = self.motor_inertia[elastic], self.per_input[elastic]
        ratio = np.broadcast_to(damping, len(velocity))[elastic]
        twist_rate = 2.0 * ratio * self.vibration[elastic] * motors / per_input
        return {
            "link_position": position,
            "link_velocity": both * velocity,
            "motor_velocity": velocity[elastic],
            "joint_torque_rate": twist_rate / self.stiffness[elastic],
            "link_position_integral": INTEGRAL_WEIGHT * position * target_frequency,
        }

    def rows(self, target_frequency: np.ndarray, damping: float | np.ndarray) -> np.ndarray:
        """h(x) = C x of the same weights, for (q1, q̇1, q2, q̇2, ∫); without rows of zeros."""
        n, e, w = self.layout.n, len(self.layout.elastic), self.weights(target_frequency, damping)
        ends = np.cumsum([0, n, n, e, e, n])
        own = [slice(*ends[k : k + 2]) for k in range(5)]
        rows = np.zeros((ends[-1], ends[-1]))
        names = "link_position", "link_velocity", "", "motor_velocity", "link_position_integral"
        for place, name in zip(own, names):
            if name:
                np.fill_diagonal(rows[place, place], w[name])
        rate = np.diag(w["joint_torque_rate"] * self.stiffness[self.layout.elastic])
        rows[own[2], n + np.array(self.layout.elastic)], rows[own[2], own[3]] = -rate, rate
        return rows[np.any(rows != 0.0, axis=1)]

    def penalty(self, target_frequency: np.ndarray, damping: float | np.ndarray) -> Penalty:
        """The same as a penalty of the robot with R2 = 1."""
        named = {
            name: weight.tolist() if len(weight) > 1 else float(weight[0])
            for name, weight in self.weights(np.asarray(target_frequency, dtype=float), damping).items()
            if np.any(weight)
        }
        return Penalty(named, 1.0)
