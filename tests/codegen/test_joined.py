"""Calls that are one straight line: the bits of the same calls one after the other."""

from dataclasses import replace

import casadi
import numpy as np
import pytest
from tests.interpreter import interpret

from flexhinf.codegen import Buffer, Call, Copy, Program, Repeat, Slice, compile_program
from flexhinf.codegen.emit.module import emit_module

X, U = casadi.SX.sym("x", 2), casadi.SX.sym("u")
SWING = casadi.Function("swing", [X, U], [casadi.vertcat(X[1], U - casadi.sin(X[0] + casadi.cos(X[1])))])
FEEDBACK = casadi.Function("feedback", [X, U], [0.3 * casadi.sin(X[0]) + X[1] * U, X * U])
A, B, V, R = Slice("a", 0, 2), Slice("b", 0, 2), Slice("v"), Slice("r", 0, 1, (1,))


HALF = casadi.Function("half", [U], [U / 2 + casadi.sin(U)])


def program(joins: bool, *, part: bool = False) -> Program:
    """One plant, its feedback through v, and another plant that has it; a is written twice, and may be read in part."""
    calls = [
        Call(SWING, (B, R), (A,)),
        Call(FEEDBACK, (A, R), (V, B)),
        Call(SWING, (A, V), (A,)),
        Call(SWING, (B, V), (B,)),
        Call(HALF, (Slice("a", 1, 1) if part else V,), (V,)),
        Copy(V, V),
        Call(HALF, (V,), (V,)),
    ]
    body = tuple(replace(call, joins=joins) if isinstance(call, Call) else call for call in calls)
    buffers = Buffer("a", 2, "state"), Buffer("b", 2, "state"), Buffer("v", 1, "out"), Buffer("r", None, "in")
    return Program("p", buffers, (Repeat("n", body),), ("n",))


@pytest.mark.quick_cases(4)
@pytest.mark.parametrize("part", [False, True])
@pytest.mark.parametrize("lanes", [1, 4])
@pytest.mark.parametrize("scale", [1.0, 1e12])  # angles beyond the reach of the straight line
def test_joined_calls_have_the_bits_of_calls(lanes, scale, part):
    rng = np.random.default_rng(0)
    shape = (lanes,) if lanes > 1 else ()
    start = {name: rng.normal(size=(n, *shape)) for name, n in (("a", 2), ("b", 2), ("v", 1), ("r", 9))}
    start["r"] *= scale
    ends = []
    for joins in (False, True):
        arrays = {name: values.copy() for name, values in start.items()}
        assert compile_program(program(joins, part=part), lanes).run(arrays, {"n": 9}).fine
        ends.append(np.concatenate([arrays[name].ravel() for name in "abv"]))
    np.testing.assert_array_equal(*ends)


@pytest.mark.oracle
def test_compiled_equals_interpreted():
    ends = []
    for make in (compile_program, interpret):
        arrays = {"a": np.ones(2), "b": np.zeros(2), "v": np.zeros(1), "r": np.linspace(-1.0, 1.0, 5)}
        assert make(program(joins=True)).run(arrays, {"n": 5}).fine
        ends.append(np.concatenate([arrays[name] for name in "abv"]))
    np.testing.assert_allclose(*ends, rtol=1e-13)


def calls_of(wanted: Program) -> int:
    return str(emit_module(wanted, 1)).split("@flexhinf_run(")[1].count("call void @flexhinf_function")


def test_what_reads_a_part_of_a_result_does_not_join():
    assert calls_of(program(joins=False)) == 6
    assert calls_of(program(joins=True)) == 2
    assert calls_of(program(joins=True, part=True)) == 3
