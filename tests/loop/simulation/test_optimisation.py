"""How hard machine code is optimised changes no bit: most tests of `make test` run it as LLVM first writes it."""

import importlib

import numpy as np
import pytest

from flexhinf.codegen import machine
from flexhinf.loop import Controller, Loop, Step
from flexhinf.loop.simulation.ensemble import LANES
from flexhinf.robot import paper_arm


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("lanes", [1, LANES])
def test_machine_code_in_a_hurry_has_the_bits_of_the_product(made, lanes, as_shipped, monkeypatch):
    levels, assemble = [], machine.assemble

    def recorded(text, level):
        levels.append(level)
        return assemble(text, level)

    monkeypatch.setattr(machine, "assemble", recorded)
    monkeypatch.setattr(importlib.import_module("flexhinf.loop.simulation.ensemble"), "WORTH", 0)
    runs = []
    for hurried in (False, True):
        with as_shipped(), pytest.MonkeyPatch.context() as patch:
            if hurried:
                patch.setattr(machine, "level", lambda operations: 0)
                patch.setattr(machine, "_PASSES", ("always_inliner", "sroa"))
            loop = Loop(paper_arm().plant(), Controller(made.law, made.ukf(), 1e-3, 48.0), 2, delay=2e-3)
            plants = [{"stiffness": 100.0 - k} for k in range(lanes)]
            options = {"disturbance": {"link_torque": Step(0.2, at=0.1)}, "noise": 1e-3, "duration": 0.3}
            runs.append(list(loop.ensemble(0.3, **options).trajectories(plants, range(lanes))))
    assert sorted(set(levels)) == [0, 3]
    for one, other in zip(*runs, strict=True):
        assert one.status == other.status == "completed"
        for kind, values in one.signals.items():
            assert np.array_equal(values, other.signals[kind]), kind
