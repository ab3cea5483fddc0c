"""Steps that are left out where a flag is zero, and loops of a fixed count: compiled, interpreted, composed."""

import casadi
import numpy as np
import pytest
from tests.interpreter import interpret

from flexhinf.codegen import (
    DIRECT,
    Block,
    Buffer,
    Call,
    Composer,
    Copy,
    Program,
    Repeat,
    Slice,
    When,
    compile_program,
)

X = casadi.SX.sym("x", 2)
DOUBLE = casadi.Function("double", [X], [2 * X])
MAKERS = pytest.mark.parametrize("make", [compile_program, interpret])


def doubled() -> Program:
    """x doubled in every turn whose flag is not zero, and copied out."""
    x = Slice("x", 0, 2)
    body = (
        When(Slice("flags", 0, 1, (1,)), (Call(DOUBLE, (x,), (x,)),)),
        Copy(x, Slice("y", 0, 2, (2,))),
    )
    buffers = (Buffer("x", 2, "state"), Buffer("flags", None, "in"), Buffer("y", None, "out"))
    return Program("doubled", buffers, (Repeat("n", body),), ("n",))


@MAKERS
def test_one_lane_runs_the_body_where_its_flag_is_set(make):
    flags = np.array([0.0, 1.0, 0.0, -0.5, np.nan, -0.0])
    arrays = {"x": np.array([1.0, -3.0]), "flags": flags, "y": np.zeros(12)}
    assert make(doubled()).run(arrays, {"n": 6}).fine
    np.testing.assert_array_equal(arrays["y"].reshape(6, 2)[:, 0], [1.0, 2.0, 2.0, 4.0, 8.0, 8.0])


def test_a_lane_beside_one_with_a_flag_runs_in_vain():
    """The body is left out only if no lane wants it: whoever reads must choose by the flag."""
    arrays = {"x": np.ones((2, 4)), "flags": np.zeros((2, 4)), "y": np.zeros((4, 4))}
    arrays["flags"][1, 2] = 1.0
    assert compile_program(doubled(), 4).run(arrays, {"n": 2}).fine
    np.testing.assert_array_equal(arrays["y"][[0, 2]], [[1.0] * 4, [2.0] * 4])


def chosen(run, x, flag):
    """What a text with a condition looks like: nested, and chosen by the flag."""
    with run.when(flag):
        twice = run.call(lambda x: 2.0 * x, x)
        with run.when(flag):
            thrice = run.call(lambda x, y: x + y, x, twice)
    return run.call(choose, flag, thrice, x)


def choose(flag, one, other):
    from flexhinf.scalars import where

    return where(flag[0] != 0.0, one, other)


@pytest.mark.oracle
@MAKERS
@pytest.mark.parametrize("lanes", [1, 3])
def test_composed_equals_direct(make, lanes):
    run = Composer()
    x, flag = Block(Slice("x", 0, 2), (2,)), Block(Slice("flag", 0, 1), (1,))
    run.copy(chosen(run, x, flag), Block(Slice("y", 0, 2), (2,)))
    assert [type(step).__name__ for step in run.body] == ["When", "Call", "Copy"]
    buffers = (Buffer("x", 2, "in"), Buffer("flag", 1, "in"), Buffer("y", 2, "out"), *run.buffers)
    kernel = make(Program("chosen", buffers, tuple(run.body)), lanes)
    values = np.random.default_rng(0).normal(size=(2, lanes))
    for flags in (np.zeros(lanes), np.eye(lanes)[0], np.ones(lanes)):
        arrays = {"x": values, "flag": flags.reshape(1, lanes), "y": np.zeros((2, lanes))}
        assert kernel.run({k: np.ascontiguousarray(a) for k, a in arrays.items()} | {"y": arrays["y"]}).fine
        for lane in range(lanes):
            expected = chosen(DIRECT, values[:, lane], flags[lane : lane + 1])
            np.testing.assert_allclose(arrays["y"][:, lane], expected, rtol=1e-15)


def powered(run, x, y):
    """(x + y, x · y) again and again, of what was before."""
    return run.repeat(
        5, lambda x, y: (run.call(lambda x, y: x + y, x, y), run.call(lambda x, y: x * y, x, y)), x, y
    )


@pytest.mark.oracle
@MAKERS
def test_a_loop_of_a_fixed_count_inside_of_one_that_moves(make):
    run = Composer()
    x, y = (Block(Slice("z", 2 * k, 2), (2,)) for k in range(2))
    for k, result in enumerate(powered(run, x, y)):
        run.copy(result, Block(Slice("out", 2 * k, 2, (4,)), (2,)))
    assert [type(step).__name__ for step in run.body] == ["Copy", "Copy", "Repeat", "Copy", "Copy"]
    buffers = (Buffer("z", 4, "in"), Buffer("out", None, "out"), *run.buffers)
    arrays = {"z": np.array([0.3, -1.1, 0.7, 0.4]), "out": np.zeros(8)}
    assert (
        make(Program("powered", buffers, (Repeat("n", tuple(run.body)),), ("n",))).run(arrays, {"n": 2}).fine
    )
    expected = np.concatenate(powered(DIRECT, arrays["z"][:2], arrays["z"][2:]))
    np.testing.assert_allclose(arrays["out"], np.tile(expected, 2), rtol=1e-14)
