"""Runs of the cases of trajectories, by their names."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from tests.export.test_ros2 import FOLLOWING
from tests.export.trajectory_session import (
    GOAL,
    JOINTS,
    LONGEST,
    MOVE,
    START,
    TINY,
    Make,
)


def shuffled(make: Make) -> Any:
    one = make()
    one.goal(MOVE[0], [row[::-1] for row in MOVE[1]], joints=JOINTS[::-1])
    return one.finished()


def one_waypoint(make: Make) -> Any:
    one = make()
    one.goal([1.0], [GOAL])
    return one.finished()


def from_now(make: Make) -> Any:
    """As MoveIt sends it: where the arm is, at rest, and then the others."""
    one = make()
    none, speed = np.zeros(2), np.subtract(GOAL, START)
    one.goal([0.0, *MOVE[0]], [START, *MOVE[1]], [none, speed, none], [none] * 3)
    found = one.finished()
    one.is_smooth()
    assert one.desired[500 + 60 + 1][:2] == pytest.approx(MOVE[1][0], abs=1e-3)
    return found


def polynomials(make: Make) -> Any:
    """The commanded path, 0.06 s earlier, is that of the waypoints: known in the middle of the second segment."""
    way, times = np.subtract(GOAL, START), [0.5, 1.0]
    speeds, none = [way, 0.0 * way], np.zeros((2, 2))
    middles = []
    for rows in ([], [speeds], [speeds, none]):
        one = make()
        one.goal(times, MOVE[1], *rows)
        found = one.finished()
        one.is_smooth()
        middles.append(one.desired[750 + 60 + 1][:2])
    # linear: ¾ of the way; cubic from ½ with v = way per s: ½ + ¼ + ⅛ · ½; quintic: ½ + ¼ + 5/32 · ½
    shares = [0.75, 0.75 + 0.5 / 8, 0.75 + 0.5 * 5 / 32]
    for middle, share in zip(middles, shares, strict=True):
        np.testing.assert_allclose(middle, START + share * way, atol=5e-4)
    return found


def mixed(make: Make) -> Any:
    """Velocities at the first waypoint alone: cubic, and then linear."""
    way = np.subtract(GOAL, START)
    one = make()
    one.goal([0.5, 1.0], MOVE[1], [way, None])
    found = one.finished()
    one.is_smooth()
    for at, share in ((250, 0.1875), (750, 0.75)):  # s = ½ of each: ¼ · 1 − ⅛ · ½, and the middle
        np.testing.assert_allclose(one.desired[at + 60 + 1][:2], START + share * way, atol=5e-4)
    return found


def refused(*arguments: Any, **other: Any) -> Callable[[Make], Any]:
    def run(make: Make) -> Any:
        one = make()
        one.goal(*arguments, **other)
        found = one.finished(None, 0)
        one.run(50)
        np.testing.assert_allclose(one.measured[-1], START, atol=1e-3)
        return found

    return run


def jumping(make: Make) -> Any:
    one = make()
    one.goal([0.005, 1.0], [GOAL, GOAL])
    assert one.accepted()
    one.run(50)
    np.testing.assert_allclose(one.measured[-1], START, atol=1e-3)
    return one.ended()


def swinging(make: Make) -> Any:
    """From the motion of now: the first way would end where it begins, by way of the end of the range."""
    one = make()
    still = np.zeros((1, 2))
    one.goal([0.7], [START], still, [(600.0, 0.0)])
    assert one.accepted()
    one.run(50)
    np.testing.assert_allclose(one.measured[-1], START, atol=1e-3)
    return one.ended()


def undisturbed(make: Make) -> Any:
    """A goal goes on, and may be cancelled, though another one was sent that cannot start."""
    ends = []
    for cancels in (False, True):
        one = make()
        one.goal(*MOVE)
        assert one.accepted()
        first = one.manager("goal_handle")
        one.run(500)
        one.goal([0.005, 1.0], [np.add(GOAL, 0.5), GOAL])
        assert one.accepted()
        one.run(2)
        assert one.ended() == ("aborted", -1)
        one.manager("look_at", ctypes.c_void_p(first))
        assert one.ended() == ("followed", None)
        if cancels:
            assert one.manager("cancel_goal") == 1
        one.run(LONGEST)
        one.is_smooth()
        assert one.desired[-1][2:] == [0.0, 0.0]
        assert np.allclose(one.measured[-1], GOAL, atol=2e-3) is not cancels
        ends.append(one.ended())
    assert ends[1] == ("cancelled", 0)
    return ends[0]


def open_until(make: Make) -> Any:
    """It succeeds while the other one waits."""
    one = make()
    one.goal([0.4], [np.add(START, 0.1)])
    assert one.accepted()
    first = one.manager("goal_handle")
    one.run(100)
    one.goal(*MOVE, begins=0.8)
    assert one.accepted()
    second = one.manager("goal_handle")
    one.run(600)
    one.manager("look_at", ctypes.c_void_p(first))
    found = one.ended()
    one.manager("look_at", ctypes.c_void_p(second))
    one.run(LONGEST)
    assert one.ended() == ("succeeded", 0)
    return found


def cancelled_waiting(make: Make) -> Any:
    one = make()
    one.goal(*MOVE)
    assert one.accepted()
    first = one.manager("goal_handle")
    one.run(300)
    one.goal([1.0], [START], begins=1.5)
    assert one.accepted()
    one.run(1)
    assert one.manager("cancel_goal") == 1
    one.run(2)
    found = one.ended()
    one.manager("look_at", ctypes.c_void_p(first))
    one.run(LONGEST)
    assert one.ended() == ("succeeded", 0)
    np.testing.assert_allclose(one.measured[-1], GOAL, atol=2e-3)
    return found


def cancelled_nothing(make: Make) -> Any:
    one = make()
    one.goal(*MOVE)
    one.manager("publish_trajectory")
    one.run(500)
    one.manager("cancel_nothing")
    one.run(LONGEST)
    one.is_smooth()
    assert one.desired[-1][2:] == [0.0, 0.0]
    assert abs(one.measured[-1] - GOAL).max() > 0.05
    one.goal(*MOVE)  # and what comes later is followed
    return "held" if one.finished() == ("succeeded", 0) else "?", None


def partial(make: Make) -> Any:
    one = make(allow_partial_joints_goal=True)
    one.goal(*MOVE)
    assert one.accepted()
    one.run(500)
    one.goal([0.6], [[0.1]], joints=("shoulder",))
    found = one.finished(None)
    one.is_smooth()
    assert one.measured[-1][0] == pytest.approx(0.1, abs=2e-3)
    assert one.desired[-1][3] == 0.0
    return found


def partly_past(make: Make) -> Any:
    """0.7 s are over: 0.3 s are left to the last waypoint."""
    one = make()
    one.goal(*MOVE, begins=-0.7)
    found = one.finished(samples=600)
    one.is_smooth()
    assert one.desired[300 + 121][:2] == pytest.approx(GOAL, abs=1e-9)
    return found


def future(make: Make) -> Any:
    """Links are where the stamp says: the goal before it is at its end by then."""
    one = make()
    one.goal([0.4], [np.add(START, 0.1)])
    assert one.accepted()
    one.run(100)
    one.goal(*MOVE, begins=0.8)
    assert one.accepted()
    one.run(700)
    assert one.desired[-1][:2] == pytest.approx(np.add(START, 0.1), abs=1e-3)
    one.run(600)
    assert one.desired[-1][:2] == pytest.approx(MOVE[1][0], abs=5e-3)
    one.run(800)
    np.testing.assert_allclose(one.measured[-1], GOAL, atol=2e-3)
    one.is_smooth()
    return one.ended()


def replaced(make: Make) -> Any:
    one = make()
    one.goal(*MOVE)
    assert one.accepted()
    one.run(500)
    before = one.manager("goal_handle")
    one.goal([0.5, 1.0], [START, GOAL])
    assert one.accepted()
    assert one.manager("goal_handle") != before
    one.run(LONGEST)
    np.testing.assert_allclose(one.measured[-1], GOAL, atol=2e-3)
    one.is_smooth()
    return one.ended()


def cancelled(make: Make) -> Any:
    """The motion goes on, and rests after stop_time and the smoothing."""
    one = make(stop_time=0.3)
    one.goal(*MOVE)
    assert one.accepted()
    one.run(500)
    at, speed = np.array(one.desired[-1]).reshape(2, 2)
    assert np.abs(speed).min() > 0.1
    assert one.manager("cancel_goal") == 1
    one.run(425)
    assert one.desired[-1][2:] == [0.0, 0.0]
    np.testing.assert_allclose(one.desired[-1][:2], at + speed * (0.06 + 0.15), atol=3e-3)
    one.is_smooth()
    one.run(300)
    np.testing.assert_allclose(one.measured[-1], one.desired[-1][:2], atol=2e-3)
    return one.ended()


def goal_missed(make: Make) -> Any:
    one = make()
    one.goal(*MOVE, at_goal=TINY, goal_time=0.2)
    assert one.accepted()
    one.run(1300)
    assert one.ended()[0] == "followed"
    one.run(30)
    return one.ended()


def moving_at_goal(make: Make) -> Any:
    """The links are where they shall be, and a velocity is never exactly zero."""
    one = make(constraints__stopped_velocity_tolerance=1e-12, constraints__goal_time=0.2)
    one.goal(*MOVE)
    return one.finished(samples=1400)


def nearly_at_rest(make: Make) -> Any:
    """What rounding leaves of a planner's last velocity is none."""
    one = make()
    one.goal(*MOVE, [(0.3, -0.3), (1e-7, -1e-9)])
    assert one.finished() == ("succeeded", 0)
    return refused(*MOVE, [(0.1, 0.1), (0.0, 2e-7)])(make)


