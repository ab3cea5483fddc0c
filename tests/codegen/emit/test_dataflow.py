"""What is decided before any text is written: divisions, products that are fused, truth values."""

import casadi
import numpy as np
import pytest

from flexhinf.codegen.dataflow import SELECT, read_dataflow
from flexhinf.codegen.operations import OPERATIONS

X, Y, Z = casadi.SX.sym("x"), casadi.SX.sym("y"), casadi.SX.sym("z")


def divisions(*results):
    flow = read_dataflow(
        casadi.Function("f", [X, Y, Z], list(results), {"cse": True}), OPERATIONS, fused=True
    )
    return sum(o.code in (casadi.OP_DIV, casadi.OP_INV) for o in flow.operations.values())


@pytest.mark.parametrize(
    ("results", "expected"),
    [
        ((X / Z, Y / Z, (X + Y) / Z), 1),
        ((X / casadi.sqrt(Z), Y / casadi.sqrt(Z)), 1),
        ((X / casadi.if_else(Y > 0, casadi.sqrt(Z), 0), 3 / casadi.if_else(Y > 0, casadi.sqrt(Z), 0)), 1),
        ((X / Z, X / Y), 2),  # one quotient each: rounded once
        ((X / (Y * Z), 2 / (Y * Z)), 2),  # a product may be too small to have a reciprocal
    ],
)
def test_quotients_by_one_argument_or_root_share_a_division(results, expected):
    assert divisions(*results) == expected


def test_shared_divisions_follow_casadi(pointwise):
    """Within the roundings of a reciprocal and a product; zero, infinities and NaN as a division has them."""
    function = casadi.Function("f", [X, Z], [X / Z - 3 / Z])
    z = [0.0, 0.7, -3e-30, 1e30, np.inf, np.nan]
    x, z = np.meshgrid([0.0, -0.0, 1.0, 3.7, -1e-200, 1e200, np.inf, np.nan], z)
    got = pointwise(function, x.ravel(), z.ravel())
    expected = np.array(function.map(x.size)(x.reshape(1, -1), z.reshape(1, -1))).ravel()
    both = np.isfinite(expected)
    assert np.array_equal(both, np.isfinite(got))
    scale = (np.abs(x.ravel()) + 3.0)[both] / np.abs(z.ravel()[both])
    assert (np.abs(got[both] - expected[both]) <= 4e-16 * scale).all()


def operations(*results):
    """Opcodes of a function, without its inputs and constants."""
    flow = read_dataflow(casadi.Function("f", [X, Y, Z], list(results)), OPERATIONS, fused=True)
    return [o.code for o in flow.operations.values() if o.code not in (casadi.OP_INPUT, casadi.OP_CONST)]


SMALLER = X < Y


@pytest.mark.parametrize(
    ("result", "expected"),
    [
        (casadi.if_else(SMALLER, 1, 0), [casadi.OP_LT]),
        (casadi.if_else(casadi.if_else(SMALLER, 1, 0) > 0.5, 1, 0), [casadi.OP_LT]),
        (casadi.logic_not(SMALLER > 0.5), [casadi.OP_LT, casadi.OP_NOT]),
        (casadi.if_else(X, 1, 0), [SELECT]),  # X may be 2, or NaN
        (X > 0.5, [casadi.OP_LT]),
        (casadi.if_else(SMALLER, X, Y), [casadi.OP_LT, SELECT]),
        (casadi.if_else(SMALLER, Y, Y * Z), [casadi.OP_LT, casadi.OP_MUL, SELECT]),
        (casadi.if_else(casadi.logic_not(SMALLER), X, 1), [casadi.OP_LT, SELECT]),
        (casadi.if_else(SMALLER, casadi.if_else(SMALLER, X, Z), Y), [casadi.OP_LT, SELECT]),
        (casadi.if_else(SMALLER, 1, Y < Z), [casadi.OP_LT, casadi.OP_LT, casadi.OP_OR]),
        (casadi.if_else(SMALLER, X, X), []),
        (casadi.if_else(casadi.fabs(X) < casadi.inf, X, X), []),
        (SMALLER <= Z, [casadi.OP_LT, casadi.OP_LE]),
    ],
)
def test_a_truth_value_is_not_compared_again(result, expected):
    assert operations(result) == expected


@pytest.mark.ci("many random functions")
@pytest.mark.oracle
def test_shortened_conditions_are_those_of_casadi(pointwise):
    """Random expressions of conditions, on numbers with NaN, infinities and both zeros."""
    random = np.random.default_rng(0)
    numbers = np.array([0.0, -0.0, 0.5, 1.0, 2.0, -3.0, np.inf, np.nan])
    x, z = (grid.ravel() for grid in np.meshgrid(numbers, numbers))
    two = [
        lambda a, b: a < b, lambda a, b: a <= b, lambda a, b: a == b, lambda a, b: a != b,
        casadi.logic_and, casadi.logic_or, lambda a, b: casadi.if_else(a, b, 0), casadi.fmin, lambda a, b: a + b,
    ]  # fmt: skip
    shorter = 0
    for _ in range(40):
        known = [X, Z, *map(casadi.SX, (0.0, 0.5, 1.0))]
        for _ in range(20):
            a, b = (known[k] for k in random.integers(len(known), size=2))
            known.append(
                casadi.logic_not(a) if random.random() < 0.2 else two[random.integers(len(two))](a, b)
            )
        function = casadi.Function("f", [X, Z], [casadi.sum1(casadi.vertcat(*known[-6:]))])
        expected = np.array(function.map(x.size)(x.reshape(1, -1), z.reshape(1, -1))).ravel()
        np.testing.assert_array_equal(pointwise(function, x, z), expected)
        shorter += (
            len(read_dataflow(function, OPERATIONS, fused=False).operations) < function.n_instructions() - 1
        )
    assert shorter >= 10


def test_stages_decide_nothing() -> None:
    """What a stage ends with is no use of a product, and what no result needs is left out."""
    product, unused = X * Y, casadi.exp(Z)
    plain = read_dataflow(casadi.Function("f", [X, Y, Z], [product + Z]), OPERATIONS, fused=True)
    staged = casadi.Function("f", [X, Y, Z], [casadi.vertcat(product, unused), product + Z])
    flow = read_dataflow(staged, OPERATIONS, fused=True, stages=1)
    assert [o.code for o in flow.operations.values()] == [o.code for o in plain.operations.values()]
    assert (len(flow.outputs), flow.outputs[0][0], len(flow.ends)) == (1, 0, 1)
    assert flow.ends[0] < flow.outputs[0][2]
