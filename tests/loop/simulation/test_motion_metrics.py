"""Wrong way, excursion, distance from the path, remaining error and ripple, against closed forms and brute force."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from flexhinf.loop.simulation.metrics import (
    excursion,
    largest_travel,
    path_distance,
    remaining_error,
    ripple,
    wrong_way,
)

TIME = 1e-3 * np.arange(2001)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_zero_on_the_right_sends_a_step_the_wrong_way(sign: float) -> None:
    """(1 − 2s)/(1 + s)²: q = 1 − (1 + 3t) e^−t, lowest at t = 2/3 with 1 − 3 e^−2/3."""
    time = np.linspace(0.0, 20.0, 20001)
    q = sign * (1.0 - (1.0 + 3.0 * time) * np.exp(-time))
    found = wrong_way(q, sign * np.array([0.0, 1.0]), 0.5)
    assert found == pytest.approx(200.0 * (3.0 * np.exp(-2.0 / 3.0) - 1.0), rel=1e-6)
    assert wrong_way(q - 0.6 * sign, sign * np.array([-1.0, 0.0, -0.1]), 1.0) == pytest.approx(
        100.0 * (3.0 * np.exp(-2.0 / 3.0) - 1.0 - 0.4), rel=1e-6
    )  # of a command that turns round, its start is the end of the range that is nearer to its first value


def test_what_stays_on_its_way_or_goes_too_far_does_not_go_the_wrong_way() -> None:
    assert wrong_way(np.array([0.0, 1.2, 1.0]), np.array([0.0, 1.0]), 1.0) == 0.0
    assert wrong_way(np.array([1.0, -0.2, 0.0]), np.array([1.0, 0.0]), 1.0) == 0.0


def test_a_joint_that_should_rest_makes_an_excursion() -> None:
    assert excursion(0.3 + 0.02 * np.sin(TIME * 30.0), 0.3, 0.5) == pytest.approx(4.0, rel=1e-4)


def test_travels_of_joints_that_turn_and_slide_compare_by_their_ranges() -> None:
    travel, slides = np.array([0.5, 0.2, 0.01, 0.0]), np.array([False, False, True, True])
    span = np.array([5.0, 4.0, 0.2, np.inf])
    assert largest_travel(travel, slides, span) == pytest.approx([0.5, 0.5, 0.02, 0.01])
    assert largest_travel(travel[:2], slides[:2], span[:2]) == pytest.approx([0.5, 0.5])


@pytest.mark.oracle
def test_the_nearest_point_of_a_path_is_that_of_a_search_through_all_its_points() -> None:
    generator = np.random.default_rng(3)
    path, travel = np.cumsum(generator.normal(size=(6, 3)), axis=0), np.array([1.0, 0.1, 5.0])
    positions = path[generator.integers(0, 6, 40)] + 0.3 * generator.normal(size=(40, 3))
    dense = np.concatenate([a + np.linspace(0.0, 1.0, 20001)[:, None] * (b - a) for a, b in pairwise(path)])
    nearest = dense[np.argmin(cdist(positions / travel, dense / travel), axis=1)]
    expected = np.abs(positions - nearest).max(axis=0)
    assert path_distance(positions, path, travel) == pytest.approx(expected, rel=1e-3)


def test_a_straight_path_of_many_points_is_the_way_between_its_ends_and_one_that_turns_back_is_not() -> None:
    ends, travel = np.array([[0.2, 1.0], [1.0, -1.0]]), np.array([0.8, 2.0])
    shares = np.append(0.0, np.geomspace(1e-9, 1.0, 200))[:, None]
    positions = ends[0] + np.random.default_rng(2).normal(size=(30, 2))
    many = path_distance(positions, ends[0] + shares * (ends[1] - ends[0]), travel)
    assert many == pytest.approx(path_distance(positions, ends, travel), rel=1e-12)
    assert path_distance(np.array([[1.4]]), np.array([[0.0], [1.5], [1.0]]), np.ones(1)) == pytest.approx(
        [0.0]
    )


def test_a_late_joint_is_on_its_path_and_a_resting_path_is_a_point() -> None:
    late = np.linspace([0.0, 1.0], [1.0, -1.0], 50) ** np.array([[1.0, 1.0]])
    assert path_distance(late, np.array([[0.0, 1.0], [1.0, -1.0]]), np.ones(2)) == pytest.approx([0.0, 0.0])
    away = path_distance(np.array([[0.1, -0.2]]), np.zeros((2, 2)), np.ones(2))
    assert away == pytest.approx([0.1, 0.2])


def test_the_remaining_error_and_the_ripple_are_those_of_the_last_three_tenths_of_a_second() -> None:
    """An error e^−t, and an input a sin(ωt) of whole periods, whose standard deviation is a/√2."""
    errors = np.exp(-TIME)[:, None] * [1.0, -2.0]
    found = remaining_error(TIME, 0.5 + errors, np.full(2, 0.5))
    assert found == pytest.approx(np.exp(-1.701) * np.array([1.0, 2.0]), rel=1e-9)
    wave = np.sin(2.0 * np.pi * 10.0 * TIME)[:, None] * [3.0, 0.5] + [40.0, -2.0]
    wave[TIME <= 1.7] = 1e3
    assert ripple(TIME, wave, np.array([100.0, 10.0])) == pytest.approx(
        100.0 * np.array([0.03, 0.05]) / np.sqrt(2.0), rel=1e-9
    )
    assert ripple(TIME, wave, np.full(2, np.inf)) == pytest.approx([0.0, 0.0])
