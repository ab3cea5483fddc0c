"""Sampled regions: closed forms, monotony, the design table's known row, refusals."""

from __future__ import annotations

import math

import numpy as np
import pytest

from flexhinf.errors import InvalidInput
from flexhinf.hinf import linear_law, smallest_gamma, solve_hji
from flexhinf.plant.polynomial_plant import PolynomialPlant


@pytest.mark.oracle
def test_scalar_region_is_where_the_inequality_changes_sign():
    """ẋ = −x + a x³ + d + u, V = ½ p x²: r vanishes at x² = (p − ½ w² − ½ p² (1/γ² − 1))/(p a)."""
    a, w, gamma = 0.7, 0.5, 3.0
    plant = PolynomialPlant({(1,): [-1.0], (3,): [a]}, [[1.0]], [[1.0]], {(1,): [1.0]}, 1.0)
    solution = linear_law(plant, 2.0)
    check = solution.sampled_region(gamma=gamma, penalty=[w], rays=10)
    p = solution.P[0, 0]
    edge = (p - w**2 / 2 - p**2 * (1 / gamma**2 - 1) / 2) / (p * a)
    assert check.level == pytest.approx(p * edge / 2, rel=1e-5)
    assert check.worst_point[0] ** 2 == pytest.approx(edge, rel=1e-5)
    assert check.limit == "inequality"


@pytest.mark.oracle
def test_region_ends_where_value_stops_increasing():
    """V = c₂ x² − |c₄| x⁴ of a plant that is stable everywhere: the level set closes at V's own maximum."""
    plant = PolynomialPlant({(1,): [-1.0], (3,): [-1.0]}, [[0.0]], [[1.0]], {(1,): [1.0]}, 1.0)
    solution = solve_hji(plant, math.inf, 4)
    c2, c4 = solution.coefficients(2)[(2,)], solution.coefficients(4)[(4,)]
    assert c4 < 0
    check = solution.sampled_region(penalty=[0.0], rays=4)
    assert check.level == pytest.approx(-(c2**2) / (4 * c4), rel=1e-6)


def test_linear_plant_has_no_edge(arm):
    plant = arm.expand(1)
    check = linear_law(plant, 2 * smallest_gamma(plant)).sampled_region(rays=200)
    assert check.level == math.inf
    assert check.limit == "nothing found"
    assert check.step_amplitude("x1", ["x5"]) == math.inf


class _Weighted:
    """The paper's arm with weights on all states (the row of the design table that begins with 65)."""

    def __init__(self, arm):
        self._arm, self.weights = arm, np.array([65.0, 9, 30, 9, 310])
        self.state_names, self.operating_point, self.r2 = arm.state_names, arm.operating_point, arm.r2

    def expand(self, degree):
        plant = self._arm.expand(degree)
        h = {1: np.diag(self.weights)}
        return PolynomialPlant.from_parts(5, plant.f_parts, plant.g1_parts, plant.g2_parts, h, plant.r2)

    def fields(self, x):
        f, g1, g2, _ = self._arm.fields(x)
        return f, g1, g2, x * self.weights


@pytest.fixture(scope="module")
def weighted(arm):
    problem = _Weighted(arm)
    star = smallest_gamma(problem)
    solution = solve_hji(problem, 1.5 * star, 4)
    return solution, solution.sampled_region(gamma=1.6 * star, penalty={"x1": 60.0, "x5": 300.0}, rays=1500)


@pytest.mark.paper
def test_cubic_law_about_hanging_rest_covers_a_large_step(weighted):
    """Rays alone gave 1.80 rad with 20,000 of them, an overestimate by a few per cent."""
    _, check = weighted
    assert 1.6 < check.step_amplitude("x1", ["x5"]) < 1.8


