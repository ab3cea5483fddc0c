"""What a solution offers: shapes, definitions, consistency."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest
from tests.refusals import refused_with

from flexhinf.errors import InvalidInput, NumericalFailure
from flexhinf.hinf import linear_law, smallest_gamma, solve_hji
from flexhinf.plant.polynomial_plant import PolynomialPlant


@pytest.fixture(scope="module")
def solved(arm):
    return solve_hji(arm, 2 * smallest_gamma(arm), 4)


@pytest.fixture
def general(random_plant):
    plant = random_plant(np.random.default_rng(3), 3)
    return plant, solve_hji(plant, 3 * smallest_gamma(plant), 4)


@pytest.mark.parametrize("name", ["value", "gradient", "law", "worst_disturbance", "residual"])
def test_a_state_beyond_the_finite_numbers_is_refused(solved, name):
    """Old code returned nan, with a warning of NumPy's."""
    function = getattr(solved, name)
    with refused_with(NumericalFailure, "V", "finite", "[1e+200"):
        function([np.zeros(5), np.full(5, 1e200)])
    with refused_with(InvalidInput, "finite", "(N, 5)", "[0.0, nan"):
        function([0.0, np.nan, 0.0, 0.0, 0.0])


def test_shapes_follow_the_state(solved):
    x = np.random.default_rng(0).standard_normal((7, 5))
    for function, shape in (("value", ()), ("residual", ()), ("gradient", (5,)), ("law", (1,))):
        many, one = getattr(solved, function)(x), getattr(solved, function)(x[2])
        assert many.shape == (7, *shape)
        assert np.shape(one) == shape
        assert many[2] == pytest.approx(one, rel=1e-13)
    assert solved.worst_disturbance(x).shape == (7, 1)
    assert solved.value(np.zeros((0, 5))).shape == (0,)
    with refused_with(InvalidInput, "(5,)", "(N, 5)", "(4,)"):
        solved.law(np.zeros(4))


def test_value_is_the_sum_of_its_monomials(solved):
    x = np.random.default_rng(1).standard_normal(5)
    total = sum(
        c * np.prod(x**e) for k in range(2, 5) for e, c in map(_as_arrays, solved.coefficients(k).items())
    )
    assert solved.value(x) == pytest.approx(total, rel=1e-12)
    assert solved.coefficients(2)[(2, 0, 0, 0, 0)] == pytest.approx(solved.P[0, 0] / 2)
    assert solved.coefficients(2)[(1, 1, 0, 0, 0)] == pytest.approx(solved.P[0, 1])
    assert len(solved.coefficients(4)) == 70
    assert np.array_equal(solved.exponents(4)[0], [4, 0, 0, 0, 0])
    for wrong in (5, 1, "4", 2.5):
        with pytest.raises(InvalidInput, match=rf"\bV .*degree {wrong!r}\."):
            solved.coefficients(wrong)
    with pytest.raises(InvalidInput, match="got 'here'"):
        solved.value("here")


def test_kronecker_coefficients_of_others_go_in_and_come_out():
    """ẋ = A x + F2 (x ⊗ x) + B u + G1 (x ⊗ u) + B1 d, h = C x: V = ½ (v2ᵀ (x⊗x) + v3ᵀ (x⊗x⊗x) + …)."""
    rng = np.random.default_rng(6)
    a, f2 = rng.standard_normal((3, 3)) - 3 * np.eye(3), rng.standard_normal((3, 9))
    b, g1, b1 = rng.standard_normal((3, 2)), rng.standard_normal((3, 6)), rng.standard_normal((3, 1))
    plant = PolynomialPlant.from_kronecker([a, f2], [b1], [b, g1], [np.eye(3)], np.diag([1.0, 2.0]))
    x, u = rng.standard_normal(3), rng.standard_normal(2)
    f, _, g2, _ = plant.fields(x[None])
    expected = a @ x + f2 @ np.kron(x, x) + b @ u + g1 @ np.kron(x, u)
    assert f[0] + g2[0] @ u == pytest.approx(expected, rel=1e-12)
    solution = solve_hji(plant, 3 * smallest_gamma(plant), 3)
    square = np.kron(x, x)
    value = (solution.kronecker(2) @ square + solution.kronecker(3) @ np.kron(x, square)) / 2
    assert solution.kronecker(2).reshape(3, 3) == pytest.approx(solution.P)
    assert value == pytest.approx(solution.value(x), rel=1e-12)
    with pytest.raises(InvalidInput, match=r"got \(3, 6\)"):
        PolynomialPlant.from_kronecker([a, np.ones((3, 6))], [b1], [b], [np.eye(3)], np.eye(2))


def _as_arrays(item):
    return np.array(item[0]), item[1]


