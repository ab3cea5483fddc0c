"""The interpreter against plain NumPy."""

import casadi
import numpy as np
import pytest
from tests.interpreter import interpret

from flexhinf.codegen import Buffer, Call, Copy, Guard, Program, Repeat, Slice


@pytest.mark.oracle
@pytest.mark.parametrize("lanes", [1, 3])
def test_a_recursion_equals_its_loop_in_numpy(lanes):
    x, u = casadi.SX.sym("x", 2), casadi.SX.sym("u")
    turn = casadi.Function("turn", [x, u], [casadi.vertcat(x[1], casadi.cos(x[0]) + u), x[0] * u])
    body = (
        Call(turn, (Slice("x", 0, 2), Slice("u", 0, 1, (1,))), (Slice("x", 0, 2), Slice("w", 1))),
        Copy(Slice("w", 0, 2), Slice("y", 0, 2, (2,))),
        Guard(Slice("y", 0, 2, (2,)), 5),
    )
    buffers = (
        Buffer("x", 2, "state"),
        Buffer("u", None, "in", shared=True),
        Buffer("y", None, "out"),
        Buffer("w", 2, "work"),
    )
    kernel = interpret(Program("recursion", buffers, (Repeat("n", body),), ("n",)), lanes)
    state = np.random.default_rng(0).normal(size=(2, lanes))
    inputs = np.array([0.1, -0.3, 0.5, 0.2])
    expected, rows = state.copy(), []
    for value in inputs:
        rows += [np.zeros(lanes), expected[0] * value]
        expected = np.array([expected[1], np.cos(expected[0]) + value])
    path = np.empty((8, lanes))
    assert kernel.run({"x": state, "u": inputs, "y": path}, {"n": 4}).fine
    np.testing.assert_allclose(state, expected, rtol=1e-15)
    np.testing.assert_allclose(path, rows, rtol=1e-15)
