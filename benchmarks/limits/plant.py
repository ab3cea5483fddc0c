"""The true arm: that of `benchmarks.workspace.plants`, with brakes, stops, backlash and drives that give less.

It shares no dynamics with flexhinf: links, motors and springs are MuJoCo's, and a test compares them with a solution of
their equations by SciPy, where Pinocchio gives the links.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from benchmarks.workspace.arm import Arm
from benchmarks.workspace.plants import MuJoCo

__all__ = ["Stop", "TrueArm", "stiff"]

#: A brake holds so many times the limit of its motor; a stop is so much stiffer than the joint's spring.
BRAKES, STOP = 3.0, 20.0
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
        self.gap = 0.5 * np.broadcast_to(backlash, arm.n)[self.elastic]
        self.braked, self.stop = False, None
        self.velocities, self.dry = self.data.qvel, self.model.dof_frictionloss
        self.springs = arm.stiffness[self.elastic]
        if np.any(self.gap):
            self.model.jnt_stiffness[self.twists] = 0.0

    braked: bool
    stop: Stop | None

    def rest(self, q: np.ndarray) -> None:
        """Start at rest with the links at q, each joint at the side of its gap that carries the weight."""
        super().rest(q)
        side = np.sign(self.arm.gravity(q))[self.elastic] * self.gap
        self.positions[self.motors[self.elastic]] += side
        self.positions[self.twists] -= side

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
        if self.stop is not None:
            j, side = self.stop.joint, self.stop.side
            rate = np.zeros(self.arm.n)
            rate[:] = self.velocities[self.motors]
            rate[self.elastic] += self.velocities[self.twists]
            deep = side * (self.read()[0][j] - self.stop.position)
            if deep > 0.0:
                k = STOP * (self.arm.stiffness[j] if np.isfinite(self.arm.stiffness[j]) else 1e4)
                d = 2.0 * 0.3 * np.sqrt(k * self.arm.inertia_matrix(self.arm.home)[j, j])
                found[j] = -side * max(0.0, k * deep + d * side * rate[j])
        return found
