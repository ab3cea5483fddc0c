from __future__ import annotations

import math
from fractions import Fraction
from types import SimpleNamespace

import casadi as ca
import mpmath
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from tests.refusals import refused_with

from flexhinf import scalars
from flexhinf.errors import InvalidInput
from flexhinf.polynomial import basis, truncated as univariate
from flexhinf.polynomial.truncated import degree_slice, size, space
from flexhinf.scalars import Jet, coefficients, jets, symbols, trace
from flexhinf.scalars.jet import by_casadi, expand

MP = SimpleNamespace(
    sin=mpmath.sin, cos=mpmath.cos, tan=mpmath.tan, exp=mpmath.exp, log=mpmath.log, sqrt=mpmath.sqrt,
    tanh=mpmath.tanh, arctan=mpmath.atan, arctan2=mpmath.atan2, arcsin=mpmath.asin, arccos=mpmath.acos,
    sinh=mpmath.sinh, cosh=mpmath.cosh, arcsinh=mpmath.asinh, arccosh=mpmath.acosh, arctanh=mpmath.atanh,
    expm1=mpmath.expm1, log1p=mpmath.log1p, log10=mpmath.log10, hypot=mpmath.hypot,
    square=lambda x: x * x, reciprocal=lambda x: 1 / x, power=lambda x, y: x**y,
)  # fmt: skip

