"""Commands and moves: by the shaping, within the joints' limits, and refused with how much slower they must be."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.designs import Specification
from flexhinf.designs.judge import move_limits, move_requirements
from flexhinf.designs.loop_setup import LoopSetup
from flexhinf.designs.plans import stated_move, step_command
from flexhinf.designs.responses import joint_limits
from flexhinf.errors import InvalidInput

Benches = Callable[..., LoopSetup]
WAY = {"time": [0.0, 0.8, 2.0], "elbow": [0.0, 0.4, -0.3], "shoulder": [0.2, 0.5, 0.4]}


@pytest.mark.ci("runs along a command")
@pytest.mark.parametrize("shaping", ["quintic", "jerk-limited"])
def test_a_shaped_step_needs_less_and_arrives_without_a_jump(setup_of: Benches, shaping: str) -> None:
    jump = setup_of("planar-two-link", (0.4, 0.6), (-0.2, 0.2))
    shaped = setup_of("planar-two-link", (0.4, 0.6), (-0.2, 0.2), shaping=shaping, feedforward=False)
    assert (jump.command, jump.command_time) == (None, 0.0)
    command = shaped.command
    assert command is not None
    np.testing.assert_allclose(
        command(np.array([0.0, command.duration])), [shaped.start, shaped.goal], atol=1e-12
    )
    at_once, slowly = jump.step(3.0), shaped.step(3.0)
    assert slowly.peak_input < 0.8 * at_once.peak_input
    np.testing.assert_allclose(slowly.positions[-1], shaped.goal, atol=2e-3)
    reference = slowly.run.signals["reference"]
    np.testing.assert_allclose(reference, command(slowly.run.time), atol=1e-12)
    nominal, links, instants = shaped.robot.corner({}), shaped.true_plant.states[:2], np.arange(101)
    sampled = shaped.ensemble(
        [nominal],
        8,
        shaped.bumpless_controller,
        shaped.start,
        0.1,
        reference=command,
        kept=links,
        instants=instants,
    )
    alone = shaped.step(0.1, nominal, seed=1, sub_steps=8)
    np.testing.assert_allclose(alone.run.signals["reference"], command(alone.run.time), atol=1e-12)
    np.testing.assert_array_equal(sampled.kept[0], alone.positions)


@pytest.mark.parametrize("shaping", ["quintic", "jerk-limited"])
def test_a_limit_of_speed_makes_the_command_slower(robot_of: Callable[[str], Any], shaping: Any) -> None:
    robot, start, goal = robot_of("planar-two-link"), np.array([0.0, 0.0]), np.array([0.8, -0.4])
    free, slow = (
        step_command(robot, Specification(shaping=shaping, peak_speed=speed), start, goal)
        for speed in (None, 0.3)
    )
    assert free is not None
    assert slow is not None
    t = np.linspace(0.0, slow.duration, 2000)
    assert np.abs(slow.derivatives(t, 1)[1]).max() <= 0.3 < np.abs(free.derivatives(t, 1)[1]).max()
    assert slow.duration > 1.5 * free.duration


@pytest.mark.ci("runs along a command")
@pytest.mark.parametrize("shaping", ["jump", "quintic", "jerk-limited"])
def test_a_stated_move_is_followed_through_its_waypoints_and_judged(setup_of: Benches, shaping: str) -> None:
    setup = setup_of("planar-two-link", (0.4, -0.3), estimator="none", shaping=shaping, move=WAY)
    plan = stated_move(setup.robot, setup.specification)
    assert plan is not None
    move = setup.move(plan, dwell=1.0)
    at = np.searchsorted(move.response.run.time, np.array(WAY["time"]) - 1e-9)
    wanted = np.column_stack([WAY["shoulder"], WAY["elbow"]])
    np.testing.assert_allclose(move.response.positions[at], wanted, atol=2e-3)
    np.testing.assert_allclose(move.response.goal, wanted[-1], atol=1e-12)
    assert move.response.run.time[-1] == pytest.approx(3.0, abs=2e-3)
    error, after, *motion = move_requirements(setup.specification, setup.limits, move, 0.0)
    assert [line.met for line in (error, after, *motion)] == [True] * 4
    assert error.found > 0.0
    assert error.limit == pytest.approx(0.05 * dict(zip(setup.joints, move.travel))[error.joint])


def test_a_joint_that_stays_has_a_tracking_error_that_can_be_met(robot_of: Callable[[str], Any]) -> None:
    """Its way along the move is rounding: 5 % of 5e-16 rad were required."""
    robot, s = robot_of("cart"), Specification()
    tracking, _ = move_limits(s.tracking_error, joint_limits(robot, s), np.array([0.04, 5e-16]))
    np.testing.assert_allclose(tracking, [2e-3, 5e-4])


@pytest.mark.ci("weights are searched")
def test_the_tracking_error_is_a_requirement_of_each_joint(setup_of: Benches) -> None:
    setup = setup_of(
        "planar-two-link", (0.4, 0.6), estimator="none", move=WAY, tracking_error=("1e-9", "10deg")
    )
    plan = stated_move(setup.robot, setup.specification)
    assert plan is not None
    error = move_requirements(setup.specification, setup.limits, setup.move(plan), 0.0)[0]
    assert (error.met, error.joint, error.limit, error.stated_by) == (
        False,
        "shoulder",
        1e-9,
        "--tracking-error",
    )


@pytest.mark.parametrize(
    ("options", "message", "advice"),
    [
        (
            {"move": {**WAY, "elbow": [0.0, 4.0, 0.0]}},
            r"(?s)limits.*'elbow'.*2\.6026",
            "rad",
        ),
        (
            {"move": WAY, "peak_speed": 0.5},
            r"(?s)'elbow' faster.* 0\.5 rad/s",
            "3.06 times",
        ),
        ({"move": WAY, "saturation": 3.0}, "(?s)'elbow'.*motor.* 3 V", "4.65 times"),
        ({"move": {**WAY, "time": [0.0, 1e5, 2e6]}}, r"(?s)too long.*666\.667 s", "ms"),
        ({"move": {**WAY, "time": [0.0, 1e-4, 1e-3]}}, r"(?s)too little.*0\.01 s", "seconds"),
        ({"move": {**WAY, "time": [0.0, 1e-300, 1.0]}}, "near[^0-9]*1e-09 s", "seconds"),
        (
            {"move": {**WAY, "time": [0, 0.1, 2]}, "shaping": "jerk-limited"},
            r"smoothing[^0]*0 s[^0]*0\.1 s",
            "shaping='jump'",
        ),
        ({"move": {"time": [0, 1], "elbow": [0, 1]}}, r"column(?s:.)*'elbow'\]", "shoulder"),
    ],
)
def test_a_move_that_cannot_be_made_is_refused_before_any_work(
    robot_of: Callable[[str], Any], options: dict[str, Any], message: str, advice: str
) -> None:
    with pytest.raises(InvalidInput, match=message) as refused:
        fh.design(robot_of("planar-two-link"), Specification(pose="home", **options))
    assert advice in refused.value.advice


def test_the_advised_time_keeps_the_limits(robot_of: Callable[[str], Any]) -> None:
    robot, s = robot_of("planar-two-link"), Specification(move=WAY, peak_speed=0.5)
    with pytest.raises(InvalidInput) as refused:
        stated_move(robot, s)
    factor = float(refused.value.advice.split()[1])
    slower = {**WAY, "time": [1.001 * factor * t for t in WAY["time"]]}
    assert stated_move(robot, Specification(move=slower, peak_speed=0.5)) is not None


@pytest.mark.ci("runs along a command")
def test_a_shaped_step_has_its_feedforward_unless_it_is_switched_off(setup_of: Benches) -> None:
    """The step along its command is the planned move of that command, run by run; without, the law lags behind."""
    ends = (0.4, 0.6), (-0.2, 0.2)
    setup = setup_of("planar-two-link", *ends, shaping="quintic")
    step = setup.step(2.0)
    assert setup.command is not None
    move = setup.move(setup.command, 2.0 - setup.command.duration).response
    np.testing.assert_array_equal(step.positions, move.positions[: len(step.positions)])
    lags = setup_of("planar-two-link", *ends, shaping="quintic", feedforward=False)
    late = lags.step(2.0)
    away = [
        np.abs(run.positions - np.reshape(setup.command(run.run.time), run.positions.shape)).max()
        for run in (step, late)
    ]
    assert away[0] < 2e-3 < 0.05 < away[1]  # with the dry friction of the file
    np.testing.assert_array_equal(
        late.inputs, setup.run(setup.bumpless_controller, setup.start, 2.0, reference=setup.command).inputs
    )
    runs = lags.move(setup.command).response.run, setup.move(setup.command).response.run
    assert [len(run.names["reference"]) for run in runs] == [2, len(setup.model.states) + 2]
