"""Functions mapped over columns, and weighted sums: equal to NumPy, to loops of calls, and for any lanes."""

import shutil
from fractions import Fraction

import casadi
import numpy as np
import pytest
from tests.in_c import in_c as programs_in_c
from tests.interpreter import interpret

from flexhinf.codegen import (
    Buffer,
    Call,
    Cholesky,
    Columns,
    Copy,
    Guard,
    Householder,
    Map,
    OuterSum,
    Program,
    Repeat,
    Residual,
    Slice,
    Sweep,
    compile_program,
)
from flexhinf.codegen.machine import host
from flexhinf.codegen.memory import COLUMN
from flexhinf.codegen.program import Step
from flexhinf.errors import InvalidInput
from flexhinf.scalars import householder

A, B = casadi.SX.sym("a", 3), casadi.SX.sym("b", 2)
TURN = casadi.Function(
    "turn",
    [A, B],
    [casadi.vertcat(casadi.sin(A[0]) * B[0] + A[1] * A[2], A[2] / (1.5 + casadi.cos(B[1] * A[0])))],
)
SHIFT = casadi.Function("shift", [A, B], [A + casadi.vertcat(B, 1.0)])
LANES = pytest.mark.parametrize("lanes", [1, 3, 8])
LARGE_TABLES = [
    pytest.param(*size, marks=pytest.mark.ci("large tables")) for size in ((25, 8, 8), (85, 28, 28))
]


def mapped(count: int, shared: bool = False) -> Program:
    step = Map(
        TURN,
        (Columns(Slice("a", 2, 3 * count), count), Slice("b", 1, 2)),
        (Columns(Slice("y", 0, 2 * count), count),),
    )
    buffers = (Buffer("a", 2 + 3 * count, "in", shared), Buffer("b", 3, "in"), Buffer("y", 2 * count, "out"))
    return Program("mapped", buffers, (step,))


@pytest.mark.quick_cases(6)
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


@pytest.mark.quick_cases(9)
@pytest.mark.oracle
@LANES
@pytest.mark.parametrize("make", [compile_program, interpret])
@pytest.mark.parametrize("count", [1, 3, 8, 9, 21])
@pytest.mark.parametrize("place", ["a", "y"])
def test_again_and_again_in_another_order(make, lanes, count, place):
    """Columns one after the other, in memory of their own; three times, in place or not."""
    here, there = (Slice(COLUMN, at, 3) for at in (1, 4))
    turn = (Call(SHIFT, (here, Slice("b", 0, 2)), (there,)), Copy(there, here))
    pairs = [((Columns(Slice(buffer, 0, 3 * count), count, "F"), here),) for buffer in ("a", place)]
    step = Sweep((Repeat(3, turn),), *pairs, size=7)
    buffers = (Buffer("a", 3 * count, "state"), Buffer("b", 2, "in"), Buffer("y", 3 * count, "out"))
    a = np.random.default_rng(0).normal(size=(3 * count, lanes))
    b = np.array([[1.0], [2.0]]) * np.ones(lanes)
    arrays = {"a": a.copy(), "b": b, "y": np.zeros_like(a)}
    assert make(Program("again", buffers, (step,)), lanes).run(arrays).fine
    expected = a + np.tile([3.0, 6.0, 3.0], count)[:, None]
    np.testing.assert_allclose(arrays[place], expected, rtol=1e-14)
    if place == "y":
        np.testing.assert_array_equal(arrays["a"], a)


def summed(count: int, rows: int, columns: int, shared: bool, **options: bool) -> Program:
    """Of sums of outer products, with weights and a matrix to add."""
    square = options.get("symmetric", False)
    left = Slice("l", 2, count * rows)
    step = OuterSum(
        left,
        left if square else Slice("r", 1, count * columns),
        Slice("y", 1, rows * columns),
        count,
        Slice("w", 0, count) if options.get("weighted") else None,
        Slice("p", 0, rows * columns) if options.get("plus") else None,
        square,
    )
    buffers = (
        Buffer("l", 2 + count * rows, "in", shared),
        Buffer("r", 1 + count * columns, "in"),
        Buffer("w", count, "in"),
        Buffer("p", rows * columns, "in", shared),
        Buffer("y", 1 + rows * columns, "out"),
    )
    return Program("summed", buffers, (step,))


def given(program: Program, lanes: int, seed: int = 0) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    arrays = {}
    for buffer in program.buffers:
        shape = (buffer.size,) if buffer.shared else (buffer.size, lanes)
        arrays[buffer.name] = rng.normal(size=shape)
    return arrays


