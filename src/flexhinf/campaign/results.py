"""The judgement of a campaign: failed samples, the worst one, success rate, and the numbers that matter for a metric.

Also the comparison of two campaigns on the same samples: differences of the pairs, and their statistics.

The statistics were fixed before any result. A metric has the median of the differences, with its exact interval by the
sign test, and the fraction of pairs in which either is better. Success and failure have the exact test of McNemar.
"""

# pyarrow has no types, and statistics of SciPy have none.
# pyright: reportMissingTypeStubs=false, reportUnknownArgumentType=false, reportUnknownLambdaType=false
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from flexhinf.campaign.batches import PART, TRACED, Campaign, Rows, TableColumn, rows_of
from flexhinf.campaign.journal import READERS, TABLE, Journal
from flexhinf.campaign.manifest import differing, listed
from flexhinf.campaign.merging import GrowingTable
from flexhinf.campaign.metrics import COMPLETED, MetricLimit
from flexhinf.campaign.parquet import numpy_column, read_columns
from flexhinf.campaign.surrogates import MOST_ROWS, Sensitivity, sensitivity
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.processors import in_threads, thread_count
from flexhinf.validation import value_text

if TYPE_CHECKING:
    import xarray as xr


@dataclass(frozen=True)
class Interval:
    """A fraction with its confidence interval."""

    successes: int
    count: int
    # low, high: By Clopper and Pearson: exact for independent samples
    low: float
    high: float
    confidence: float

    @property
    def rate(self) -> float:
        """The observed fraction."""
        return self.successes / self.count


def success_interval(successes: int, count: int, confidence: float = 0.95) -> Interval:
    """Exact confidence interval of a probability, from the successes among `count` independent samples.

    Clopper & Pearson, "The use of confidence or fiducial limits illustrated in the case of the binomial", 1934.
    Without failures in n samples, the 95 % interval is from (0.025)^(1/n), about 1 − 3.7/n, to 1.

    Raises InvalidInput: for a count below 1, or successes that are not among them.
    """
    from scipy.special import betaincinv

    refuse_if(
        not 0 <= successes <= count or count < 1,
        "There is no such fraction.",
        f"expected 0 <= successes <= count, got {successes} of {count}",
        "99 of 100",
    )
    half, failures = 0.5 * (1.0 - confidence), count - successes
    low = betaincinv(successes, failures + 1, half) if successes else 0.0
    high = betaincinv(successes + 1, failures, 1.0 - half) if failures else 1.0
    return Interval(successes, count, float(low), float(high), confidence)


#: Largest number of columns of a file in memory, enough for one figure or table.
CACHED = 6


class StoredColumns(Mapping[str, np.ndarray]):
    """Columns (N,) of a file by name, each read when it is used; the last `CACHED` ones stay in memory."""

    def __init__(self, path: Path) -> None:
        import pyarrow.parquet as pq

        def read(name: str) -> np.ndarray:
            return numpy_column(read_columns(path, [name]).column(name))

        self.names: tuple[str, ...] = tuple(pq.read_schema(path).names)
        self._read = lru_cache(CACHED)(read)

    def __getitem__(self, name: str) -> np.ndarray:
        """A column; do not write into it."""
        if name not in self.names:
            raise KeyError(name)
        return self._read(name)

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __len__(self) -> int:
        return len(self.names)


def labelled(
    rows: Mapping[str, np.ndarray],
    columns: Sequence[TableColumn],
    time: np.ndarray,
    settings: Mapping[str, str],
) -> xr.Dataset:
    """Rows as an xarray Dataset of dimension ``sample``, kept signals with ``kept`` runs and ``time`` (s) instead.

    Seeds are text: they have 64 bits, of which NetCDF 3 and a double would lose some.
    """
    import xarray as xr

    variables, coordinates = {}, {"sample": rows["sample"]}
    for column in columns:
        values = rows[column.name]
        values = values.astype(str) if values.dtype == np.uint64 else values
        attributes = {"units": column.unit, "kind": column.kind}
        if column.kind == "trace":
            variables[column.name] = (("kept", "time"), values, attributes)
            coordinates |= {"time": ("time", time, {"units": "s"}), "kept": np.arange(len(values))}
        elif column.name != "sample":
            # texts are not looked through for what else they could be
            variables[column.name] = xr.Variable(
                "sample", values, attributes, fastpath=values.dtype == object
            )
    return xr.Dataset(variables, coordinates, dict(settings))


