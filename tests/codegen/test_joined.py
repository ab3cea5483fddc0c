"""Calls that are one straight line: the bits of the same calls one after the other."""

import casadi
import numpy as np
import pytest
from tests.interpreter import interpret

from flexhinf.codegen import Buffer, Call, Joined, Program, Repeat, Slice, compile_program
from flexhinf.errors import InvalidInput

X, U = casadi.SX.sym("x", 2), casadi.SX.sym("u")
SWING = casadi.Function("swing", [X, U], [casadi.vertcat(X[1], U - casadi.sin(X[0] + casadi.cos(X[1])))])
FEEDBACK = casadi.Function("feedback", [X, U], [0.3 * casadi.sin(X[0]) + X[1] * U, X * U])
A, B, V, R = Slice("a", 0, 2), Slice("b", 0, 2), Slice("v"), Slice("r", 0, 1, (1,))


def calls(first: Call) -> tuple[Call, ...]:
    """One plant, its feedback through v, and another plant that has it; the first result of all is written twice."""
    return first, Call(FEEDBACK, (A, R), (V, B)), Call(SWING, (A, V), (A,)), Call(SWING, (B, V), (B,))


def program(apart: bool) -> Program:
    body = calls(Call(SWING, (B, R), (A,)))
    buffers = Buffer("a", 2, "state"), Buffer("b", 2, "state"), Buffer("v", 1, "out"), Buffer("r", None, "in")
    return Program("p", buffers, (Repeat("n", body if apart else (Joined(body),)),), ("n",))


@pytest.mark.parametrize("lanes", [1, 4])
@pytest.mark.parametrize("scale", [1.0, 1e12])  # angles beyond the reach of the straight line
def test_joined_calls_have_the_bits_of_calls(lanes, scale):
    rng = np.random.default_rng(0)
    shape = (lanes,) if lanes > 1 else ()
    start = {name: rng.normal(size=(n, *shape)) for name, n in (("a", 2), ("b", 2), ("v", 1), ("r", 9))}
    start["r"] *= scale
    ends = []
    for apart in (True, False):
        arrays = {name: values.copy() for name, values in start.items()}
        assert compile_program(program(apart), lanes).run(arrays, {"n": 9}).fine
        ends.append(np.concatenate([arrays[name].ravel() for name in "abv"]))
    np.testing.assert_array_equal(*ends)


@pytest.mark.oracle
def test_compiled_equals_interpreted():
    ends = []
    for make in (compile_program, interpret):
        arrays = {"a": np.ones(2), "b": np.zeros(2), "v": np.zeros(1), "r": np.linspace(-1.0, 1.0, 5)}
        assert make(program(apart=False)).run(arrays, {"n": 5}).fine
        ends.append(np.concatenate([arrays[name] for name in "abv"]))
    np.testing.assert_allclose(*ends, rtol=1e-13)


def test_links_are_arguments_that_earlier_calls_compute():
    joined = Joined(calls(Call(SWING, (B, R), (A,))))
    assert joined.links == {2: 0, 4: 0, 5: 1, 6: 2, 7: 1}


@pytest.mark.parametrize("steps", [(), (Joined((Call(SWING, (A, V), (A,)),)),)])
def test_other_steps_are_not_joined(steps):
    with pytest.raises(InvalidInput):
        Joined(steps)


def test_a_part_of_what_an_earlier_call_writes_is_refused():
    with pytest.raises(InvalidInput, match="joined"):
        Joined((Call(SWING, (A, V), (A,)), Call(SWING, (B, Slice("a", 1, 1)), (B,))))
