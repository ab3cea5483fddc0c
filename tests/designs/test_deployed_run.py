"""A run of a deployed controller: the step or the move of the design, on a robot that may be another one."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from tests.refusals import refused_with, unnamed

import flexhinf as fh
from flexhinf.designs import Specification
from flexhinf.designs.deployed_run import DeployedRun, perturbed, prepare_run
from flexhinf.errors import InvalidInput
from flexhinf.export import realtime
from flexhinf.pages import run_met, run_notes, run_tables, run_verdict
from flexhinf.pages.run import SLOW

pytest.importorskip("mujoco")


class OwnClock:
    """In place of the module `time`: it goes on where somebody sleeps, and by a microsecond when it is read."""

    now = 0

    def perf_counter_ns(self) -> int:
        self.now += 1000
        return self.now

    time_ns = perf_counter_ns

    def sleep(self, seconds: float) -> None:
        self.now += round(1e9 * seconds)


MOVE = {"time": [0.0, 0.4, 0.8], "elbow": [0.0, 0.1, 0.2], "shoulder": [0.1, 0.15, 0.2]}


def controller_of(robot: fh.Robot, start: list[float], penalty: Any = None) -> fh.Controller:
    """A linear law with an unscented filter that begins at a pose, without a jump of the input."""
    plant = robot.plant()
    mean = robot.operating_point(start)[0]
    ukf = fh.UnscentedKalmanFilter(plant, 1e-3, 1e-9, 1e-8, mean, 1e-6)
    problem = robot.problem(penalty) if penalty else robot.problem()
    return fh.Controller(fh.linear_law(problem, gamma=math.inf), ukf, 1e-3, 48.0, start="bumpless")


@pytest.fixture(scope="module")
def paper() -> tuple[fh.Robot, fh.Controller]:
    robot = fh.paper_arm()
    return robot, controller_of(robot, [-0.1])


def prepared(
    paper: tuple[fh.Robot, fh.Controller],
    robot: fh.Robot | None = None,
    conditions: dict[str, Any] | None = None,
    **fields: Any,
) -> DeployedRun:
    model, controller = paper
    step: dict[str, Any] = {"pose": (0.0,), "start": "-0.1"}
    original, s = Specification(**step), Specification(**{**step, "duration": 0.3, **fields})
    return prepare_run(controller, (model, original), robot or model, s, **(conditions or {}))


@pytest.mark.ci("two loops: on MuJoCo's robot and on ours")
@pytest.mark.oracle
def test_the_step_is_that_of_the_loop_on_our_own_plant(paper: tuple[fh.Robot, fh.Controller]) -> None:
    """MuJoCo's robot against ours, integrated by our Runge–Kutta steps: the same noise, the same command."""
    run = prepared(paper)
    found = fh.run_realtime(run.loop, **run.arguments, real_time=False).trajectory
    given = {name: run.arguments[name] for name in ("reference", "noise", "duration", "initial_state")}
    ours = fh.Loop(paper[0].plant(), paper[1]).run(**given)
    for kind in ("state", "input", "estimate"):
        size = np.abs(ours.signals[kind]).max()
        np.testing.assert_allclose(found.signals[kind], ours.signals[kind], rtol=0, atol=1e-6 * size)


@pytest.mark.ci("runs of two robots")
def test_another_robot_a_load_no_noise(paper: tuple[fh.Robot, fh.Controller]) -> None:
    softer = perturbed(paper[0], ["stiffness=-20%"])
    loaded = {"noise": False, "load": 0.5, "load_at": 0.1}
    run = prepared(paper, softer, loaded, angle_unit="deg")
    made = fh.run_realtime(run.loop, **run.arguments, real_time=False)
    torque = made.trajectory.signal("disturbance", "link_torque")
    assert torque[99] == 0.0
    assert torque[100] == 0.5
    measured, true = (made.trajectory.signal(kind, "link_position") for kind in ("output", "state"))
    np.testing.assert_array_equal(measured, true)
    # the robot that is driven begins in its own equilibrium, and the law holds it there
    x, u = softer.operating_point([-0.1])
    np.testing.assert_allclose(made.trajectory.signals["state"][0], x)
    np.testing.assert_allclose(run.loop.controller.input_before(), u)
    assert run_met(run, made) is all(line.met for line in run.requirements(made))


