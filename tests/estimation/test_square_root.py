"""Filters that carry rows of deviations: against Kalman filters in many digits, and against the covariance form."""

from __future__ import annotations

from functools import partial

import mpmath
import numpy as np
import pytest
from tests.builders import KALMAN, bearing, linear_plant, pairs
from tests.estimation import kalman
from tests.estimation.composing import composed
from tests.estimation.kalman import LinearCase
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.estimation import ExtendedKalmanFilter, UnscentedKalmanFilter
from flexhinf.estimation.square_root import root_rows

# Kernels that run once each: half of the time.
pytestmark = pytest.mark.usefixtures("unoptimised")


ROOT = {"form": "square_root"}


def taken(estimator, y, u):
    """The same in NumPy: the belief after a correction and a prediction."""
    estimator.correct(y)
    estimator.predict(u)
    return estimator._belief


# Linear plants -----------------------------------------------------------------------------------------
@pytest.mark.quick_cases(2)
@pytest.mark.oracle
@pytest.mark.parametrize(
    ("kind", "size", "scale"),
    pairs([UnscentedKalmanFilter, ExtendedKalmanFilter], [(3, 1), (6, 4), (9, 3)], [1e-6, 1.0, 1e3]),
)
def test_on_a_linear_plant_it_is_the_kalman_filter(kind, size, scale):
    n, p = size
    case = LinearCase(n, 2, p, seed=n, scale=scale)
    estimator = kind(**case.arguments(**ROOT))
    step, (f, g) = composed(estimator), case.map(estimator.stages, estimator.sub_steps)
    belief, expected = estimator.initial, (case.mean, case.p0)
    assert kalman.relative(belief.mean, belief.covariance, *expected) < 1e-14
    for _ in range(5):
        y, u = scale * case.rng.normal(size=p), case.rng.normal(size=2)
        belief = step(belief, y, u)
        expected = kalman.predict(*kalman.correct(*expected, case.c, y, case.r), f, g, u, case.q)
        assert kalman.relative(belief.mean, belief.covariance, *expected) < 1e-12
        mine = taken(estimator, y, u)
        assert kalman.relative(mine.mean, mine.covariance, belief.mean, belief.covariance) < 1e-12
    covariance = kind(**case.arguments())
    covariance.correct(y)
    other = kind(**case.arguments(**ROOT))
    other.correct(y)
    assert other.log_likelihood == pytest.approx(covariance.log_likelihood, rel=1e-10)


def exact(case, n, p, samples):
    """Means and variances after each correction of a Kalman filter in 80 digits; F by the same Runge–Kutta method."""
    with mpmath.workdps(80):
        h, one = mpmath.mpf(case["period"]), mpmath.eye(n)
        a, b, c = (mpmath.matrix(case[name].tolist()) for name in ("a", "b", "c"))
        q, r, p0 = (mpmath.matrix(case[name].tolist()) for name in ("q", "r", "p0"))
        f, drive = one, one
        for k in range(4, 0, -1):
            drive = f
            f = one + h / k * a * f
        g = h * drive * b
        mean, covariance, found = mpmath.zeros(n, 1), p0, []
        for y, u in samples:
            s = c * covariance * c.T + r
            gain = covariance * c.T * mpmath.inverse(s)
            mean = mean + gain * (mpmath.matrix(y.tolist()) - c * mean)
            covariance = covariance - gain * c * covariance
            found.append(([float(x) for x in mean], [float(covariance[i, i]) for i in range(n)]))
            mean, covariance = f * mean + g * mpmath.mpf(float(u)), f * covariance * f.T + q
    return found


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@KALMAN
@pytest.mark.parametrize(
    ("prior", "noise", "process"),
    [(1e8, 1e-10, 1e-8), (1.0, 1e-12, 0.0), (1e4, 1e-16, 1e-20), (1e-12, 1e6, 1e-4)],
)
def test_where_variances_lie_many_decades_apart_it_is_right(kind, prior, noise, process):
    rng = np.random.default_rng(5)
    n, p, period = 4, 2, 0.01
    case = {
        "period": period, "a": np.eye(n, k=1) - 0.2 * rng.random((n, n)), "b": rng.normal(size=(n, 1)),
        "c": rng.normal(size=(p, n)), "q": process * np.eye(n), "r": noise * np.eye(p), "p0": prior * np.eye(n),
    }  # fmt: skip
    plant = linear_plant(
        case["a"], case["b"], case["c"], states=tuple("abcd"), inputs=("u",), outputs=("y", "z")
    )
    estimator = kind(plant, period, case["q"], case["r"], np.zeros(n), case["p0"], **ROOT)
    assert (estimator.stages, estimator.sub_steps) == (4, 1)
    samples = [(np.sqrt(noise) * rng.normal(size=p) + 1.0, rng.normal()) for _ in range(20)]
    for (y, u), (mean, variance) in zip(samples, exact(case, n, p, samples), strict=True):
        estimator.correct(y)
        np.testing.assert_allclose(np.sum(estimator._belief.root**2, axis=0), variance, rtol=1e-5)
        assert np.all(np.abs(estimator.mean - mean) <= 1e-3 * np.sqrt(variance) + 1e-12 * np.abs(mean))
        estimator.predict([u])


