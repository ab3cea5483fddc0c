"""Modes of a linearisation, named as an engineer names them: frequency, damping, joint, vibration or swing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, cast

import numpy as np

from flexhinf.arrays import Matrix
from flexhinf.robot.layout import Layout
from flexhinf.scalars.spectral import damping_ratio

#: An oscillation is a vibration of the springs if they hold this fraction or more of the energy of springs and moving
#: links: one half where the motors stand still, more where they move against the links, next to nothing where links
#: and motors swing together.
SPRING_FRACTION = 0.25

#: A mode slower than this, relative to the fastest one, is at rest: a double zero eigenvalue is found only to the
#: square root of the rounding.
STANDS_STILL = 1e-7


@dataclass(frozen=True, repr=False)
class Mode:
    """An eigenvalue λ with Im λ ≥ 0, standing for itself and its conjugate."""

    eigenvalue: complex  # 1/s
    vibration: bool  # of the springs; otherwise links and motors move together
    joint: str  # where most of it is

    def __repr__(self) -> str:
        return f"<{self.name} of {self.joint}: {self.frequency:.4g} Hz, damping {self.damping:.3g}>"

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


class Energy(NamedTuple):
    """What tells fractions of energy: K (n,) of the springs, the inertia of links and motors (2n, 2n), and T (n, n) of
    the motors that move more than one joint. Of a rigid joint K is infinite, and its motor's inertia is part of the
    link's."""

    stiffness: np.ndarray
    inertia: np.ndarray
    coupling: np.ndarray


def modes_of(a: np.ndarray, joints: Sequence[str], *energy: np.ndarray) -> tuple[Mode, ...]:
    """Modes of ẋ = A x, slowest first; see `named_modes`."""
    return named_modes(*np.linalg.eig(a), joints, *energy)


def named_modes(
    values: np.ndarray,
    vectors: np.ndarray,
    joints: Sequence[str],
    stiffness: np.ndarray,
    inertia: np.ndarray,
    coupling: np.ndarray,
) -> tuple[Mode, ...]:
    """Modes by name, slowest first.

    Eigenvalues (N,), 1/s, and eigenvectors (N, N) in columns are of a state that begins with link positions, link
    velocities, motor positions, motor velocities. The others are those of `Energy`.
    """
    fastest, n, modes = np.abs(values).max(initial=0.0), len(joints), list[Mode]()
    weight, rigid = np.diag(inertia), np.isinf(stiffness)
    layout, springs = Layout(n, tuple(np.flatnonzero(rigid).tolist())), np.where(rigid, 0.0, stiffness)
    for value, vector in zip(values, vectors.T):
        if value.imag < 0.0:
            continue
        q, dq, theta, _ = np.split(layout.whole(vector), 4)
        spring = springs * np.abs(theta - coupling @ q) ** 2
        kinetic = float(np.real(dq.conj() @ inertia[:n, :n] @ dq))
        fraction = float(spring.sum()) / max(float(spring.sum()) + kinetic, 1e-300)
        still = abs(value) <= STANDS_STILL * fastest
        vibration = bool(not still and value.imag > 0.0 and fraction >= SPRING_FRACTION)
        where = spring if vibration else weight[:n] * np.abs(q) ** 2 + weight[n:] * np.abs(theta) ** 2
        modes.append(Mode(0j if still else complex(value), vibration, joints[int(np.argmax(where))]))
    return tuple(sorted(modes, key=lambda mode: (abs(mode.eigenvalue), mode.joint)))


def stiffness_and_inertia(plant: Any, equilibrium: tuple[np.ndarray, np.ndarray]) -> Energy:
    """The energies from the plant's own linearisation in equilibrium."""
    p, layout = plant.parameters.named(plant.parameters.vector()), Layout.of_plant(plant)
    n, elastic = layout.n, layout.elastic
    stiffness, motors = np.full(n, np.inf), np.zeros(n)
    stiffness[elastic] = np.atleast_1d(p.stiffness)
    motors[elastic] = np.atleast_1d(p.motor_inertia)[elastic]
    a, _, torques, _ = plant.linearise(*equilibrium)
    if layout.rigid or layout.coupling:
        links = cast("Matrix", np.linalg.inv(torques[n : 2 * n, :n]))  # ∂q̈1/∂d_link = M⁻¹
    else:  # M, as ∂q̈1/∂q2 = M⁻¹ K
        links = cast("Matrix", np.linalg.solve(a[n : 2 * n, 2 * n : 3 * n].T, np.diag(stiffness))).T
    inertia = np.zeros((2 * n, 2 * n))
    inertia[:n, :n], inertia[n:, n:] = (links + links.T) / 2.0, np.diag(motors)
    return Energy(stiffness, inertia, layout.matrix)
