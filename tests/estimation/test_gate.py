"""A gate for outliers: against Kalman filters in NumPy that leave them out, by SciPy's quantile."""

from __future__ import annotations

import copy
import pickle
from functools import partial

import numpy as np
import pytest
from scipy.stats import chi2, multivariate_normal
from tests.builders import KALMAN_FORMS, seen_by_three, still, three_sensors, tracking_mass
from tests.estimation import kalman
from tests.estimation.kalman import LinearCase
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.estimation import ExtendedKalmanFilter, UnscentedKalmanFilter

# Kernels that run once each: half of the time.
pytestmark = pytest.mark.usefixtures("unoptimised")


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@KALMAN_FORMS
@pytest.mark.parametrize("gate", [0.5, 0.99, 0.999999])
def test_what_lies_beyond_the_quantile_is_left_out(kind, gate):
    case = LinearCase(5, 1, 3, seed=3)
    filter = kind(**case.arguments(), gate=gate)
    f, g = case.map(filter.stages, filter.sub_steps)
    mean, covariance, counts = case.mean, case.p0, np.zeros(3, dtype=int)
    for k in range(30):
        spread = case.c @ covariance @ case.c.T + case.r
        y = case.rng.multivariate_normal(case.c @ mean, spread * (25.0 if k % 3 == 0 else 1.0))
        y[k % 5 : k % 5 + 1] = np.nan
        squares = (y - case.c @ mean) ** 2 / np.diag(spread)
        used = squares <= chi2.ppf(gate, 1)
        counts += squares > chi2.ppf(gate, 1)
        filter.correct(y)
        if used.any():
            left = multivariate_normal((case.c @ mean)[used], spread[np.ix_(used, used)])
            assert filter.log_likelihood == pytest.approx(left.logpdf(y[used]), rel=1e-8, abs=1e-9)
            mean, covariance = kalman.correct(
                mean, covariance, case.c[used], y[used], case.r[np.ix_(used, used)]
            )
        assert kalman.relative(filter.mean, filter.covariance, mean, covariance) < 1e-9
        np.testing.assert_array_equal(filter.rejected, counts)
        filter.predict([0.1])
        mean, covariance = kalman.predict(mean, covariance, f, g, np.array([0.1]), case.q)
    assert counts.sum() > 0
    filter.reset()
    np.testing.assert_array_equal(filter.rejected, [0, 0, 0])


@pytest.mark.oracle
@KALMAN_FORMS
def test_of_sensors_that_are_not_linear_it_is_the_filter_of_the_others(kind):
    y = np.array([0.15, 0.2, 0.1])
    plain = seen_by_three(kind)
    gated = seen_by_three(kind, gate=0.999)
    for place in range(3):
        for filter in (plain, gated):
            filter.reset()
        wild, gap = y.copy(), y.copy()
        wild[place], gap[place] = 50.0, np.nan
        gated.correct(wild)
        plain.correct(gap)
        assert kalman.relative(gated.mean, gated.covariance, plain.mean, plain.covariance) < 1e-13
        assert gated.log_likelihood == pytest.approx(plain.log_likelihood, rel=1e-12)
        np.testing.assert_array_equal(gated.rejected, np.arange(3) == place)
        np.testing.assert_array_equal(plain.rejected, [0, 0, 0])


@KALMAN_FORMS
def test_a_gate_that_nothing_meets_changes_no_bit(kind):
    plain = seen_by_three(kind)
    gated = seen_by_three(kind, gate=1.0 - 1e-12)
    for y in ([0.15, 0.2, 0.1], [0.1, np.nan, 0.1]):
        for filter in (plain, gated):
            filter.correct(y)
            filter.predict([0.1])
        np.testing.assert_array_equal(gated.mean, plain.mean)
        np.testing.assert_array_equal(gated.covariance, plain.covariance)


@pytest.mark.ci("4,000 samples")
@pytest.mark.oracle
def test_of_good_measurements_as_many_are_rejected_as_stated():
    plant = fh.Plant(lambda x, u, d, p: -x + u[0], lambda x, u, p: x, ("a", "b"), ("u",))
    filter, rng = (
        ExtendedKalmanFilter(plant, 0.1, 0.01, 0.04, [0.0, 0.0], 0.2, gate=0.9),
        np.random.default_rng(0),
    )
    f, x, samples = 1.0 - 0.1 + 0.005 - 1e-3 / 6 + 1e-4 / 24, rng.normal(size=2) * np.sqrt(0.2), 4000
    for _ in range(samples):
        filter.correct(x + 0.2 * rng.normal(size=2))
        filter.predict([0.0])
        x = f * x + 0.1 * rng.normal(size=2)
    share = filter.rejected / samples
    assert np.all(np.abs(share - 0.1) < 0.02), share  # more than four deviations


