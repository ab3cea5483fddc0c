"""The numbers of a robot with elastic joints, as torques at the motors, and its rigid-body dynamics by Pinocchio.

    M(q) q̈ + C q̇ + G(q) = K (θ − q) + D (θ̇ − q̇),    J θ̈ + B θ̇ + F sgn θ̇ + K (θ − q) + D (θ̇ − q̇) = k_u u

The numbers are those of the robot's file; nothing of flexhinf's dynamics is used. A motor that a voltage drives has
k_u = k_t / R, and its back-EMF, k_t k_b / R, is a part of B.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from importlib import import_module
from typing import Any

import numpy as np

import flexhinf as fh
from flexhinf.plant import Parameters

__all__ = ["LATENCY", "PERIOD", "SPRINGS", "Arm", "damped"]

#: Its names come from compiled code, which type checkers do not see.
pin: Any = import_module("pinocchio")

#: Sampling period of every loop, s, and the latency that every law knows, samples.
PERIOD, LATENCY = 1e-3, 1
#: Damping ratio of a spring whose file states none, of its own vibration at home: no real one is undamped.
SPRINGS = 0.005


@dataclass(frozen=True, eq=False)
class Arm:
    """A robot's numbers; arrays have one entry per joint, in rad and N·m, or m and N where a joint slides."""

    robot: Any  # the flexhinf.Robot whose numbers these are
    tree: Any  # its joints
    mass: np.ndarray  # (n,), kg
    centre: np.ndarray  # (n, 3), m, in each link's frame
    inertia: np.ndarray  # (n, 3, 3), kg·m², about the centre of mass
    fall: np.ndarray  # (3,), m/s²
    stiffness: np.ndarray  # infinite of a joint without a spring, whose motor turns with the link
    spring_damping: np.ndarray
    rotor: np.ndarray  # J, reflected to the link side
    viscous: np.ndarray  # B, back-EMF included
    dry: np.ndarray  # F
    per_input: np.ndarray  # k_u, torque per unit of the input
    lower: np.ndarray  # (n,), joint range
    upper: np.ndarray
    limit: np.ndarray  # largest input, in its own unit
    speed: np.ndarray  # largest velocity

    @staticmethod
    def of(robot: Any, values: Mapping[str, Any] | None = None) -> Arm:
        """The numbers of a robot, or of one with other parameters of its plant, as `Robot.corner` returns them.

        Raises `fh.InvalidInput` for a motor without a limit, and a sliding joint without a range.
        """
        p = dict(robot.plant_parameters() if values is None else values)
        n, named = len(robot.joint_names), Parameters(p)
        tree, mass, centre, inertia = robot.links.rigid(named)
        ends = [
            pair or ((-np.pi, np.pi) if not slides else (np.nan, np.nan))
            for pair, slides in zip(robot.links.limits, robot.links.slides)
        ]
        limits = [*robot.effort_limits, *robot.speed_limits]
        if not np.all(np.isfinite([*np.ravel(ends), *limits])):
            raise fh.InvalidInput(
                f"The robot {robot.name!r} cannot be judged over its workspace.",
                f"expected a range of each sliding joint and limits of all motors, got ranges {ends}, limits {limits}",
                "effort_limit, speed_limit and limits in the robot's file",
            )

        def number(name: str, default: float = 0.0) -> np.ndarray:
            return np.broadcast_to(np.asarray(p.get(name, default), dtype=float), n).copy()

        def of_springs(name: str, rigid: float) -> np.ndarray:
            found, elastic = np.full(n, rigid), [joint not in robot.rigid for joint in robot.joint_names]
            found[elastic] = np.asarray(p.get(name, 0.0), dtype=float)
            return found

        constant, resistance = number("torque_constant", 1.0), number("resistance", 1.0)
        per_input = constant / resistance
        back = per_input * number("back_emf_constant") if robot.drive == "voltage" else 0.0
        return Arm(
            robot=robot, tree=tree, mass=np.array(mass, dtype=float), centre=np.array(centre, dtype=float),
            inertia=np.array([_symmetric(six) for six in inertia]),
            fall=np.array(robot.links.fall(named), dtype=float),
            stiffness=of_springs("stiffness", np.inf), spring_damping=of_springs("damping", 0.0),
            rotor=number("motor_inertia"),
            viscous=number("friction") + back, dry=number("coulomb_friction"), per_input=per_input,
            lower=np.array([low for low, _ in ends]), upper=np.array([high for _, high in ends]),
            limit=np.array(robot.effort_limits, dtype=float), speed=np.array(robot.speed_limits, dtype=float),
        )  # fmt: skip

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.stiffness)

    @property
    def slides(self) -> np.ndarray:
        """Whether each joint slides, (n,)."""
        return np.array([joint.slides for joint in self.tree.joints])

    @property
    def home(self) -> np.ndarray:
        """The robot's home pose, (n,)."""
        return np.array(self.robot.home, dtype=float)

    def limited(self, u: np.ndarray) -> np.ndarray:
        """Inputs (n,) within the motors' limits."""
        return np.minimum(np.maximum(u, -self.limit), self.limit)  # half the time of np.clip

    # Rigid-body dynamics --------------------------------------------------------------------------
    @cached_property
    def model(self) -> Any:
        """Pinocchio's model of the links."""
        model, places = pin.Model(), []
        for i, (joint, parent) in enumerate(zip(self.tree.joints, self.tree.parents)):
            place = pin.SE3(np.array(joint.placement.rotation), np.array(joint.placement.translation))
            kinds = (pin.JointModelRevoluteUnaligned, pin.JointModelPrismaticUnaligned)
            kind = kinds[joint.slides](np.array(joint.axis))
            places.append(model.addJoint(places[parent] if parent >= 0 else 0, kind, place, joint.name))
            body = pin.Inertia(float(self.mass[i]), self.centre[i], self.inertia[i])
            model.appendBodyToJoint(places[-1], body, pin.SE3.Identity())
        model.gravity.linear = self.fall
        return model

    @cached_property
    def memory(self) -> Any:
        """Pinocchio's scratch."""
        return self.model.createData()

    @cached_property
    def _upper(self) -> np.ndarray:
        return np.triu(np.ones((self.n, self.n), dtype=bool))

    def inertia_matrix(self, q: np.ndarray) -> np.ndarray:
        """M(q), (n, n)."""
        whole = pin.crba(self.model, self.memory, q)  # its upper part counts
        return np.where(self._upper, whole, whole.T)

    def gravity(self, q: np.ndarray) -> np.ndarray:
        """G(q), (n,)."""
        return np.array(pin.computeGeneralizedGravity(self.model, self.memory, q))

    def gravity_slope(self, q: np.ndarray) -> np.ndarray:
        """∂G/∂q, (n, n)."""
        return np.array(pin.computeGeneralizedGravityDerivatives(self.model, self.memory, q))

    def acceleration(self, q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
        """q̈ (n,) of the links under these torques."""
        return pin.aba(self.model, self.memory, q, dq, torque)

    def rest(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Motor positions and inputs with which the links rest at q, (n,) each."""
        weight = self.gravity(q)
        return q + weight / self.stiffness, weight / self.per_input

    def sagged(self, theta: np.ndarray) -> np.ndarray:
        """Link positions (n,) at rest with the motors at theta (n,): a fixed point, for springs that the weight hardly
        twists."""
        q = theta
        for _ in range(50):
            q = theta - self.gravity(q) / self.stiffness
        return q

    def linear(self, q: np.ndarray, ratio: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """A (4n, 4n) and B (4n, n) of x = (q, q̇, θ, θ̇), u, in deviations from rest at q, without dry friction.

        `ratio` damps each spring by 2 ratio √(K J) more.
        """
        n, zero, unit = self.n, np.zeros((self.n, self.n)), np.eye(self.n)
        inverse = np.linalg.inv(self.inertia_matrix(q))
        k = np.diag(self.stiffness)
        d = np.diag(self.spring_damping + 2.0 * ratio * np.sqrt(self.stiffness * self.rotor))
        j = 1.0 / self.rotor[:, None]
        a = np.block([
            [zero, unit, zero, zero],
            [-inverse @ (k + self.gravity_slope(q)), -inverse @ d, inverse @ k, inverse @ d],
            [zero, zero, zero, unit],
            [j * k, j * d, -j * k, -j * (d + np.diag(self.viscous))],
        ])  # fmt: skip
        b = np.zeros((4 * n, n))
        b[3 * n :] = np.diag(self.per_input / self.rotor)
        return a, b

    def fastest(self) -> float:
        """An upper bound of the vibrations' frequencies at home, rad/s."""
        inverse, elastic = np.linalg.inv(self.inertia_matrix(self.home)), np.isfinite(self.stiffness)
        turns = np.sqrt(self.stiffness[elastic] * (np.diag(inverse) + 1.0 / self.rotor)[elastic])
        return float(np.max(turns, initial=0.0))


def damped(arm: Arm) -> Arm:
    """The arm with the damping of springs that its file leaves out."""
    inverse = np.diag(np.linalg.inv(arm.inertia_matrix(arm.home)))
    elastic = np.isfinite(arm.stiffness)
    turns = np.sqrt(np.where(elastic, arm.stiffness, 1.0) * (inverse + 1.0 / arm.rotor))
    least = 2.0 * SPRINGS * np.where(elastic, arm.stiffness, 0.0) / turns
    return replace(arm, spring_damping=np.where(arm.spring_damping > 0.0, arm.spring_damping, least))


def _symmetric(six: Any) -> np.ndarray:
    xx, xy, xz, yy, yz, zz = six
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], dtype=float)
