"""One period with derivatives, against SciPy's integrator."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from flexhinf.paper.rows import one_period
from flexhinf.robot import paper_arm


@pytest.mark.oracle
@pytest.mark.parametrize("coil", [False, True])
def test_a_period_and_its_derivatives(coil: bool) -> None:
    plant, rng, period = paper_arm().plant(inductance=coil), np.random.default_rng(1), 0.01
    n = plant.n
    x, u = rng.normal(size=(3, n)), rng.normal(size=(3, 1))
    p = np.tile(plant.parameters.vector(), (3, 1))
    later, by_state, by_input = one_period(plant, period, 70, x, u, p)
    for k in range(3):

        def end(state: np.ndarray, volts: np.ndarray) -> np.ndarray:
            flow = lambda _, s: plant.derivative(s, volts)  # noqa: E731
            return solve_ivp(flow, (0.0, period), state, rtol=1e-12, atol=1e-13).y[:, -1]

        assert np.allclose(later[k], end(x[k], u[k]), rtol=1e-9, atol=1e-10)
        step = 1e-4
        for i in range(n):
            e = step * np.eye(n)[i]
            slope = (end(x[k] + e, u[k]) - end(x[k] - e, u[k])) / (2 * step)
            assert np.allclose(by_state[k, :, i], slope, atol=1e-6)
        slope = (end(x[k], u[k] + step) - end(x[k], u[k] - step)) / (2 * step)
        assert np.allclose(by_input[k, :, 0], slope, atol=1e-6)
