"""The indefinite Riccati equation and the scaling it is solved in."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import solve_continuous_are

from flexhinf.hinf.linear_part import LinearPart, polish, solve_riccati


@pytest.mark.oracle
@pytest.mark.parametrize("n", [1, 4, 12])
def test_stabilising_solution_equals_scipy_and_has_a_smaller_residual(n):
    rng = np.random.default_rng(n)
    a, b, c = rng.standard_normal((n, n)) / n, rng.standard_normal((n, n + 1)), rng.standard_normal((n, n))
    weights = np.diag([-400.0] + [1.0] * n)
    m, q = -b @ np.linalg.inv(weights) @ b.T, c.T @ c
    rough = solve_riccati(a, m, q)
    assert rough is not None
    found = polish(a, m, q, rough.p)
    assert found is not None
    expected = solve_continuous_are(a, b, q, weights)
    assert found.p.astype(float) == pytest.approx(expected, rel=1e-7, abs=1e-7 * np.abs(expected).max())
    assert found.residual < 1e-13
    assert np.linalg.eigvals(found.closed_loop).real.max() < 0


@pytest.mark.parametrize("excess", [1e-3, 1e-8, 0.0])
def test_no_solution_beyond_blow_up(excess):
    """2 p + 1 + p² m = 0 with m ≥ 0 has no p ≥ 0 that stabilises 1 + m p; with m < 0 it grows like 2/|m|."""
    one = np.ones((1, 1))
    assert solve_riccati(one, excess * one, one) is None
    grown = solve_riccati(one, -1e-8 * one, one)
    assert grown is not None
    assert grown.p[0, 0] == pytest.approx(2e8, rel=1e-6)


def test_no_solution_with_eigenvalues_on_the_axis():
    a, m = -np.eye(2), 2 * np.eye(2)
    assert solve_riccati(a, m, np.eye(2)) is None


def test_scaling_is_exact_and_undone():
    rng = np.random.default_rng(1)
    d = np.array([1e-6, 1.0, 1e4, 1e8])
    a, b, c = rng.standard_normal((4, 4)), rng.standard_normal((4, 2)), 1e5 * rng.standard_normal((3, 4))
    a, b, c = a * d / d[:, None], b / d[:, None], c * d
    scaling, scaled = LinearPart(a, b, np.zeros((4, 0)), c, ()).scaled(1.0)
    as_input, _ = LinearPart(a, np.zeros((4, 0)), b, c, ()).scaled(1.0)
    assert scaling.value == as_input.value  # d and v count alike
    assert np.array_equal(np.log2(scaling.state) % 1, np.zeros(4))
    assert np.log2(scaling.value) % 1 == 0
    sa, sb, sc = scaled.a, scaled.b1, scaled.c
    assert np.abs(sa).max() < 10
    assert 0.01 < np.linalg.norm(sb @ sb.T) / np.linalg.norm(sc.T @ sc) < 100
    assert np.array_equal(sa * scaling.state[:, None] / scaling.state, a)
    assert np.array_equal(sb * scaling.state[:, None] / scaling.value, b)
    assert np.array_equal(sc * scaling.value / scaling.state, c)