def waiting(make: Make) -> Any:
    one = make()
    one.goal(*MOVE, at_goal=TINY)
    return one.finished(samples=3000)


def on_path(tolerance: float, parameter: float = 0.0) -> Callable[[Make], Any]:
    def run(make: Make) -> Any:
        one = make(constraints__elbow__trajectory=parameter)
        one.goal(*MOVE, path=[("elbow", tolerance, 0.0)])
        found = one.finished(None)
        one.is_smooth()
        assert one.desired[-1][2:] == [0.0, 0.0]
        return found

    return run


def held(make: Make) -> Any:
    """A robot that stands still, whose controller does not brake: as far as its path goes on while one would."""
    one = make()
    one.goal([2.0], [np.add(START, (0.69, 0.0))])
    assert one.accepted()
    one.is_held = True
    one.run(1300)
    assert one.ended() == ("followed", None)
    one.run(700)
    away = np.abs(np.array(one.desired)[:, 0] - START[0])
    allowed = FOLLOWING + 0.5 * 0.3 * 2.5
    assert allowed < np.nanmax(away) < allowed + 0.15  # it comes to rest from there
    return one.ended()


def braked(make: Make) -> Any:
    """The command leaves the box of the workspace, where the controller brakes until it begins again."""
    one = make()
    one.goal([1.5], [(0.6, 0.2)])
    found = one.finished(None, 1900)
    assert 0.3 < one.measured[-1][0] < 0.6
    np.testing.assert_allclose(np.diff(one.measured[-50:], axis=0), 0.0, atol=1e-4)
    return found


