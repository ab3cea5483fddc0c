"""Modes of a linearisation, named as an engineer names them: vibration of a spring, or motion of the whole."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.analysis import LinearLoop
from flexhinf.estimation import stationary_gain
from flexhinf.loop.simulation.metrics import damping_ratio
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
    """An eigenvalue λ with Im λ ≥ 0, standing for itself and its conjugate.

    Attributes
    ----------
    eigenvalue : complex
        1/s.
    vibration : bool
        Whether it is a vibration of the springs; otherwise links and motors move together.
    joint : str
        Where most of it is.
    """

    eigenvalue: complex
    vibration: bool
    joint: str

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
        """Whether it decays."""
        return self.damping > 0.0

    @property
    def name(self) -> str:
        """In words."""
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

    Parameters
    ----------
    values, vectors : (N,), (N, N)
        Eigenvalues, 1/s, and eigenvectors in columns, of a state that begins with link positions, link
        velocities, motor positions, motor velocities.
    stiffness, inertia : (n,), (2n, 2n)
        Of the springs, and of links and motors; for the fractions of energy. Infinite and zero for a rigid joint and
        its motor, which counts as its link.
    """
    fastest = np.abs(values).max(initial=0.0)
    n, found = len(joints), []
    weight, layout = np.diag(inertia), Layout(n, tuple(np.flatnonzero(np.isinf(stiffness)).tolist()))
    springs = np.where(np.isinf(stiffness), 0.0, stiffness)
    for value, vector in zip(values, vectors.T):
        if value.imag < 0.0:
            continue
        q, dq, theta, _ = np.split(layout.whole(vector), 4)
        spring = springs * np.abs(theta - q) ** 2
        kinetic = float(np.real(dq.conj() @ inertia[:n, :n] @ dq))
        fraction = float(spring.sum()) / max(float(spring.sum()) + kinetic, 1e-300)
        vibration = bool(value.imag > 0.0 and fraction >= SPRING_FRACTION)
        moving = weight[:n] * np.abs(q) ** 2 + weight[n:] * np.abs(theta) ** 2
        where = spring if vibration else moving
        still = abs(value) <= STANDS_STILL * fastest
        found.append(Mode(0j if still else complex(value), vibration, joints[int(np.argmax(where))]))
    return tuple(sorted(found, key=lambda mode: (abs(mode.eigenvalue), mode.joint)))


def running_modes(
    linear: LinearLoop, joints: Sequence[str], stiffness: np.ndarray, inertia: np.ndarray
) -> tuple[Mode, ...]:
    """Modes of the running loop with their continuous equivalents log(z)/T, slowest first; see `named_modes`.

    Parameters
    ----------
    linear : LinearLoop
        Sampled, with estimator and delay.
    joints, stiffness, inertia
        As of `named_modes`.
    """
    return _sampled_modes(*linear.running.modes(), linear.period, joints, stiffness, inertia)


def estimator_modes(
    estimator: Any,
    equilibrium: tuple[np.ndarray, np.ndarray],
    joints: Sequence[str],
    stiffness: np.ndarray,
    inertia: np.ndarray,
) -> tuple[Mode, ...]:
    """Modes of the estimation error in equilibrium, with the stationary gain of the linearised filter, slowest first.

    e(k + 1) = A (1 − L C) e(k) for the sampled A, with L from the stationary Riccati equation of R^v and R^n. With the
    nominal plant the linearised loop has these modes beside those of the law.
    """
    from scipy.linalg import expm

    a, _, _, c = estimator.plant.linearise(*equilibrium)
    sampled = expm(a * estimator.period)
    gain = stationary_gain((sampled, c), estimator.process_noise, estimator.measurement_noise)
    error = sampled @ (np.eye(len(a)) - gain @ c)
    return _sampled_modes(*np.linalg.eig(error), estimator.period, joints, stiffness, inertia)


def _sampled_modes(values: np.ndarray, vectors: np.ndarray, period: float, *names: Any) -> tuple[Mode, ...]:
    kept = np.abs(values) > DEADBEAT
    rates = np.log(values[kept].astype(complex)) / period
    return named_modes(rates, vectors[:, kept], *names)


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
    if layout.rigid:
        links = np.linalg.inv(torques[n : 2 * n, :n])  # ∂q̈1/∂d_link = M⁻¹
    else:
        links = np.linalg.solve(a[n : 2 * n, 2 * n : 3 * n].T, np.diag(stiffness)).T  # M, as ∂q̈1/∂q2 = M⁻¹ K
    inertia = np.zeros((2 * n, 2 * n))
    inertia[:n, :n], inertia[n:, n:] = (links + links.T) / 2.0, np.diag(motors)
    return stiffness, inertia
