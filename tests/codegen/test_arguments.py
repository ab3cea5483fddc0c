"""Arrays and counts that do not fit are refused before memory is touched."""

import casadi
import numpy as np
import pytest
from tests.interpreter import interpret
from tests.refusals import refused_with

from flexhinf.codegen import Buffer, Call, Program, Repeat, Slice, compile_program
from flexhinf.codegen.compiler import check_arrays
from flexhinf.errors import InvalidInput

X, Y = casadi.SX.sym("x", 2), casadi.SX.sym("y", 2)
ADD = casadi.Function("add", [X, Y], [X + Y])
PROGRAM = Program(
    "sums",
    (Buffer("x", 2, "in", shared=True), Buffer("y", None, "out"), Buffer("w", 2, "work")),
    (
        Repeat(
            "n",
            (
                Call(ADD, (Slice("x", 0, 2), Slice("x", 0, 2)), (Slice("w", 0, 2),)),
                Call(ADD, (Slice("w", 0, 2), Slice("w", 0, 2)), (Slice("y", 0, 2, (2,)),)),
            ),
        ),
    ),
    ("n",),
)


def good(lanes):
    return {"x": np.ones(2), "y": np.zeros((6, lanes) if lanes > 1 else 6)}


def readonly(shape):
    array = np.zeros(shape)
    array.flags.writeable = False
    return array


REFUSED = {
    "missing": lambda lanes: ({"x": np.ones(2)}, {"n": 3}),
    "unknown": lambda lanes: ({**good(lanes), "z": np.ones(2)}, {"n": 3}),
    "work given": lambda lanes: ({**good(lanes), "w": np.ones(2)}, {"n": 3}),
    "no array": lambda lanes: ({**good(lanes), "x": [1.0, 1.0]}, {"n": 3}),
    "single precision": lambda lanes: ({**good(lanes), "x": np.ones(2, np.float32)}, {"n": 3}),
    "foreign byte order": lambda lanes: ({**good(lanes), "x": np.ones(2, ">f8")}, {"n": 3}),
    "integers": lambda lanes: ({**good(lanes), "x": np.ones(2, int)}, {"n": 3}),
    "not contiguous": lambda lanes: ({**good(lanes), "x": np.ones(4)[::2]}, {"n": 3}),
    "wrong size": lambda lanes: ({**good(lanes), "x": np.ones(3)}, {"n": 3}),
    "read-only result": lambda lanes: ({**good(lanes), "y": readonly(good(lanes)["y"].shape)}, {"n": 3}),
    "too short for the count": lambda lanes: (good(lanes), {"n": 4}),
    "missing count": lambda lanes: (good(lanes), {}),
    "unknown count": lambda lanes: (good(lanes), {"n": 3, "m": 1}),
    "negative count": lambda lanes: (good(lanes), {"n": -1}),
    "fractional count": lambda lanes: (good(lanes), {"n": 2.5}),
}


@pytest.mark.parametrize("make", [compile_program, interpret])
@pytest.mark.parametrize("lanes", [1, 2])
@pytest.mark.parametrize("case", REFUSED)
def test_refused_in_three_parts(case, lanes, make):
    kernel = make(PROGRAM, lanes)
    arrays, counts = REFUSED[case](lanes)
    with pytest.raises(InvalidInput) as caught:
        kernel.run(arrays, counts)
    assert caught.value.found
    assert caught.value.advice


def test_the_lane_axis_is_asked_for():
    arrays = {**good(2), "y": np.zeros(12)}
    with refused_with(InvalidInput, "'y'", "'sums'", "2 lanes", "(12,)"):
        compile_program(PROGRAM, 2).run(arrays, {"n": 3})


def test_overlapping_arrays_are_refused():
    memory = np.zeros(7)
    with refused_with(InvalidInput, "memory", "'x' and 'y'"):
        compile_program(PROGRAM).run({"x": memory[:2], "y": memory[1:]}, {"n": 3})


#: Places of three arrays in one memory, first and end: two that are read, and one that is written.
PLACES = {
    "apart": (((0, 2), (2, 4), (4, 6)), True),
    "the same for both readers": (((0, 2), (0, 2), (2, 4)), True),
    "an end inside": (((4, 6), (0, 2), (1, 3)), False),
    "a short one in a long one that is read": (((0, 9), (1, 2), (5, 6)), False),
    "readers in what is written": (((1, 2), (6, 7), (0, 9)), False),
    "behind another reader": (((0, 2), (4, 9), (8, 10)), False),
    "nothing": (((0, 9), (3, 3), (9, 10)), True),
}


@pytest.mark.parametrize("case", PLACES)
def test_only_readers_may_share_memory(case):
    names, (places, fits) = "abc", PLACES[case]
    roles = [Buffer(name, None, "out" if name == "c" else "in") for name in names]
    program, memory = Program("none", tuple(roles), ()), np.zeros(10)
    arrays = {name: memory[first:end] for name, (first, end) in zip(names, places, strict=True)}
    if fits:
        assert list(check_arrays(program, arrays, 1)) == list(names)
        return
    with refused_with(InvalidInput, "memory", "'c'"):
        check_arrays(program, arrays, 1)


def test_counts_that_do_not_fit_are_refused_after_some_that_do():
    kernel, arrays = compile_program(PROGRAM), good(1)
    for _ in range(2):
        assert kernel.run(arrays, {"n": 3}).fine
        with refused_with(InvalidInput, "'y'", "'sums'"):
            kernel.run(arrays, {"n": 4})


@pytest.mark.parametrize("lanes", [0, -1, 1.5, True])
@pytest.mark.parametrize("make", [compile_program, interpret])
def test_bad_lanes_are_refused(lanes, make):
    with pytest.raises(InvalidInput, match="lanes"):
        make(PROGRAM, lanes)


def test_numpy_integers_and_trajectories_of_two_axes_are_taken():
    arrays = {"x": readonly(2), "y": np.ones((3, 2))}
    assert compile_program(PROGRAM).run(arrays, {"n": np.int64(3)}).fine
    np.testing.assert_array_equal(arrays["y"], np.zeros((3, 2)))


def test_a_backward_stride_may_not_leave_the_front():
    back = Program(
        "back",
        (Buffer("y", None, "state"),),
        (Repeat("n", (Call(ADD, (Slice("y", 4, 2, (-2,)),) * 2, (Slice("y", 4, 2, (-2,)),)),)),),
        ("n",),
    )
    kernel = compile_program(back)
    y = np.ones(6)
    kernel.run({"y": y}, {"n": 2})
    np.testing.assert_array_equal(y, [1, 1, 2, 2, 2, 2])
    with refused_with(InvalidInput, "'y'", "'back'", "0 to 6", "-2 to 6"):
        kernel.run({"y": y}, {"n": 4})