@pytest.mark.quick_cases(1)
@KALMAN
@pytest.mark.parametrize("rank", [0, 1, 2])
def test_a_state_that_is_known_exactly_stays_so(kind, rank):
    rng = np.random.default_rng(rank)
    columns = rng.normal(size=(3, rank))
    p0 = columns @ columns.T
    rows = root_rows(p0)
    assert np.count_nonzero(np.abs(rows).max(axis=1)) == rank
    np.testing.assert_allclose(rows.T @ rows, p0, atol=1e-15)
    plant = fh.Plant(lambda x, u, d, q: -0.1 * x + u[0], lambda x, u, q: x[:2], tuple("abc"), ("u",))
    estimator = kind(plant, 0.1, 0.0, 1e-12, np.zeros(3), p0, **ROOT)
    for _ in range(50):
        estimator.correct([0.0, 0.0])
        estimator.predict([0.0])
    assert np.all(np.isfinite(estimator.covariance))
    assert np.linalg.matrix_rank(estimator.covariance, tol=1e-13) <= rank


# What is not linear -------------------------------------------------------------------------------------
@pytest.mark.oracle
@pytest.mark.parametrize("bounds", [None, {"angle": (-0.1, 0.4)}])
@pytest.mark.parametrize("scaling", [{}, {"alpha": 0.9, "beta": 2.0, "kappa": 1.0}])
def test_where_the_rows_are_cholesky_factors_both_forms_agree(bounds, scaling):
    """One prediction, and one correction: later the points are others, since W is turned."""
    root = np.array([[0.1, 0.0], [0.05, 0.2]])
    given = (bearing(), 0.1, 1e-4, 1e-3, [0.2, 0.1], root @ root.T)
    for update, value in (("correct", [0.1, 0.05]), ("predict", [0.3])):
        first, second = (UnscentedKalmanFilter(*given, **scaling, bounds=bounds, form=form)
                         for form in ("covariance", "square_root"))  # fmt: skip
        second._belief = second.initial._replace(root=root.T)
        getattr(first, update)(value)
        getattr(second, update)(value)
        np.testing.assert_allclose(second.mean, first.mean, rtol=1e-12)
        np.testing.assert_allclose(second.covariance, first.covariance, rtol=1e-11, atol=1e-16)


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.parametrize(
    "kind", [UnscentedKalmanFilter, partial(UnscentedKalmanFilter, bounds={"angle": (0.0, 9.0)})]
)
def test_composed_it_is_its_text_on_floats(kind):
    estimator = kind(bearing(), 0.5, 1e-4, 1e-3, [0.2, 0.1], [0.01, 0.04], **ROOT)
    assert estimator.sub_steps > 1
    step, belief = composed(estimator), estimator.initial
    for k in range(4):
        y, u = np.array([0.1 * k, 0.02]), np.array([0.1])
        belief, mine = step(belief, y, u), taken(estimator, y, u)
        assert kalman.relative(belief.mean, belief.covariance, mine.mean, mine.covariance) < 1e-12


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@KALMAN
def test_an_arm_is_estimated_as_in_the_covariance_form(kind):
    robot, rng = fh.load_robot("planar-two-link"), np.random.default_rng(0)
    plant = robot.plant(("link_position", "motor_position"))
    x, u = robot.operating_point(robot.home)[:2]
    first, second = (
        kind(plant, 1e-3, 1e-8, 1e-8, x, 1e-4, form=form) for form in ("covariance", "square_root")
    )
    for _ in range(20):
        y = np.asarray(plant.evaluate_output(x, u, plant.parameters.vector()), float) + 1e-4 * rng.normal(
            size=4
        )
        torque = u + rng.normal(size=2)
        taken(first, y, torque)
        taken(second, y, torque)
    spread = np.sqrt(np.diag(first.covariance))
    np.testing.assert_allclose(second.mean, first.mean, atol=1e-6 * spread.min())
    np.testing.assert_allclose(second.covariance, first.covariance, atol=1e-7 * spread.max() ** 2)


