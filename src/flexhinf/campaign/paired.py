"""Two campaigns on the same samples: differences pair by pair, and their inference for all samples.

The statistics were fixed before any result: of each metric the median of the differences with its exact interval by the
sign test, the fraction of pairs in which either is better, and of success and failure the exact test of McNemar.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from flexhinf.campaign.batches import PART, Column
from flexhinf.campaign.journal import differing, listed
from flexhinf.campaign.metrics import COMPLETED, Requirement
from flexhinf.campaign.results import (
    CampaignTable,
    Interval,
    MergedTable,
    main_metric,
    success_interval,
    violations,
)
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.validation import value_text

if TYPE_CHECKING:
    import xarray as xr

#: Of every interval, each by itself.
CONFIDENCE = 0.95

#: Values that agree to this fraction are equal: a difference of rounding would be significant in every pair, without a
#: meaning. UKF and EKF of a linear arm are 2e-6 of the overshoot apart; a robot's differences are far larger.
SAME = 1e-4

#: Settings in which two campaigns on the same samples may differ: those of the law, and of the bookkeeping. A law
#: without an integral takes no reference, its goal is its operating point.
_FREE = {
    "version", "batch", "metrics", "signals", "controller", "sub-steps", "short run", "reference", "multi_turn",
}  # fmt: skip
_FREE_PREFIX = "design "

#: Differences that a refusal lists.
_LISTED = 6


class PairedMetric:
    """One metric of two campaigns, sample by sample.

    A run that does not come to its end is worse than every run that does. A pair of two such runs, or of one that
    has no such number, is left out. Smaller values are better, unless a requirement states a least value.

    `a`, `b`: (N,) values; infinite, with the sign of what is worse, where only this run does not come to its end; NaN
    for none. `pairs`: (P,) indices of the samples that are compared. `differences`: (P,) b − a; infinite where one has
    no finite value, 0 where they agree to `SAME`. `medians`, `median`: Lower medians of a and of b, and of the
    differences, each one of the values; NaN without pairs. `better`: Fractions of the pairs in which a is better and
    in which b is, with their intervals; the rest is equal. `extremes`: The samples in which a, and in which b, is
    better by most; None where it never is.
    """

    def __init__(
        self, name: str, unit: str, a: np.ndarray, b: np.ndarray, largest_is_best: bool = False
    ) -> None:
        self.name, self.unit, self.a, self.b, self.largest_is_best = name, unit, a, b, largest_is_best
        self.pairs = np.flatnonzero(~(np.isnan(a) | np.isnan(b)))
        a, b, count = a[self.pairs], b[self.pairs], len(self.pairs)
        finite = np.isfinite(a) & np.isfinite(b)
        size = np.where(finite, np.maximum(np.abs(a), np.abs(b)), 0.0)
        apart = np.abs(np.subtract(b, a, where=finite, out=np.zeros(count)))
        equal = np.where(finite, apart <= SAME * size, a == b)
        self.differences = np.subtract(b, a, where=~equal, out=np.zeros(count))
        self.medians, self.median = (_median(a), _median(b)), _median(self.differences)
        worse = -self.differences if largest_is_best else self.differences
        none = Interval(0, 0, 0.0, 1.0, CONFIDENCE)
        wins = [np.flatnonzero(gain > 0.0) for gain in (worse, -worse)]
        self.better = tuple(success_interval(len(won), count, CONFIDENCE) if count else none for won in wins)
        self.extremes = tuple(
            int(self.pairs[np.argmax(gain)]) if len(won) else None for gain, won in zip((worse, -worse), wins)
        )

    @cached_property
    def interval(self) -> tuple[float, float]:
        """Confidence interval of the median difference, for independent samples.

        By order statistics, that is, by inverting the sign test (`scipy.stats.quantile_test`): it holds for every
        distribution, symmetric or not, and with infinite differences. NaN where the pairs are too few (six at least).
        """
        from scipy.stats import quantile_test

        if not len(self.pairs):
            return math.nan, math.nan
        interval = quantile_test(self.differences, q=0, p=0.5).confidence_interval(CONFIDENCE)
        return float(interval.low), float(interval.high)


def _median(values: np.ndarray) -> float:
    return float(np.quantile(values, 0.5, method="inverted_cdf")) if len(values) else math.nan


@dataclass(frozen=True)
class McNemar:
    """Success and failure of pairs, and the exact test that both fail equally often.

    McNemar, "Note on the sampling error of the difference between correlated proportions", 1947, with the binomial
    distribution of the pairs in which only one fails. The attributes are numbers of pairs by which of them fails.
    """

    both_fail: int
    only_a: int
    only_b: int
    neither: int

    @property
    def count(self) -> int:
        """Number of pairs."""
        return self.both_fail + self.only_a + self.only_b + self.neither

    @property
    def failures(self) -> tuple[int, int]:
        """Number of failures of a, and of b."""
        return self.both_fail + self.only_a, self.both_fail + self.only_b

    @property
    def p_value(self) -> float:
        """Probability of counts at least as unequal as these if both fail equally often; 1 where none is unequal."""
        from scipy.stats import binomtest

        unequal = self.only_a + self.only_b
        return float(binomtest(self.only_a, unequal, 0.5).pvalue) if unequal else 1.0


class PairedCampaigns:
    """Two campaigns on the same samples, made by `compare`; a run that meets the requirements is a success.

    `count`: Number of samples. `metrics`, `parts`: Names of the metrics that both campaigns have, of the whole runs and
    of parts, such as single joints. `main`: The metric that a verdict names, "" without any.
    """

    def __init__(self, a: CampaignTable, b: CampaignTable, requirements: Sequence[str] = ()) -> None:
        self.a, self.b, self.count = a, b, len(a.columns["sample"])
        self.metrics, self.parts = (
            tuple(name for name in a.names(kind) if name in b.names(kind)) for kind in ("metric", PART)
        )
        self.main, known = main_metric(self.metrics), (*self.metrics, *self.parts)
        self.requirements = tuple(Requirement.of(text, known) for text in requirements)

    def metric(self, name: str) -> PairedMetric:
        """One metric of both campaigns; InvalidInput if not both have it."""
        refuse_if(
            name not in (*self.metrics, *self.parts),
            f"Not both campaigns have a metric {name!r}.",
            f"expected one of {', '.join(self.metrics) or 'none'}",
            "campaigns with the same metrics",
        )
        best = any(rule.metric == name and not rule.at_most for rule in self.requirements)
        lost = [side.columns["status"] != COMPLETED for side in (self.a, self.b)]
        a, b = (
            np.where(rows, -math.inf if best else math.inf, side.columns[name])
            for rows, side in zip(lost, (self.a, self.b))
        )
        return PairedMetric(name, self.a.unit(name), np.where(lost[0] & lost[1], math.nan, a), b, best)

    @cached_property
    def success(self) -> McNemar:
        """Success and failure of the pairs; samples that no campaign could run are failures of both."""
        a, b = (
            (side.columns["status"] != COMPLETED) | violations(side.columns, self.requirements).any(axis=1)
            for side in (self.a, self.b)
        )
        return McNemar(*(int(pairs.sum()) for pairs in (a & b, a & ~b, ~a & b, ~a & ~b)))


def compare(
    a: xr.Dataset | MergedTable, b: xr.Dataset | MergedTable, requirements: Sequence[str] = ()
) -> PairedCampaigns:
    """Compare two campaigns on the same samples: any plant, any two laws.

    `a`, `b`: of `run_campaign` with the same draw, samples, seed and circumstances, and another controller.
    `requirements`: what a run must keep to count as a success, ``overshoot_percent<=5``, besides coming to its end.
    Returns: differences b − a of each metric, success and failure.
    Raises InvalidInput: if the samples are not the same: the message says what differs.
    """
    own, other = _table(a), _table(b)
    names = [*own.settings, *other.settings]
    bound = [name for name in names if name not in _FREE and not name.startswith(_FREE_PREFIX)]
    pairs = differing(own.settings, other.settings, bound)
    differences = [f"{name}: {first} ↔ {second}" for name, first, second in pairs]
    numbers = own.names("parameter")
    if numbers != other.names("parameter"):
        differences.append(f"numbers: {list(numbers)} ↔ {list(other.names('parameter'))}")
    elif not differences:
        differences = [
            f"{k}: not the same values"
            for k in ("sample", "seed", *numbers)
            if not np.array_equal(own.columns[k], other.columns[k], equal_nan=k not in ("sample", "seed"))
        ]
    refuse_if(
        differences,
        "The campaigns are not on the same samples; their differences would not be those of the controllers.",
        listed(differences, _LISTED),
        "the same draw, samples, seed, plant, noise and duration for both, and another controller",
    )
    return PairedCampaigns(own, other, requirements)


def _table(source: xr.Dataset | MergedTable) -> CampaignTable:
    if isinstance(source, MergedTable):
        return source
    if not hasattr(source, "data_vars") or "status" not in source or "seed" not in source:
        raise InvalidInput(
            "Only campaigns are compared.",
            f"expected an xarray Dataset of `run_campaign`, got {value_text(source)}",
            "flexhinf.campaign.compare(fh.run_campaign(…), fh.run_campaign(…))",
        )
    described = [
        Column("sample", "own"),
        *(
            Column(str(name), array.attrs.get("kind", ""), array.attrs.get("units", ""))
            for name, array in source.data_vars.items()
        ),
    ]
    columns = {column.name: source[column.name].values for column in described}
    return CampaignTable(described, columns, {str(k): str(v) for k, v in source.attrs.items()})
