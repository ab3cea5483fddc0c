"""Along a ray every part of V is a power of the radius."""

from __future__ import annotations

import numpy as np
import pytest

from flexhinf.hinf import linear_law, smallest_gamma, solve_hji
from flexhinf.hinf.rays import RayInequality, Rays
from flexhinf.hinf.sampled import PENALTY_MARGIN
from flexhinf.plant.polynomial_plant import PolynomialPlant


@pytest.fixture
def solved(random_plant):
    plant = random_plant(np.random.default_rng(4), 3)
    return solve_hji(plant, 3 * smallest_gamma(plant), 5)


def test_points_on_rays_are_what_the_solution_says_of_them(solved):
    rng = np.random.default_rng(0)
    rays, radius = Rays.of(solved, rng.standard_normal((20, 3))), rng.uniform(0.1, 3.0, 20)
    x, value, slope, radial = rays.at(radius)
    assert np.array_equal(x, rays.direction * radius[:, None])
    assert value == pytest.approx(solved.value(x), rel=1e-12)
    assert slope == pytest.approx(solved.gradient(x), rel=1e-11, abs=1e-12)
    assert radial == pytest.approx((solved.gradient(x) * x).sum(1), rel=1e-11, abs=1e-12)


def test_terms_of_the_designed_pair_add_up_to_the_residual(solved):
    x = 0.3 * np.random.default_rng(1).standard_normal((20, 3))
    terms = RayInequality(solved, solved.gamma, lambda x, h: h).terms(x, solved.gradient(x))
    assert terms.sum(axis=0) == pytest.approx(solved.residual(x), rel=1e-9, abs=1e-12 * np.abs(terms).max())


def test_directions_lie_on_one_level_of_the_quadratic_part_and_back(solved):
    game = RayInequality(solved, solved.gamma, lambda x, h: h)
    sphere = np.random.default_rng(2).standard_normal((9, 3))
    directions = game.directions(sphere)
    assert ((directions @ solved.P) * directions).sum(1) == pytest.approx(np.ones(9), rel=1e-12)
    unit = sphere / np.linalg.norm(sphere, axis=1, keepdims=True)
    assert game.on_sphere(directions) == pytest.approx(unit, rel=1e-10, abs=1e-12)


def test_rays_find_the_edge_and_why():
    """ẋ = −x + x³ + d + u: with nothing penalised, r = −p x² + p x⁴ + ½ p² x² (1/γ² − 1)."""
    plant = PolynomialPlant({(1,): [-1.0], (3,): [1.0]}, [[1.0]], [[1.0]], {(1,): [1.0]}, 1.0)
    solution = linear_law(plant, 2.0)
    p = solution.P[0, 0]
    stops = RayInequality(solution, 4.0, lambda x, h: 0 * h).follow(
        np.array([[1.0], [-2.0]]), np.array([0.01, 0.01]), 1.1, 100.0, np.inf
    )
    edge = np.sqrt(1 - p * (1 / 16 - 1) / 2)
    assert stops.point[:, 0] == pytest.approx([edge, -edge], rel=1e-6)
    assert stops.level == pytest.approx(p * edge**2 / 2, rel=1e-6)
    assert stops.broken.all()
    near = RayInequality(solution, 4.0, lambda x, h: 0 * h).follow(
        np.array([[1.0]]), np.array([0.01]), 1.1, 0.5, np.inf
    )
    assert np.isinf(near.level[0])


def test_few_rays_stop_where_they_do_among_many(solved):
    """Few rays are followed at several radii at once, many at one."""
    inequality = RayInequality(solved, 1.2 * solved.gamma, lambda x, h: 0.9 * h)
    directions = inequality.directions(np.random.default_rng(5).standard_normal((100, len(solved.P))))
    many = inequality.follow(directions, np.full(100, 1e-3), 1.05, 50.0, np.inf)
    stopped = np.flatnonzero(np.isfinite(many.level))
    lowest = stopped[np.argmin(many.level[stopped])]
    for chosen in ([lowest], [lowest, *range(6)]):
        few = inequality.follow(directions[chosen], np.full(len(chosen), 1e-3), 1.05, 50.0, np.inf)
        assert few.level[0] == pytest.approx(many.level[lowest], rel=1e-10)
        assert few.radius[0] == pytest.approx(many.radius[lowest], rel=1e-10)
        assert few.broken[0] == many.broken[lowest]


def test_the_worst_rate_is_the_slope_of_the_residual_in_the_gradient(solved):
    """r is quadratic in V_x, so that differences are exact; the checked level is not the designed one."""
    game = RayInequality(solved, 1.3 * solved.gamma, lambda x, h: h)
    rng = np.random.default_rng(5)
    x, slope = 0.3 * rng.standard_normal((2, 10, 3))
    rate = game.worst_rate(slope, game.checked_fields(x))
    for i, unit in enumerate(np.eye(3)):
        after, before = (game.terms(x, slope + sign * unit).sum(axis=0) for sign in (1.0, -1.0))
        assert rate[:, i] == pytest.approx((after - before) / 2, rel=1e-10, abs=1e-10)


def test_the_margin_is_the_rate_of_r_close_to_the_goal(solved):
    """r ≤ −rate · V there, and equal in its direction: two inputs and three disturbances, another γ."""
    gamma = 1.4 * solved.gamma
    margin = solved.checked_margin(gamma=gamma)
    game = RayInequality(solved, gamma, lambda x, h: PENALTY_MARGIN * h)

    def rates(directions):
        x = 1e-5 * directions / np.linalg.norm(directions, axis=1, keepdims=True)
        return -game.terms(x, solved.gradient(x)).sum(axis=0) / solved.value(x)

    assert margin.rate > 0
    assert rates(margin.direction[None])[0] == pytest.approx(margin.rate, rel=1e-3)
    assert rates(np.random.default_rng(6).standard_normal((200, 3))).min() >= margin.rate * (1 - 1e-3)
