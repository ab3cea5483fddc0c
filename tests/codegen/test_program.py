"""A program that cannot run is refused where it is written."""

import casadi
import pytest

from flexhinf.codegen import Buffer, Call, Copy, Guard, Program, Repeat, Slice, When
from flexhinf.codegen.program import slices
from flexhinf.errors import InvalidInput

X = casadi.SX.sym("x", 3)
DOUBLE = casadi.Function("double", [X], [2 * X], ["x"], ["y"])
BUFFERS = (Buffer("a", 3, "in"), Buffer("b", 6, "out"), Buffer("c", None, "state"))


def program(*body, buffers=BUFFERS, counts=("n",), name="p"):
    return Program(name, buffers, body, counts)


def test_steps_are_walked_in_order_with_their_loops():
    copy = Copy(Slice("a", 0, 3), Slice("c", 0, 3, (0, 3)))
    inner = Repeat("m", (copy,))
    guard = Guard(Slice("a", 0, 3), 1)
    outer = Repeat("n", (inner, guard))
    whole = program(outer, counts=("n", "m"))
    assert list(whole.steps()) == [(outer, ()), (inner, ("n",)), (copy, ("n", "m")), (guard, ("n",))]


def test_slices_of_a_step():
    source, target = Slice("a", 0, 3), Slice("b", 0, 3)
    assert slices(Call(DOUBLE, (source,), (target,))) == ((source,), (target,))
    assert slices(Copy(source, target)) == ((source,), (target,))
    assert slices(Guard(source, 1)) == ((source,), ())


def test_a_slice_reads_like_an_index():
    assert str(Slice("a", 2, 3, (0, 6))) == "a[2 + 6·k1 : +3]"


FREE = casadi.Function("free", [X], [X + casadi.SX.sym("q")], {"allow_free": True})
SPARSE = casadi.Function("sparse", [X], [casadi.SX(3, 1)])
MX = casadi.MX.sym("m")
REFUSED = {
    "unknown buffer": lambda: program(Guard(Slice("z", 0, 1), 1)),
    "unknown count": lambda: program(Repeat("m", ())),
    "name twice": lambda: program(buffers=(*BUFFERS, Buffer("a", 1, "in"))),
    "count named like a buffer": lambda: program(counts=("a",)),
    "bad program name": lambda: program(name="p 1"),
    "bad count name": lambda: program(counts=("1n",)),
    "write to an input": lambda: program(Copy(Slice("b", 0, 3), Slice("a", 0, 3))),
    "outside of a buffer": lambda: program(Guard(Slice("b", 4, 3), 1)),
    "strides without a loop": lambda: program(Guard(Slice("b", 0, 3, (1,)), 1)),
    "a loop of no turns": lambda: Repeat(0, ()),
    "a loop of half a turn": lambda: Repeat(0.5, ()),
    "a flag of two numbers": lambda: When(Slice("a", 0, 2), ()),
    "a guard under a condition": lambda: When(Slice("a", 0, 1), (Guard(Slice("a", 0, 1), 1),)),
    "unknown buffer of a flag": lambda: program(When(Slice("z", 0, 1), ())),
    "unknown buffer under a condition": lambda: program(
        When(Slice("a", 0, 1), (Copy(Slice("z", 0, 1), Slice("b", 0, 1)),))
    ),
    "too few strides": lambda: program(Repeat("n", (Repeat("n", (Guard(Slice("b", 0, 3, (1,)), 1),)),))),
    "no step": lambda: program("double"),
    "argument size": lambda: Call(DOUBLE, (Slice("b", 0, 6),), (Slice("b", 0, 3),)),
    "result size": lambda: Call(DOUBLE, (Slice("a", 0, 3),), (Slice("b", 0, 6),)),
    "number of arguments": lambda: Call(DOUBLE, (), (Slice("b", 0, 3),)),
    "number of results": lambda: Call(DOUBLE, (Slice("a", 0, 3),), ()),
    "free symbols": lambda: Call(FREE, (Slice("a", 0, 3),), (Slice("b", 0, 3),)),
    "sparse result": lambda: Call(SPARSE, (Slice("a", 0, 3),), (Slice("b", 0, 3),)),
    "not SX": lambda: Call(casadi.Function("m", [MX], [MX + 1]), (Slice("a", 0, 1),), (Slice("b", 0, 1),)),
    "copy of another size": lambda: Copy(Slice("a", 0, 3), Slice("b", 0, 2)),
    "guard without a code": lambda: Guard(Slice("a", 0, 3), 0),
    "negative offset": lambda: Slice("a", -1, 3),
    "empty slice": lambda: Slice("a", 0, 0),
    "fractional stride": lambda: Slice("a", 0, 1, (0.5,)),
    "unknown role": lambda: Buffer("a", 3, "inout"),
    "size zero": lambda: Buffer("a", 0, "in"),
    "work of unknown size": lambda: Buffer("a", None, "work"),
    "shared result": lambda: Buffer("a", 3, "out", shared=True),
    "an input that is not cleared": lambda: Buffer("a", 3, "in", cleared=False),
    "bad buffer name": lambda: Buffer("a-b", 3, "in"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused_in_three_parts(case):
    with pytest.raises(InvalidInput) as caught:
        REFUSED[case]()
    assert caught.value.what
    assert caught.value.found
    assert caught.value.advice
