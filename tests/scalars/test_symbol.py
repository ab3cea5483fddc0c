from __future__ import annotations

import math
from fractions import Fraction

import casadi as ca
import numpy as np
import pytest
from tests.refusals import refused_with

from flexhinf.errors import InvalidInput
from flexhinf.scalars import Symbol, symbols, trace

SMOOTH = [
    np.sin, np.cos, np.tan, np.arctan, np.sinh, np.cosh, np.tanh, np.arcsinh, np.exp, np.expm1,
    np.floor, np.ceil, np.abs, np.negative, np.positive, np.square, np.conjugate,
]  # fmt: skip
POSITIVE = [np.log, np.log10, np.log1p, np.sqrt, np.reciprocal]
INSIDE = [np.arcsin, np.arccos, np.arctanh]
BINARY = [np.add, np.subtract, np.multiply, np.divide, np.power, np.arctan2, np.hypot]
OPERATORS = {
    np.less: "__lt__", np.less_equal: "__le__", np.greater: "__gt__", np.greater_equal: "__ge__",
    np.equal: "__eq__", np.not_equal: "__ne__",
}  # fmt: skip


def evaluated(code, *arrays) -> np.ndarray:
    """What `code`, run on symbols, computes on numbers (CasADi's evaluator)."""
    traced = trace(code, *[np.shape(a) for a in arrays])
    return np.asarray(traced(*[np.ravel(a) for a in arrays]), dtype=float).ravel()


def assert_like_numpy(code, *arrays) -> None:
    result = evaluated(code, *arrays)
    expected = np.ravel(np.asarray(code(*arrays), dtype=float))
    np.testing.assert_allclose(result, expected, rtol=1e-14, atol=1e-15)


@pytest.mark.oracle
@pytest.mark.parametrize("function", SMOOTH)
def test_functions_of_one_variable(function):
    assert_like_numpy(function, np.random.default_rng(0).uniform(-3, 3, 20))


@pytest.mark.oracle
@pytest.mark.parametrize("function", POSITIVE)
def test_functions_of_a_positive_variable(function):
    assert_like_numpy(function, np.random.default_rng(0).uniform(0.01, 5, 20))


@pytest.mark.oracle
@pytest.mark.parametrize("function", INSIDE)
def test_functions_inside_the_unit_interval(function):
    assert_like_numpy(function, np.random.default_rng(0).uniform(-0.99, 0.99, 20))


@pytest.mark.oracle
def test_arccosh():
    assert_like_numpy(np.arccosh, np.random.default_rng(0).uniform(1.01, 9, 20))


@pytest.mark.oracle
@pytest.mark.parametrize("function", BINARY)
def test_functions_of_two_variables(function):
    rng = np.random.default_rng(0)
    a, b = rng.uniform(0.1, 3, 20), rng.uniform(0.1, 3, 20)
    assert_like_numpy(function, a, b)
    assert_like_numpy(lambda x: function(x, 1.7), a)


@pytest.mark.oracle
@pytest.mark.parametrize("function", [np.add, np.subtract, np.multiply, np.divide, np.power])
@pytest.mark.parametrize("number", [2, 2.5, np.float64(2.5), np.int64(3), Fraction(5, 2), np.bool_(True)])
def test_numbers_on_either_side(function, number):
    values = np.random.default_rng(0).uniform(0.1, 3, 5)
    for code in (lambda x: function(x, number), lambda x: function(number, x)):
        expected = np.asarray(code(values.astype(object)), dtype=float)
        np.testing.assert_allclose(evaluated(code, values), expected, rtol=1e-14)


@pytest.mark.oracle
@pytest.mark.parametrize("function", OPERATORS)
def test_comparisons_are_zero_or_one(function):
    a, b = np.array([1.0, 2.0, 3.0]), np.array([2.0, 2.0, 2.0])
    arrays = evaluated(lambda x, y: function(x, y, dtype=object), a, b)
    np.testing.assert_array_equal(arrays, function(a, b))
    operator = getattr(Symbol, OPERATORS[function])
    elements = evaluated(lambda x, y: np.array([operator(i, j) for i, j in zip(x, y, strict=True)]), a, b)
    np.testing.assert_array_equal(elements, function(a, b))


