"""Measurements of which elements are missing: against the filter whose output has the others alone."""

from __future__ import annotations

import itertools
from functools import partial

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from tests.builders import (
    KALMAN_FORMS,
    SEEN,
    SEEN_MEAN,
    filters,
    seen_by_three,
    still,
    three_sensors,
    tracking_mass,
)
from tests.estimation import kalman
from tests.estimation.composing import composed
from tests.estimation.kalman import LinearCase
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.estimation import (
    ConstantGainFilter,
    ExtendedKalmanFilter,
    ModalFilter,
    OutputInjectionObserver,
    UnscentedKalmanFilter,
    linear_model,
    stationary_gain,
)

# Kernels that run once each: half of the time.
pytestmark = pytest.mark.usefixtures("unoptimised")


BOUNDED = {
    "bounded": partial(UnscentedKalmanFilter, bounds={"x0": (-0.4, 2.0)}),
    "bounded, rows": partial(UnscentedKalmanFilter, bounds={"x0": (-0.4, 2.0)}, form="square_root"),
}
EVERY = filters(**BOUNDED)


def masks(p):
    """Every choice of elements that are there, and some that are not."""
    return [np.array(mask) for mask in itertools.product([True, False], repeat=p) if 0 < sum(mask) < p]


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@KALMAN_FORMS
@pytest.mark.parametrize("scale", [1.0, 1e-4])
def test_on_a_linear_plant_it_is_the_kalman_filter_of_the_others(kind, scale):
    case = LinearCase(5, 1, 3, seed=7, scale=scale)
    filter = kind(**case.arguments())
    f, g = case.map(filter.stages, filter.sub_steps)
    step, u = composed(filter), np.array([0.3])
    for mask in masks(3):
        y = scale * case.rng.normal(size=3)
        c, r, there = case.c[mask], case.r[np.ix_(mask, mask)], np.where(mask, y, np.nan)
        mean, covariance = kalman.correct(case.mean, case.p0, c, y[mask], r)
        filter.reset()
        filter.correct(there)
        assert kalman.relative(filter.mean, filter.covariance, mean, covariance) < 1e-12
        density = multivariate_normal(c @ case.mean, c @ case.p0 @ c.T + r)
        assert filter.log_likelihood == pytest.approx(density.logpdf(y[mask]), rel=1e-10)
        expected = kalman.predict(mean, covariance, f, g, u, case.q)
        for gap in (np.nan, np.inf, -np.inf):  # in compiled code, whatever is not finite
            moved = step(filter.initial, np.where(mask, y, gap), u)
            assert kalman.relative(moved.mean, moved.covariance, *expected) < 1e-11


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@EVERY
def test_of_sensors_that_are_not_linear_it_is_the_filter_of_the_others(kind):
    rng, y = np.random.default_rng(0), np.array([0.15, 0.2, 0.1])
    filter = seen_by_three(kind)
    for mask in masks(3):
        places = np.flatnonzero(mask)
        fewer = seen_by_three(kind, tuple(places))
        filter.reset()
        for _ in range(4):
            y, u = y + 0.02 * rng.normal(size=3), rng.normal(size=1)
            filter.correct(np.where(mask, y, np.nan))
            fewer.correct(y[mask])
            assert filter.log_likelihood == pytest.approx(fewer.log_likelihood, rel=1e-9)
            filter.predict(u)
            fewer.predict(u)
            assert kalman.relative(filter.mean, filter.covariance, fewer.mean, fewer.covariance) < 1e-11


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@filters("ukf", "ukf, rows", "ekf", bounded=BOUNDED["bounded, rows"])
def test_composed_it_is_its_text_on_floats(kind):
    filter = seen_by_three(kind)
    step, belief, u = composed(filter), filter.initial, np.array([0.2])
    for mask in masks(3):
        y = np.where(mask, [0.15, 0.2, 0.1], np.nan)
        belief, filter._u = step(belief, y, u), u
        filter.correct(y)
        filter.predict(u)
        assert kalman.relative(belief.mean, belief.covariance, filter.mean, filter.covariance) < 1e-12


@pytest.mark.quick_cases(7)
@EVERY
@pytest.mark.parametrize("y", [None, [np.nan] * 3, [None] * 3, np.ma.masked_all(3)])
def test_where_nothing_is_measured_nothing_changes(kind, y):
    filter = seen_by_three(kind)
    filter.correct([0.1, np.nan, 0.2])
    mean, covariance = filter.mean, filter.covariance
    filter.correct(y)
    np.testing.assert_array_equal(filter.mean, mean)
    np.testing.assert_array_equal(filter.covariance, covariance)
    assert filter.log_likelihood == 0.0


