"""Rows with derivatives, against closed forms and SciPy's integrator."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from flexhinf.analysis.sampled_controller import DerivativeRows, near_equilibrium, one_period, solved
from flexhinf.robot import load_robot, paper_arm

# Rows of three plants, computed once: 0.1 s instead of 0.7 s.
pytestmark = pytest.mark.usefixtures("unoptimised")


def test_values_and_slopes_of_rows_with_their_own_and_with_common_numbers() -> None:
    x, p = ca.SX.sym("x", 3), ca.SX.sym("p", 2)
    build = lambda: ca.Function("f", [x, p], [ca.vertcat(p[0] * x[0] * x[1], ca.sin(p[1] * x[2]))])  # noqa: E731
    rows, rng = DerivativeRows("test rows", build), np.random.default_rng(0)
    points, own = rng.normal(size=(5, 3)), rng.normal(size=(5, 2))
    for held in (own, own[0]):
        a, b = np.broadcast_to(held, (5, 2)).T
        value, slope = rows(points, held)
        expected = np.zeros((5, 2, 3))
        expected[:, 0, 0], expected[:, 0, 1] = a * points[:, 1], a * points[:, 0]
        expected[:, 1, 2] = b * np.cos(b * points[:, 2])
        assert np.allclose(
            value, np.column_stack([a * points[:, 0] * points[:, 1], np.sin(b * points[:, 2])])
        )
        assert np.allclose(slope, expected, rtol=1e-14)


def test_repeated_rows_carry_slopes_along() -> None:
    x = ca.SX.sym("x", 2)
    function = ca.Function("f", [x, ca.SX.sym("none", 0)], [ca.vertcat(x[1], x[0] * x[0])])
    value, slope = DerivativeRows("test repeated", lambda: function, repeated=True)(
        np.array([[2.0, 3.0]]), None, 4
    )
    # (a, b) → (b, a²) → (a², b²) → (b², a⁴) → (a⁴, b⁴)
    assert np.allclose(value, [[16.0, 81.0]])
    assert np.allclose(slope, [[[32.0, 0.0], [0.0, 108.0]]])


@pytest.mark.ci("SciPy integrates a period some forty times")
@pytest.mark.oracle
@pytest.mark.parametrize("name", ["paper", "coil", "planar-two-link"])
def test_a_period_and_its_derivatives(name: str) -> None:
    robot = load_robot("planar-two-link") if name == "planar-two-link" else paper_arm()
    plant, rng, period = robot.plant(inductance=name == "coil"), np.random.default_rng(1), 0.01
    n, m, k = plant.n, len(plant.inputs), len(plant.disturbances)
    x, u, d = rng.normal(size=(2, n)), rng.normal(size=(2, m)), rng.normal(size=(2, k))
    p = np.tile(plant.parameters.vector(), (2, 1))
    later, slope = one_period(plant, period, 120, x, u, p, d)
    for row in range(2):

        def end(moving: np.ndarray) -> np.ndarray:
            u, d = moving[n : n + m], moving[n + m :]
            flow = lambda _, s: plant.derivative(s, u, d)  # noqa: E731
            return solve_ivp(flow, (0.0, period), moving[:n], rtol=1e-12, atol=1e-13).y[:, -1]

        start = np.concatenate([x[row], u[row], d[row]])
        assert np.allclose(later[row], end(start), rtol=1e-9, atol=1e-9)
        for i in range(n + m + k):
            e = 1e-4 * np.eye(n + m + k)[i]
            difference = (end(start + e) - end(start - e)) / 2e-4
            assert np.allclose(slope[row, :, i], difference, rtol=1e-6, atol=1e-6)


@pytest.mark.oracle
@pytest.mark.parametrize("name", ["paper", "coil", "planar-two-link"])
def test_a_period_near_a_rest_is_that_of_the_loop_there(name: str) -> None:
    robot = load_robot("planar-two-link") if name == "planar-two-link" else paper_arm()
    plant, steps = robot.plant(inductance=name == "coil"), 12
    x, u = (np.array([value]) for value in robot.operating_point(0.4 * np.ones(len(robot.joint_names))))
    x = np.hstack([x, np.zeros((1, plant.n - x.shape[1]))])
    if name == "coil":
        x[0, 4] = -plant.derivative(x[0], u[0])[4] / plant.linearise(x[0], u[0])[0][4, 4]
    p = plant.parameters.vector()[None, :]
    later, slope = near_equilibrium(plant, 1e-3, steps, x, u, p)
    exact, by = one_period(plant, 1e-3, steps, x, u, p)
    assert np.allclose(later, x, atol=1e-12)
    assert np.allclose(exact, x, atol=1e-12)
    assert np.allclose(slope, by[:, :, : slope.shape[2]], rtol=1e-11, atol=1e-13)


def test_a_singular_system_has_no_solution_and_the_others_have() -> None:
    matrices = np.array([np.eye(2), np.zeros((2, 2)), 2.0 * np.eye(2)])
    found = solved(matrices, np.ones((3, 2)))
    assert np.allclose(found[[0, 2]], [[1.0, 1.0], [0.5, 0.5]])
    assert np.isnan(found[1]).all()
