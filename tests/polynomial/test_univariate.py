from __future__ import annotations

import mpmath
import numpy as np
import pytest

from flexhinf.errors import InvalidInput
from flexhinf.polynomial import truncated as univariate

DEGREE = 9
REFERENCE = {
    "sin": mpmath.sin, "cos": mpmath.cos, "tan": mpmath.tan,
    "sinh": mpmath.sinh, "cosh": mpmath.cosh, "tanh": mpmath.tanh,
    "arcsin": mpmath.asin, "arccos": mpmath.acos, "arctan": mpmath.atan,
    "arcsinh": mpmath.asinh, "arccosh": mpmath.acosh, "arctanh": mpmath.atanh,
    "exp": mpmath.exp, "expm1": mpmath.expm1, "log": mpmath.log, "log1p": mpmath.log1p,
    "log10": mpmath.log10, "sqrt": mpmath.sqrt,
}  # fmt: skip
INSIDE = {"arcsin", "arccos", "arctanh", "log1p"}
POSITIVE = {"log", "log10", "sqrt"}


def points(name: str) -> list[float]:
    if name in INSIDE:
        return [-0.9, -0.3, 0.0, 0.55, 0.99]
    if name in POSITIVE:
        return [1e-3, 0.4, 1.0, 30.0]
    if name == "arccosh":
        return [1.01, 2.0, 9.0]
    return [-2.1, -0.5, 0.0, 0.7, 3.0]


def exact(function, x: float, degree: int) -> np.ndarray:
    with mpmath.workdps(60):
        return np.array([float(c) for c in mpmath.taylor(function, mpmath.mpf(x), degree)])


def assert_close(result: np.ndarray, expected: np.ndarray, x: float, tolerance: float = 1e-13) -> None:
    """Errors in units of the size that the coefficients take with this radius of convergence."""
    radius = np.abs(expected).max() ** (1.0 / DEGREE) if np.abs(expected).max() > 1 else 1.0
    scale = np.maximum(np.abs(expected), np.finfo(float).tiny) + radius ** np.arange(len(expected))
    assert (np.abs(result - expected) <= tolerance * scale).all(), (x, result - expected)


def test_every_function_has_a_reference():
    assert set(univariate.FUNCTIONS) == set(REFERENCE)


@pytest.mark.quick_cases(9)
@pytest.mark.oracle
@pytest.mark.parametrize("name", sorted(REFERENCE))
def test_coefficients_are_those_of_mpmath(name):
    for x in points(name):
        assert_close(univariate.FUNCTIONS[name](x, DEGREE), exact(REFERENCE[name], x, DEGREE), x)


@pytest.mark.parametrize("name", sorted(REFERENCE))
def test_a_lower_degree_is_a_prefix(name):
    x = points(name)[0]
    full = univariate.FUNCTIONS[name](x, DEGREE)
    for degree in range(DEGREE):
        np.testing.assert_array_equal(univariate.FUNCTIONS[name](x, degree), full[: degree + 1])


@pytest.mark.oracle
@pytest.mark.parametrize("exponent", [-3, -1, 0, 1, 4, 12, 0.5, -0.5, 2.7])
@pytest.mark.parametrize("x", [0.3, 1.0, 7.0])
def test_powers_are_those_of_mpmath(exponent, x):
    expected = exact(lambda t: t ** mpmath.mpf(exponent), x, DEGREE)
    scale = np.maximum(np.abs(expected), 1e-13 * np.abs(expected).max())
    assert (np.abs(univariate.power(x, exponent, DEGREE) - expected) <= 2e-14 * scale).all()


def test_whole_powers_at_zero_and_below():
    np.testing.assert_array_equal(univariate.power(0.0, 3, 5), [0, 0, 0, 1, 0, 0])
    np.testing.assert_array_equal(univariate.power(0.0, 0, 2), [1, 0, 0])
    np.testing.assert_array_equal(univariate.power(-2.0, 3, 4), [-8, 12, -6, 1, 0])
    np.testing.assert_allclose(univariate.power(-2.0, -1, 3), [-1 / 2, -1 / 4, -1 / 8, -1 / 16], rtol=1e-15)


def test_tanh_far_out_is_flat():
    np.testing.assert_array_equal(univariate.FUNCTIONS["tanh"](800.0, 3), [1, 0, 0, 0])
    np.testing.assert_array_equal(univariate.FUNCTIONS["tanh"](-800.0, 3), [-1, 0, 0, 0])


@pytest.mark.parametrize(
    ("name", "x"),
    [
        ("sqrt", 0.0), ("sqrt", -1.0), ("log", 0.0), ("log", -2.0), ("log10", 0.0), ("log1p", -1.0),
        ("arcsin", 1.0), ("arccos", -1.0), ("arctanh", 1.5), ("arccosh", 1.0),
    ],
)  # fmt: skip
def test_a_point_outside_the_domain_is_refused_by_name(name, x):
    with pytest.raises(InvalidInput) as caught:
        univariate.FUNCTIONS[name](x, 3)
    assert name in caught.value.what
    assert f"got {x:g}" in caught.value.found
    assert caught.value.advice


@pytest.mark.parametrize(
    ("x", "exponent", "name"), [(0.0, -1, "1/x"), (0.0, -2, "x**-2"), (-1.0, 0.5, "x**0.5")]
)
def test_powers_outside_their_domain_are_refused(x, exponent, name):
    with pytest.raises(InvalidInput) as caught:
        univariate.power(x, exponent, 3)
    assert name in caught.value.what


@pytest.mark.parametrize(
    ("series", "x", "name"),
    [
        (univariate.FUNCTIONS["exp"], 1e3, "exp"),
        (univariate.FUNCTIONS["cosh"], -1e3, "cosh"),
        (univariate.FUNCTIONS["sin"], np.inf, "sin"),
        (univariate.FUNCTIONS["log"], np.nan, "log"),
        (lambda x, degree: univariate.power(x, 3, degree), 1e200, "x**3"),
        (lambda x, degree: univariate.power(x, 0.5, degree), np.nan, "x**0.5"),
        (lambda x, degree: univariate.power(x, np.inf, degree), 2.0, "x**inf"),
    ],
)
def test_what_is_not_finite_is_refused_by_name(series, x, name):
    with pytest.raises(InvalidInput) as caught:
        series(x, 3)
    assert f" {name} " in caught.value.what
    assert "finite" in caught.value.found