@KALMAN_FORMS
def test_what_a_filter_goes_on_in_spite_of_is_counted(kind):
    filter = seen_by_three(kind, gate=0.999)
    none = dict.fromkeys(("skipped", "missing", "rejected", "singular", "covariance"), 0)
    assert filter.repairs == none
    filter.correct([np.nan, np.nan, 0.1])
    filter.correct([np.nan] * 3)
    filter.correct([0.15, 50.0, np.nan])
    assert filter.repairs == {**none, "skipped": 1, "missing": 3, "rejected": 1}
    beside = copy.copy(filter)
    beside.correct(None)
    assert (beside.repairs["skipped"], filter.repairs["skipped"]) == (2, 1)
    filter.reset()
    assert filter.repairs == none


def test_a_covariance_that_is_singular_to_rounding_is_counted():
    """Two states that are known to be alike; nothing is counted of one that is known exactly, nor of rows."""
    plant = fh.Plant(lambda x, u, d, p: 0.0 * x + u[0], lambda x, u, p: x[:1], ("a", "b"), ("u",))
    for p0, form, count in (([[1.0, 1.0], [1.0, 1.0]], "covariance", 3), ([1.0, 0.0], "covariance", 0),
                            ([[1.0, 1.0], [1.0, 1.0]], "square_root", 0)):  # fmt: skip
        filter = ExtendedKalmanFilter(plant, 0.1, 0.0, 1.0, [0.0, 0.0], p0, form=form)
        for _ in range(3):
            filter.predict([0.0])
        assert filter.repairs["singular"] == count


# In controllers ------------------------------------------------------------------------------------------
@pytest.mark.quick_cases(1)
@KALMAN_FORMS
@pytest.mark.parametrize("pieces", [False, True])
def test_to_a_controller_an_outlier_is_a_missing_element(kind, pieces):
    """The integral counts the estimate instead, and the count lives where the belief does."""
    gated, plain = tracking_mass(partial(kind, gate=0.9999)), tracking_mass(kind)
    gated, plain = (c.in_pieces() if pieces else c for c in (gated, plain))
    for k in range(40):
        at = plain.estimate if k else np.array([0.1, 0.0])
        y = np.array([at[0], at[1] + 0.1 * np.sin(at[0])]) + 1e-3 * np.cos([k, 2.0 * k])
        wild, gap = y.copy(), y.copy()
        if k % 4 == 3:
            wild[k // 4 % 2], gap[k // 4 % 2] = 1e3, np.nan
        if k == 20:
            wild[:], gap[:] = None, None
        np.testing.assert_allclose(gated.step(wild, 0.2), plain.step(gap, 0.2), rtol=1e-9, atol=1e-11)
        np.testing.assert_allclose(gated.estimate, plain.estimate, rtol=1e-10, atol=1e-13)
        np.testing.assert_allclose(gated.integrals, plain.integrals, rtol=1e-10, atol=1e-13)
    assert gated.rejected.sum() >= 6
    assert plain.rejected.tolist() == [0, 0]
    again = pickle.loads(pickle.dumps(gated))
    np.testing.assert_array_equal(again.rejected, gated.rejected)
    gated.reset()
    assert gated.rejected.tolist() == [0, 0]


@pytest.mark.ci("compiles a loop of each filter")
@pytest.mark.quick_cases(1)
@KALMAN_FORMS
def test_a_loop_is_that_of_its_steps_and_files_keep_the_gate(kind, tmp_path):
    controller = fh.Controller(still(three_sensors()), seen_by_three(kind, gate=0.9), 0.05)
    run = fh.Loop(three_sensors(), controller).run(noise=0.05, duration=5.0, initial_state=[0.3, 0.5, 0.0])
    controller.save(tmp_path / "one")
    for stepped in (controller.fresh(), fh.load_controller(tmp_path / "one")):
        for y, estimate in zip(run.signals["output"], run.signals["estimate"], strict=True):
            stepped.step(y)
            np.testing.assert_array_equal(stepped.estimate, estimate)
        assert stepped.rejected.sum() > 20


def test_without_an_estimator_nothing_is_rejected():
    assert fh.Controller(still(three_sensors()), None).rejected.tolist() == [0, 0, 0]


@pytest.mark.quick_cases(12)
@KALMAN_FORMS
@pytest.mark.parametrize("gate", [0.0, 1.0, -0.5, 3.0, np.nan, np.inf, "0.9", [0.9, 0.9], 1j])
def test_what_is_no_probability_is_refused(kind, gate):
    with refused_with(InvalidInput, "gate", "0", "1"):
        seen_by_three(kind, gate=gate)


def test_where_no_variance_is_predicted_there_is_no_gate():
    with refused_with(InvalidInput, "gate", "redraw"):
        seen_by_three(UnscentedKalmanFilter, gate=0.9, redraw=False)
