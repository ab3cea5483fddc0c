"""What `identify` says where its model is wrong: intervals that are wide enough by chance alone, and a mark."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import toeplitz
from tests.identification.test_likelihood import sought
from tests.logs import PERIOD, linear_log, oscillator

import flexhinf as fh
from flexhinf.identification.information import lag_counts, long_run

#: Correlation of neighbouring errors of the measurement, which a Kalman filter takes to be white; and samples.
CORRELATION, COUNT = 0.9, 2000


def gain_log(seed, correlation=CORRELATION):
    """A gain of 1.5 from the last input to the output, with errors of size 0.1, correlated as those of AR(1)."""
    rng = np.random.default_rng(seed)
    errors = 0.1 * rng.normal(size=COUNT)
    for k in range(1, COUNT):
        errors[k] = correlation * errors[k - 1] + np.sqrt(1.0 - correlation**2) * errors[k]
    times = PERIOD * np.arange(COUNT)
    u = 1.0 + np.sin(1.3 * times)
    return times, u[:, None], (1.5 * np.append(0.0, u[:-1]) + errors)[:, None]


def gain_found(log):
    """The gain by a filter that knows the size of the errors, and takes them for white: least squares."""
    plant = fh.Plant(
        lambda x, u, d, p: np.array([p.gain * u[0]]), lambda x, u, p: x[:1], ("level",), ("drive",),
        parameters={"gain": 1.0}, sampled=True,
    )  # fmt: skip
    filter = fh.ExtendedKalmanFilter(plant, PERIOD, 1e-12, 0.01, [0.0], 1e-12)
    return fh.identify(plant, log, ("gain",), filter=filter, noise=False)


@pytest.mark.oracle
@pytest.mark.ci("identifies 21 logs, each with its signals at other times")
def test_the_standard_error_is_that_of_correlated_errors():
    """Least squares with errors of a known correlation has a variance in closed form."""
    log = gain_log(0)
    u = log[1][:-1, 0]
    correlations = 0.01 * CORRELATION ** np.arange(COUNT - 1)
    true = np.sqrt(u @ toeplitz(correlations) @ u) / (u @ u)
    errors = [gain_found(gain_log(seed)).standard_errors["gain"] for seed in range(20)]
    assert np.mean(errors) == pytest.approx(true, rel=0.2)
    white = gain_found(gain_log(0, 0.0))
    assert white.consistent
    assert white.standard_errors["gain"] == pytest.approx(0.1 / np.sqrt(u @ u), rel=0.1)


@pytest.mark.ci("identifies 40 logs, each with its signals at other times")
def test_intervals_hold_the_truth_though_errors_are_correlated():
    inside = []
    for seed in range(40):
        found = gain_found(gain_log(seed))
        assert not found.consistent
        low, high = found.intervals["gain"]
        inside.append(low <= 1.5 <= high)
    assert np.mean(inside) >= 0.8


@pytest.mark.oracle
def test_the_spread_of_sums_is_that_of_their_weights():
    scores = np.random.default_rng(0).normal(size=(50, 2)).cumsum(axis=0)
    lags = 7
    weights = np.maximum(0.0, 1.0 - np.abs(np.subtract.outer(np.arange(50), np.arange(50))) / (lags + 1.0))
    np.testing.assert_allclose(long_run(scores, lags), scores.T @ weights @ scores)
    assert lag_counts(2500, True) == lag_counts(2500, False)[:1]
    assert lag_counts(10, False)[-1] <= lag_counts(2500, False)[-1] <= 250


def test_innovations_are_those_of_the_filter_over_the_log():
    log = linear_log(3)
    likelihood, unknowns = sought(log)
    evaluation = likelihood.evaluate(*unknowns.model(unknowns.start))
    assert evaluation is not None
    (_, q, r), _ = unknowns.model(unknowns.start)
    filter = fh.ExtendedKalmanFilter(oscillator(), PERIOD, q * PERIOD, r, [0.0, 0.0], 1.0)
    data = fh.filter_log(filter, log)
    np.testing.assert_allclose(evaluation.innovations, data["innovation"].values, atol=1e-9)
    np.testing.assert_allclose(evaluation.deviations, data["innovation_standard_deviation"].values, rtol=1e-6)
    np.testing.assert_allclose(evaluation.squared, data["nis"].values, rtol=1e-5, atol=1e-9)


def dry_log(arm, level=1.0, noise=1e-5):
    """A log of the paper's arm with dry friction of so many N·m."""
    dry = arm.with_parameters(fh.Parameter("coulomb_friction", level))
    plant = dry.plant(("link_position", "motor_position"), extras=("coulomb_friction",))
    times = 1e-3 * np.arange(2000)
    volts = 8.0 * np.sin(3.0 * times) + 5.0 * np.sin(11.0 * times) + 3.0 * np.sin(23.0 * times)
    run = plant_run(plant, times, volts)
    return times, volts[:, None], run + noise * np.random.default_rng(0).normal(size=run.shape)


def plant_run(plant, times, volts):
    """Outputs (N, p) from rest by SciPy."""
    p, still = plant.parameters.vector(), np.zeros(len(plant.disturbances))
    x, rows = np.zeros(plant.n), []
    for u in volts:
        rows.append(plant.evaluate_output(x, np.array([u]), p))
        x = solve_ivp(
            lambda t, x, u=u: plant.evaluate_flow(x, np.array([u]), still, p), (0.0, times[1]), x, method="RK45",
            rtol=1e-6, atol=1e-9,
        ).y[:, -1]  # fmt: skip
    return np.array(rows)


@pytest.mark.ci("simulates dry friction by SciPy, and identifies twice")
def test_a_model_that_lacks_dry_friction_is_said_not_to_fit(tmp_path):
    """Viscous friction explains dry friction badly; a model with dry friction finds both."""
    arm = fh.load_robot("paper")
    log = dry_log(arm)
    for extras in ((), ("coulomb_friction",)):
        robot = arm.with_parameters(fh.Parameter("coulomb_friction", 1.0))
        found = fh.identify(
            robot, log, ("friction",), measured=("link_position", "motor_position"), extras=extras
        )
        low, high = found.intervals["friction"]
        assert found.consistent == bool(extras)
        assert (low < 0.1 < high) == bool(extras)
        marked = [name for name in found.summary() if "not fit" in name]
        assert bool(marked) != bool(extras)
        assert ("not fit" in found.robot["friction"].source) != bool(extras)