@pytest.mark.quick_cases(10)
@pytest.mark.oracle
@LANES
@pytest.mark.parametrize("size", [(1, 1, 1), (7, 1, 3), (8, 2, 8), (57, 7, 28), (29, 4, 21), (413, 2, 7)])
@pytest.mark.parametrize("options", [{}, {"weighted": True, "plus": True}])
@pytest.mark.parametrize("shared", [False, True])
def test_a_sum_of_outer_products_is_numpys(size, options, lanes, shared):
    count, rows, columns = size
    program = summed(*size, shared, **options)
    arrays = given(program, lanes)
    each = {k: np.broadcast_to(v.reshape(len(v), -1), (len(v), lanes)) for k, v in arrays.items()}
    left, right = each["l"][2:].reshape(count, rows, -1), each["r"][1:].reshape(count, columns, -1)
    weights = each["w"] if options else np.ones((count, lanes))
    expected = np.einsum("kl,kil,kjl->ijl", weights, left, right).reshape(-1, lanes)
    expected = expected + (each["p"] if options else 0.0)
    for make in (compile_program, interpret):
        arrays["y"][:] = 7.0
        assert make(program, lanes).run(arrays).fine
        np.testing.assert_allclose(arrays["y"][1:], expected, rtol=1e-12, atol=1e-12)
        np.testing.assert_array_equal(arrays["y"][0], 7.0)


@pytest.mark.quick_cases(9)
@pytest.mark.oracle
@LANES
@pytest.mark.parametrize("make", [compile_program, interpret])
@pytest.mark.parametrize(("count", "n"), [(5, 1), (9, 6), (57, 28)])
def test_a_symmetric_sum_is_the_sum_and_exactly_symmetric(make, count, n, lanes):
    program = summed(count, n, n, False, symmetric=True, weighted=True)
    arrays = given(program, lanes)
    assert make(program, lanes).run(arrays).fine
    result = arrays["y"][1:].reshape(n, n, lanes)
    np.testing.assert_array_equal(result, result.transpose(1, 0, 2))
    points = arrays["l"][2:].reshape(count, n, lanes)
    expected = np.einsum("kl,kil,kjl->ijl", arrays["w"], points, points)
    np.testing.assert_allclose(result, expected, rtol=1e-12, atol=1e-12)


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize("count", [75, 413])
@pytest.mark.parametrize("symmetric", [False, True])
def test_the_bits_of_a_sum_do_not_depend_on_lanes(symmetric, count):
    program = summed(count, 13, 13, False, symmetric=symmetric, weighted=True, plus=True)
    arrays = given(program, 1)
    compile_program(program).run(arrays)
    for lanes in (2, 8):
        many = {name: np.repeat(array, lanes, axis=1) for name, array in arrays.items()}
        many["y"][:] = 0.0
        compile_program(program, lanes).run(many)
        np.testing.assert_array_equal(many["y"][1:], np.repeat(arrays["y"][1:], lanes, axis=1))


def factored(n: int) -> Program:
    buffers = (Buffer("a", n * n, "in"), Buffer("y", n * n, "out"))
    return Program("factored", buffers, (Cholesky(Slice("a", 0, n * n), Slice("y", 0, n * n)),))


@pytest.mark.quick_cases(7)
@pytest.mark.oracle
@LANES
@pytest.mark.parametrize("make", [compile_program, interpret])
@pytest.mark.parametrize("n", [1, 2, 8, 13, 28, 65])
def test_a_cholesky_factor_is_numpys(make, n, lanes):
    roots = np.random.default_rng(n).normal(size=(lanes, n, n))
    matrices = roots @ roots.transpose(0, 2, 1) + np.eye(n)
    y = np.full((n * n, lanes), np.nan)
    assert make(factored(n), lanes).run({"a": matrices.reshape(lanes, -1).T.copy(), "y": y}).fine
    for lane in range(lanes):
        np.testing.assert_allclose(y[:, lane].reshape(n, n).T, np.linalg.cholesky(matrices[lane]), atol=1e-12)
    if make is compile_program and lanes > 1:
        alone = np.empty((n * n, 1))
        compile_program(factored(n)).run({"a": matrices[-1].reshape(-1, 1).copy(), "y": alone})
        np.testing.assert_array_equal(alone[:, 0], y[:, -1])