def fighting(make: Make) -> Any:
    """Twenty times a second, for more than a second; then one of them stops."""
    one = make()
    places = np.add(START, (0.2, 0.1)), np.add(START, (-0.2, -0.1))
    for k in range(36):
        assert one.is_contested() == (k > 21)
        one.goal([0.8], [places[k % 2]])
        one.manager("publish_trajectory")
        one.run(50)
    one.goal([0.8], [places[0]])
    one.manager("publish_trajectory")
    one.run(1500)
    assert not one.is_contested()
    np.testing.assert_allclose(one.measured[-1], places[0], atol=2e-3)
    return "contested", None


def streamed(make: Make) -> Any:
    """A servo: each point where a sine will be; the links are that much later, and nothing is contested."""
    one = make()
    way = [np.add(START, (0.2 * np.sin(2e-3 * 1.5 * k), 0.1 * np.sin(2e-3 * 1.5 * k))) for k in range(2000)]
    for k in range(0, 1700, 10):
        one.goal([0.1], [way[k]])
        one.manager("publish_trajectory")
        one.run(20)
        assert not one.is_contested()
    late = [np.abs(one.measured[2 * k + 100 + 60] - way[k]).max() for k in range(200, 1600)]
    assert max(late) < 0.03
    return "followed", None


def timed_out(make: Make) -> Any:
    one = make(cmd_timeout=0.3)
    one.goal(*MOVE, at_goal=TINY)
    assert one.accepted()
    one.run(1400)
    assert one.ended()[0] == "followed"
    one.run(30)
    return one.ended()


def scaled(make: Make) -> Any:
    """At half of its speed from the middle on: it ends half a second later."""
    one = make(speed_scaling_interface="scaling/factor")
    one.goal(*MOVE)
    assert one.accepted()
    one.run(500)
    one.run(600, speed=0.5)
    assert one.ended()[0] == "followed"
    one.run(600, speed=0.5)
    one.is_smooth()
    np.testing.assert_allclose(one.measured[-1], GOAL, atol=2e-3)
    return one.ended()


def fault(make: Make) -> Any:
    one = make()
    one.goal(*MOVE)
    assert one.accepted()
    one.run(400)
    codes = [one.manager.update([math.nan] * 4) for _ in range(15)]
    assert codes[-1] == 1
    assert np.array_equal(one.manager.input(), [0.0, 0.0])
    found = one.ended()
    assert b"stopped" in one.manager("goal_text")
    one.goal(*MOVE)
    assert not one.accepted()
    return found