def test_gradient_law_disturbance_and_residual_are_their_formulas(general):
    plant, solution = general
    x = 0.3 * np.random.default_rng(2).standard_normal((5, 3))
    step = 1e-6
    slope = np.stack(
        [(solution.value(x + step * e) - solution.value(x - step * e)) / (2 * step) for e in np.eye(3)]
    )
    assert solution.gradient(x) == pytest.approx(slope.T, rel=1e-6, abs=1e-6)
    f, g1, g2, h = plant.fields(x)
    for i, gradient in enumerate(solution.gradient(x)):
        u = -np.linalg.solve(plant.r2, g2[i].T @ gradient)
        d = g1[i].T @ gradient / solution.gamma**2
        assert solution.law(x)[i] == pytest.approx(u, rel=1e-12)
        assert solution.worst_disturbance(x)[i] == pytest.approx(d, rel=1e-12)
        # Eq. (8) is the Hamiltonian at its saddle point
        drift = gradient @ (f[i] + g1[i] @ d + g2[i] @ u)
        saddle = drift + (h[i] @ h[i] + u @ plant.r2 @ u - solution.gamma**2 * d @ d) / 2
        assert solution.residual(x)[i] == pytest.approx(saddle, rel=1e-9, abs=1e-9)


def test_law_as_data_is_the_law_through_its_degree(solved, general):
    x = np.random.default_rng(4).standard_normal(5)
    data = solved.law_polynomial()
    assert data.degrees == (1, 3)
    assert data.coefficients.shape == (1, 40)
    assert data.evaluate(x) == pytest.approx(solved.law(x), rel=1e-12)
    _, solution = general
    direction = np.random.default_rng(5).standard_normal(3)
    errors = [
        np.abs(solution.law(r * direction) - solution.law_polynomial().evaluate(r * direction)).max()
        for r in (2e-2, 1e-2)
    ]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4, abs=0.3)


def test_closed_loop_is_stable_and_attains_the_level(arm):
    """The measured gain of the linear closed loop lies between γ* and γ."""
    star = smallest_gamma(arm)
    solution = linear_law(arm, 1.05 * star)
    plant = arm.expand(1)
    gain = -np.linalg.solve(plant.r2, plant.g2_parts[0][..., 0].T @ solution.P)
    a = plant.f_parts[1] + plant.g2_parts[0][..., 0] @ gain
    c = np.vstack([plant.h_parts[1], np.sqrt(10.0) * gain])
    assert np.linalg.eigvals(a).real.max() < 0
    frequencies = np.r_[0, np.geomspace(1e-2, 1e3, 4000)]
    peak = max(
        np.linalg.norm(c @ np.linalg.solve(1j * w * np.eye(5) - a, plant.g1_parts[0][..., 0]), 2)
        for w in frequencies
    )
    assert star * 0.999 <= peak <= solution.gamma


def test_report_tells_method_residual_and_memory(solved):
    report = solved.report()
    for word in ("Riccati", "parity", "eigenbasis", "cond(T)", "memory"):
        assert word in report
    assert [record.degree for record in solved.records] == [2, 3, 4]
    assert all(record.residual <= 1e-14 for record in solved.records)


def test_the_gain_is_the_slope_of_the_law_at_the_operating_point(solved, general):
    """By central differences of the whole law, of degree 3 and with g2(x) too."""
    for solution in (solved, general[1]):
        n = len(solution.P)
        slope = np.array([(solution.law(1e-5 * e) - solution.law(-1e-5 * e)) / 2e-5 for e in np.eye(n)]).T
        assert solution.gain.shape == slope.shape
        assert solution.gain == pytest.approx(slope, rel=1e-6, abs=1e-7 * np.abs(slope).max())


def test_the_gain_stabilises_and_does_not_depend_on_the_degree(solved, arm):
    plant = solved.expansion
    loop = plant.f_parts[1] + plant.g2_parts[0][..., 0] @ solved.gain
    assert np.linalg.eigvals(loop).real.max() < 0.0
    assert linear_law(arm, solved.gamma).gain == pytest.approx(solved.gain, rel=1e-12)


def test_a_copy_is_whole_and_shares_no_memory_when_deep(solved, general):
    x = np.random.default_rng(8).standard_normal(5)
    solved.law(x)
    for again in (pickle.loads(pickle.dumps(solved)), copy.copy(solved), copy.deepcopy(solved)):
        assert np.array_equal(again.law(x), solved.law(x))
        assert again.report() == solved.report()
    _, solution = general
    twin = copy.deepcopy(solution)
    assert not any(np.shares_memory(part, solution.value_parts[k]) for k, part in twin.value_parts.items())
    with pytest.raises(ValueError, match="read-only"):  # its own copies share it
        twin.value_parts[2][:] = 0.0
