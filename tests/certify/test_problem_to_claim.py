"""What is read from a plant is the plant: every operation that a certificate takes, against the plant's own numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.certify.problem_to_claim import statement_of

from .definition import Definition

pytestmark = pytest.mark.oracle


def flow(x: Any, u: Any, d: Any, p: Any) -> Any:
    """Sums, twice, negatives, squares, powers, products, quotients by parameters, and functions of linear forms."""
    a, b, c = x
    return np.array(
        [
            -(a + a) + b * b - 0.25 * a**3 + p.push / (p.mass * p.length**2) * np.sin(0.5 * a - b),
            a * b * c / p.mass + (1 / p.length**2) * (c - a) - b + u[0] / p.mass + d[1],
            -c + (a - b) ** 2 + b * np.cos(c) + u[1] + d[0] * 0.5 + (a + b) * 3 - np.exp(0.1 * c) + 1.0,
        ]
    )


def test_every_term_is_read_as_it_runs() -> None:
    plant = fh.Plant(
        flow, lambda x, u, p: x[:2], states=("a", "b", "c"), inputs=("u", "v"), disturbances=("d", "e"),
        parameters={"mass": 1.25, "length": 0.8, "push": 0.3},
    )  # fmt: skip
    problem = plant.with_objective(fh.Penalty((1.0, 2.0, 0.5), effort=(1.0, 2.0)))
    solution = fh.solve_hji(problem, 3.0 * fh.smallest_gamma(problem), 2)
    claim = statement_of(solution, None, None)
    values = {p.name: p.middle for p in claim.parameters}
    x = np.random.default_rng(0).uniform(-1.5, 1.5, (30, 3))

    def bracket(claim: Any, number: int, x: list[Any]) -> Any:
        function = claim.functions[number]
        phi, o = getattr(np, function.name), function.offset + function.pi_halves * np.pi / 2
        return phi(o + sum(a * state for a, state in zip(function.slope, x))) - phi(o)

    at = Definition(claim, list(x.T), values, float, bracket)
    f, g1, g2, h = solution.exact_fields(x)
    for i in range(3):
        np.testing.assert_allclose(at.terms(claim.drift[i]) + 0 * x[:, 0], f[:, i], rtol=1e-12, atol=1e-12)
        for read, exact in ((claim.g1, g1), (claim.g2, g2)):
            for j in range(2):
                np.testing.assert_allclose(
                    at.terms(read[i][j]) + 0 * x[:, 0], exact[:, i, j], rtol=1e-12, atol=1e-13
                )
    square = sum(at.polynomial(row) ** 2 for row in claim.penalty)
    np.testing.assert_allclose(square, 0.81 * (h**2).sum(1), rtol=1e-9)  # 0.9 times the designed penalty
    for read, exact in zip(at.law(), solution.inputs(x).T, strict=True):
        np.testing.assert_allclose(read, exact, rtol=1e-11, atol=1e-12)
