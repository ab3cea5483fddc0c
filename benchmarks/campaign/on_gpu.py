"""The paper's arm and seven links on a GPU: rates, bits beside those of lanes, and a whole campaign on disk."""

from __future__ import annotations

import math
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

import flexhinf as fh
from benchmarks.arm import PERIOD as PERIOD_OF_SEVEN, Arm
from benchmarks.measure import timed
from flexhinf.codegen import cuda

#: Plants at once; and robots and samples of the campaign.
PLANTS, ROBOTS, SAMPLES = (1 << 15, 1 << 17, 1 << 19), 1_000_000, 4_000

#: The same of seven links, a warp for each plant: plants at once, and samples of each.
PLANTS_OF_SEVEN, SAMPLES_OF_SEVEN = (1 << 13, 1 << 15), 400

#: Plants whose numbers are compared with those of lanes.
COMPARED = 1024


def on_gpu(ensemble: Any, parameters: np.ndarray, goal: float, noise: float) -> list[dict[str, Any]]:
    """Rows of the table; none without a card, and why.

    `ensemble`: Of the paper's arm. `parameters`: (N, P), of plants that are repeated. `goal`, `noise`: Its command, and
    the deviation of its noise.
    """
    try:
        card = cuda.card()
    except cuda.NoCard as error:
        print(f"not measured: {error.what} {error.found}")
        return []
    commit = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=True
    )
    where = f"{card.name}, driver of CUDA {card.version}, commit {commit.stdout.strip()}"
    rows = [*rates(ensemble, parameters, PLANTS, where), *rates(*seven_links(), PLANTS_OF_SEVEN, where)]
    loop = fh.Loop(ensemble.plant, ensemble.controller, 1)
    period, begun = ensemble.command.period, time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        fh.run_campaign(
            loop, fh.paper_arm().draw, ROBOTS, reference=fh.Step(goal), noise=noise, device="gpu",
            duration=(SAMPLES - 1) * period, folder=Path(folder) / "journal",
        )  # fmt: skip
    seconds = time.perf_counter() - begun
    rows.append(
        {"what": f"run_campaign of {ROBOTS:,} robots x {SAMPLES * period:g} s, with a journal", "target": "<= 30 s",
         "rate": ROBOTS * SAMPLES / seconds, "met": seconds <= 30.0, "note": f"{seconds:.0f} s; {where}"}
    )  # fmt: skip
    return rows


def seven_links() -> tuple[Any, np.ndarray]:
    """The ensemble of the catalogue's arm, and parameters of some of its plants."""
    arm = Arm()
    duration = (SAMPLES_OF_SEVEN - 1) * PERIOD_OF_SEVEN
    ensemble = fh.Loop(arm.plant, arm.controller, 1).ensemble(noise=1e-5, duration=duration)
    spread = 1.0 + 0.01 * np.random.default_rng(0).uniform(-1.0, 1.0, (64, 1))
    return ensemble, spread * arm.plant.parameters.vector()


def rates(
    ensemble: Any, parameters: np.ndarray, numbers: tuple[int, ...], where: str
) -> list[dict[str, Any]]:
    """Rows of one ensemble: its bits, and its rates for these numbers of plants."""
    steps, states = ensemble.command.samples, len(ensemble.start["x"])
    rows = [same_bits(ensemble, parameters, where)]
    for plants in numbers:
        several, seeds = np.resize(parameters, (plants, parameters.shape[1])), np.arange(plants)
        t = timed(
            lambda some=several, seeds=seeds: ensemble.run(some, seeds, device="gpu"), plants * steps, 3
        )
        what = f"ensemble of {plants:,} plants of {states} states x {steps:,} steps"
        rows.append({"what": what, "rate": 1.0 / t.median, "best": 1.0 / t.best, "note": where})
    return rows


def same_bits(ensemble: Any, parameters: np.ndarray, where: str) -> dict[str, Any]:
    """Whether every number of some plants is the same, some of them with far angles and some that diverge."""
    several, seeds = np.resize(parameters, (COMPARED, parameters.shape[1])), np.arange(COMPARED)
    states = np.tile(ensemble.start["x"], (COMPARED, 1))
    states[::100, 0] = 1e10 * math.pi
    states[50::100, 1] = 1e300
    cpu, gpu = (ensemble.run(several, seeds, states, device=device) for device in ("cpu", "gpu"))
    numbers = [(column, gpu.metrics()[name]) for name, column in cpu.metrics().items()]
    numbers += [(cpu.codes, gpu.codes), (cpu.diverged_at, gpu.diverged_at), (cpu.kept, gpu.kept)]
    equal = all(np.array_equal(one, other, equal_nan=True) for one, other in numbers)
    note = f"{COMPARED} plants, {int((cpu.codes != 0).sum())} of which diverge; {where}"
    what = f"bits of lanes, {len(ensemble.start['x'])} states"
    return {"what": what, "rate": None, "target": "equal", "met": equal, "note": note}
