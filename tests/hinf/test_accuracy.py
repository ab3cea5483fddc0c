"""V near γ*: its coefficients against fifty-digit arithmetic, and what the solution says about them."""

from __future__ import annotations

import re
from itertools import pairwise
from typing import Any

import mpmath
import numpy as np
import pytest
from tests.refusals import refused_with

from flexhinf.errors import NumericalFailure
from flexhinf.hinf import smallest_gamma, solve_hji
from flexhinf.hinf.linear_part import LinearPart, ScaledProblem
from flexhinf.hinf.recursion import equation_residuals
from flexhinf.plant.polynomial_plant import PolynomialPlant
from flexhinf.polynomial import basis

Polynomial = dict[tuple[int, ...], Any]


def _exact(values: np.ndarray) -> np.ndarray:
    return np.vectorize(lambda value: mpmath.mpf(float(value)), otypes=[object])(values)


def _polynomial(parts: dict[int, np.ndarray], n: int) -> Polynomial:
    """{exponents: array of mpf}, zero coefficients left out."""
    return {
        tuple(key): _exact(part[..., i])
        for k, part in parts.items()
        for i, key in enumerate(basis.exponents(n, k).tolist())
        if part[..., i].any()
    }


def _times(left: Polynomial, right: Polynomial, top: int) -> Polynomial:
    total: Polynomial = {}
    for a, p in left.items():
        for b, q in right.items():
            if sum(a) + sum(b) <= top:
                key = tuple(i + j for i, j in zip(a, b, strict=True))
                total[key] = total.get(key, 0) + p @ q
    return total


def _stable_solution(a: np.ndarray, m: np.ndarray, q: np.ndarray) -> np.ndarray:
    """P from the stable eigenvectors of the Hamiltonian matrix."""
    n = len(a)
    values, vectors = mpmath.eig(mpmath.matrix(np.block([[a, m], [-q, -a.T]]).tolist()))
    stable = [i for i in range(2 * n) if values[i].real < 0]
    assert len(stable) == n
    graph = mpmath.matrix([[vectors[row, i] for i in stable] for row in range(2 * n)])
    p = (graph[n:, :] * graph[:n, :] ** -1).apply(mpmath.re)
    return np.array(((p + p.T) / 2).tolist())


def _moves(a: np.ndarray, n: int, k: int) -> mpmath.matrix:
    """The matrix of V_k ↦ V_k,x A x over the monomials of degree k."""
    keys = [tuple(key) for key in basis.exponents(n, k).tolist()]
    place = {key: i for i, key in enumerate(keys)}
    matrix = mpmath.matrix(len(keys))
    for column, key in enumerate(keys):
        for i in np.flatnonzero(key):
            for j in range(n):
                target = tuple(e - (r == i) + (r == j) for r, e in enumerate(key))
                matrix[place[target], column] += key[i] * a[i, j]
    return matrix


def _fifty_digits(plant: PolynomialPlant, gamma: float, degree: int) -> dict[int, np.ndarray]:
    """Coefficients of V_k in the order of `basis.exponents`; dense, written out, nothing shared with the solver."""
    with mpmath.workdps(50):
        n, level = len(plant.state_names), mpmath.mpf(float(gamma))
        f, g1, g2, h = (
            _polynomial(part, n) for part in (plant.f_parts, plant.g1_parts, plant.g2_parts, plant.h_parts)
        )
        price = np.array(mpmath.inverse(mpmath.matrix(plant.r2.tolist())).tolist())
        a, b1, b2 = (
            _exact(part) for part in (plant.f_parts[1], plant.g1_parts[0][..., 0], plant.g2_parts[0][..., 0])
        )
        c = _exact(plant.h_parts[1])
        m = b1 @ b1.T / level**2 - b2 @ price @ b2.T
        p = _stable_solution(a, m, c.T @ c)
        rows, columns = np.triu_indices(n)
        found = {2: np.array([p[i, j] / (2 if i == j else 1) for i, j in zip(rows, columns, strict=True)])}
        slope: Polynomial = {}
        for k in range(3, degree + 1):
            for key, c_k in zip(map(tuple, basis.exponents(n, k - 1).tolist()), found[k - 1], strict=True):
                for j in np.flatnonzero(key):
                    lower = tuple(e - (r == j) for r, e in enumerate(key))
                    slope.setdefault(lower, _exact(np.zeros(n)))[j] += key[j] * c_k
            w1, w2 = _times(slope, g1, k - 1), _times(slope, g2, k - 1)
            priced = {key: -w @ price / 2 for key, w in w2.items()}
            terms = [_times(slope, f, k), _times(priced, w2, k)]
            terms += [_times({key: v / 2 for key, v in h.items()}, h, k)]
            terms += [_times({key: v / (2 * level**2) for key, v in w1.items()}, w1, k)]
            keys = map(tuple, basis.exponents(n, k).tolist())
            known = [-sum(term.get(key, 0) for term in terms) for key in keys]
            found[k] = np.array(list(mpmath.lu_solve(_moves(a + m @ p, n, k), mpmath.matrix(known))))
        return found