@EVERY
def test_masked_elements_and_none_are_missing_too(kind):
    filter = seen_by_three(kind)
    found = []
    for y in (
        [0.1, np.nan, 0.2],
        (0.1, None, 0.2),
        np.ma.masked_array([0.1, 9.0, 0.2], [False, True, False]),
    ):
        filter.reset()
        filter.correct(y)
        found.append(filter.mean)
    np.testing.assert_array_equal(found[1:], found[:1] * 2)


@pytest.mark.quick_cases(14)
@EVERY
@pytest.mark.parametrize(
    "y", [[np.inf, 0.1, 0.1], [0.1, -np.inf, np.nan], [0.1, np.nan], np.nan, "none", [0.1, "x", 0.2]]
)
def test_what_is_no_measurement_is_refused_and_changes_nothing(kind, y):
    filter = seen_by_three(kind)
    with refused_with(InvalidInput, 3, "output_1", "NaN"):
        filter.correct(y)
    np.testing.assert_array_equal(filter.mean, SEEN_MEAN)


# Filters of another kind ----------------------------------------------------------------------------------
@pytest.mark.oracle
def test_a_constant_gain_has_the_column_of_a_missing_sensor_zero():
    ekf = seen_by_three(ExtendedKalmanFilter)
    plant = ekf.plant
    filter = ConstantGainFilter(
        ekf, stationary_gain(linear_model(ekf, np.zeros(3), np.zeros(1)), ekf.process_noise, SEEN)
    )
    y, p = np.array([0.15, 0.2, 0.1]), plant.parameters.vector()
    x = np.array(SEEN_MEAN)
    controller = fh.Controller(still(plant), filter, 0.05)
    for mask in masks(3):
        controller.reset()
        controller.step(np.where(mask, y, np.nan))
        gain = filter.initial.gain * mask
        expected = x + gain @ (y - np.asarray(plant.evaluate_output(x, controller.input_before(), p), float))
        np.testing.assert_allclose(controller.estimate, expected, rtol=1e-13)


@pytest.mark.ci("a controller of two links")
@pytest.mark.oracle
def test_the_filter_of_an_arm_has_the_column_of_a_missing_sensor_zero():
    robot = fh.load_robot("planar-two-link")
    plant = robot.plant(("link_position", "motor_position"))
    x, u = robot.operating_point(robot.home)[:2]
    filter = ModalFilter(ExtendedKalmanFilter(plant, 1e-3, 1e-8, 1e-8, x, 1e-4))
    controller = fh.Controller(still(plant), filter, 1e-3, before_first=u)
    expected = np.asarray(plant.evaluate_output(x, u, plant.parameters.vector()), float)
    y = expected + 1e-3 * np.arange(1.0, 5.0)
    for mask in masks(4):
        controller.reset(input=u)
        controller.step(np.where(mask, y, np.nan))
        moved = x + filter.gain(x) @ np.where(mask, y - expected, 0.0)
        np.testing.assert_allclose(controller.estimate, moved, rtol=1e-12, atol=1e-14)


@pytest.mark.oracle
def test_output_injection_bridges_what_is_missing_with_the_estimate():
    """ÿ of a pendulum whose angle and speed are measured: φ of the estimate, the column of L zero, and P by hand."""
    plant = fh.Plant(
        lambda x, u, d, p: np.array([x[1], -9.81 * np.sin(x[0]) + u[0]]),
        lambda x, u, p: x,
        ("angle", "speed"),
        ("u",),
    )
    r = np.array([[1e-4, 3e-5], [3e-5, 4e-4]])
    observer = OutputInjectionObserver(plant, 0.01, 1e-5, r, [0.3, -0.2], 0.01)
    y, gain = np.array([0.32, -0.1]), observer.gain
    for mask in ([True, False], [False, True]):
        observer.reset()
        observer.correct(np.where(mask, y, np.nan))
        used = gain * np.array(mask)
        np.testing.assert_allclose(observer.mean, [0.3, -0.2] + used @ (y - [0.3, -0.2]), rtol=1e-13)
        rest = np.eye(2) - used
        expected = rest @ (0.01 * np.eye(2)) @ rest.T + used @ r @ used.T
        np.testing.assert_allclose(observer.covariance, expected, rtol=1e-12)
        np.testing.assert_allclose(observer._belief.measured, np.where(mask, y, [0.3, -0.2]), rtol=1e-14)
        density = multivariate_normal(np.array([0.3, -0.2])[mask], (0.01 * np.eye(2) + r)[np.ix_(mask, mask)])
        assert observer.log_likelihood == pytest.approx(density.logpdf(y[mask]), rel=1e-12)


