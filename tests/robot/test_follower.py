"""Trajectories of waypoints: splines by SciPy, motions by the elastic plant, and what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import BPoly
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.codegen.c.source import zeros
from flexhinf.errors import InvalidInput
from flexhinf.robot import FollowCode, FollowGoal
from flexhinf.robot.follow_pieces import between

PERIOD = 2e-3
NAMES = ("shoulder", "elbow")


def follower(period: float = PERIOD, **options: Any) -> fh.Follower:
    return fh.Follower(fh.load_robot("planar-two-link"), period, **options)


@pytest.mark.oracle
@pytest.mark.parametrize("order", [1, 2, 3])
def test_waypoints_are_joined_by_the_polynomial_of_what_they_state(order: int) -> None:
    """SciPy's polynomial in Bernstein form has the same value and derivatives at both ends."""
    rng = np.random.default_rng(order)
    begin, end = rng.normal(size=(2, 3))
    expected = BPoly.from_derivatives([0.0, 0.7], [begin[:order], end[:order]])
    for at in (0.0, 0.2, 0.69):
        found = zeros(3)
        between(begin, end, 0.7, at, order, found)
        np.testing.assert_allclose(found, [expected(at, nu=k) for k in range(3)], rtol=1e-9, atol=1e-9)


@pytest.mark.oracle
@pytest.mark.ci("integrates the elastic plant along a replaced path")
def test_the_rows_are_a_motion_of_the_elastic_arm() -> None:
    """Integrated with the rows' inputs, the plant stays on the rows' states: a linear goal, replaced at speed."""
    one = follower()
    one.reset([-0.4, 0.3])
    plant, rows = one.robot.plant(), []
    for k in range(500):
        if k in (5, 200):
            assert (
                one.start(FollowGoal(NAMES, [0.5], [[0.1, -0.2] if k == 5 else [-0.2, 0.1]]))
                is FollowCode.ACTIVE
            )
        rows.append(one.step().row)
    rows, n = np.array(rows), plant.n
    times, none = PERIOD * np.arange(len(rows)), np.zeros(len(plant.disturbances))
    numbers = plant.parameters.named(plant.parameters.vector())

    def rates(t: float, x: np.ndarray) -> np.ndarray:
        u = [np.interp(t, times, column) for column in rows[:, n:].T]
        return np.asarray(plant.flow(x, np.array(u), none, numbers), dtype=float)

    found = solve_ivp(rates, (0.0, times[-1]), rows[0, :n], t_eval=times, rtol=1e-7, atol=1e-9)
    assert np.abs(found.y.T[:, :2] - rows[:, :2]).max() < 2e-4
    assert np.abs(np.diff(rows[:, :2], axis=0)).max() > 1e-4


#: Goals that cannot be followed: how each is called, and what it has beside a good one.
UNFOLLOWED: list[tuple[str, dict[str, Any]]] = [
    ("INVALID_JOINTS", {"joint_names": ("shoulder", "wrist")}),
    ("INVALID_JOINTS", {"joint_names": ("elbow",), "positions": [[0.1], [0.2]]}),
    ("INVALID_JOINTS", {"joint_names": ("elbow", "elbow")}),
    ("INVALID_JOINTS", {"path_tolerance": {"wrist": (0.1, 0.1)}}),
    ("INVALID_GOAL", {"times": [], "positions": np.zeros((0, 2))}),
    ("INVALID_GOAL", {"times": [1.0, 0.5]}),
    ("INVALID_GOAL", {"times": [-0.1, 0.5]}),
    ("INVALID_GOAL", {"times": [0.5, 0.5 + PERIOD / 17]}),
    ("INVALID_GOAL", {"times": [0.5, np.inf]}),
    ("INVALID_GOAL", {"positions": [[0.0, 0.0], [np.nan, 0.0]]}),
    ("INVALID_GOAL", {"positions": [[0.0, 0.0], [0.0, 2.7]]}),
    ("INVALID_GOAL", {"times": [0.5, 0.51]}),
    ("INVALID_GOAL", {"velocities": [[0.1, 0.0], [0.0, 0.1]]}),
    ("INVALID_GOAL", {"velocities": [[0.1, 0.0], [0.0, -2e-7]]}),
    ("INVALID_GOAL", {"goal_tolerance": {"elbow": (-0.5, 0.0)}}),
    ("INVALID_GOAL", {"goal_time": -2.0}),
    ("OLD_HEADER_TIMESTAMP", {"begins": -1.5}),
]


def test_goals_that_cannot_be_followed_change_nothing() -> None:
    good: dict[str, Any] = {"joint_names": NAMES, "times": [0.5, 1.0], "positions": [[0.0, 0.0], [0.2, 0.1]]}
    one, other = follower(), follower()
    for each in (one, other):
        assert each.start(FollowGoal(**good)) is FollowCode.ACTIVE
        for _ in range(40):
            each.step()
    for code, changed in UNFOLLOWED:
        bad = FollowGoal(**(good | changed))
        assert one.check(bad) is one.start(bad) is FollowCode[code], changed
        assert np.array_equal(one.step().row, other.step().row), changed


