"""References and poses that a robot cannot follow or hold."""

from dataclasses import replace

import numpy as np
import pytest

from flexhinf.errors import InvalidInput
from flexhinf.loop import JerkLimited, Quintic, Sine, Step
from flexhinf.robot import check_holding, check_reference, load_robot, paper_arm


def refused(call):
    with pytest.raises(InvalidInput) as caught:
        call()
    assert caught.value.what
    assert caught.value.found
    assert caught.value.advice
    return str(caught.value)


@pytest.fixture(scope="module")
def limited():
    """A robot with limits on every joint."""
    robot = load_robot("seven-link")
    assert all(pair is not None for pair in robot.links.limits)
    return robot


def test_a_reference_within_the_limits(limited):
    home = list(limited.home)
    assert check_reference(limited, home, 1.0) == 0.0
    assert check_reference(limited, home, 0.5, period=0.1) == 0.0
    for ends in zip(*limited.links.limits):  # a limit itself may be commanded
        assert check_reference(limited, list(ends), 0.5) == 0.0
    assert check_reference(paper_arm(), Sine(100.0, 1.0), 2.0) == 0.0  # no limits are stated


@pytest.mark.parametrize("joint", [0, 3, 6])
@pytest.mark.parametrize("end", [0, 1])
def test_the_joint_the_time_the_value_and_the_limit_are_named(limited, joint, end):
    home, limit = list(limited.home), limited.links.limits[joint][end]
    beyond = limit + (0.2 if end else -0.2)
    signals = [*home]
    signals[joint] = Step(beyond, at=0.35, initial=home[joint])
    text = refused(lambda: check_reference(limited, signals, 1.0))
    assert repr(limited.joint_names[joint]) in text
    assert f"{beyond:.6g}" in text
    assert f"{limit:g}" in text
    assert "t = 0.35 s" in text


def test_joints_by_name_or_by_signal(limited):
    for full in ("", "link_position_"):
        signals = {f"{full}{name}": value for name, value in zip(limited.joint_names, limited.home)}
        assert check_reference(limited, signals, 0.2) == 0.0
        first = next(iter(signals))
        text = refused(lambda s=signals | {first: 50.0}: check_reference(limited, s, 0.2))
        assert limited.joint_names[0] in text


def test_the_last_moment_is_looked_at(limited):
    signals = [*limited.home]
    signals[0] = Step(50.0, at=1.0005, initial=signals[0])
    assert check_reference(limited, signals, 1.0004) == 0.0
    assert "t = 1.0005" in refused(lambda: check_reference(limited, signals, 1.0005))


def test_the_feedforward_stays_below_the_effort():
    """1 rad in 0.2 s needs an acceleration of about 5.77/0.04 rad/s², that is more than 60 V."""
    arm = paper_arm()
    slow, fast = Quintic(0.0, 1.0, 2.0), Quintic(0.0, 1.0, 0.2)
    share = check_reference(arm, slow, 2.5, effort=60.0)
    t = np.linspace(0.0, 2.5, 2501)
    expected = np.abs(arm.inverse_dynamics(*slow.derivatives(t)[..., None])[1]).max() / 60.0
    assert share == pytest.approx(expected)
    assert 0.0 < share < 1.0
    text = refused(lambda: check_reference(arm, fast, 2.5, effort=60.0))
    assert "'joint'" in text
    assert "60 V" in text
    assert "t = 0" in text


def test_efforts_of_joints():
    robot = load_robot("planar-two-link")
    move = JerkLimited((0.0, 0.0), (1.0, 1.0), 2.0, 10.0, 100.0, smoothing=0.1)
    _, u = robot.inverse_dynamics(*move.derivatives(np.arange(0.0, 1.5, 1e-3)))
    most = np.abs(u).max(axis=0)
    names = robot.joint_names
    assert check_reference(robot, move, 1.5, effort=most * 1.1) == pytest.approx(1 / 1.1, rel=1e-3)
    assert names[1] in refused(
        lambda: check_reference(robot, move, 1.5, effort=dict(zip(names, most * [1.1, 0.9])))
    )
    by_input = dict(zip(robot.plant().inputs, most * [0.9, 1.1]))
    assert names[0] in refused(lambda: check_reference(robot, move, 1.5, effort=by_input))


