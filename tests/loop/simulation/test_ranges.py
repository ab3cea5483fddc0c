"""A command beyond the limits of a joint is refused before a run, whoever commands it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.loop.simulation.run_arguments import check_ranges


@pytest.fixture(scope="module")
def robot() -> fh.Robot:
    return fh.load_robot("planar-two-link")


def loop_of(robot: fh.Robot, moving: bool) -> fh.Loop:
    problem = robot.problem()
    law = fh.linear_law(problem, gamma=2.0 * fh.smallest_gamma(problem))
    return fh.Loop(robot.plant(), fh.Controller(law, None, 1e-3, moving=moving))


def test_commands_beyond_a_joint_are_refused_with_joint_time_and_value(robot: fh.Robot) -> None:
    low, high = robot.links.limits[1]
    wide = high + 0.3
    elbow = {"link_position_elbow": fh.Step(wide, at=0.25)}
    with pytest.raises(fh.InvalidInput, match="link_position_elbow") as caught:
        loop_of(robot, moving=False).run(elbow, duration=0.5)
    assert f"{wide:.6g} rad at t = 0.25 s" in str(caught.value)
    assert f"{low:g} to {high:g}" in str(caught.value)
    wave = [0.0, fh.Sine(wide, 1.0)]
    moving: Any = fh.Moving(wave, robot.inverse_dynamics)
    with pytest.raises(fh.InvalidInput, match="leaves the range of 'link_position_elbow'"):
        loop_of(robot, moving=True).run(moving, duration=1.0)


def test_the_limit_itself_and_states_without_limits_are_commanded(robot: fh.Robot) -> None:
    _, high = robot.links.limits[1]
    run = loop_of(robot, moving=False).run({"link_position_elbow": high}, duration=0.01)
    assert run.signals["reference"][0, 1] == high
    arm = fh.paper_arm()
    assert arm.plant().limits == {}
    check_ranges(np.array([[1e9]]), np.zeros(1), ["anything"], {}, {})
