"""The exported controller takes over an arm that another law drives: it is told where the arm is and what it applies.

The arm carries a load that the controller does not know. It rests away from the start of the design, or moves. The loop
is integrated here, around the compiled C. Python, told the same, must give the same bits.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.designs.task import Task
from flexhinf.designs.workspace.search import tuned_setup
from flexhinf.export.compiled import CompiledController
from flexhinf.plant import rk4_step
from flexhinf.robot.workspace import workspace_of

# Libraries that make a thousand samples.
pytestmark = [pytest.mark.oracle, pytest.mark.usefixtures("unoptimised")]

PERIOD, LIMIT, LOAD = 1e-3, 48.0, 0.3  # s, V, N·m on the link
PLANT = fh.paper_arm().plant()

#: Where the PD that had the arm before leads it: to rest at 0.6 rad, and through there at 1 rad/s.
GOALS: dict[str, Callable[[float], float]] = {"rests": lambda t: 0.6, "moves": lambda t: 0.6 + (t - 4.0)}


class Driven(NamedTuple):
    """State of the arm, (4,), and the input that is applied, V."""

    state: np.ndarray
    input: float


def moved(x: np.ndarray, u: float) -> np.ndarray:
    return np.asarray(rk4_step(lambda x, u: PLANT.derivative(x, [u], [LOAD, 0.0]), x, (u, u, u), PERIOD))


@pytest.fixture(scope="module")
def control() -> fh.Controller:
    """A cubic law with an integral, the unscented filter, and a sample of latency."""
    arm = fh.paper_arm()
    specification = fh.Specification(
        pose=0.8, start=0.0, preset="damped", degrees=(4,), draws=0, rays=0, proof_seconds=0.0,
        saturation=LIMIT,
    )  # fmt: skip
    return fh.design(arm, specification).controller()


@pytest.fixture(scope="module")
def library(
    control: fh.Controller, compiler: str, tmp_path_factory: pytest.TempPathFactory
) -> CompiledController:
    folder: Path = tmp_path_factory.mktemp("library")
    return fh.load_compiled(fh.compile_controller(control, folder / "arm.so"))


@pytest.fixture(scope="module", params=GOALS)
def driven(request: pytest.FixtureRequest) -> Driven:
    goal, moves = GOALS[request.param], request.param == "moves"
    x, u, speed = goal(0.0) * np.array([1.0, 0.0, 1.0, 0.0]), 0.0, float(moves)
    for k in range(4000):
        aim = goal(k * PERIOD)
        u = float(np.clip(60.0 * (aim - x[2]) + 12.0 * (speed - x[3]), -LIMIT, LIMIT))
        x = moved(x, u)
    return Driven(x, u)


def taken_over(control: Any, driven: Driven, samples: int = 1000) -> tuple[np.ndarray, np.ndarray]:
    """Inputs that act, (samples,), the first one being that before, and positions of the link; the goal is where the
    arm was."""
    x, applied, inputs, positions = driven.state, driven.input, [], []
    for _ in range(samples):
        after = float(control.step([x[0]], [driven.state[0]])[0])
        inputs.append(applied)
        positions.append(x[0])
        x, applied = moved(x, applied), after  # what a sample gives acts when the next one begins
    return np.array(inputs), np.array(positions)


@pytest.mark.ci("designs a controller, and two runs of 4 s")
def test_the_input_continues_and_the_arm_stays(library: CompiledController, driven: Driven) -> None:
    """RunCounts, the input goes on as it was; untold, it jumps to the limit at once and the arm leaves its place."""
    library.reset(driven.state, [driven.input])
    inputs, positions = taken_over(library, driven)
    assert inputs[1] == pytest.approx(driven.input, abs=1e-9)
    assert np.abs(np.diff(inputs)).max() < 2e-3 * LIMIT
    assert np.abs(inputs).max() < 1.2 * driven.input
    left = np.abs(positions - positions[0]).max()
    library.reset()
    inputs, positions = taken_over(library, driven)
    assert np.abs(np.diff(inputs)).max() > 0.2 * LIMIT
    assert np.abs(inputs).max() == LIMIT
    assert np.abs(positions - positions[0]).max() > 1.5 * left


@pytest.mark.ci("designs a controller, and two runs of 4 s")
def test_python_told_the_same_gives_the_same_bits(
    control: fh.Controller, library: CompiledController, driven: Driven
) -> None:
    told = {"state": driven.state, "input": [driven.input]}
    one = control.fresh(fused=library.fused)
    for each in (one, library):
        each.reset(**told)
    for mine, other in zip(taken_over(one, driven, 300), taken_over(library, driven, 300), strict=True):
        np.testing.assert_array_equal(mine, other)


# A workspace ------------------------------------------------------------------------------------------
#: On links and motors, N·m, and the plans on which a PD has led the arm so long, s: at rest, and half-way.
LOADS = np.array([0.5, 0.3, 0.0, 0.0])
PLANS = {"rests": ((0.8, -0.5), (0.8, -0.5), 3.0), "moves": ((-0.4, 0.2), (0.8, -0.5), 1.0)}


class Arm(NamedTuple):
    """Two links that carry the loads: state (8,) and input (2,), and the plan's states and inputs from now on, (N, 10),
    one row a sample."""

    plant: fh.Plant
    state: np.ndarray
    input: np.ndarray
    plan: np.ndarray

    def moved(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        return np.asarray(rk4_step(lambda x, u: self.plant.derivative(x, u, LOADS), x, (u, u, u), PERIOD))

    def taken_over(self, control: Any, samples: int = 1500) -> tuple[np.ndarray, np.ndarray]:
        """Inputs that act (samples, 2), the first being that before, and errors of the links (samples, 2), rad."""
        x, applied, inputs, errors = self.state, self.input, [], []
        for now, then in zip(self.plan[:samples], self.plan[1:], strict=False):  # a sample of latency
            after = np.array(control.step([*x[:2], *x[4:6]], then))
            inputs.append(applied)
            errors.append((x - now[:8])[:2])
            x, applied = self.moved(x, applied), after
        return np.array(inputs), np.array(errors)


@pytest.fixture(scope="module")
def workspace() -> fh.Controller:
    """A design for the workspace with encoders on both sides, without its judgement."""
    robot, sensors = fh.load_robot("planar-two-link"), ("link_position", "motor_position")
    s = fh.Specification(workspace="limits", measured=sensors, saturation=LIMIT)
    setup = tuned_setup(robot, s, Task(workspace_of(robot, "limits")))
    return setup.controller(setup.workspace.home, supervision=setup.supervision)


@pytest.fixture(scope="module", params=PLANS)
def led(request: pytest.FixtureRequest) -> Arm:
    begin, goal, time = PLANS[request.param]
    robot = fh.load_robot("planar-two-link")
    moves = [fh.Quintic(a, b, 2.0) for a, b in zip(begin, goal, strict=True)]
    motion, times = fh.Moving(moves, robot.inverse_dynamics), PERIOD * np.arange(round(time / PERIOD) + 1501)
    plan = np.hstack([motion.state(times), motion.input(times)])
    arm = Arm(robot.plant(("link_position", "motor_position")), *robot.operating_point(begin), plan)
    x, u = arm.state, arm.input
    for aim in plan[:-1501]:
        error = aim[:8] - x
        pd = np.array([400.0, 200.0]) * error[4:6] + np.array([40.0, 20.0]) * error[6:]
        u = np.clip(aim[8:] + pd, -LIMIT, LIMIT)
        x = arm.moved(x, u)
    return arm._replace(state=x, input=u, plan=plan[-1501:])


@pytest.mark.ci("designs a workspace, and compiles a library")
@pytest.mark.parametrize(("start", "jump"), [("zero", 1e-2), ("bumpless", 1e-9)])
def test_a_controller_of_a_workspace_takes_over(
    start: str, jump: float, workspace: fh.Controller, led: Arm, compiler: str, tmp_path: Path
) -> None:
    """RunCounts, the first input changes by what the load makes of it, or not at all where the design begins without
    a jump;
    untold, it jumps by 10 times as much, the governor notwithstanding. Python, told the same, gives the same bits."""
    controller = workspace.fresh(start=start)
    one = fh.load_compiled(fh.compile_controller(controller, tmp_path / "arm.so"))
    one.reset(led.state, led.input)
    inputs, errors = led.taken_over(one)
    assert np.abs(inputs[1] - inputs[0]).max() < jump * LIMIT
    assert (
        np.abs(np.diff(inputs[:900], axis=0)).max() < 1e-2 * LIMIT
    )  # a quintic's acceleration jumps at its end
    assert np.abs(errors).max() < 3e-3
    same = controller.fresh(fused=one.fused)
    for each in (one, same):
        each.reset(led.state, led.input)
    for mine, other in zip(led.taken_over(one, 300), led.taken_over(same, 300), strict=True):
        np.testing.assert_array_equal(mine, other)
    if start == "zero":
        one.reset()
        inputs, untold = led.taken_over(one)
        assert np.abs(np.diff(inputs, axis=0)).max() > 0.1 * LIMIT
        assert np.abs(untold).max() > 100 * np.abs(errors).max()
