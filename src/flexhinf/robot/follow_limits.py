"""Numbers of a `Follower` that a robot and a controller fix: ranges, speeds, jumps, what drives take, smoothing."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np

from flexhinf.arrays import Vector
from flexhinf.plant.model import ParameterTable
from flexhinf.robot.command_limits import command_changes, command_limits, motion_limits
from flexhinf.robot.elastic import InverseFlow, traced_inverse
from flexhinf.robot.feedforward import Feedforward
from flexhinf.robot.robot import Robot

#: Jump of a joint that turns or slides without a stated speed limit, rad and m, that counts as none.
JUMPS: Final = (0.05, 0.01)

#: What is above the mean speed of a way by rounding alone.
ROUNDING: Final = 1.001

#: What a quintic through samples of a motion at its speed limit is above that limit between them, at most, where no
#: sample changes the speed by more than the limit: 6.7 %, a cubic 4.4 %. Planners send such samples.
BETWEEN: Final = 1.07

#: What a place between waypoints may be beyond the range by rounding, of the range: 8 units of float.
EDGE: Final = 1e-6

#: Range and speed of a joint that states none, rad or m, rad/s or m/s. Float places an angle of so many rad to 0.1.
ANYWHERE: Final = 1e6
ANYHOW: Final = 1e4

#: Share of what drives limit that a goal may have, as planned moves have: the rest is for twists and feedback.
SHARE: Final = 0.7

#: Velocity by which a path is bent to see what that asks of drives, rad/s or m/s.
SLOWLY: Final = 1e-3

#: Goals that end in one call, at most: one that is followed, one that waits, and one that replaced them.
ENDS: Final = 3

#: Units of the last place by which commands are off.
ULPS: Final = 8.0


@dataclass(frozen=True, eq=False)
class FollowLimits:
    """What is fixed of a follower: lists have a number for each joint; rad or m, s, and 1/s or 1/s² of these."""

    feedforward: Feedforward
    joints: int
    samples: int  # of the path, which are smoothed
    latency: int  # samples from a row until the links are there
    period: float
    smoothing: float
    delay: float  # by how much the links are later than the path
    stop_time: float  # in which joints come to rest, at first
    home: list[float]
    low: list[float]
    high: list[float]
    rounding: list[float]  # by which a place between waypoints may be beyond
    fastest: list[float]  # mean speeds of ways, and speeds anywhere
    peak: list[float]
    farthest: list[float]  # jumps that smoothing takes
    paced: bool  # whether a joint has a speed limit
    limited: bool  # whether drives limit how fast commands change
    rates: list[float]  # of commands, and how fast these change
    changes: list[float]
    quickest: list[float]  # velocities and accelerations of links, where drives take these or positions
    hardest: list[float]
    bent_rates: list[float]  # of commands at home, where a path is bent by a unit velocity; their changes
    bent_changes: list[float]
    ulps: float = ULPS * 2.0**-52  # by which commands are off, of their size

    @classmethod
    def of(cls, feedforward: Feedforward, latency: int, stop_time: float) -> FollowLimits:
        """By the limits of the robot, its joints and drives."""
        robot, smoothing, home = feedforward.robot, feedforward.smoothing, feedforward.robot.home
        (low, high), speeds = ranges_of(robot), speeds_of(robot)
        low, high = np.maximum(low, -ANYWHERE), np.minimum(high, ANYWHERE)
        usual = np.array([JUMPS[int(slides)] for slides in robot.links.slides])
        commands, links = SHARE * command_limits(robot), SHARE * motion_limits(robot)
        limited = bool(np.isfinite(commands).any())
        bends = _bends(feedforward) if limited else np.zeros_like(commands)
        rows = {
            "home": np.asarray(home, dtype=float),
            "low": low,
            "high": high,
            "rounding": EDGE * (high - low),
            "fastest": np.minimum(ROUNDING * speeds, ANYHOW),
            "peak": np.minimum(BETWEEN * speeds, ANYHOW),
            "farthest": np.where(np.isfinite(speeds), ROUNDING * speeds * smoothing, usual),
            **dict(zip(("rates", "changes"), commands)),
            **dict(zip(("quickest", "hardest"), links)),
            **dict(zip(("bent_rates", "bent_changes"), bends)),
        }
        return cls(
            feedforward,
            joints=len(low),
            samples=feedforward.weights.shape[1],
            latency=latency,
            period=feedforward.period,
            smoothing=smoothing,
            delay=feedforward.delay,
            stop_time=stop_time,
            paced=bool(np.isfinite(speeds).any()),
            limited=limited,
            **{name: row.tolist() for name, row in rows.items()},
        )

    @cached_property
    def sizes(self) -> Mapping[str, int]:
        """Of the arrays of records, by name."""
        commands = self.feedforward.robot.plant().n + self.joints
        return {
            "JOINTS": self.joints,
            "SAMPLES": self.samples,
            "COMMANDS": commands,
            "DELAYED": self.latency + 1,
            "ENDS": ENDS,
        }

    @cached_property
    def _turning(self) -> np.ndarray:
        """Weights (5, 2 N − 1) by the place of a sample behind the newest one in a ring of N."""
        return self.feedforward.weights[:, -np.arange(1 - self.samples, self.samples) % self.samples]

    def smoothed(self, path: np.ndarray, newest: int) -> np.ndarray:
        """Position and four derivatives (5, n) of the smoothed path (N, n), a ring, at its newest sample."""
        begin = self.samples - 1 - newest
        found = self._turning[:, begin : begin + self.samples] @ (path - path[newest])
        found[0] += path[newest]
        return found

    @cached_property
    def _inverse(self) -> tuple[Callable[[], None], np.ndarray, np.ndarray, object]:
        """The robot's inverse dynamics of one motion: what computes them, the motion (5, n), the commands (n,); and the
        owners of what that reads."""
        robot, motion, found = self.feedforward.robot, np.zeros((5, self.joints)), np.zeros(self.joints)
        table = ParameterTable(dict(robot.plant_parameters()))
        shapes = tuple((name, np.shape(value)) for name, value in table.values.items())
        function = traced_inverse(InverseFlow(robot.links, robot.drive, layout=robot.layout), shapes)
        places, run = function.buffer()
        arrays: list[Any] = [*motion, table.vector(), found]
        rows = list(map(memoryview, arrays))
        for k, row in enumerate(rows[:-1]):
            places.set_arg(k, row)
        places.set_res(1, rows[-1])
        return run, motion, found, (function, places, rows)

    def inputs(self, motion: Sequence[Sequence[float]]) -> np.ndarray:
        """Commands (n,) of the drives on a motion (5, n)."""
        run, place, found, _ = self._inverse
        place[:] = motion
        run()
        return found


def ranges_of(robot: Robot) -> np.ndarray:
    """Lower and upper ends (2, n) of the link positions, rad or m; infinite where the robot states none."""
    ends = [(-np.inf, np.inf) if pair is None else pair for pair in robot.links.limits]
    return np.array(ends, dtype=float).T


def speeds_of(robot: Robot) -> Vector:
    """Speed limits (n,), rad/s or m/s; infinite where the robot states none."""
    stated = robot.speed_limits or [None] * len(robot.joint_names)
    return np.array([np.inf if limit is None else limit for limit in stated], dtype=float)


def _bends(feedforward: Feedforward) -> np.ndarray:
    """Largest rates and accelerations of commands (2, n) at home, where smoothing bends a path by a unit velocity."""
    robot, samples = feedforward.robot, feedforward.weights.shape[1] + 3
    found = np.zeros((2, len(robot.joint_names)))
    for joint in range(found.shape[1]):
        path = np.tile(np.asarray(robot.home, dtype=float), (samples, 1))
        path[:, joint] += SLOWLY * feedforward.period * np.arange(samples)
        inputs = robot.inverse_dynamics(*feedforward.smoothed(path))[1]
        changes = command_changes(inputs, feedforward.period)
        found[:, joint] = [np.abs(rows[:, joint]).max() / SLOWLY for rows in changes]
    return found
