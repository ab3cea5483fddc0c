"""γ* against closed forms, 40-digit arithmetic and its definition."""

from __future__ import annotations

import math
from typing import Any

import mpmath
import numpy as np
import pytest
from tests.refusals import refused_with

from flexhinf.errors import NotDetectable, NotStabilisable
from flexhinf.hinf import smallest_gamma
from flexhinf.hinf.linear_part import LinearPart, is_feasible, linear_smallest_gamma
from flexhinf.plant.polynomial_plant import PolynomialPlant


def _linear(a, g1, g2, c, r2: Any = 1.0) -> PolynomialPlant:
    n = len(a)
    unit = np.eye(n, dtype=int)
    f = {tuple(unit[j].tolist()): np.asarray(a, float)[:, j] for j in range(n)}
    h = {tuple(unit[j].tolist()): np.asarray(c, float)[:, j] for j in range(n)}
    return PolynomialPlant(f, g1, g2, h, r2)


def _smallest_eigenvalue(plant: PolynomialPlant, gamma) -> mpmath.mpf:
    """Of P from the stable subspace of the Hamiltonian matrix, in 40 digits; −∞ if there is none."""
    with mpmath.workdps(40):
        a, b1, b2, c = (
            mpmath.matrix(m.tolist())
            for m in (
                plant.f_parts[1],
                plant.g1_parts[0][..., 0],
                plant.g2_parts[0][..., 0],
                plant.h_parts[1],
            )
        )
        n = a.rows
        m = b1 * b1.T / mpmath.mpf(gamma) ** 2 - b2 * mpmath.matrix(plant.r2.tolist()) ** -1 * b2.T
        hamiltonian = mpmath.matrix(2 * n)
        hamiltonian[:n, :n], hamiltonian[:n, n:], hamiltonian[n:, :n], hamiltonian[n:, n:] = (
            a,
            m,
            -c.T * c,
            -a.T,
        )
        values, vectors = mpmath.eig(hamiltonian)
        stable = [i for i in range(2 * n) if values[i].real < -(mpmath.mpf(10) ** -15)]
        if len(stable) != n:
            return -mpmath.inf
        upper, lower = mpmath.matrix(n), mpmath.matrix(n)
        for column, i in enumerate(stable):
            for row in range(n):
                upper[row, column], lower[row, column] = vectors[row, i], vectors[n + row, i]
        p = (lower * upper**-1).apply(mpmath.re)
        return min(mpmath.eigsy((p + p.T) / 2, eigvals_only=True))


@pytest.mark.oracle
def test_the_papers_arm_to_eight_digits_against_forty_digit_arithmetic(arm):
    gamma = smallest_gamma(arm)
    assert gamma == pytest.approx(123.0168, abs=1e-3)
    assert _smallest_eigenvalue(arm.expand(1), gamma * (1 + 1e-9)) > 0
    assert _smallest_eigenvalue(arm.expand(1), gamma * (1 - 1e-9)) < 0


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.parametrize("spread", [2.0, 4.0])
def test_coefficients_over_eight_orders_of_magnitude(spread):
    """Three states, every coefficient of a size of its own; 40 digits say which side γ* lies on."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        shapes = ((3, 3), (3, 1), (3, 1), (2, 3))
        a, b1, b2, c = (
            rng.standard_normal(shape) * 10 ** rng.uniform(-spread, spread, shape) for shape in shapes
        )
        plant = _linear(a, b1, b2, c)
        gamma = smallest_gamma(plant)
        assert _smallest_eigenvalue(plant, gamma * (1 + 1e-8)) > 0, seed
        assert _smallest_eigenvalue(plant, gamma * (1 - 1e-8)) < 0, seed


@pytest.mark.oracle
@pytest.mark.parametrize(("reach", "accuracy"), [(1e-5, 1e-8), (1e-7, 1e-7), (1e-9, 1e-6)])
def test_an_unstable_mode_almost_out_of_reach(reach, accuracy):
    plant = _linear([[1.0, 0], [0.3, -1]], [[1], [0.5]], [[reach], [1]], np.eye(2))
    gamma = smallest_gamma(plant)
    assert _smallest_eigenvalue(plant, gamma * (1 + accuracy)) > 0
    assert _smallest_eigenvalue(plant, gamma * (1 - accuracy)) < 0


def test_scales_beyond_whole_numbers_are_no_warning():
    """SciPy's, of a cast of the scales that balance the matrix."""
    assert smallest_gamma(_linear([[0.5, 1], [0, 0.3]], np.eye(2), [[1], [1e-13]], np.eye(2))) > 1e13


