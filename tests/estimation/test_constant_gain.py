import numpy as np
import pytest
from tests.estimation.kalman import LinearCase

from flexhinf.errors import InvalidInput
from flexhinf.estimation import ConstantGainFilter, ExtendedKalmanFilter, linear_model, stationary_gain
from flexhinf.plant import Estimator
from flexhinf.robot import paper_arm


def test_on_a_linear_plant_it_is_the_kalman_filter_after_many_samples():
    case = LinearCase(3, 2, 2, seed=5)
    ekf = ExtendedKalmanFilter(**case.arguments())
    model = linear_model(ekf, np.zeros(3), np.zeros(2))
    constant = ConstantGainFilter(ekf, stationary_gain(model, case.q, case.r))
    assert isinstance(constant, Estimator)
    p = case.plant.parameters.named(case.plant.parameters.vector())
    belief = constant.initial_at(np.ones(3))
    for _ in range(600):
        y, u = case.rng.normal(size=2), case.rng.normal(size=2)
        ekf.correct(y)
        belief = constant.measurement_update(belief, y, u, p, case.r)
        settled = belief.mean - ekf.mean
        ekf.predict(u)
        belief = constant.time_update(belief, u, p, case.q)
    assert np.abs(settled).max() < 1e-11


def test_one_step_by_hand():
    plant = paper_arm().plant()
    ekf = ExtendedKalmanFilter(plant, 1e-3, 1e-6, 1e-6, [0.1, 0.2, 0.3, 0.4], 0.0)
    gain = np.array([[0.5], [1.0], [-2.0], [3.0]])
    constant, p = ConstantGainFilter(ekf, gain), plant.parameters.named(plant.parameters.vector())
    after = constant.measurement_update(constant.initial, np.array([0.3]), np.zeros(1), p, None)
    np.testing.assert_allclose(after.mean, ekf.mean + gain[:, 0] * (0.3 - 0.1), rtol=1e-15)
    later = constant.time_update(after, np.array([2.0]), p, None)
    np.testing.assert_array_equal(later.mean, ekf.transition(after.mean, np.array([2.0]), p))
    np.testing.assert_array_equal(later.gain, gain)


@pytest.mark.parametrize("gain", [np.ones(4), np.ones((1, 4)), np.full((4, 1), np.nan)])
def test_a_gain_that_does_not_fit_is_named(gain):
    ekf = ExtendedKalmanFilter(paper_arm().plant(), 1e-3, 1e-6, 1e-6, np.zeros(4), 0.0)
    with pytest.raises(InvalidInput, match=r"\(4, 1\)"):
        ConstantGainFilter(ekf, gain)