@pytest.mark.quick_cases(2)
@pytest.mark.oracle
@pytest.mark.parametrize(
    ("seed", "excess"), [(0, 1e-4), (2, 1e-2), (2, 1e-4), (2, 1e-6), (1, 1e-4), (1, 1e-8)]
)
def test_every_degree_near_the_smallest_level_is_as_accurate_as_it_says(random_plant, seed, excess):
    """P without bound (seeds 0, 2) and eigenvalues on the imaginary axis (seed 1): error, its estimate, residual."""
    plant = random_plant(np.random.default_rng(seed), 3)
    gamma = (1 + excess) * smallest_gamma(plant)
    solution, exact = solve_hji(plant, gamma, 5), _fifty_digits(plant, gamma, 5)
    for record in solution.records:
        reference = exact[record.degree]
        apart = np.abs(solution.coefficient_array(record.degree) - reference).max()
        error = float(apart / np.abs(reference).max())
        assert error <= 1e-13 / excess, record
        assert error <= 3 * record.error <= 1e-10 / excess, record
        assert record.residual <= 1e-12, record
    if excess <= 1e-8:
        assert re.search("warning: .*degree 3, 4, 5", solution.report())
    if excess >= 1e-4:
        assert "warning" not in solution.report()


def test_what_the_data_do_not_determine_is_refused(monkeypatch, arm):
    """The limit itself is met so close to γ* that γ* is not known well enough to test it: another limit is set."""
    from flexhinf.hinf import recursion as accuracy

    gamma = smallest_gamma(arm) * (1 + 1e-8)
    errors = {record.degree: record.error for record in solve_hji(arm, gamma, 4).records}
    monkeypatch.setattr(accuracy, "_LARGEST_ERROR", (errors[2] + errors[4]) / 2)
    with refused_with(NumericalFailure, "degree 4", "determined", "degree 3"):
        solve_hji(arm, gamma, 4)
    assert solve_hji(arm, gamma, 3).degree == 3


def test_the_residual_is_that_of_the_equation_and_sees_a_wrong_coefficient(random_plant):
    """One coefficient of one degree changed by 1e-6: its degree and those above have such a residual, no other has."""
    plant = random_plant(np.random.default_rng(4), 3)
    gamma = 2 * smallest_gamma(plant)
    scaling, _ = LinearPart.of(plant).scaled(gamma)
    problem = ScaledProblem.of(plant, gamma, 5, scaling)
    solution = solve_hji(plant, gamma, 5)
    value = {}
    for k, part in solution.value_parts.items():
        powers = np.prod(scaling.state ** solution.exponents(k), axis=1)
        value[k] = part * powers / basis.multiplicity(3, k) / scaling.value**2
    right = equation_residuals(problem, value)
    assert max(right.values()) < 1e-13
    for wrong in (2, 3, 4, 5):
        largest = np.argmax(np.abs(value[wrong]))
        changed = {**value, wrong: value[wrong] * (1 + 1e-6 * np.eye(len(value[wrong]))[largest])}
        residuals = equation_residuals(problem, changed)
        assert all(residuals[k] < 1e-13 for k in range(2, wrong))
        assert all(1e-9 < residuals[k] < 1e-4 for k in range(wrong, 6))


def test_bounded_states_give_the_same_solution(monkeypatch, random_plant):
    """Far above γ* both choices of states are good; the estimate of a large problem is of their difference's size."""
    from flexhinf.hinf import hji

    plant = random_plant(np.random.default_rng(7), 4)
    gamma = 3 * smallest_gamma(plant)
    plain = solve_hji(plant, gamma, 5)
    monkeypatch.setattr(hji, "_LARGE_P", (0.0, 0.0))
    bounded = solve_hji(plant, gamma, 5)
    assert bounded.condition != plain.condition
    for k in range(2, 6):
        size = np.abs(plain.coefficient_array(k)).max()
        assert bounded.coefficient_array(k) == pytest.approx(plain.coefficient_array(k), abs=1e-13 * size)


def test_errors_grow_towards_the_smallest_level(random_plant):
    plant = random_plant(np.random.default_rng(2), 3)
    star = smallest_gamma(plant)
    errors = [solve_hji(plant, star * (1 + x), 4).records[-1].error for x in (1.0, 1e-2, 1e-4, 1e-6, 1e-8)]
    assert all(far < near for far, near in pairwise(errors))
