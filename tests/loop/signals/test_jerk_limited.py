import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from flexhinf.errors import InvalidInput
from flexhinf.loop import JerkLimited

SLACK = 1.0 + 1e-9


def seven_phases(way, v, a, j):
    """Times of the corners where all limits are reached: jerk, constant acceleration, jerk, cruise, and back."""
    assert v >= a * a / j
    assert way >= v * (v / a + a / j)
    up, hold, cruise = a / j, v / a - a / j, way / v - v / a - a / j
    return np.cumsum([0.0, up, hold, up, cruise, up, hold, up])


def corner_states(way, v, a, j):
    """Position, velocity and acceleration at the corners, from the areas under the trapezes."""
    up, hold = a / j, v / a - a / j
    first, second = j * up**3 / 6, a * up**2 / 2 + a * up * hold / 2 + a * hold**2 / 2
    p1, p2 = first, first + (a * up / 2) * hold + a * hold**2 / 2
    p3 = v * v / (2 * a) + v * a / (2 * j)
    del second
    positions = [0.0, p1, p2, p3, way - p3, way - p2, way - p1, way]
    speeds = [0.0, a * up / 2, v - a * up / 2, v, v, v - a * up / 2, a * up / 2, 0.0]
    return np.array(positions), np.array(speeds), np.array([0, a, a, 0, 0, -a, -a, 0.0])


@pytest.mark.oracle
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_seven_phases_in_closed_form(sign):
    way, v, a, j = 4.0, 1.5, 2.0, 8.0
    move = JerkLimited(1.0, 1.0 + sign * way, v, a, j, at=0.5)
    corners = seven_phases(way, v, a, j)
    assert move.duration == pytest.approx(corners[-1], rel=1e-12)
    found = move.derivatives(0.5 + corners, 2)
    positions, speeds, pulls = corner_states(way, v, a, j)
    np.testing.assert_allclose(found[0], 1.0 + sign * positions, atol=1e-12)
    np.testing.assert_allclose(found[1], sign * speeds, atol=1e-12)
    np.testing.assert_allclose(found[2], sign * pulls, atol=1e-11)
    middles = 0.5 + 0.5 * (corners[1:] + corners[:-1])
    np.testing.assert_allclose(move.derivatives(middles, 3)[3], sign * j * np.array([1, 0, -1, 0, -1, 0, 1]))


@pytest.mark.oracle
def test_a_short_way_takes_the_time_of_four_jerks():
    """Neither velocity nor acceleration is reached: T = 4 (way / 2j)^⅓."""
    assert JerkLimited(0.0, 0.01, 10.0, 10.0, 5.0).duration == pytest.approx(
        4 * (0.01 / 10.0) ** (1 / 3), rel=1e-12
    )


limits = st.floats(0.05, 20.0)
ends = st.floats(-5.0, 5.0)


@pytest.mark.property
@settings(max_examples=60, deadline=None)
@given(
    way=st.lists(st.tuples(ends, ends), min_size=1, max_size=3),
    bounds=st.tuples(limits, limits, limits),
    smoothing=st.sampled_from([0.0, 0.03, 0.4]),
)
def test_limits_are_kept_and_the_ends_are_exact(way, bounds, smoothing):
    start, goal = (np.round(end, 6) for end in zip(*way))
    move = JerkLimited(start, goal, *bounds, at=1.0, smoothing=smoothing)
    t = 1.0 + np.linspace(-0.5, move.duration + 0.5, 2003)
    rows = move.derivatives(t, 4 if smoothing else 3)
    assert rows.shape == (5 if smoothing else 4, 2003, len(start))
    for row, bound in zip(rows[1:], bounds):
        assert np.abs(row).max() <= bound * SLACK
    np.testing.assert_array_equal(rows[0][t <= 1.0], np.broadcast_to(start, rows[0][t <= 1.0].shape))
    after = t >= 1.0 + move.duration
    np.testing.assert_array_equal(rows[0][after], np.broadcast_to(goal, rows[0][after].shape))
    np.testing.assert_array_equal(rows[1:, after], 0.0)
    if smoothing:
        assert np.abs(rows[4]).max() <= 2.0 * bounds[2] / smoothing * SLACK


def test_channels_arrive_together_and_alone_as_fast_as_alone():
    move = JerkLimited((0.0, 0.0), (1.0, -3.0), (1.0, 2.0), 4.0, 20.0)
    slow = JerkLimited(0.0, -3.0, 2.0, 4.0, 20.0)
    assert move.duration == pytest.approx(max(slow.duration, JerkLimited(0.0, 1.0, 1.0, 4.0, 20.0).duration))
    moving = np.linspace(0.0, move.duration, 1000)[1:-1]
    assert np.all(np.abs(move(moving) - [1.0, -3.0]) > 0.0)
    assert move(0.3).shape == (2,)
    assert move(moving).shape == (998, 2)


