"""The likelihood of a log against NumPy's Kalman filter; gradient and information by differences and by scores."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from tests.logs import PERIOD, TRUE, linear_log, oscillator

import flexhinf as fh
from flexhinf.estimation import ExtendedKalmanFilter
from flexhinf.identification.defaults import default_filter, measurement_variances
from flexhinf.identification.likelihood import Likelihood
from flexhinf.identification.recursion import rows_of
from flexhinf.identification.unknowns import Noises, Unknowns, plant_numbers


def sought(log, names=("stiffness", "damping", "gain"), plant=None):
    plant = plant or oscillator()
    filter = fh.ExtendedKalmanFilter(plant, PERIOD, 1e-8, 1e-4, [0.0, 0.0], 1.0, form="covariance")
    unknowns = Unknowns(plant, None, plant_numbers(plant, names), Noises.of(filter, np.array([0.1]), True))
    return Likelihood(filter, rows_of(*log, PERIOD), len(unknowns.names)), unknowns


def plain_likelihood(log, stiffness, damping, gain, noise, level):
    drift = np.array([[0.0, 1.0], [-stiffness, -damping]])
    whole = expm(PERIOD * np.block([[drift, np.array([[0.0], [gain]])], [np.zeros((1, 3))]]))
    x, p, total = np.zeros(2), np.eye(2), 0.0
    for u, y in zip(log[1][:, 0], log[2][:, 0]):
        spread, e = p[0, 0] + noise**2, y - x[0]
        total -= 0.5 * (e * e / spread + np.log(2.0 * np.pi * spread))
        gains = p[:, 0] / spread
        x, p = x + gains * e, p - np.outer(gains, p[0])
        x = whole[:2, :2] @ x + whole[:2, 2] * u
        p = whole[:2, :2] @ p @ whole[:2, :2].T + np.diag([0.0, level**2 * PERIOD])
    return total


@pytest.mark.oracle
def test_of_a_linear_plant_it_is_that_of_the_kalman_filter():
    log = linear_log(1)
    likelihood, unknowns = sought(log)
    found = likelihood.evaluate(*unknowns.model(unknowns.start))
    assert found.value == pytest.approx(plain_likelihood(log, *TRUE.values(), 0.01, 0.1), rel=1e-7)


def test_the_gradient_is_that_of_differences():
    likelihood, unknowns = sought(linear_log(2), plant=oscillator(stiffness=36.0))
    z = unknowns.start + 0.1
    found = likelihood.evaluate(*unknowns.model(z))
    for k in range(len(z)):
        step = 1e-5 * np.eye(len(z))[k]
        ends = [likelihood.evaluate(*unknowns.model(z + sign * step)).value for sign in (-1.0, 1.0)]
        assert found.gradient[k] == pytest.approx((ends[1] - ends[0]) / 2e-5, rel=1e-4, abs=1e-3)
    np.testing.assert_allclose(found.scores.sum(axis=0), found.gradient, rtol=1e-12)


def test_unknowns_at_a_bound_are_free_where_the_gradient_points_inside():
    """Those that a small step along the gradient moves, and those without a slope."""
    _, found = sought(linear_log(1, count=10))
    numbers = [replace(found.numbers[0], sign="not negative"), *found.numbers[1:]]
    noises = replace(found.noises, least=np.array([0.01]))
    unknowns = Unknowns(found.plant, None, numbers, noises, bounded=True)
    rng = np.random.default_rng(0)
    for bound in (unknowns.lowest, unknowns.highest):
        z = np.where(np.isfinite(bound), bound, unknowns.start)
        assert 0 < np.isfinite(bound).sum() < len(z)
        for _ in range(50):
            gradient = rng.choice([-10.0, -0.1, 0.0, 0.1, 10.0], len(z))
            moved = (unknowns.inside(z + 1e-6 * gradient) != z) | (gradient == 0.0)
            assert np.array_equal(unknowns.free(z, gradient), np.flatnonzero(moved))


def test_the_likelihood_is_that_of_the_filtered_log():
    robot = fh.load_robot("paper")
    plant = robot.plant(("link_position", "motor_position"))
    rng = np.random.default_rng(5)
    log = 1e-3 * np.arange(200), rng.normal(size=(200, 1)), 1e-3 * rng.normal(size=(200, 2))
    log[2][::3, 1] = np.nan
    filter = default_filter(plant, *log, ExtendedKalmanFilter, form="covariance")
    unknowns = Unknowns(plant, None, plant_numbers(plant, ["stiffness"]), Noises.of(filter, None, False))
    likelihood = Likelihood(filter, rows_of(*log, filter.period), 1)
    value = likelihood.evaluate(*unknowns.model(unknowns.start)).value
    assert value == pytest.approx(fh.filter_log(filter, log).attrs["log_likelihood"], rel=1e-9)


@pytest.mark.ci("the likelihood of 400 logs")
def test_information_is_the_covariance_of_the_scores():
    scores, informations = [], []
    for seed in range(400):
        likelihood, unknowns = sought(linear_log(seed, count=150))
        found = likelihood.evaluate(*unknowns.model(unknowns.start))
        scores.append(found.gradient)
        informations.append(found.information)
    information, scores = np.mean(informations, axis=0), np.array(scores)
    size = np.sqrt(np.diag(information))
    found = np.cov(scores.T) / size / size[:, None]
    np.testing.assert_allclose(found, information / size / size[:, None], atol=0.3)
    assert np.abs(scores.mean(axis=0) / size * np.sqrt(len(scores))).max() < 4.0


@pytest.mark.parametrize("missing", [0.0, 0.2, 0.5, 0.7])
def test_missing_values_are_no_noise(missing):
    """Values that lie apart are no neighbours: the noise stays 1e-4 rad though the signal moves far."""
    rng, times = np.random.default_rng(0), 1e-3 * np.arange(4000)
    values = np.sin(3.0 * times) + 0.2 * np.sin(23.0 * times) + 1e-4 * rng.normal(size=len(times))
    values[rng.random(len(times)) < missing] = np.nan
    assert np.sqrt(measurement_variances(values[:, None])) == pytest.approx(1e-4, rel=0.3)
