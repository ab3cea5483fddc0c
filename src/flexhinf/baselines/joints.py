"""The numbers of a plant's elastic joints at an equilibrium, from its exact Jacobians.

At rest M(q1) q̈1 + C q̇1 + G = K(q2 − q1) + D(q̇2 − q̇1) + d_link and J q̈2 + B q̇2 + K(q2 − q1) + D(q̇2 − q̇1) =
k_u u + d_motor, Eq. (2), are read off ẋ = A x + B u + G d: what the motors feel of d_motor is J⁻¹, what the links
feel of d_link is M⁻¹. Whatever the model adds (a damped or hardening spring, a back-EMF) is in the numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.plant import Plant

STATES = ("link_position", "link_velocity", "motor_position", "motor_velocity")
TORQUES = ("link_torque", "motor_torque")

#: Coupling between the motors of different joints, relative to their own numbers, that counts as none.
COUPLING = 1e-9


@dataclass(frozen=True, eq=False)
class ElasticJoints:
    """Numbers of n elastic joints, seen from the link side; SI units.

    Attributes
    ----------
    link_inertia : ndarray, (n, n)
        M(q*).
    gravity_slope : ndarray, (n, n)
        ∂G/∂q at q*.
    stiffness, spring_damping : ndarray, (n,)
        K and D of the springs as they are at this equilibrium.
    motor_inertia, motor_damping : ndarray, (n,)
        J and B, the back-EMF's k_t k_b / R included.
    torque_per_input : ndarray, (n,)
        Torque per input: k_t / R, N·m/V, for a voltage; k_t, N·m/A, for a current; 1 for a torque.
    """

    link_inertia: np.ndarray
    gravity_slope: np.ndarray
    stiffness: np.ndarray
    spring_damping: np.ndarray
    motor_inertia: np.ndarray
    motor_damping: np.ndarray
    torque_per_input: np.ndarray

    @property
    def joint_inertia(self) -> np.ndarray:
        """Inertia that each motor would move if the joints were rigid and the others stood still, M_jj + J_j."""
        return np.diag(self.link_inertia) + self.motor_inertia


def check_joints(plant: Plant) -> int:
    """Number of elastic joints n of a plant with their states, 4n in the order of Eq. (2), and one input each.

    Raises
    ------
    InvalidInput
        If it has other states, inputs or disturbances.
    """
    names = tuple(single for name in STATES for single in plant.expanded(name))
    joints = len(plant.inputs)
    torques = [single for name in TORQUES for single in plant.expanded(name)]
    if (
        tuple(plant.states) != names
        or len(names) != 4 * joints
        or not set(torques) <= set(plant.disturbances)
    ):
        raise InvalidInput(
            "The plant is not a robot with elastic joints as this law needs it.",
            f"expected the states {list(names)}, one input per joint and the disturbances {torques}, "
            f"got {list(plant.states)}, {list(plant.inputs)}, {list(plant.disturbances)}",
            "robot.plant() of a robot without rigid joints, and without the coils' inductance",
        )
    return joints


def elastic_joints(plant: Plant, x: np.ndarray, u: np.ndarray) -> ElasticJoints:
    """The joints' numbers at the equilibrium (x, u), (4n,) and (n,).

    Raises
    ------
    InvalidInput
        If the plant has no elastic joints, or its motors are coupled.
    """
    n = check_joints(plant)
    a, b, g, _ = plant.linearise(x, u)
    torques = [[plant.disturbances.index(name) for name in plant.expanded(kind)] for kind in TORQUES]  # type: ignore[union-attr]
    links, motors = slice(n, 2 * n), slice(3 * n, 4 * n)
    motor_inertia = 1.0 / _diagonal("motor inertia", g[motors, torques[1]])
    link_inertia = np.linalg.inv(g[links, torques[0]])
    stiffness = motor_inertia * _diagonal("stiffness", a[motors, :n])
    damping = motor_inertia * _diagonal("spring damping", a[motors, links])
    return ElasticJoints(
        link_inertia=(link_inertia + link_inertia.T) / 2.0,
        gravity_slope=-link_inertia @ a[links, :n] - np.diag(stiffness),
        stiffness=stiffness,
        spring_damping=damping,
        motor_inertia=motor_inertia,
        motor_damping=-motor_inertia * _diagonal("motor damping", a[motors, motors]) - damping,
        torque_per_input=motor_inertia * _diagonal("input", b[motors]),
    )


def _diagonal(what: str, matrix: np.ndarray) -> np.ndarray:
    diagonal = np.diag(matrix).copy()
    beside = np.abs(matrix - np.diag(diagonal)).max()
    if beside > COUPLING * np.abs(diagonal).max(initial=0.0):
        raise InvalidInput(
            "The motors of different joints are coupled.",
            f"expected a {what} of each joint alone, got {matrix.tolist()}",
            "a plant of a robot of this package",
        )
    return diagonal