@pytest.mark.parametrize("make", [compile_program, interpret])
@pytest.mark.parametrize("lanes", [1, 3])
def test_a_factor_of_what_is_not_positive(make, lanes):
    """Zero columns for exactly known states and for low rank, NaN for a negative pivot."""
    columns = np.random.default_rng(0).normal(size=(11, 3))
    low_rank = np.zeros((12, 12))
    low_rank[1:, 1:] = columns @ columns.T
    y = np.empty((144, lanes))
    kernel = make(factored(12), lanes)
    kernel.run({"a": np.repeat(low_rank.reshape(-1, 1), lanes, axis=1), "y": y})
    factor = y[:, 0].reshape(12, 12).T
    np.testing.assert_allclose(factor @ factor.T, low_rank, atol=1e-12)
    np.testing.assert_array_equal(factor[:, [0, *range(4, 12)]], 0.0)
    kernel.run({"a": np.repeat(-np.eye(12).reshape(-1, 1), lanes, axis=1), "y": y})
    assert np.isnan(y).any()


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("n", [5, 2, 28, 13])
def test_factors_of_low_rank_are_finite_and_the_same_in_lanes_and_in_c(n, tmp_path):
    """A pivot that rounding makes negative counts as zero, by the same rule as in `flexhinf.scalars.cholesky`."""
    rng, alone, lanes = (
        np.random.default_rng(n),
        compile_program(factored(n)),
        compile_program(factored(n), 8),
    )
    compiled = in_c(factored(n), tmp_path)
    for _ in range(25):
        roots = rng.normal(size=(8, n, n - 1)) * 10.0 ** rng.uniform(-3, 3, (8, 1, n - 1))
        roots *= 10.0 ** rng.uniform(-6, 6, (8, n, 1))
        matrices = roots @ roots.transpose(0, 2, 1)
        many, one = np.empty((n * n, 8)), np.empty((n * n, 1))
        lanes.run({"a": matrices.reshape(8, -1).T.copy(), "y": many})
        for matrix, row in zip(matrices, many.T):
            alone.run({"a": matrix.reshape(-1, 1).copy(), "y": one})
            np.testing.assert_array_equal(one[:, 0], row)
            factor, size = row.reshape(n, n).T, np.sqrt(np.diag(matrix))
            assert np.all(np.abs(factor @ factor.T - matrix) <= 1e-6 * np.outer(size, size))
            if compiled is not None:
                np.testing.assert_array_equal(compiled(matrix), row)
    indefinite = np.diag([*np.ones(n - 1), -1e-9])
    alone.run({"a": indefinite.reshape(-1, 1), "y": one})
    assert np.isnan(one).any()
    assert compiled is None or np.isnan(compiled(indefinite)).any()


def reflected(m: int, k: int, count: int) -> Program:
    """Reflections of (m, k), in the memory of the result."""
    buffers = (Buffer("a", m * k, "in"), Buffer("y", m * k, "out"))
    return Program(
        "reflected", buffers, (Householder(Slice("a", 0, m * k), Slice("y", 0, m * k), (m, k), count),)
    )


