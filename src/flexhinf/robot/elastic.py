"""Spong's model (Eq. 2) of n elastic joints: links, springs and motors as one ẋ."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from flexhinf.robot.dynamics import Tree
from flexhinf.robot.extras import friction_torque, spring_torque, torque_per_input


class Links(Protocol):
    """The links' side of a robot: what it is made of, and how torques move it. Frozen, so that it is a key."""

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints."""
        ...

    @property
    def slides(self) -> tuple[bool, ...]:
        """Whether each joint is prismatic."""
        ...

    @property
    def limits(self) -> tuple[tuple[float, float] | None, ...]:
        """Range of each joint, rad or m."""
        ...

    def required(self) -> tuple[str, ...]:
        """Names of the parameters that the links must have."""
        ...

    def packed(self, values: Any) -> dict[str, Any]:
        """The links' parameters as the plant has them."""
        ...

    def joint_array(self, column: list[float]) -> Any:
        """One number per joint as the plant has them."""
        ...

    def accelerations(self, q: Any, dq: Any, torque: Any, p: Any, armature: Any = None) -> Any:
        """q̈1 (n,) for the torques of springs and disturbances, gravity included; inertia of rigid joints' rotors."""
        ...

    def torques(self, q: Any, dq: Any, ddq: Any, p: Any) -> Any:
        """M(q1) q̈1 + C q̇1 + G(q1) (n,): the inverse of `accelerations`."""
        ...

    def gravity_torque(self, q: Any, p: Any) -> Any:
        """G(q1), (n,) of any element: what the springs must hold, N·m or N."""
        ...

    @property
    def down(self) -> tuple[float, float, float]:
        """Direction of free fall."""
        ...

    def fall(self, p: Any) -> tuple[Any, ...]:
        """Acceleration of free fall, m/s²."""
        ...

    def rigid(self, p: Any) -> tuple[Tree, np.ndarray, np.ndarray, np.ndarray]:
        """Tree, mass (n,), centre of mass (n, 3) and inertia (n, 6) of rigid links that move alike."""
        ...


@dataclass(frozen=True)
class Layout:
    """Where the joints stand in x = (q1 (n), q̇1 (n), q2 (e), q̇2 (e) (, i (n))): e of the n joints are elastic.

    Parameters
    ----------
    rigid : tuple of int
        Joints without a spring, whose rotor turns with the link: q2 = q1.
    """

    n: int
    rigid: tuple[int, ...] = ()

    @staticmethod
    def of(states: Sequence[str]) -> Layout:
        """From the names of the states: a joint without a motor's position is rigid."""
        joints = [name.removeprefix("link_position") for name in states if name.startswith("link_position")]
        joints = [joint for joint in joints if not joint.endswith("_integral")]
        rigid = tuple(i for i, joint in enumerate(joints) if f"motor_position{joint}" not in states)
        return Layout(len(joints), rigid)

    @property
    def elastic(self) -> list[int]:
        """The joints with a spring."""
        return [i for i in range(self.n) if i not in self.rigid]

    @property
    def mechanical(self) -> int:
        """Number of states without the coils' currents."""
        return 4 * self.n - 2 * len(self.rigid)

    def split(self, x: Any) -> tuple[Any, Any, Any, Any]:
        """q1 (n,), q̇1 (n,), q2 (e,), q̇2 (e,)."""
        n, e = self.n, self.n - len(self.rigid)
        return x[:n], x[n : 2 * n], x[2 * n : 2 * n + e], x[2 * n + e : 2 * n + 2 * e]

    def motors(self, links: Any, motors: Any) -> Any:
        """One entry per motor (n,): its own of an elastic joint, the link's of a rigid one."""
        if not self.rigid:
            return motors
        own = iter(motors)
        return np.array([links[i] if i in self.rigid else next(own) for i in range(self.n)])

    def whole(self, x: Any) -> np.ndarray:
        """q1, q̇1, q2, q̇2 (4 n,) with the motors of rigid joints where their links are; or (4 n, N) of columns."""
        q, dq, theta, dtheta = self.split(x)
        return np.concatenate([q, dq, self.motors(q, theta), self.motors(dq, dtheta)])


@dataclass(frozen=True)
class ElasticFlow:
    """ẋ of M(q1) q̈1 + C q̇1 + G = K(q2 − q1) + d_link,   J q̈2 + B q̇2 + K(q2 − q1) = τ + d_motor.

    τ is the input itself, k_t i of a current i, or k_t (V − k_b q̇2) / R; with the coil k_t i, where
    L di/dt = V − R i − k_b q̇2.
    x = (q1, q̇1, q2, q̇2 (, i)), each with one entry per joint; d = (d_link, d_motor).

    A rigid joint has neither spring nor q2: its row is (M(q1) + J) q̈1 + C q̇1 + G + B q̇1 = τ + d_link + d_motor.

    Parameters
    ----------
    drive : {"voltage", "current", "torque"}
    extras : sequence of str
        See `flexhinf.robot.extras`.
    rigid : tuple of int
        Joints without a spring.
    """

    links: Links
    drive: str = "voltage"
    extras: tuple[str, ...] = ()
    rigid: tuple[int, ...] = ()

    def __call__(self, x: Any, u: Any, d: Any, p: Any) -> Any:
        """The rates of all states, of any element."""
        layout = Layout(len(self.links.joint_names), self.rigid)
        n, elastic = layout.n, layout.elastic
        q, dq, theta, dtheta = layout.split(x)
        current, speed = x[layout.mechanical :], layout.motors(dq, dtheta)
        torque, damping = self._motor(current, u, p)
        if not self.rigid:
            spring = spring_torque(theta - q, dtheta - dq, p, self.extras)
            left = torque - damping * dtheta - friction_torque(dtheta, p, self.extras) - spring + d[n:]
            link_acceleration = self.links.accelerations(q, dq, spring + d[:n], p)
            motor_acceleration = (
                1.0 / p.motor_inertia
            ) * left  # a quotient of parameters alone: computed once
        else:
            spring = spring_torque(theta - q[elastic], dtheta - dq[elastic], p, self.extras)
            driven = torque - damping * speed - friction_torque(speed, p, self.extras) + d[n:]
            rotors = [p.motor_inertia[i] if i in self.rigid else 0.0 for i in range(n)]
            on_links = layout.motors(driven, spring) + d[:n]
            link_acceleration = self.links.accelerations(q, dq, on_links, p, rotors)
            motor_acceleration = (1.0 / p.motor_inertia[elastic]) * (driven[elastic] - spring)
        rates = [dq, link_acceleration, dtheta, motor_acceleration]
        if "inductance" in self.extras:
            rates.append((u - p.resistance * current - p.back_emf_constant * speed) / p.inductance)
        return np.concatenate(rates)

    def _motor(self, current: Any, u: Any, p: Any) -> tuple[Any, Any]:
        """The motor's torque, and what multiplies −q̇2."""
        if self.drive == "torque":
            return u, p.friction
        if "inductance" in self.extras:
            return p.torque_constant * current, p.friction
        gain = torque_per_input(self.drive, p)
        return gain * u, p.friction + (gain * p.back_emf_constant if self.drive == "voltage" else 0.0)
