"""Many controllers on the same samples: each has the bits of a campaign of its own, in lanes, alone and on a GPU."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pytest
from tests.campaign.conftest import OPTIONS, Feedback, made_campaign, made_loop, spring, tolerances
from tests.card import StandIn, on_stand_in, stand_in  # noqa: F401 - fixtures
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.campaign import Campaign, Sample, candidates, judge_controllers, search_weights
from flexhinf.campaign.batches import run_batch
from flexhinf.codegen import cuda
from flexhinf.errors import FlexhinfError, InvalidInput, NumericalFailure
from flexhinf.loop import Ensemble

METRICS = ("overshoot_percent", "peak_input", "tracking_rmse", "estimation_rmse")


def controller(gain=(60.0, 12.0, 100.0), q=1e-6, period=4e-3, **options) -> fh.Controller:
    filter = fh.ExtendedKalmanFilter(spring(), period, q, 1e-6, np.zeros(2), 1e-4)
    return fh.Controller(Feedback(gain), filter, period, **options)


#: Gains, the estimator's noise, limits, and the input before the first sample.
CONTROLLERS = [
    controller(saturation=8.0),
    controller((90.0, 9.0, 50.0), q=1e-4, saturation=4.0),
    controller((40.0, 20.0, 10.0), saturation=(-1.0, 2.0), before_first=[0.5]),
]


def apart(each: fh.Controller, draw) -> dict[str, np.ndarray]:
    campaign = Campaign(fh.Loop(spring(), each, 1), draw, 20, 5, OPTIONS, batch=20)
    return run_batch(campaign, 0)


def pushed(rng: np.random.Generator) -> Sample:
    """Some begin with an input of their own, others have a spring that pushes, and some are not run."""
    own = {"initial_input": [0.3]} if rng.uniform() < 0.5 else {}
    numbers = {"mass": rng.uniform(0.8, 1.2), "stiffness": float(rng.choice([20.0, -1e7]))}
    return Sample(numbers, own, failure="no robot" if numbers["mass"] > 1.15 else "")


@pytest.mark.parametrize("draw", [tolerances(), pushed], ids=["tolerances", "inputs"])
@pytest.mark.parametrize("lanes_from", ["0", "1000000"], ids=["lanes", "alone"])
def test_each_controller_has_the_bits_of_a_campaign_of_its_own(draw, lanes_from, monkeypatch):
    monkeypatch.setenv("FLEXHINF_LANES_FROM", lanes_from)
    campaign = Campaign(fh.Loop(spring(), CONTROLLERS[0], 1), draw, 20, 5, OPTIONS)
    found = judge_controllers(campaign, CONTROLLERS)
    for k, each in enumerate(CONTROLLERS):
        rows = apart(each, draw)
        for name in (*METRICS, "status"):
            assert np.array_equal(found[name][k], rows[name], equal_nan=name != "status")
    assert set(found["status"].ravel()) >= ({"completed"} if draw is not pushed else {"diverged", "not run"})
    assert len({float(np.nanmax(row)) for row in found["peak_input"]}) == 3


@pytest.mark.ci("compiles an ensemble for a GPU")
def test_a_gpu_gives_the_same_bits_of_all_controllers_in_one_launch(on_stand_in: StandIn):  # noqa: F811
    campaign = Campaign(fh.Loop(spring(), CONTROLLERS[0], 1), tolerances(), 20, 5, OPTIONS)
    before = on_stand_in["launches"]
    cpu, gpu = (judge_controllers(campaign, CONTROLLERS, device) for device in ("cpu", "gpu"))
    assert on_stand_in["launches"] == before + 1
    assert cpu.keys() == gpu.keys()
    assert all(np.array_equal(cpu[name], gpu[name], equal_nan=name != "status") for name in cpu)


def test_more_samples_than_a_batch_has_run_in_parts(monkeypatch):
    campaign = Campaign(fh.Loop(spring(), CONTROLLERS[0], 1), tolerances(), 50, 5, OPTIONS)
    sizes, run = list[int](), Ensemble.run
    whole = judge_controllers(campaign, CONTROLLERS)
    monkeypatch.setattr(candidates, "LARGEST_BATCH", 20)
    monkeypatch.setattr(
        Ensemble, "run", lambda *some, **more: sizes.append(len(some[1])) or run(*some, **more)
    )
    parts = judge_controllers(campaign, CONTROLLERS)
    assert all(np.array_equal(parts[name], whole[name], equal_nan=name != "status") for name in whole)
    assert (max(sizes), sum(sizes)) == (20, 3 * 50)


def test_controllers_that_cannot_run_together_are_refused(monkeypatch):
    monkeypatch.setattr(cuda, "card", lambda: cuda.Card(cuda.Driver("libnothing.so.7")))
    campaign = made_campaign()
    for others, words in (
        ([], ("Controllers", "none")),
        (controller(), ("sequence", "Controller")),
        ([controller(), Feedback()], ("Controllers", "Feedback")),
        ([controller(), controller(period=2e-3)], ("period",)),
        ([controller(latency=2)], ("program", "estimator")),
    ):
        with refused_with(InvalidInput, *words):
            judge_controllers(campaign, others)  # pyright: ignore
    with refused_with(InvalidInput, "Campaign", "Loop"):
        judge_controllers(made_loop(), [controller()])  # pyright: ignore
    with refused_with(FlexhinfError, "driver", "cpu"):  # though few runs are on the processor
        judge_controllers(campaign, [controller()], device="gpu")
    alone = made_campaign(metrics={"effort": lambda run: 1.0})
    with refused_with(InvalidInput, "samples", "signals"):
        judge_controllers(alone, [made_loop().controller])
    ensemble = made_loop().ensemble(duration=0.1)
    with refused_with(InvalidInput, "controllers", "2", "1"):
        ensemble.run([{}, {}], controllers=[controller()])
    own = made_loop().ensemble(duration=0.1, initial_memory=controller().initial_memory(input=[1.0]))
    with refused_with(InvalidInput, "initial_memory"):
        own.run([{}], controllers=[controller()])


def weighed(weights: Mapping[str, float]) -> fh.Controller:
    """Not of every pair of weights."""
    if weights["stiff"] > 150.0:
        raise NumericalFailure("No law.", "expected less", "less")
    return controller((weights["stiff"], weights["damped"], 30.0), saturation=8.0)


#: Limit of the input, which the fastest laws miss.
PEAK = 0.4

RANGES = {"stiff": (20.0, 200.0), "damped": (3.0, 60.0)}


@pytest.fixture
def corners() -> Campaign:
    loop = fh.Loop(spring(), CONTROLLERS[0], 1)
    box = tolerances("random", "corners")
    return Campaign(loop, box, 8, 5, {"duration": 0.4, "noise": 1e-4, "reference": 0.1})


@pytest.mark.ci("makes and judges a few hundred laws")
def test_no_weights_of_a_grid_are_better_than_those_that_are_found(corners):
    tried: list[int] = []
    found = search_weights(
        corners,
        weighed,
        RANGES,
        "tracking_rmse",
        [f"peak_input<={PEAK}"],
        starts=2,
        progress=lambda n, best: tried.append(n),
    )
    assert tried[-1] <= found.candidates
    assert all(low <= found.weights[name] <= high for name, (low, high) in RANGES.items())
    grid = [
        {"stiff": a, "damped": b} for a in np.geomspace(20.0, 149.0, 6) for b in np.geomspace(3.0, 60.0, 6)
    ]
    rows = judge_controllers(corners, [weighed(weights) for weights in grid])
    kept = np.all((rows["status"] == "completed") & (rows["peak_input"] <= PEAK), axis=1)
    assert 0 < kept.sum() < len(grid)
    assert found.value <= 1.001 * rows["tracking_rmse"].max(axis=1)[kept].min()
    again = Campaign(fh.Loop(spring(), found.controller, 1), corners.draw, 8, 5, corners.options)
    one = run_batch(again, 0)
    assert (one["tracking_rmse"].max(), one["peak_input"].max() <= PEAK) == (found.value, True)
    begun = run_batch(Campaign(corners.loop, corners.draw, 8, 5, corners.options), 0)
    assert found.begun == (begun["tracking_rmse"].max() if begun["peak_input"].max() <= PEAK else math.inf)


@pytest.mark.ci("compiles an ensemble for a GPU")
def test_weights_found_on_a_gpu_are_those_of_the_processor(
    corners,
    on_stand_in: StandIn,  # noqa: F811
):
    cpu, gpu = (
        search_weights(corners, weighed, RANGES, "tracking_rmse", starts=3, device=device)
        for device in ("cpu", "gpu")
    )
    assert (cpu.weights, cpu.value, cpu.candidates) == (gpu.weights, gpu.value, gpu.candidates)
    assert on_stand_in["launches"] > 3


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"ranges": {}}, ("weight", "none")),
        ({"ranges": {"stiff": (0.0, 1.0)}}, ("'stiff'", "(0.0, 1.0)")),
        ({"ranges": {"stiff": 1.0}}, ("'stiff'", "1.0")),
        ({"metric": "speed"}, ("metric", "'speed'")),
        ({"requirements": ["peak_input<=0"], "starts": 1}, ("weights", "peak_input<=0", "none")),
        ({"ranges": {**RANGES, "stiff": (160.0, 200.0)}, "starts": 2}, ("weights", "none", "No law.")),
        ({"starts": 0}, ("starts",)),
        ({"ranges": [(1.0, 2.0)]}, ("ranges", "mapping", "(1.0, 2.0)")),
        ({"requirements": "peak_input<=4"}, ("requirements", "list", "'peak_input<=4'")),
        ({"seed": -1}, ("seed=-1",)),
        ({"controller_of": controller()}, ("function", "Controller")),
        ({"controller_of": lambda weights: None}, ("Controller", "None", "return")),
        ({"device": "tpu"}, ("device", "'tpu'")),
    ],
)
def test_mistakes_of_a_search_of_weights(corners, changes, words):
    given = {"controller_of": weighed, "ranges": RANGES, "metric": "tracking_rmse", **changes}
    with refused_with(InvalidInput, *words):
        search_weights(corners, **given)
