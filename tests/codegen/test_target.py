"""Another target is one file: the example that CONTRIBUTING.md prints, beside CasADi and a controller's own steps."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import casadi
import numpy as np
import pytest
from tests.builders import arm_controller
from tests.codegen.emit.test_opcodes import BINARY, UNARY, X, Y
from tests.example_target import python_of

import flexhinf as fh

ORDINARY = (0.0, 0.25, 1.0, -0.5, -2.5, 3.0, 7.5, math.nan)


def loaded(function: casadi.Function) -> Callable[..., Sequence[list[float]]]:
    """The function that the text defines, as a reader of the file gets it."""
    scope: dict[str, Any] = {}
    exec(compile(python_of(function), "target.py", "exec"), scope)
    return scope[function.name()]


@pytest.mark.oracle
@pytest.mark.parametrize("name", [*UNARY, *BINARY])
def test_every_operation_of_the_table_is_that_of_casadi(name: str) -> None:
    symbols = [X] if name in UNARY else [X, Y]
    function = casadi.Function("f", symbols, [(UNARY | BINARY)[name]])
    pairs = [(x, y) for x in ORDINARY for y in ORDINARY if name in BINARY or y == 1.0]
    compared = 0
    for pair in pairs:
        columns = pair[: len(symbols)]
        expected = float(function(*columns))
        if math.isfinite(expected):
            assert loaded(function)(*([x] for x in columns))[0][0] == pytest.approx(expected, rel=1e-14)
            compared += 1
    assert compared > 2


@pytest.mark.costs("a controller is traced and read")
def test_a_controller_in_one_trace_is_a_module_of_plain_python() -> None:
    controller = arm_controller(kind=fh.ExtendedKalmanFilter)
    step, memory = loaded(controller.traced()), controller.initial_memory()
    for y in (0.3, 0.2, 0.25):
        expected, _ = controller.evaluate(y, controller.operating_reference, memory)
        u, _, memory = step([y], controller.operating_reference, memory, controller.data_vector)
        np.testing.assert_allclose(u, expected, rtol=1e-12)
        assert abs(u[0]) > 0.1
