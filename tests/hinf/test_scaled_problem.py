"""The scaled problem is the problem in other units."""

from __future__ import annotations

import numpy as np
import pytest

from flexhinf.hinf.linear_part import ScaledProblem, Scaling
from flexhinf.polynomial.algebra import evaluate


@pytest.mark.parametrize("gamma", [1.7, np.inf])
def test_terms_of_the_equation_are_those_of_the_plant(random_plant, gamma):
    """At x = D ξ, for a costate p = s² D⁻¹ π: s² times the scaled terms are the plant's own."""
    plant = random_plant(np.random.default_rng(0), 3)
    scaling = Scaling(np.array([0.5, 4.0, 2.0]), 8.0)
    problem = ScaledProblem.of(plant, gamma, 12, scaling)
    rng = np.random.default_rng(1)
    xi, pi = rng.standard_normal((7, 3)), rng.standard_normal((7, 3))
    f, g, q = (evaluate(part, xi) for part in (problem.f, problem.g, problem.q))
    scaled = (pi * f).sum(1) + q + (np.einsum("ai,aij->aj", pi, g) ** 2 @ problem.signs) / 2
    x, costate = xi * scaling.state, pi * scaling.value**2 / scaling.state
    f, g1, g2, h = plant.fields(x)
    w1, w2 = (np.einsum("ai,aij->aj", costate, part) for part in (g1, g2))
    price = (w2 * np.linalg.solve(plant.r2, w2.T).T).sum(1)
    exact = (costate * f).sum(1) + ((h * h).sum(1) + (w1 * w1).sum(1) / gamma**2 - price) / 2
    assert scaling.value**2 * scaled == pytest.approx(exact, rel=1e-11)
    assert len(problem.signs) == (plant.size[1] if np.isfinite(gamma) else 0) + plant.size[2]


def test_penalty_is_cut_after_the_degree_of_the_value(random_plant):
    plant = random_plant(np.random.default_rng(2), 2)
    assert max(ScaledProblem.of(plant, 2.0, 4, Scaling(np.ones(2), 1.0)).q) == 4