@pytest.mark.oracle
def test_derivatives_by_differences_and_the_average_by_quadrature():
    plain, smooth = (
        JerkLimited(0.3, 2.0, 1.0, 3.0, 30.0),
        JerkLimited(0.3, 2.0, 1.0, 3.0, 30.0, smoothing=0.07),
    )
    assert smooth.duration == pytest.approx(plain.duration + 0.07)
    for t in (0.05, 0.31, 1.2, 2.0):
        before = np.linspace(t - 0.07, t, 20001)
        averages = np.trapezoid(plain.derivatives(before, 2), before) / 0.07
        np.testing.assert_allclose(smooth.derivatives(t, 2), averages, atol=1e-9)
    h, t = 1e-5, np.linspace(0.012, smooth.duration - 0.01, 301)
    slopes = (smooth.derivatives(t + h) - smooth.derivatives(t - h)) / (2 * h)
    exact = smooth.derivatives(t)
    for k, tolerance in enumerate((1e-8, 1e-8, 1e-3)):
        np.testing.assert_allclose(slopes[k], exact[k + 1], atol=tolerance)
    jumps = np.abs(slopes[3] - exact[4]) > 1e-5 * np.abs(exact[4]).max()
    assert jumps.sum() <= 4  # near a corner of the jerk


@pytest.mark.parametrize(
    "bounds",
    [
        (
            97.04265271883386,
            23543.191116770482,
            11423468.597189462,
        ),  # ruckig alone finds none: "error in step 1"
        (1e6, 1e12, 1e18),
        (1e-6, 1e-12, 1e-18),
    ],
)
def test_motions_of_any_time_scale_are_found(bounds):
    way = JerkLimited(0.0, 1.0, *bounds)
    time = np.linspace(0.0, way.duration, 3001)
    largest = np.abs(way.derivatives(time, 3)).max(axis=1)
    assert way(0.0) == 0.0
    assert way(way.duration) == 1.0
    np.testing.assert_array_less(largest[1:], np.array(bounds) * (1.0 + 1e-9))
    assert np.max(largest[1:] / bounds) > 0.999


def test_a_way_of_nothing():
    still = JerkLimited(1.0, 1.0, 1.0, 1.0, 1.0, smoothing=0.1)
    np.testing.assert_array_equal(still.derivatives([-1.0, 0.0, 5.0])[0], 1.0)
    np.testing.assert_array_equal(still.derivatives([-1.0, 0.05, 5.0])[1:], 0.0)
    one = JerkLimited((0.0, 1.0), (1.0, 1.0), 1.0, 1.0, 1.0)
    np.testing.assert_array_equal(one(np.linspace(0.0, 5.0, 50))[:, 1], 1.0)


def test_without_smoothing_there_is_no_snap():
    move = JerkLimited(0.0, 1.0, 1.0, 1.0, 10.0)
    with pytest.raises(InvalidInput, match="order 4") as caught:
        move.derivatives(0.1)
    assert "smoothing" in caught.value.advice
    with pytest.raises(InvalidInput, match="order 5"):
        JerkLimited(0.0, 1.0, 1.0, 1.0, 10.0, smoothing=0.1).derivatives(0.1, 5)


def test_equal_motions_are_equal_and_named():
    assert JerkLimited([0, 0], [1, 2], 1, 1, 1) == JerkLimited(
        (0.0, 0.0), np.array([1.0, 2.0]), 1.0, 1.0, 1.0
    )
    assert hash(JerkLimited(0, 1, 1, 1, 1)) == hash(JerkLimited(0.0, 1.0, 1.0, 1.0, 1.0))
    assert "(1, 2)" in JerkLimited([0, 0], [1, 2], 1, 1, 1).name
    assert "smoothed" in JerkLimited(0, 1, 1, 1, 1, smoothing=0.1).name


@pytest.mark.parametrize(
    "arguments",
    [
        (0.0, 1.0, 0.0, 1.0, 1.0), (0.0, 1.0, 1.0, -1.0, 1.0), (0.0, 1.0, 1.0, 1.0, np.inf),
        (np.nan, 1.0, 1.0, 1.0, 1.0),
        ("a", 1.0, 1.0, 1.0, 1.0), ((0.0, 0.0), (1.0, 1.0, 1.0), 1.0, 1.0, 1.0), ((), (), 1.0, 1.0, 1.0),
        (0.0, 1.0, 1.0, 1.0, 1.0, 0.0, -0.1), (0.0, 1.0, 1.0, 1.0, 1.0, (0.0, 1.0)),
        (0.0, 1.0, 1.0, 1.0, 1.0, 0.0, np.nan),
    ],
)  # fmt: skip
def test_bad_motions_are_refused(arguments):
    with pytest.raises(InvalidInput) as caught:
        JerkLimited(*arguments)
    assert caught.value.advice
