"""Running and binding, compiled and interpreted alike."""

import _ctypes
import gc
import threading
import time
import weakref

import casadi
import numpy as np
import pytest
from tests.interpreter import interpret

from flexhinf.codegen import Buffer, Call, Guard, Program, Repeat, Slice, aligned, compile_program

BOTH = pytest.mark.parametrize("make", [compile_program, interpret])
X, U = casadi.SX.sym("x"), casadi.SX.sym("u")
STEP = casadi.Function("step", [X, U], [X + casadi.log(U)])
PROGRAM = Program(
    "sum",
    (Buffer("x", 1, "state"), Buffer("u", 1, "in")),
    (
        Repeat(
            "n",
            (Call(STEP, (Slice("x"), Slice("u")), (Slice("x"),)), Guard(Slice("x"), 3)),
        ),
    ),
    ("n",),
)


@BOTH
def test_a_bound_kernel_reads_what_the_arrays_hold_now(make):
    x, u = np.zeros(1), np.ones(1)
    bound = make(PROGRAM).bind({"x": x, "u": u}, {"n": 2})
    assert bound() == 0
    assert x[0] == 0.0
    u[0] = np.e
    assert bound() == 0
    assert x[0] == 2.0
    assert bound.status.fine


@BOTH
@pytest.mark.parametrize("lanes", [1, 3])
def test_a_bound_kernel_tells_failure_and_forgets_it(make, lanes):
    x, u = np.zeros((1, lanes)), np.ones((1, lanes))
    bound = make(PROGRAM, lanes).bind({"x": x, "u": u}, {"n": 2})
    u[0, 0] = -1.0
    assert bound() == 3
    assert np.ravel(bound.status.code)[0] == 3
    assert np.ravel(bound.status.step)[0] == 0
    assert (np.ravel(bound.status.code)[1:] == 0).all()
    u[:], x[:] = 1.0, 0.0
    assert bound() == 0
    assert bound.status.fine


@BOTH
def test_a_status_does_not_change_with_the_next_run(make):
    x, u = np.zeros((1, 2)), np.array([[1.0, -1.0]])
    bound = make(PROGRAM, 2).bind({"x": x, "u": u}, {"n": 1})
    bound()
    status = bound.status
    u[:], x[:] = 1.0, 0.0
    bound()
    np.testing.assert_array_equal(status.code, [0, 3])


@pytest.mark.ci("compiles and drops kernels until memory would show it")
@BOTH
def test_a_bound_kernel_keeps_its_arrays_and_its_code(make):
    x, u = np.zeros(1), np.full(1, np.e)
    watched = weakref.ref(x)
    bound = make(PROGRAM).bind({"x": x, "u": u}, {"n": 1})
    del x, u
    gc.collect()
    assert bound() == 0
    kept = watched()
    assert kept is not None
    assert kept[0] == 1.0
    del bound, kept
    gc.collect()
    assert watched() is None


@pytest.mark.ci("compiles a program twice")
def test_two_kernels_of_one_program_live_side_by_side():
    first, second = compile_program(PROGRAM), compile_program(PROGRAM)
    del first
    gc.collect()
    x = np.zeros(1)
    assert second.run({"x": x, "u": np.full(1, np.e)}, {"n": 4}).fine
    assert x[0] == 4.0


def test_a_run_lets_other_threads_work():
    x, u = np.zeros(1), np.ones(1)
    bound = compile_program(PROGRAM).bind({"x": x, "u": u}, {"n": 30_000_000})

    def moments_of_this_thread() -> int:
        """How often this thread looked at the clock in the middle half of a run in another one."""
        ends, moments = [], []

        def run():
            ends.append(time.perf_counter())
            bound()
            ends.append(time.perf_counter())

        thread = threading.Thread(target=run)
        thread.start()
        while thread.is_alive():
            moments.append(time.perf_counter())
        quarter = 0.25 * (ends[1] - ends[0])
        return sum(ends[0] + quarter < moment < ends[1] - quarter for moment in moments)

    # a busy machine may not let this thread run at all during a run; one that held the interpreter never would
    assert any(moments_of_this_thread() > 10 for _ in range(5))


def test_threads_run_one_kernel_on_arrays_of_their_own():
    kernel = compile_program(PROGRAM)
    columns = [np.zeros(1) for _ in range(4)]
    bound = [
        kernel.bind({"x": x, "u": np.full(1, np.e)}, {"n": 1000 * (k + 1)}) for k, x in enumerate(columns)
    ]
    threads = [threading.Thread(target=one) for one in bound]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [x[0] for x in columns] == [1000.0, 2000.0, 3000.0, 4000.0]


@BOTH
def test_a_short_call_keeps_the_lock_and_gives_the_same(make):
    kernel, results = make(PROGRAM), []
    for short in (False, True):
        x = np.zeros(1)
        bound = kernel.bind({"x": x, "u": np.full(1, 3.0)}, {"n": 100}, short=short)
        assert bound() == 0
        results.append(x[0])
        if make is compile_program:
            assert bool(bound.func._flags_ & _ctypes.FUNCFLAG_PYTHONAPI) is short
    assert results[0] == results[1]


@pytest.mark.parametrize("size", [1, 8, 9, 1001, 100_000])
def test_the_memory_of_a_kernel_begins_with_a_line_of_the_cache(size):
    memory = Program(
        "work", (Buffer("w", size, "work"), Buffer("x", 1, "state")), PROGRAM.body[0].body[1:], ()
    )
    bound = compile_program(memory).bind({"x": np.zeros(1)})
    for array in (aligned(size), bound.keep[1]["w"]):
        assert array.shape == (size,)
        assert array.ctypes.data % 64 == 0
        assert not array.any()
