"""What the rows of a campaign come to: which samples fail, by which requirement, and which is the worst."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from flexhinf.campaign.batches import COMPLETED, DIVERGED, NOT_RUN, Campaign, run_samples
from flexhinf.campaign.journal import Journal, MergedTable
from flexhinf.campaign.metrics import Requirement
from flexhinf.campaign.statistics import Interval, Sensitivity, sensitivity, success_interval
from flexhinf.loop import Trajectory

__all__ = ["CampaignJudgement", "Replayed", "replayed"]

#: Quantiles that are stated of every metric.
QUANTILES = (0.0, 0.05, 0.5, 0.95, 1.0)


@dataclass(frozen=True, eq=False)
class CampaignJudgement:
    """The rows of a campaign against requirements.

    Attributes
    ----------
    table : MergedTable
    requirements : tuple of Requirement
    """

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
        """Whether each sample (N) misses each requirement (R); one that did not come to its end misses all."""
        ended = self.column("status") == COMPLETED
        missed = [~one.met(self.column(one.metric)) for one in self.requirements]
        return np.column_stack([~ended, *(one | ~ended for one in missed)])[:, 1:]

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

    @cached_property
    def success(self) -> Interval:
        """The fraction of successes, as of independent samples."""
        return success_interval(self.count - self.failures, self.count)

    @property
    def main(self) -> str:
        """The metric by which samples are worse than others: the overshoot, or the first one; empty without any."""
        names = self.table.names("metric")
        return "overshoot_percent" if "overshoot_percent" in names else names[0] if names else ""

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

    def quantiles(self, metric: str) -> np.ndarray:
        """`QUANTILES` of a metric over the samples that have it, each one of its values; NaN where none has."""
        values = self.column(metric)
        values = values[~np.isnan(values)]
        return np.quantile(values, QUANTILES, method="higher") if len(values) else np.full(len(QUANTILES), np.nan)

    def sensitivity(self, metric: str) -> Sensitivity | None:
        """Which number matters for a metric; see `flexhinf.campaign.sensitivity`."""
        names = self.table.names("parameter")
        return sensitivity(names, np.column_stack([self.column(name) for name in names]), self.column(metric))

    def numbers(self, sample: int) -> dict[str, float]:
        """What is special about a sample, by name."""
        return {name: float(self.column(name)[sample]) for name in self.table.names("parameter")}

    @property
    def nominal(self) -> Mapping[str, float]:
        """Nominal values of the numbers, where they are known."""
        return self.table.journal.about.get("nominal", {})

    def reasons(self, sample: int) -> str:
        """Why a sample fails: its status, or the requirements that it misses."""
        status = str(self.column("status")[sample])
        if status == NOT_RUN:
            return f"{NOT_RUN}: {self.column('failure')[sample]}"
        if status == DIVERGED:
            return f"{DIVERGED} at {self.column('diverged_at_s')[sample]:g} s"
        missed = [one for one, bad in zip(self.requirements, self.violations[sample]) if bad]
        return ", ".join(f"{one.metric} {self.column(one.metric)[sample]:.4g}" for one in missed)


@dataclass(frozen=True, eq=False)
class Replayed:
    """A sample that was run again.

    Attributes
    ----------
    sample : int
    run : Trajectory
    recorded, again : mapping
        Its row in the journal, and that of the run; the first is empty for a sample that is not in it yet.
    command : str
    """

    sample: int
    run: Trajectory
    recorded: Mapping[str, object]
    again: Mapping[str, object]

    @property
    def same(self) -> bool:
        """Whether both are the same, bit by bit."""
        return not self.recorded or all(_same(self.recorded[k], v) for k, v in self.again.items())


def _same(a: object, b: object) -> bool:
    return a == b or (isinstance(a, float) and isinstance(b, float) and np.isnan(a) and np.isnan(b))


def replayed(campaign: Campaign, journal: Journal, sample: int) -> Replayed:
    """Run one sample of a campaign again, alone.

    Raises
    ------
    InvalidInput
        If there is no such sample, or it could not be run.
    """
    run = campaign.replay(sample)
    rows = run_samples(campaign, range(sample, sample + 1))
    again = {name: column[0] for name, column in rows.columns.items() if column.ndim == 1}
    plain = {name: value.item() if hasattr(value, "item") else value for name, value in again.items()}
    return Replayed(sample, run, journal.row(sample), plain)
