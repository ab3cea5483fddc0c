"""Many controllers on the same samples: each has the bits of a campaign of its own, in lanes, alone and on a GPU."""

from __future__ import annotations

import numpy as np
import pytest
from tests.campaign.conftest import OPTIONS, Feedback, made_campaign, made_loop, spring, tolerances
from tests.card import StandIn, on_stand_in, stand_in  # noqa: F401 - fixtures
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.campaign import Campaign, Sample, judge_controllers
from flexhinf.campaign.batches import run_batch
from flexhinf.errors import InvalidInput

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


def test_controllers_that_cannot_run_together_are_refused():
    campaign = made_campaign()
    for others, words in (
        ([], ("at least one", "none")),
        ([controller(), controller(period=2e-3)], ("period",)),
        ([controller(latency=2)], ("program", "estimator")),
    ):
        with refused_with(InvalidInput, *words):
            judge_controllers(campaign, others)
    alone = made_campaign(metrics={"effort": lambda run: 1.0})
    with refused_with(InvalidInput, "one by one", "signals"):
        judge_controllers(alone, [made_loop().controller])
    ensemble = made_loop().ensemble(duration=0.1)
    with refused_with(InvalidInput, "controllers", "2", "1"):
        ensemble.run([{}, {}], controllers=[controller()])
    own = made_loop().ensemble(duration=0.1, initial_memory=controller().initial_memory(input=[1.0]))
    with refused_with(InvalidInput, "initial_memory"):
        own.run([{}], controllers=[controller()])
