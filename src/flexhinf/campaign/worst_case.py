"""Search for the worst plant inside the box of the tolerances: the result is a lower bound of the worst metric.

The search maximises a metric over the intervals of the varied numbers, ends included. All its runs have the noise of
the worst sample of the campaign, so that plants differ by their numbers and not by luck. It starts at that sample, so
its result is never less bad, and also at other bad samples, at the worst corners, and at random points of the box.
Noise itself is not searched: it has no bounds. Each result is one file in the campaign's folder.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.analysis.search import box_corners, climb
from flexhinf.campaign.batches import Campaign, checked_integer, rows_of, run_batch
from flexhinf.campaign.draws import Tolerances
from flexhinf.campaign.journal import Journal
from flexhinf.campaign.manifest import UNREADABLE
from flexhinf.campaign.metrics import COMPLETED, known_metric
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.loop import Trajectory
from flexhinf.validation import NotReadable

#: All corners are run if there are at most so many.
MOST_CORNERS = 1024

#: Number of searches, by default and at most; and runs in one call.
STARTS, MOST_STARTS, CHUNK = 8, 1000, 256

#: Key of the random starts; the samples' own numbers have other keys.
_STREAM = 0x776F727374

#: Folder of the files, inside the campaign's folder.
FOLDER = Path("worst-case")


@dataclass(frozen=True)
class EvaluatedPlant:
    """One plant: its numbers, its value of the metric (NaN where the run has none) and the status of its run."""

    numbers: Mapping[str, float]
    value: float
    status: str = COMPLETED

    def size(self, least: bool) -> float:
        """Badness of the plant, by which plants are compared: infinite where the run did not come to its end."""
        return float(_sizes(np.array(self.value), np.array(self.status, dtype=object), least))


@dataclass(frozen=True)
class WorstCase:
    """Result of the search for the worst plant by one metric."""

    metric: str
    unit: str
    least: bool  # Whether small values are the bad ones
    sample: int  # The worst sample inside the box; every run of the search has its noise
    # sampled, found, nominal: That sample, the plant that the search found, and the nominal one, with the same noise
    sampled: EvaluatedPlant
    found: EvaluatedPlant
    nominal: EvaluatedPlant
    # The metric of the plant found with this number alone at its nominal value; NaN where the run has none
    alone: Mapping[str, float]
    intervals: Mapping[str, tuple[float, float]]  # The box
    units: Mapping[str, str]  # Of the numbers
    # starts, together: Searches, and how many of them ended at the plant found
    starts: int
    together: int
    all_corners: bool  # Whether every corner was run
    runs: int
    # Samples outside the box (a normal distribution is not cut off); they are not compared
    outside: int
    settings: Mapping[str, str]  # The settings that the result depends on

    @property
    def factor(self) -> float:
        """Ratio of the worst value found to the worst one sampled; NaN unless both are positive, of complete runs."""
        a, b = self.found.value, self.sampled.value
        whole = self.found.status == self.sampled.status == COMPLETED
        return a / b if whole and b > 0.0 and 0.0 <= a < math.inf else math.nan

    @property
    def worse(self) -> bool:
        """Whether the search found a worse plant than the samples."""
        return self.found.size(self.least) > self.sampled.size(self.least)

    def run(self, campaign: Campaign, plant: EvaluatedPlant | None = None) -> Trajectory:
        """Run the plant found, or another one with the same noise; InvalidInput where it cannot be run."""
        sample = _box(campaign).built((plant or self.found).numbers, self.sample)
        refuse_if(
            sample.failure,
            f"The plant with the worst {self.metric} cannot be run.",
            sample.failure,
            "another metric",
        )
        return next(campaign.trajectories([self.sample], [sample]))

    def again(self, campaign: Campaign) -> EvaluatedPlant:
        """Run the plant found once more, alone; the value has the same bits as in the search."""
        return _runs(campaign, [self.found.numbers], self.sample, self.metric)[0]


def worst_case(
    campaign: Campaign,
    metric: str,
    rows: Mapping[str, ArrayLike] | None = None,
    *,
    least: bool = False,
    starts: int = STARTS,
    seed: int | None = None,
    nominal: Mapping[str, float] | None = None,
    journal: Journal | None = None,
    progress: Callable[[int, float], None] = lambda runs, best: None,
) -> WorstCase:
    """Search the box of a campaign's tolerances for the plant with the worst value of a metric.

    `campaign`: its draw must be `Tolerances`.
    `rows`: the campaign's rows, as `run_campaign` gives them; without them its samples are run now.
    `least`: whether the smallest value is the worst.
    `starts`: searches: half of them begin at the worst samples, a quarter at the worst corners, the others at random.
    `seed`: of the random starts; by default the campaign's.
    `nominal`: nominal numbers; those that are not named are the middles of their intervals.
    `journal`: its folder keeps the result; a stored result of the same options is returned without a search.
    `progress`: called with the runs so far and the worst value.
    Returns: never better than the worst sample. The same bits for any number of threads or lanes.
    Raises InvalidInput: for a draw without intervals, an unknown metric, or one that no sample has; or if another
        driver is at work on the journal. Raises FlexhinfError: if the disk is full.
    """
    box = _box(campaign)
    known_metric(metric, [column.name for column in campaign.columns if column.judged])
    check_starts(starts)
    seed = checked_integer("seed", campaign.seed if seed is None else seed, 0, 2**63 - 1, "0")
    settings = {
        "campaign": campaign.digest,
        "metric": metric,
        "least": str(least),
        "starts": str(starts),
        "seed": str(seed),
    }
    try:
        if journal is not None and (stored := stored_worst(journal, metric)).settings == settings:
            return stored
    except NotReadable:
        raise
    except InvalidInput:  # no file, or a damaged one: search
        pass
    names = [variable.name for variable in box.variables]
    low, high = np.array([(variable.low, variable.high) for variable in box.variables], dtype=float).T
    table = _columns(campaign, rows, [metric, "status", *names])
    points = np.column_stack([table[name] for name in names]).astype(float)
    inside = np.all((points >= low) & (points <= high), axis=1)
    size = np.where(inside, _sizes(table[metric].astype(float), table["status"], least), -math.inf)
    order = np.argsort(-size, kind="stable")
    first = int(order[0])
    refuse_if(
        size[first] == -math.inf,
        f"No sample has the metric {metric!r}.",
        f"expected a number in one of {len(size)} rows, inside the intervals of the tolerances",
        "a metric that the runs have, as peak_input",
    )

    def numbers(t: np.ndarray) -> dict[str, float]:
        return dict(zip(names, ((1.0 - t) * low + t * high).tolist(), strict=True))

    runs = 0

    def values(unit: np.ndarray) -> np.ndarray:
        nonlocal runs
        runs += len(unit)
        return np.array(
            [plant.size(least) for plant in _runs(campaign, list(map(numbers, unit)), first, metric)]
        )

    all_corners = 1 << len(names) <= MOST_CORNERS
    sampled = EvaluatedPlant(
        dict(zip(names, points[first].tolist())), float(table[metric][first]), str(table["status"][first])
    )
    worst_plant, together = sampled, 1
    if math.isfinite(size[first]):
        width = np.where(high > low, high - low, 1.0)
        some = [(points[k] - low) / width for k in order[: max(1, starts // 2)] if size[k] > -math.inf]
        if all_corners:
            every = box_corners(len(names))
            some += list(every[np.argsort(-values(every), kind="stable")[: -(-(starts - len(some)) // 2)]])
        generator = np.random.Generator(np.random.Philox(key=[seed, _STREAM]))
        some += list(generator.random((max(0, starts - len(some)), len(names))))
        climbed = climb(values, np.array(some), lambda _, best: progress(runs, -best if least else best))
        (best,) = _runs(campaign, [numbers(climbed.point)], first, metric)
        if best.size(least) > sampled.size(least):
            worst_plant, together = best, climbed.together
    middle = {**numbers(np.full(len(names), 0.5)), **{k: v for k, v in (nominal or {}).items() if k in names}}
    others = [middle, *({**worst_plant.numbers, name: middle[name]} for name in names)]
    centre, *restored = _runs(campaign, others, first, metric)
    case = WorstCase(
        metric,
        next(c.unit for c in campaign.columns if c.name == metric),
        least,
        first,
        sampled,
        worst_plant,
        centre,
        {name: plant.value for name, plant in zip(names, restored)},
        dict(zip(names, zip(low.tolist(), high.tolist()))),
        {name: box.units[name] for name in names},
        starts,
        together,
        all_corners,
        runs + len(others),
        int((~inside).sum()),
        settings,
    )
    if journal is not None:
        journal.store(FOLDER / f"{metric}.json", asdict(case))
    return case


def check_starts(starts: object) -> None:
    """Refuse a number of searches that is out of range."""
    checked_integer("starts", starts, 1, MOST_STARTS, str(STARTS))


def _box(campaign: Campaign) -> Tolerances:
    if isinstance(campaign.draw, Tolerances) and campaign.draw.variables:
        return campaign.draw
    raise InvalidInput(
        "The samples of this campaign have no box that could be searched.",
        f"expected a draw by Tolerances with variables, got {type(campaign.draw).__name__}",
        "Tolerances([Variable('stiffness', 0.9, 1.1), …])",
    )


def _columns(
    campaign: Campaign, rows: Mapping[str, ArrayLike] | None, names: list[str]
) -> dict[str, np.ndarray]:
    if rows is None:
        parts = [run_batch(campaign, batch) for batch in range(campaign.batches)]
        return {name: np.concatenate([part[name] for part in parts]) for name in names}
    columns = {name: np.asarray(rows[name]) for name in names if name in rows}
    sizes = {name: columns[name].shape if name in columns else "none" for name in names}
    refuse_if(
        any(size != (campaign.samples,) for size in sizes.values()),
        "The rows are not those of the campaign.",
        f"expected {campaign.samples} numbers of each, got {sizes}",
        "what run_campaign returned for the same loop, draw and samples",
    )
    return columns


def _runs(
    campaign: Campaign, numbers: list[dict[str, float]] | list[Mapping[str, float]], noise: int, metric: str
) -> list[EvaluatedPlant]:
    box, plants = _box(campaign), list[EvaluatedPlant]()
    for begin in range(0, len(numbers), CHUNK):
        some = numbers[begin : begin + CHUNK]
        rows = rows_of(campaign, [noise] * len(some), [box.built(point, noise) for point in some])
        plants += [
            EvaluatedPlant(dict(point), float(value), str(status))
            for point, value, status in zip(some, rows[metric], rows["status"])
        ]
    return plants


def _sizes(values: np.ndarray, status: np.ndarray, least: bool) -> np.ndarray:
    """Badness (N,) of runs: infinite where one did not come to its end, −inf where it has no value."""
    sizes = np.where(np.isnan(values), -math.inf, -values if least else values)
    return np.where(status == COMPLETED, sizes, math.inf)


def stored_worst(journal: Journal, metric: str) -> WorstCase:
    """The worst case of a metric from the campaign's folder.

    InvalidInput if nothing was searched, or the file is damaged or of another campaign.
    """
    path = FOLDER / f"{known_metric(metric, journal.metrics)}.json"
    try:
        case = journal.stored(path, WorstCase)
        if (case.settings["campaign"], case.metric) == (journal.digest, metric):
            return case
        raise ValueError("it is of another campaign")
    except FileNotFoundError:
        known = [name for name in journal.metrics if (journal.folder / FOLDER / f"{name}.json").exists()]
        raise InvalidInput(
            f"The worst case of {metric!r} was not searched in this campaign.",
            f"expected one of {', '.join(known) or 'none'}",
            f"the campaign's command with --worst-case --metric {metric}",
        ) from None
    except NotReadable:
        raise
    except UNREADABLE as error:
        raise InvalidInput(
            f"The worst case of {metric!r} cannot be read.",
            f"{journal.folder / path}: {str(error)[:200]}",
            "the campaign's command with --worst-case, which searches again",
        ) from error


def stored_worsts(journal: Journal) -> list[WorstCase]:
    """Every stored worst case that can be read, in the order of the metrics."""
    cases: list[WorstCase] = []
    for metric in journal.metrics:
        try:
            cases.append(stored_worst(journal, metric))
        except NotReadable:
            raise
        except InvalidInput:  # the command that searches reports a damaged file and repairs it
            continue
    return cases
