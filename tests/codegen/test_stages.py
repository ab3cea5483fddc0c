"""A trace as one function for each of its stages: every bit is that of the trace, whatever it is divided at."""

from __future__ import annotations

from collections import Counter

import casadi
import numpy as np
import pytest

from flexhinf.codegen import Buffer, Call, Program, Slice, compile_program, cut, stages
from flexhinf.codegen.program import Stages, TracedStage

SIZE, OF_STAGES, IN_STAGE = 6, 6, 60


def drawn(rng: np.random.Generator) -> Call:
    """A function of sums, products, and quotients that share divisors and read across stages."""
    x = casadi.SX.sym("x", SIZE)
    values, ends = casadi.vertsplit(x), []
    for _ in range(OF_STAGES):
        own = list(values[-12:])
        divisors = [own[k] for k in rng.integers(len(own), size=2)]
        for _ in range(IN_STAGE):
            a, b = (own[k] for k in rng.integers(len(own), size=2))
            d = divisors[rng.integers(2)]
            choice = rng.integers(7)
            made = [a + b, a - b, a * b, a * b + d, b - a * a, a / d, a / d][choice]
            own.append(made)
        values = values + own[-4:]
        ends.append(casadi.vertcat(0, *own[-4:]))
    result = casadi.vertcat(*values[-8:])
    whole = casadi.Function("f", [x], [result])
    rows = tuple(TracedStage(f"stage{k}", "", ((f"of{k}", 4, 0),)) for k in range(OF_STAGES))
    traced = Stages(casadi.Function("f", [x], [*ends, result]), rows)
    return Call(whole, (Slice("x", 0, SIZE),), (Slice("y", 0, 8),), stages=traced)


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Functions of few operations, so that there are many of them."""
    monkeypatch.setattr(cut, "MOST", 20)
    monkeypatch.setattr(stages, "COLUMNS", 40)


@pytest.mark.ci("traces a whole step")
@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("seed", range(4))
def test_a_product_stays_with_the_sum_that_it_is_fused_into(seed: int) -> None:
    """Where a reciprocal that others share ends a function, too."""
    rng = np.random.default_rng(seed)
    for _ in range(15):
        traced = stages._Operations.of(drawn(rng))
        group = stages._Functions(traced, "scratch", "").group
        uses = Counter(one for k in group for one in traced.operands(k))
        uses.update(k for _, _, k in traced.outputs)
        sums = {k for k in group if traced.operations[k].code in (casadi.OP_ADD, casadi.OP_SUB)}
        for k in sums:
            for one in (one for one in traced.operands(k) if one in group):
                alone = uses[one] == 1 and traced.operations[one].code in (casadi.OP_MUL, casadi.OP_SQ)
                assert group[one] == group[k] or not alone


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.parametrize("fused", [False, True])
def test_every_bit_is_that_of_the_trace(fused: bool) -> None:
    rng = np.random.default_rng(0)
    for _ in range(4):
        call = drawn(rng)
        body, buffers = stages.staged(call, "scratch")
        assert len(body) > 2
        found = []
        for steps, own in (((call,), ()), (body, buffers)):
            arrays = {"x": np.random.default_rng(1).uniform(0.5, 2.0, SIZE), "y": np.zeros(8)}
            program = Program("f", (Buffer("x", SIZE, "in"), Buffer("y", 8, "out"), *own), steps)
            compile_program(program, 1, fused).run(arrays, {})
            found.append(arrays["y"])
        np.testing.assert_array_equal(*found)


def test_functions_that_pass_nothing_on_need_no_memory() -> None:
    x = casadi.vertsplit(casadi.SX.sym("x", 60))
    halves = [casadi.vertcat(*(2 * v * (v + 1) for v in x[k : k + 30])) for k in (0, 30)]
    whole, ends = casadi.vertcat(*halves), [casadi.vertcat(0, half) for half in halves]
    function = casadi.Function("f", [casadi.vertcat(*x)], [whole])
    traced = Stages(
        casadi.Function("f", [casadi.vertcat(*x)], [*ends, whole]),
        (TracedStage("a", "", (("a", 30, 0),)), TracedStage("b", "", (("b", 30, 0),), begins=True)),
    )
    call = Call(function, (Slice("x", 0, 60),), (Slice("y", 0, 60),), stages=traced)
    body, buffers = stages.staged(call, "scratch")
    assert len(body) > 1
    assert buffers == ()