# In a controller ---------------------------------------------------------------------------------------
@pytest.mark.quick_cases(1)
@KALMAN_FORMS
@pytest.mark.parametrize("pieces", [False, True])
def test_a_sample_of_nan_is_one_without_a_measurement(kind, pieces):
    first, second = (tracking_mass(kind).in_pieces() if pieces else tracking_mass(kind) for _ in range(2))
    for k in range(20):
        none = k % 3 == 1 or k < 2
        y = [0.1 + 0.01 * k, 0.2]
        a, b = first.step(None if none else y, 0.5), second.step([np.nan, np.nan] if none else y, 0.5)
        np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(first.estimate, second.estimate)
        np.testing.assert_array_equal(first._history.memory, second._history.memory)
    assert not first._history.waiting


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@KALMAN_FORMS
@pytest.mark.parametrize("pieces", [False, True])
def test_a_controller_estimates_from_what_is_there(kind, pieces):
    """By the filter alone: the integral counts the estimate where the position is missing."""
    controller = tracking_mass(kind, latency=0)
    controller = controller.in_pieces() if pieces else controller
    filter = tracking_mass(kind).estimator
    u, last, integral = controller.input_before(), None, 0.0
    filter.predict(u)
    filter.reset()
    filter._u = u
    for k, gap in enumerate(["", "position", "rate", "both", "", "position"]):
        y = np.array([0.1 + 0.02 * k, 0.3])
        y[[gap in ("position", "both"), gap in ("rate", "both")]] = np.nan
        filter.correct(y)
        position = y[0] if np.isfinite(y[0]) else filter.mean[0]
        integral += 0.0 if last is None else 0.02 * (0.5 * (last + position) - 0.5)
        u = controller.step(y, 0.5)
        np.testing.assert_allclose(controller.estimate, filter.mean, rtol=1e-11)
        np.testing.assert_allclose(controller.integrals, [integral], rtol=1e-11, atol=1e-15)
        filter.predict(u)
        last = position


def test_what_is_infinite_is_missing_as_what_is_not_a_number():
    """As in the exported C; it was refused in Python alone."""
    first, second = tracking_mass(UnscentedKalmanFilter), tracking_mass(UnscentedKalmanFilter)
    for y in ([-np.inf, np.inf], [0.1, 0.0], [np.inf, 0.1], [np.nan, -np.inf], [0.1, np.inf], [0.1, 0.1]):
        gaps = np.where(np.isinf(y), np.nan, y)
        np.testing.assert_array_equal(first.step(y, 0.5), second.step(gaps, 0.5))
        np.testing.assert_array_equal(first.estimate, second.estimate)
    np.testing.assert_array_equal(first.step([-np.inf, np.inf], 0.5), second.step(None, 0.5))


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("gap", [[0], [1], [0, 1]])
def test_an_offset_is_taken_where_a_sensor_first_speaks(gap):
    """The sensor that is missing at the first sample has its offset from its first sample on: nothing moves."""
    controller = tracking_mass(ExtendedKalmanFilter, offset_time=1.0)
    controller.reset([0.1, 0.0])
    y = np.array([0.1 + 0.05, 0.1 * np.sin(0.1) - 0.02])
    first = y.copy()
    first[gap] = np.nan
    controller.step(first, 0.1)
    np.testing.assert_allclose(controller.estimate if len(gap) < 2 else [0.1, 0.0], [0.1, 0.0], atol=1e-12)
    controller.step(y, 0.1)
    known = controller.memory.named(controller._history.memory).offset_known
    np.testing.assert_array_equal(known, [1.0, 1.0])
    np.testing.assert_allclose(controller.estimate, [0.1, 0.0], atol=2e-3)


# In the loop -------------------------------------------------------------------------------------------
@pytest.mark.ci("compiles a loop of each filter")
@pytest.mark.quick_cases(1)
@EVERY
def test_a_loop_whose_sensors_give_nothing_at_times_is_that_of_its_steps(kind):
    """Sensors that see a part of the states' range only, written with `where`: they go, and come again."""
    plain = three_sensors()

    def seen(x, u, p):
        y = plain.output(x, u, p)
        return np.array(
            [fh.scalars.where(x[1] > 0.2, np.nan, y[0]), fh.scalars.where(x[0] > 0.55, np.nan, y[1]), y[2]]
        )

    plant = fh.Plant(plain.flow, seen, plain.states, ("u",), parameters={"scale": 1.3})
    controller = fh.Controller(still(plant), seen_by_three(kind), 0.05)
    run = fh.Loop(plant, controller).run(noise=1e-2, duration=8.0, initial_state=[0.3, 0.5, 0.0])
    missing = np.isnan(run.signals["output"])
    assert run.status == "completed"
    assert missing.sum(axis=0).tolist()[2] == 0
    assert np.all(missing.sum(axis=0)[:2] > 10)
    assert missing.sum(axis=1).max() == 2
    stepped = controller.fresh()
    for y, estimate in zip(run.signals["output"], run.signals["estimate"], strict=True):
        stepped.step(y)
        np.testing.assert_array_equal(stepped.estimate, estimate)
