"""Every operation, one by one, against CasADi's own evaluator."""

import casadi
import numpy as np
import pytest

from flexhinf.codegen.operations import OPERATIONS

X, Y = casadi.SX.sym("x"), casadi.SX.sym("y")

UNARY = {
    "OP_NEG": -X,
    "OP_EXP": casadi.exp(X),
    "OP_LOG": casadi.log(X),
    "OP_SQRT": casadi.sqrt(X),
    "OP_SQ": X * X,
    "OP_TWICE": 2 * X,
    "OP_SIN": casadi.sin(X),
    "OP_COS": casadi.cos(X),
    "OP_TAN": casadi.tan(X),
    "OP_ASIN": casadi.asin(X),
    "OP_ACOS": casadi.acos(X),
    "OP_ATAN": casadi.atan(X),
    "OP_NOT": casadi.logic_not(X),
    "OP_FLOOR": casadi.floor(X),
    "OP_CEIL": casadi.ceil(X),
    "OP_FABS": casadi.fabs(X),
    "OP_SIGN": casadi.sign(X),
    "OP_ERF": casadi.erf(X),
    "OP_INV": 1 / X,
    "OP_SINH": casadi.sinh(X),
    "OP_COSH": casadi.cosh(X),
    "OP_TANH": casadi.tanh(X),
    "OP_ASINH": casadi.asinh(X),
    "OP_ACOSH": casadi.acosh(X),
    "OP_ATANH": casadi.atanh(X),
    "OP_LOG1P": casadi.log1p(X),
    "OP_EXPM1": casadi.expm1(X),
}
BINARY = {
    "OP_ADD": X + Y,
    "OP_SUB": X - Y,
    "OP_MUL": X * Y,
    "OP_DIV": X / Y,
    "OP_POW": X**Y,
    "OP_LT": X < Y,
    "OP_LE": X <= Y,
    "OP_EQ": X == Y,
    "OP_NE": X != Y,
    "OP_AND": casadi.logic_and(X, Y),
    "OP_OR": casadi.logic_or(X, Y),
    "OP_FMOD": casadi.fmod(X, Y),
    "OP_REMAINDER": casadi.remainder(X, Y),
    "OP_COPYSIGN": casadi.copysign(X, Y),
    "OP_IF_ELSE_ZERO": casadi.if_else(X, Y, 0),
    "OP_FMIN": casadi.fmin(X, Y),
    "OP_FMAX": casadi.fmax(X, Y),
    "OP_ATAN2": casadi.atan2(X, Y),
    "OP_HYPOT": casadi.hypot(X, Y),
}
# Ours, and not the C library's: equal to its last bits only.
OWN = {"OP_SIN", "OP_COS"}

NASTY = [
    0.0,
    -0.0,
    1.0,
    -1.0,
    0.5,
    -2.5,
    3.0,
    1e-8,
    5e-324,
    1e-310,
    710.0,
    -745.5,
    1e17,
    1.7e308,
    np.inf,
    -np.inf,
]
NASTY += [np.nan, np.nextafter(1.0, 2.0), 2.0**31, -(2.0**63)]


def codes(function: casadi.Function) -> set[int]:
    inside = {function.instruction_id(k) for k in range(function.n_instructions())}
    return inside - {casadi.OP_INPUT, casadi.OP_OUTPUT, casadi.OP_CONST}


