"""Robots of the catalogue and of our own making, and problems that are chosen once for all tests."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.design import Specification
from flexhinf.design.loop_setup import LoopSetup
from flexhinf.design.problem.presets import DesignProblem, choose

#: A cart on a soft belt carries an arm: one joint slides, one turns, and their inputs are a force and a torque.
CART = """
name = "cart"
gravity = { value = 9.81 }
down = [0.0, 0.0, -1.0]
home = [0.0, 0.3]

[[joint]]
name = "belt"
kind = "prismatic"
axis = [1.0, 0.0, 0.0]
limits = [-0.5, 0.5]
spring = { stiffness = { value = 6.0e3, tolerance = 12 } }
motor = { motor_inertia = { value = 2.5, tolerance = 3 }, friction = { value = 40.0, tolerance = 15 } }

[joint.link]
mass = { value = 4.0, tolerance = 5 }
centre_of_mass = { value = [0.0, 0.0, 0.0] }
inertia = { xx = 0.02, yy = 0.02, zz = 0.02 }

[[joint]]
name = "arm"
axis = [0.0, 1.0, 0.0]
limits = [-2.5, 2.5]

[joint.link]
mass = { value = 1.2, tolerance = 5 }
centre_of_mass = { value = [0.0, 0.0, -0.3] }
inertia = { xx = 0.01, yy = 0.011, zz = 0.001 }

[joint.spring]
stiffness = { value = 90.0, tolerance = 12 }

[joint.motor]
motor_inertia = { value = 0.08, tolerance = 3 }
friction = { value = 0.4, tolerance = 15 }
"""


@pytest.fixture(scope="session")
def robot_of(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Any]:
    """A robot by name: of the catalogue, or ours. "paper stiffness*0.3" is the arm with a softer spring."""
    file = tmp_path_factory.mktemp("robots") / "cart.toml"
    file.write_text(CART, encoding="utf-8")
    known: dict[str, Any] = {}

    def named(name: str) -> Any:
        if name not in known:
            base, *changes = name.split()
            robot = fh.load_robot(file if base == "cart" else base)
            for change in changes:
                quantity, factor = change.split("*")
                values = {
                    p.name: p.value * float(factor) for p in robot.parameters if p.name.startswith(quantity)
                }
                assert values
                robot = robot.with_values(values)
            known[name] = robot
        return known[name]

    return named


@pytest.fixture(scope="session")
def only_uncertain() -> Callable[..., Any]:
    """The robot with the tolerances of the parameters of these names alone."""

    def of(robot: Any, *names: str) -> Any:
        kept = [p if p.name in names else replace(p, tolerance=0.0) for p in robot.parameters]
        return replace(robot, parameters=tuple(kept))

    return of


@pytest.fixture(scope="session")
def problem_of(robot_of: Callable[[str], Any]) -> Callable[..., DesignProblem]:
    """The problem of a robot, by its name, goal, start and specification; made once."""
    known: dict[Any, DesignProblem] = {}

    def chosen(name: str, goal: Any = None, start: Any = None, **options: Any) -> DesignProblem:
        robot = robot_of(name)
        pose = np.array(robot.home if goal is None else goal, dtype=float)
        begin = pose - 0.1 if start is None else np.array(start, dtype=float)
        key = (name, tuple(pose), tuple(begin), str(sorted(options.items())))
        if key not in known:
            known[key] = choose(robot, pose, begin, Specification(**options))
        return known[key]

    return chosen


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
