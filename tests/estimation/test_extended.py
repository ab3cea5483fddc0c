import numpy as np
import pytest

from flexhinf.estimation import ExtendedKalmanFilter, UnscentedKalmanFilter
from flexhinf.plant import Plant
from flexhinf.robot import paper_arm

# Kernels that run once each: half of the time.
pytestmark = pytest.mark.usefixtures("unoptimised")


@pytest.mark.oracle
@pytest.mark.parametrize("period", [1e-3, 0.05])
def test_the_jacobian_is_that_of_the_sampled_map(period):
    """Complex steps through the same NumPy code: no symbols, no differences."""
    plant = paper_arm().plant()
    ekf = ExtendedKalmanFilter(plant, period, 0.0, 1.0, [0.3, -1.0, 0.2, 2.0], 1.0)
    p = plant.parameters.named(plant.parameters.vector())
    u, x = np.array([4.0]), ekf.mean
    expected = np.column_stack([ekf.transition(x + 1e-200j * e, u, p).imag / 1e-200 for e in np.eye(4)])
    ekf.predict(u)
    np.testing.assert_allclose(ekf.mean, ekf.transition(x, u, p), rtol=1e-14)
    np.testing.assert_allclose(ekf.covariance, expected @ expected.T, rtol=1e-13)
    first_order = np.eye(4) + period * plant.linearise(x, u)[0]
    assert np.abs(ekf.covariance - first_order @ first_order.T).max() > 1e-7


@pytest.mark.oracle
def test_a_curved_measurement_is_linearised_at_the_estimate():
    plant = Plant(
        lambda x, u, d, p: u - x,
        lambda x, u, p: np.array([x[0] ** 2 * p.gain + u[0]]),
        ("x",),
        ("u",),
        parameters={"gain": 3.0},
    )
    ekf = ExtendedKalmanFilter(plant, 0.1, 0.0, 0.5, [2.0], 0.2)
    ekf.correct([13.0])
    c = 12.0
    gain = 0.2 * c / (c * 0.2 * c + 0.5)
    assert ekf.mean[0] == pytest.approx(2.0 + gain * (13.0 - 12.0), rel=1e-14)
    assert ekf.covariance[0, 0] == pytest.approx((1 - gain * c) * 0.2, rel=1e-12)


@pytest.mark.ci("runs of two filters")
def test_with_the_link_measured_it_ties_with_the_unscented_one():
    """The plant's only nonlinearity is then a function of the output (design note on the paper's claim)."""
    plant = paper_arm().plant()
    arguments = (plant, 1e-3, 1e-8, 1e-6, np.zeros(4), 1e-4)
    filters = [ExtendedKalmanFilter(*arguments), UnscentedKalmanFilter(*arguments)]
    rng = np.random.default_rng(1)
    for k in range(500):
        y = np.sin(0.004 * k) + 1e-3 * rng.normal()
        for one in filters:
            one.correct(y)
            one.predict(2.0)
    np.testing.assert_allclose(filters[0].mean, filters[1].mean, atol=1e-4)


def test_keys_tell_code_apart():
    plant = paper_arm().plant()
    one, two = (
        ExtendedKalmanFilter(plant, h, 0.0, 1.0, np.zeros(4), 1.0).estimator_key for h in (1e-3, 2e-3)
    )
    assert one != two
