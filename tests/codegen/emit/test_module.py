"""Loops, copies, guards and lanes: compiled programs against interpreted ones and plain NumPy."""

import casadi
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from tests.interpreter import interpret

from flexhinf.codegen import Buffer, Call, Copy, Guard, Program, Repeat, Slice, compile_program
from flexhinf.codegen.emit.module import emit_module

BOTH = pytest.mark.parametrize("make", [compile_program, interpret])
X = casadi.SX.sym("x", 2)
SWAP = casadi.Function("swap", [X], [casadi.vertcat(X[1], X[0])])


def pendulum(step: float = 1e-3) -> casadi.Function:
    x, u = casadi.SX.sym("x", 2), casadi.SX.sym("u")

    def flow(x):
        return casadi.vertcat(x[1], -9.81 * casadi.sin(x[0]) - 0.1 * x[1] * casadi.cos(x[0]) + casadi.tanh(u))

    k1 = flow(x)
    k2 = flow(x + step / 2 * k1)
    k3 = flow(x + step / 2 * k2)
    k4 = flow(x + step * k3)
    return casadi.Function("pendulum", [x, u], [x + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)], {"cse": True})


def loop(function: casadi.Function) -> Program:
    """State recorded, stepped with an input of its own at every step, and guarded."""
    body = (
        Copy(Slice("x", 0, 2), Slice("path", 0, 2, (2,))),
        Call(function, (Slice("x", 0, 2), Slice("u", 0, 1, (1,))), (Slice("x", 0, 2),)),
        Guard(Slice("x", 0, 2), 7),
    )
    buffers = (Buffer("x", 2, "state"), Buffer("u", None, "in", shared=True), Buffer("path", None, "out"))
    return Program("loop", buffers, (Repeat("n", body),), ("n",))


def starts(count: int, steps: int) -> dict[str, np.ndarray]:
    random = np.random.default_rng(2)
    return {
        "x": random.normal(0.0, 1.0, (2, count)),
        "u": random.normal(0.0, 1.0, steps),
        "path": np.zeros((2 * steps, count)),
    }


def run_in_lanes(
    program: Program, lanes: int, arrays: dict[str, np.ndarray], steps: int
) -> dict[str, np.ndarray]:
    """Every column of the arrays, `lanes` at a time."""
    kernel = compile_program(program, lanes)
    result = {name: array.copy() for name, array in arrays.items()}
    for first in range(0, arrays["x"].shape[1], lanes):
        columns = slice(first, first + lanes)
        part = {name: np.ascontiguousarray(result[name][:, columns]) for name in ("x", "path")}
        assert kernel.run({**part, "u": arrays["u"]}, {"n": steps}).fine
        for name, array in part.items():
            result[name][:, columns] = array
    return result


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize("lanes", [2, 4, 8, 16])
def test_the_bits_do_not_depend_on_the_lanes(lanes):
    steps = 10_000
    program, arrays = loop(pendulum()), starts(16, steps)
    one, many = (run_in_lanes(program, width, arrays, steps) for width in (1, lanes))
    for name in ("x", "path"):
        np.testing.assert_array_equal(many[name], one[name])
    assert np.unique(one["x"][0]).size == 16


@pytest.mark.oracle
def test_a_long_loop_follows_casadi():
    steps = 2000
    program, arrays = loop(pendulum()), starts(1, steps)
    other = {name: array.copy() for name, array in arrays.items()}
    compile_program(program).run(arrays, {"n": steps})
    interpret(program).run(other, {"n": steps})
    np.testing.assert_allclose(arrays["path"], other["path"], rtol=0, atol=1e-11)
    assert np.ptp(arrays["path"]) > 0.5


@BOTH
@pytest.mark.parametrize("lanes", [1, 4])
def test_a_call_in_place_reads_before_it_writes(make, lanes):
    program = Program(
        "turn",
        (Buffer("x", 3, "state"),),
        (
            Repeat(
                "n",
                (
                    Call(SWAP, (Slice("x", 0, 2),), (Slice("x", 0, 2),)),
                    Call(SWAP, (Slice("x", 0, 2),), (Slice("x", 1, 2),)),
                ),
            ),
        ),
        ("n",),
    )
    start = np.arange(1.0, 1.0 + 3 * lanes).reshape(3, lanes)
    x = start.copy()
    make(program, lanes).run({"x": x}, {"n": 2})
    expected = start
    for _ in range(2):
        expected = expected[[1, 0, 2]]
        expected = expected[[0, 1, 0]]
    np.testing.assert_array_equal(x, expected)


