"""Estimators composed of pieces, against the Kalman filter and against their own text."""

import numpy as np
import pytest
from tests.builders import KALMAN
from tests.estimation import kalman
from tests.estimation.composing import composed
from tests.estimation.kalman import LinearCase

import flexhinf as fh
from flexhinf.codegen import DIRECT
from flexhinf.estimation import UnscentedKalmanFilter
from flexhinf.plant import rk4_stages

# Kernels that run once each: half of the time.
pytestmark = pytest.mark.usefixtures("unoptimised")


def composed_step(estimator):
    """``step(mean, covariance, y, u)`` → corrected with y, then predicted with u."""
    step, kind = composed(estimator), type(estimator.initial)
    return lambda mean, covariance, y, u: tuple(step(kind(mean, covariance), y, u)[:2])


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@KALMAN
@pytest.mark.parametrize(
    ("n", "p", "period", "stages"),
    [
        (3, 1, 0.02, 4),
        (9, 4, 0.02, 4),
        (9, 4, 0.5, 8),
        pytest.param(28, 7, 0.02, 4, marks=pytest.mark.ci("28 states")),
        pytest.param(33, 8, 0.02, 4, marks=pytest.mark.ci("33 states")),
    ],
)
def test_on_a_linear_plant_they_are_the_kalman_filter(kind, n, p, period, stages):
    case = LinearCase(n, 2, p, seed=n, scale=1e-2, period=period)
    estimator = kind(**case.arguments(form="covariance"))
    assert estimator.stages == stages
    step, (f, g) = composed_step(estimator), case.map(estimator.stages, estimator.sub_steps)
    expected = mean, covariance = case.mean, case.p0
    for _ in range(5):
        y, u = 1e-2 * case.rng.normal(size=p), case.rng.normal(size=2)
        mean, covariance = step(mean, covariance, y, u)
        np.testing.assert_array_equal(covariance, covariance.T)
        expected = kalman.correct(*expected, case.c, y, case.r)
        expected = kalman.predict(*expected, f, g, u, case.q)
        assert kalman.relative(mean, covariance, *expected) < 1e-10


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@KALMAN
def test_composed_they_are_their_text_on_floats(kind):
    case = LinearCase(12, 2, 3, seed=4)
    estimator = kind(**case.arguments(period=1.0, form="covariance"))
    assert estimator.sub_steps > 2
    step, (mean, covariance) = composed_step(estimator), (case.mean, case.p0)
    for _ in range(3):
        y, u = case.rng.normal(size=3), case.rng.normal(size=2)
        mean, covariance = step(mean, covariance, y, u)
        belief = estimator.measurement_update(
            estimator._belief, y, u, estimator._parameters, estimator.measurement_noise
        )
        estimator._belief = estimator.time_update(belief, u, estimator._parameters, estimator.process_noise)
        assert kalman.relative(mean, covariance, *estimator._belief[:2]) < 1e-11


@pytest.mark.ci("filters of seven links, up to forty steps a sample")
@pytest.mark.oracle
def test_little_process_noise_does_not_show_the_step_of_eight_stages():
    """Seven links whose springs ring, from a known state: estimates are those of forty classical steps a sample.

    With five steps a velocity errs by some hundredths more at the worst, with three by more than twice as much.
    """
    robot, rng, period = fh.load_robot("seven-link"), np.random.default_rng(1), 1e-3
    plant = robot.plant()
    start, rest = robot.operating_point()[:2]
    pushes = np.array([20.0, 40.0, 20.0, 40.0, 10.0, 10.0, 5.0])
    ukf = UnscentedKalmanFilter(plant, period, 1e-14, 1e-10, start, 1e-12, form="covariance")
    assert (ukf.stages, ukf.sub_steps) == (8, 1)
    x, states, measured, torques = start, [], [], []
    for _ in range(300):
        torques.append(rest + pushes * rng.normal(size=7))
        states.append(x)
        measured.append(
            plant.evaluate_output(x, torques[-1], plant.parameters.vector()) + 1e-5 * rng.normal(size=7)
        )
        x = moved(plant, x, torques[-1], period, 40)
    errors = {}
    for steps in ((4, 3), (4, 5), (8, 1), (4, 40)):
        ukf.stages, ukf.sub_steps = steps
        step, mean, covariance, found = composed_step(ukf), start, ukf.covariance, []
        for y, u, true in zip(measured, torques, states, strict=True):
            found.append(mean - true)
            mean, covariance = step(mean, covariance, y, u)
        errors[steps] = np.sqrt(np.mean(np.square(found[150:]), axis=0))
    three, five, eight = ((errors[steps] / errors[4, 40]).max() for steps in ((4, 3), (4, 5), (8, 1)))
    print(three, five, eight)
    assert eight < 1.01
    assert eight < five
    assert three > 2.0


def moved(plant, x, u, period, count):
    """A state after a period, in so many classical steps."""
    held = (u, np.zeros(len(plant.disturbances)), plant.parameters.vector())
    for _ in range(count):
        x = rk4_stages(DIRECT, lambda x: np.asarray(plant.traced_flow(x, *held)).ravel(), x, period / count)
    return x