def elsewhere(make: Make) -> Any:
    one = make()
    one.goal(*MOVE)
    assert one.accepted()
    one.run(400)
    assert one.manager("deactivate") == 0
    found = one.ended()
    pose = (-0.6, 0.5)
    one.activate(pose)
    one.run(300)
    np.testing.assert_allclose(one.measured[-300:], np.broadcast_to(pose, (300, 2)), atol=2e-3)
    one.goal([1.0], [GOAL])
    assert one.accepted()
    one.run(LONGEST)
    np.testing.assert_allclose(one.measured[-1], GOAL, atol=2e-3)
    assert one.ended() == ("succeeded", 0)
    return found


def off(make: Make) -> Any:
    one = make()
    assert one.manager("deactivate") == 0
    one.goal(*MOVE)
    return one.finished(None, 0)


def empty_topic(make: Make) -> Any:
    one = make()
    one.goal(*MOVE)
    assert one.accepted()
    one.run(300)
    one.goal([])
    one.manager("publish_trajectory")
    one.run(LONGEST - 300)
    one.is_smooth()
    np.testing.assert_allclose(one.measured[-1], GOAL, atol=2e-3)
    return one.ended()


def by_topic(make: Make) -> Any:
    one = make()
    one.goal(*MOVE)
    assert one.accepted()
    one.run(300)
    other = np.add(START, (0.2, 0.1))
    one.goal([1.0], [other])
    one.manager("publish_trajectory")
    one.run(LONGEST)
    np.testing.assert_allclose(one.measured[-1], other, atol=2e-3)
    one.is_smooth()
    return one.ended()


def by_topic_beyond(make: Make) -> Any:
    one = make(constraints__elbow__trajectory=1e-5)
    one.goal(*MOVE)
    one.manager("publish_trajectory")
    one.run(LONGEST)
    one.is_smooth()
    assert one.desired[-1][2:] == [0.0, 0.0]
    assert abs(one.measured[-1] - GOAL).max() > 0.1
    return "held", None


RUNS: dict[str, Callable[[Make], Any]] = {
    "shuffled names": shuffled, "linear, cubic, quintic": polynomials,
    "one waypoint": one_waypoint, "first waypoint at time 0": from_now, "waypoint without positions": refused([1.0]),
    "waypoints of mixed kinds": mixed, "empty goal": refused([]),
    "unknown joint": refused(*MOVE, joints=("shoulder", "wrist")),
    "joint left out": refused([1.0], [[0.1]], joints=("elbow",)),
    "joint left out, `allow_partial_joints_goal`": partial,
    "times that do not increase": refused([0.5, 0.5], MOVE[1]),
    "efforts": refused(*MOVE, *[[(0.0, 0.0)] * 2] * 3),
    "number that is not finite": refused(MOVE[0], [START, (math.nan, 0.0)]),
    "speed at the end": nearly_at_rest,
    "beyond the joint's range": refused([1.0], [(3.1, 0.0)]),
    "beyond range or speed between waypoints": refused([1.0, 1.7], [START] * 2, [(40.0, 0.0), (0.0, 0.0)]),
    "beyond range or speed from where it is": swinging,
    "jump between waypoints": refused([0.5, 0.51], [START, GOAL]),
    "jump from where it is": jumping, "goal before one that cannot start": undisturbed,
    "past stamp, over": refused(*MOVE, begins=-1.5), "past stamp, partly": partly_past, "future stamp": future,
    "goal before one with a future stamp": open_until,
    "replaced at speed": replaced, "cancelled at speed": cancelled,
    "cancelled before it begins": cancelled_waiting, "cancel without an open goal": cancelled_nothing,
    "goal tolerance missed": goal_missed,
    "moving at the goal": moving_at_goal,
    "goal time 0": waiting, "path tolerance": on_path(1e-5), "path tolerance 0": on_path(0.0, 1e-5),
    "path tolerance, unstated": held, "controller brakes": braked,
    "path tolerance −1": on_path(-1.0, 1e-5), "other negative tolerance": refused(*MOVE, path=[("elbow", -0.5, 0.0)]),
    "time-out": timed_out, "speed scaling": scaled, "fault in mid-move": fault,
    "deactivated, then active at another pose": elsewhere, "not active": off, "topic": by_topic,
    "topic, path tolerance": by_topic_beyond, "two publishers that fight": fighting,
    "one publisher at 50 Hz": streamed, "empty trajectory on the topic": empty_topic,
}  # fmt: skip
