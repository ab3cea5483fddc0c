"""The rows of a batch: a pure function of the campaign and the number of the batch."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from flexhinf.campaign.batches import ALONE, TRACE, TRACED, Campaign, checked_integer
from flexhinf.campaign.draws import Sample, sample_seeds
from flexhinf.campaign.outcomes import COMPLETED, DIVERGED, NOT_RUN, UNSTABLE, is_unstable
from flexhinf.errors import FlexhinfError, InvalidInput
from flexhinf.loop import EnsembleResult, Trajectory


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of some samples.

    Attributes
    ----------
    columns : mapping of str to ndarray
        By name, (N,); a kept signal (N, T) of 32 bits, NaN where it is not kept and after a run diverged.
    """

    columns: Mapping[str, np.ndarray]

    def __len__(self) -> int:
        return len(self.columns["sample"])


def run_batch(campaign: Campaign, batch: int) -> Rows:
    """The rows of one batch: the same on every machine of one kind, whatever was run before or beside it.

    Raises
    ------
    InvalidInput
        If there is no such batch, or a sample's run or metric is refused; the message names the sample.
    """
    checked_integer("batch", batch, 0, campaign.batches - 1, "0")
    return run_samples(campaign, campaign.indices(batch))


def run_samples(campaign: Campaign, indices: range) -> Rows:
    """The rows of some samples, as `run_batch`."""
    return rows_of(campaign, indices, campaign.draw.samples(indices, campaign.samples, campaign.seed))


def rows_of(campaign: Campaign, indices: Sequence[int], drawn: Sequence[Sample]) -> Rows:
    """The rows of plants in circumstances that need not be drawn, each with the noise of a sample.

    Parameters
    ----------
    indices : sequence of int
        Sample of the campaign whose noise each run has; one may stand there several times.

    Raises
    ------
    InvalidInput
        If a run or a metric is refused.
    """
    table = _Table(campaign, indices)
    for place, (index, one) in enumerate(zip(indices, drawn)):
        table.describe(place, index, one)
    ways = campaign.ways(drawn)
    alone, place = ways.pop(ALONE, []), 0
    try:
        for some in ways.values():
            assert campaign.ensemble is not None
            given = campaign.plants([indices[k] for k in some], [drawn[k] for k in some])
            table.fill(np.array(some), campaign.ensemble.run(**given))
        runs = campaign.trajectories([indices[k] for k in alone], [drawn[k] for k in alone])
        for place in alone:
            table.judge(place, next(runs))
    except FlexhinfError as error:
        raise InvalidInput(
            f"Sample {indices[place]} of the campaign, or one up to {indices[-1]}, is refused.",
            " ".join(str(error).split()),
            "a draw and metrics that fit every sample",
        ) from error
    return Rows(table.columns)


class _Table:
    """The columns of a batch while they are filled."""

    def __init__(self, campaign: Campaign, indices: Sequence[int]) -> None:
        self.campaign, count = campaign, len(indices)
        self.columns: dict[str, np.ndarray] = {}
        for column in campaign.columns:
            trace = column.kind == "trace"
            shape = (count, len(campaign.instants)) if trace else count
            self.columns[column.name] = np.full(shape, math.nan, np.float32 if trace else float)
        self.columns["sample"] = np.array(indices, dtype=np.int64)
        self.columns["seed"] = sample_seeds(campaign.seed, indices)
        self.columns |= {name: np.full(count, "", dtype=object) for name in ("status", "failure")}

    def describe(self, place: int, index: int, drawn: Sample) -> None:
        """Its numbers, and why it cannot be run."""
        row, names = drawn.row(), self.campaign.named("parameter")
        if set(row) != set(names):
            raise InvalidInput(
                f"Sample {index} has other numbers than the first one.",
                f"expected {list(names)}, got {list(row)}",
                "a draw that names the same parameters every time",
            )
        for name, value in row.items():
            self.columns[name][place] = value
        if drawn.failure:
            self.columns["status"][place], self.columns["failure"][place] = NOT_RUN, drawn.failure

    def fill(self, places: np.ndarray, found: EnsembleResult) -> None:
        """Status, metrics and kept signals of runs in lanes."""
        ended = np.where(found.common["unstable"] > 0.5, UNSTABLE, COMPLETED)
        status = np.where(found.completed, ended, DIVERGED)
        self.columns["status"][places], self.columns["diverged_at_s"][places] = status, found.diverged_at
        for metrics in self.campaign.metrics:
            assert metrics.reduced is not None
            values = metrics.reduced(found)
            for name in metrics.units:
                self.columns[name][places] = np.where(found.completed, values[name], math.nan)
        kept = self.columns["sample"][places] < TRACED
        with np.errstate(over="ignore"):  # of a run that diverges: 32 bits call it infinite
            for k, name in enumerate(self.campaign.signals or ()):
                self.columns[TRACE + name][places[kept]] = found.kept[kept, :, k]

    def judge(self, place: int, run: Trajectory) -> None:
        """Status and metrics, and the signals that are kept."""
        if run.diverged_at is None:
            self.columns["status"][place] = UNSTABLE if is_unstable(run) else COMPLETED
            for metrics in self.campaign.metrics:
                for name, value in metrics(run).items():
                    self.columns[name][place] = value
        else:
            self.columns["status"][place], self.columns["diverged_at_s"][place] = DIVERGED, run.diverged_at
        if self.columns["sample"][place] < TRACED:
            at = self.campaign.instants[: np.searchsorted(self.campaign.instants, len(run.time))]
            with np.errstate(over="ignore"):  # of a run that diverges: 32 bits call it infinite
                for name in self.campaign.signals or ():
                    self.columns[TRACE + name][place, : len(at)] = run.tracked(name)[at]
