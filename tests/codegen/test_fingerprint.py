"""Whatever changes the machine code changes the fingerprint, and nothing else does."""

from dataclasses import replace

import casadi
import numpy as np
import pytest

from flexhinf.codegen import Buffer, Call, Columns, Guard, Map, OuterSum, Program, Repeat, Slice, Sweep, When
from flexhinf.codegen.compiler import emitter_digest, fingerprint

X = casadi.SX.sym("x", 2)


WEIGHTS = Slice("a", 0, 4)


def function(constant: float = 3.0, flip: bool = False) -> casadi.Function:
    value = X * constant + 1.0
    return casadi.Function("f", [X], [value[::-1] if flip else value])


def program(
    traced=None, count=4, times=1, code=1, weights=WEIGHTS, order="C", turns="n", flag=0, joins=False
) -> Program:
    traced = traced or function()
    pieces, place = Columns(Slice("a", 0, 8), 4, order), Slice("column", 0, 2)
    body = (
        Call(traced, (Slice("a", 0, 2),), (Slice("a", 2, 2),), joins=joins),
        Map(traced, (pieces,), (pieces,)),
        Sweep(
            (Repeat(times, (Call(traced, (place,), (place,)),)),), ((pieces, place),), ((pieces, place),), 2
        ),
        OuterSum(Slice("a", 0, 4), Slice("a", 4, 4), Slice("b", 0, 1), count, weights),
        When(Slice("a", flag, 1), (Call(traced, (Slice("a", 0, 2),), (Slice("a", 2, 2),)),)),
        Repeat(turns, (Guard(Slice("b"), code),)),
    )
    return Program("p", (Buffer("a", 8, "state"), Buffer("b", 1, "out")), body, ("n", "m"))


CHANGES = {
    "a constant by one bit": {"traced": function(np.nextafter(3.0, 4.0))},
    "the order of results": {"traced": function(flip=True)},
    "how often": {"times": 2},
    "a code": {"code": 2},
    "weights": {"weights": None},
    "the order of a matrix": {"order": "F"},
    "a count": {"turns": "m"},
    "a flag": {"flag": 1},
    "a call that joins": {"joins": True},
}


@pytest.mark.parametrize("change", CHANGES)
def test_it_tells_programs_apart(change):
    assert fingerprint(program(**CHANGES[change])) != fingerprint(program())


def test_it_tells_buffers_apart():
    one = program()
    other = Program("p", tuple(replace(b, size=9) for b in one.buffers), one.body, one.counts)
    assert fingerprint(other) != fingerprint(one)


def test_it_tells_which_function_is_called_where():
    one, two = function(), function(2.0)
    calls = [Call(f, (Slice("a", 0, 2),), (Slice("a", 2, 2),)) for f in (one, two)]
    programs = [Program("p", (Buffer("a", 8, "state"),), tuple(body)) for body in (calls, calls[::-1])]
    assert fingerprint(programs[0]) != fingerprint(programs[1])


def test_the_same_text_traced_again_has_the_same_fingerprint():
    assert fingerprint(program(function())) == fingerprint(program(function()))


def test_the_emitters_sources_count():
    assert len(emitter_digest()) == 64
