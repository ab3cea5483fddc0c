"""The path between two waypoints of a goal, and how quick it is."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np

from flexhinf.arrays import Vector
from flexhinf.robot.command_limits import command_changes, command_limits, motion_limits
from flexhinf.robot.feedforward import Feedforward

#: Parts of the way between two waypoints, at whose ends velocity and acceleration are looked at.
PARTS: Final = 16

#: Share of what drives limit that a goal may have, as planned moves have: the rest is for twists and feedback.
SHARE: Final = 0.7

#: Velocity by which a path is bent to see what that asks of drives, rad/s or m/s.
SLOWLY: Final = 1e-3


class GoalLimits(NamedTuple):
    """What the drives of a robot leave to goals, (2, n) each: infinite where they limit nothing."""

    links: np.ndarray  # velocities and accelerations of links, of drives that take positions or velocities
    commands: np.ndarray  # rates and accelerations of commands
    bends: np.ndarray  # the largest of them at home, where smoothing bends a path by a unit velocity

    @classmethod
    def of(cls, feedforward: Feedforward) -> GoalLimits:
        """By the limits of a robot's commands."""
        robot, samples = feedforward.robot, feedforward.weights.shape[1] + 3
        commands, found = SHARE * command_limits(robot), np.zeros((2, len(robot.joint_names)))
        for joint in range(found.shape[1]) if np.isfinite(commands).any() else ():
            path = np.tile(np.asarray(robot.home, dtype=float), (samples, 1))
            path[:, joint] += SLOWLY * feedforward.period * np.arange(samples)
            inputs = robot.inverse_dynamics(*feedforward.smoothed(path))[1]
            changes = command_changes(inputs, feedforward.period)
            found[:, joint] = [np.abs(rows[:, joint]).max() / SLOWLY for rows in changes]
        return cls(SHARE * motion_limits(robot), commands, found)

    @property
    def limits(self) -> bool:
        """Whether there is one."""
        return bool(np.isfinite(self.commands).any())

    def forbid(self, begin: np.ndarray, goal: Any, segment: int, time: float, window: float) -> bool:
        """Whether drives do not take the way from a motion (3, n) to a waypoint in so many s, and the bend there;
        `window`: the time, s, within which two bends add up."""
        if not self.limits:
            return False
        order: int = goal.orders[segment]
        end, last = goal.points[:, segment], segment + 1 == len(goal.times)
        moves = np.where(goal.moves, 1.0, 0.0)
        motions = (between(begin, end, time, time * i / PARTS, order)[1:] for i in range(PARTS + 1))
        found = any(np.any(moves * np.abs(way) > self.links) for way in motions)
        if order > 1:
            return found
        slope, after = (end[0] - begin[0]) / time, np.zeros_like(end[0])
        if not last:
            after = (goal.points[0, segment + 1] - end[0]) / (goal.times[segment + 1] - goal.times[segment])
        bends = moves * np.abs([slope - begin[1], after - slope])
        jumps = bends.sum(axis=0) if time < window else bends.max(axis=0)
        return found or bool(np.any(jumps * self.bends > self.commands))


def between(begin: np.ndarray, end: np.ndarray, time: float | Vector, at: float, order: int) -> np.ndarray:
    """Position, velocity and acceleration (3, n) on the polynomial between two waypoints (3, n), `at` s from the
    first: linear, cubic or quintic."""
    s, way = at / time, end[0] - begin[0]
    if order == 1:
        return np.array([begin[0] + s * way, way / time, np.zeros_like(way)])
    v0, v1 = time * begin[1], time * end[1]
    if order == 2:
        c2, c3 = 3.0 * way - (2.0 * v0 + v1), (v0 + v1) - 2.0 * way
        c4 = c5 = np.zeros_like(way)
    else:
        a0, a1 = time * time * begin[2], time * time * end[2]
        c2 = 0.5 * a0
        c3 = 10.0 * way - 6.0 * v0 - 4.0 * v1 - 1.5 * a0 + 0.5 * a1
        c4 = 8.0 * v0 + 7.0 * v1 + 1.5 * a0 - a1 - 15.0 * way
        c5 = 6.0 * way - 3.0 * v0 - 3.0 * v1 - 0.5 * a0 + 0.5 * a1
    position = begin[0] + s * (v0 + s * (c2 + s * (c3 + s * (c4 + s * c5))))
    velocity = (v0 + s * (2.0 * c2 + s * (3.0 * c3 + s * (4.0 * c4 + s * (5.0 * c5))))) / time
    acceleration = (2.0 * c2 + s * (6.0 * c3 + s * (12.0 * c4 + s * (20.0 * c5)))) / (time * time)
    return np.array([position, velocity, acceleration])
