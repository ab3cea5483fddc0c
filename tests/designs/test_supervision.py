"""What a deployed controller watches: the workspace of its design, in Python and after a move was prepared."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from tests.designs.test_workspace_controller import deployed, made

import flexhinf as fh
from flexhinf.designs.deployed_run import prepare_run
from flexhinf.designs.loop_setup import LoopSetup


@pytest.mark.ci("searches weights")
def test_a_design_of_a_pose_with_loud_sensors_counts_larger_swings(
    setup_of: Callable[..., LoopSetup],
) -> None:
    setups = (
        setup_of("planar-two-link", (0.5, -0.7), saturation=24.0, measurement_noise=1e-4, torque_noise=size)
        for size in (1e-9, 1e-2)
    )
    quiet, loud = (setup.supervision.swing for setup in setups)
    assert quiet is None
    swing = np.asarray(loud)
    assert (swing >= 0.2 * 24.0).all()
    assert swing.max() > 0.3 * 24.0


@pytest.mark.ci("steps a controller 3,000 times, twice")
def test_noise_that_requirements_allow_is_no_limit_cycle() -> None:
    """5 % of what a motor gives, rms: swings of ± 10 % are 4 standard deviations, and one followed the other."""
    quiet = made(measurement_noise=8e-4**2)
    setup = replace(quiet, random=tuple(10.0 * size for size in quiet.random))
    at = np.asarray(setup.workspace.home)
    share = setup.noise_spread(setup.linear(at))[0] / setup.authority
    assert 0.04 < share.max() < 0.06
    (x, u), one, said = setup.robot.operating_point(at), deployed(setup), []
    rest = dict(zip(one.commanded, [*x, *u], strict=True))
    run = setup.loop(one).run(rest, noise=setup.noise, duration=3.0, initial_state=x, seed=1)
    for swing in (setup.supervision.swing, 0.2 * setup.authority):
        one = deployed(setup, supervision=replace(setup.supervision, swing=swing))
        bits = []
        for y in run.signals["output"]:
            one.step(y, [*x, *u])
            bits.append(fh.Status.LIMIT_CYCLE in one.status)
        said.append(any(bits))
    assert said == [False, True]


@pytest.mark.ci("searches weights")
def test_the_workspace_lies_about_start_goal_and_law(setup_of: Callable[..., LoopSetup]) -> None:
    """A tenth of the largest travel beyond both ends, at least 0.05 rad; runs of a design watch nothing."""
    for goal, start, low, high in (
        ((0.5, -0.7), (0.0, 0.0), (-0.07, -0.77), (0.57, 0.07)),
        ((0.5, -0.7), (0.4, -0.7), (0.35, -0.75), (0.55, -0.65)),
    ):
        setup = setup_of("planar-two-link", goal, start)
        controller = setup.controller(setup.start, supervised=True)
        assert controller.supervision is not None
        assert np.array(controller.supervision.workspace) == pytest.approx(np.array([low, high]))
        assert setup.bumpless_controller.supervision is None
        y = np.zeros(len(controller.measured))
        controller.step(y, goal)
        assert controller.status == fh.Status(0)
        controller.step(y, (high[0] + 1e-6, goal[1]))
        assert controller.status == fh.Status.OUTSIDE_WORKSPACE
        assert controller.supervision.modes(moving=False) == ("none",) * 5


@pytest.mark.ci("searches weights")
def test_a_schedule_adds_the_poses_of_its_laws(setup_of: Callable[..., LoopSetup]) -> None:
    setup, other = setup_of("paper", (1.5,), (0.0,)), setup_of("paper", (-1.0,), (0.0,))
    box = replace(setup, law=fh.Schedule([setup.law, other.law])).supervision.workspace
    assert box is not None
    assert np.ravel(box) == pytest.approx([-1.0 - 0.25, 1.5 + 0.25])


@pytest.mark.ci("drives MuJoCo's robot")
def test_a_move_of_a_deployed_controller_is_watched_without_reactions() -> None:
    """It is driven in error coordinates, where a frozen command would have velocities; offsets decay as before."""
    pytest.importorskip("mujoco")
    robot = fh.load_robot("planar-two-link")
    watch = fh.Supervision(workspace=(-0.1, 0.15), reactions={"workspace": "limit"})
    ukf = fh.UnscentedKalmanFilter(
        robot.plant(), 1e-3, 1e-9, 1e-8, robot.operating_point([0.1, 0.0])[0], 1e-6
    )
    penalty = {"link_position": 60.0, "link_position_integral": 300.0}
    law = fh.linear_law(robot.problem(penalty), gamma=math.inf)
    controller = fh.Controller(law, ukf, 1e-3, 48.0, start="bumpless", supervision=watch, offset_time=0.5)
    move = {"time": [0.0, 0.4, 0.8], "elbow": [0.0, 0.1, 0.2], "shoulder": [0.1, 0.15, 0.2]}
    s = fh.Specification(start="0.1,0", move=move)
    run = prepare_run(controller, (robot, fh.Specification(start="0.1,0")), robot, s, noise=False)
    moving = run.loop.controller
    assert moving.supervision is not None
    assert moving.supervision.workspace == watch.workspace
    assert moving.mode.reactions == ("none",) * 5
    assert moving.offset_time == 0.5
    told = fh.run_realtime(run.loop, **run.arguments, real_time=False).status
    goals = np.abs(np.diff(told & fh.Status.OUTSIDE_WORKSPACE)).sum()
    assert told[0] == 0
    assert told[-1] == fh.Status.OUTSIDE_WORKSPACE
    assert goals == 1