@BOTH
@pytest.mark.parametrize("lanes", [1, 2])
def test_nested_loops_with_strides_multiply_matrices(make, lanes):
    """C = C + A·B for (3, 4)·(4, 5), one product of numbers per innermost turn, three loops deep."""
    c, a, b = (casadi.SX.sym(name) for name in "cab")
    fused = casadi.Function("fused", [c, a, b], [c + a * b])
    body = Call(
        fused,
        (Slice("c", 0, 1, (5, 1, 0)), Slice("a", 0, 1, (4, 0, 1)), Slice("b", 0, 1, (0, 1, 5))),
        (Slice("c", 0, 1, (5, 1, 0)),),
    )
    program = Program(
        "product",
        (Buffer("c", 15, "state"), Buffer("a", 12, "in"), Buffer("b", 20, "in", shared=True)),
        (Repeat("rows", (Repeat("columns", (Repeat("inner", (body,)),)),)),),
        ("rows", "columns", "inner"),
    )
    random = np.random.default_rng(0)
    left, right = (
        random.integers(-9, 9, (lanes, 3, 4)).astype(float),
        random.integers(-9, 9, (4, 5)).astype(float),
    )
    c = np.zeros((15, lanes))
    arrays = {"c": c, "a": np.ascontiguousarray(left.reshape(lanes, 12).T), "b": right.reshape(-1)}
    make(program, lanes).run(arrays, {"rows": 3, "columns": 5, "inner": 4})
    np.testing.assert_array_equal(c.T.reshape(lanes, 3, 5), left @ right)


@BOTH
def test_a_count_of_zero_runs_nothing(make):
    arrays = starts(1, 0)
    start = arrays["x"].copy()
    assert make(loop(pendulum())).run(arrays, {"n": 0}).fine
    np.testing.assert_array_equal(arrays["x"], start)


@BOTH
@pytest.mark.parametrize("lanes", [1, 4])
@pytest.mark.parametrize("size", [3, 100])
def test_copies_move_broadcast_and_overlap(make, lanes, size):
    program = Program(
        "copies",
        (Buffer("s", size, "in", shared=True), Buffer("x", 2 * size, "state"), Buffer("y", size, "out")),
        (
            Copy(Slice("s", 0, size), Slice("y", 0, size)),
            Copy(Slice("x", 0, size + 1), Slice("x", 1, size + 1)),
        ),
    )
    x = np.random.default_rng(0).normal(size=(2 * size, lanes))
    expected = x.copy()
    expected[1 : size + 2] = x[: size + 1]
    y = np.zeros((size, lanes))
    make(program, lanes).run({"s": np.arange(float(size)), "x": x, "y": y})
    np.testing.assert_array_equal(x, expected)
    np.testing.assert_array_equal(y, np.repeat(np.arange(float(size))[:, None], lanes, axis=1))


@BOTH
def test_work_starts_at_zero_in_every_run(make):
    a, b = casadi.SX.sym("a"), casadi.SX.sym("b")
    add = casadi.Function("add", [a, b], [a + b])
    body = Call(add, (Slice("w", 3, 1), Slice("x")), (Slice("w", 3, 1),))
    program = Program(
        "sum",
        (Buffer("x", 1, "in"), Buffer("y", 1, "out"), Buffer("w", 4, "work")),
        (Repeat("n", (body,)), Copy(Slice("w", 3, 1), Slice("y"))),
        ("n",),
    )
    y = np.zeros(1)
    bound = make(program).bind({"x": np.ones(1), "y": y}, {"n": 5})
    for _ in range(3):
        bound()
        assert y[0] == 5.0


def growth(lanes: int, size: int) -> Program:
    """x ← x·rate, guarded over `size` copies of it; overflows to infinity where the rate is large."""
    x, rate = casadi.SX.sym("x", size), casadi.SX.sym("rate")
    function = casadi.Function("grow", [x, rate], [x * rate])
    body = (
        Call(function, (Slice("x", 0, size), Slice("rate")), (Slice("x", 0, size),)),
        Guard(Slice("x", 0, size), 4),
    )
    return Program(
        f"growth{lanes}", (Buffer("x", size, "state"), Buffer("rate", 1, "in")), (Repeat("n", body),), ("n",)
    )


