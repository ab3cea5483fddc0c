"""Many controllers on the same samples of a campaign, as a search of weights needs them: all runs in a few batches."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np

from flexhinf.campaign.batches import ALONE, LARGEST_BATCH, Campaign, Rows, fill_reduced
from flexhinf.campaign.draws import sample_seeds
from flexhinf.campaign.metrics import NOT_RUN
from flexhinf.campaign.samples import Sample, taken
from flexhinf.codegen.gpu import Device
from flexhinf.errors import refuse_if
from flexhinf.loop import Controller


def judge_controllers(
    campaign: Campaign, controllers: Sequence[Controller], device: Device = "cpu"
) -> dict[str, np.ndarray]:
    """Metrics (L, N) by name, and ``status``, of the N samples of a campaign with each of L controllers.

    Row k has the bits of the campaign of the k-th controller: the same robots, noise and loads. All runs go side by
    side, each with its own numbers of law and estimator, as many at once as a batch has at most.

    `controllers`: of one program, which differ in numbers alone, as linear laws with other weights.
    `device`: where the runs are made; no number depends on it.
    Raises InvalidInput: for controllers of another program, period or goal, and for samples that run one by one.
    Raises FlexhinfError: without a GPU, where there should be one.
    """
    campaign.check_device(device)
    refuse_if(
        not len(controllers),
        "There is no controller to be judged.",
        "expected at least one, got none",
        "[campaign.loop.controller]",
    )
    count = campaign.samples
    samples = campaign.draw.samples(range(count), count, campaign.seed)
    modes = campaign.modes(samples)
    refuse_if(
        ALONE in modes,
        "The samples of this campaign run one by one.",
        "expected metrics that need no signals, and samples without a plant, delay, reference or disturbance of their "
        "own",
        "a campaign of each controller",
    )
    names = [name for metrics in campaign.metrics for name in metrics.units]
    found: Rows = {name: np.full((len(controllers), count), math.nan) for name in names}
    found["status"] = np.full((len(controllers), count), NOT_RUN, dtype=object)
    for places in modes.values():
        together = max(1, LARGEST_BATCH // len(places))
        for begin in range(0, len(controllers), together):
            some = controllers[begin : begin + together]
            part = _run(campaign, some, taken(samples, places), np.array(places), device)
            for name, column in found.items():
                column[begin : begin + together, places] = part[name].reshape(len(some), -1)
    return found


def _run(
    campaign: Campaign,
    controllers: Sequence[Controller],
    samples: Sequence[Sample],
    places: np.ndarray,
    device: Device,
) -> Rows:
    """Rows of samples with the first controller, then with the next one."""
    assert campaign.ensemble is not None
    plants, times = (
        campaign.plants((), samples, seeds=sample_seeds(campaign.seed, places.tolist())),
        len(controllers),
    )
    inputs, loads, table = plants.get("initial_inputs"), plants["loads"], campaign.ensemble.plant.parameters
    result = campaign.ensemble.run(
        np.tile(table.vectors(cast("Sequence[Mapping[str, Any]]", plants["parameters"])), (times, 1)),
        np.tile(np.asarray(plants["seeds"]), times),
        np.tile(np.asarray(plants["initial_states"]), (times, 1)),
        None if loads is None else np.tile(np.asarray(loads), (times, 1)),
        initial_inputs=None if inputs is None else np.tile(np.asarray(inputs), (times, 1)),
        controllers=[each for each in controllers for _ in places],
        device=device,
        traced=0,
    )
    every = np.arange(times * len(places))
    names = ["diverged_at_s", *(name for metrics in campaign.metrics for name in metrics.units)]
    rows: Rows = {name: np.full(len(every), math.nan) for name in names}
    rows["status"] = np.full(len(every), "", dtype=object)
    fill_reduced(campaign, rows, every, result, every[:0])
    return rows
