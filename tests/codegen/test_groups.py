"""Work memory that is used again: each read finds what was written, turn after turn."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import casadi
import numpy as np
import pytest
from tests.codegen.test_gpu import seven_links_program

from flexhinf.codegen import Buffer, Call, Program, Repeat, Slice, When
from flexhinf.codegen.groups import Packing, column_packing, form_of, packings
from flexhinf.codegen.memory import COLUMN
from flexhinf.codegen.program import Step, Sweep, slices

X = casadi.SX.sym("x", 4)
TURNED = casadi.Function("turned", [X], [X[::-1]])


def moved(source: Slice, target: Slice) -> Call:
    return Call(TURNED, (source,), (target,))


def work(k: int) -> Slice:
    return Slice("work", 4 * k, 4)


def in_order(body: Sequence[Step], turns: int) -> Iterator[Step]:
    """All loops are run so many times, and all conditions hold."""
    for step in body:
        if isinstance(step, Repeat | When):
            for _ in range(turns if isinstance(step, Repeat) else 1):
                yield from in_order(step.body, turns)
        else:
            yield step


def reads(body: Sequence[Step], found: Mapping[str, Packing], begun: Sequence[Slice] = ()) -> int:
    """How many elements are read; each is the one that was written there."""
    memory = {name: np.full(packing.size, -1) for name, packing in found.items()}
    count = 0
    for inputs, outputs in [((), begun), *map(slices, in_order(body, 3))]:
        for pieces, writes in ((inputs, False), (outputs, True)):
            for piece in (piece for piece in pieces if piece.buffer in found):
                start = found[piece.buffer].offset(piece.offset)
                here = memory[piece.buffer][start : start + piece.size]
                own = np.arange(piece.offset, piece.offset + piece.size)
                if writes:
                    here[:] = own
                else:
                    np.testing.assert_array_equal(here, own, str(piece))
                    count += piece.size
    return count


@pytest.mark.ci("writes the loop of seven links")
def test_the_work_of_seven_links_fits_a_warp_and_is_all_there():
    program = seven_links_program()
    form, work = form_of(program), program.buffer("scratch").size
    assert (form.group, form.apart) == (32, False)
    assert reads(program.body, form.packings) > 50_000
    assert form.packings["scratch"].size < 0.5 * (work or 0)
    (sweep,) = (step for step, _ in program.steps() if isinstance(step, Sweep))
    column = column_packing(sweep)
    begun = [place for _, place in sweep.inputs]
    assert reads(sweep.body, {COLUMN: column}, begun) > 800
    assert column.size < 0.5 * sweep.size


@pytest.mark.parametrize("carried", ["", "from_before", "from_a_turn"])
def test_what_a_turn_leaves_for_the_next_keeps_its_place(carried: str):
    """Blocks of a loop, of a loop inside, of a condition, and one of which a turn reads what is from before."""
    x = Slice("x", 0, 4)
    inner = Repeat(3, (moved(work(1), work(2)), moved(work(2), work(1))))
    rare = When(Slice("work", 8, 1), (moved(work(1), work(3)),))
    body = (
        moved(work(0), work(1)), inner, rare, *((moved(work(4), work(5)),) if carried else ()),
        moved(work(1), work(4)), moved(work(4), work(6)), moved(work(6), x),
    )  # fmt: skip
    begun = (moved(x, work(0)), *((moved(x, work(4)),) if carried == "from_before" else ()))
    buffers = Buffer("x", 4, "state"), Buffer("work", 28, "work", cleared=False)
    program = Program("turns", buffers, (*begun, Repeat(5, body)))
    found = packings(program)
    assert reads(program.body, found, (work(4),) if carried == "from_a_turn" else ()) > 0
    assert found["work"].size <= (20 if carried else 16)
