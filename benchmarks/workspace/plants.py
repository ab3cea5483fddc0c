"""Two simulators of a robot with elastic joints; both share nothing with flexhinf but the numbers of its file.

Both have Coulomb friction that sticks, hold their input for a period, and take torques on the links as a disturbance.
Limits of the joint range are not built in: a robot that leaves it goes on.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any, Protocol
from xml.sax.saxutils import quoteattr

import numpy as np

from benchmarks.workspace.arm import PERIOD, Arm

__all__ = ["PLANTS", "MuJoCo", "Plant", "RungeKutta"]


class Plant(Protocol):
    """A true robot."""

    def rest(self, q: np.ndarray) -> None:
        """Start at rest with the links at q."""
        ...

    def read(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions of links and motors, (n,) each."""
        ...

    def advance(self, u: np.ndarray, push: np.ndarray | None = None) -> None:
        """One period with the input u and torques `push` on the links, (n,) each."""
        ...


class RungeKutta:
    """Pinocchio's articulated-body algorithm, and Runge–Kutta steps of fourth order between changes of stick and slip.

    A motor sticks while the torque on it is at most its dry friction; it slides until its velocity changes sign. Joints
    have springs.
    """

    def __init__(self, arm: Arm, friction: bool = True, sub_steps: int | None = None) -> None:
        self.arm, self.dry = arm, arm.dry if friction else np.zeros(arm.n)
        self.sub_steps = sub_steps or max(1, int(np.ceil(arm.fastest() * PERIOD / 0.3)))
        self.x = np.zeros(4 * arm.n)
        self.side = np.zeros(arm.n)  # −1, 0, 1: sliding backwards, sticking, sliding forwards

    def rest(self, q: np.ndarray) -> None:
        """Start at rest with the links at q."""
        zero = np.zeros(self.arm.n)
        self.x, self.side = np.concatenate([q, zero, self.arm.rest(q)[0], zero]), zero.copy()

    def read(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions of links and motors."""
        n = self.arm.n
        return self.x[:n].copy(), self.x[2 * n : 3 * n].copy()

    def advance(self, u: np.ndarray, push: np.ndarray | None = None) -> None:
        """One period with this input."""
        arm, n, h = self.arm, self.arm.n, PERIOD / self.sub_steps
        torque, links = arm.per_input * u, np.zeros(n) if push is None else push
        k, d = arm.stiffness, arm.spring_damping

        def rate(x: np.ndarray, drive: np.ndarray, free: np.ndarray) -> np.ndarray:
            q, dq, theta, dtheta = x[:n], x[n : 2 * n], x[2 * n : 3 * n], x[3 * n :]
            spring = k * (theta - q) + d * (dtheta - dq)
            out = np.empty(4 * n)
            out[:n], out[2 * n : 3 * n] = dq, dtheta
            out[n : 2 * n] = arm.acceleration(q, dq, spring + links)
            out[3 * n :] = free * (drive - arm.viscous * dtheta - spring) / arm.rotor
            return out

        for _ in range(self.sub_steps):
            x = self.x
            load = torque - k * (x[2 * n : 3 * n] - x[:n]) - d * (x[3 * n :] - x[n : 2 * n])
            breaks = (self.side == 0.0) & (np.abs(load) > self.dry)
            side = np.where(breaks, np.sign(load), self.side)
            free = (side != 0.0) | (self.dry == 0.0)
            drive = torque - side * self.dry
            a = rate(x, drive, free)
            b = rate(x + 0.5 * h * a, drive, free)
            c = rate(x + 0.5 * h * b, drive, free)
            e = rate(x + h * c, drive, free)
            x = x + (h / 6.0) * (a + 2.0 * b + 2.0 * c + e)
            stops = (x[3 * n :] * side <= 0.0) & (self.dry > 0.0)
            x[3 * n :] = np.where(stops, 0.0, x[3 * n :])
            self.x, self.side = x, np.where(stops, 0.0, side)


class MuJoCo:
    """MuJoCo's dynamics of two joints in series at each axis: the motor with its rotor, and the twist of the spring.

    A joint without a spring is its motor's alone.
    """

    def __init__(self, arm: Arm, friction: bool = True, sub_steps: int | None = None) -> None:
        mujoco: Any = import_module("mujoco")
        self._mujoco, self.arm = mujoco, arm
        self.sub_steps = sub_steps or max(4, int(np.ceil(arm.fastest() * PERIOD / 0.25)))
        self.model = mujoco.MjModel.from_xml_string(mjcf(arm, friction, PERIOD / self.sub_steps))
        self.data = mujoco.MjData(self.model)
        self.positions, self.applied = self.data.qpos, self.data.qfrc_applied  # views
        names = arm.robot.joint_names
        self.elastic = np.flatnonzero(np.isfinite(arm.stiffness))
        self.motors = np.array([self.model.joint(f"motor {name}").qposadr[0] for name in names])
        self.twists = np.array([self.model.joint(f"twist {names[i]}").qposadr[0] for i in self.elastic], int)

    def rest(self, q: np.ndarray) -> None:
        """Start at rest with the links at q."""
        theta = self.arm.rest(q)[0]
        self._mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[self.motors], self.data.qpos[self.twists] = theta, (q - theta)[self.elastic]
        self._mujoco.mj_forward(self.model, self.data)

    def read(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions of links and motors."""
        theta = self.positions[self.motors]
        q = theta.copy()
        q[self.elastic] += self.positions[self.twists]
        return q, theta

    def advance(self, u: np.ndarray, push: np.ndarray | None = None) -> None:
        """One period with this input; a torque on a link does work on the motor's joint and on the twist."""
        torque = self.arm.per_input * u
        self.applied[self.motors] = torque if push is None else torque + push
        self.applied[self.twists] = 0.0 if push is None else push[self.elastic]
        self._mujoco.mj_step(self.model, self.data, self.sub_steps)


def mjcf(arm: Arm, friction: bool, step: float) -> str:
    """The robot as MJCF; joints have one degree of freedom, so places in qpos and in qvel are the same."""
    dry = arm.dry if friction else np.zeros(arm.n)

    def bodies(parent: int) -> str:
        text = ""
        for i, joint in enumerate(arm.tree.joints):
            if arm.tree.parents[i] != parent:
                continue
            kind = f'type="{"slide" if joint.slides else "hinge"}" axis="{_row(joint.axis)}"'
            xx, xy, xz, _, yy, yz, _, _, zz = arm.inertia[i].ravel()
            rotation, name = np.array(joint.placement.rotation), arm.robot.joint_names[i]
            axes = np.concatenate([rotation[:, 0], rotation[:, 1]])
            twist = (
                f'<joint name={quoteattr(f"twist {name}")} {kind} stiffness="{float(arm.stiffness[i])!r}" '
                f'damping="{float(arm.spring_damping[i])!r}"/>'
            )
            text += (
                f'<body pos="{_row(joint.placement.translation)}" xyaxes="{_row(axes)}">'
                f'<joint name={quoteattr(f"motor {name}")} {kind} armature="{float(arm.rotor[i])!r}" '
                f'damping="{float(arm.viscous[i])!r}" frictionloss="{float(dry[i])!r}" '
                f'solreffriction="0.004 1" solimpfriction="0.999 0.9999 0.001"/>'
                f"{twist if np.isfinite(arm.stiffness[i]) else ''}"
                f'<inertial pos="{_row(arm.centre[i])}" mass="{float(arm.mass[i])!r}" '
                f'fullinertia="{_row((xx, yy, zz, xy, xz, yz))}"/>{bodies(i)}</body>'
            )
        return text

    return (
        '<mujoco><compiler angle="radian" balanceinertia="false" boundmass="0" boundinertia="0"/>'
        f'<option timestep="{step!r}" integrator="implicitfast" gravity="{_row(arm.fall)}">'
        f'<flag contact="disable"/></option><worldbody>{bodies(-1)}</worldbody></mujoco>'
    )


def _row(numbers: object) -> str:
    return " ".join(repr(float(number)) for number in np.ravel(np.asarray(numbers, dtype=float)))


#: By name.
PLANTS = {"mujoco": MuJoCo, "runge-kutta": RungeKutta}