@pytest.mark.parametrize(
    ("what", "advice"),
    [
        (lambda: FollowGoal(NAMES, [1.0], [[0.1]]), "each time"),
        (lambda: FollowGoal(NAMES, 1.0, [[0.1, 0.2]]), "times="),
        (lambda: FollowGoal(NAMES, [1.0], [["a", "b"]]), "positions="),
        (lambda: FollowGoal(NAMES, [1.0, 2.0], [[0.1, 0.2], [0.1]]), "positions="),
        (lambda: FollowGoal("elbow", [1.0], [[0.1] * 5]), "joint_names="),
        (lambda: FollowGoal(NAMES, [1.0], [[0.1, 0.2]], begins=None), "begins=0.0"),
        (lambda: FollowGoal(NAMES, [1.0], [[0.1, 0.2]], path_tolerance={"elbow": ("a", "b")}), "0.01"),
        (lambda: follower(latency=0.5), "controller.mode.latency"),
        (lambda: follower(path_tolerance=None), "shoulder"),
        (lambda: FollowGoal(NAMES, [1.0], [[0.1, 0.2]], path_tolerance={"elbow": (0.1,)}), "elbow"),
        (lambda: follower(path_tolerance={"wrist": (0.1, 0.1)}), "shoulder"),
        (lambda: follower(goal_tolerance={"elbow": (-0.1, 0.1)}), "0.01"),
        (lambda: follower(goal_time=-1.0), "goal_time=0.0"),
        (lambda: follower(timeout=np.nan), "timeout=0.0"),
        (lambda: follower(stop_time=0.0), "stop_time=0.5"),
        (lambda: follower(latency=-1), "controller.mode.latency"),
        (lambda: follower(smoothing=0.0071), "smoothing="),
        (lambda: follower().reset([0.1]), "each joint"),
        (lambda: follower().step([0.1]), "each joint"),
    ],
)
def test_what_is_no_goal_or_follower_is_refused(what: Any, advice: str) -> None:
    with refused_with(InvalidInput, advice):
        what()


def test_the_last_pose_is_held_and_at_a_stop_nothing_leaves_the_range() -> None:
    """The elbow is cancelled at 2 rad/s just before the end of its range, 2.6 rad."""
    one = follower(1e-2, stop_time=1.0)
    one.reset([0.0, 1.0])
    assert one.start(FollowGoal(NAMES, [0.75, 2.0], [[0.0, 2.5], [0.0, 0.0]])) is FollowCode.ACTIVE
    for _ in range(72):
        one.step()
    one.cancel()
    places = np.array([one.step().position for _ in range(130)])
    assert places[:, 1].max() == places[-1][1] == pytest.approx(2.6)
    assert np.array_equal(places[-1], places[-10])


def moving(samples: int, speed: float = 1.0) -> fh.Follower:
    """A follower in the middle of a move by 0.5 rad in 1 s."""
    one = follower()
    one.reset([0.0, 0.0])
    assert one.start(FollowGoal(NAMES, [1.0], [[0.5, 0.5]])) is FollowCode.ACTIVE
    for _ in range(samples):
        one.step(speed=speed)
    return one


def places_of(one: fh.Follower, samples: int, speed: float) -> np.ndarray:
    return np.array([one.step(speed=speed).position[0] for _ in range(samples)])


def test_at_speed_0_nothing_moves_from_the_beginning() -> None:
    assert not places_of(moving(0), 200, 0.0).any()


def test_a_cancelled_goal_does_not_go_on_when_the_speed_returns() -> None:
    """Paused, cancelled, and then at full speed again."""
    one = moving(150)
    held = places_of(one, 400, 0.0)[-1]
    one.cancel()
    assert np.array_equal(places_of(one, 100, 0.0), places_of(one, 100, 1.0))
    assert one.step().position[0] == held


def test_a_slow_move_stops_in_the_same_time() -> None:
    """The velocity is kept at the cancel, and is 0 after `stop_time` and the smoothing."""
    one = moving(300, 0.2)
    speed = np.diff(places_of(one, 2, 0.2))[0]
    one.cancel()
    steps = np.diff(places_of(one, 320, 0.2))
    assert steps[0] == pytest.approx(speed, rel=1e-6)
    assert np.all(np.diff(steps) <= 1e-12)
    assert not steps[312:].any()


def test_a_goal_after_a_slow_stop_continues_it() -> None:
    """No velocity jumps where it begins in the middle of the stop."""
    one = moving(300, 0.2)
    one.cancel()
    places = places_of(one, 60, 0.2)
    assert one.start(FollowGoal(NAMES, [1.0], [[0.2, 0.2]], [[0.0, 0.0]])) is FollowCode.ACTIVE
    places = np.concatenate([places, places_of(one, 200, 0.2)])
    assert np.abs(np.diff(places, 2)).max() < 2e-5


def test_a_second_cancel_changes_nothing() -> None:
    one, other = moving(150), moving(150)
    one.cancel()
    other.cancel()
    for _ in range(80):
        other.cancel()
        assert np.array_equal(one.step().row, other.step().row)


def test_the_arrays_of_a_goal_are_its_own() -> None:
    one, times = follower(), np.array([0.5])
    one.reset([0.0, 0.0])
    assert one.start(FollowGoal(NAMES, times, [[0.1, 0.1]])) is FollowCode.ACTIVE
    times[0] = 5.0
    assert places_of(one, 320, 1.0)[-1] == pytest.approx(0.1)
