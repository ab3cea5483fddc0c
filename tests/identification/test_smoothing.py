"""The smoother: a batch least-squares problem of the whole log, covariances too; nonlinear arms; what is refused."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest
from tests.logs import PERIOD, undisturbed
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.identification.smoothing import solved_rows

# A filter for each test, compiled for one short log: compiled in half the time.
pytestmark = pytest.mark.usefixtures("unoptimised")


def batch(filter, times, u, y, mean, start, q, r):
    """The most likely states (N, n) of the whole log and their covariances (N, n, n), by the normal equations.

    Of a linear plant, whose map over each step comes from the filter's own Runge-Kutta steps on unit vectors.
    """
    n, p = len(mean), y.shape[1]
    count, steps = len(times), np.diff(times)
    c = np.array([[float(filter.plant.output(e, [0.0], None)[i]) for e in np.eye(n)] for i in range(p)])
    information, vector = np.zeros((count * n, count * n)), np.zeros(count * n)

    def add(place, matrix, target, weight):
        """Adds ‖matrix x − target‖² with a weight matrix, x from `place` on."""
        rows = slice(place, place + matrix.shape[1])
        information[rows, rows] += matrix.T @ weight @ matrix
        vector[rows] += matrix.T @ weight @ target

    add(0, np.eye(n), mean, np.linalg.inv(start))
    for k in range(count):
        some = np.isfinite(y[k])
        add(k * n, c[some], y[k, some], np.linalg.inv(r[np.ix_(some, some)]))
        if k + 1 < count:
            drift, drive = stepped(filter, steps[k])
            add(
                k * n,
                np.hstack([-drift, np.eye(n)]),
                drive @ u[k],
                np.linalg.inv(q * steps[k] / filter.period),
            )
    covariance = np.linalg.inv(information)
    blocks = np.array([covariance[k * n : k * n + n, k * n : k * n + n] for k in range(count)])
    return np.linalg.solve(information, vector).reshape(count, n), blocks


def stepped(filter, seconds):
    """A and B of one prediction: a Runge-Kutta step is a polynomial of the drift."""
    a, b = np.array([[0.0, 1.0], [-40.0, -0.3]]), np.array([[0.0], [1.0]])
    h, order = seconds / filter.sub_steps, filter.stages
    assert order == 4
    whole = np.block([[a, b], [np.zeros((1, 3))]]) * h
    step = sum(np.linalg.matrix_power(whole, k) / math.factorial(k) for k in range(5))
    total = np.linalg.matrix_power(step, filter.sub_steps)
    return total[:2, :2], total[:2, 2:]


@pytest.mark.quick_cases(3)
@pytest.mark.oracle
@pytest.mark.parametrize("form", ["covariance", "square_root"])
@pytest.mark.parametrize("kind", [fh.ExtendedKalmanFilter, fh.UnscentedKalmanFilter])
@pytest.mark.parametrize("measured", [("position",), ("position", "velocity")])
def test_a_linear_log_is_smoothed_as_by_least_squares(kind, form, measured):
    rng = np.random.default_rng(5)
    times = np.concatenate([[0.0], np.cumsum(PERIOD * rng.uniform(0.6, 1.0, 60))])
    u, y = rng.normal(size=(61, 1)), 0.1 * rng.normal(size=(61, len(measured)))
    y[::5, 0] = np.nan
    q = np.array([[2e-4, 1e-4], [1e-4, 3e-3]])
    r, mean, start = 1e-3 * np.eye(len(measured)), np.array([0.1, -0.2]), np.diag([0.5, 2.0])
    filter = kind(undisturbed(measured), PERIOD, q, r, mean, start, form=form)
    data = fh.filter_log(filter, (times, u, y), smooth=True)
    states, covariances = batch(filter, times, u, y, mean, start, q, r)
    np.testing.assert_allclose(data.smoothed.values, states, rtol=1e-9, atol=1e-10)
    deviations = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    np.testing.assert_allclose(data.smoothed_standard_deviation.values, deviations, rtol=1e-8)
    np.testing.assert_allclose(data.smoothed.values[-1], data.estimate.values[-1], rtol=1e-12)
    plain = fh.filter_log(filter, (times, u, y))
    assert "smoothed" not in plain
    np.testing.assert_array_equal(plain.estimate.values, data.estimate.values)


@pytest.mark.oracle
def test_a_gap_is_gone_back_over():
    """Rows in a gap measure nothing: as a log with these rows, all of whose values are missing."""
    rng = np.random.default_rng(6)
    times = PERIOD * np.arange(50)
    u, y = rng.normal(size=(50, 1)), 0.1 * rng.normal(size=(50, 1))
    u[20:30] = u[20]
    y[21:30] = np.nan
    kept = np.r_[0:21, 30:50]
    filter = fh.UnscentedKalmanFilter(undisturbed(), PERIOD, 1e-4, 1e-3, [0.1, 0.0], 1.0, form="square_root")
    whole = fh.filter_log(filter, (times, u, y), smooth=True)
    short = fh.filter_log(filter, (times[kept], u[kept], y[kept]), smooth=True)
    for name in ("smoothed", "smoothed_standard_deviation"):
        np.testing.assert_allclose(short[name].values, whole[name].values[kept], rtol=1e-8, atol=1e-11)


@pytest.mark.ci("smooths logs of every filter")
@pytest.mark.parametrize("form", ["covariance", "square_root"])
@pytest.mark.parametrize("kind", [fh.ExtendedKalmanFilter, fh.UnscentedKalmanFilter])
def test_smoothed_states_of_an_arm_are_nearer_to_the_truth(kind, form):
    """Between 1.5 and 10 times, and as near as they say: the error of link velocities from an encoder of the motor."""
    arm = fh.paper_arm()
    plant = arm.plant("motor_position")
    ukf = fh.UnscentedKalmanFilter(plant, 1e-3, [0, 0, 1e-7, 1e-7], 1e-8, np.zeros(4), 1e-6)
    law = fh.linear_law(arm.problem(), gamma=math.inf)
    run = fh.Loop(plant, fh.Controller(law, ukf, 1e-3)).run(
        fh.Sine(0.3, 1.0), duration=1.0, noise=1e-3, seed=2
    )
    log = fh.Log(run.time[1:], run.signals["input"][:-1], run.signals["output"][1:], run.signals["state"][1:])
    filter = kind(plant, 1e-3, np.diag([0, 1e-10, 0, 1e-10]), 1e-6, np.zeros(4), 1e-4, form=form)
    data = fh.filter_log(filter, log, smooth=True)
    middle = slice(200, 800)
    before = np.sqrt(np.mean((data.estimate.values - log.truth)[middle] ** 2, axis=0))
    after = (data.smoothed.values - log.truth)[middle]
    assert (np.sqrt(np.mean(after**2, axis=0)) < before / 1.2).all()
    spread = data.smoothed_standard_deviation.values[middle]
    assert (spread < data.standard_deviation.values[middle]).all()
    assert np.sqrt(np.mean((after / spread) ** 2)) < 1.5


def test_what_the_next_state_determines():
    """A state without any noise, known from the start: the rows are singular, and nothing becomes infinite."""
    plant = fh.Plant(
        lambda x, u, d, p: np.array([u[0], 0.0 * x[0]]), lambda x, u, p: x[:1], ("x", "constant"), ("u",),
        outputs=("x",),
    )  # fmt: skip
    filter = fh.ExtendedKalmanFilter(
        plant, PERIOD, np.diag([1e-4, 0.0]), 1e-2, [0.0, 3.0], np.diag([1.0, 0.0]), form="square_root"
    )
    rng = np.random.default_rng(7)
    data = fh.filter_log(filter, (PERIOD * np.arange(40), np.zeros(40), rng.normal(size=40)), smooth=True)
    np.testing.assert_array_equal(data.smoothed.values[:, 1], 3.0)
    np.testing.assert_allclose(data.smoothed_standard_deviation.values[:, 1], 0.0, atol=1e-12)
    assert np.isfinite(data.smoothed.values).all()
    triangles = np.array([[[2.0, 1.0], [0.0, 0.0]], [[2.0, 1.0], [0.0, 4.0]]])
    right = np.array([[[2.0], [0.0]], [[2.0], [4.0]]])
    solved, remainder = solved_rows(triangles, right)
    np.testing.assert_allclose(triangles @ solved, right, atol=1e-14)
    np.testing.assert_allclose(remainder, 0.0, atol=1e-14)


def test_filters_that_have_no_smoother():
    log = (PERIOD * np.arange(5), np.zeros(5), np.zeros(5))
    for options in ({"redraw": False}, {"alpha": 1e-3, "beta": 0.0}):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            filter = fh.UnscentedKalmanFilter(
                undisturbed(), PERIOD, 1e-4, 1e-3, [0.0, 0.0], 1.0, **options, form="covariance"
            )
        with refused_with(fh.InvalidInput, "smoother", "redraw"):
            fh.filter_log(filter, log, smooth=True)


@pytest.mark.oracle
@pytest.mark.parametrize(
    ("a", "c", "q", "start"),
    [
        ([[1, 0, 0], [0, 1, 0.1], [0, 0, 1]], [[1, 1, 0]], np.diag([0, 1e-3, 1e-2]), np.diag([0.0, 1, 1])),
        ([[1.5, -0.7], [1, 0]], [[1, 0]], np.diag([0.1, 0]), np.eye(2)),
        ([[0.9, 0], [0, 0.9]], [[1, 0]], 0.1 * np.ones((2, 2)), np.ones((2, 2))),
    ],
    ids=["a state that is known", "a position that repeats another", "two equal copies"],
)
def test_spreads_where_the_predicted_covariance_is_singular(a, c, q, start):
    """As conditioning the Gaussian of all samples at once."""
    a, c = np.array(a, dtype=float), np.array(c, dtype=float)
    n, count, r = len(a), 25, 0.01
    y = np.random.default_rng(3).normal(size=(count, 1))
    plant = fh.Plant(
        lambda x, u, d, p: a @ x,
        lambda x, u, p: c @ x,
        tuple("xyz"[:n]),
        (),
        outputs=("measured",),
        sampled=True,
    )
    filter = fh.ExtendedKalmanFilter(plant, PERIOD, q, r, np.zeros(n), start)
    log = fh.Log(PERIOD * np.arange(count), None, y)
    data = fh.filter_log(filter, log, smooth=True)
    powers = [np.eye(n, n * (count + 1))]  # of each sample: by the first state and the noise of each step
    for k in range(count):
        powers.append(a @ powers[-1])
        powers[-1][:, n * (k + 1) : n * (k + 2)] += np.eye(n)
    prior = np.kron(np.eye(count + 1), q)
    prior[:n, :n] = start
    seen = np.vstack([c @ power for power in powers[:count]])
    gain = np.linalg.solve(seen @ prior @ seen.T + r * np.eye(count), seen @ prior).T
    left = prior - gain @ seen @ prior
    spreads = [np.sqrt(np.maximum(np.diag(power @ left @ power.T), 0.0)) for power in powers[:count]]
    np.testing.assert_allclose(data.smoothed_standard_deviation.values, spreads, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(data.smoothed.values, [p @ gain @ y[:, 0] for p in powers[:count]], atol=1e-9)