@BOTH
@pytest.mark.parametrize("size", [2, 50])
def test_every_lane_keeps_its_own_first_failure(make, size):
    rates = np.array([1.5, 1e300, 1e155, np.nan, 1.0001, 1e20, 1.0, 1e300])
    x = np.ones((size, 8))
    status = make(growth(8, size), 8).run({"x": x, "rate": rates[None, :].copy()}, {"n": 100})
    np.testing.assert_array_equal(status.code, [0, 4, 4, 4, 0, 4, 0, 4])
    np.testing.assert_array_equal(status.step, [-1, 1, 1, 0, -1, 15, -1, 1])
    assert not status.fine
    alone = [float(np.cumprod([rate] * 100)[-1]) for rate in rates[[0, 4, 6]]]
    np.testing.assert_array_equal(x[0, [0, 4, 6]], alone)


@BOTH
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("place", [0, 49])
def test_one_lane_stops_where_it_fails(make, bad, place):
    x = np.ones(50)
    x[place] = bad
    status = make(growth(1, 50)).run({"x": x, "rate": np.array([2.0])}, {"n": 100})
    assert (status.code, status.step) == (4, 0)
    assert x[25] == 2.0


@BOTH
def test_all_lanes_lost_stops_the_run(make):
    x = np.full((2, 2), np.nan)
    status = make(growth(2, 2), 2).run(
        {"x": x, "rate": np.ones((1, 2))}, {"n": 10**12 if make is compile_program else 9}
    )
    np.testing.assert_array_equal(status.step, [0, 0])


@BOTH
def test_a_guard_in_an_inner_loop_names_the_outermost_turn(make):
    body = Repeat("m", (Guard(Slice("x", 0, 1, (3, 1)), 2),))
    program = Program("scan", (Buffer("x", 12, "in"),), (Repeat("n", (body,)),), ("n", "m"))
    x = np.zeros(12)
    x[7] = np.inf
    status = make(program).run({"x": x}, {"n": 4, "m": 3})
    assert (status.code, status.step) == (2, 2)


@BOTH
def test_a_guard_outside_of_loops_says_step_zero(make):
    program = Program("look", (Buffer("x", 1, "in"),), (Guard(Slice("x"), 9), Guard(Slice("x"), 8)))
    status = make(program).run({"x": np.array([np.nan])})
    assert (status.code, status.step) == (9, 0)


def test_one_function_is_emitted_once():
    call = Call(SWAP, (Slice("x", 0, 2),), (Slice("x", 0, 2),))
    text = str(emit_module(Program("twice", (Buffer("x", 2, "state"),), (call, call)), lanes=1))
    assert text.count("define internal void") == 1
    assert text.count("call void @flexhinf_function0") == 2


@BOTH
def test_one_function_takes_shared_numbers_here_and_lanes_there(make):
    body = tuple(
        Call(SWAP, (Slice(source, 0, 2),), (Slice("y", 2 * k, 2),)) for k, source in enumerate("sxs")
    )
    buffers = (Buffer("s", 2, "in", shared=True), Buffer("x", 2, "in"), Buffer("y", 6, "out"))
    y = np.zeros((6, 2))
    x = np.array([[1.0, 2.0], [3.0, 4.0]])
    make(Program("mixed", buffers, body), 2).run({"s": np.array([8.0, 9.0]), "x": x, "y": y})
    np.testing.assert_array_equal(y, [[9, 9], [8, 8], [3, 4], [1, 2], [9, 9], [8, 8]])


def test_every_name_is_ours_and_no_licence_is_given_to_reorder():
    text = str(emit_module(loop(pendulum()), lanes=4))
    names = {word.split("(")[0] for word in text.split("@")[1:]}
    assert {name for name in names if not name.startswith(("flexhinf_", "llvm."))} == set()
    for licence in ("noalias", "fast", "reassoc", "contract", "nnan", "afn"):
        assert f" {licence} " not in text


def test_without_a_fused_multiply_add_products_stay_apart():
    a, b, c = (casadi.SX.sym(name) for name in "abc")
    function = casadi.Function("f", [a, b, c], [a * b + c])
    step = Call(function, (Slice("x", 0), Slice("x", 1), Slice("x", 2)), (Slice("x", 0),))
    program = Program("apart", (Buffer("x", 3, "state"),), (step,))
    assert "llvm.fma" in str(emit_module(program, 1, fused=True))
    assert "llvm.fma" not in str(emit_module(program, 1, fused=False))


