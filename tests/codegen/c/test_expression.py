"""The text of exported C: what stands in one line, what has a name, what is a condition."""

import re

import casadi
import numpy as np
import pytest

from flexhinf.codegen.c import Real, Translator, constant, folded
from flexhinf.codegen.c.expression import MOST

X = casadi.SX.sym("x", 4)


def text(*results: casadi.SX) -> str:
    translator = Translator("c", Real("double"))
    translator.function(casadi.Function("f", [X], [casadi.vertcat(*results)]))
    return str(translator)


def lines(*results: casadi.SX) -> list[str]:
    return [line.strip() for line in text(*results).splitlines() if line.endswith(";")]


@pytest.mark.parametrize(
    ("result", "expected"),
    [
        (
            casadi.if_else(casadi.fabs(X[0]) < casadi.inf, X[0], X[0]),
            ["const real v1 = in0[0];", "result[0] = v1;"],
        ),
        (
            (X[0] + X[1]) * X[2] - X[3],
            ["const real v1 = FMA(in0[0] + in0[1], in0[2], -in0[3]);", "result[0] = v1;"],
        ),
        (
            casadi.if_else(X[0] < X[1], X[2], X[3]),
            ["const real v1 = (in0[0] < in0[1]) ? in0[2] : in0[3];", "result[0] = v1;"],
        ),
        (
            casadi.if_else(X[0] < X[1], X[2] / X[3], 0.0),
            [
                "const real v1 = in0[2] / in0[3];",
                "const real v2 = (in0[0] < in0[1]) ? v1 : 0.0;",
                "result[0] = v2;",
            ],
        ),
        (X[0] / (X[1] / X[2]), ["const real v1 = in0[0] / (in0[1] / in0[2]);", "result[0] = v1;"]),
        (-1.0 - X[0] * -X[1], ["const real v1 = FMA(in0[0], in0[1], -1.0);", "result[0] = v1;"]),
    ],
)
def test_a_value_that_is_used_once_stands_where_it_is_used(result: casadi.SX, expected: list[str]) -> None:
    assert lines(result) == [line.replace("real", "double") for line in expected]


def test_a_monomial_that_is_used_twice_is_called_by_its_factors() -> None:
    square = X[1] * X[0]
    assert "const double in0_0_1 = in0[1] * in0[0];" in lines(square * X[2], square * X[3])


def test_a_condition_that_is_used_twice_is_a_bool() -> None:
    found = lines(casadi.if_else(X[0] < X[1], X[2], X[3]), casadi.if_else(X[0] < X[1], X[3], X[2]))
    assert found[0] == "const bool c1 = in0[0] < in0[1];"
    assert [line for line in found if "!= 0" in line] == []
    assert sum("c1 ? in0" in line for line in found) == 2


@pytest.mark.ci("traces large functions")
def test_expressions_and_functions_are_bounded() -> None:
    """Of one sum of 4,000 products, whatever is nested inside."""
    total, factor = X[0], X[1]
    for k in range(4000):
        factor = casadi.sin(factor) + 0.001 * k
        total = total * X[2] + factor
    translator = Translator("c", Real("double"))
    function = casadi.Function("f", [X], [total])
    translator._function(function, apart=True)
    bodies = list(translator.functions.values())
    assert len(bodies) > 20
    assert max(body.count("\n") for body in bodies) <= 120
    written = [line for body in bodies for line in body.splitlines()]
    assert max(map(len, written)) <= 132
    assert max(len(re.findall(r"FMA\(| [-+*/] |c_sin\(", line)) for line in written if " v" in line) <= MOST


def test_lines_are_folded() -> None:
    words = " ".join(f"word{k}" for k in range(40))
    given = [
        f"    A_CONSTANT = 1, /* {words} */",
        f" * {words}",
        f"    /* {words}",
        f"    const real v1 = {' + '.join(f'some[A_PLACE_{k}]' for k in range(12))};",
        f"    const real v2 = (first[A_PLACE] < second[A_PLACE]) ? first[A_PLACE{'_OF_IT' * 10}] : none;",
    ]
    found = folded("\n".join(given))
    assert max(map(len, found.splitlines())) <= 120
    assert re.sub(r"[\s*]+", "", "".join(sorted(found))) == re.sub(
        r"[\s*]+", "", "".join(sorted("\n".join(given)))
    )
    assert found.index("word39") < found.index("A_CONSTANT")
    macro = f"#define MANY(x) \\\n    {' + '.join(['(x)'] * 40)} \\\n    + 1"
    assert folded(macro) == macro  # what a directive goes on with is cut nowhere


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (1.0, "1.0f"),
        (0.0, "0.0f"),
        (-0.5, "-0.5f"),
        (0.001, "0.001f"),
        (1e-9, "1e-09f"),
        (3e7, "3e+07f"),
        (0.1, "0.1f"),
    ],
)
def test_constants_in_float_are_written_as_people_do(value: float, expected: str) -> None:
    assert constant(value, Real("float")) == expected
    assert np.float32(expected[:-1]) == np.float32(value)