def test_inequality_holds_inside_and_fails_at_the_worst_point(weighted):
    solution, check = weighted
    rng = np.random.default_rng(9)
    x = rng.standard_normal((20_000, 5)) @ np.linalg.cholesky(np.linalg.inv(solution.P)).T
    x *= (rng.random(20_000) ** 0.2 * np.sqrt(2 * check.level) / np.sqrt(((x @ solution.P) * x).sum(1)))[
        :, None
    ]
    inside = x[solution.value(x) < 0.95 * check.level]
    weights = np.array([60.0, 0, 0, 0, 300])

    def inequality(points):
        f, g1, _, _ = solution.exact_fields(points)
        slope, u = solution.gradient(points), solution.law(points)
        drift = (slope * f).sum(1) - (u @ solution.expansion.r2 * u).sum(1) / 2
        d = np.einsum("ai,aij->aj", slope, g1) / check.gamma
        return drift + (((points * weights) ** 2).sum(1) + (d * d).sum(1)) / 2

    assert len(inside) > 10_000
    assert inequality(inside).max() <= 0
    beyond = check.worst_point[None] * np.array([[1 - 1e-4], [1 + 1e-4]])
    low, high = inequality(beyond)
    assert low < 0 < high
    assert solution.value(check.worst_point) == pytest.approx(check.level, rel=1e-4)


@pytest.mark.oracle
def test_step_amplitude_is_where_the_best_start_meets_the_level(weighted):
    from scipy.optimize import minimize_scalar

    solution, check = weighted
    a = check.step_amplitude("x1", ["x5"])

    def lowest(amplitude):
        motor = -amplitude - 0.098 * np.sin(amplitude)
        return minimize_scalar(
            lambda e: float(solution.value(np.array([-amplitude, 0, motor, 0, e]))),
            bounds=(-1, 1),
            method="bounded",
        ).fun

    assert lowest(a) <= check.level * (1 + 1e-9)
    assert lowest(a * 1.02) > check.level
    assert check.step_amplitude({"x1": 2.0}, ["x5"]) == pytest.approx(a / 2, rel=0.02)


def test_relaxing_only_gamma_leaves_no_region_with_the_papers_penalty(arm):
    solution = solve_hji(arm, 2 * smallest_gamma(arm), 4)
    same = solution.sampled_region(penalty=[60.0, 0, 0, 0, 300], rays=500)
    assert same.step_amplitude("x1", ["x5"]) < 0.05
    assert "1.1 times the designed gamma" in same.margin


def test_same_seed_same_answer_and_a_readable_report(weighted):
    solution, check = weighted
    arguments = {"gamma": check.gamma, "penalty": [60.0, 0, 0, 0, 300], "rays": 200, "seed": 3}
    first, second = solution.sampled_region(**arguments), solution.sampled_region(**arguments)
    assert first.level == second.level
    for word in ("not a proof", "1.067 times the designed gamma", "worst point", "inequality"):
        assert word in check.report()


def test_refusals(weighted):
    solution, check = weighted
    with pytest.raises(InvalidInput, match="expected gamma"):
        solution.sampled_region(gamma=0.9 * solution.gamma)
    for wrong in (
        {"rays": 0},
        {"rays": 2.5},
        {"seed": -1},
        {"largest": "far"},
        {"gamma": "2"},
        {"gamma": math.nan},
    ):
        with pytest.raises(InvalidInput, match="cannot be made with these numbers"):
            solution.sampled_region(**wrong)
    with pytest.raises(InvalidInput, match="'heavy'"):
        solution.sampled_region(penalty={"x1": "heavy"})
    with pytest.raises(InvalidInput, match="x9"):
        solution.sampled_region(penalty={"x9": 1.0})
    with pytest.raises(InvalidInput, match=r"shape \(3,\)"):
        solution.sampled_region(penalty=[1.0, 2, 3])
    with pytest.raises(InvalidInput, match="which state moves"):
        check.step_amplitude()
    with pytest.raises(InvalidInput, match="unknown states"):
        check.step_amplitude("q1", ["x5"])
