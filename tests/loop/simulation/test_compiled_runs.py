"""Runs side by side in vector lanes are what they are alone, bit by bit."""

import importlib

import numpy as np
import pytest

from flexhinf.loop import Controller, Loop, Step, run_many
from flexhinf.loop.simulation.compiled_runs import LANES
from flexhinf.robot import paper_arm


@pytest.fixture(autouse=True)
def always(monkeypatch):
    """Also few samples are worth the lanes."""
    monkeypatch.setattr(importlib.import_module("flexhinf.loop.simulation.compiled_runs"), "WORTH", 0)


def prepared(made, count, duration=0.3, estimator=True, **options):
    """Runs of arms of different stiffness, each with noise of its own; the third is so soft that it is torn apart."""
    controller = Controller(made.law, made.ukf() if estimator else None, 1e-3)
    load = {"link_torque": Step(0.2, at=0.1)} if estimator else None
    runs = []
    for k in range(count):
        stiffness = -1e7 if k == 2 else 100.0 - k
        plant = paper_arm().plant().with_parameters(stiffness=stiffness)
        loop = Loop(plant, controller, 2, **options)
        runs.append(loop.prepared(0.3, load, 1e-3 if estimator else None, duration, seed=k))
    return runs


def same(one, other):
    assert one.status == other.status
    assert one.message == other.message
    assert np.array_equal(one.time, other.time)
    assert list(one.signals) == list(other.signals)
    for kind, values in one.signals.items():
        assert np.array_equal(values, other.signals[kind], equal_nan=True), kind
    assert one.settings == other.settings


@pytest.mark.parametrize("count", [LANES, LANES + 3])
@pytest.mark.parametrize("options", [{}, {"delay": 2e-3, "quantisation": 1e-4}])
def test_lanes_do_not_matter(made, count, options):
    runs = prepared(made, count, **options)
    many = list(run_many(runs))
    assert len(many) == count
    for run, found in zip(runs, many, strict=True):
        same(found, run.alone())
    assert many[2].status == "diverged"
    assert many[2].diverged_at < many[1].time[-1]
    assert [run.status for k, run in enumerate(many) if k != 2] == ["completed"] * (count - 1)


def test_the_true_state_fed_back_and_a_run_alone_in_its_lanes(made):
    runs = prepared(made, LANES + 1, estimator=False)
    for run, found in zip(runs, run_many(runs), strict=True):
        same(found, run.alone())


def test_undisturbed_runs_read_one_array_of_zeros(made):
    """Of seven links 43 kB a sample: with a copy for each lane it was most of a design's memory."""
    run = prepared(made, 1, estimator=False)[0]
    zeros = run.inputs["disturbance"]
    assert not zeros.any()
    assert not zeros.flags.writeable
    buffers = run.code.kernel(LANES, run.shared).program.buffers
    assert [buffer.name for buffer in buffers if buffer.shared] == ["disturbance"]
    assert prepared(made, 1)[0].shared == ()


def test_runs_of_two_lengths_take_turns(made):
    longer, shorter = prepared(made, LANES), prepared(made, LANES + 1, duration=0.2)
    mixed = [run for pair in zip(longer, shorter) for run in pair] + shorter[LANES:]
    for run, found in zip(mixed, run_many(iter(mixed)), strict=True):
        same(found, run.alone())


def test_few_runs_and_few_samples_are_made_alone(made, monkeypatch):
    module = importlib.import_module("flexhinf.loop.simulation.compiled_runs")
    monkeypatch.setattr(module, "_side_by_side", lambda *runs: pytest.fail("not worth a kernel"))
    runs = prepared(made, LANES)
    assert list(run_many([])) == []
    same(next(run_many(runs[:3])), runs[0].alone())
    monkeypatch.setattr(module, "WORTH", LANES * len(runs[0].times) + 1)
    assert len(list(run_many(runs))) == LANES
