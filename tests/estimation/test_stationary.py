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


@pytest.mark.oracle
@pytest.mark.parametrize(("n", "p"), [(1, 1), (3, 2), (6, 4)])
def test_gain_is_that_of_python_control(kalman, n, p):
    import control

    case = kalman.case(n, 1, p, seed=n)
    f, _ = case.map(4, 1)
    expected = control.dlqe(f, np.eye(n), case.c, case.q, case.r)[1]  # P of the prediction
    expected = expected @ case.c.T @ np.linalg.inv(case.c @ expected @ case.c.T + case.r)
    assert np.allclose(stationary_gain((f, case.c), case.q, case.r), expected, rtol=1e-9, atol=1e-12)


def test_without_process_noise_a_stable_model_is_left_alone():
    f, h = np.diag([0.9, 0.5]), np.ones((1, 2))
    assert np.allclose(stationary_gain((f, h), np.zeros((2, 2)), np.eye(1)), 0.0, atol=1e-15)
