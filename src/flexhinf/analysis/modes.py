"""Modes of sampled and closed loops, and weights scaled by what each motor moves.

Weights from a target frequency per joint and a damping weight, scaled by what each motor moves.

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

from flexhinf.plant import GeneralisedPlant, Penalty, Plant
from flexhinf.robot.layout import Layout
from flexhinf.robot.modes import (
    Mode as Mode,
    modes_of as modes_of,
    named_modes as named_modes,
    stiffness_and_inertia as stiffness_and_inertia,
)

#: A sampled mode whose multiplier is smaller than this is gone after one sample and has no rate.
DEADBEAT = 1e-12


def sampled_modes(
    values: np.ndarray, vectors: np.ndarray, period: float, *names: Any, lasting: float = DEADBEAT
) -> tuple[Mode, ...]:
    """Modes of a sampled system with their continuous equivalents log(z)/T, slowest first; see `named_modes`.

    `names`: joints and energies, as of `named_modes`. `lasting`: modes of at most this |z| are left out.
    """
    kept = np.abs(values) > lasting
    return named_modes(np.log(values[kept].astype(complex)) / period, vectors[:, kept], *names)


def closed_loop(problem: GeneralisedPlant, gain: np.ndarray) -> np.ndarray:
    """A + B2 K (N, N) for the law u = K x (m, N), with the exact linearisation of the problem."""
    expansion = problem.expand(1)
    return expansion.f_parts[1] + expansion.g2_parts[0][:, :, 0] @ gain


# Weights ------------------------------------------------------------------------------------------------
#: Weight of the integral over that of the position times ω; weight of the velocities over that of the position per ω.
INTEGRAL_WEIGHT, VELOCITY_WEIGHT = 0.5, 0.5


@dataclass(frozen=True, eq=False)
class JointScales:
    """Stiffness, inertia, damping and motor constants at a pose, by which weights are scaled."""

    stiffness: np.ndarray  # (n,), K of each joint; infinite for a rigid one
    link_inertia: np.ndarray  # (n,), M, the diagonal of the links' inertia at the pose
    motor_inertia: np.ndarray  # (n,), J; zero for a rigid joint, where it is part of M
    damping: np.ndarray  # (n,), of each motor, back-EMF included, N·m·s/rad
    per_input: np.ndarray  # (n,), torque per unit of input
    antiresonance: float  # lowest frequency at which the links vibrate while the motors are held, rad/s
    layout: Layout  # which joints have a spring
    unit: float | np.ndarray = 1.0  # (n,), in which each input is weighed, V or N·m

    @staticmethod
    def of(plant: Plant, equilibrium: tuple[np.ndarray, np.ndarray]) -> JointScales:
        """Scales of a robot's plant in equilibrium."""
        stiffness, inertia, _ = stiffness_and_inertia(plant, equilibrium)
        layout = Layout.of_plant(plant)
        n, elastic = layout.n, layout.elastic
        a, b, _, _ = plant.linearise(*equilibrium)
        motors, links = np.diag(inertia)[n:], inertia[:n, :n]
        free, moved = links[np.ix_(elastic, elastic)], layout.matrix[np.ix_(elastic, elastic)]
        springs = moved.T @ np.diag(stiffness[elastic]) @ moved
        antiresonance = np.linalg.eigvals(np.linalg.solve(free, springs)).real.min()
        rows = slice(2 * n + len(elastic), layout.mechanical)
        damping, per_input = (
            layout.motors(np.diag(links @ of_links), np.diag(of_motors) * motors[elastic])
            for of_links, of_motors in (
                (-a[n : 2 * n, n : 2 * n], -a[rows, rows]),
                (b[n : 2 * n], b[rows][:, elastic]),
            )
        )
        return JointScales(
            stiffness,
            np.diag(links),
            motors,
            damping,
            np.abs(per_input),
            float(np.sqrt(antiresonance)),
            layout,
        )

    def _at_links(self, numbers: np.ndarray) -> np.ndarray:
        """Numbers (n,) of motors or springs as each link feels them where it moves alone: the diagonal of Tᵀ … T."""
        if not self.layout.coupling:
            return numbers
        return np.square(self.layout.matrix).T @ np.where(np.isfinite(numbers), numbers, 0.0)

    @property
    def vibration(self) -> np.ndarray:
        """ω_v (n,), rad/s; of a rigid joint, which does not vibrate, the slowest of the others."""
        elastic, frequencies = self.layout.elastic, np.zeros(self.layout.n)
        links, motors = self.link_inertia[elastic], self._at_links(self.motor_inertia)[elastic]
        frequencies[elastic] = np.sqrt(self._at_links(self.stiffness)[elastic] * (1.0 / links + 1.0 / motors))
        return np.where(frequencies > 0.0, frequencies, frequencies[elastic].min())

    @property
    def split_inertia(self) -> tuple[np.ndarray, np.ndarray]:
        """Inertia before and behind each spring (n,); of a rigid joint half of its own each."""
        motors = self._at_links(self.motor_inertia)
        rigid, half = self.motor_inertia == 0.0, 0.5 * (self.link_inertia + motors)
        return np.where(rigid, half, self.link_inertia), np.where(rigid, half, motors)

    def input_per_position(self, frequency: float | np.ndarray) -> np.ndarray:
        """Input (n,) that moves each joint by one unit at an angular frequency, rad/s, without its spring."""
        total = self.link_inertia + self._at_links(self.motor_inertia)
        per_input = np.sqrt(self._at_links(self.per_input**2)) if self.layout.coupling else self.per_input
        return frequency * np.hypot(total * frequency, self._at_links(self.damping)) / per_input

    def weights(self, target_frequency: np.ndarray, damping: float | np.ndarray) -> dict[str, np.ndarray]:
        """Weight by name, (n,), or (e,) of what elastic joints have.

        `target_frequency` (n,) is ω, rad/s, `damping` is ζ of all joints or of each; 0 leaves the rates of the springs'
        torques free.
        """
        position = self.input_per_position(target_frequency) / self.unit
        velocity = VELOCITY_WEIGHT * position / target_frequency
        elastic, both = self.layout.elastic, np.ones(len(velocity))
        both[list(self.layout.rigid)] = np.sqrt(2.0)
        motors, per_input = self.motor_inertia[elastic], (self.per_input * self.unit)[elastic]
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
        """Matrix C of h(x) = C x with these weights, for (q1, q̇1, q2, q̇2, ∫); without rows of zeros."""
        n, e, w = self.layout.n, len(self.layout.elastic), self.weights(target_frequency, damping)
        ends = np.cumsum([0, n, n, e, e, n])
        own = [slice(*ends[k : k + 2]) for k in range(5)]
        rows = np.zeros((ends[-1], ends[-1]))
        names = "link_position", "link_velocity", "", "motor_velocity", "link_position_integral"
        for place, name in zip(own, names):
            if name:
                np.fill_diagonal(rows[place, place], w[name])
        rate = np.diag(w["joint_torque_rate"] * self.stiffness[self.layout.elastic])
        rows[own[2], own[1]], rows[own[2], own[3]] = -rate @ self.layout.matrix[self.layout.elastic], rate
        return rows[np.any(rows != 0.0, axis=1)]

    @property
    def r2(self) -> np.ndarray:
        """R2 (n, n): the squares of the inputs in their units."""
        return np.diag(np.broadcast_to(1.0 / np.square(self.unit), self.layout.n))

    def penalty(self, target_frequency: np.ndarray, damping: float | np.ndarray) -> Penalty:
        """Penalty of the robot with these weights, its inputs in their units."""
        weights = self.weights(np.asarray(target_frequency, dtype=float), damping)
        named = {name: w.tolist() if len(w) > 1 else float(w[0]) for name, w in weights.items() if np.any(w)}
        return Penalty(named, 1.0 / np.square(self.unit))
