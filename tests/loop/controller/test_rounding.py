"""Controllers that round multiply-adds once or twice, whatever the processor has; exported C is compared in
`tests/export/test_flags.py`."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import numpy as np
import pytest
from tests.builders import arm_controller

import flexhinf as fh
from flexhinf.codegen.emit.module import emit_module
from flexhinf.codegen.machine import host
from flexhinf.loop.controller.memory import step_program

SAMPLES = 200


def made(form: str = "covariance", pieces: bool = False) -> fh.Controller:
    one = arm_controller(filter={"form": form})
    return one.in_pieces() if pieces else one


def inputs(controller: fh.Controller) -> np.ndarray:
    return np.array([controller.step([0.1 * np.sin(0.1 * k)], 0.2) for k in range(SAMPLES)])


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize("pieces", [False, True])
@pytest.mark.parametrize("form", ["covariance", "square_root"])
def test_a_step_without_fused_multiply_adds_calls_none(form: str, pieces: bool) -> None:
    one = made(form, pieces)
    sizes = {"y": 1, "r": 1, "data": one.data.size, "memory": one.memory.size, "u": 1, "estimate": 4}
    program = step_program(sizes, True, one.gaps, one.steps)
    assert "llvm.fma" in str(emit_module(program, 1, fused=True))
    assert "fma" not in str(emit_module(program, 1, fused=False))


def test_both_roundings_are_there_on_every_processor() -> None:
    one = made()
    own, once, twice = inputs(one), inputs(one.fresh(fused=True)), inputs(one.fresh(fused=False))
    np.testing.assert_array_equal(own, once if host().fused else twice)
    assert 0.0 < np.abs(once - twice).max() < 1e-9 * np.abs(once).max()


def test_copies_round_alike() -> None:
    twice = made().fresh(fused=False)
    expected = inputs(twice.fresh())
    for other in (copy.copy(twice), copy.deepcopy(twice), pickle.loads(pickle.dumps(twice)), twice.fresh()):
        np.testing.assert_array_equal(inputs(other), expected)
    assert twice.in_pieces().fused is False
    assert twice.fresh(fused=True).fused is True


@pytest.mark.ci("compiles a loop; steps are quick")
@pytest.mark.parametrize("fused", [False, True])
def test_a_compiled_loop_rounds_as_its_controller(fused: bool) -> None:
    controller = made().fresh(fused)
    loop, stepped = fh.Loop(fh.paper_arm().plant(), controller), controller.fresh()
    options: dict[str, Any] = {"reference": fh.Step(0.2), "noise": 1e-3, "duration": 0.2}
    run = loop.run(**options, seed=1)
    for k, y in enumerate(run.signals["output"]):
        np.testing.assert_array_equal(stepped.step(y, 0.2), run.signals["input"][k])
    many = loop.ensemble(**options, kept=["input.motor_voltage"], instants=range(SAMPLES)).run([{}], [1])
    np.testing.assert_array_equal(many.kept[0, :, 0], run.signals["input"][:SAMPLES, 0])