class GatheredRows:
    """The rows of a campaign's batches as they come, in one array for each column."""

    def __init__(self, campaign: Campaign) -> None:
        self.campaign, self._columns, self._left = campaign, Rows(), campaign.samples
        #: Of all samples, see `labelled`; None until they are there
        self.dataset: xr.Dataset | None = None

    def of(self, results: Iterable[tuple[int, Rows]]) -> Iterator[tuple[int, Rows]]:
        """Batches with their rows, which are entered when they have been used."""
        for batch, rows in results:
            yield batch, rows
            self._enter(self.campaign.indices(batch), rows)

    def _enter(self, indices: range, rows: Rows) -> None:
        own, self._left = self.campaign, self._left - len(indices)
        for column in own.columns:
            values = rows[column.name].astype(str) if column.name == "seed" else rows[column.name]
            count = min(own.samples, TRACED if column.kind == "trace" else own.samples)
            if column.name not in self._columns:
                self._columns[column.name] = np.empty((count, *values.shape[1:]), values.dtype)
            some = self._columns[column.name][indices.start : indices.stop]
            some[:] = values[: len(some)]
        if not self._left:
            self.dataset = labelled(self._columns, own.columns, own.time, own.settings)


#: Quantiles of every metric in tables.
QUANTILES = (0.0, 0.05, 0.5, 0.95, 1.0)


@dataclass(frozen=True, eq=False)
class CampaignTable:
    """Rows of a campaign: its columns, their values by name, and the settings that the rows depend on."""

    described: Sequence[TableColumn]
    columns: Mapping[str, np.ndarray]  # (N,); NaN where a row has no number
    settings: Mapping[str, str]

    def names(self, kind: str) -> tuple[str, ...]:
        """Names of the columns of a kind."""
        return tuple(column.name for column in self.described if column.kind == kind)

    def unit(self, name: str) -> str:
        """Unit of a column."""
        return next(column.unit for column in self.described if column.name == name)

    def numbers(self, sample: int) -> dict[str, float]:
        """Values of the varied numbers of a sample, by name."""
        return {name: float(self.columns[name][sample]) for name in self.names("parameter")}