def test_a_pose_that_the_motors_cannot_hold():
    arm = paper_arm()
    x, u = check_holding(arm, 0.5 * np.pi, 11.0)
    assert u[0] == pytest.approx(9.8 * 10.0 / 9.0)
    assert x[0] == 0.5 * np.pi
    text = refused(lambda: check_holding(arm, [0.5 * np.pi], 10.0))
    assert "'joint'" in text
    assert "10.89 V" in text
    assert " 10 V" in text
    robot = load_robot("planar-two-link")
    holding = np.abs(robot.operating_point([1.2, 0.3])[1])
    assert robot.joint_names[1] in refused(lambda: check_holding(robot, [1.2, 0.3], holding * [1.5, 0.5]))


@pytest.mark.parametrize("effort", [0.0, -1.0, np.nan, "much", [1.0, 2.0, 3.0], {"nobody": 1.0}, {}])
def test_limits_that_are_none_are_refused(effort):
    refused(lambda: check_holding(load_robot("planar-two-link"), None, effort))
    refused(lambda: check_reference(paper_arm(), 0.0, 1.0, effort=effort))


def test_times_that_are_none_are_refused():
    refused(lambda: check_reference(paper_arm(), 0.0, 0.0))
    refused(lambda: check_reference(paper_arm(), 0.0, 1.0, period=np.nan))


@pytest.mark.parametrize("pose", [90, [-180.0]])
def test_a_pose_beyond_one_turn_asks_whether_degrees_were_meant(pose):
    text = refused(lambda: paper_arm().problem(pose=pose))
    assert "degrees" in text
    assert "90deg" in text or "-180deg" in text
    paper_arm().problem(pose=[2.0 * np.pi])


def test_limits_are_one_per_joint_and_checked():
    robot = load_robot("planar-two-link")
    assert robot.effort_limits == robot.speed_limits == (np.inf, np.inf)
    limited = replace(robot, effort_limits=[300.0, None], speed_limits=(2.0, 1.5))
    assert limited.effort_limits == (300.0, np.inf)
    assert limited.with_values({"gravity": 3.7}).speed_limits == (2.0, 1.5)
    for field in ("effort_limits", "speed_limits"):
        for wrong in ([1.0], [1.0, -2.0], [1.0, np.nan], 3.0, "87,12"):
            assert "joints" in refused(lambda field=field, wrong=wrong: replace(robot, **{field: wrong}))


def test_what_a_robot_states_is_kept_by_default():
    robot = replace(load_robot("planar-two-link"), effort_limits=(1.0, 1e3), speed_limits=(2.0, 1.5))
    first, second = robot.joint_names
    text = refused(lambda: check_holding(robot, [1.5, 0.0]))
    assert repr(first) in text
    assert " 1 V" in text
    check_holding(robot, [1.5, 0.0], 1e4)
    slow = {first: 0.1, second: Sine(0.5, 0.45)}  # 1.41 rad/s
    assert check_reference(robot, slow, 2.0) == 0.0
    fast = {first: 0.1, second: Sine(0.5, 0.5)}  # 1.57 rad/s
    text = refused(lambda: check_reference(robot, fast, 2.0))
    assert repr(second) in text
    assert "1.5 rad/s" in text
    assert check_reference(robot, fast, 2.0, speed={second: 1.6, first: 1.0}) == 0.0


class Ramp:
    """A signal with one derivative and no more."""

    def __init__(self, speed):
        self.speed = speed

    def derivatives(self, t, order):
        return np.stack([self.speed * t, np.full(len(t), self.speed)])[: order + 1]


def test_speeds_need_one_derivative():
    robot = replace(load_robot("planar-two-link"), speed_limits=(2.0, 1.5))
    assert check_reference(robot, [Ramp(0.2), Ramp(1.4)], 0.5) == 0.0
    assert repr(robot.joint_names[1]) in refused(lambda: check_reference(robot, [Ramp(0.2), Ramp(1.6)], 0.5))
