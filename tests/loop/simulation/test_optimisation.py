"""How hard machine code is optimised changes no bit: `FLEXHINF_OPTIMISATION` limits it."""

import os
from collections import OrderedDict

import numpy as np
import pytest

from flexhinf.codegen import machine, shared
from flexhinf.loop import Controller, Loop, Step
from flexhinf.loop.simulation.ensemble import LANES
from flexhinf.robot import paper_arm


@pytest.mark.ci("compiles a loop at each level")
@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("lanes", [1, LANES])
def test_the_level_of_optimisation_changes_no_bit(made, lanes, monkeypatch):
    levels, assemble = [], machine.assemble

    def recorded(text, level):
        levels.append(level)
        return assemble(text, level)

    monkeypatch.setattr(machine, "assemble", recorded)
    monkeypatch.setenv("FLEXHINF_LANES_FROM", "0")
    monkeypatch.setenv("FLEXHINF_CACHE", os.devnull)  # nothing is kept: all is compiled
    monkeypatch.setattr(shared, "_kept", OrderedDict())  # nor is what other tests of this process built
    runs = []
    for level in (None, "0"):
        with pytest.MonkeyPatch.context() as patch:
            if level is not None:
                patch.setenv("FLEXHINF_OPTIMISATION", level)
            loop = Loop(paper_arm().plant(), Controller(made.law, made.ukf(), 1e-3, 48.0), 2, delay=2e-3)
            plants = [{"stiffness": 100.0 - k} for k in range(lanes)]
            options = {"disturbance": {"link_torque": Step(0.2, at=0.1)}, "noise": 1e-3, "duration": 0.3}
            runs.append(list(loop.ensemble(0.3, **options).trajectories(plants, range(lanes))))
    assert sorted(set(levels)) == [0, 3]
    for one, other in zip(*runs, strict=True):
        assert one.status == other.status == "completed"
        for kind, values in one.signals.items():
            assert np.array_equal(values, other.signals[kind]), kind
