"""Campaigns in memory: the same bits whatever is run beside a sample; metrics, statuses, mistakes."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest
from tests.campaign.conftest import OPTIONS, Feedback, made_campaign, made_loop, tolerances
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.campaign import DOUBTFUL, STANDARD, Campaign, Metrics, Sample, run_batch, run_campaign
from flexhinf.campaign.batches import ALONE, rows_of
from flexhinf.campaign.draws import sample_seeds
from flexhinf.errors import InvalidInput
from flexhinf.plant import BlackBox


def torn(rng):
    """Some springs push instead of pulling."""
    return {"mass": 1.0, "stiffness": float(rng.choice([20.0, -1e7]))}


def same(a, b):
    return all(
        np.array_equal(a[name].values, b[name].values, equal_nan=a[name].dtype.kind == "f") for name in a
    )


def test_a_batch_of_short_runs_holds_more(loop):
    """Unless they are made one by one."""

    def batch(duration, **changes):
        given = {"draw": tolerances(), "options": {**OPTIONS, "duration": duration}, **changes}
        return Campaign(loop, samples=20_000, **given).batch

    period = loop.controller.period
    assert [batch(steps * period) for steps in (100, 8_000, 1_000_000)] == [4_096, 2_048, 256]
    assert batch(100 * period, metrics=[replace(STANDARD, reduced=None)]) == 256
    assert batch(100 * period, draw=lambda rng: Sample({"mass": 1.0}, delay=period)) == 256


@pytest.mark.ci("starts a process of its own")
def test_a_sample_has_the_same_bits_alone_in_any_batch_and_in_another_process(loop):
    arguments = {"seed": 5, **OPTIONS}
    found = run_campaign(loop, tolerances("sobol"), 60, batch=60, **arguments)
    assert same(found, run_campaign(loop, tolerances("sobol"), 60, batch=7, **arguments))
    assert same(found, run_campaign(loop, tolerances("sobol"), 60, batch=16, workers=1, **arguments))
    alone = Campaign(loop, tolerances("sobol"), 60, 5, OPTIONS).replay(41)
    assert alone.metrics()["overshoot_percent"] == found.overshoot_percent.values[41]
    parameters = {"mass": float(found.mass[41]), "stiffness": float(found.stiffness[41])}
    by_hand = loop.with_plant(loop.true_plant.with_parameters(**parameters))
    run = by_hand.run(seed=int(found.seed[41]), **OPTIONS)
    assert run.metrics()["peak_input"] == found.peak_input.values[41]


@pytest.mark.parametrize("draw", [tolerances(), torn], ids=["tolerances", "diverging"])
def test_lanes_say_what_the_signals_of_each_run_say(draw):
    """Means of squares and rise times to their rounding, the rest bit by bit."""
    lanes = run_batch(made_campaign(draw=draw), 1)
    from_signals = [replace(one, reduced=None) for one in (STANDARD, DOUBTFUL)]
    signals = run_batch(made_campaign(draw=draw, metrics=from_signals), 1)
    for name, values in lanes.items():
        if name in ("tracking_rmse", "estimation_rmse", "rise_time_s"):
            np.testing.assert_allclose(values, signals[name], rtol=1e-12)
        else:
            np.testing.assert_array_equal(values, signals[name], name)


def test_a_sample_has_the_same_bits_beside_samples_that_cannot_run_in_lanes(loop):
    def draw(rng):
        force = float(rng.uniform(-1.0, 1.0))
        kind = [{}, {"initial_input": [force]}, {"disturbance": {"push": fh.Step(force)}}][rng.integers(3)]
        return Sample({"mass": 1.0 + 0.1 * force}, kind, {"force": force, "kind": float(len(kind))})

    campaign = made_campaign(20, 20, draw=draw)
    again = pickle.loads(pickle.dumps(made_campaign(20, 20, draw=tolerances())))
    whole = run_batch(campaign, 0)
    batchable = [ALONE not in campaign.modes([campaign.sample(k)]) for k in range(20)]
    assert 0 < sum(batchable) < 20
    for k in (0, 3, 8, 19):
        one = rows_of(campaign, range(k, k + 1))
        for name, values in one.items():
            np.testing.assert_array_equal(values[0], whole[name][k], name)
    assert again.ensemble is not None
    assert pickle.loads(pickle.dumps(again)).digest == again.digest


def test_the_dataset_says_what_it_holds(loop):
    found = run_campaign(loop, tolerances(), 20, seed=1, **OPTIONS)
    assert found.sizes["sample"] == 20
    assert set(found.status.values) == {"completed"}
    assert found.mass.attrs == {"units": "kg", "kind": "parameter"}
    trace = found["trace.position"]
    assert trace.shape == (20, len(found.time))
    assert found.time.values[[0, -1]].tolist() == [0.0, 0.4]
    assert found.attrs["method"] == "random"


def test_the_dataset_is_read_from_netcdf_as_it_was_written(loop, tmp_path):
    """Old code had seeds of 64 bits without a sign, which no NetCDF 3 has: xarray refused to write the file."""
    import xarray as xr

    found = run_campaign(loop, tolerances(), 3, duration=0.05)
    found.to_netcdf(tmp_path / "campaign.nc", engine="scipy")
    with xr.open_dataset(tmp_path / "campaign.nc", engine="scipy") as again:
        xr.testing.assert_identical(again.load(), found)
    assert [int(seed) for seed in again.seed] == sample_seeds(0, range(3)).tolist()


def test_a_plant_that_diverges_is_a_status():
    found = run_campaign(made_loop(), torn, 24, seed=2, **OPTIONS)
    gone = found.status.values == "diverged"
    assert 0 < gone.sum() < 24
    assert np.isfinite(found.diverged_at_s.values[gone]).all()
    assert np.isnan(found.peak_input.values[gone]).all()
    assert np.isfinite(found.peak_input.values[~gone]).all()
    assert np.isnan(found["trace.position"].values[gone, -1]).all()


def test_metrics_of_a_user(loop):
    metrics = ["peak_input", {"power": lambda run: float((run.signals["input"] ** 2).mean())}]
    found = run_campaign(loop, tolerances(), 3, metrics=metrics, signals=["velocity"], **OPTIONS)
    assert {"peak_input", "power", "trace.velocity"} < set(found)
    assert "overshoot_percent" not in found
    several = Metrics({"a": "m", "b": ""}, lambda run: {"a": 1.0, "b": None})
    found = run_campaign(loop, tolerances(), 3, metrics=several, **OPTIONS)
    assert found.a.attrs["units"] == "m"
    assert np.isnan(found.b).all()


def test_a_function_without_a_name_of_its_own_in_the_table_is_refused(loop):
    def largest(run):
        return 1.0

    for metrics in ([largest], ["peak_input", largest], [lambda run: 1.0], [3]):
        with refused_with(InvalidInput, "metric", "function", "metrics="):
            run_campaign(loop, tolerances(), 3, metrics=metrics, **OPTIONS)


def test_a_black_box_is_a_plant_of_its_own_for_each_sample():
    class Box(BlackBox):
        states = ("position", "velocity")

        def __init__(self, mass):
            self.mass = mass

        def reset(self, initial_state):
            self.x = np.zeros(2) if initial_state is None else np.array(initial_state)

        def step(self, u, disturbance, period):
            self.x = self.x + period * np.array([self.x[1], u[0] / self.mass])

        def output(self):
            return self.x[:1]

        def state(self):
            return self.x

    law = fh.Controller(Feedback(), made_loop().controller.estimator, 4e-3)
    found = run_campaign(
        fh.Loop(Box(1.0), law), lambda rng: Sample(plant=Box(m := rng.uniform(0.8, 1.2)), numbers={"mass": m}), 4,
        duration=0.2, reference=0.1,
    )  # fmt: skip
    assert found.status.values.tolist() == ["completed"] * 4
    assert len(set(found.peak_input.values)) == 4


def test_disturbance_and_initial_state_of_a_sample(loop):
    def draw(rng):
        push = fh.Step(float(rng.uniform(1.0, 2.0)), at=0.1)
        start = {"position": float(rng.uniform(-0.01, 0.01))}
        return Sample(options={"disturbance": {"push": push}, "initial_state": start}, numbers=start)

    found = run_campaign(loop, draw, 12, **OPTIONS)
    assert found["trace.position"].values[:, 0] == pytest.approx(found.position.values, rel=1e-6)
    assert np.ptp(found["trace.position"].values[:, -1]) > 1e-3


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"samples": 0}, "samples"),
        ({"samples": 2.5}, "samples"),
        ({"samples": -3}, "samples"),
        ({"seed": -1}, "seed"),
        ({"batch": 0}, "batch"),
        ({"metrics": ["overshot_percent"]}, "metric 'overshot_percent'"),
        ({"metrics": {"mass": lambda run: 1.0}}, r"(?s)columns.*\['mass'\]"),
        ({"metrics": {"no name": 1.0}}, "(?s)metric.*'no name'"),
        ({"signals": ["velocty"]}, "signal 'velocty'"),
        ({"draw": 3}, "(?s)draw.*function.*got 3"),
        ({"draw": lambda rng: {"mas": 1.0}}, "parameter 'mas'"),
        ({"draw": lambda rng: {"mass": np.nan}}, "finite"),
        ({"options": {"duration": -1.0}}, "duration"),
        ({"options": {"duration": 1.0, "reference": {"positon": 1.0}}}, "positon"),
    ],
)
def test_mistakes_are_told_before_any_work(changes, what):
    with pytest.raises(InvalidInput, match=what):
        made_campaign(**changes)


def test_mistakes_of_later_samples_name_them(loop):
    late = Campaign(
        loop, lambda rng: {"mass" if rng.uniform() < 0.6 else "stiffness": 1.0}, 20, options=OPTIONS
    )
    with refused_with(InvalidInput, "Sample 1", "['mass']", "['stiffness']"):
        run_batch(late, 0)
    with pytest.raises(InvalidInput, match="Sample 0 "):
        run_batch(made_campaign(metrics={"own": lambda run: "large"}), 0)
    with pytest.raises(InvalidInput, match="batch"):
        run_batch(made_campaign(), 4)
    with pytest.raises(InvalidInput, match="option 'sed'"):
        run_campaign(loop, tolerances(), 3, sed=1)
