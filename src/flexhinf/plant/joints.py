"""Elastic joints of a plant: their numbers at an equilibrium, gravity torque and M⁻¹, from its exact Jacobians.

At rest M(q1) q̈1 + C q̇1 + G = K(q2 − q1) + D(q̇2 − q̇1) + d_link and J q̈2 + B q̇2 + K(q2 − q1) + D(q̇2 − q̇1) =
k_u u + d_motor, Eq. (2), are read off ẋ = A x + B u + G d: what the motors feel of d_motor is J⁻¹, what the links
feel of d_link is M⁻¹. Whatever the model adds (a damped or hardening spring, a back-EMF) is in the numbers.

The gravity torque is taken from the flow too. At rest and with its springs relaxed (q2 = q1) a robot falls by
q̈1 = −M⁻¹ G, and a torque at the links moves it by M⁻¹, so G = −(∂q̈1/∂d_link)⁻¹ q̈1 is exact for any plant of elastic
joints.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.plant.plant import Plant
from flexhinf.scalars import apply, digest

STATES = ("link_position", "link_velocity", "motor_position", "motor_velocity")
TORQUES = ("link_torque", "motor_torque")

#: Coupling between the motors of different joints, relative to their own numbers, that counts as none.
COUPLING = 1e-9


class ElasticJoints(NamedTuple):
    """Numbers of n elastic joints at an equilibrium, seen from the link side, in SI units; (n,) but for the first
    two."""

    link_inertia: np.ndarray  # M(q*), (n, n)
    gravity_slope: np.ndarray  # ∂G/∂q, (n, n)
    stiffness: np.ndarray  # K of the springs as they are there
    spring_damping: np.ndarray  # D
    motor_inertia: np.ndarray  # J
    motor_damping: np.ndarray  # B, the back-EMF's k_t k_b / R included
    torque_per_input: np.ndarray  # k_t / R, N·m/V, for a voltage; k_t, N·m/A, for a current; 1 for a torque


def check_joints(plant: Plant) -> int:
    """Number of elastic joints n of a plant with their states, 4n in the order of Eq. (2), and one input each; one of
    other states, inputs or disturbances is refused."""
    names = tuple(single for name in STATES for single in plant.expanded(name))
    torques = [single for name in TORQUES for single in plant.expanded(name)]
    fits = tuple(plant.states) == names and len(names) == 4 * len(plant.inputs)
    if not fits or not set(torques) <= set(plant.disturbances):
        raise InvalidInput(
            "The plant is not a robot with elastic joints as this law needs it.",
            f"expected the states {list(names)}, one input per joint and the disturbances {torques}, "
            f"got {list(plant.states)}, {list(plant.inputs)}, {list(plant.disturbances)}",
            "robot.plant() of a robot without rigid joints, and without the coils' inductance",
        )
    return len(plant.inputs)


def elastic_joints(plant: Plant, x: np.ndarray, u: np.ndarray) -> ElasticJoints:
    """The joints' numbers at the equilibrium (x, u), (4n,) and (n,); a plant without elastic joints, or of coupled
    motors, is refused."""
    n = check_joints(plant)
    a, b, g, _ = plant.linearise(x, u)
    links, motors = slice(n, 2 * n), slice(3 * n, 4 * n)

    def diagonal(what: str, matrix: np.ndarray) -> np.ndarray:
        alone = np.diag(matrix).copy()
        if np.abs(matrix - np.diag(alone)).max() > COUPLING * np.abs(alone).max(initial=0.0):
            raise InvalidInput(
                "The motors of different joints are coupled.",
                f"expected a {what} of each joint alone, got {matrix.tolist()}",
                "a plant of a robot of this package",
            )
        return alone

    motor_inertia = 1.0 / diagonal("motor inertia", g[motors, _places(plant, "motor_torque")])
    link_inertia = np.linalg.inv(g[links, _places(plant, "link_torque")])
    stiffness = motor_inertia * diagonal("stiffness", a[motors, :n])
    damping = motor_inertia * diagonal("spring damping", a[motors, links])
    return ElasticJoints(
        link_inertia=(link_inertia + link_inertia.T) / 2.0,
        gravity_slope=-link_inertia @ a[links, :n] - np.diag(stiffness),
        stiffness=stiffness,
        spring_damping=damping,
        motor_inertia=motor_inertia,
        motor_damping=-motor_inertia * diagonal("motor damping", a[motors, motors]) - damping,
        torque_per_input=motor_inertia * diagonal("input", b[motors]),
    )


def _places(plant: Plant, torque: str) -> list[int]:
    return [plant.disturbances.index(name) for name in plant.expanded(torque)]  # type: ignore[union-attr]


def _static(plant: Plant, name: str, quantity: Callable[[Any, Any], Any]) -> Any:
    """(q, parameter vector) → quantity(q̈1, M⁻¹) at rest with relaxed springs, as a CasADi function."""
    n = check_joints(plant)
    q, p = ca.SX.sym("q", n), ca.SX.sym("p", plant.parameters.size)
    d, still = ca.SX.sym("d", len(plant.disturbances)), ca.SX.zeros(n)
    fall = plant.traced_flow(ca.vertcat(q, still, q, still), ca.SX.zeros(n), d, p)[n : 2 * n]
    compliance = ca.jacobian(fall, d)[:, _places(plant, "link_torque")]
    free = ca.substitute(quantity(fall, compliance), d, ca.SX.zeros(d.numel()))
    return ca.Function(name, [q, p], [ca.densify(free)], {"cse": True})


class LinkCompliance:
    """M(q)⁻¹ of a plant of elastic joints (another is refused), on any element, with the plant's parameters as data."""

    def __init__(self, plant: Plant) -> None:
        self.traced = _static(plant, "compliance", lambda fall, compliance: ca.vec(compliance))
        self.key = digest(self.traced)

    def matrix(self, q: Any, p: Any) -> Any:
        """M(q)⁻¹ (n, n): the accelerations q̈1 per torque at the links, at the parameter vector p."""
        return apply(self.traced, q, p)[0].reshape(len(q), -1)


@dataclass(frozen=True, eq=False)
class GravityTorque:
    """G(q1) of a plant of elastic joints (another is refused), on any element, with the plant's parameters as data."""

    plant: Plant

    def __post_init__(self) -> None:
        check_joints(self.plant)

    @cached_property
    def traced(self) -> Any:
        """(q, parameter vector) → G as a CasADi function."""
        return _static(self.plant, "gravity", lambda fall, compliance: -ca.solve(compliance, fall))

    @cached_property
    def _with_rate(self) -> Any:
        n = len(self.plant.inputs)
        q, dq, p = ca.SX.sym("q", n), ca.SX.sym("dq", n), ca.SX.sym("p", self.plant.parameters.size)
        torque = self.traced(q, p)
        rate = ca.densify(ca.jtimes(torque, q, dq))
        return ca.Function("gravity_rate", [q, dq, p], [torque, rate], {"cse": True})

    def torque(self, q: Any, p: Any) -> Any:
        """G(q), (n,), N·m, at the parameter vector p."""
        return apply(self.traced, q, p)[0]

    def torque_and_rate(self, q: Any, dq: Any, p: Any) -> tuple[Any, ...]:
        """G(q) and its rate ∂G/∂q q̇, (n,) each."""
        return apply(self._with_rate, q, dq, p)

    @cached_property
    def key(self) -> str:
        """Key of the code of a gravity torque."""
        return digest(self.traced)