def test_arrays_of_symbols_do_not_compare_to_yes_or_no():
    with pytest.raises(InvalidInput, match=r"np.greater\(x, y, dtype=object\)"):
        np.greater(symbols("x", 2), 0)


@pytest.mark.oracle
def test_logic():
    predicates = (lambda p, q: p & q, lambda p, q: p | q, lambda p, q: ~p & ~q)
    for a in (-1.0, 1.0):
        for b in (-1.0, 1.0):
            both, either, neither = evaluated(
                lambda z: np.array([p(z[0] > 0, z[1] > 0) for p in predicates]), np.array([a, b])
            )
            assert (both, either, neither) == (a > 0 and b > 0, a > 0 or b > 0, not (a > 0 or b > 0))


@pytest.mark.oracle
def test_linear_algebra_and_slicing():
    rng = np.random.default_rng(0)
    matrix, vector = rng.normal(size=(4, 3)), rng.normal(size=3)
    for code in (
        lambda a, x: a @ x,
        lambda a, x: a.T @ a,
        lambda a, x: np.outer(x, x) * 2.0,
        lambda a, x: np.cross(a[1], x),
        lambda a, x: a[::2, 1:] - x[:2],
        lambda a, x: np.sum(a, axis=0) / np.mean(x),
        lambda a, x: np.concatenate([a.ravel(), x]),
        lambda a, x: np.array([np.vdot(x, x), np.dot(a[0], x), np.prod(x), 3.0]),
    ):
        result, expected = evaluated(code, matrix, vector), np.ravel(code(matrix, vector))
        np.testing.assert_allclose(result, expected, rtol=1e-13, atol=1e-14)


def test_a_number_and_an_array_combine_in_either_order():
    x = symbols("x", 3)
    assert isinstance(np.float64(2.0) * x[0], Symbol)
    assert (np.arange(3.0) * x[0]).shape == (x[0] * np.arange(3.0)).shape == (3,)


def branch(x):
    return x if x > 0 else -x


@pytest.mark.parametrize(
    "code", [branch, bool, lambda x: max(x, 0.0), np.sign, lambda x: np.maximum(x, 0.0), lambda x: 0 < x < 1]
)
def test_branches_raise(code):
    with refused_with(InvalidInput, "truth", "Symbol(") as caught:
        code(symbols("x", 1)[0])
    assert "flexhinf.scalars.where" in caught.value.advice


@pytest.mark.parametrize("code", [float, math.sin, lambda x: np.array([x], dtype=float)])
def test_asking_for_the_number_raises(code):
    with refused_with(InvalidInput, "float(Symbol(x))"):
        code(symbols("x", 1)[0])


def test_filling_a_float_array_raises():
    target = np.zeros(2)
    with refused_with(InvalidInput, "float(Symbol(x))"):
        target[0] = symbols("x", 1)[0]


def test_a_constant_symbol_is_a_number():
    assert float(Symbol(ca.SX(2.5)) * 2) == 5.0


@pytest.mark.parametrize("function", [np.cbrt, np.rint, np.exp2, np.degrees, np.isfinite, np.log2, np.sinc])
def test_unlisted_functions_raise(function):
    with pytest.raises((TypeError, InvalidInput)):
        function(symbols("x", 2))


@pytest.mark.parametrize("stranger", ["a", None, 1j, ca.DM(1.0)])
def test_strangers_are_not_guessed_at(stranger):
    [x] = symbols("x", 1)
    for operation in (lambda a, b: a + b, lambda a, b: a * b, lambda a, b: a / b, lambda a, b: a < b):
        with pytest.raises((TypeError, NotImplementedError, InvalidInput)):
            operation(x, stranger)


def test_a_symbol_is_not_a_key():
    with pytest.raises(TypeError, match="unhashable"):
        {symbols("x", 1)[0]: 1}


def test_its_text_is_short():
    [x] = symbols("x", 1)
    assert repr(x + 1) == "Symbol((x+1))" or repr(x + 1) == "Symbol((1+x))"
    long = sum((np.sin(x + k) for k in range(50)), x)
    assert len(repr(long)) < 80
