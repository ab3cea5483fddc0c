"""A process that steps or designs for long stays as large as it is: resident memory, as a measured slope."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.costs import resident
from tests.tiers import ci_and_night

import flexhinf as fh
from flexhinf.codegen import shared
from flexhinf.plant import Plant

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")

NUMBERS = pytest.mark.parametrize("number", ci_and_night("so many designs", [30], [200]))

GRAVITY = 9.81


def slope(points: list[tuple[int, float]]) -> float:
    """KB per count, the line of least squares."""
    count, size = np.array(points).T
    return float(np.polyfit(count, size, 1)[0])


def arm_loop(gamma: float) -> fh.Loop:
    """Robot, problem, law, filter and loop of the paper's arm, all anew."""
    robot = fh.paper_arm()
    problem = robot.problem()
    solution = fh.solve_hji(problem, gamma=gamma * fh.smallest_gamma(problem), degree=4)
    ukf = fh.UnscentedKalmanFilter(robot.plant(), 1e-3, 1e-8, 1e-6, np.zeros(4), 1e-4)
    return fh.Loop(robot.plant(), fh.Controller(solution, ukf, saturation=48.0))


def falling(x: Any, u: Any, d: Any, p: Any) -> Any:
    """A pendulum whose gravity is a global."""
    return np.array([x[1], -GRAVITY * np.sin(x[0]) - p.damping * x[1] + u[0] + d[0]])


def pendulum_loop() -> fh.Loop:
    """The same for a plant of one's own."""
    plant = Plant(falling, lambda x, u, p: x[:1], ("a", "da"), ("u",), ("push",), {"damping": 1.0})
    problem = plant.with_objective({"a": 3.0, "da": 1.0})
    solution = fh.solve_hji(problem, gamma=2.0 * fh.smallest_gamma(problem), degree=4)
    ekf = fh.ExtendedKalmanFilter(plant, 1e-2, 1e-6, 1e-6, np.zeros(2), 1e-4)
    return fh.Loop(plant, fh.Controller(solution, ekf, period=1e-2))


@pytest.mark.nightly("ten million steps, to tell a bit per step from none")
def test_ten_million_compiled_steps_are_flat() -> None:
    step = arm_loop(2.0).controller.step
    points = []
    for million in range(11):
        y = np.zeros(1)
        for k in range(1_000_000 if million else 100_000):
            y[0] = 1e-3 * (k % 97)
            step(y, 0.5)
        points.append((million, resident()))
    assert slope(points[1:]) < 50.0, points  # KB per million: less than a bit per step


@NUMBERS
def test_designs_of_one_robot_are_flat(number: int) -> None:
    points = []
    for k in range(number):
        arm_loop(1.5 + 0.005 * k).run(fh.Step(1.0), duration=0.05)
        if (k + 1) % (number // 10) == 0:
            points.append((k, resident()))
    assert slope(points[2:]) < 20.0, points  # KB per design


@NUMBERS
def test_designs_of_changing_code_give_their_machine_code_back(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, number: int
) -> None:
    monkeypatch.setenv("FLEXHINF_CACHE", str(tmp_path))
    monkeypatch.setenv("FLEXHINF_OPTIMISATION", "0")  # a kernel of each design, which runs once
    monkeypatch.setattr(shared, "CAPACITY", 8)  # so that the oldest are forgotten from the beginning
    points = []
    for k in range(number):
        monkeypatch.setitem(globals(), "GRAVITY", 5.0 + 0.01 * k)
        pendulum_loop().run(duration=0.05, initial_state=[0.1, 0.0])
        if (k + 1) % (number // 10) == 0:
            points.append((k, resident()))
    assert slope(points[2:]) < 100.0, points  # KB per design; 514 were kept before
