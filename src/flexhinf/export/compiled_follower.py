"""The exported C that follows trajectories, called as `flexhinf.Follower` is."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from pathlib import Path
from tempfile import gettempdir

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.arrays import Numbers
from flexhinf.errors import InvalidInput
from flexhinf.export.compiled import compiler_flags, loaded, shared_library
from flexhinf.export.controller_c import ControllerCode
from flexhinf.export.file_list import File, rendered
from flexhinf.export.follow import FILES, follow_values, follower_of
from flexhinf.robot.follow_goal import FollowGoal
from flexhinf.robot.follower import FollowCode, Follower, FollowSample
from flexhinf.validation import checked_array

#: What calls ``NAME_follow``, for `CompiledFollower`.
LIBRARY: File[Mapping[str, object]] = File("follow_library.c", "follow_library.c", lambda values: values)


def follow_files(code: ControllerCode) -> dict[str, str]:
    """Header and source of ``NAME_follow``, and a file with what `CompiledFollower` calls of it."""
    return rendered([*FILES, LIBRARY], follow_values(code), code.name, code.real)


def checked_follower(code: ControllerCode) -> Follower:
    """`follower_of` a controller with its robot.

    Raises InvalidInput: for a controller whose commands are no motions of its robot.
    """
    follower = follower_of(code)
    if follower is None:
        raise InvalidInput(
            "This controller follows no trajectories.",
            "expected one for the workspace, whose commands are motions of its robot's joints, got one of "
            f"{list(code.controller.commanded)}",
            "flexhinf design ROBOT, without --pose",
        )
    return follower


def compile_follower(code: ControllerCode) -> CompiledFollower:
    """The follower of a controller with its robot, compiled for this machine.

    Raises InvalidInput: as `checked_follower`; without a C compiler.
    """
    follower, sources = checked_follower(code), {**code.files, **follow_files(code)}
    image = shared_library(sources, ("-O2", *compiler_flags("portable")))
    return CompiledFollower(loaded(image, Path(gettempdir())), follower, np.float64)


class CompiledFollower:
    """``NAME_follow`` of an export in a library of this process, with a memory of its own.

    What it computes, refuses and answers is what `follower` does; a step takes microseconds.
    """

    def __init__(self, library: ctypes.CDLL, follower: Follower, kind: type[np.float32 | np.float64]) -> None:
        self.robot, self.follower, self.period = follower.robot, follower, follower.period
        self._library, self._kind = library, kind
        for name in ("follow_size", "follow_point_size"):
            getattr(library, name).restype = ctypes.c_size_t
        n, plant = len(self.robot.joint_names), self.robot.plant()
        row = (kind, (n,))
        names = ("time", "position", "velocity", "acceleration", "order")
        self._point = np.dtype(list(zip(names, (kind, row, row, row, np.intc), strict=True)), align=True)
        assert self._point.itemsize == library.follow_point_size()
        self._memory = np.zeros(-(-int(library.follow_size()) // 8))
        self._row, self._desired = np.zeros(plant.n + n, dtype=kind), np.zeros(2 * n, dtype=kind)
        self._estimate, self._rates = np.zeros(2 * n, dtype=kind), np.ones(2, dtype=kind)
        self._places = [
            _place(array) for array in (self._memory, self._estimate, self._rates, self._row, self._desired)
        ]
        self._kept: list[
            np.ndarray
        ] = []  # points that the C may still read: of the goal, and of one that waits
        self.reset(np.asarray(self.robot.home, dtype=float))

    @property
    def waits(self) -> bool:
        """Whether a goal waits until it begins; the one before is still followed."""
        return bool(self._library.follow_waits(self._places[0]))

    def reset(self, position: ArrayLike) -> None:
        """As `Follower.reset`."""
        n, own = len(self.robot.joint_names), self.follower
        what = "The pose does not fit the robot."
        q = checked_array(what, position, (n,), f"{n} finite numbers", "one for each joint").astype(
            self._kind
        )
        numbers = np.array([*own.usual.ravel(), own.goal_time, own.timeout, own.stop_time], dtype=self._kind)
        self._library.follow_reset(
            self._places[0], _place(q), _place(numbers), int(own.partial), int(own.limited)
        )
        self._kept = []

    def check(self, goal: FollowGoal) -> FollowCode:
        """As `Follower.check`."""
        return self._begin(goal, False)[0]

    def start(self, goal: FollowGoal) -> FollowCode:
        """As `Follower.start`."""
        waited = self.waits
        code, points = self._begin(goal, True)
        if code is FollowCode.ACTIVE:
            if self.waits:  # the one that waited before it is dropped
                self._kept = [*(self._kept[:-1] if waited else self._kept), points]
            else:
                self._kept = [points]
        return code

    def _begin(self, goal: FollowGoal, starts: bool) -> tuple[FollowCode, np.ndarray]:
        own, joints = self.robot.joint_names, list(goal.joint_names)
        points = np.zeros(np.size(goal.times), dtype=self._point)
        stated = {*joints, *goal.path_tolerance, *goal.goal_tolerance}
        if not joints or stated - {*own} or len({*joints}) < len(joints):
            return FollowCode.INVALID_JOINTS, points
        places = [own.index(joint) for joint in joints]
        points["time"], points["order"] = goal.times, goal.orders
        kinds = ("position", "velocity", "acceleration")
        for name in kinds:
            points[name] = np.nan  # of joints that are left out, and of what is not stated: not read
        for name, rows in zip(kinds, goal.arrays):
            points[name][:, places] = rows
        tolerances = np.zeros((2, 2, len(own)))
        for k, pairs in enumerate((goal.path_tolerance, goal.goal_tolerance)):
            for joint, pair in pairs.items():
                tolerances[k, :, own.index(joint)] = pair
        numbers = np.array([*tolerances.ravel(), goal.begins, goal.goal_time], dtype=self._kind)
        moves = np.isin(np.arange(len(own)), places).astype(np.intc)
        call, memory = self._library.follow_start, self._places[0]
        code = call(memory, _place(points), len(points), _place(moves), _place(numbers), int(starts))
        return FollowCode(code), points

    def cancel(self) -> None:
        """As `Follower.cancel`."""
        self._library.follow_cancel(self._places[0])

    def step(
        self, position: Numbers, velocity: Numbers, speed: float = 1.0, path_rate: float = 1.0
    ) -> FollowSample:
        """As `Follower.step`, with the links' positions and velocities (n,) stated."""
        n = len(self.robot.joint_names)
        self._estimate[:n], self._estimate[n:] = position, velocity
        self._rates[:] = speed, path_rate
        code = FollowCode(self._library.follow_step(*self._places))
        desired = self._desired.copy()
        return FollowSample(self._row.copy(), desired[:n], desired[n:], code)


def _place(array: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)
