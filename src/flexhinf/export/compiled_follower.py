"""The exported C that follows trajectories, called as `flexhinf.Follower` is."""

from __future__ import annotations

import ctypes
from pathlib import Path
from tempfile import gettempdir
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.arrays import Numbers
from flexhinf.codegen.c.source import Record, structure
from flexhinf.errors import InvalidInput
from flexhinf.export.compiled import compiler_flags, loaded, shared_library
from flexhinf.export.controller_c import ControllerCode
from flexhinf.export.file_list import rendered
from flexhinf.export.follow import FILES, follow_values, follower_of
from flexhinf.robot.follow_goal import FollowGoal
from flexhinf.robot.follow_records import Goal, Input, Options, Output, Point, State
from flexhinf.robot.follower import FollowCode, Follower, FollowerStatus, FollowReason, FollowSample
from flexhinf.validation import checked_array, real_array


def follow_files(code: ControllerCode) -> dict[str, str]:
    """Header and source of ``NAME_follow``."""
    return rendered(FILES, follow_values(code), code.name, code.real)


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
    image = shared_library(sources, ("-O2", *compiler_flags("portable")), "default")
    return CompiledFollower(loaded(image, Path(gettempdir())), follower, np.float64, code.name)


class CompiledFollower(FollowerStatus):
    """``NAME_follow`` of an export in a library of this process, with a memory of its own.

    What it computes, refuses and answers is what `follower` does; a step takes microseconds.
    """

    def __init__(
        self, library: ctypes.CDLL, follower: Follower, kind: type[np.float32 | np.float64], name: str = "arm"
    ) -> None:
        self.robot, self.follower, self.period = follower.robot, follower, follower.period
        self._library, self._kind, self._name = library, kind, name
        self._param = ctypes.c_char.in_dll(library, f"{name}_defaults")
        self._state, self._options, self._input, self._output = map(
            self._record, (State, Options, Input, Output)
        )
        self._kept: list[np.ndarray] = []  # that the C may still read: of the goal, and of one that waits
        self.reset(np.asarray(self.robot.home, dtype=float))

    def _structure(self, record: type[Record]) -> type[ctypes.Structure]:
        return structure(record, tuple(self.follower.own.sizes.items()), self._kind)

    def _record(self, record: type[Record]) -> Any:
        return self._structure(record)()

    def _call(self, name: str, *arguments: Any) -> int:
        passed = (
            ctypes.byref(one) if isinstance(one, (ctypes.Structure, ctypes.c_char)) else one
            for one in arguments
        )
        return getattr(self._library, f"{self._name}_follow_{name}")(*passed)

    def reset(self, position: ArrayLike) -> None:
        """As `Follower.reset`."""
        n, what = self.follower.own.joints, "The pose does not fit the robot."
        q = checked_array(what, position, (n,), f"{n} finite numbers", "one for each joint")
        self._state_options()
        self._call("init", self._state, _place(q.astype(self._kind)))
        self._output, self._kept = self._record(Output), []

    def _state_options(self) -> None:
        own = self.follower
        _fill_tolerances(self._options, own.usual)
        for name in ("goal_time", "timeout", "stop_time", "partial", "limited"):
            setattr(self._options, name, getattr(own, name))

    def check(self, goal: FollowGoal) -> FollowCode:
        """As `Follower.check`."""
        return self._checked(goal, 0)[0]

    def start(self, goal: FollowGoal, number: int = 0) -> FollowCode:
        """As `Follower.start`."""
        self._state.ended = 0
        code, ordered, points = self._checked(goal, number)
        if code is FollowCode.SUCCESSFUL:
            waited = self.waits
            code = FollowCode(self._call("start", self._state, self._options, ordered))
            if code is FollowCode.ACTIVE:  # a goal that waits replaces one that waited
                self._kept = (
                    [*(self._kept[:-1] if waited else self._kept), points] if self.waits else [points]
                )
        return code

    def _checked(self, goal: FollowGoal, number: int) -> tuple[FollowCode, Any, np.ndarray]:
        ordered, rows = self._record(Goal), goal.ordered(self.robot.joint_names)
        layout: Any = self._structure(Point)
        points: Any = np.zeros(np.size(goal.times), dtype=layout)
        if rows is None:
            return FollowCode.INVALID_JOINTS, ordered, points
        points["time"], points["order"] = rows.times, rows.orders
        for name, numbers in zip(("position", "velocity", "acceleration"), rows.points):
            points[name] = numbers
        ordered.points, ordered.count, ordered.number = points.ctypes.data, len(points), number
        ordered.moves[:], ordered.begins, ordered.goal_time = rows.moves.tolist(), goal.begins, goal.goal_time
        _fill_tolerances(ordered, rows.tolerances)
        self._state_options()
        return FollowCode(self._call("check", self._options, ordered)), ordered, points

    def cancel(self, number: int = 0) -> None:
        """As `Follower.cancel`."""
        self._call("cancel_goal", self._state, self._options, ctypes.c_long(number))

    def end_all(self, code: FollowCode, reason: FollowReason = FollowReason.BY_CODE) -> None:
        """As `Follower.end_all`."""
        self._call("end_all", self._state, ctypes.c_int(code), ctypes.c_int(reason))

    def step(
        self, position: Numbers, velocity: Numbers, speed: float = 1.0, path_rate: float = 1.0
    ) -> FollowSample:
        """As `Follower.step`, with the links' positions and velocities (n,) stated."""
        sample, found = self._input, self._output
        sample.position[:], sample.velocity[:] = (
            np.ravel(real_array(position)).tolist(),
            np.ravel(real_array(velocity)).tolist(),
        )
        sample.speed, sample.path_rate = speed, path_rate
        code = FollowCode(self._call("step", self._state, self._options, self._param, sample, found))
        row, places, rates = (
            np.array(part, dtype=self._kind) for part in (found.r, found.position, found.velocity)
        )
        return FollowSample(row, places, rates, code)


def _fill_tolerances(record: Any, numbers: np.ndarray) -> None:
    """Of path and goal, (2, 2, n)."""
    for one, (position, velocity) in zip((record.path, record.goal), numbers.tolist()):
        one.position[:], one.velocity[:] = position, velocity


def _place(array: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)
