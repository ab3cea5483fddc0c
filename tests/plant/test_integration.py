import math
import re

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from flexhinf.codegen import DIRECT
from flexhinf.errors import InvalidInput
from flexhinf.plant import eight_stages, rk4_step, sub_steps
from flexhinf.plant.integration import SIMULATION_STEP


def test_on_a_linear_system_it_is_the_exponential_to_order_four():
    a = np.array([[0.0, 1.0], [-4.0, -0.3]])
    h = 0.1
    step = np.column_stack([rk4_step(lambda x, v: a @ x, e, (None,) * 3, h) for e in np.eye(2)])
    taylor = sum(np.linalg.matrix_power(h * a, k) / f for k, f in enumerate([1.0, 1.0, 2.0, 6.0, 24.0]))
    np.testing.assert_allclose(step, taylor, rtol=1e-14)
    np.testing.assert_allclose(step, expm(h * a), atol=(h * 2.0) ** 5 / 50)


@pytest.mark.oracle
def test_order_four_with_inputs_that_change():
    def flow(x, v):
        return np.array([x[1], -np.sin(x[0]) + v])

    exact = solve_ivp(
        lambda t, x: flow(x, np.cos(3 * t)), (0.0, 1.0), [0.3, 0.0], "DOP853", rtol=1e-13, atol=1e-14
    )
    errors = []
    for steps in (20, 40, 80):
        x, h = np.array([0.3, 0.0]), 1.0 / steps
        for k in range(steps):
            x = rk4_step(flow, x, np.cos(3 * h * (k + np.array([0.0, 0.5, 1.0]))), h)
        errors.append(np.abs(x - exact.y[:, -1]).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(np.abs(orders - 4.0) < 0.2)


def eight(flow, x, step):
    return eight_stages(DIRECT, flow, x, step)


def test_eight_stages_on_a_linear_system_are_the_exponential_to_order_eight():
    a = np.array([[0.0, 1.0], [-4.0, -0.3]])
    h = 0.5
    taylor = sum(np.linalg.matrix_power(h * a, k) / math.factorial(k) for k in range(9))
    np.testing.assert_allclose(eight(lambda x: a @ x, np.eye(2), h), taylor, rtol=1e-14, atol=1e-15)


@pytest.mark.oracle
def test_eight_stages_have_order_four():
    """Of a flow that bends with both components."""

    def flow(x):
        return np.array([x[1], -np.sin(x[0]) - 0.3 * x[0] * x[1] ** 2])

    exact = solve_ivp(lambda t, x: flow(x), (0.0, 2.0), [1.3, 0.4], "DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    errors = []
    for steps in (4, 8, 16):
        x = np.array([1.3, 0.4])
        for _ in range(steps):
            x = eight(flow, x, 2.0 / steps)
        errors.append(np.abs(x - exact).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(orders > 3.8)


def test_no_vibration_grows_in_eight_stages():
    for angle in np.linspace(0.01, 3.39, 40):
        a = angle * np.array([[0.0, 1.0], [-1.0, 0.0]])
        factor = np.linalg.eigvals(eight(lambda x, a=a: a @ x, np.eye(2), 1.0))
        assert np.abs(factor).max() <= 1.0 + 1e-15
        assert angle > 1.25 or np.abs(factor - np.exp([1j * angle, -1j * angle])).min() < 1.7e-5 * angle


def test_sub_steps():
    assert sub_steps(1e-3, 99.0) == 10
    assert sub_steps(1e-3, 100.0, largest=0.25) == 1
    assert sub_steps(1e-3, 0.0) == 1
    assert sub_steps(1.0, 10 * SIMULATION_STEP) == 10


@pytest.mark.parametrize("mode", [np.nan, np.inf, 1e9])
def test_hopelessly_fast_plants_are_refused(mode):
    with pytest.raises(InvalidInput, match=re.escape(f" {mode:g} rad/s")):
        sub_steps(1e-3, mode)
