"""The recursion against routes that share nothing with it."""

from __future__ import annotations

import math
import re

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.linalg import solve_continuous_are

from flexhinf.errors import InfeasibleGamma, InvalidInput, NotDetectable
from flexhinf.hinf import linear_law, smallest_gamma, solve_hji
from flexhinf.plant.polynomial_plant import PolynomialPlant
from flexhinf.polynomial import basis


@pytest.mark.oracle
def test_degree_two_is_the_care_without_disturbance(arm):
    plant = arm.expand(1)
    expected = solve_continuous_are(
        plant.f_parts[1], plant.g2_parts[0][..., 0], plant.h_parts[1].T @ plant.h_parts[1], plant.r2
    )
    solution = linear_law(arm, math.inf)
    assert pytest.approx(expected, rel=1e-9) == solution.P
    assert pytest.approx(expected, rel=1e-8) == linear_law(arm, 1e7).P


def _scalar(values: np.ndarray, g1: dict, gamma: float, degree: int) -> np.ndarray:
    """V′ through `degree` − 1 for ẋ = Σ values[k] xᵏ + g1(x) d + u, h = x."""
    f = {(k,): [c] for k, c in enumerate(values) if c}
    solution = solve_hji(PolynomialPlant(f, g1, [[1.0]], {(1,): [1.0]}, 1.0), gamma, degree)
    return np.array([k * solution.coefficients(k)[(k,)] for k in range(2, degree + 1)])


@pytest.mark.oracle
@pytest.mark.parametrize("gamma", [1.5, 4.0, math.inf])
def test_scalar_cubic_plant_to_degree_nine(gamma):
    """ẋ = x − x³ + d + u: V_x = (f + √(f² + s x²))/s, s = 1 − 1/γ²."""
    with mpmath.workdps(40):
        s = 1 - 1 / mpmath.mpf(gamma) ** 2
        exact = mpmath.taylor(lambda x: x * (1 - x**2 + mpmath.sqrt((1 - x**2) ** 2 + s)) / s, 0, 8)
    slopes = _scalar(np.array([0, 1, 0, -1.0]), {(0,): [[1.0]]}, gamma, 9)
    assert slopes == pytest.approx([float(c) for c in exact[1:]], rel=1e-12, abs=1e-12)


@pytest.mark.oracle
def test_scalar_plant_with_state_dependent_disturbance_channel():
    """ẋ = u + arctan(x) d, h = x: V_x = x/√(1 − arctan²x/γ²)."""
    gamma = 1.3
    channel = {(k,): [[float(c)]] for k, c in enumerate(mpmath.taylor(mpmath.atan, 0, 9))}
    with mpmath.workdps(40):
        exact = mpmath.taylor(lambda x: x / mpmath.sqrt(1 - (mpmath.atan(x) / gamma) ** 2), 0, 8)
    plant = PolynomialPlant({(1,): [0.0]}, channel, [[1.0]], {(1,): [1.0]}, 1.0)
    assert smallest_gamma(plant) == 0.0
    solution = solve_hji(plant, gamma, 9)
    slopes = [k * solution.coefficients(k)[(k,)] for k in range(2, 10)]
    assert slopes == pytest.approx([float(c) for c in exact[1:]], rel=1e-12, abs=1e-13)


@pytest.mark.oracle
def test_scalar_plant_whose_penalty_and_input_depend_on_the_state():
    """ẋ = u + x²u, h = x + x²/2, γ = ∞: V_x = h/(1 + x²)·√R2."""
    plant = PolynomialPlant(
        {(1,): [0.0]}, [[0.0]], {(0,): [[1.0]], (2,): [[1.0]]}, {(1,): [1.0], (2,): [0.5]}, 4.0
    )
    solution = solve_hji(plant, math.inf, 8)
    exact = mpmath.taylor(lambda x: 2 * (x + x**2 / 2) / (1 + x**2), 0, 7)
    slopes = [k * solution.coefficients(k)[(k,)] for k in range(2, 9)]
    assert slopes == pytest.approx([float(c) for c in exact[1:]], rel=1e-13, abs=1e-13)
    assert solution.law(np.array([0.01])) == pytest.approx([-(0.01 + 0.01**2 / 2) / 2], rel=1e-11)


