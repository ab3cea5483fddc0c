"""Motions through waypoints: every point at its time, at rest where they stop, derivatives as differences."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from flexhinf.errors import InvalidInput
from flexhinf.loop import JerkLimited, Quintic, Spline, Waypoints

TIMES = np.array([0.0, 0.7, 1.6, 2.0])
VALUES = np.array([[0.0, 1.0], [0.5, 1.0], [0.2, -0.4], [0.3, 0.0]])


def motion(profile: str) -> Waypoints:
    return Waypoints(TIMES, VALUES, profile, smoothing=0.1 if profile == "jerk-limited" else 0.0)


@pytest.mark.parametrize("profile", ["spline", "through", "quintic", "jerk-limited"])
def test_every_waypoint_is_reached_at_its_time_from_rest_to_rest(profile: str) -> None:
    found = motion(profile)
    np.testing.assert_allclose(found(TIMES), VALUES, atol=1e-12)
    np.testing.assert_allclose(found(np.array([-1.0, 5.0])), VALUES[[0, -1]], atol=1e-12)
    stops = TIMES[[0, -1]] if profile in ("spline", "through") else TIMES
    np.testing.assert_allclose(found.derivatives(stops, 2)[1:], 0.0, atol=1e-8)
    assert found.duration == 2.0


@pytest.mark.parametrize("profile", ["spline", "through", "quintic", "jerk-limited"])
def test_derivatives_are_those_of_the_position(profile: str) -> None:
    found, step = motion(profile), 1e-4
    t = np.linspace(0.013, 1.987, 57)  # between the corners
    rows = found.derivatives(t, 4)
    for order in range(4):
        ahead, behind = (found.derivatives(t + side * step, order)[order] for side in (1, -1))
        differences, size = (ahead - behind) / (2.0 * step), np.abs(rows[order + 1]).max()
        assert np.quantile(np.abs(differences - rows[order + 1]), 0.9) < 1e-3 * size


def test_through_stays_between_neighbouring_waypoints() -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        times = np.cumsum(rng.uniform(0.05, 1.0, 12))
        values = rng.normal(size=(12, 2)) * rng.uniform(0.01, 10.0, (12, 1))
        found = Waypoints(times, values, "through")
        for k in range(11):
            low, high = np.sort(values[k : k + 2], axis=0)
            between = found(np.linspace(times[k], times[k + 1], 101))
            assert np.all(between >= low - 1e-9)
            assert np.all(between <= high + 1e-9)
    line = Waypoints([0.0, 1.0, 3.0, 4.0], [0.0, 1.0, 3.0, 4.0], "through")
    np.testing.assert_allclose(line(np.linspace(1.0, 3.0, 9)), np.linspace(1.0, 3.0, 9), atol=1e-12)


def test_through_has_four_continuous_derivatives() -> None:
    found = motion("through")
    for at in TIMES[1:-1]:
        before, after = found.derivatives(at - 1e-7), found.derivatives(at + 1e-7)
        np.testing.assert_allclose(before[:2], after[:2], atol=1e-5)
        np.testing.assert_allclose(
            before[2:], after[2:], atol=0.5 * np.abs(found.derivatives(at + 0.1)[2:]).max()
        )
        assert np.abs(found.derivatives(at)[2:]).max() < 1e-6
    with pytest.raises(InvalidInput, match="fifth"):
        found.derivatives(0.1, 5)


def test_two_waypoints_are_the_motions_of_one_way() -> None:
    t = np.linspace(-0.1, 1.2, 40)
    quintic = Waypoints([0.0, 1.0], [0.2, 0.9], "quintic")
    np.testing.assert_allclose(quintic.derivatives(t), Quintic(0.2, 0.9, 1.0).derivatives(t), atol=1e-12)
    spline = Waypoints([0.0, 1.0], [0.2, 0.9])
    np.testing.assert_array_equal(spline.derivatives(t), Spline([0.0, 1.0], [0.2, 0.9]).derivatives(t))
    limited = Waypoints([0.0, 1.0], [0.0, 1.0], "jerk-limited", smoothing=0.2)
    rate = 4.0 / 0.8
    one = JerkLimited(0.0, 1.0, 0.4 * rate, 0.4 * rate**2, 0.8 * rate**3, smoothing=0.2)
    assert one.duration == pytest.approx(1.0)
    np.testing.assert_allclose(limited.derivatives(t), one.derivatives(t), atol=1e-9)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([0.0, 1.0, 1.0], [0.0, 1.0, 2.0]), r"times \(3,\)"),
        (([0.0, 1.0], [0.0, np.nan]), r"times \(2,\)"),
        (([0.0, 1.0], [0.0, 1.0], "cubic"), r"'jerk-limited'.*'cubic'"),
        (([0.0, 1.0], [0.0, 1.0], "jerk-limited", 1.0), "smoothing"),
        ((np.arange(2000), np.arange(2000), "quintic"), r"waypoints[\s\S]* 1000, got 2000"),
    ],
)
def test_what_is_no_motion_is_refused(arguments: Any, message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        Waypoints(*arguments)