@pytest.mark.quick_cases(2)
@pytest.mark.oracle
@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("distance", [1e-8, 3e-9, 1e-9])
def test_two_unstable_modes_almost_as_one_to_the_input(distance, turned):
    """One input reaches their sum; their difference only through the distance of the modes."""
    a, b = np.array([[0.5, 0, 0], [0, 0.5 + distance, 1], [0, 0, -1]]), np.ones((3, 1))
    turn = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0] if turned else np.eye(3)
    plant = _linear(turn @ a @ turn.T, np.eye(3), turn @ b, np.eye(3))
    gamma, accuracy = smallest_gamma(plant), 3e-15 / distance
    assert _smallest_eigenvalue(plant, gamma * (1 + accuracy)) > 0
    assert _smallest_eigenvalue(plant, gamma * (1 - accuracy)) < 0


@pytest.mark.oracle
@pytest.mark.parametrize(
    ("a", "b", "r"), [(-1.0, 1.0, 1.0), (2.0, 0.5, 3.0), (0.0, 1.0, 0.1), (-1e3, 1e2, 1e-3)]
)
def test_scalar_plant(a, b, r):
    """2 a p + 1 + p²(1/γ² − b²/r) = 0: the discriminant a² − m vanishes, or m reaches 0 for a ≥ 0."""
    m = a * a if a < 0 else 0.0
    expected = 1 / math.sqrt(b * b / r + m)
    assert smallest_gamma(_linear([[a]], [[1.0]], [[b]], [[1.0]], r)) == pytest.approx(expected, rel=1e-8)


@pytest.mark.oracle
def test_eigenvalues_on_the_axis_are_seen():
    """A lightly damped mode without input authority: γ* is the peak of its transfer function."""
    zeta = 0.01
    plant = _linear([[0, 1], [-1, -2 * zeta]], [[0], [1]], [[0], [1e-9]], [[1, 0]])
    peak = 1 / (2 * zeta * math.sqrt(1 - zeta**2))
    assert smallest_gamma(plant) == pytest.approx(peak, rel=1e-7)


def test_no_path_from_disturbance_to_output_gives_zero():
    a = [[-1.0, 0, 0], [0.3, -2, 0], [0.1, 0.2, -3]]
    assert smallest_gamma(_linear(a, [[0], [0], [1.0]], [[1.0], [0], [0]], [[1.0, 0, 0], [0, 1, 0]])) == 0.0
    assert smallest_gamma(_linear(a, np.zeros((3, 1)), [[1.0], [0], [0]], np.eye(3))) == 0.0
    assert smallest_gamma(_linear(a, [[0], [1e-6], [0]], [[1.0], [0], [0]], np.eye(3))) > 0


def test_units_do_not_matter():
    rng = np.random.default_rng(5)
    a, b1, b2 = rng.standard_normal((4, 4)), rng.standard_normal((4, 2)), rng.standard_normal((4, 1))
    plain = smallest_gamma(_linear(a, b1, b2, np.eye(4)))
    d = np.array([1e-4, 1, 1e3, 1e5])
    scaled = smallest_gamma(_linear(a * d / d[:, None], b1 / d[:, None], b2 / d[:, None], np.diag(d)))
    assert scaled == pytest.approx(plain, rel=1e-8)


def test_mode_out_of_reach_is_named():
    plant = _linear([[-1, 0], [0, 0.25]], [[1], [1]], [[1], [0]], np.eye(2))
    with refused_with(NotStabilisable, 0.25, "'x2'"):
        smallest_gamma(plant)


def test_double_integrator_without_weight_is_named():
    plant = _linear([[-1, 0, 0], [0, 0, 1], [0, 0, 0]], np.eye(3), np.eye(3), [[1, 0, 0]], np.eye(3))
    with pytest.raises(NotDetectable, match="'x2'"):
        smallest_gamma(plant)


@pytest.mark.ci("forty digits at seven levels")
@pytest.mark.oracle
def test_feasible_is_what_forty_digits_say(arm):
    linear = LinearPart.of(arm.expand(1))
    for gamma in (50.0, 123.0, 123.0167, 123.0169, 124.0, 1e4, float("inf")):
        wanted = gamma == float("inf") or bool(_smallest_eigenvalue(arm.expand(1), gamma) > 0)
        assert is_feasible(linear, gamma) is wanted


def test_feasible_levels_are_all_those_above_one(random_plant):
    for seed in range(5):
        linear = LinearPart.of(random_plant(np.random.default_rng(seed), 3).expand(1))
        star = linear_smallest_gamma(linear)
        assert is_feasible(linear, star * (1.0 + 1e-6))
        assert not is_feasible(linear, star * (1.0 - 1e-6))
        assert [is_feasible(linear, share * star) for share in (0.1, 0.9, 1.1, 10.0)] == [
            False,
            False,
            True,
            True,
        ]


def test_a_rough_level_is_rough_and_never_too_low(arm):
    linear = LinearPart.of(arm.expand(1))
    star = linear_smallest_gamma(linear)
    for width in (1e-1, 1e-3, 1e-6):
        rough = linear_smallest_gamma(linear, width)
        assert star * (1.0 - 1e-9) <= rough <= star * (1.0 + width)
