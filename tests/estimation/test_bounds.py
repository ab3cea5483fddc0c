"""Means within bounds: against the quadratic program that SciPy solves."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from scipy.optimize import lsq_linear
from tests.builders import FORMS, filters, seen_by_three, still
from tests.estimation import kalman
from tests.estimation.composing import composed
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.estimation import ExtendedKalmanFilter, UnscentedKalmanFilter
from flexhinf.estimation.bounds import projected

# Kernels that run once each: 1 s instead of 2 s.
pytestmark = pytest.mark.usefixtures("unoptimised")


def nearest(mean, covariance, places, ends):
    """min (x − m)ᵀ P⁻¹ (x − m) within the intervals."""
    low, high = (np.full(len(mean), end) for end in (-np.inf, np.inf))
    low[places], high[places] = np.array(ends).T
    white = np.linalg.inv(np.linalg.cholesky(covariance))
    return lsq_linear(white, white @ mean, (low, high), method="bvls", tol=1e-14).x


def distance(x, mean, covariance):
    return (x - mean) @ np.linalg.solve(covariance, x - mean)


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.parametrize("bounded", [1, 2, 4])
def test_it_is_the_most_likely_point_within(bounded):
    """Of one bound always, of several mostly; never outside, nor much less likely."""
    rng, exact = np.random.default_rng(bounded), 0
    for _ in range(300):
        root = rng.normal(size=(5, 5))
        covariance, mean = root @ root.T + 0.01 * np.eye(5), 2.0 * rng.normal(size=5)
        places = list(rng.permutation(5)[:bounded])
        ends = [tuple(np.sort(rng.normal(size=2))) for _ in places]
        found = projected(places, ends, mean, covariance[:, places])
        best = nearest(mean, covariance, places, ends)
        for place, (low, high) in zip(places, ends, strict=True):
            assert low <= found[place] <= high
        assert distance(found, mean, covariance) >= distance(best, mean, covariance) * (1.0 - 1e-9) - 1e-20
        exact += np.allclose(found, best, atol=1e-7 * np.abs(mean).max())
    assert exact >= (270 if bounded == 4 else 300), exact


def test_a_mean_within_is_not_touched_and_one_known_exactly_is_put_to_the_bound():
    columns = np.array([[1.0, 0.5], [0.3, 0.2], [0.5, 2.0]])
    mean = np.array([0.1, -7.0, 0.9])
    np.testing.assert_array_equal(projected([0, 2], [(0.0, 1.0)] * 2, mean, columns), mean)
    moved = projected([0, 2], [(0.2, 1.0)] * 2, mean, np.zeros((3, 2)))
    np.testing.assert_array_equal(moved, [0.2, -7.0, 0.9])


def decaying(x, u, d, p):
    """A position whose spring is a state, unknown and positive."""
    return np.array([x[1], u[0] - x[2] * x[0] - p.damping * x[1], 0.0 * x[0]])


def spring():
    return fh.Plant(
        decaying, lambda x, u, p: x[:1], ("position", "speed", "stiffness"), ("force",), parameters={"damping": 0.4}
    )  # fmt: skip


ARGUMENTS = (spring(), 0.05, [1e-8, 1e-6, 1e-3], 1e-4, [0.5, 0.0, 1.0], [0.01, 0.04, 4.0])
BOUNDS = {"stiffness": (0.8, 3.0), "speed": (-0.3, 0.3)}


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@FORMS
def test_every_update_ends_with_the_projection_of_the_plain_one(form):
    """Each update of the bounded filter is the plain one from the same belief, then projected; P is the plain one's."""
    bounded, plain = (ExtendedKalmanFilter(*ARGUMENTS, form=form, bounds=b) for b in (BOUNDS, None))
    rng, places, met = np.random.default_rng(2), [1, 2], 0
    for k in range(60):
        for update, value in (
            ("correct", [0.5 * np.cos(0.06 * k) + 0.02 * rng.normal()]),
            ("predict", [0.3]),
        ):
            plain._belief, plain._u = bounded._belief, bounded._u
            getattr(plain, update)(value)
            getattr(bounded, update)(value)
            ends = [BOUNDS["speed"], BOUNDS["stiffness"]]
            expected = projected(places, ends, plain.mean, plain.covariance[:, places])
            np.testing.assert_allclose(bounded.mean, expected, rtol=1e-12, atol=1e-14)
            np.testing.assert_array_equal(bounded.covariance, plain.covariance)
            met += not np.array_equal(expected, plain.mean)
            assert all(low <= x <= high for x, (low, high) in zip(bounded.mean[places], ends, strict=True))
    assert met > 10


@pytest.mark.ci("compiles a loop")
@pytest.mark.oracle
@FORMS
def test_compiled_it_is_its_text_and_a_loop_and_a_file_keep_it(form, tmp_path):
    filter = ExtendedKalmanFilter(*ARGUMENTS, form=form, bounds=BOUNDS)
    step, belief = composed(filter), filter.initial
    for k in range(30):
        y, u = np.array([0.5 * np.cos(0.1 * k)]), np.array([0.1])
        belief, filter._u = step(belief, y, u), u
        filter.correct(y)
        filter.predict(u)
        assert kalman.relative(belief.mean, belief.covariance, filter.mean, filter.covariance) < 1e-10
    controller = fh.Controller(
        still(spring()), ExtendedKalmanFilter(*ARGUMENTS, form=form, bounds=BOUNDS), 0.05
    )
    controller.save(tmp_path / "one")
    run = fh.Loop(spring(), controller).run(noise=0.02, duration=4.0, initial_state=[0.5, 0.0, 0.5])
    estimate = run.signals["estimate"]
    assert estimate[:, 2].min() == 0.8
    assert np.abs(estimate[:, 1]).max() <= 0.3
    for stepped in (pickle.loads(pickle.dumps(controller)), fh.load_controller(tmp_path / "one")):
        for y, expected in zip(run.signals["output"], estimate, strict=True):
            stepped.step(y)
            np.testing.assert_array_equal(stepped.estimate, expected)


@filters()
def test_without_bounds_that_are_met_nothing_changes(kind):
    wide = {"x0": (-9.0, 9.0), "x2": (-9.0, 9.0)}
    plain, bounded = (seen_by_three(kind, bounds=bounds) for bounds in (None, wide))
    for y in ([0.15, 0.2, 0.1], [0.1, np.nan, 0.1]):
        for filter in (plain, bounded):
            filter.correct(y)
            filter.predict([0.1])
        np.testing.assert_array_equal(bounded.mean, plain.mean)
        np.testing.assert_array_equal(bounded.covariance, plain.covariance)


@pytest.mark.parametrize("kind", [ExtendedKalmanFilter, UnscentedKalmanFilter])
@pytest.mark.parametrize(
    ("bounds", "named"),
    [
        ({"x0": (1.0, 0.5)}, ("x0",)), ({"x0": (0.0, np.nan)}, ("x0",)), ({"x0": "wide"}, ("x0",)),
        ({"x9": (0.0, 1.0)}, ("x9",)), ({"x0": (0.5, 1.0)}, ("x0", 0.5, 0.3)), ([("x0", 0.0, 1.0)], ("bounds",)),
        ({"x0": (0.0, 1.0, 2.0)}, ("x0", 2.0)), ({"x0": 3.0}, ("x0", 3.0)),
    ],
)  # fmt: skip
def test_what_is_no_interval_about_the_mean_is_refused(kind, bounds, named):
    with refused_with(InvalidInput, *named):
        seen_by_three(kind, bounds=bounds)
