"""Spong's model (Eq. 2) of n elastic joints: links, springs and motors as one ẋ."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from flexhinf.robot.dynamics import Tree
from flexhinf.robot.extras import friction_torque, spring_torque

__all__ = ["ElasticFlow", "Links"]


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

    def accelerations(self, q: Any, dq: Any, torque: Any, p: Any) -> Any:
        """q̈1 (n,) for the torques of springs and disturbances, gravity included."""
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
class ElasticFlow:
    """ẋ of M(q1) q̈1 + C q̇1 + G = K(q2 − q1) + d_link,   J q̈2 + B q̇2 + K(q2 − q1) = τ + d_motor.

    τ is the input itself, or k_t (V − k_b q̇2) / R; with the coil k_t i, where L di/dt = V − R i − k_b q̇2.
    x = (q1, q̇1, q2, q̇2 (, i)), each with one entry per joint; d = (d_link, d_motor).

    Parameters
    ----------
    links : Links
    drive : {"voltage", "torque"}
    extras : sequence of str
        See `flexhinf.robot.extras`.
    """

    links: Links
    drive: str = "voltage"
    extras: tuple[str, ...] = ()

    def __call__(self, x: Any, u: Any, d: Any, p: Any) -> Any:
        """The rates of all states, of any element."""
        n = len(self.links.joint_names)
        q, dq, theta, dtheta = (x[k * n : (k + 1) * n] for k in range(4))
        spring = spring_torque(theta - q, dtheta - dq, p, self.extras)
        torque, damping = self._motor(x[4 * n :], u, p)
        left = torque - damping * dtheta - friction_torque(dtheta, p, self.extras) - spring + d[n:]
        link_acceleration = self.links.accelerations(q, dq, spring + d[:n], p)
        motor_acceleration = (1.0 / p.motor_inertia) * left  # a quotient of parameters alone: computed once
        rates = [dq, link_acceleration, dtheta, motor_acceleration]
        if "inductance" in self.extras:
            rates.append((u - p.resistance * x[4 * n :] - p.back_emf_constant * dtheta) / p.inductance)
        return np.concatenate(rates)

    def _motor(self, current: Any, u: Any, p: Any) -> tuple[Any, Any]:
        """The motor's torque, and what multiplies −q̇2."""
        if self.drive == "torque":
            return u, p.friction
        if "inductance" in self.extras:
            return p.torque_constant * current, p.friction
        gain = p.torque_constant / p.resistance
        return gain * u, p.friction + gain * p.back_emf_constant
