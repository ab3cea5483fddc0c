"""Modes of a linearisation, named as an engineer names them, and weights scaled by what each motor moves.

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

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.loop.simulation.metrics import damping_ratio
from flexhinf.plant import Penalty
from flexhinf.robot.elastic import Layout

#: An oscillation is a vibration of the springs if they hold this fraction or more of the energy of springs and moving
#: links: one half where the motors stand still, more where they move against the links, next to nothing where links
#: and motors swing together.
SPRING_FRACTION = 0.25

#: A sampled mode whose multiplier is smaller than this is gone after one sample and has no rate.
DEADBEAT = 1e-12

#: A mode slower than this, relative to the fastest one, is at rest: a double zero eigenvalue is found only to the
#: square root of the rounding.
STANDS_STILL = 1e-7


@dataclass(frozen=True)
class Mode:
    """An eigenvalue λ with Im λ ≥ 0, standing for itself and its conjugate."""

    eigenvalue: complex  # 1/s
    vibration: bool  # of the springs; otherwise links and motors move together
    joint: str  # where most of it is

    @property
    def frequency(self) -> float:
        """|λ| / 2π, Hz."""
        return abs(self.eigenvalue) / (2.0 * np.pi)

    @property
    def damping(self) -> float:
        """−Re λ / |λ|: 1 for a mode that decays without oscillating, 0 at rest and for one that swings on, negative
        for one that grows; see `damping_ratio`."""
        return float(damping_ratio(np.array(self.eigenvalue)))

    @property
    def stable(self) -> bool:
        """Whether the mode decays."""
        return self.damping > 0.0

    @property
    def name(self) -> str:
        """Name of the mode."""
        if self.eigenvalue == 0.0:
            return "free motion"
        if self.vibration:
            return "vibration"
        return "swing" if self.eigenvalue.imag else ("motion" if self.stable else "fall")

    @property
    def time_constant(self) -> float | None:
        """1 / |Re λ|, s: to decay, or to grow, by the factor e; None for a mode that does neither."""
        return 1.0 / abs(self.eigenvalue.real) if self.damping else None


def modes_of(
    a: np.ndarray, joints: Sequence[str], stiffness: np.ndarray, inertia: np.ndarray
) -> tuple[Mode, ...]:
    """Modes of ẋ = A x, slowest first; see `named_modes`."""
    return named_modes(*np.linalg.eig(a), joints, stiffness, inertia)


def named_modes(
    values: np.ndarray, vectors: np.ndarray, joints: Sequence[str], stiffness: np.ndarray, inertia: np.ndarray
) -> tuple[Mode, ...]:
    """Modes by name, slowest first.

    Eigenvalues (N,), 1/s, and eigenvectors (N, N) in columns are of a state that begins with link positions, link
    velocities, motor positions, motor velocities. The stiffness (n,) of the springs and the inertia (2n, 2n) of links
    and motors tell fractions of energy; of a rigid joint they are infinite, and zero for its motor.
    """
    fastest, n, modes = np.abs(values).max(initial=0.0), len(joints), []
    weight, rigid = np.diag(inertia), np.isinf(stiffness)
    layout, springs = Layout(n, tuple(np.flatnonzero(rigid).tolist())), np.where(rigid, 0.0, stiffness)
    for value, vector in zip(values, vectors.T):
        if value.imag < 0.0:
            continue
        q, dq, theta, _ = np.split(layout.whole(vector), 4)
        spring = springs * np.abs(theta - q) ** 2
        kinetic = float(np.real(dq.conj() @ inertia[:n, :n] @ dq))
        fraction = float(spring.sum()) / max(float(spring.sum()) + kinetic, 1e-300)
        vibration = bool(value.imag > 0.0 and fraction >= SPRING_FRACTION)
        where = spring if vibration else weight[:n] * np.abs(q) ** 2 + weight[n:] * np.abs(theta) ** 2
        still = abs(value) <= STANDS_STILL * fastest
        modes.append(Mode(0j if still else complex(value), vibration, joints[int(np.argmax(where))]))
    return tuple(sorted(modes, key=lambda mode: (abs(mode.eigenvalue), mode.joint)))


def sampled_modes(
    values: np.ndarray, vectors: np.ndarray, period: float, *names: Any, lasting: float = DEADBEAT
) -> tuple[Mode, ...]:
    """Modes of a sampled system with their continuous equivalents log(z)/T, slowest first; see `named_modes`.

    `names`: joints, stiffness and inertia, as of `named_modes`. `lasting`: modes of at most this |z| are left out.
    """
    kept = np.abs(values) > lasting
    return named_modes(np.log(values[kept].astype(complex)) / period, vectors[:, kept], *names)


def closed_loop(problem: Any, gain: np.ndarray) -> np.ndarray:
    """A + B2 K (N, N) for the law u = K x (m, N), with the exact linearisation of the problem."""
    expansion = problem.expand(1)
    return expansion.f_parts[1] + expansion.g2_parts[0][:, :, 0] @ gain


def stiffness_and_inertia(
    plant: Any, equilibrium: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """K (n,) and the inertia of links and motors (2n, 2n), from the plant's own linearisation in equilibrium.

    Of a rigid joint K is infinite, and its motor's inertia is part of the link's.
    """
    p, layout = plant.parameters.named(plant.parameters.vector()), Layout.of(plant.states)
    n, elastic = layout.n, layout.elastic
    stiffness, motors = np.full(n, np.inf), np.zeros(n)
    stiffness[elastic] = np.atleast_1d(p.stiffness)
    motors[elastic] = np.atleast_1d(p.motor_inertia)[elastic]
    a, _, torques, _ = plant.linearise(*equilibrium)
    links = (
        np.linalg.inv(torques[n : 2 * n, :n])  # ∂q̈1/∂d_link = M⁻¹
        if layout.rigid
        else np.linalg.solve(a[n : 2 * n, 2 * n : 3 * n].T, np.diag(stiffness)).T  # M, as ∂q̈1/∂q2 = M⁻¹ K
    )
    inertia = np.zeros((2 * n, 2 * n))
    inertia[:n, :n], inertia[n:, n:] = (links + links.T) / 2.0, np.diag(motors)
    return stiffness, inertia


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
    def of(plant: Any, equilibrium: tuple[np.ndarray, np.ndarray]) -> JointScales:
        """Scales of a robot's plant in equilibrium."""
        stiffness, inertia = stiffness_and_inertia(plant, equilibrium)
        layout = Layout.of(plant.states)
        n, elastic = layout.n, layout.elastic
        a, b, _, _ = plant.linearise(*equilibrium)
        motors, links = np.diag(inertia)[n:], inertia[:n, :n]
        free = links[np.ix_(elastic, elastic)]
        antiresonance = np.linalg.eigvals(np.linalg.solve(free, np.diag(stiffness[elastic]))).real.min()
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

    @property
    def vibration(self) -> np.ndarray:
        """ω_v (n,), rad/s; of a rigid joint, which does not vibrate, the slowest of the others."""
        elastic, frequencies = self.layout.elastic, np.zeros(self.layout.n)
        links, motors = self.link_inertia[elastic], self.motor_inertia[elastic]
        frequencies[elastic] = np.sqrt(self.stiffness[elastic] * (1.0 / links + 1.0 / motors))
        return np.where(frequencies > 0.0, frequencies, frequencies[elastic].min())

    @property
    def split_inertia(self) -> tuple[np.ndarray, np.ndarray]:
        """Inertia before and behind each spring (n,); of a rigid joint half of its own each."""
        rigid, half = self.motor_inertia == 0.0, 0.5 * (self.link_inertia + self.motor_inertia)
        return np.where(rigid, half, self.link_inertia), np.where(rigid, half, self.motor_inertia)

    def input_per_position(self, frequency: float | np.ndarray) -> np.ndarray:
        """Input (n,) that moves each joint by one unit at an angular frequency, rad/s, without its spring."""
        total = self.link_inertia + self.motor_inertia
        return frequency * np.hypot(total * frequency, self.damping) / self.per_input

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
        rows[own[2], n + np.array(self.layout.elastic)], rows[own[2], own[3]] = -rate, rate
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
