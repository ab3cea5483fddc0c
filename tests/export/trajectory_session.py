"""A robot of MuJoCo that the package for ROS 2 moves along trajectories."""

from __future__ import annotations

import ctypes
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.export.test_rest import robot_of
from tests.export.test_ros2 import PERIOD, Manager, built, workspace_controller

from flexhinf.robot import MuJoCoPlant

pytest.importorskip("mujoco")

JOINTS = ("shoulder", "elbow")
START = (-0.4, 0.2)
GOAL = (-0.1, -0.1)
STATES = {2: "followed", 4: "succeeded", 5: "cancelled", 6: "aborted"}

#: Longest time that a goal of a second may take: it ends 0.12 s later, and a step longer than a period may be missing.
LONGEST = 1300


class Followed(ABC):
    """An arm that follows goals, however they are sent."""

    measured: list[np.ndarray]
    desired: list[list[float]]

    @abstractmethod
    def accepted(self) -> bool:
        """Send what was prepared."""

    @abstractmethod
    def run(self, samples: int) -> Any:
        """Go on."""

    @abstractmethod
    def ended(self) -> tuple[str, int | None]:
        """How the last goal ended."""

    def finished(self, goal: Sequence[float] | None = GOAL, samples: int = LONGEST) -> tuple[str, int | None]:
        """Send what was prepared, and how it ended; a goal that succeeded is where the links are."""
        if not self.accepted():
            return "rejected", None
        self.run(samples)
        if goal is not None:
            np.testing.assert_allclose(self.measured[-1], goal, atol=2e-3)
        return self.ended()

    def is_smooth(self) -> None:
        """Commanded velocities change by less than 0.05 rad/s in a sample: nothing jumps."""
        moves = np.array(self.desired)
        moves = moves[np.isfinite(moves).all(axis=1)]
        assert np.abs(np.diff(moves[:, 2:], axis=0)).max() < 0.05
        np.testing.assert_allclose(
            np.diff(moves[:, :2], axis=0), PERIOD * 0.5 * (moves[1:, 2:] + moves[:-1, 2:]), atol=2e-5
        )


class Session(Followed):
    """A robot at rest, and a manager of its controller, which is active."""

    def __init__(self, manager: Manager, pose: Sequence[float] = START, **parameters: Any) -> None:
        self.manager, self.robot = manager, robot_of("planar-two-link")
        self.library = manager.library
        for name in ("goal_text",):
            getattr(self.library, name).restype = ctypes.c_char_p
        self.library.goal_handle.restype = ctypes.c_void_p
        self.library.desired.restype = ctypes.c_double
        self.plant = MuJoCoPlant(self.robot, ("link_position", "motor_position"))
        self.measured: list[np.ndarray] = []
        self.desired: list[list[float]] = []
        self.is_held = False
        assert manager.configure(publish_every=1, **parameters) == 0
        self.activate(pose)

    def activate(self, pose: Sequence[float]) -> None:
        self.plant.reset(self.robot.operating_point(pose)[0])
        assert self.manager.activate([*self.plant.output(), *[1.0] * self.scaled]) == 0

    @property
    def scaled(self) -> int:
        """How many interfaces are behind those of the robot."""
        return len(self.manager.names(False)) - 4

    def goal(
        self, times: Any, *rows: Any, joints: Sequence[str] = JOINTS, begins: float = math.nan, goal_time: float = 0.0,
        path: Sequence[tuple[str, float, float]] = (), at_goal: Sequence[tuple[str, float, float]] = (),
    ) -> None:  # fmt: skip
        """Prepare a goal with positions, and velocities, accelerations and efforts where they are stated."""
        self.manager("trajectory", ctypes.c_double(begins), ctypes.c_double(goal_time))
        for name in joints:
            self.manager("joint", name.encode())
        for time, *stated in zip(times, *rows, strict=True):
            numbers = [np.reshape(part, len(joints)) for part in stated if part is not None]
            flat = np.ascontiguousarray(numbers, dtype=float)
            place = flat.ctypes.data_as(ctypes.c_void_p)
            self.manager("point", ctypes.c_double(time), len(numbers), len(joints), place)
        for is_goal, stated in enumerate((path, at_goal)):
            for name, *numbers in stated:
                self.manager("tolerance", is_goal, name.encode(), *map(ctypes.c_double, numbers))

    def accepted(self) -> bool:
        return bool(self.manager("send_goal"))

    def is_contested(self) -> bool:
        return self.manager.published("health", "contested") == 1.0

    def run(self, samples: int, speed: float = 1.0) -> Session:
        for _ in range(samples):
            assert self.manager.update([*self.plant.output(), *[speed] * self.scaled]) == 0
            if not self.is_held:
                self.plant.step(self.manager.input(), [], PERIOD)
            self.measured.append(self.plant.state()[:2])
            self.desired.append(
                [self.manager.published("desired", f"{kind}_{joint}") for kind in ("position", "velocity")
                 for joint in JOINTS]
            )  # fmt: skip
        return self

    def ended(self) -> tuple[str, int | None]:
        """How the last goal ended."""
        for _ in range(2):
            self.manager("spin")
        state = STATES[self.manager("goal_state")]
        return state, None if state == "followed" else self.manager("goal_code")


Make = Callable[..., Session]
MOVE = [0.5, 1.0], [np.add(START, GOAL) / 2, GOAL]
TINY = [("elbow", 1e-12, 0.0)]


@cache
def package_of(version: str, sources_of: Callable[..., Path]) -> tuple[ctypes.CDLL, Path]:
    """The plugin of two joints in a library, and its folder."""
    return built(sources_of(workspace_controller(), "double", robot_of("planar-two-link")), version)
