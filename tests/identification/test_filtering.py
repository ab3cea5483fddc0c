"""A filter over a log: its samples one by one, irregular times against SciPy's linear system, labels, refusals."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm
from tests.logs import PERIOD, undisturbed
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.identification.recursion import rows_of

# A filter for each test, compiled for 60 samples: compiled in half the time.
pytestmark = pytest.mark.usefixtures("unoptimised")


def samples(count, outputs=1, seed=0):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(count, 1)), 0.1 * rng.normal(size=(count, outputs))


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize("form", ["covariance", "square_root"])
@pytest.mark.parametrize("kind", [fh.ExtendedKalmanFilter, fh.UnscentedKalmanFilter])
@pytest.mark.parametrize("measured", [("position",), ("position", "velocity")])
def test_a_log_is_filtered_as_its_samples_one_by_one(kind, form, measured):
    filter = kind(undisturbed(measured), PERIOD, 1e-4, 1e-3, [0.1, 0.0], 1.0, form=form)
    u, y = samples(60, len(measured))
    data = fh.filter_log(filter, (PERIOD * np.arange(60), u, y))
    total = 0.0
    for k in range(60):
        before = filter.mean
        filter.correct(y[k])
        np.testing.assert_allclose(data.estimate.values[k], filter.mean, rtol=1e-11, atol=1e-13)
        deviations = np.sqrt(np.diag(filter.covariance))
        np.testing.assert_allclose(data.standard_deviation.values[k], deviations, rtol=1e-9)
        np.testing.assert_allclose(data.prediction.values[k], before[: len(measured)], rtol=1e-11, atol=1e-13)
        assert data.log_likelihood.values[k] == pytest.approx(filter.log_likelihood, rel=1e-9, abs=1e-9)
        total += filter.log_likelihood
        filter.predict(u[k])
    assert data.attrs["log_likelihood"] == pytest.approx(total, rel=1e-10)


def test_what_a_gate_rejects_is_not_in_the_likelihood():
    filter = fh.ExtendedKalmanFilter(undisturbed(), PERIOD, 1e-4, 1e-3, [0.1, 0.0], 1.0, gate=0.99)
    u, y = samples(60)
    y[30] = 50.0
    data = fh.filter_log(filter, (PERIOD * np.arange(60), u, y))
    for k in range(60):
        filter.correct(y[k])
        assert data.log_likelihood.values[k] == pytest.approx(filter.log_likelihood, rel=1e-9, abs=1e-9)
        filter.predict(u[k])
    assert filter.rejected.sum() >= 1
    assert data.measured.values[30] == 0


@pytest.mark.oracle
def test_irregular_times_and_gaps_are_those_of_the_exact_linear_filter():
    rng = np.random.default_rng(3)
    steps = PERIOD * rng.uniform(0.5, 1.0, 80)
    steps[30] = 0.173  # a gap
    times = 5.0 + np.concatenate([[0.0], np.cumsum(steps)])
    u, y = samples(81, seed=4)
    y[::7] = np.nan
    level, noise = 1e-3, 1e-3
    filter = fh.ExtendedKalmanFilter(
        undisturbed(), PERIOD, level * PERIOD * np.eye(2), noise, [0.1, 0.0], 1.0
    )
    data = fh.filter_log(filter, (times, u, y))
    drift, drive = np.array([[0.0, 1.0], [-40.0, -0.3]]), np.array([[0.0], [1.0]])
    x, p, c = np.array([0.1, 0.0]), np.eye(2), np.array([[1.0, 0.0]])
    for k in range(81):
        if np.isfinite(y[k, 0]):
            spread = (c @ p @ c.T).item() + noise
            assert data.nis.values[k] == pytest.approx((y[k, 0] - x[0]) ** 2 / spread, rel=1e-5)
            gain = p @ c.T / spread
            x, p = x + gain[:, 0] * (y[k, 0] - x[0]), p - gain @ c @ p
        else:
            assert np.isnan(data.nis.values[k])
            assert np.isnan(data.innovation.values[k]).all()
        np.testing.assert_allclose(data.estimate.values[k], x, rtol=1e-5, atol=1e-6)
        if k == 80:
            break
        pieces = max(1, int(np.ceil((times[k + 1] - times[k]) / (1.01 * PERIOD))))
        span = (times[k + 1] - times[k]) / pieces
        whole = expm(span * np.block([[drift, drive], [np.zeros((1, 3))]]))
        for _ in range(pieces):
            x = whole[:2, :2] @ x + whole[:2, 2] * u[k, 0]
            p = whole[:2, :2] @ p @ whole[:2, :2].T + level * span * np.eye(2)


def test_a_gap_is_as_many_rows_as_periods():
    rows = rows_of(np.array([0.0, 0.01, 0.055, 0.065]), np.arange(4.0)[:, None], np.ones((4, 1)), PERIOD)
    np.testing.assert_array_equal(rows.places, [0, 1, 6, 7])
    assert rows.seconds[1:6].sum() == pytest.approx(0.045)
    np.testing.assert_array_equal(rows.inputs[:, 0], [0, 0, 1, 1, 1, 1, 1, 2, 3])
    np.testing.assert_array_equal(rows.measured[:, 0], [1, 1, 0, 0, 0, 0, 1, 1])


def test_the_table_names_its_columns_and_their_units():
    robot = fh.load_robot("paper")
    t = 1e-3 * np.arange(50)
    data = fh.filter_log(robot.plant(), (t, np.zeros(50), 0.1 + np.zeros(50)))
    assert data.estimate.sel(state_name="motor_position").dims == ("time",)
    assert str(data.state_unit.sel(state_name="link_velocity").item()) == "rad/s"
    assert float(np.abs(data.estimate.sel(state_name="link_position") - 0.1).max()) < 0.01


def test_a_run_is_a_log():
    robot = fh.load_robot("paper")
    problem = robot.problem()
    solution = fh.linear_law(problem, gamma=200.0)
    filter = fh.ExtendedKalmanFilter(problem.plant, 1e-3, 1e-8, 1e-6, np.zeros(4), 1e-3)
    run = fh.Loop(problem.plant, fh.Controller(solution, filter, latency=0)).run(
        duration=0.2, initial_state=[0.1, 0, 0.1, 0]
    )
    data = fh.filter_log(filter, run)
    np.testing.assert_allclose(data.estimate.values, run.data.estimate.values, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize(
    ("times", "inputs", "outputs", "anchors"),
    [
        ([0.0, 0.0, 0.1], np.zeros(3), np.zeros(3), ("row 2",)),
        ([0.0, 0.2, 0.1], np.zeros(3), np.zeros(3), ("row 3",)),
        ([0.0, 0.1, np.nan], np.zeros(3), np.zeros(3), ("times",)),
        ([0.0, 0.1, 0.2], [0.0, np.nan, 0.0], np.zeros(3), ("input", "row 2")),
        ([0.0, 0.1, 0.2], np.zeros(2), np.zeros(3), ("inputs", "(3, 1)")),
        ([0.0, 0.1, 0.2], np.zeros(3), np.zeros((3, 2)), ("outputs", "(3, 1)")),
        ([0.0, 0.1, 0.2], np.zeros(3), np.full(3, np.nan), ("outputs",)),
        ([0.0, 0.1, 0.2], np.zeros(3), [0.0, np.inf, 0.0], ("outputs",)),
    ],
)
def test_what_is_no_log_is_refused(times, inputs, outputs, anchors):
    filter = fh.ExtendedKalmanFilter(undisturbed(), PERIOD, 1e-4, 1e-3, [0.0, 0.0], 1.0)
    with refused_with(fh.InvalidInput, *anchors):
        fh.filter_log(filter, (times, inputs, outputs))


def test_a_diverging_filter_is_refused_with_its_sample():
    plant = fh.Plant(lambda x, u, d, p: x**3 + u, lambda x, u, p: x, ("x",), ("u",))
    filter = fh.ExtendedKalmanFilter(plant, PERIOD, 1e-4, 1e-3, [0.0], 1.0)
    u = np.zeros(20)
    u[7] = 1e120
    with refused_with(fh.NumericalFailure, "sample 8"):
        fh.filter_log(filter, (PERIOD * np.arange(20), u, np.zeros(20)))


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize("latency", [0, 1, 3])
def test_inputs_of_a_run_act_after_its_latency(latency):
    """Noiseless, with a model without any noise: the estimate is the true state at every sample."""
    robot = fh.load_robot("paper")
    plant = robot.plant()
    filter = fh.ExtendedKalmanFilter(plant, 1e-3, 1e-14, 1e-6, np.zeros(4), 1e-14)
    law = fh.linear_law(robot.problem(), gamma=400.0)
    controller = fh.Controller(law, filter, 1e-3, latency=latency)
    run = fh.Loop(plant, controller).run(fh.Step(0.1), duration=0.1)
    data = fh.filter_log(filter, run)
    assert len(data.time) == len(run.time) - latency
    truth = run.signals["state"][latency:]
    np.testing.assert_allclose(data.estimate.values, truth, atol=1e-5 * np.abs(truth).max())
    np.testing.assert_array_equal(data.known.values, 4)