@pytest.mark.filterwarnings("ignore:The central covariance weight")
@pytest.mark.parametrize("setting", [{"redraw": False}, {"alpha": 0.5, "beta": 0.0}])
def test_what_subtracts_covariances_has_no_square_root(setting):
    with refused_with(InvalidInput, "covariance", *setting):
        UnscentedKalmanFilter(bearing(), 0.1, 1e-4, 1e-3, [0.2, 0.1], 1.0, **setting, **ROOT)


def given(**settings):
    return (bearing(), 0.1, 1e-4, 1e-3, [0.2, 0.1], 1.0), settings


@pytest.mark.parametrize(
    ("kind", "settings", "form"),
    [
        (UnscentedKalmanFilter, {}, "square_root"), (ExtendedKalmanFilter, {}, "square_root"),
        (UnscentedKalmanFilter, {"redraw": False}, "covariance"),
        (UnscentedKalmanFilter, {"form": "covariance"}, "covariance"),
    ],
)  # fmt: skip
def test_rows_are_the_default_where_there_are_any(kind, settings, form):
    arguments, settings = given(**settings)
    assert kind(*arguments, **settings).form == form


def test_negative_weights_leave_the_covariance_form_and_a_warning():
    arguments, settings = given(alpha=0.5, beta=0.0)
    with pytest.warns(UserWarning, match=r"negative \(-2\.25\)"):
        estimator = UnscentedKalmanFilter(*arguments, **settings)
    assert estimator.form == "covariance"
    with pytest.warns(UserWarning, match="negative"):
        assert type(estimator)(**estimator.settings()).form == "covariance"


def test_a_subclass_that_moves_points_itself_has_the_covariance_form():
    """Rows are moved by differences of the plant's flow, which its `moved` would not change."""

    class Halved(UnscentedKalmanFilter):
        def moved(self, run, x, u, p):
            return run.call(lambda x: 0.5 * x, x)

    arguments, _ = given()
    estimator = Halved(*arguments)
    assert estimator.form == "covariance"
    estimator.predict([0.0])
    np.testing.assert_allclose(estimator.mean, [0.1, 0.05], rtol=1e-12)
    with refused_with(InvalidInput, "moved", "covariance"):
        Halved(*arguments, **ROOT)


def test_an_unknown_form_is_refused():
    with refused_with(InvalidInput, "square_root"):
        ExtendedKalmanFilter(bearing(), 0.1, 1e-4, 1e-3, [0.2, 0.1], 1.0, form="ud")
