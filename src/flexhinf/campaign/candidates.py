"""Many controllers on the same samples of a campaign, all runs in a few batches; and the search of weights by them.

The search is that of `flexhinf.analysis.search` over the logarithms of the weights, from several starts at once: a
generation are the candidates of a step of all of them. A candidate whose law cannot be made, or of which a sample does
not come to its end or misses a requirement, has no value.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from flexhinf.analysis.search import climb
from flexhinf.campaign.batches import ALONE, LARGEST_BATCH, Campaign, Rows, checked_integer, fill_reduced
from flexhinf.campaign.draws import sample_seeds
from flexhinf.campaign.metrics import COMPLETED, NOT_RUN, MetricLimit, known_metric
from flexhinf.campaign.samples import Sample, taken
from flexhinf.campaign.worst_case import STARTS, check_starts
from flexhinf.codegen.gpu import Device
from flexhinf.errors import FlexhinfError, InvalidInput, refuse_if
from flexhinf.loop import Controller
from flexhinf.loop.simulation.own_laws import checked_controllers
from flexhinf.processors import single_blas
from flexhinf.validation import checked_kind, real_array, value_text

#: Key of the random starts.
_STREAM = 0x77656967687473


def judge_controllers(
    campaign: Campaign, controllers: Sequence[Controller], device: Device = "cpu"
) -> dict[str, np.ndarray]:
    """Metrics (L, N) by name, and ``status``, of the N samples of a campaign with each of L controllers.

    Row k has the bits of the campaign of the k-th controller: the same robots, noise and loads. All runs go side by
    side, each with its own numbers of law and estimator, as many at once as a batch has at most.

    `controllers`: of one program, which differ in numbers alone, as linear laws with other weights.
    `device`: where the runs are made; no number depends on it.
    Raises InvalidInput: for what is no controller, or one of another program, period or goal; and for samples that run
        one by one.
    Raises FlexhinfError: without a GPU, where there should be one.
    """
    _check_campaign(campaign)
    campaign.check_device(device)
    checked_controllers(controllers)
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
    for places in [
        every[k : k + LARGEST_BATCH] for every in modes.values() for k in range(0, len(every), LARGEST_BATCH)
    ]:
        together = LARGEST_BATCH // len(places)
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


def _check_campaign(campaign: object) -> None:
    what, advice = "Controllers are judged by a campaign.", "flexhinf.campaign.Campaign(loop, draw, samples)"
    checked_kind(what, campaign, Campaign, "a Campaign", advice)


@dataclass(frozen=True, eq=False)
class SearchedWeights:
    """Result of a search of weights."""

    weights: Mapping[str, float]
    controller: Controller  # with these weights
    value: float  # of the metric, with the worst sample
    begun: float  # the same of the campaign's own controller; infinite where it has no value
    candidates: int  # that were tried


@single_blas()
def search_weights(
    campaign: Campaign,
    controller_of: Callable[[Mapping[str, float]], Controller],
    ranges: Mapping[str, tuple[float, float]],
    metric: str,
    requirements: Sequence[str] = (),
    *,
    starts: int = STARTS,
    seed: int = 0,
    device: Device = "cpu",
    progress: Callable[[int, float], None] = lambda candidates, best: None,
) -> SearchedWeights:
    """Search the weights with which the worst sample of a campaign has the smallest value of a metric.

    `controller_of`: makes the controller of weights by name, of one program for all; a `FlexhinfError` is no candidate.
    `ranges`: smallest and largest value of each weight, above zero.
    `requirements`: that every sample has to meet, as ``peak_input<=24``.
    `starts`, `seed`: searches, from the middle of the ranges and from random points; of the latter.
    `device`: where the runs are made; no number depends on it.
    `progress`: called with the candidates so far and the best value.
    Raises InvalidInput: for ranges, a metric or a requirement that are none; for weights that give no `Controller`;
        where no candidate has a value; and as `judge_controllers`.
    """
    _check_campaign(campaign)
    low, high = _checked_ranges(ranges)
    what, advice = "The requirements are not told apart.", "['peak_input<=24']"
    checked_kind(what, requirements, (list, tuple), "a list of texts", advice)
    judged = [column.name for column in campaign.columns if column.judged]
    rules = [MetricLimit.of(text, judged) for text in requirements]
    known_metric(metric, judged)
    check_starts(starts)
    seed = checked_integer("seed", seed, 0, 2**63 - 1, "0")
    refuse_if(
        not callable(controller_of),
        "There is nothing that makes controllers.",
        f"expected a function of weights by name, got {value_text(controller_of)}",
        "controller_of=lambda weights: fh.Controller(…)",
    )

    refused: list[FlexhinfError] = []

    def weights(point: np.ndarray) -> dict[str, float]:
        return dict(zip(ranges, (low ** (1.0 - point) * high**point).tolist(), strict=True))

    def controller_at(point: np.ndarray) -> Controller | None:
        try:
            controller = controller_of(weights(point))
        except FlexhinfError as error:
            refused.append(error)
            return None
        what, advice = "The weights give no controller.", "return fh.Controller(law, estimator, period)"
        checked_kind(what, controller, Controller, "a Controller of controller_of", advice)
        return controller

    def sizes(points: np.ndarray) -> np.ndarray:
        controllers = [controller_at(point) for point in points]
        known = [k for k, each in enumerate(controllers) if each is not None]
        found = np.full(len(points), -math.inf)
        if known:
            some = [each for each in controllers if each is not None]
            found[known] = -_worst(judge_controllers(campaign, some, device), metric, rules)
        return found

    own = _worst(judge_controllers(campaign, [campaign.loop.controller], device), metric, rules)
    generator = np.random.Generator(np.random.Philox(key=[seed, _STREAM]))
    some = np.vstack([np.full((1, len(low)), 0.5), generator.random((starts - 1, len(low)))])
    best = climb(sizes, some, lambda tried, best: progress(tried, -best))
    if best.value == -math.inf:
        without = f"; {len(refused)} without a controller, as: {refused[-1].what}" if refused else ""
        raise InvalidInput(
            "No weights were found.",
            f"expected a law of which every sample comes to its end and keeps {list(requirements)}, got none of "
            f"{best.evaluations} candidates{without}",
            "wider ranges, more starts, or other requirements",
        ) from (refused[-1] if refused else None)
    found = weights(best.point)
    return SearchedWeights(found, controller_of(found), -best.value, float(own[0]), best.evaluations)


def _worst(found: Mapping[str, np.ndarray], metric: str, rules: Sequence[MetricLimit]) -> np.ndarray:
    """Largest value (L,) of a metric of all samples that are run; infinite where one has none or misses a rule."""
    run = found["status"] != NOT_RUN
    fails = run & ((found["status"] != COMPLETED) | np.isnan(found[metric]))
    for rule in rules:
        fails |= run & ~rule.met(found[rule.metric])
    values = np.where(run, found[metric], -math.inf).max(axis=1)
    return np.where(fails.any(axis=1) | ~run.any(axis=1), math.inf, values)


def _checked_ranges(ranges: Mapping[str, tuple[float, float]]) -> np.ndarray:
    """Smallest and largest values (2, d) of weights; others than finite ones above zero are refused."""
    what, advice = "The ranges of the weights have no names.", "{'link_position': (1.0, 100.0)}"
    checked_kind(what, ranges, Mapping, "a mapping", advice)
    for name, ends in ranges.items():
        numbers = real_array(ends)
        if numbers.shape != (2,) or not 0.0 < numbers[0] <= numbers[1] < math.inf:
            raise InvalidInput(
                f"The range of the weight {name!r} is not usable.",
                f"expected finite 0 < low <= high, got {value_text(ends)}",
                f"{{{name!r}: (1.0, 100.0)}}",
            )
    refuse_if(
        not ranges,
        "There is no weight to search.",
        "expected at least one range by name, got none",
        advice,
    )
    return np.array([*ranges.values()], dtype=float).T