# A linear problem pulled through a polynomial change of coordinates --------------------------------------


def _times(left: dict, right: dict, top: int) -> dict:
    """Product of two polynomials {exponents: array}, truncated after degree `top`; arrays multiply by @."""
    total: dict = {}
    for a, p in left.items():
        for b, q in right.items():
            if sum(a) + sum(b) <= top:
                key = tuple(map(sum, zip(a, b, strict=True)))
                total[key] = total.get(key, 0) + p @ q
    return total


def _pulled_back(rng: np.random.Generator, n: int, degree: int):
    """ż = Az + B1 d + B2 u, |Cz| in x with z = φ(x) = x + ψ(x); ψ of the later half in the earlier half.

    Then (Dφ)⁻¹ = I − Dψ exactly, so f, g1, g2 and h are polynomials, and V = ½ φᵀPφ.
    """
    a = rng.standard_normal((n, n)) / np.sqrt(n) - 1.2 * np.eye(n)
    b1, b2, c = rng.standard_normal((n, 2)), rng.standard_normal((n, 2)), rng.standard_normal((n, n))
    r2 = np.diag([1.0, 2.0])
    zero, unit, half = (0,) * n, np.eye(n, dtype=int), max(1, n // 2)
    phi = {tuple(unit[j].tolist()): np.eye(n)[:, [j]] for j in range(n)}
    inverse = {zero: np.eye(n)}
    for row in range(half, n):
        for power in (2, 3, 4):
            key = np.bincount(rng.integers(0, half, power), minlength=n)
            weight = 0.5 * rng.standard_normal()
            phi[tuple(key.tolist())] = (
                phi.get(tuple(key.tolist()), np.zeros((n, 1))) + weight * np.eye(n)[:, [row]]
            )
            for j in np.flatnonzero(key):
                slope = tuple((key - unit[j]).tolist())
                change = np.zeros((n, n))
                change[row, j] = weight * key[j]
                inverse[slope] = inverse.get(slope, np.zeros((n, n))) - change
    f = _times(inverse, {k: a @ v for k, v in phi.items()}, degree)
    fields = [_times(inverse, {zero: b}, degree) for b in (b1, b2)]
    h = {k: c @ v for k, v in phi.items()}
    plant = PolynomialPlant(
        {k: v[:, 0] for k, v in f.items()}, *fields, {k: v[:, 0] for k, v in h.items()}, r2
    )
    return plant, phi, (a, b1, b2, c, r2)


def _error_in_polynomial_coordinates(seed: int, n: int, degree: int) -> float:
    """Largest error of any coefficient of V, relative to the largest coefficient through its degree."""
    plant, phi, (a, b1, b2, c, r2) = _pulled_back(np.random.default_rng(seed), n, degree)
    gamma = 1.5 * smallest_gamma(plant)
    weights = np.zeros((4, 4))
    weights[:2, :2], weights[2:, 2:] = -(gamma**2) * np.eye(2), r2
    p = solve_continuous_are(a, np.hstack([b1, b2]), c.T @ c, weights)
    expected = _times({k: v.T for k, v in phi.items()}, {k: p @ v / 2 for k, v in phi.items()}, degree)
    solution = solve_hji(plant, gamma, degree)
    largest = error = 0.0
    for k in range(2, degree + 1):
        exact = np.zeros(basis.count(n, k))
        for key in (key for key in expected if sum(key) == k):
            exact[basis.rank(n, np.repeat(np.arange(n), key)[None])] = expected[key].item()
        largest = max(largest, np.abs(exact).max())
        error = max(error, np.abs(solution.coefficient_array(k) - exact).max() / largest)
    return error


@pytest.mark.oracle
@pytest.mark.property
@settings(max_examples=settings.default.max_examples // 4)
@given(st.integers(0, 10**6), st.integers(2, 12), st.integers(2, 8))
def test_linear_problem_in_polynomial_coordinates(seed, n, degree):
    """Small ones of the family of the next test."""
    while basis.count(n, degree) > 200:
        degree -= 1
    assert _error_in_polynomial_coordinates(seed, n, degree) <= 1e-10


@pytest.mark.ci("large ones of the family")
@pytest.mark.oracle
@pytest.mark.property
@given(st.integers(0, 10**6), st.integers(2, 12), st.integers(2, 8))
def test_large_linear_problem_in_polynomial_coordinates(seed, n, degree):
    """Exact in any dimension and to any degree, with g1(x), g2(x), h(x); large sizes are drawn smaller.

    The error is 1e-15 to 1e-14 as a rule; the bound leaves room for draws that are ill-conditioned themselves.
    """
    while basis.count(n, degree) > 5_000:
        degree -= 1
    assert _error_in_polynomial_coordinates(seed, n, degree) <= 1e-10


@pytest.mark.ci("a solve of 12 states to degree 8")
@pytest.mark.oracle
def test_twelve_states_to_degree_eight():
    """The corner of that family: 75 582 coefficients of degree 8."""
    assert _error_in_polynomial_coordinates(0, 12, 8) <= 1e-12


# Dense and high-precision twins --------------------------------------------------------------------------


@pytest.mark.oracle
@pytest.mark.parametrize(("n", "degree"), [(2, 5), (3, 4)])
def test_the_equation_vanishes_in_every_coefficient(random_plant, n, degree):
    """Insert V into Eq. (8) with every product written out over dense monomials: degrees 2 … d vanish."""
    plant = random_plant(np.random.default_rng(n), n)
    gamma = 2 * smallest_gamma(plant)
    solution = solve_hji(plant, gamma, degree)
    value = {k: c for j in range(2, degree + 1) for k, c in solution.coefficients(j).items()}

    def polynomial(parts):
        return {
            tuple(e): part[..., i]
            for k, part in parts.items()
            for i, e in enumerate(basis.exponents(n, k).tolist())
        }

    slope: dict = {}
    for key, coefficient in value.items():
        for j in np.flatnonzero(key):
            lower = tuple(e - (i == j) for i, e in enumerate(key))
            slope.setdefault(lower, np.zeros((1, n)))[0, j] += key[j] * coefficient
    f, g1, g2, h = (polynomial(p) for p in (plant.f_parts, plant.g1_parts, plant.g2_parts, plant.h_parts))
    w1, w2 = _times(slope, g1, degree), _times(slope, g2, degree)
    inverse = np.linalg.inv(plant.r2)
    terms = [
        _times(slope, {k: v[:, None] for k, v in f.items()}, degree),
        _times({k: v[None] / 2 for k, v in h.items()}, {k: v[:, None] for k, v in h.items()}, degree),
        _times({k: v / (2 * gamma**2) for k, v in w1.items()}, {k: v.T for k, v in w1.items()}, degree),
        _times({k: -v @ inverse / 2 for k, v in w2.items()}, {k: v.T for k, v in w2.items()}, degree),
    ]
    largest = max(abs(v.item()) for term in terms for v in term.values())
    for key in {k for term in terms for k in term}:
        assert abs(sum(term[key].item() for term in terms if key in term)) < 1e-12 * largest


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.parametrize(("degree", "bound"), [(4, 1e-12), (6, 1e-11)])
def test_the_papers_arm_against_sixty_digits(arm, degree, bound):
    gamma = 2 * smallest_gamma(arm)
    exact = _sixty_digit_coefficients(gamma, degree)
    solution = solve_hji(arm, gamma, degree)
    for k in range(2, degree + 1, 2):
        largest = max(abs(v) for v in exact[k].values())
        error = max(abs(solution.coefficients(k)[key] - v) for key, v in exact[k].items())
        assert error / largest <= bound


def _sixty_digit_coefficients(gamma: float, degree: int) -> dict[int, dict[tuple[int, ...], mpmath.mpf]]:
    """V of the paper's arm: Newton for degree 2, then refinement of dense float solves, in 60 digits."""
    with mpmath.workdps(60):
        mp = mpmath.matrix
        a = mp(5)
        a[0, 1] = a[2, 3] = a[4, 0] = 1
        a[1, 0], a[1, 2], a[3, 0], a[3, 2], a[3, 3] = -mpmath.mpf("109.8"), 100, 100, -100, -1
        a[1, 0] = mpmath.mpf(-9.8) - 100  # the double the plant holds, so that both solve the same problem
        m = mp(5)
        m[4, 4], m[3, 3] = 1 / mpmath.mpf(gamma) ** 2, -(mpmath.mpf(0.9) ** 2) / 10
        q = mpmath.diag([3600, 0, 0, 0, 90000])
        p = _newton(a, m, q, gamma)
        closed = a + m * p
        value = {2: {}}
        for i in range(5):
            for j in range(i, 5):
                value[2][_pair(i, j)] = p[i, j] / (2 if i == j else 1)
        for k in range(4, degree + 1, 2):
            value[k] = _refined(closed, _known_terms(value, m, k), k)
        return value


def _pair(*indices: int) -> tuple[int, ...]:
    return tuple(indices.count(i) for i in range(5))


def _newton(a, m, q, gamma):
    from scipy.linalg import solve_continuous_are

    b = np.array([[0, 0], [0, 0], [0, 0], [0, 0.9], [-1.0, 0]])
    start = solve_continuous_are(
        np.array(a.tolist(), float), b, np.array(q.tolist(), float), np.diag([-(gamma**2), 10.0])
    )
    p, identity = mpmath.matrix(start.tolist()), mpmath.eye(5)
    for _ in range(5):
        residual = a.T * p + p * a + q + p * m * p
        closed = a + m * p
        kronecker = mpmath.matrix(25)
        for i in range(5):
            for j in range(5):
                for r in range(5):
                    kronecker[5 * i + j, 5 * r + j] += closed[r, i] * identity[0, 0]
                    kronecker[5 * i + j, 5 * i + r] += closed[r, j]
        right = mpmath.matrix([-residual[i, j] for i in range(5) for j in range(5)])
        step = mpmath.lu_solve(kronecker, right)
        p = (
            p
            + mpmath.matrix(
                5,
                5,
            )
            + mpmath.matrix([[step[5 * i + j] for j in range(5)] for i in range(5)])
        )
    return (p + p.T) / 2


def _known_terms(value, m, k):
    """V_i,x f_(k+1−i) with the sine's coefficients, and the quadratic terms of the degrees in between."""
    total: dict = {}

    def add(key, number):
        total[key] = total.get(key, mpmath.mpf(0)) + number

    def slope(i, j):
        return {
            tuple(e - (r == j) for r, e in enumerate(key)): key[j] * c
            for key, c in value[i].items()
            if key[j]
        }

    for i in value:
        power = k + 1 - i
        if power >= 3:
            sine = mpmath.mpf(-9.8 * (-1) ** ((power - 1) // 2) / math.factorial(power))
            for key, c in slope(i, 1).items():
                add((key[0] + power, *key[1:]), c * sine)
        other = k + 2 - i
        if i > 2 and other in value:
            for j in (3, 4):
                right = slope(other, j)
                for a, p in slope(i, j).items():
                    for b, q in right.items():
                        add(tuple(map(sum, zip(a, b, strict=True))), p * q * m[j, j] / 2)
    return total


def _refined(closed, known, k):
    """Solve V_x A x = −r over plain monomials: float LU, residuals in 60 digits."""
    keys = [tuple(e) for e in basis.exponents(5, k).tolist()]
    place = {key: i for i, key in enumerate(keys)}
    entries = []
    for column, key in enumerate(keys):
        for i in np.flatnonzero(key):
            for j in range(5):
                moved = tuple(e - (r == i) + (r == j) for r, e in enumerate(key))
                entries.append((place[moved], column, key[i] * closed[int(i), j]))
    dense = np.zeros((len(keys), len(keys)))
    for row, column, number in entries:
        dense[row, column] += float(number)
    solution = [mpmath.mpf(0)] * len(keys)
    for _ in range(8):
        residual = [-known.get(key, mpmath.mpf(0)) for key in keys]
        for row, column, number in entries:
            residual[row] -= number * solution[column]
        scale = max(abs(r) for r in residual)
        if scale == 0:
            break
        step = np.linalg.solve(dense, [float(r / scale) for r in residual])
        solution = [s + scale * mpmath.mpf(float(d)) for s, d in zip(solution, step, strict=True)]
    return dict(zip(keys, solution, strict=True))


# Order of the residual -----------------------------------------------------------------------------------


@pytest.mark.oracle
@pytest.mark.parametrize("degree", [2, 4, 6])
def test_residual_on_the_papers_odd_plant_is_of_order_degree_plus_two(arm, degree):
    solution = solve_hji(arm, 2 * smallest_gamma(arm), degree)
    direction = np.random.default_rng(1).standard_normal((50, 5))
    far, near = (np.abs(solution.residual(direction * r)) for r in (0.2, 0.1))
    slopes = np.log2(far / near)
    assert np.median(slopes) == pytest.approx(degree + 2, abs=0.1)
    assert all(not solution.coefficient_array(k).any() for k in range(3, degree + 1, 2))


@pytest.mark.oracle
@pytest.mark.parametrize("degree", [2, 3, 4, 5])
def test_residual_is_of_order_degree_plus_one(random_plant, degree):
    plant = random_plant(np.random.default_rng(7), 3)
    solution = solve_hji(plant, 3 * smallest_gamma(plant), degree)
    direction = np.random.default_rng(2).standard_normal((100, 3))
    far, near = (np.abs(solution.residual(direction * r)) for r in (4e-3, 2e-3))
    assert np.median(np.log2(far / near)) == pytest.approx(degree + 1, abs=0.15)


# Refusals --------------------------------------------------------------------------------------------------


def test_level_below_the_smallest_is_refused_with_it(arm):
    star = smallest_gamma(arm)
    with pytest.raises(InfeasibleGamma, match=r"gamma\* = 123\.0168") as caught:
        solve_hji(arm, 0.999 * star, 4)
    assert caught.value.gamma_star == pytest.approx(star, rel=1e-8)
    assert solve_hji(arm, star * (1 + 1e-6), 2).P[0, 0] > 0


@pytest.mark.parametrize("gamma", [0.0, -1.0, math.nan, True, "2"])
def test_level_must_be_a_positive_number(arm, gamma):
    with pytest.raises(InvalidInput, match="gamma"):
        solve_hji(arm, gamma, 4)


@pytest.mark.parametrize("degree", [1, 0, -2, 2.5, 4.0, math.nan, True, "4", 201, 10**9])
def test_degree_must_be_an_integer_from_two_to_two_hundred(arm, degree):
    with pytest.raises(InvalidInput, match=rf"degree.* 200[\s\S]* got {re.escape(repr(degree))}"):
        solve_hji(arm, math.inf, degree)


def test_a_thing_that_is_no_problem_is_refused():
    with pytest.raises(InvalidInput, match="ndarray"):
        solve_hji(np.eye(3), 2.0, 4)
    with pytest.raises(InvalidInput, match="NoneType"):
        smallest_gamma(None)


def test_penalty_that_leaves_the_integrator_unseen_is_refused(arm):
    plant = arm.expand(3)
    blind = PolynomialPlant.from_parts(
        5, plant.f_parts, plant.g1_parts, plant.g2_parts, {1: np.eye(5)[[0]]}, plant.r2
    )
    with pytest.raises(NotDetectable, match="'x5'"):
        solve_hji(blind, 300.0, 4)
