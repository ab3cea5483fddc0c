"""Steps that become one function, and functions that become three: the same numbers."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import casadi
import numpy as np
import pytest
from tests.builders import arm_controller
from tests.interpreter import interpret
from tests.tiers import ci_and_night

import flexhinf as fh
from flexhinf.codegen import (
    Buffer,
    Call,
    Copy,
    OuterSum,
    Program,
    Repeat,
    Slice,
    Sweep,
    When,
    compile_program,
)
from flexhinf.codegen.program import Step
from flexhinf.codegen.stages import staged
from flexhinf.codegen.straight import straightened
from flexhinf.export.controller_c import code_of
from flexhinf.loop.controller.memory import step_program
from flexhinf.scalars.symbol import PIVOT_TOLERANCE

SAMPLES = 40


@pytest.fixture(scope="module")
def controller() -> fh.Controller:
    """One link, whose law takes over the input before the first sample."""
    return arm_controller(degree=4, q=[0, 0, 1e-4, 1e-4], r=1e-7, start="bumpless", before_first=0.3)


def whole(controller: fh.Controller) -> Program:
    """The step as `Controller.step` has it."""
    sizes = code_of(controller, "arm", "double").sizes
    return step_program(sizes, True, controller.gaps, controller.steps)


def runs(kernel: Any, controller: fh.Controller) -> np.ndarray:
    """Inputs, estimates and memories of some samples, a few of which are missing."""
    code = code_of(controller, "arm", "double")
    arrays = {name: np.zeros(size) for name, size in code.sizes.items()}
    arrays["data"][:], arrays["memory"][:] = controller.data_vector, controller.initial_memory()
    run, rng, rows = kernel.bind(arrays, {}), np.random.default_rng(0), []
    for k in range(SAMPLES):
        arrays["y"][:] = math.nan if k % 7 == 3 else 0.02 * math.sin(0.2 * k) + 1e-4 * rng.standard_normal(1)
        arrays["r"][:] = 0.02
        run()
        rows.append(np.concatenate([arrays[name] for name in ("u", "estimate", "memory")]))
    return np.array(rows)


def every(body: tuple[Step, ...]) -> Iterator[Step]:
    for step in body:
        yield step
        if isinstance(step, Repeat | When | Sweep):
            yield from every(step.body)


@pytest.mark.ci("long random functions")
@pytest.mark.parametrize("latency", [0, 1])
def test_straightened_steps_give_the_same_numbers(controller: fh.Controller, latency: int) -> None:
    own = controller.fresh(latency=latency).in_pieces()
    given = whole(own)
    longer = straightened(given, PIVOT_TOLERANCE)
    expected, found = (runs(interpret(program), own) for program in (given, longer))
    assert (np.abs(found - expected) <= 1e-9 * np.abs(expected).max(axis=0)).all()
    steps = [sum(1 for _ in every(program.body)) for program in (given, longer)]
    assert steps[1] < 0.5 * steps[0]
    sizes = [program.buffer("scratch").size or 0 for program in (given, longer)]
    assert sizes[1] < 0.8 * sizes[0]


def test_what_a_loop_or_a_condition_leaves_as_it_is_stays_readable() -> None:
    """Memory that is read in the next turn, and memory that a condition may not have written."""
    x = casadi.SX.sym("x", 2)
    double, less = casadi.Function("double", [x], [2 * x]), casadi.Function("less", [x], [x - 1])
    a, b, c = (Slice("scratch", k, 2) for k in (0, 2, 4))
    y = Slice("y", 0, 2)
    body = (
        Copy(y, a), Copy(y, c), Call(double, (a,), (b,)),
        Repeat(3, (Call(less, (b,), (a,)), Call(double, (a,), (b,)))),
        When(Slice("flag"), (Copy(b, c), Call(less, (c,), (c,)))),
        OuterSum(c, b, Slice("z", 0, 4), 1), Call(less, (b,), (y,)),
    )  # fmt: skip
    buffers = (
        Buffer("y", 2, "state"),
        Buffer("flag", 1, "in"),
        Buffer("z", 4, "out"),
        Buffer("scratch", 6, "work"),
    )
    given = Program("steps", buffers, body)
    longer = straightened(given, PIVOT_TOLERANCE)
    for flag in (0.0, 1.0):
        found = []
        for program in (given, longer):
            arrays = {"y": np.array([1.0, 3.0]), "flag": np.array([flag]), "z": np.zeros(4)}
            interpret(program).bind(arrays, {})()
            found.append(np.concatenate([arrays["y"], arrays["z"]]))
        np.testing.assert_array_equal(found[0], found[1])


@pytest.mark.parametrize("fused", ci_and_night("compiles the step of an unscented filter", [True], [False]))
def test_a_function_in_its_stages_gives_the_same_bits(controller: fh.Controller, fused: bool) -> None:
    """Where its rare part counts, at the first sample, and elsewhere; products are fused with the same sums."""
    given, parted = whole(controller), code_of(controller, "arm", "double").program
    assert any(isinstance(step, When) for step in parted.body)
    expected, found = (runs(compile_program(program, fused=fused), controller) for program in (given, parted))
    np.testing.assert_array_equal(found, expected)


def test_a_function_that_hardly_chooses_stays_whole() -> None:
    x = casadi.SX.sym("x", 3)
    function = casadi.Function("f", [x], [casadi.if_else(x[0] > 0, x[1] * x[2], x[2] + 1)])
    call = Call(function, (Slice("x", 0, 3),), (Slice("y", 0, 1),))
    assert [type(step) for step in staged(call, "scratch")[0]] == [Call]