@pytest.mark.ci("drives MuJoCo's robot")
def test_a_move_is_followed_in_error_coordinates() -> None:
    """Also where it begins elsewhere than the step of the design: the estimate begins there."""
    robot = fh.load_robot("planar-two-link")
    controller = controller_of(robot, [0.2, 0.1], {"link_position": 60, "link_position_integral": 300})
    s = Specification(start="0.2,0.1", move=MOVE, measurement_noise=2e-3**2)
    original = Specification(pose=robot.home, start="0.2,0.1")
    run = prepare_run(controller, (robot, original), robot, s, noise=False)
    assert run.loop.controller.mode.moving
    np.testing.assert_allclose(run.start, [0.1, 0.0])
    np.testing.assert_allclose(run.goal, [0.2, 0.2])
    np.testing.assert_allclose(run.arguments["initial_estimate"], robot.operating_point([0.1, 0.0])[0])
    made = fh.run_realtime(run.loop, **run.arguments, real_time=False)
    assert len(made.trajectory.time) == 1201
    lines = {line.what: line for line in run.requirements(made)}
    assert lines["tracking error"].found < 2e-3
    assert lines["remaining error"].limit == pytest.approx(6e-3)  # three deviations of the sensors
    assert unnamed(run_verdict(run, made), "followed", "move from (0.1 rad", "to (0.2 rad") == []
    assert len(run_tables(run, made)) == 3


@pytest.mark.ci("runs in real time")
def test_what_is_said_of_a_run(paper: tuple[fh.Robot, fh.Controller]) -> None:
    run = prepared(paper)
    made = fh.run_realtime(run.loop, **run.arguments)
    lines = {line.what: line for line in run.requirements(made)}
    missed = int(made.timing.missed.sum())
    assert lines["missed deadlines"].found == pytest.approx(100.0 * missed / 301)
    assert lines["overshoot"].found == run.response(made).overshoot.value
    text = run_verdict(run, made)
    kept = (missed, 301, "deadlines") if missed else ("deadline", "301 samples", "1000 Hz")
    assert (
        unnamed(text.partition(". ")[0], *(kept if made.timing.slowness <= SLOW else ("0.3 s", "not"))) == []
    )
    assert unnamed(text, "not settle", "step from −0.1 rad") == []
    assert len(run_tables(run, made)) == 3
    assert bool(run_notes(made)) >= bool(missed)
    free = fh.run_realtime(run.loop, **run.arguments, real_time=False)
    assert "missed deadlines" not in {line.what for line in run.requirements(free)}
    first = run_verdict(run, free).partition(". ")[0]
    assert unnamed(first, "not", "real time", "301 samples") == []


@pytest.mark.ci("drives MuJoCo's robot")
def test_a_loop_that_is_too_slow_is_said_to_be(
    paper: tuple[fh.Robot, fh.Controller], monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a clock of our own: looking at the run takes four periods of it."""
    clock = OwnClock()
    monkeypatch.setattr(realtime, "time", clock)

    def slow() -> bool:
        clock.sleep(0.004)
        return True

    run = prepared(paper, duration=0.05)
    made = fh.run_realtime(run.loop, **run.arguments, watch=slow, watch_every=1e-3)
    assert made.timing.slowness > 3.0
    assert unnamed(run_verdict(run, made), "real time", "not", "0.05 s") == []
    assert not any("deadlines" in text for text in run_notes(made))
    assert not run_met(run, made)
    stopped = fh.run_realtime(run.loop, **run.arguments, watch=lambda: False, real_time=False)
    assert unnamed(run_verdict(run, stopped), "stopped", "0 s") == []
    assert len(run_tables(run, stopped)) == 2


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        (["stifness=-20%"], "(?s)'paper'.*parameter.*'stifness=-20%'"),
        (["stiffness"], "NAME=NUMBER.*'stiffness'"),
        (["stiffness=soft"], "NAME=NUMBER.*'stiffness=soft'"),
        (["stiffness=nan"], "NAME=NUMBER.*'stiffness=nan'"),
        (["stiffness=-200%"], "stiffness"),
    ],
)
def test_changes_that_cannot_be_made(changes: list[str], what: str) -> None:
    with pytest.raises(InvalidInput, match=what):
        perturbed(fh.paper_arm(), changes).plant()


def test_changes_of_all_joints_and_of_one() -> None:
    robot = fh.load_robot("planar-two-link")
    other = perturbed(robot, ["stiffness=-10%", "stiffness_elbow=+5%", "mass_elbow=1.5"])
    assert other.nominal["stiffness_shoulder"] == pytest.approx(0.9 * robot.nominal["stiffness_shoulder"])
    assert other.nominal["stiffness_elbow"] == pytest.approx(1.05 * robot.nominal["stiffness_elbow"])
    assert other.nominal["mass_elbow"] == 1.5


def test_a_load_outside_of_the_run_and_extras_of_others(paper: tuple[fh.Robot, fh.Controller]) -> None:
    with pytest.raises(InvalidInput, match="outside"):
        prepared(paper, conditions={"load": 1.0, "load_at": 0.3})
    with refused_with(InvalidInput, "MuJoCo", "'inductance'"):
        prepared(paper, extras="inductance")
