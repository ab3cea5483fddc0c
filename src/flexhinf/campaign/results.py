"""The judgement of a campaign: which samples fail, by which requirement, and which is the worst."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from flexhinf.campaign.batches import TRACED, Campaign, Column, run_samples
from flexhinf.campaign.journal import (
    Journal,
    StoredColumns,
    labelled,
    numpy_column,
    plain_number,
    read_columns,
)
from flexhinf.campaign.metrics import COMPLETED, Requirement
from flexhinf.campaign.statistics import MOST_ROWS, Interval, Sensitivity, sensitivity, success_interval
from flexhinf.loop import Trajectory

if TYPE_CHECKING:
    import xarray as xr

#: Quantiles that are stated of every metric.
QUANTILES = (0.0, 0.05, 0.5, 0.95, 1.0)


@dataclass(frozen=True, eq=False)
class CampaignTable:
    """Rows of a campaign: what its columns are, their values by name, and everything that the rows depend on."""

    described: Sequence[Column]
    columns: Mapping[str, np.ndarray]  # (N,); NaN where a row has no number
    settings: Mapping[str, str]

    def names(self, kind: str) -> tuple[str, ...]:
        """Names of the columns of a kind."""
        return tuple(column.name for column in self.described if column.kind == kind)

    def unit(self, name: str) -> str:
        """Of a column."""
        return next(column.unit for column in self.described if column.name == name)

    def numbers(self, sample: int) -> dict[str, float]:
        """Drawn numbers of a sample by name."""
        return {name: float(self.columns[name][sample]) for name in self.names("parameter")}


@dataclass(frozen=True, eq=False)
class MergedTable(CampaignTable):
    """All rows of a journal's campaign, each column read from the table when it is asked for; its shards by batch."""

    journal: Journal
    shards: Mapping[int, Path]

    def trace(self, name: str) -> np.ndarray:
        """A kept signal (R, T) of the runs that it is kept of; NaN after one diverged."""
        count = min(self.journal.batches, -(-TRACED // self.journal.size(0)))
        columns = (read_columns(self.shards[batch], [name]).column(name) for batch in range(count))
        return np.concatenate([numpy_column(column) for column in columns])[:TRACED]

    def dataset(self) -> xr.Dataset:
        """The rows as an xarray Dataset; see `run_campaign`."""
        rows = {**self.columns, **{name: self.trace(name) for name in self.names("trace")}}
        return labelled(rows, self.described, self.journal.time, self.settings)


def merged(journal: Journal, good: Mapping[int, Path]) -> MergedTable:
    """Merge the table of a journal of which every batch's shard is there, and read it; raises as `Journal.merge`."""
    columns = StoredColumns(journal.merge(good))
    return MergedTable(journal.columns, columns, journal.settings, journal, dict(good))


def main_metric(names: Sequence[str]) -> str:
    """The overshoot, or the first one; empty without any."""
    return "overshoot_percent" if "overshoot_percent" in names else names[0] if names else ""


def violations(values: Mapping[str, np.ndarray], requirements: Sequence[Requirement]) -> np.ndarray:
    """Whether a sample (N) misses a requirement (R), by status and metrics; one that did not end well misses all."""
    lost = values["status"] != COMPLETED
    return np.column_stack([lost, *(lost | ~one.met(values[one.metric]) for one in requirements)])[:, 1:]


@dataclass(frozen=True, eq=False)
class CampaignJudgement:
    """The rows of a campaign against requirements."""

    table: MergedTable
    requirements: tuple[Requirement, ...]

    @property
    def count(self) -> int:
        """Samples."""
        return len(self.column("sample"))

    def column(self, name: str) -> np.ndarray:
        """A column of the table (N,)."""
        return self.table.columns[name]

    def of_status(self, status: str) -> int:
        """Samples of a status."""
        return int((self.column("status") == status).sum())

    @cached_property
    def violations(self) -> np.ndarray:
        """See `violations`."""
        return violations(self.table.columns, self.requirements)

    @cached_property
    def failed(self) -> np.ndarray:
        """Numbers of the samples that fail, those that did not come to their end first, then by the main metric."""
        ended = self.column("status") == COMPLETED
        failed = np.flatnonzero(~ended | self.violations.any(axis=1))
        size = self.column(self.main) if self.main else np.zeros(self.count)
        return failed[np.lexsort((failed, -np.nan_to_num(size[failed], posinf=1e300), ended[failed]))]

    @property
    def failures(self) -> int:
        """How many fail."""
        return len(self.failed)

    @property
    def method(self) -> str:
        """How the samples are spread, see `METHODS`; a draw that states no method draws each by itself."""
        return self.table.journal.settings.get("method", "random")

    @property
    def rate(self) -> float:
        """The fraction of successes."""
        return 1.0 - self.failures / self.count

    @cached_property
    def success(self) -> Interval | None:
        """The fraction of successes with its interval; None for samples that are not independent, as those of a Sobol
        sequence and of a Latin hypercube: of one campaign of these no interval is known."""
        independent = self.method == "random"
        return success_interval(self.count - self.failures, self.count) if independent else None

    @property
    def main(self) -> str:
        """The metric by which samples are worse than others: the overshoot, or the first one; empty without any."""
        return main_metric(self.table.names("metric"))

    def worst(self, metric: str) -> int | None:
        """The completed sample with the largest value of a metric (the smallest where a requirement is a least value).

        Infinite values are the worst; None where no sample has a value.
        """
        values = self.column(metric)
        known = np.flatnonzero(~np.isnan(values))
        least = any(one.metric == metric and not one.at_most for one in self.requirements)
        if not len(known):
            return None
        return int(known[np.argmin(values[known]) if least else np.argmax(values[known])])

    @property
    def worst_of_all(self) -> int | None:
        """The worst sample of the main metric; None without any."""
        return self.worst(self.main) if self.main else None

    def quantiles(self, metric: str) -> np.ndarray:
        """`QUANTILES` of a metric over the samples that have it, each one of its values; NaN where none has."""
        values = self.column(metric)
        values = values[~np.isnan(values)]
        if not len(values):
            return np.full(len(QUANTILES), np.nan)
        return np.quantile(values, QUANTILES, method="higher")

    def sensitivity(self, metric: str) -> Sensitivity | None:
        """Which number matters for a metric; see `flexhinf.campaign.sensitivity`."""
        names, values = self.table.names("parameter"), self.column(metric)
        rows = np.flatnonzero(np.isfinite(values))[:MOST_ROWS]
        numbers = np.empty((len(rows), len(names)))
        for k, name in enumerate(names):
            numbers[:, k] = self.column(name)[rows]
        return sensitivity(names, numbers, values[rows])

    def numbers(self, sample: int) -> dict[str, float]:
        """Drawn numbers of a sample by name."""
        return self.table.numbers(sample)

    @property
    def nominal(self) -> Mapping[str, float]:
        """Nominal values of the numbers, where they are known."""
        return self.table.journal.about.get("nominal", {})

    def missed(self, sample: int) -> list[Requirement]:
        """The requirements that a completed sample misses."""
        return [one for one, bad in zip(self.requirements, self.violations[sample]) if bad]


@dataclass(frozen=True, eq=False)
class Replayed:
    """A sample that was run again: its row in the journal (empty where it is not in it yet), and that of the run."""

    sample: int
    run: Trajectory
    recorded: Mapping[str, object]
    again: Mapping[str, object]

    @property
    def same(self) -> bool:
        """Whether both are the same, bit by bit."""
        pairs = [(self.recorded.get(name), value) for name, value in self.again.items()]
        missing = [
            isinstance(a, float) and isinstance(b, float) and np.isnan(a) and np.isnan(b) for a, b in pairs
        ]
        return not self.recorded or all(a == b or nan for (a, b), nan in zip(pairs, missing))


def replayed(campaign: Campaign, journal: Journal, sample: int) -> Replayed:
    """Run one sample of a campaign again, alone."""
    run = campaign.replay(sample)
    rows = run_samples(campaign, range(sample, sample + 1))
    again = {name: plain_number(column[0]) for name, column in rows.columns.items() if column.ndim == 1}
    return Replayed(sample, run, journal.row(sample), again)
