"""Robots of the catalogue and of our own making, and problems that are chosen once for all tests."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.designs import Specification
from flexhinf.designs.loop_setup import LoopSetup
from flexhinf.designs.problem.presets import DesignProblem, choose


@pytest.fixture(scope="session")
def problem_of(robot_of: Callable[[str], Any]) -> Callable[..., DesignProblem]:
    """The problem of a robot, by its name, goal, start and specification; made once."""
    known: dict[Any, DesignProblem] = {}

    def chosen(name: str, goal: Any = None, start: Any = None, **options: Any) -> DesignProblem:
        robot = robot_of(name)
        pose = np.array(robot.home if goal is None else goal, dtype=float)
        begin = pose - 0.1 if start is None else np.array(start, dtype=float)
        # The channels of `robust` alone depend on the start.
        own = tuple(begin) if options.get("preset") == "robust" else ()
        key = (name, tuple(pose), own, str(sorted(options.items())))
        if key not in known:
            known[key] = choose(robot, pose, begin, Specification(**options))
        return known[key]

    return chosen


@pytest.fixture(scope="session")
def at_a_pose(robot_of: Callable[[str], Any], only_uncertain: Callable[..., Any]) -> Any:
    """A whole design of the paper's arm, two corners and no searches, and the stages that it told of."""
    s = Specification(
        pose="30deg", start="0", estimator="ekf", measured="link_position,motor_position", torque_noise=1e-7,
        degrees="2", draws=0, rays=0, proof_seconds=0,
    )  # fmt: skip
    told: list[str] = []
    return SimpleNamespace(
        design=fh.design(only_uncertain(robot_of("paper"), "stiffness"), s, told.append), told=told
    )


@pytest.fixture(scope="session")
def setup_of(
    robot_of: Callable[[str], Any], problem_of: Callable[..., DesignProblem]
) -> Callable[..., LoopSetup]:
    """A loop: robot, goal, start, degree of its law, what its problem is chosen for, and other fields of the loop."""
    known: dict[Any, Any] = {}

    def made(
        name: str, goal: Any = None, start: Any = None, degree: int = 2, game: Any = (), **options: Any
    ) -> LoopSetup:
        robot = robot_of(name)
        pose = np.array(robot.home if goal is None else goal, dtype=float)
        begin = pose - 0.1 if start is None else np.array(start, dtype=float)
        chosen = problem_of(name, pose, begin, **{"preset": "damped", **dict(game)})
        key = (id(chosen), degree)
        if key not in known:
            known[key] = fh.solve_hji(chosen.problem, chosen.gamma, degree)
        return LoopSetup(robot, Specification(**options), known[key], pose, begin)

    return made
