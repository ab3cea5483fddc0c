"""Functions mapped over columns, and weighted sums: equal to NumPy, to loops of calls, and for any lanes."""

import casadi
import numpy as np
import pytest

from flexhinf.codegen import (
    Buffer,
    Call,
    Columns,
    Map,
    Program,
    Repeat,
    Slice,
    WeightedSum,
    compile_program,
    interpret,
)
from flexhinf.errors import InvalidInput

A, B = casadi.SX.sym("a", 3), casadi.SX.sym("b", 2)
TURN = casadi.Function(
    "turn",
    [A, B],
    [casadi.vertcat(casadi.sin(A[0]) * B[0] + A[1] * A[2], A[2] / (1.5 + casadi.cos(B[1] * A[0])))],
)
LANES = pytest.mark.parametrize("lanes", [1, 3, 8])


def mapped(count: int, shared: bool = False) -> Program:
    step = Map(
        TURN,
        (Columns(Slice("a", 2, 3 * count), count), Slice("b", 1, 2)),
        (Columns(Slice("y", 0, 2 * count), count),),
    )
    buffers = (Buffer("a", 2 + 3 * count, "in", shared), Buffer("b", 3, "in"), Buffer("y", 2 * count, "out"))
    return Program("mapped", buffers, (step,))


@pytest.mark.oracle
@LANES
@pytest.mark.parametrize("count", [1, 5, 8, 13, 57])
@pytest.mark.parametrize("shared", [False, True])
def test_a_map_is_the_function_of_every_column(count, lanes, shared):
    rng = np.random.default_rng(count)
    a = rng.normal(size=(2 + 3 * count, *(() if shared else (lanes,))))
    b = rng.normal(size=(3, lanes))
    results = []
    for make in (compile_program, interpret):
        kernel, y = make(mapped(count, shared), lanes), np.full((2 * count, lanes), np.nan)
        assert kernel.run({"a": a if not shared or lanes > 1 else a.ravel(), "b": b, "y": y}).fine
        results.append(y.copy())
    for lane in range(lanes):
        columns = (a if shared else a[:, lane])[2:].reshape(3, count)
        expected = np.array(TURN.map(count)(columns, np.tile(b[1:, lane : lane + 1], count))).ravel()
        np.testing.assert_allclose(results[0][:, lane], expected, rtol=1e-14, atol=1e-15)
        np.testing.assert_array_equal(results[1][:, lane], expected)


def test_the_bits_of_a_map_depend_on_neither_columns_nor_lanes():
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(3, 57)), rng.normal(size=2)
    whole = np.zeros((2, 57))
    compile_program(mapped(57)).run(
        {"a": np.concatenate([[0, 0], a.ravel()]), "b": np.array([0, *b]), "y": whole}
    )
    for k in range(57):
        one = np.zeros(2)
        arrays = {"a": a[:, k].copy(), "b": b, "y": one}
        call = Call(TURN, (Slice("a", 0, 3), Slice("b", 0, 2)), (Slice("y", 0, 2),))
        buffers = (Buffer("a", 3, "in"), Buffer("b", 2, "in"), Buffer("y", 2, "out"))
        compile_program(Program("called", buffers, (call,))).run(arrays)
        np.testing.assert_array_equal(one, whole[:, k])
    lanes = np.zeros((2 * 57, 4))
    column = np.concatenate([[0, 0], a.ravel()])
    arrays = {"a": np.tile(column[:, None], 4), "b": np.tile(np.array([0, *b])[:, None], 4), "y": lanes}
    compile_program(mapped(57), 4).run(arrays)
    np.testing.assert_array_equal(lanes, np.tile(whole.reshape(-1, 1), 4))


@pytest.mark.oracle
@LANES
@pytest.mark.parametrize("make", [compile_program, interpret])
def test_a_map_in_place_inside_a_loop(make, lanes):
    shift = casadi.Function("shift", [A, B], [A + casadi.vertcat(B, 1.0)])
    step = Map(
        shift, (Columns(Slice("a", 0, 33), 11), Slice("b", 0, 2, (2,))), (Columns(Slice("a", 0, 33), 11),)
    )
    buffers = (Buffer("a", 33, "state"), Buffer("b", None, "in", shared=True))
    kernel = make(Program("shifted", buffers, (Repeat("n", (step,)),), ("n",)), lanes)
    start, b = np.random.default_rng(0).normal(size=(33, lanes)), np.arange(10.0)
    a = start.copy()
    assert kernel.run({"a": a, "b": b}, {"n": 5}).fine
    expected = start.reshape(3, 11, lanes) + np.array([20.0, 25.0, 5.0])[:, None, None]
    np.testing.assert_allclose(a.reshape(3, 11, lanes), expected, rtol=1e-14)


def summed(count: int, width: int, shared: bool) -> Program:
    step = WeightedSum(Slice("w", 0, count), Slice("r", 1, count * width), Slice("y", 1, width))
    buffers = (
        Buffer("w", count, "in"),
        Buffer("r", 1 + count * width, "in", shared),
        Buffer("y", 1 + width, "out"),
    )
    return Program("summed", buffers, (step,))


