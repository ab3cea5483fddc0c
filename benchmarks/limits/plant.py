"""The true arm: that of `benchmarks.workspace.plants`, with brakes, stops, backlash and drives that give less.

It shares no dynamics with flexhinf: links, motors and springs are MuJoCo's, and a test compares them with a solution of
their equations by SciPy, where Pinocchio gives the links.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from benchmarks.workspace.arm import PERIOD, Arm
from benchmarks.workspace.plants import MuJoCo

__all__ = ["Stop", "TrueArm", "stiff"]

#: A brake holds so many times the limit of its motor; a stop is so much stiffer than the joint's spring, or has this
#: stiffness at a joint without one, N·m/rad or N/m, and this damping of the light link alone.
BRAKES, STOP, STOP_WITHOUT, STOP_DAMPING = 3.0, 20.0, 2e5, 0.3
#: Largest share of a radian of a vibration that an integration step covers.
COVERED = 0.25
#: Vibration, rad/s, and its damping by which a joint without a spring is one with a spring, for laws and linear loops.
RIGID, RIGID_DAMPING = 1e4, 0.5


def stiff(arm: Arm) -> Arm:
    """The arm with a very stiff spring at joints without one: what laws and linear loops compute with."""
    light = 1.0 / (np.diag(np.linalg.inv(arm.inertia_matrix(arm.home))) + 1.0 / arm.rotor)
    elastic = np.isfinite(arm.stiffness)
    return replace(
        arm,
        stiffness=np.where(elastic, arm.stiffness, light * RIGID**2),
        spring_damping=np.where(elastic, arm.spring_damping, 2.0 * RIGID_DAMPING * RIGID * light),
    )


@dataclass(frozen=True)
class Stop:
    """An obstacle in the way of a link: it cannot go beyond a position, on the side `side` of it."""

    joint: int
    position: float  # rad or m
    side: float  # 1 where larger positions are behind it, −1 where smaller ones are


class TrueArm(MuJoCo):
    """A true arm; backlash (rad or m, one number or (n,)) is the whole width of the gap in a joint with a spring."""

    def __init__(self, arm: Arm, backlash: float | np.ndarray = 0.0) -> None:
        super().__init__(arm)
        self._sub_steps = self.sub_steps
        self.gap = 0.5 * np.broadcast_to(backlash, arm.n)[self.elastic]
        self.braked, self._stop = False, None
        self.velocities, self.dry = self.data.qvel, self.model.dof_frictionloss
        self.springs = arm.stiffness[self.elastic]
        if np.any(self.gap):
            self.model.jnt_stiffness[self.twists] = 0.0

    braked: bool
    _stop: tuple[Stop, float, float] | None  # with its stiffness and damping

    @property
    def stop(self) -> Stop | None:
        """The obstacle that is there. It is damped by what the link weighs where the arm is when it comes, and the
        integration's steps resolve its vibration: one for a heavier link would throw a light one."""
        return None if self._stop is None else self._stop[0]

    @stop.setter
    def stop(self, stop: Stop | None) -> None:
        self._stop, steps = None, self._sub_steps
        if stop is not None:
            spring = self.arm.stiffness[stop.joint]
            k = STOP * spring if np.isfinite(spring) else STOP_WITHOUT
            light = 1.0 / np.linalg.inv(self.arm.inertia_matrix(self.read()[0]))[stop.joint, stop.joint]
            steps = max(steps, int(np.ceil(np.sqrt(k / light) * PERIOD / COVERED)))
            self._stop = stop, k, 2.0 * STOP_DAMPING * np.sqrt(k * light)
        self.sub_steps = steps
        self.model.opt.timestep = PERIOD / steps

    def rest(self, q: np.ndarray) -> None:
        """Start at rest with the links at q, each joint at the side of its gap that carries the weight."""
        super().rest(q)
        side = np.sign(self.arm.gravity(q))[self.elastic] * self.gap
        self.positions[self.motors[self.elastic]] += side
        self.positions[self.twists] -= side

    def push(self, speeds: np.ndarray) -> None:
        """Give the links velocities (n,) at once, beside what they have."""
        elastic = np.isfinite(self.arm.stiffness)
        self.velocities[self.twists] += speeds[elastic]
        self.velocities[self.motors[~elastic]] += speeds[~elastic]

    def brake(self, on: bool) -> None:
        """Hold all motors, with their drives off, or let them go."""
        self.braked = on
        held = BRAKES * self.arm.limit * self.arm.per_input if on else 0.0
        self.dry[self.motors] = self.arm.dry + held

    def advance(self, u: np.ndarray, push: np.ndarray | None = None) -> None:
        """One period with this input; `push` is no part of these trials."""
        u = np.zeros(self.arm.n) if self.braked else u
        if self.stop is None and not np.any(self.gap):
            super().advance(u, push)
            return
        torque = self.arm.per_input * u
        for _ in range(self.sub_steps):
            links = self._stopped()
            twist = self.positions[self.twists]
            self.applied[self.motors] = torque + links
            self.applied[self.twists] = links[self.elastic]
            if np.any(self.gap):
                self.applied[self.twists] -= self.springs * (twist - np.clip(twist, -self.gap, self.gap))
            self._mujoco.mj_step(self.model, self.data, 1)

    def _stopped(self) -> np.ndarray:
        """Torque of the stop on the links (n,): a damped spring that only pushes."""
        found = np.zeros(self.arm.n)
        if self._stop is not None:
            stop, k, damping = self._stop
            j, side = stop.joint, stop.side
            rate = self.velocities[self.motors].copy()
            rate[self.elastic] += self.velocities[self.twists]
            deep = side * (self.read()[0][j] - stop.position)
            if deep > 0.0:
                found[j] = -side * max(0.0, k * deep + damping * side * rate[j])
        return found