@pytest.mark.quick_cases(7)
@pytest.mark.oracle
@LANES
@pytest.mark.parametrize("make", [compile_program, interpret])
@pytest.mark.parametrize(("m", "k", "count"), [(1, 1, 1), (5, 3, 2), (13, 4, 4), (7, 9, 3), *LARGE_TABLES])
def test_reflections_make_a_triangle_of_the_same_squares(make, m, k, count, lanes, tmp_path):
    rng = np.random.default_rng(m)
    tables = rng.normal(size=(lanes, m, k)) * 10.0 ** rng.uniform(-8.0, 8.0, (lanes, m, 1))
    tables[:, m // 2] = 0.0
    if m > 4:
        tables[:, :, count - 1] = 0.0  # a column of zeros stays one
    y = np.full((m * k, lanes), np.nan)
    assert make(reflected(m, k, count), lanes).run({"a": tables.reshape(lanes, -1).T.copy(), "y": y}).fine
    compiled = in_c(reflected(m, k, count), tmp_path) if make is compile_program and lanes == 1 else None
    alone = np.empty((m * k, 1))
    for table, found in zip(tables, y.T.reshape(lanes, m, k), strict=True):
        np.testing.assert_array_equal(np.tril(found[:, :count], -1), 0.0)
        size = np.sqrt((table**2).sum(axis=0))
        error = np.abs(found.T @ found - table.T @ table)
        assert np.all(error <= 1e-13 * np.outer(size, size))
        if count == k:
            triangle = np.linalg.qr(table, mode="r")[:k]
            signs = np.sign(np.diag(found)[:k, None]) * np.sign(np.diag(triangle)[:, None])
            np.testing.assert_allclose(found[: len(triangle)], signs * triangle, atol=1e-11 * size.max())
        if compiled is not None:
            np.testing.assert_array_equal(compiled(table), found.ravel())
        if make is compile_program:
            compile_program(reflected(m, k, count)).run({"a": table.reshape(-1, 1).copy(), "y": alone})
            np.testing.assert_array_equal(alone[:, 0], found.ravel())


@pytest.mark.oracle
@pytest.mark.parametrize(
    ("m", "k", "first", "count"),
    [(9, 3, 0, 2), pytest.param(17, 5, 1, 4, marks=pytest.mark.ci("a larger table"))],
)
def test_neighbouring_columns_that_count_as_zero_are_zero_below_the_diagonal(m, k, first, count, tmp_path):
    """Their squares are below what counts. NumPy, lanes and C have the same bits; NumPy rounds other columns."""
    rng = np.random.default_rng(m)
    tables = rng.normal(size=(16, m, k))
    tables[:, :, first : first + 2] *= 1e-150
    numbers = tables.reshape(16, -1)
    alone, one = compile_program(reflected(m, k, count)), np.empty((m * k, 1))
    compiled = in_c(reflected(m, k, count), tmp_path)
    for table in tables:
        assert alone.run({"a": table.reshape(-1, 1).copy(), "y": one}).fine
        found, expected = one.reshape(m, k), householder(table, count)
        np.testing.assert_array_equal(np.tril(found[:, :count], -1), 0.0)
        np.testing.assert_allclose(found, expected, rtol=1e-9 if first else 0.0)
        if compiled is not None:
            np.testing.assert_array_equal(compiled(table), one[:, 0])
    for lanes in (1, 3, 16):
        y = np.empty((m * k, lanes))
        assert (
            compile_program(reflected(m, k, count), lanes).run({"a": numbers[:lanes].T.copy(), "y": y}).fine
        )
        alone.run({"a": numbers[lanes - 1].reshape(-1, 1), "y": one})
        np.testing.assert_array_equal(y[:, -1:], one)


def subtracted(s: int, p: int, n: int) -> Program:
    """e − C x − v of s rows that follow C in one buffer."""
    size = s * (2 * p + n)
    step = Residual(Slice("a", p * n, size), Slice("a", 0, p * n), Slice("y", 0, s * p), (p, n))
    return Program("subtracted", (Buffer("a", p * n + size, "in"), Buffer("y", s * p, "out")), (step,))


@pytest.mark.quick_cases(7)
@pytest.mark.oracle
@LANES
@pytest.mark.parametrize("make", [compile_program, interpret])
@pytest.mark.parametrize(
    ("s", "p", "n"),
    [
        (1, 1, 1),
        (1, 3, 2),
        (5, 1, 4),
        (9, 2, 6),
        pytest.param(29, 7, 28, marks=pytest.mark.ci("a large table")),
    ],
)
def test_a_residual_has_the_digits_of_exact_arithmetic(make, s, p, n, lanes, tmp_path):
    rng = np.random.default_rng(s)
    slope = rng.normal(size=(lanes, p, n)) * 10.0 ** rng.uniform(-8.0, 8.0, (lanes, 1, n))
    x, v = rng.normal(size=(lanes, s, n)), 1e-12 * rng.normal(size=(lanes, s, p))
    rows = np.concatenate([x @ slope.transpose(0, 2, 1), x, v], axis=2)  # what is left is rounding
    given = np.concatenate([slope.reshape(lanes, -1), rows.reshape(lanes, -1)], axis=1)
    y, alone, program = np.full((s * p, lanes), np.nan), np.empty((s * p, 1)), subtracted(s, p, n)
    assert make(program, lanes).run({"a": given.T.copy(), "y": y}).fine
    compiled = in_c(program, tmp_path) if make is compile_program and lanes == 1 else None
    for c, row, numbers, found in zip(slope, rows, given, y.T):
        exact = [
            Fraction(e[i]) - sum(Fraction(a) * Fraction(b) for a, b in zip(c[i], e[p : p + n])) - Fraction(e[p + n + i])
            for e in row for i in range(p)
        ]  # fmt: skip
        size = np.abs(row[:, p : p + n]) @ np.abs(c.T)
        np.testing.assert_array_less(
            np.abs(found - np.array(exact, float)), 1e-30 * size.ravel() + 1e-15 * np.abs(found)
        )
        if make is compile_program:
            compile_program(program).run({"a": numbers.reshape(-1, 1).copy(), "y": alone})
            np.testing.assert_array_equal(alone[:, 0], found)
        if compiled is not None:
            np.testing.assert_array_equal(compiled(numbers), found)


def test_reflections_in_place_are_those_apart():
    table, program = np.random.default_rng(0).normal(size=(6, 3)), reflected(6, 3, 3)
    y, here = np.empty((18, 1)), table.reshape(-1, 1).copy()
    compile_program(program).run({"a": here.copy(), "y": y})
    step = Householder(Slice("y", 0, 18), Slice("y", 0, 18), (6, 3), 3)
    compile_program(Program("here", (Buffer("y", 18, "state"),), (step,))).run({"y": here})
    np.testing.assert_array_equal(here, y)


def in_c(program, folder):
    """A program of `a` and `y` in C, as this processor rounds; None where there is no compiler.

    With and without fused multiply-adds, C and machine code must agree.
    """
    if shutil.which("gcc") is None:
        return None
    compiled = {fused: programs_in_c({"program": program}, folder, fused) for fused in (False, True)}
    kernels = {fused: compile_program(program, fused=fused) for fused in compiled}

    def run(matrix):
        given, found = np.ravel(np.asarray(matrix, dtype=float)), {}
        for fused, kernel in kernels.items():
            found[fused], y = np.empty(program.buffer("y").size), np.empty((program.buffer("y").size, 1))
            compiled[fused]("program", {"a": given, "y": found[fused]})
            kernel.run({"a": given.reshape(-1, 1).copy(), "y": y})
            np.testing.assert_array_equal(found[fused], y[:, 0])
        return found[host().fused]

    return run


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


def sweep(*body: Step, place: Slice = Slice(COLUMN, 0, 3)) -> Sweep:  # noqa: B008
    """In place, over two columns of three numbers."""
    return Sweep(body, ((MATRIX, place),), ((MATRIX, place),), 3)


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
    "a sweep that writes elsewhere": lambda: sweep(Copy(Slice("b", 0, 2), Slice("a", 0, 2))),
    "a sweep of other steps": lambda: sweep(Guard(Slice(COLUMN, 0, 3), 1)),
    "a sweep of a loop without a number": lambda: sweep(Repeat("n", (Copy(Slice("b"), Slice(COLUMN)),))),
    "a sweep beyond its memory": lambda: sweep(Copy(Slice("b"), Slice(COLUMN, 3))),
    "a sweep of other columns": lambda: sweep(place=Slice(COLUMN, 0, 2)),
    "an unknown order": lambda: Columns(Slice("a", 0, 6), 2, "K"),
    "a sum of another size": lambda: OuterSum(Slice("w", 0, 3), Slice("r", 0, 7), Slice("y", 0, 2), 3),
    "a sum over its terms": lambda: OuterSum(Slice("w", 0, 3), Slice("r", 0, 6), Slice("w", 2, 2), 3),
    "a symmetric sum of two": lambda: OuterSum(
        Slice("w", 0, 6), Slice("r", 0, 6), Slice("y", 0, 4), 3, symmetric=True
    ),
    "a factor of what is not square": lambda: Cholesky(Slice("a", 0, 8), Slice("b", 0, 8)),
    "reflections of another size": lambda: Householder(Slice("a", 0, 8), Slice("b", 0, 6), (2, 3), 1),
    "reflections over a part": lambda: Householder(Slice("a", 0, 6), Slice("a", 3, 6), (2, 3), 1),
    "a residual of other rows": lambda: Residual(
        Slice("a", 0, 9), Slice("b", 0, 2), Slice("c", 0, 2), (1, 2)
    ),
    "a residual over its rows": lambda: Residual(
        Slice("a", 0, 8), Slice("b", 0, 2), Slice("a", 7, 2), (1, 2)
    ),
    "fewer rows of a triangle than reflections": lambda: Householder(
        Slice("a", 0, 6), Slice("b", 0, 6), (3, 2), 2, 1
    ),
    "more reflections than rows": lambda: Householder(Slice("a", 0, 6), Slice("b", 0, 6), (2, 3), 3),
    "a factor over its matrix": lambda: Cholesky(Slice("a", 0, 9), Slice("a", 1, 9)),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused_in_three_parts(case):
    with pytest.raises(InvalidInput) as caught:
        REFUSED[case]()
    assert caught.value.advice
