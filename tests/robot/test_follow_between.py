"""Range and speed between waypoints: what is refused, beside the extremes of polynomials and beside dense samples."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.interpolate import BPoly

import flexhinf as fh
from flexhinf.codegen.c.source import room
from flexhinf.robot import FollowCode, FollowGoal
from flexhinf.robot.follow_limits import BETWEEN, EDGE, ROUNDING
from flexhinf.robot.follow_pieces import leaves, spanned
from flexhinf.robot.robot import Robot

#: Speed limits of both joints, rad/s; their ranges are ± 3.0 and ± 2.6 rad.
SPEEDS = (2.0, 1.5)
ENDS = np.array([3.0, 2.6])
NAMES = ("shoulder", "elbow")
STILL = [0.0, 0.0]


@cache
def paced() -> Robot:
    return replace(fh.load_robot("planar-two-link"), speed_limits=SPEEDS)


def follower(pose: Any = (0.0, 0.0), period: float = 1e-3) -> fh.Follower:
    one = fh.Follower(paced(), period)
    one.reset(pose)
    return one


def polynomial(begin: Any, end: Any, time: float, order: int) -> BPoly:
    return BPoly.from_derivatives([0.0, time], [begin[:order], end[:order]])


def extremes(way: BPoly, time: float) -> tuple[float, float]:
    """Smallest and largest value of a polynomial, at its ends and where its derivative is zero."""
    coefficients = np.polynomial.Polynomial(
        np.polynomial.polynomial.polyfit(np.linspace(0.0, 1.0, 9), way(time * np.linspace(0.0, 1.0, 9)), 5)
    )
    roots = coefficients.deriv().roots()
    at = [0.0, 1.0, *(r.real for r in roots if abs(r.imag) < 1e-6 and 0.0 < r.real < 1.0)]
    values = way(time * np.array(at))
    return float(values.min()), float(values.max())


place, speed = st.floats(-3.0, 3.0), st.floats(-20.0, 20.0)
motion = st.tuples(place, speed, st.floats(-300.0, 300.0))


@pytest.mark.property
@pytest.mark.oracle
@given(
    motion,
    motion,
    st.floats(1e-3, 5.0),
    st.sampled_from([1, 2, 3]),
    st.floats(-4.0, 4.0),
    st.floats(0.1, 3.0),
)
def test_a_way_leaves_a_range_as_its_extremes_say(
    begin: Any, end: Any, time: float, order: int, low: float, wide: float
) -> None:
    """By the roots of the derivatives: of position and velocity, but where they are as near as rounding."""
    spans = room(6), room(6)
    degree = spanned(begin, end, time, order, *spans)
    way = polynomial(begin, end, time, order)
    for coefficients, at, curve in ((spans[0], degree, way), (spans[1], degree - 1, way.derivative())):
        least, most = extremes(curve, time)
        size = 1e-7 * max(map(abs, coefficients[: at + 1])) + 1e-9
        if min(abs(least - low), abs(most - low - wide)) > size:
            assert leaves(coefficients, at, low, low + wide) == (least < low or most > low + wide)


@pytest.mark.parametrize("size", [1e300, np.inf, np.nan])
def test_what_is_no_number_leaves_every_range(size: float) -> None:
    spans = room(6), room(6)
    degree = spanned([0.0, 0.0, 0.0], [0.1, 0.0, size], 0.7, 3, *spans)
    assert leaves(spans[0], degree, -1e6, 1e6)


def dense(goal: FollowGoal, begin: Any = None) -> np.ndarray:
    """Largest position beyond the range, and share of the speed limit, of dense samples of each way, by SciPy."""
    rows, orders, times = (
        np.zeros((3, len(np.atleast_1d(goal.times)), 2)),
        goal.orders,
        np.asarray(goal.times),
    )
    for k, part in enumerate(goal.arrays):
        rows[k] = part
    found = np.full(2, -np.inf)
    pairs = [
        (rows[:, k], rows[:, k + 1], times[k + 1] - times[k], min(orders[k : k + 2]))
        for k in range(len(times) - 1)
    ]
    pairs += [] if begin is None else [(begin, rows[:, 0], times[0], orders[0])]
    for first, last, time, order in pairs:
        for j in range(2):
            way, at = polynomial(first[:, j], last[:, j], time, order), np.linspace(0.0, time, 400)
            beyond = np.abs(way(at)).max() - ENDS[j]
            found = np.maximum(found, [beyond, np.abs(way(at, nu=1)).max() / SPEEDS[j]])
    return found


pair = st.tuples(st.floats(-2.5, 2.5), st.floats(-2.5, 2.5))
few = st.integers(2, 4)


@st.composite
def goals(draw: Any) -> FollowGoal:
    """Waypoints near one another, as fast as what they state lets them be."""
    count, order = draw(few), draw(st.sampled_from([1, 2, 3]))
    steps = [draw(st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))) for _ in range(count)]
    first = draw(pair)
    rows = np.clip(np.add(first, np.cumsum(steps, axis=0)), -ENDS, ENDS)
    times = np.cumsum([draw(st.floats(0.2, 1.5)) for _ in range(count)])
    rates = np.array([draw(st.tuples(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0))) for _ in range(count)])
    changes = np.array([draw(st.tuples(st.floats(-9.0, 9.0), st.floats(-9.0, 9.0))) for _ in range(count)])
    rates[-1] = 0.0
    return FollowGoal(NAMES, times, *[rows, rates, changes][:order])


@pytest.mark.property
@pytest.mark.oracle
@given(goals())
def test_goals_are_taken_exactly_where_dense_samples_stay_inside(goal: FollowGoal) -> None:
    """In `check`; both sides of the margins are stated, and between them either answer is right."""
    beyond, share = dense(goal)
    taken = follower().check(goal) is FollowCode.SUCCESSFUL
    if beyond > 2.0 * EDGE * 6.0 or share > 1.001 * BETWEEN:
        assert not taken
    if beyond < -1e-9 and share < (0.999 if goal.orders[0] == 1 else 0.999 * BETWEEN) and _slow(goal):
        assert taken


def _slow(goal: FollowGoal) -> bool:
    """Whether mean speeds are below the limits."""
    means = np.abs(np.diff(goal.positions, axis=0)) / np.diff(goal.times)[:, None]
    return bool(np.all(means <= ROUNDING * np.array(SPEEDS)))


@pytest.mark.property
@pytest.mark.ci("plays goals sample by sample")
@given(goals(), goals(), st.floats(0.05, 1.2), st.integers(0, 1))
def test_the_motion_stays_within_range_and_speed(
    first: FollowGoal, second: FollowGoal, at: float, hop: int
) -> None:
    """A goal that is replaced at speed, and a jump before it: also what smoothing makes of both."""
    one = follower(np.asarray(first.positions)[0], 4e-3)
    started = one.start(first) is FollowCode.ACTIVE
    jump = ROUNDING * one.smoothing * np.array(SPEEDS)
    samples = []
    for k in range(round((at + 6.5) / 4e-3)):
        if k == round(at / 4e-3):
            if hop:
                near = np.clip(one._state.now[0] + 0.9 * jump, -ENDS, ENDS)
                one.start(FollowGoal(NAMES, [4e-3], [near]))
            begin, second_taken = np.array(one._state.now), one.start(second) is FollowCode.ACTIVE
            if second_taken and not hop:
                assert dense(second, begin)[0] <= 2.0 * EDGE * 6.0
        samples.append(one.advance())
    q, dq = (np.array([getattr(one, name) for one in samples]) for name in ("position", "velocity"))
    assert np.all(np.abs(q) <= ENDS * (1.0 + 3.0 * EDGE))
    # a jump in one sample is at most 0.55 of it in a smoothing time: the height of the B-spline of degree 5
    assert np.all(np.abs(dq) <= (BETWEEN + 0.56 * ROUNDING * (1 + hop)) * np.array(SPEEDS))
    assert started or not np.abs(q[: round(at / 4e-3)] - q[0]).any()


def test_hops_one_behind_another_go_no_faster_than_the_limit() -> None:
    """Each is a jump that smoothing takes: in goals of one sample, and in waypoints of one goal."""
    one, taken = follower(), 0
    jump = ROUNDING * one.smoothing * SPEEDS[0]
    for _ in range(1000):
        goal = FollowGoal(NAMES, [1e-3], [[one._state.now[0][0] + 0.9 * jump, 0.0]])
        taken += one.check(goal) is FollowCode.SUCCESSFUL and one.start(goal) is FollowCode.ACTIVE
        one.advance()
    assert one._state.now[0][0] <= jump + BETWEEN * SPEEDS[0] * 1.0
    assert one._state.now[0][0] > 0.8 * SPEEDS[0]
    rows = np.outer(0.9 * jump * np.arange(1.0, 20.0), [1.0, 0.0])
    assert follower().check(FollowGoal(NAMES, 1e-3 * np.arange(1, 20), rows)) is FollowCode.INVALID_GOAL
    assert follower().check(FollowGoal(NAMES, 2e-2 * np.arange(1, 20), rows)) is FollowCode.SUCCESSFUL


def trapezoid(way: float, speed: float, acceleration: float, at: np.ndarray) -> np.ndarray:
    """Position, velocity and acceleration (3, N) of a move at its limits, as planners of the fastest move make it."""
    ramp = speed / acceleration
    total = way / speed + ramp
    t = np.clip(at, 0.0, total)
    rise, fall = np.minimum(t, ramp), np.maximum(t - (total - ramp), 0.0)
    v = np.minimum(acceleration * rise, speed) - acceleration * fall
    q = (
        speed * t
        - 0.5 * speed * ramp
        + 0.5 * acceleration * (ramp - rise) ** 2
        - 0.5 * acceleration * fall**2
    )
    a = np.where(t < ramp, acceleration, np.where(t > total - ramp, -acceleration, 0.0)) * (t < total)
    return np.array([q, v, a])


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("step", [0.01, 0.05, 0.1])
def test_moves_at_the_speed_limit_are_taken(order: int, step: float) -> None:
    """Sampled evenly, from any phase, as time parametrisations do: a corner of the speed lies between two samples. A
    quarter faster they are refused."""
    for faster in (1.0, 1.25):
        for acceleration in (8.0, 0.98 * SPEEDS[0] / step):
            for phase in np.linspace(0.0, 1.0, 7):
                total = 2.0 / (faster * SPEEDS[0]) + faster * SPEEDS[0] / acceleration
                at = np.append(np.arange(phase * step, total, step), total)
                at = at[np.append(np.diff(at) > 0.2 * step, True)]
                q, v, a = trapezoid(2.0, faster * SPEEDS[0], acceleration, at)
                v[-1] = a[-1] = 0.0
                rows = [np.column_stack([part, np.zeros(len(at))]) for part in (q - 1.0, v, a)][:order]
                goal = FollowGoal(NAMES, at + 1.0 - at[0], *rows)
                assert (follower().check(goal) is FollowCode.SUCCESSFUL) == (faster == 1.0)


@pytest.mark.parametrize(
    ("kind", "size", "taken"),
    [
        ("acceleration", 0.0, True), ("acceleration", 20.0, True), ("acceleration", 50.0, False),
        ("acceleration", 500.0, False), ("acceleration", 1e300, False), ("velocity", 1.0, True),
        ("velocity", 20.0, False), ("velocity", -20.0, False), ("velocity", 1e300, False),
    ],
)  # fmt: skip
def test_a_short_way_does_not_go_far(kind: str, size: float, taken: bool) -> None:
    """A tenth of a radian in 0.7 s; refused by `check`, or by `start` where it is the way from here."""
    row, one = [[size, 0.0]], follower()
    if kind == "acceleration":
        goal = FollowGoal(NAMES, [0.7], [[0.1, 0.0]], [STILL], row)
    else:
        goal = FollowGoal(NAMES, [0.7, 1.7], [[0.1, 0.0], [0.15, 0.0]], [*row, STILL])
    assert (one.check(goal) is one.start(goal) is FollowCode.INVALID_GOAL) == (
        kind == "velocity" and not taken
    )
    places = np.array([one.advance().position for _ in range(2500)])
    assert places[:, 0].max() < 0.4
    assert (places[-1, 0] > 0.09) == taken
