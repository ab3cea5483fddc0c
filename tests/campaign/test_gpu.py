"""Campaigns on a GPU, whose PTX this processor runs: the same files to the last byte; replays are on the CPU."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from tests.campaign.conftest import OPTIONS, made_campaign, made_loop, output, tolerances
from tests.card import StandIn, on_stand_in, stand_in  # noqa: F401 - fixtures
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.campaign import (
    Journal,
    Sample,
    Shard,
    drive,
    driver as campaign_driver,
    on_device,
    worst_case,
)
from flexhinf.campaign.batches import rows_of, run_batch
from flexhinf.codegen import cuda
from flexhinf.codegen.program import Unsupported
from flexhinf.errors import FlexhinfError, InvalidInput

pytest.importorskip("pyarrow")

#: The file, beside the function of the same name.
worst_case_file = sys.modules["flexhinf.campaign.worst_case"]


def torn(rng: np.random.Generator) -> dict[str, float]:
    """Some springs push instead of pulling."""
    return {"mass": 1.0, "stiffness": float(rng.choice([20.0, -1e7]))}


@pytest.mark.ci("compiles an ensemble for lanes, and as PTX, which becomes C")
@pytest.mark.parametrize("draw", [tolerances(), torn], ids=["tolerances", "diverging"])
def test_shards_of_both_devices_make_one_journal_with_the_bytes_of_one(
    draw,
    tmp_path,
    on_stand_in: StandIn,  # noqa: F811
):
    """Which device made a shard is no part of it. A replay is made on the processor."""
    campaign = made_campaign(draw=draw)
    cpu, mixed = (Journal.opened(tmp_path / name, campaign) for name in ("cpu", "mixed"))
    drive(campaign, cpu)
    before = on_stand_in["launches"]
    assert drive(campaign, mixed, shard=Shard(1, 2), executor=on_device("gpu")) is None
    assert on_stand_in["launches"] > before
    drive(campaign, mixed, shard=Shard(2, 2))
    files = [sorted(path.name for path in (journal.folder / "shards").iterdir()) for journal in (cpu, mixed)]
    assert files[0] == files[1]  # each with the digest of its bytes
    table = (cpu.folder / "samples.parquet").read_bytes()
    assert (mixed.folder / "samples.parquet").read_bytes() == table
    rows = run_batch(campaign, 0, "gpu")
    for k in (0, 7):
        run = campaign.replay(k)
        fine = rows["status"][k] == "completed"
        assert (run.diverged_at is None) == fine
        if fine:
            assert run.metrics()["peak_input"] == rows["peak_input"][k]


@pytest.mark.ci("compiles an ensemble for a GPU")
def test_run_campaign_on_a_gpu_runs_what_it_cannot_on_the_processor(on_stand_in: StandIn):  # noqa: F811
    """Samples with a disturbance of their own, beside others."""

    def draw(rng: np.random.Generator) -> Sample:
        force = float(rng.uniform(-1.0, 1.0))
        own = {"disturbance": {"push": fh.Step(force)}} if force > 0.5 else {}
        return Sample({"mass": 1.0 + 0.1 * force}, own, {"force": force})

    loop, given = made_loop(), {"seed": 3, "reference": 0.1, "duration": 0.2}
    cpu, gpu = (fh.run_campaign(loop, draw, 20, device=device, **given) for device in ("cpu", "gpu"))
    assert cpu.identical(gpu)
    assert 0 < (cpu.force > 0.5).sum() < 20


@pytest.mark.ci("compiles an ensemble for a GPU")
def test_the_worst_plant_is_the_same_found_on_a_gpu_whose_generations_run_at_once(
    on_stand_in: StandIn,  # noqa: F811
    monkeypatch: pytest.MonkeyPatch,
):
    """Every bit of both results. Of 400 searches a generation is one launch, but for a few plants on the processor."""
    campaign, sizes = made_campaign(), list[int]()
    parts = [run_batch(campaign, k) for k in range(campaign.batches)]
    rows = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    cpu = worst_case(campaign, "overshoot_percent", rows, starts=400)
    before = on_stand_in["launches"]
    monkeypatch.setattr(
        worst_case_file, "rows_of", lambda *some, **more: sizes.append(len(some[1])) or rows_of(*some, **more)
    )
    assert worst_case(campaign, "overshoot_percent", rows, starts=400, device="gpu") == cpu
    assert cpu.found.value >= cpu.corner.value
    assert on_stand_in["launches"] - before == sum(size >= 8 for size in sizes) > 2
    assert sizes[0] == 4 + 8 * 400  # corners and points; then the best of them are the starts
    assert sizes[2] == 400


@pytest.mark.ci("compiles an ensemble for a GPU")
def test_a_card_that_fails_is_no_fault_of_a_sample(on_stand_in: StandIn):  # noqa: F811
    """Nothing is left in its memory, as the fixture says, and the next campaign runs."""
    loop, given = made_loop(), {"device": "gpu", **OPTIONS}
    for name, code, words in (("failing", 700, ("700", "cpu")), ("failing", 2, ("memory", "batch", "cpu"))):
        on_stand_in[name] = code
        with refused_with(cuda.CardError, *words):
            fh.run_campaign(loop, tolerances(), 20, **given)
    on_stand_in["failing"] = 0
    assert fh.run_campaign(loop, tolerances(), 20, **given).sizes["sample"] == 20

    def flow(x, u, d, p):
        return np.array([x[1], (u[0] - p.stiffness * np.tanh(x[0])) / p.mass])

    soft = fh.Plant(flow, output, ("position", "velocity"), ("force",), (), {"mass": 1.0, "stiffness": 20.0})
    with refused_with(Unsupported, "tanh", "cpu"):
        fh.run_campaign(fh.Loop(soft, loop.controller, 1), tolerances(), 20, **given)


def test_what_no_gpu_does_is_refused_before_any_work(monkeypatch):
    monkeypatch.setattr(cuda, "card", lambda: cuda.Card(cuda.Driver("libnothing.so.7")))
    loop = made_loop()
    with refused_with(InvalidInput, "device", "cpu", "gpu", "'tpu'"):
        fh.run_campaign(loop, tolerances(), 5, device="tpu", **OPTIONS)
    for more in ({}, {"workers": 2}):
        with refused_with(FlexhinfError, "driver", "libnothing.so.7", "cpu"):
            fh.run_campaign(loop, tolerances(), 5, device="gpu", **OPTIONS, **more)
    with refused_with(InvalidInput, "effort", "cpu"):
        metrics = {"effort": lambda run: float(run.signals["input"].max())}
        fh.run_campaign(loop, tolerances(), 5, device="gpu", metrics=metrics, **OPTIONS)
    with refused_with(InvalidInput, "delay", "cpu"):
        fh.run_campaign(loop, lambda rng: Sample({"mass": 1.0}, delay=1), 5, device="gpu", **OPTIONS)


def test_a_worker_without_a_gpu_uses_its_processor(monkeypatch):
    """Workers of a cluster have one or not."""
    used: list[str] = []
    monkeypatch.setattr(campaign_driver, "_worker_campaign", lambda sent: None)
    monkeypatch.setattr(campaign_driver, "run_batch", lambda campaign, batch, device: used.append(device))
    for there in (True, False):
        monkeypatch.setattr(cuda, "is_there", lambda there=there: there)
        for device in ("gpu", "cpu"):
            campaign_driver.remote_batch(b"", 0, fh.__version__, device)
    assert used == ["gpu", "cpu", "cpu", "cpu"]