#: Each works on jets (F is NumPy) and on numbers of any precision (F is the table above).
EXPRESSIONS = {
    "trigonometry": lambda x, y, z, F: F.sin(x * y) + F.cos(z - x) * F.tan(y / 4),
    "exponentials": lambda x, y, z, F: F.exp(-x * z) * F.log(2 + y * y) + F.expm1(x - y) * F.log1p(y / 3),
    "decimal": lambda x, y, z, F: F.log10(3 + x + z * y),
    "roots": lambda x, y, z, F: F.sqrt(1 + x * x + y) / F.hypot(x + 2, z - 1),
    "hyperbolic": lambda x, y, z, F: F.tanh(2 * x - z) * F.sinh(y) - F.cosh(x * z),
    "inverse": lambda x, y, z, F: F.arcsin(x / 3) + F.arccos(y / 4) * F.arctan(z - x * y),
    "inverse hyperbolic": lambda x, y, z, F: F.arcsinh(x + y) + F.arccosh(3 + z) * F.arctanh(y / 3),
    "angle, first quadrant": lambda x, y, z, F: F.arctan2(y + 2, 3 + x),
    "angle, second quadrant": lambda x, y, z, F: F.arctan2(y + 2, x - 3 + z),
    "angle, third quadrant": lambda x, y, z, F: F.arctan2(x - 2, y - 3),
    "angle, upwards": lambda x, y, z, F: F.arctan2(z + 2, x - x),
    "powers": lambda x, y, z, F: (2 + x) ** 3 - (3 + y) ** (-2) + (2 + z) ** 1.5 + x**2 + (x - z) ** 7,
    "variable powers": lambda x, y, z, F: (2 + x) ** y + 3**z + F.power(2 + y, z),
    "quotients": lambda x, y, z, F: (x - y) / (3 + z * x) + 1 / (2 - y) + F.reciprocal(4 + F.square(x)),
    "a joint": lambda x, y, z, F: (-9.81 * F.sin(x) - 7 * (x - y) - 0.3 * z**3) / (1 + 0.2 * F.cos(x - y)),
}
#: Identities of polynomials: few draws see whether one holds.
FEWER = settings(max_examples=settings.default.max_examples // 2)
POINTS = [(0.0, 0.0, 0.0), (0.4, -0.7, 0.2), (-1.1, 0.9, 0.6)]


def along(coefficient_vector: np.ndarray, direction: np.ndarray, degree: int) -> np.ndarray:
    """Coefficients of t ↦ p(t v), summed from the monomials by their definition."""
    n = len(direction)
    return np.array(
        [
            coefficient_vector[degree_slice(n, k)] @ np.prod(direction ** basis.exponents(n, k), axis=1)
            for k in range(degree + 1)
        ]
    )


@pytest.mark.quick_cases(10)
@pytest.mark.oracle
@pytest.mark.parametrize("name", EXPRESSIONS)
@pytest.mark.parametrize("point", POINTS)
def test_along_random_lines_jets_equal_mpmath(name, point):
    degree, expression = 6, EXPRESSIONS[name]
    result = expression(*jets(point, degree), np)
    rng = np.random.default_rng(1)
    for direction in rng.normal(size=(3, 3)):

        def line(t, v=direction):
            return expression(*[mpmath.mpf(p) + t * mpmath.mpf(d) for p, d in zip(point, v, strict=True)], MP)

        with mpmath.workdps(50):
            expected = np.array([float(c) for c in mpmath.taylor(line, 0, degree)])
        got = along(result.coefficients, direction, degree)
        np.testing.assert_allclose(got, expected, rtol=1e-12, atol=1e-13 * np.abs(expected).max())


@pytest.mark.oracle
@pytest.mark.parametrize("name", EXPRESSIONS)
def test_value_gradient_and_hessian_equal_casadi(name):
    point, expression = np.array([0.4, -0.7, 0.2]), EXPRESSIONS[name]
    traced = trace(lambda x: np.array([expression(*x, np)]), 3)
    x = ca.SX.sym("x", 3)
    hessian, gradient = ca.hessian(traced(x), x)
    exact = ca.Function("exact", [x], [traced(x), gradient, hessian])(point)
    value, gradient, hessian = (np.asarray(e, dtype=float) for e in exact)
    result = expression(*jets(point, 2), np).coefficients
    rows, columns = basis.indices(3, 2).T
    monomials = hessian[rows, columns] * np.where(rows == columns, 0.5, 1.0)
    expected = np.concatenate([value.ravel(), gradient.ravel(), monomials])
    np.testing.assert_allclose(result, expected, rtol=1e-12, atol=1e-13)


def test_a_closed_form_in_two_variables():
    x, y = jets([0.0, 0.0], 7)
    result = (1 / (1 - x - y)).coefficients  # Σ (x + y)ᵏ
    np.testing.assert_allclose(
        result, np.concatenate([basis.multiplicity(2, k) for k in range(8)]), rtol=1e-14
    )
    result = np.exp(x + 2 * y).coefficients
    expected = [
        2.0**b / (math.factorial(a) * math.factorial(b))
        for k in range(8)
        for a, b in basis.exponents(2, k).tolist()
    ]
    np.testing.assert_allclose(result, expected, rtol=1e-14)


def test_a_polynomial_is_its_own_expansion():
    x, y = jets([2.0, -1.0], 3)
    p = x * y**2 - 3 * x  # about (2, −1): −4 + (−2) a − 4 b + 0 a² − 2 a b + 2 b² + a b²
    np.testing.assert_array_equal(p.coefficients, [-4, -2, -4, 0, -2, 2, 0, 0, 1, 0])
    assert p.constant == -4.0


# properties


@st.composite
def smooth_jets(draw, count: int = 1, positive: bool = False):
    """Random jets of one kind, with a constant term away from zero when `positive`."""
    n, degree = draw(st.sampled_from([(1, 8), (2, 6), (4, 4), (7, 3)]))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    drawn = []
    for _ in range(count):
        vector = rng.normal(size=size(n, degree)) * (
            rng.random(size(n, degree)) < draw(st.sampled_from([0.3, 1.0]))
        )
        vector *= 0.3 ** np.concatenate([np.full(basis.count(n, k), k) for k in range(degree + 1)])
        vector[0] = rng.uniform(0.6, 1.6) if positive else vector[0]
        present = np.flatnonzero(vector)
        drawn.append(Jet(space(n, degree).support(present), vector[present]))
    return drawn


def assert_equal_jets(a: Jet, b: Jet | float, tolerance: float = 1e-11) -> None:
    b = coefficients(b, a.n, a.degree)
    np.testing.assert_allclose(a.coefficients, b, rtol=tolerance, atol=tolerance * max(1.0, np.abs(b).max()))


@pytest.mark.property
@FEWER
@given(smooth_jets(count=2, positive=True))
def test_identities_of_arithmetic(drawn):
    a, b = drawn
    assert_equal_jets(a * b / b, a)
    assert_equal_jets(a - b + b, a)
    assert_equal_jets(a * b - b * a, 0.0)
    assert_equal_jets((a + b) ** 2, a * a + 2 * a * b + b * b)
    assert_equal_jets(1.0 / (1.0 / a), a)
    assert_equal_jets(a**3, a * a * a)
    assert_equal_jets(a**5, a * a * a * a * a)
    assert_equal_jets(a**-2, 1 / (a * a))
    assert_equal_jets(a**0.5, np.sqrt(a))
    assert_equal_jets(a**b * a ** (-b), 1.0)
    assert_equal_jets(np.hypot(a, b) ** 2, a * a + b * b)
    assert_equal_jets(2.0**a, np.exp(a * math.log(2.0)))


@pytest.mark.property
@FEWER
@given(smooth_jets(positive=True))
def test_identities_of_positive_arguments(drawn):
    [a] = drawn
    assert_equal_jets(np.exp(np.log(a)), a)
    assert_equal_jets(np.sqrt(a) ** 2, a)
    assert_equal_jets(np.log10(a), np.log(a) / math.log(10.0))
    assert_equal_jets(np.log1p(a), np.log(1 + a))
    assert_equal_jets(np.cosh(np.arccosh(a + 1)), a + 1)


@pytest.mark.property
@FEWER
@given(smooth_jets())
def test_identities_of_any_argument(drawn):
    [a] = drawn
    s, c = np.sin(a), np.cos(a)
    assert_equal_jets(s * s + c * c, 1.0)
    assert_equal_jets(np.sin(2 * a), 2 * s * c)
    assert_equal_jets(np.cosh(a) ** 2 - np.sinh(a) ** 2, 1.0)
    assert_equal_jets(np.log(np.exp(a)), a)
    assert_equal_jets(np.expm1(a), np.exp(a) - 1)
    assert_equal_jets(np.tanh(a) * np.cosh(a), np.sinh(a))
    assert_equal_jets(np.tan(np.arctan(a)), a)
    assert_equal_jets(np.sinh(np.arcsinh(a)), a)
    assert_equal_jets(np.arctanh(np.tanh(a / 8)), a / 8)
    small = s / 2
    assert_equal_jets(np.sin(np.arcsin(small)), small)
    assert_equal_jets(np.arcsin(small) + np.arccos(small), np.pi / 2)
    angle = a + (0.3 - a.constant)
    assert_equal_jets(np.arctan2(np.sin(angle), np.cos(angle)), angle)


@pytest.mark.property
@FEWER
@given(st.integers(0, 2**32 - 1))
def test_truncation_commutes_with_everything(seed):
    rng = np.random.default_rng(seed)
    point = rng.uniform(-1, 1, 3)
    for expression in EXPRESSIONS.values():
        high = expression(*jets(point, 5), np).coefficients
        low = expression(*jets(point, 3), np).coefficients
        np.testing.assert_allclose(low, high[: size(3, 3)], rtol=1e-13, atol=1e-14)


# living in arrays


def test_numpy_arrays_of_jets():
    x = jets([0.3, -0.2, 0.5], 4)
    matrix = np.array([[1.0, x[0], 0.0], [x[1], 2.0, x[2]], [0.0, x[0] * x[1], -1.0]], dtype=object)
    product = matrix @ x
    by_hand = [x[0] + x[0] * x[1], x[1] * x[0] + 2 * x[1] + x[2] ** 2, x[0] * x[1] * x[1] - x[2]]
    for got, expected in zip(product, by_hand, strict=True):
        assert_equal_jets(got, expected)
    assert_equal_jets(np.dot(x, x), np.sum(x * x))
    assert_equal_jets(np.linalg.norm([1.0, 2.0]) * x[0], math.sqrt(5) * x[0])
    np.testing.assert_array_equal(coefficients(np.outer(x, x), 3, 4), coefficients(np.outer(x, x).T, 3, 4))
    assert_equal_jets(np.cross(x, np.array([1.0, 0.0, 0.0]))[1], x[2])
    assert coefficients(np.sin(x), 3, 4).shape == (3, size(3, 4))
    assert isinstance((np.array([1.0, 2.0, 3.0]) * x)[0], Jet)
    assert isinstance(np.float64(2.0) * x[0], Jet)
    assert (x[0] * np.arange(3.0)).shape == (3,)
    assert_equal_jets(sum(x), np.sum(x))
    assert_equal_jets(np.vdot(x, x), x @ x)


def test_numbers_on_either_side():
    [x] = jets([0.5], 3)
    for number in (2, 2.0, np.float64(2.0), np.int64(2), Fraction(2), True + 1):
        np.testing.assert_allclose((x + number).coefficients, [2.5, 1, 0, 0])
        np.testing.assert_allclose((number + x).coefficients, [2.5, 1, 0, 0])
        np.testing.assert_allclose((x - number).coefficients, [-1.5, 1, 0, 0])
        np.testing.assert_allclose((number - x).coefficients, [1.5, -1, 0, 0])
        np.testing.assert_allclose((number * x).coefficients, [1, 2, 0, 0])
        np.testing.assert_allclose((x / number).coefficients, [0.25, 0.5, 0, 0])
        np.testing.assert_allclose((number / x).coefficients, [4, -8, 16, -32])
        np.testing.assert_allclose((x**number).coefficients, [0.25, 1, 1, 0])
    np.testing.assert_array_equal((+x).coefficients, x.coefficients)
    np.testing.assert_array_equal((-x).coefficients, -x.coefficients)


def test_zero_stays_a_jet():
    """So that np.sin of what a zero parameter multiplies still works."""
    [x] = jets([0.7], 3)
    zero = 0.0 * x
    assert isinstance(zero, Jet)
    np.testing.assert_array_equal(np.cos(zero).coefficients, [1, 0, 0, 0])
    np.testing.assert_array_equal((zero * x + zero - zero).coefficients, np.zeros(4))
    np.testing.assert_array_equal((zero + 2.0).coefficients, [2, 0, 0, 0])
    np.testing.assert_array_equal((x + zero).coefficients, x.coefficients)


def test_a_jet_never_changes():
    x, y = jets([0.3, 0.0], 3)
    before = x.coefficients, y.coefficients
    z = x
    z += 1.0
    z *= y
    np.sin(x), x**4, 1 / x, x - y, -x, y + 3.0
    np.testing.assert_array_equal((x.coefficients, y.coefficients), before)


def test_dense_coefficients_have_zeros_for_monomials_that_are_absent():
    jet = Jet(space(2, 2).support(np.array([1, 3, 5])), np.array([1.0, -2.0, 3.0]))
    np.testing.assert_array_equal(jet.coefficients, [0.0, 1.0, 0.0, -2.0, 0.0, 3.0])
    assert (jet.n, jet.degree, jet.constant) == (2, 2, 0.0)


def test_coefficients_of_a_mixed_array():
    x, y = jets([1.0, 2.0], 1)
    table = coefficients([[x, 3.0], [0, y]], 2, 1)
    np.testing.assert_array_equal(table, [[[1, 1, 0], [3, 0, 0]], [[0, 0, 0], [2, 0, 1]]])
    for wrong in ([x, "a"], [jets([1.0], 1)[0]], [jets([1.0, 2.0], 2)[0]], [symbols("s", 1)[0]]):
        with refused_with(InvalidInput, "2 variables", "degree 1"):
            coefficients(wrong, 2, 1)


# refusals


@pytest.mark.parametrize(
    ("what", "named"),
    [
        (lambda x: 1 / x, "1/x"),
        (lambda x: (1 + x) / (x * x), "1/x"),
        (lambda x: x**-1, "1/x"),
        (lambda x: x**0.5, "x**0.5"),
        (lambda x: x**x, "log"),
        (lambda x: (-2.0) ** x, "log"),
        (np.sqrt, "sqrt"),
        (np.log, "log"),
        (np.log10, "log10"),
        (lambda x: np.log1p(x - 1), "log1p"),
        (lambda x: np.arcsin(1 + x), "arcsin"),
        (lambda x: np.arccos(x - 1), "arccos"),
        (lambda x: np.arctanh(x + 2), "arctanh"),
        (lambda x: np.arccosh(x + 1), "arccosh"),
        (lambda x: np.arctan2(x, x), "arctan2"),
        (lambda x: np.arctan2(x, x - 1), "arctan2"),
        (lambda x: np.hypot(x, x), "sqrt"),
        (lambda x: x / 0.0, "zero"),
    ],
)
def test_points_that_are_not_analytic_are_refused(what, named):
    [x] = jets([0.0], 3)
    with pytest.raises(InvalidInput) as caught:
        what(x)
    assert named in caught.value.what
    assert caught.value.found
    assert caught.value.advice


@pytest.mark.parametrize("name", ["absolute", "sign"])
def test_piecewise_functions_are_refused_by_name(name):
    x = jets([0.5, 1.0], 2)
    for argument in (x, x[0]):
        with pytest.raises(InvalidInput, match=f" {name} .*smooth.*Jet"):
            getattr(scalars, name)(argument)


def test_piecewise_functions_of_several_arguments_are_refused_by_name():
    [x] = jets([0.5], 2)
    for name, arguments in {
        "maximum": (x, 0.0), "minimum": (0.0, x), "clip": (x, -1.0, 1.0), "where": (True, x, 0.0),
    }.items():  # fmt: skip
        with pytest.raises(InvalidInput, match=f" {name} .*smooth.*Jet"):
            getattr(scalars, name)(*arguments)


@pytest.mark.parametrize(
    "what",
    [
        lambda x: x > 0, lambda x: x >= 0, lambda x: x < 0, lambda x: x <= 0, lambda x: x == 0,
        lambda x: x != 0, bool, float, int, abs, math.sin, np.abs, lambda x: max(x, 0.0),
        lambda x: np.maximum(x, 0.0),
        lambda x: np.array([x], dtype=float), lambda x: 1.0 if x else 0.0, lambda x: np.clip(x, -1.0, 1.0),
        lambda x: x in [0.0], np.floor, np.ceil, math.floor,
    ],
)  # fmt: skip
def test_branches_and_conversions_are_refused(what):
    [x] = jets([0.5], 2)
    with refused_with(InvalidInput, "number", "`", "Jet(1 variables, degree 2, value 0.5)"):
        what(x)


@pytest.mark.parametrize("function", [np.rint, np.cbrt, np.exp2, np.isfinite, np.degrees])
def test_unlisted_functions_raise(function):
    with pytest.raises(TypeError):
        function(jets([0.5], 2))


def test_strangers_are_not_guessed_at():
    [x] = jets([0.5], 2)
    [symbol] = symbols("s", 1)
    for stranger in ("a", None, 1j, symbol):
        for operation in (
            lambda a, b: a + b, lambda a, b: a - b, lambda a, b: a * b, lambda a, b: a / b, lambda a, b: a**b,
        ):  # fmt: skip
            with pytest.raises(TypeError):
                operation(x, stranger)
            with pytest.raises(TypeError):
                operation(stranger, x)


def test_jets_of_different_kinds_are_refused():
    [a], [b], c = jets([0.5], 2), jets([0.5], 3), jets([0.5, 1.0], 2)
    for other in (b, c[0]):
        for operation in ("__add__", "__sub__", "__mul__", "__truediv__", "__pow__", "arctan2", "hypot"):
            with refused_with(InvalidInput, "Jet(1 variables, degree 2"):
                getattr(a, operation)(other)


def test_a_jet_is_not_a_key():
    with pytest.raises(TypeError, match="unhashable"):
        {jets([0.5], 1)[0]: 1}


@pytest.mark.parametrize("point", [[np.nan], [np.inf, 0.0], [], [[1.0]], 3.0])
def test_unusable_points_are_refused(point):
    with refused_with(InvalidInput, "point", "finite"):
        jets(point, 2)


@pytest.mark.parametrize("degree", [-1, 2.0, True, "3"])
def test_unusable_degrees_are_refused(degree):
    with pytest.raises(InvalidInput, match="degree"):
        jets([0.0], degree)


def test_every_listed_function_is_tested_here():
    tested = set(vars(MP)) - {"square", "reciprocal", "power", "arctan2", "hypot"}
    assert tested == set(univariate.FUNCTIONS)
    assert all(hasattr(Jet, name) for name in univariate.FUNCTIONS)


@pytest.mark.parametrize("name", ["tanh", "arcsinh", "exp"])
def test_casadis_derivatives_expand_as_the_recurrences_do(name):
    code = {"tanh": ca.OP_TANH, "arcsinh": ca.OP_ASINH, "exp": ca.OP_EXP}[name]
    x, y = jets([0.4, -0.7], 4)
    inner = x * y + 0.3 * x
    expected = getattr(inner, name)().coefficients
    np.testing.assert_allclose(by_casadi(name, code, 1)(inner).coefficients, expected, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("number", [None, 2.0])
def test_casadis_derivatives_of_two_operands_expand_as_the_angle_does(number):
    x, y = jets([0.4, -0.7], 4)
    left, right = y + x * x, number or x
    got = by_casadi("arctan2", ca.OP_ATAN2, 2)(left, right)
    np.testing.assert_allclose(got.coefficients, left.arctan2(right).coefficients, rtol=1e-12, atol=1e-14)


def test_an_operation_that_is_added_is_refused_where_it_has_no_expansion(monkeypatch):
    for name, code, operands, refusal in (("cube_log", ca.OP_LOG, 1, ""), ("fmod", ca.OP_FMOD, 2, "another")):
        monkeypatch.setattr(Jet, name, None, raising=False)
        delattr(Jet, name)
        expand(name, code, operands, refusal)
    [x] = jets([0.0], 2)
    with refused_with(InvalidInput, "cube_log", 2):
        x.cube_log()
    with refused_with(InvalidInput, "fmod", "another"):
        x.fmod(2.0)
    kept = Jet.sin
    expand("sin", ca.OP_COS, 1)
    assert Jet.sin is kept