def same(got: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """Same bits, any NaN being equal to any other."""
    return (got.view(np.int64) == expected.view(np.int64)) | (np.isnan(got) & np.isnan(expected))


def by_casadi(function: casadi.Function, *columns: np.ndarray) -> np.ndarray:
    return np.array(function(*(column[None, :] for column in columns))).reshape(-1)


def grid(arguments: int) -> list[np.ndarray]:
    random = np.random.default_rng(1).normal(0.0, 3.0, (arguments, 200))
    if arguments == 1:
        return [np.concatenate([NASTY, random[0]])]
    left, right = np.meshgrid(NASTY, NASTY)
    return [np.concatenate([left.ravel(), random[0]]), np.concatenate([right.ravel(), random[1]])]


@pytest.mark.oracle
@pytest.mark.parametrize("lanes", [pytest.param(1, marks=pytest.mark.ci("the same rows for one lane")), 4])
@pytest.mark.parametrize("name", [*UNARY, *BINARY])
def test_operation_means_what_casadi_means(name, lanes, pointwise):
    symbols = [X] if name in UNARY else [X, Y]
    function = casadi.Function("f", symbols, [(UNARY | BINARY)[name]])
    assert codes(function) == {getattr(casadi, name)}
    columns = grid(len(symbols))

    got, expected = pointwise(function, *columns, lanes=lanes), by_casadi(function, *columns)

    if name in OWN:
        np.testing.assert_allclose(got, expected, rtol=5e-16, atol=0.0)
    else:
        wrong = ~same(got, expected)
        assert not wrong.any(), [
            (*(column[wrong][0] for column in columns), got[wrong][0], expected[wrong][0])
        ]


@pytest.mark.oracle
@pytest.mark.parametrize("name", [name for name in (*UNARY, *BINARY) if name != "OP_IF_ELSE_ZERO"])
def test_the_numpy_function_of_an_operation_is_what_casadi_means(name):
    symbols = [X] if name in UNARY else [X, Y]
    function = casadi.Function("f", symbols, [(UNARY | BINARY)[name]])
    columns = [np.where(np.abs(column) < 1e8, column, 0.7) for column in grid(len(symbols))]
    with np.errstate(all="ignore"):
        got = np.asarray(OPERATIONS[getattr(casadi, name)].numpy(*columns), dtype=float)
    np.testing.assert_allclose(got, by_casadi(function, *columns), rtol=1e-14, atol=1e-300)


@pytest.mark.oracle
@pytest.mark.parametrize("exponent", [0.5, 1.5, -2.0, 3.0, 7.0, 0.0])
def test_constant_powers(exponent, pointwise):
    function = casadi.Function("f", [X], [casadi.constpow(X, exponent)])
    (column,) = grid(1)
    assert same(pointwise(function, column), by_casadi(function, column)).all()


def test_every_operation_of_the_table_is_tested():
    tested = {getattr(casadi, name) for name in (UNARY | BINARY)}
    other = {casadi.OP_ASSIGN, casadi.OP_CONSTPOW}
    assert {code for code in OPERATIONS if code >= 0} | {casadi.OP_IF_ELSE_ZERO} == tested | other


def test_the_table_holds_all_that_casadi_functions_of_one_or_two_numbers_emit():
    emitted = {}
    for name in dir(casadi):
        for arguments in ((X,), (X, Y), (X, 2.5)):
            try:
                value = getattr(casadi, name)(*arguments)
                function = casadi.Function("f", [X, Y], [casadi.SX(value)])
            except (TypeError, NotImplementedError, RuntimeError, AttributeError):
                continue
            emitted.update(dict.fromkeys(codes(function), name))
    assert len(emitted) > 40
    written = {*OPERATIONS, casadi.OP_IF_ELSE_ZERO}  # a choice of its own, see `flexhinf.codegen.dataflow`
    assert {code: name for code, name in emitted.items() if code not in written} == {
        casadi.OP_ERFINV: "erfinv"
    }


@pytest.mark.oracle
@pytest.mark.parametrize(
    "expression",
    [X * Y + 3.0, 3.0 - X * Y, X * Y - 3.0, X * X + Y * Y, X * X - Y, Y - X * X, (X * Y) * (X * Y) + X * Y],
    ids=str,
)
def test_products_are_rounded_once_where_they_are_fused(expression, pointwise):
    """The values stay within one rounding of the product of those that are rounded twice."""
    function = casadi.Function("f", [X, Y], [expression])
    columns = [column[np.isfinite(grid(2)[0]) & np.isfinite(grid(2)[1])] for column in grid(2)]
    columns = [np.clip(column, -1e70, 1e70) for column in columns]
    scale = by_casadi(
        casadi.Function("s", [X, Y], [1 + X**2 + Y**2 + (X * Y) ** 2 + casadi.fabs(X * Y)]), *columns
    )
    difference = pointwise(function, *columns) - by_casadi(function, *columns)
    assert (np.abs(difference) <= 3e-16 * scale).all()


def test_a_fused_product_keeps_what_rounding_would_lose(pointwise):
    function = casadi.Function("f", [X, Y], [X * X - Y])
    x = np.array([1.0 + 2.0**-30])
    assert pointwise(function, x, x * x)[0] == 2.0**-60