@dataclass(frozen=True, eq=False)
class MergedTable(CampaignTable):
    """All rows of a journal's campaign, each column read from the table when it is asked for; its shards by batch."""

    journal: Journal
    shards: Mapping[int, Path]

    def trace(self, name: str) -> np.ndarray:
        """A kept signal (R, T) of the runs that it is kept of; NaN after one diverged."""
        count = min(self.journal.batches, -(-TRACED // self.journal.size(0)))
        tables = in_threads(
            lambda batch: self.journal.rows(batch, self.shards[batch], [name]), range(count), READERS
        )
        return np.concatenate([numpy_column(table.column(name)) for table in tables])[:TRACED]

    def dataset(self) -> xr.Dataset:
        """The rows as an xarray Dataset; see `run_campaign`."""
        names = [column.name for column in self.described if column.kind != "trace"]
        parts = min(READERS, thread_count())

        def read(k: int) -> dict[str, np.ndarray]:
            table = read_columns(self.journal.folder / TABLE, names[k::parts])
            return {name: numpy_column(table.column(name)) for name in names[k::parts]}

        rows = {
            name: values for some in in_threads(read, range(parts), READERS) for name, values in some.items()
        }
        rows |= {name: self.trace(name) for name in self.names("trace")}
        return labelled(rows, self.described, self.journal.time, self.settings)


def merged(journal: Journal, good: Mapping[int, Path], table: GrowingTable | None = None) -> MergedTable:
    """Merge the table of a journal of which every batch's shard is there, and read it; raises as
    `GrowingTable.finished`.

    `table`: One that was begun.
    """
    with closing(table or GrowingTable(journal, good)) as growing:
        columns = StoredColumns(growing.finished(good))
    return MergedTable(journal.columns, columns, journal.settings, journal, dict(good))


def main_metric(names: Sequence[str]) -> str:
    """The main metric: the overshoot, else the first one; empty without any."""
    return "overshoot_percent" if "overshoot_percent" in names else names[0] if names else ""


def violations(values: Mapping[str, np.ndarray], requirements: Sequence[MetricLimit]) -> np.ndarray:
    """Whether sample (N) fails requirement (R), by status and metrics; a run that did not complete fails all."""
    lost = values["status"] != COMPLETED
    return np.column_stack([lost, *(lost | ~rule.met(values[rule.metric]) for rule in requirements)])[:, 1:]


class CampaignJudgement:
    """The rows of a campaign, judged by requirements.

    `count`, `failures`: numbers of samples, and of failed ones. `rate`: fraction of successes. `success`: the same with
    its interval; None for samples that are not independent, as of a Sobol sequence or a Latin hypercube, for which one
    campaign gives no interval. `failed`: (F,) indices of the samples that fail: first
    those that did not come to their end, then by the main metric. `violations`: (N, R), see `violations`. `main`: The
    metric that ranks the samples, "" without any. `method`: One of `METHODS`; a draw that states none draws each sample
    independently. `nominal`: Nominal values of the numbers, where they are known.
    """

    def __init__(self, table: MergedTable, requirements: tuple[MetricLimit, ...]) -> None:
        self.table, self.requirements = table, requirements
        self.nominal: Mapping[str, float] = table.journal.about.get("nominal", {})
        self.method, self.main = table.settings.get("method", "random"), main_metric(table.names("metric"))
        self.count = len(table.columns["sample"])
        self.violations = violations(table.columns, requirements)
        ended = table.columns["status"] == COMPLETED
        failed = np.flatnonzero(~ended | self.violations.any(axis=1))
        size = np.nan_to_num(
            table.columns[self.main][failed] if self.main else np.zeros(len(failed)), posinf=1e300
        )
        self.failed = failed[np.lexsort((failed, -size, ended[failed]))]
        self.failures = len(failed)
        self.rate = 1.0 - self.failures / self.count
        self.independent = self.method == "random"  # whether intervals and tests hold for the samples
        succeeded = self.count - self.failures
        self.success = success_interval(succeeded, self.count) if self.independent else None

    def column(self, name: str) -> np.ndarray:
        """A column of the table (N,)."""
        return self.table.columns[name]

    def of_status(self, status: str) -> int:
        """Number of samples with this status."""
        return int((self.column("status") == status).sum())

    def worst(self, metric: str) -> int | None:
        """The completed sample with the largest value of a metric (the smallest where a requirement is a least value).

        Infinite values are the worst; None where no sample has a value.
        """
        values = self.column(metric)
        known = np.flatnonzero(~np.isnan(values))
        smaller_is_worse = any(rule.metric == metric and not rule.at_most for rule in self.requirements)
        worst = np.argmin if smaller_is_worse else np.argmax
        return int(known[worst(values[known])]) if len(known) else None

    @property
    def worst_of_all(self) -> int | None:
        """The worst sample of the main metric; None without any."""
        return self.worst(self.main) if self.main else None

    def quantiles(self, metric: str) -> np.ndarray:
        """`QUANTILES` of a metric over the samples that have it; each is one of the values. NaN if no sample has it."""
        values = self.column(metric)
        values = values[~np.isnan(values)]
        missing = np.full(len(QUANTILES), np.nan)
        return np.quantile(values, QUANTILES, method="higher") if len(values) else missing

    def sensitivity(self, metric: str) -> Sensitivity | None:
        """Sobol indices of a metric; see `flexhinf.campaign.sensitivity`."""
        names, values = self.table.names("parameter"), self.column(metric)
        rows = np.flatnonzero(np.isfinite(values))[:MOST_ROWS]
        numbers = np.column_stack([np.empty((len(rows), 0)), *(self.column(name)[rows] for name in names)])
        return sensitivity(names, numbers, values[rows])

    def missed(self, sample: int) -> list[MetricLimit]:
        """The requirements that a completed sample misses."""
        return [rule for rule, bad in zip(self.requirements, self.violations[sample]) if bad]


class Replayed:
    """A sample that is run again, alone; InvalidInput if it does not exist or could not be run.

    `recorded`, `again`: its row in the journal (empty where it is not in it yet), and that of the `run`. `same`:
    whether both are the same, bit by bit.
    """

    def __init__(self, campaign: Campaign, journal: Journal, sample: int) -> None:
        self.sample, self.run = sample, campaign.replay(sample)
        rows = rows_of(campaign, [sample])
        self.again = {name: column.tolist()[0] for name, column in rows.items() if column.ndim == 1}
        self.recorded = journal.row(sample)
        pairs = [(self.recorded.get(name), value) for name, value in self.again.items()]
        # NaN is not itself.
        self.same = not self.recorded or all(a == b or (a != a and b != b) for a, b in pairs)


#: Confidence level of every single interval.
CONFIDENCE = 0.95

#: Values that agree to this fraction count as equal; otherwise rounding would be a significant difference in every
#: pair. UKF and EKF of a linear arm differ by 2e-6 of the overshoot; differences of a robot are far larger.
SAME = 1e-4

#: Settings in which two campaigns on the same samples may differ: the law's and administrative ones. A law without an
#: integral has no reference; its goal is its operating point.
_FREE = {
    "version",
    "batch",
    "metrics",
    "signals",
    "controller",
    "sub-steps",
    "short run",
    "reference",
    "multi_turn",
}


class PairedMetric:
    """One metric of two campaigns, sample by sample.

    A run that does not complete is worse than every run that does. A pair of two such runs, or with a run without the
    metric, is left out. Smaller values are better, unless a requirement has a lower limit.

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

        It inverts the sign test (`scipy.stats.quantile_test`), so it is valid for every distribution, also with
        infinite differences. NaN for fewer than six pairs.
        """
        from scipy.stats import quantile_test

        if not len(self.pairs):
            return math.nan, math.nan
        interval = quantile_test(self.differences, q=0, p=0.5).confidence_interval(CONFIDENCE)
        return float(interval.low), float(interval.high)


def _median(values: np.ndarray) -> float:
    return float(np.quantile(values, 0.5, method="inverted_cdf")) if len(values) else math.nan


@dataclass
class McNemar:
    """Success and failure of pairs, and the exact test that both fail equally often.

    McNemar, "Note on the sampling error of the difference between correlated proportions", 1947, with the binomial
    distribution of the pairs in which only one fails. The attributes are numbers of pairs by which of them fails;
    `count`: of all, `failures`: of those that a, and that b, fails.
    """

    both_fail: int
    only_a: int
    only_b: int
    neither: int

    def __post_init__(self) -> None:
        self.count = self.both_fail + self.only_a + self.only_b + self.neither
        self.failures = self.both_fail + self.only_a, self.both_fail + self.only_b

    @property
    def p_value(self) -> float:
        """Probability of counts at least as unequal as these if both fail equally often; 1 if no pair differs."""
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
        self.requirements = tuple(MetricLimit.of(text, known) for text in requirements)

    def metric(self, name: str) -> PairedMetric:
        """One metric of both campaigns; InvalidInput unless both have it."""
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

    `a`, `b`: results of `run_campaign` with the same draw, samples, seed and circumstances, but different controllers.
    `requirements`: limits that a successful run keeps, such as ``overshoot_percent<=5``; it must also complete.
    Returns: differences b − a of each metric, success and failure.
    Raises InvalidInput: if the samples differ; the message names the difference.
    """
    own, other = _table(a), _table(b)
    bound = [
        name
        for name in [*own.settings, *other.settings]
        if name not in _FREE and not name.startswith("design ")
    ]
    differences = [
        f"{name}: {first} ↔ {second}"
        for name, first, second in differing(own.settings, other.settings, bound)
    ]
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
        listed(differences),
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
        TableColumn("sample", "own"),
        *(
            TableColumn(str(name), array.attrs.get("kind", ""), array.attrs.get("units", ""))
            for name, array in source.data_vars.items()
        ),
    ]
    return CampaignTable(
        described,
        {
            column.name: values.astype(np.uint64) if column.name == "seed" else values
            for column in described
            for values in (source[column.name].values,)
        },
        {str(k): str(v) for k, v in source.attrs.items()},
    )
