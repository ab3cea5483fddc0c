"""A loop whose sensors say nothing at first waits as `Controller.step` does: alone, in lanes, and in pieces."""

from __future__ import annotations

import numpy as np
import pytest
from tests.builders import PlantBox, linear_law, seen_by_three, three_sensors

import flexhinf as fh
from flexhinf.scalars import where

# Kernels that run once each: half of the time.
pytestmark = pytest.mark.usefixtures("unoptimised")

START = {"x0": 0.3, "x1": 0.5, "x2": 0.0}


def asleep(until=0.35):
    """The same plant, whose sensors give nothing before its first state has come so low."""
    plain = three_sensors()

    def seen(x, u, p):
        return np.array([where(x[0] > until, np.nan, one) for one in plain.output(x, u, p)])

    return fh.Plant(plain.flow, seen, plain.states, ("u",), parameters={"scale": 1.3})


def controller(kind=fh.ExtendedKalmanFilter, **options):
    law = linear_law(three_sensors(), [-1.0, -0.5, -0.2], rest=[0.2])
    return fh.Controller(law, seen_by_three(kind), 0.05, before_first=[0.07], **options)


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.parametrize("pieces", [False, True])
@pytest.mark.parametrize(
    "options", [{}, {"latency": 0}, {"latency": 3, "start": "bumpless"}, {"offset_time": 0.3}]
)
def test_a_run_is_that_of_the_steps(options, pieces):
    one = controller(**options)
    one = one.in_pieces() if pieces else one
    run = fh.Loop(asleep(), one).run(noise=1e-2, duration=6.0, initial_state=[0.6, 0.0, 0.0])
    output, stepped = run.signals["output"], one.fresh().in_pieces() if pieces else one.fresh()
    first = int(np.flatnonzero(np.isfinite(output).any(axis=1))[0])
    assert 3 < first < 100
    for k, y in enumerate(output):
        np.testing.assert_array_equal(stepped.step(y), run.signals["input"][k])
        np.testing.assert_array_equal(stepped.estimate, run.signals["estimate"][k])
    np.testing.assert_array_equal(run.signals["input"][:first], 0.07)
    assert np.isnan(run.signals["estimate"][:first]).all()
    assert np.isfinite(run.signals["estimate"][first:]).all()
    assert run.status == "completed"


@pytest.mark.ci("compiles an ensemble and its loop")
@pytest.mark.oracle
def test_runs_in_lanes_wait_each_for_itself():
    loop = fh.Loop(asleep(), controller())
    ensemble = loop.ensemble(
        noise=1e-2, duration=5.0, kept=("estimate.x1", "input.u"), instants=np.arange(101)
    )
    starts = np.array([[0.6, 0.0, 0.0], [0.2, 0.1, 0.0], [0.5, 0.2, 0.1]])
    parameters, seeds = np.full((3, 1), 1.3), [0, 1, 2]
    lanes = ensemble.run(parameters, seeds, starts, lanes=8)
    alone = ensemble.run(parameters, seeds, starts, lanes=1)
    np.testing.assert_array_equal(lanes.kept, alone.kept)
    for k, run in enumerate(ensemble.trajectories(parameters, seeds, starts)):
        np.testing.assert_array_equal(lanes.kept[k, :, 0], run.signal("estimate", "x1"))
        np.testing.assert_array_equal(lanes.kept[k, :, 1], run.signal("input", "u"))
    waited = np.isnan(lanes.kept[:, :, 0]).sum(axis=1)
    assert waited.tolist() == [21, 0, 29]


def test_a_black_box_and_a_plant_wait_alike():
    one = controller()
    runs = [
        loop.run(duration=4.0, initial_state=[0.6, 0.0, 0.0])
        for loop in (fh.Loop(asleep(), one, sub_steps=1), fh.Loop(PlantBox(asleep()), one))
    ]
    for kind in ("input", "estimate", "output"):
        np.testing.assert_allclose(runs[0].signals[kind], runs[1].signals[kind], rtol=1e-10, atol=1e-13)


def test_what_always_measures_has_the_code_of_before():
    """No step is guarded where no number of an output is written as NaN."""
    loop = fh.Loop(three_sensors(), controller())
    assert not loop.prepared(duration=0.2).code.waits
    assert fh.Loop(asleep(), controller()).prepared(duration=0.2).code.waits
