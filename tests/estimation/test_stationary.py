"""The gain at rest against SciPy's Riccati solver, python-control and the recursion itself."""

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from flexhinf.estimation import ExtendedKalmanFilter, linear_model, stationary_gain
from flexhinf.plant import equilibrium
from flexhinf.robot import paper_arm


@pytest.mark.oracle
@pytest.mark.parametrize("goal", [0.5, np.pi])
@pytest.mark.parametrize("q", [1e-10, 1e-6, 1.0])
def test_gain_is_that_of_the_riccati_solver(goal, q):
    plant = paper_arm().plant()
    filter = ExtendedKalmanFilter(plant, 1e-3, q, np.deg2rad(0.1) ** 2, np.zeros(4), 0.0)
    f, h = linear_model(filter, *equilibrium(plant, ["link_position"], np.array([goal])))
    noise, r = filter.process_noise, filter.measurement_noise
    p = solve_discrete_are(f.T, h.T, noise, r)
    expected = p @ h.T / (h @ p @ h.T + r)
    assert np.allclose(stationary_gain((f, h), noise, r), expected, rtol=1e-7, atol=1e-12)


def test_without_process_noise_a_stable_model_is_left_alone():
    f, h = np.diag([0.9, 0.5]), np.ones((1, 2))
    assert np.allclose(stationary_gain((f, h), np.zeros((2, 2)), np.eye(1)), 0.0, atol=1e-15)