SMOOTH = (
    lambda a, b: a + b,
    lambda a, b: a - b,
    lambda a, b: a * b,
    lambda a, b: a / (1 + b * b),
    lambda a, b: casadi.tanh(a),
    lambda a, b: casadi.atan(a) - b,
    lambda a, b: a * a,
    lambda a, b: -a,
)
WAVES = (lambda a, b: casadi.sin(a), lambda a, b: casadi.cos(b))
PIECES = (
    lambda a, b: casadi.floor(a),
    lambda a, b: casadi.fabs(a),
    lambda a, b: casadi.sign(b),
    casadi.fmin,
    casadi.fmax,
    casadi.atan2,
    lambda a, b: casadi.if_else(a < b, a, 2 * b),
    lambda a, b: casadi.if_else(casadi.logic_and(a > 0, b > 0), b, a),
)


@st.composite
def functions(draw, operations):
    """A function of three numbers; its results are all the values on the way, some used more than once."""
    symbols = casadi.SX.sym("x", 3)
    pool = [*casadi.vertsplit(symbols), casadi.SX(draw(st.sampled_from([0.5, -2.0, 3.25])))]
    for _ in range(draw(st.integers(1, 20))):
        pick = st.sampled_from(pool)
        pool.append(draw(st.sampled_from(operations))(draw(pick), draw(pick)))
    last = draw(st.booleans())  # with all values as results nothing can be fused
    return casadi.Function("f", [symbols], [casadi.densify(casadi.vertcat(*(pool[-1:] if last else pool)))])


POINTS = st.lists(st.floats(-3, 3), min_size=12, max_size=12).map(lambda numbers: np.reshape(numbers, (3, 4)))


def evaluate(make, function: casadi.Function, x: np.ndarray) -> np.ndarray:
    size, lanes = function.numel_out(), x.shape[1]
    step = Call(function, (Slice("x", 0, 3),), (Slice("y", 0, size),))
    program = Program("any", (Buffer("x", 3, "in"), Buffer("y", size, "out")), (step,))
    y = np.zeros((size, lanes))
    kernel = make(program, lanes)
    kernel.run({"x": np.ascontiguousarray(x), "y": y})
    return y


@pytest.mark.ci("compiles 60 drawn functions")
@pytest.mark.property
@pytest.mark.oracle
@settings(max_examples=60, deadline=None)
@given(functions(SMOOTH + PIECES), POINTS)
def test_without_fusing_random_functions_equal_casadi_to_the_bit(function, x):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("flexhinf.codegen.machine.Host.fused", False)
        got = evaluate(compile_program, function, x)
    np.testing.assert_array_equal(got, evaluate(interpret, function, x))


@pytest.mark.ci("many random functions")
@pytest.mark.property
@pytest.mark.oracle
@settings(max_examples=60, deadline=None)
@given(functions(SMOOTH + WAVES), POINTS)
def test_fused_random_functions_follow_casadi(function, x):
    got, expected = evaluate(compile_program, function, x), evaluate(interpret, function, x)
    nudged = [evaluate(interpret, function, x + nudge) for nudge in (1e-9, -1e-9)]
    slack = sum(np.abs(near - expected) for near in nudged)
    tame = np.abs(expected) < 1e6
    assert (np.abs(got - expected) <= 1e-9 * (1 + np.abs(expected)) + slack)[tame].all()


@pytest.mark.ci("compiles 40 drawn functions, each for two numbers of lanes")
@pytest.mark.property
@settings(max_examples=40, deadline=None)
@given(functions(SMOOTH + WAVES + PIECES), POINTS)
def test_random_functions_do_not_depend_on_the_lanes(function, x):
    together = evaluate(compile_program, function, x)
    apart = [evaluate(compile_program, function, x[:, [lane]]) for lane in range(4)]
    np.testing.assert_array_equal(together, np.hstack(apart))


@pytest.mark.parametrize("lanes", [1, 4])
def test_a_guard_compares_once(lanes):
    """0·x is summed: one operation for each number, where a comparison takes four."""
    program = Program("guarded", (Buffer("x", 30, "in"),), (Guard(Slice("x", 0, 30), 1),))
    assert str(emit_module(program, lanes)).count("fcmp") == 1