@pytest.mark.oracle
@LANES
@pytest.mark.parametrize(("count", "width"), [(1, 1), (7, 3), (8, 8), (100, 7), (29, 21)])
@pytest.mark.parametrize("shared", [False, True])
def test_a_weighted_sum_is_numpys(count, width, lanes, shared):
    rng = np.random.default_rng(width)
    w = rng.normal(size=(count, lanes))
    rows = rng.normal(size=(1 + count * width, 1 if shared else lanes))
    expected = np.einsum(
        "al,aml->ml", w, np.broadcast_to(rows[1:], (count * width, lanes)).reshape(count, width, lanes)
    )
    given = {"w": w, "r": rows.ravel() if shared else rows}
    for make in (compile_program, interpret):
        y = np.full((1 + width, lanes), 7.0)
        assert make(summed(count, width, shared), lanes).run({**given, "y": y}).fine
        np.testing.assert_allclose(y[1:], expected, rtol=1e-13, atol=1e-13)
        np.testing.assert_array_equal(y[0], 7.0)


def test_the_bits_of_a_weighted_sum_do_not_depend_on_lanes_or_neighbours():
    rng = np.random.default_rng(0)
    w, rows = rng.normal(size=75), rng.normal(size=(75, 13))
    y = np.zeros(14)
    compile_program(summed(75, 13, False)).run({"w": w, "r": np.concatenate([[0], rows.ravel()]), "y": y})
    for lanes in (2, 8):
        many = np.zeros((14, lanes))
        given = {"w": np.tile(w[:, None], lanes), "r": np.concatenate([[0], rows.ravel()]), "y": many}
        compile_program(summed(75, 13, True), lanes).run(given)
        np.testing.assert_array_equal(many, np.tile(y[:, None], lanes))
    for column in range(13):
        alone = np.zeros(2)
        given = {"w": w, "r": np.concatenate([[0], rows[:, column]]), "y": alone}
        compile_program(summed(75, 1, False)).run(given)
        assert alone[1] == y[1 + column]


def test_lanes_that_are_no_power_of_two_lie_side_by_side():
    """Three float64 numbers are 24 bytes, though LLVM pads a vector of them to 32."""
    double = casadi.Function("double", [A], [2 * A])
    call = Call(double, (Slice("a", 0, 3),), (Slice("y", 0, 3),))
    program = Program("doubled", (Buffer("a", 3, "in"), Buffer("y", 3, "out")), (call,))
    a, y = np.arange(9.0).reshape(3, 3), np.zeros((3, 3))
    compile_program(program, 3).run({"a": a, "y": y})
    np.testing.assert_array_equal(y, 2 * a)


def test_long_runs_need_no_more_stack_than_short_ones():
    """Loops and guards inside of a loop once took stack in every turn."""
    from flexhinf.codegen import Guard

    body = (
        Map(
            casadi.Function("f", [A[0]], [A[0] + 1]),
            (Columns(Slice("a", 0, 40), 40),),
            (Columns(Slice("a", 0, 40), 40),),
        ),
        Guard(Slice("a", 0, 40), 1),
    )
    inner = Repeat("m", (Call(casadi.Function("f", [A], [A / 2]), (Slice("a", 0, 3),), (Slice("a", 0, 3),)),))
    program = Program("long", (Buffer("a", 40, "state"),), (Repeat("n", (*body, inner)),), ("n", "m"))
    a = np.zeros(40)
    assert compile_program(program).run({"a": a}, {"n": 2_000_000, "m": 1}).fine
    assert a[3] == 2_000_000


MATRIX = Columns(Slice("a", 0, 6), 2)
REFUSED = {
    "columns that do not divide": lambda: Columns(Slice("a", 0, 7), 2),
    "no columns": lambda: Columns(Slice("a", 0, 7), 0),
    "another number of columns": lambda: Map(
        TURN, (MATRIX, Slice("b", 0, 2)), (Columns(Slice("y", 0, 6), 3),)
    ),
    "a result that is one slice": lambda: Map(TURN, (MATRIX, Slice("b", 0, 2)), (Slice("y", 0, 2),)),
    "a result over its neighbours": lambda: Map(
        casadi.Function("f", [A], [A]), (MATRIX,), (Columns(Slice("a", 3, 6), 2),)
    ),
    "a result over what is held": lambda: Map(
        TURN, (MATRIX, Slice("y", 3, 2)), (Columns(Slice("y", 0, 4), 2),)
    ),
    "a sum of another size": lambda: WeightedSum(Slice("w", 0, 3), Slice("r", 0, 7), Slice("y", 0, 2)),
    "a sum over its weights": lambda: WeightedSum(Slice("w", 0, 3), Slice("r", 0, 6), Slice("w", 2, 2)),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused_in_three_parts(case):
    with pytest.raises(InvalidInput) as caught:
        REFUSED[case]()
    assert caught.value.advice
