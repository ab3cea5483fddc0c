"""Search for the worst plant inside the box of the tolerances: the result is a lower bound of the worst metric.

The search maximises a metric over the intervals of the varied numbers, ends included. All its runs have the noise of
the worst sample of the campaign, so that plants differ by their numbers and not by luck. Its first generation are the
corners of the box, or a random choice of them, and random points. From the worst samples, corners and points searches
go side by side, and the plants of a step of all of them are one generation. So the result is never less bad than any of
them. With S searches in d numbers the first generation has up to (`CORNERS` + `POINTS`) S plants, and later ones 2 d S
and (`TRIALS` + 2 d) S at most. Each runs at once, on the device that is stated, and no number depends on which it is.
Noise itself is not searched: it has no bounds. Each result is one file in the campaign's folder.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.analysis.search import box_corners, climb
from flexhinf.campaign.batches import LARGEST_BATCH, Campaign, checked_integer, rows_of, run_batch
from flexhinf.campaign.damping import DAMPING, OF_RUNS, LinearDamping
from flexhinf.campaign.draws import Tolerances
from flexhinf.campaign.journal import Journal
from flexhinf.campaign.manifest import UNREADABLE
from flexhinf.campaign.metrics import COMPLETED, known_metric
from flexhinf.campaign.samples import Columns, Sample
from flexhinf.codegen.gpu import Device
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.loop import Trajectory
from flexhinf.processors import single_blas
from flexhinf.validation import NotReadable

#: Corners and random points of the first generation, for each search. All corners are run if there are at most so
#: many, or at most `MOST_CORNERS`.
CORNERS, POINTS, MOST_CORNERS = 128, 8, 1024

#: Number of searches, by default and at most.
STARTS, MOST_STARTS = 8, 10_000

#: Plants that run at once at most; and those that are built one by one.
TOGETHER, CHUNK = LARGEST_BATCH, 256

#: Key of the random points; the samples' own numbers have other keys.
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
    # sampled, corner, found, nominal: That sample, the worst corner that was run, the plant that the search found, and
    # the nominal one, with the same noise
    sampled: EvaluatedPlant
    corner: EvaluatedPlant
    found: EvaluatedPlant
    nominal: EvaluatedPlant
    # The metric of the plant found with this number alone at its nominal value; NaN where the run has none
    alone: Mapping[str, float]
    intervals: Mapping[str, tuple[float, float]]  # The box
    units: Mapping[str, str]  # Of the numbers
    # starts, together: Searches, and how many of them ended at the plant found
    starts: int
    together: int
    corners: int  # How many were run
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
    def all_corners(self) -> bool:
        """Whether every corner was run."""
        return self.corners == 1 << len(self.intervals)

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
        return _Generations(campaign, self.metric, self.least, self.sample).plants([self.found.numbers])[0]


@single_blas()
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
    device: Device = "cpu",
) -> WorstCase:
    """Search the box of a campaign's tolerances for the plant with the worst value of a metric.

    `campaign`: its draw must be `Tolerances`.
    `metric`: of the runs; or `DAMPING`, the least damping ratio of the linear loop, which needs no runs.
    `rows`: the campaign's rows, as `run_campaign` gives them; without them its samples are run now.
    `least`: whether the smallest value is the worst; of `DAMPING` it is.
    `starts`: searches: half of them begin at the worst samples, a quarter at the worst corners, the others at the worst
        random points. Generations grow with their number.
    `seed`: of the random points; by default the campaign's.
    `nominal`: nominal numbers; those that are not named are the middles of their intervals.
    `journal`: its folder keeps the result; a stored result of the same options is returned without a search.
    `progress`: called with the runs so far and the worst value.
    `device`: where runs are made, those of samples too.
    Returns: never better than the worst sample and the worst corner that was run. The same bits for any number of
        threads or lanes, and for either device.
    Raises InvalidInput: for a draw without intervals, an unknown metric, or one that no sample has; for runs that a GPU
        does not make; or if another driver is at work on the journal. Raises FlexhinfError: if the disk is full, or
        without a GPU, where there should be one.
    """
    linear = check_searchable(campaign, metric)
    check_starts(starts)
    campaign.check_device(device)
    seed = checked_integer("seed", campaign.seed if seed is None else seed, 0, 2**63 - 1, "0")
    search = _Generations(campaign, metric, least or linear is not None, 0, device)
    settings = {
        "campaign": campaign.digest,
        "metric": metric,
        "least": str(search.least),
        "starts": str(starts),
        "seed": str(seed),
    }
    if journal is not None:
        try:
            stored = _stored_case(journal, metric)
        except Damaged:  # it is made anew
            stored = None
        if stored is not None and stored.settings == settings:
            return stored
    case = _searched(search, rows, (starts, seed), nominal or {}, progress, settings)
    if journal is not None:
        journal.store(FOLDER / f"{metric}.json", asdict(case))
    return case


def _searched(
    search: _Generations,
    rows: Mapping[str, ArrayLike] | None,
    starts_and_seed: tuple[int, int],
    nominal: Mapping[str, float],
    progress: Callable[[int, float], None],
    settings: Mapping[str, str],
) -> WorstCase:
    """The result of `worst_case`: the first generation, searches from its worst plants, then each number alone."""
    (starts, seed), least, names, box = starts_and_seed, search.least, search.names, _box(search.campaign)
    points, values, status = search.samples(rows)
    inside = np.all((points >= search.low) & (points <= search.high), axis=1)
    size = np.where(inside, _sizes(values, status, least), -math.inf)
    search.noise = first = int(np.argmax(size))
    refuse_if(
        size[first] == -math.inf,
        f"No sample has the metric {search.metric!r}.",
        f"expected a number in one of {len(size)} rows, inside the intervals of the tolerances",
        "a metric that the runs have, as peak_input",
    )
    sampled = EvaluatedPlant(
        dict(zip(names, points[first].tolist())), float(values[first]), str(status[first])
    )
    generator = np.random.Generator(np.random.Philox(key=[seed, _STREAM]))
    corners = _corners(len(names), starts, generator)
    spread = generator.random((POINTS * starts, len(names)))
    at_corners, at_points = np.split(search.sizes(np.vstack([corners, spread])), [len(corners)])
    (corner,) = search.plants(search.rows(corners[[np.argmax(at_corners)]]))
    found, together = max((sampled, corner), key=lambda plant: plant.size(least)), 1
    if math.isfinite(size[first]):
        begun = (points - search.low) / search.width
        some = _starts([(begun, size), (corners, at_corners), (spread, at_points)], starts)
        climbed = climb(search.sizes, some, lambda _, best: progress(search.runs, -best if least else best))
        (best,) = search.plants(search.rows(climbed.point[None]))
        if best.size(least) > sampled.size(least):
            found, together = max((best, corner), key=lambda plant: plant.size(least)), climbed.together
    (middle,) = search.rows(np.full((1, len(names)), 0.5))
    middle |= {name: value for name, value in nominal.items() if name in middle}
    centre, *restored = search.plants([middle, *({**found.numbers, name: middle[name]} for name in names)])
    return WorstCase(
        search.metric,
        next((c.unit for c in search.campaign.columns if c.name == search.metric and c.judged), ""),
        least,
        first,
        sampled,
        corner,
        found,
        centre,
        {name: plant.value for name, plant in zip(names, restored)},
        dict(zip(names, zip(search.low.tolist(), search.high.tolist()))),
        {name: box.units[name] for name in names},
        starts,
        together,
        len(corners),
        search.runs,
        int((~inside).sum()),
        settings,
    )


def _corners(d: int, starts: int, generator: np.random.Generator) -> np.ndarray:
    """Corners (N, d) of the unit box: all of them, or a random choice of so many that `starts` searches have."""
    most = max(CORNERS * starts, MOST_CORNERS)
    if 1 << d <= most:
        return box_corners(d)
    return generator.integers(0, 2, (CORNERS * starts, d)).astype(float)


def _starts(parts: Sequence[tuple[np.ndarray, np.ndarray]], count: int) -> np.ndarray:
    """At most `count` points (S, d): the worst samples, corners and random points, by points (N, d) and sizes (N,) of
    each. Half of them are samples and half of the others corners; one is the worst of both."""
    ranked = [
        points[np.argsort(-sizes, kind="stable")[: int((sizes > -math.inf).sum())]] for points, sizes in parts
    ]
    if count == 1:
        worst = [float(sizes.max()) for _, sizes in parts[:2]]
        return ranked[int(np.argmax(worst))][:1]
    some = ranked[0][: count // 2]
    some = np.vstack([some, ranked[1][: -(-(count - len(some)) // 2)]])
    return np.vstack([some, ranked[2][: count - len(some)]])


def check_searchable(campaign: Campaign, metric: str) -> LinearDamping | None:
    """Refuse, before any run, a metric whose worst case is not searched in a campaign.

    Returns: what computes `DAMPING`; None for a metric of the runs. A parameter may be called as the metric is.
    Raises InvalidInput: for a draw without intervals, an unknown metric, or `DAMPING` where no linear loop is known.
    """
    _box(campaign)
    columns = [column.name for column in campaign.columns if column.judged]
    if known_metric(metric, [*columns, DAMPING]) in columns:
        return None
    refuse_if(
        "reference" in campaign.sample(0).options,
        "The samples of this campaign have no common linear loop.",
        "expected samples with one goal, got a move of its own for each",
        OF_RUNS,
    )
    return campaign.linear_damping


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


@dataclass(eq=False)
class _Generations:
    """Plants of a campaign's box, judged many at once by one metric, all with the noise of one sample."""

    campaign: Campaign
    metric: str
    least: bool
    noise: int
    device: Device = "cpu"
    runs: int = 0  # so far

    def __post_init__(self) -> None:
        variables = _box(self.campaign).variables
        self.names = [variable.name for variable in variables]
        self.low, self.high = np.array([(v.low, v.high) for v in variables], dtype=float).T
        self.width = np.where(self.high > self.low, self.high - self.low, 1.0)
        self.linear = check_searchable(self.campaign, self.metric)

    def numbers(self, unit: np.ndarray) -> dict[str, np.ndarray]:
        """Numbers (N,) by name, of points (N, d) of the unit box."""
        return dict(zip(self.names, ((1.0 - unit) * self.low + unit * self.high).T.copy()))

    def rows(self, unit: np.ndarray) -> list[dict[str, float]]:
        """Numbers of each of these points."""
        columns = self.numbers(unit).values()
        return [dict(zip(self.names, row)) for row in zip(*(column.tolist() for column in columns))]

    def sizes(self, unit: np.ndarray) -> np.ndarray:
        """Badness (N,) of the plants at points (N, d) of the unit box."""
        return _sizes(*self.judged(self.numbers(unit)), self.least)

    def plants(self, rows: Sequence[Mapping[str, float]]) -> list[EvaluatedPlant]:
        """The plants with these numbers. Of linear loops each is computed alone, so that it has the same bits again."""
        columns = {name: np.array([row[name] for row in rows]) for name in self.names}
        apart = range(len(rows)) if self.linear else [slice(None)]
        judged = [self.judged({name: np.atleast_1d(c[k]) for name, c in columns.items()}) for k in apart]
        values, status = (np.concatenate(part) for part in zip(*judged))
        return [EvaluatedPlant(dict(r), float(v), str(s)) for r, v, s in zip(rows, values, status)]

    def judged(self, columns: Columns) -> tuple[np.ndarray, np.ndarray]:
        """Values and status (N,) of the plants with these numbers (N,), by name."""
        count, begin = len(columns[self.names[0]]), 0
        parts: list[tuple[np.ndarray, np.ndarray]] = []
        while begin < count:
            samples = self._samples({name: c[begin : begin + TOGETHER] for name, c in columns.items()})
            if self.linear:
                parts.append(self.linear(samples))
            else:
                noise = [self.noise] * len(samples)
                rows = rows_of(self.campaign, noise, samples, device=self.device, traced=0)
                parts.append((rows[self.metric].astype(float), rows["status"]))
            begin += len(samples)
        self.runs += count
        values, status = (np.concatenate(part) for part in zip(*parts))
        return values, status

    def _samples(self, columns: Columns) -> Sequence[Sample]:
        """The samples of these numbers, by name, or the first of them where each is built alone."""
        box = _box(self.campaign)
        if (together := box.columns(columns)) is not None:
            return together
        few = zip(*(columns[name][:CHUNK].tolist() for name in self.names))
        return [box.built(dict(zip(self.names, row)), self.noise) for row in few]

    def samples(self, rows: Mapping[str, ArrayLike] | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Numbers (N, d), values and status (N,) of the campaign's samples, of its rows or run now."""
        campaign, names = self.campaign, self.names if self.linear else [self.metric, "status", *self.names]
        if rows is None and self.linear:
            table = _box(campaign).numbers(range(campaign.samples), campaign.samples, campaign.seed)
        elif rows is None:
            parts = [run_batch(campaign, batch, self.device) for batch in range(campaign.batches)]
            table = {name: np.concatenate([part[name] for part in parts]) for name in names}
        else:
            table = _checked_rows(campaign, rows, names)
        points = np.column_stack([table[name] for name in self.names]).astype(float)
        if self.linear:
            return points, *self.judged(dict(zip(self.names, points.T.copy())))
        return points, table[self.metric].astype(float), table["status"]


def _checked_rows(
    campaign: Campaign, rows: Mapping[str, ArrayLike], names: Sequence[str]
) -> dict[str, np.ndarray]:
    columns = {name: np.asarray(rows[name]) for name in names if name in rows}
    sizes = {name: columns[name].shape if name in columns else "none" for name in names}
    refuse_if(
        any(size != (campaign.samples,) for size in sizes.values()),
        "The rows are not those of the campaign.",
        f"expected {campaign.samples} numbers of each, got {sizes}",
        "what run_campaign returned for the same loop, draw and samples",
    )
    return columns


def _sizes(values: np.ndarray, status: np.ndarray, least: bool) -> np.ndarray:
    """Badness (N,) of runs: infinite where one did not come to its end, −inf where it has no value."""
    sizes = np.where(np.isnan(values), -math.inf, -values if least else values)
    return np.where(status == COMPLETED, sizes, math.inf)


def searchable(journal: Journal) -> list[str]:
    """Metrics whose worst case can be searched."""
    return list(dict.fromkeys([*journal.metrics, DAMPING]))


def stored_worst(journal: Journal, metric: str) -> WorstCase:
    """The worst case of a metric from the campaign's folder.

    InvalidInput if nothing was searched, or the file is damaged.
    """
    case = _stored_case(journal, metric)
    if case is None:
        known = [name for name in searchable(journal) if (journal.folder / FOLDER / f"{name}.json").exists()]
        raise InvalidInput(
            f"The worst case of {metric!r} was not searched in this campaign.",
            f"expected one of {', '.join(known) or 'none'}",
            f"the campaign's command with --worst-case --metric {metric}",
        )
    return case


class Damaged(InvalidInput):
    """A file of results is there, and is not whole."""


def _stored_case(journal: Journal, metric: str) -> WorstCase | None:
    """The worst case of a metric; None where none was searched in this campaign. Raises Damaged, NotReadable."""
    path = FOLDER / f"{known_metric(metric, searchable(journal))}.json"
    try:
        case = journal.stored(path, WorstCase)
        return case if (case.settings["campaign"], case.metric) == (journal.digest, metric) else None
    except FileNotFoundError:
        return None
    except NotReadable:
        raise
    except UNREADABLE as error:
        raise Damaged(
            f"The worst case of {metric!r} cannot be read.",
            f"{journal.folder / path}: {str(error)[:200]}",
            "the campaign's command with --worst-case, which searches again",
        ) from error


def stored_worsts(journal: Journal) -> list[WorstCase]:
    """Every stored worst case, in the order of the metrics. Raises InvalidInput: one is damaged."""
    cases = (_stored_case(journal, metric) for metric in searchable(journal))
    return [case for case in cases if case is not None]
