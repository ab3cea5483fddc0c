"""What is read from a plant is the plant: every operation that a certificate takes, against the plant's own numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.certify.box import _parts, box_vertices
from flexhinf.certify.certificate import linear_part, linear_system, quadratic_part
from flexhinf.certify.problem_to_claim import statement_of
from flexhinf.errors import InvalidInput

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
    # At 0, where each function is its slope times its argument.
    along = {"sin": np.cos, "cos": lambda o: -np.sin(o), "exp": np.exp}
    slopes = [along[f.name](f.offset + f.pi_halves * np.pi / 2) for f in claim.functions]
    a, b, g, _ = plant.linearise()
    for read, exact in zip(linear_system(claim, values, slopes), (a, g, b), strict=True):
        np.testing.assert_allclose(read, exact, rtol=1e-12, atol=1e-12)
    # In z = T⁻¹x V_2 is ½ |z|² and r_2 is diagonal, to the 20 bits of T.
    turn, gain, output = np.array(claim.coordinates), linear_part(claim.law, 3), linear_part(claim.penalty, 3)
    p, closed = quadratic_part(claim.value, 3), a + b @ gain
    costs = output.T @ output + gain.T @ np.array(claim.r2) @ gain + p @ g @ g.T @ p / claim.gamma**2
    for matrix in (p, p @ closed + closed.T @ p + costs):
        inside = turn.T @ matrix @ turn
        np.testing.assert_allclose(inside, np.diag(np.diag(inside)), atol=1e-4 * np.abs(inside).max())
    # The terms of the inequality at the one vertex there is: V_x (f + g2 u), ½ |z|² and ½ |g1ᵀV_xᵀ|².
    u, slope = at.law(), np.array(at.slope())
    pushed = [sum(s * g for s, g in zip(slope, column)) for column in zip(*at.disturbance_matrix())]
    expected = [(slope * at.rates(u)).sum(axis=0), at.squared_output(u) / 2, sum(p**2 for p in pushed) / 2]
    np.testing.assert_allclose(_parts(claim, box_vertices(claim), x), expected, rtol=1e-9, atol=1e-12)
    square = sum(at.polynomial(row) ** 2 for row in claim.penalty)
    np.testing.assert_allclose(square, 0.81 * (h**2).sum(1), rtol=1e-9)  # 0.9 times the designed penalty
    for read, exact in zip(at.law(), solution.inputs(x).T, strict=True):
        np.testing.assert_allclose(read, exact, rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize(
    "inside", [lambda a, b: a + 0.3 * np.sin(b), lambda a, b: a + a * b], ids=["function", "product"]
)
def test_functions_of_what_is_no_linear_form_are_refused(inside: Any) -> None:
    plant = fh.Plant(
        lambda x, u, d, p: np.array([-x[0] + 0.2 * np.cos(inside(*x)) - 0.2 + d[0], -x[1] + u[0]]),
        lambda x, u, p: x[:1], states=("a", "b"), inputs=("u",), disturbances=("d",),
    )  # fmt: skip
    problem = plant.with_objective(fh.Penalty((1.0, 1.0), effort=(1.0,)))
    solution = fh.solve_hji(problem, 3.0 * fh.smallest_gamma(problem), 2)
    with refused_with(InvalidInput, "cos"):
        statement_of(solution, None, None)
