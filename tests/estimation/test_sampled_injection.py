import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from flexhinf.estimation.output_injection import first_order_hold


def test_of_two_integrators_by_hand():
    t = 0.3
    transition, hold, ramp = first_order_hold(np.array([[0.0, 1.0], [0.0, 0.0]]), t)
    np.testing.assert_allclose(transition, [[1.0, t], [0.0, 1.0]], rtol=1e-15)
    np.testing.assert_allclose(hold, [[t, t**2 / 2], [0.0, t]], rtol=1e-15)
    np.testing.assert_allclose(ramp, [[t / 2, t**2 / 6], [0.0, t / 2]], rtol=1e-15)


@pytest.mark.oracle
@pytest.mark.parametrize("period", [1e-4, 0.05, 2.0])
def test_against_an_integrator(period):
    rng = np.random.default_rng(0)
    a, start, first, last = rng.normal(size=(4, 4)), *rng.normal(size=(3, 4))
    transition, hold, ramp = first_order_hold(a, period)
    moved = transition @ start + hold @ first + ramp @ (last - first)
    run = solve_ivp(
        lambda t, x: a @ x + first + (last - first) * t / period,
        (0.0, period), start, "DOP853", rtol=1e-13, atol=1e-13,
    )  # fmt: skip
    np.testing.assert_allclose(moved, run.y[:, -1], rtol=1e-11)
    np.testing.assert_allclose(transition, expm(a * period), rtol=1e-13)
