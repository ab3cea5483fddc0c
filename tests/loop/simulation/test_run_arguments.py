"""What a run is given is checked before it starts, whoever asks."""

import re
from typing import Any

import numpy as np
import pytest
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.loop import Controller, Loop
from flexhinf.loop.simulation.inputs import (
    MOST_SAMPLES,
    check_ranges,
    sample_count,
    start_text,
    starting_state,
)
from flexhinf.numerals import number_text
from flexhinf.robot import paper_arm

WITH_COIL = paper_arm().plant(inductance=True).states


def test_by_name_in_order_and_by_default(made):
    controller = Controller(made.law_about([0.5]), None)
    lag = 9.8 * np.sin(0.5) / 100.0
    np.testing.assert_allclose(
        starting_state(None, WITH_COIL, controller), [0.5, 0, 0.5 + lag, 0, 0], atol=1e-12
    )
    named = {"coil_current": 2.0, "link_position": 0.1}
    np.testing.assert_array_equal(starting_state(named, WITH_COIL, controller), [0.1, 0, 0, 0, 2.0])
    np.testing.assert_array_equal(starting_state([1, 2, 3, 4, 5], WITH_COIL, controller), [1, 2, 3, 4, 5])
    np.testing.assert_array_equal(starting_state([1, 2, 3, 4], WITH_COIL, controller), [1, 2, 3, 4, 0])


@pytest.mark.parametrize("apart", [0.3, -0.3, 0.0])
def test_a_run_says_where_it_starts_beside_the_controller(made, apart):
    controller, plant = Controller(made.law_about([0.5]), None), paper_arm().plant()
    x = starting_state(None, plant.states, controller)
    x[1] += apart
    text = start_text(plant, x, True, controller, np.zeros(1))
    assert (f"{plant.states[1]} = {number_text(apart, 'rad/s')}," in text) == (apart != 0.0)


def test_fewer_values_are_those_of_the_designed_plant_by_name(made):
    controller = Controller(made.law, None)
    mixed = ("coil_current", *reversed(controller.states))
    np.testing.assert_array_equal(starting_state([1, 2, 3, 4], mixed, controller), [0, 4, 3, 2, 1])


@pytest.mark.parametrize(
    "given",
    [
        {"speed": 1.0},
        {"link_position": np.nan},
        {"link_position": "up"},
        [1.0],
        [0] * 6,
        "rest",
        3.0,
        [np.inf] * 5,
    ],
)
def test_what_does_not_fit_is_refused(made, given):
    with pytest.raises(InvalidInput):
        starting_state(given, WITH_COIL, Controller(made.law, None))


# Ranges of joints ---------------------------------------------------------------------------------
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
    assert re.search(rf" {wide:.6g} rad .* 0\.25 s", str(caught.value))
    assert f"{low:g} to {high:g}" in str(caught.value)
    wave = [0.0, fh.Sine(wide, 1.0)]
    moving: Any = fh.Moving(wave, robot.inverse_dynamics)
    with refused_with(fh.InvalidInput, "range", "'link_position_elbow'"):
        loop_of(robot, moving=True).run(moving, duration=1.0)


def test_the_limit_itself_and_states_without_limits_are_commanded(robot: fh.Robot) -> None:
    _, high = robot.links.limits[1]
    run = loop_of(robot, moving=False).run({"link_position_elbow": high}, duration=0.01)
    assert run.signals["reference"][0, 1] == high
    arm = fh.paper_arm()
    assert arm.plant().limits == {}
    check_ranges(np.array([[1e9]]), np.zeros(1), ["anything"], {}, {})


# Degrees, milliseconds and hertz --------------------------------------------------------------------
@pytest.mark.parametrize(
    "command",
    [
        180, fh.Step(180), fh.Step(1.0, at=0.2, initial=90.0), [90.0], {"link_position": fh.Step(-180.0)},
        fh.Quintic(0.0, 90.0, 1.0),
        fh.JerkLimited(0.0, 45.0, 100.0, 100.0, 1000.0), fh.Sine(30.0, 1.0), np.array([7.0]),
    ],
)  # fmt: skip
def test_degrees_are_asked_about(made: Any, command: Any) -> None:
    loop = Loop(paper_arm().plant(), Controller(made.law, None))
    with refused_with(InvalidInput, "'link_position'", "turn", "6.283 rad") as caught:
        loop.run(command, duration=0.5)
    assert "np.radians(" in str(caught.value)


def test_the_hint_converts_the_number(made: Any) -> None:
    loop = Loop(paper_arm().plant(), Controller(made.law, None))
    with pytest.raises(InvalidInput, match=r"np.radians\(180\) = 3.142"):
        loop.run(fh.Step(180))


def test_a_turn_and_several_that_are_meant_are_commanded(made: Any) -> None:
    loop = Loop(paper_arm().plant(), Controller(made.law, None))
    assert loop.run(2.0 * np.pi, duration=0.01).signals["reference"][0, 0] == 2.0 * np.pi
    assert loop.run(7.0, duration=0.01, multi_turn=True).signals["reference"][0, 0] == 7.0
    for computed in (fh.Samples([0.0, 1.0], [7.0, 8.0]), lambda t: 7.0 + t):
        assert loop.run(computed, duration=0.01).signals["reference"][0, 0] == 7.0


def test_what_is_no_angle_has_no_turns(made: Any) -> None:
    plant, law = made.two_inputs()
    run = Loop(plant, Controller(law, None, 1e-2)).run(100.0, duration=0.05)
    assert run.signals["reference"][0, 0] == 100.0


def test_the_number_of_samples() -> None:
    assert sample_count(8.0, 1e-3) == 8001
    assert sample_count(0.3, 0.1) == 4
    assert sample_count((MOST_SAMPLES - 1) * 1e-3, 1e-3) == MOST_SAMPLES


@pytest.mark.parametrize(
    ("duration", "match"),
    [
        (-3, r"positive[\s\S]* -3"),
        (4e-4, r" 0\.001 s, got 0\.0004 s"),
        (1e5, r"duration=100 .*100000 ms"),
        ("long", r"positive[\s\S]*'long'"),
    ],
)
def test_durations_out_of_proportion(duration: Any, match: str) -> None:
    with pytest.raises(InvalidInput, match=match):
        sample_count(duration, 1e-3)
