"""The report of two designs on the same samples: success and failure, paired differences, extremes."""

# Not checked strictly: parts of Matplotlib have no types.
# pyright: reportUnknownMemberType=false

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from flexhinf.campaign import (
    PairedMetric,
)
from flexhinf.designs.campaign_folder import FOLDERS, DesignPair, verdict_of
from flexhinf.designs.verdict import UNKNOWN
from flexhinf.numerals import number, short_numbers
from flexhinf.pages.campaign_text import (
    SPREAD,
    campaign_design,
    display_scale_of,
    histogram,
    in_degrees,
    interval_text,
    limit_text,
    metric_text,
    percent_text,
    replay_command,
    sample_changes,
    setting_rows,
    value_text,
)
from flexhinf.pages.drawing import DASHED, few_ticks, figure_block, framed, small_panels
from flexhinf.pages.page import design_statuses, write_page
from flexhinf.report import (
    INK,
    SERIES,
    Column,
    Fact,
    Listing,
    Note,
    Page,
    PageBlock,
    Paragraph,
    Section,
    Table,
    house_style,
    label,
)

#: Points of a panel, at most.
POINTS = 2000


def write_pair(result: DesignPair) -> Path:
    """Write index.html of a comparison; returns its path."""
    settings, counts = result.judged[0].table.journal.settings, result.paired.success
    metrics = map(result.paired.metric, result.paired.metrics)
    varied = [
        _in_page_units(result, m)
        for m in metrics
        if np.any(np.isfinite(m.differences) & (m.differences != 0.0))
    ]
    with house_style():  # once for all figures
        blocks = [*_success(result), *_differences(result, varied[:6]), *_extremes(result, varied)]
    failures = zip("AB", counts.failures, (counts.only_a, counts.only_b))
    page = Page(
        f"Two designs on the same robots “{result.a.request.robot.name}”",
        f"{result.paired.count} robots, each with its own measurement noise, run twice for "
        f"{short_numbers(settings['duration'])} s: with the controller A of {result.names[0]} and "
        f"with the controller B of {result.names[1]}.",
        pair_verdict(result),
        (Section("A against B", blocks, "pair", True),),
        result.command,
        int(settings["seed"]),
        {
            "Samples": [
                Fact(*row) for row in setting_rows(result.judged[0]) if not row[0].startswith("design ")
            ]
        },
        [
            *(
                Fact(f"fail with {side}", count, f"of {counts.count}", f"{only} with {side} alone")
                for side, count, only in failures
            ),
            *(
                Fact(
                    metric_text(metric.name),
                    _signed(metric.median),
                    metric.unit,
                    f"median of B − A; {_interval_text(result, metric)}",
                )
                for metric in varied[:2]
            ),
        ],
        [
            replace(status, text=f"{side}: {status.text}")
            for side, judged in zip("AB", result.judged)
            for status in design_statuses(verdict_of(judged.table.journal) or UNKNOWN)
        ],
    )
    return write_page(result.folder, "report of the comparison", page)


# In words ----------------------------------------------------------------------------------------------------
def pair_verdict(result: DesignPair) -> str:
    """Failures of both designs with McNemar's test, and the medians of the main metric."""
    paired, counts = result.paired, result.paired.success
    text = "Of the same {} robots {} fail with A, {} with B".format(paired.count, *counts.failures)
    if counts.only_a + counts.only_b:
        test = f"; McNemar: {_p_text(counts.p_value)}" if result.independent else ""
        text += f" ({counts.only_a} with A alone, {counts.only_b} with B alone{test})"
    if not paired.main:
        return f"{text}."
    metric = _in_page_units(result, paired.metric(paired.main))
    medians = [value_text(median, metric.unit) for median in metric.medians]
    better = [percent_text(share.rate) for share in metric.better]
    return (
        f"{text}; median {metric_text(metric.name)} {medians[0]} with A, {medians[1]} with B; the difference B − A is "
        f"{_signed(metric.median, metric.unit)} at the median ({_interval_text(result, metric)}); A is better in "
        f"{better[0]} of the pairs, B in {better[1]}."
    )


def pair_designs(result: DesignPair) -> list[str]:
    """The verdict on each of the two designs."""
    return [f"{side}: {campaign_design(judged)}" for side, judged in zip("AB", result.judged)]


def _in_page_units(result: DesignPair, metric: PairedMetric) -> PairedMetric:
    """The metric in the unit of the design's pages."""
    both = np.concatenate([metric.a, metric.b])
    factor, unit = display_scale_of(both, metric.unit, in_degrees(result.judged[0]))
    return (
        metric
        if unit == metric.unit
        else PairedMetric(metric.name, unit, factor * metric.a, factor * metric.b, metric.largest_is_best)
    )


def _p_text(p: float) -> str:
    return f"p < {number(1e-6, 1)}" if p < 1e-6 else f"p = {number(p, 2)}"


def _signed(value: float, unit: str = "") -> str:
    if math.isnan(value):
        return "none"
    text = "∞" if math.isinf(value) else number(abs(value), 3)
    return f"{'+' if value > 0.0 else '−' if value < 0.0 else ''}{text} {unit}".strip()


def _interval_text(result: DesignPair, metric: PairedMetric) -> str:
    if not result.independent:
        return f"no interval: samples spread {SPREAD[result.judged[0].method]}"
    return f"95 %: {_span(metric)}" if _span(metric) else "too few pairs for an interval"


def _span(metric: PairedMetric) -> str:
    return "" if np.isnan(metric.interval).any() else " to ".join(map(_signed, metric.interval))


# Blocks ------------------------------------------------------------------------------------------------------
def _success(result: DesignPair) -> list[PageBlock]:
    differing = [(name.replace("_", " "), a, b) for name, a, b in result.differences]
    tally, first, own = result.paired.success, result.judged[0], result.b.requirements
    limits = [
        f"{metric_text(rule.metric)} {limit_text(rule, first.table.unit(rule.metric), in_degrees(first))}"
        for rule in result.paired.requirements
    ]
    test = (
        f"McNemar's test, by the binomial distribution over pairs in which one of them fails: {_p_text(tally.p_value)}."
        if result.independent
        else f"The samples are spread {SPREAD[first.method]} and not independent: no test and no confidence interval "
        "holds for them, and none is stated (`--method random` has them)."
    )
    return [
        Table(("", "A", "B"), differing, "What differs in the specifications", "table-designs")
        if differing
        else Note("The specifications do not differ: the controllers are two of the same design."),
        Paragraph(
            f"Robots, noise, sensors, motors and step are the same for both; the folders {FOLDERS[0]} and {FOLDERS[1]} "
            "have the report of each. A sample is a success if its run reaches its end, is stable there, and keeps the "
            f"requirements: {'; '.join(limits) or 'there are none'}. {test}"
        ),
        *(
            [Note(f"B by itself requires {', '.join(own)}; here both are judged by the same requirements.")]
            if own != result.a.requirements
            else []
        ),
        Table(
            ("", "B keeps them", "B fails"),
            [("A keeps them", tally.neither, tally.only_b), ("A fails", tally.only_a, tally.both_fail)],
            "Pairs",
            "table-pairs",
        ),
        Table(
            ("", "success", "95 %: from", "to"),
            [
                (
                    f"{name}: {source}",
                    percent_text(side.rate),
                    *(
                        ("–", "–")
                        if side.success is None
                        else map(percent_text, (side.success.low, side.success.high))
                    ),
                )
                for name, source, side in zip("AB", result.names, result.judged)
            ],
            "Each by itself, by Clopper and Pearson",
            "table-rates",
        ),
    ]


def pair_table(result: DesignPair, names: Sequence[str]) -> Table:
    """Table of the paired differences of some metrics."""
    independent = result.independent
    return Table(
        (
            "", "unit", Column("median of A", brief="A"), Column("of B", brief="B"), Column("of B − A", brief="B − A"),
            "95 %", Column("A is better", brief="A better"), Column("95 %", brief=None),
            Column("B is better", brief=None), Column("95 %", brief=None), Column("pairs", brief=None),
        ),
        [
            (
                metric_text(metric.name), metric.unit, *(value_text(median, "") for median in metric.medians),
                _signed(metric.median), (_span(metric) or "too few") if independent else "–",
                *(
                    text
                    for share in metric.better
                    for text in (percent_text(share.rate), interval_text(share) if independent else "–")
                ),
                len(metric.pairs),
            )
            for metric in (_in_page_units(result, result.paired.metric(name)) for name in names) if len(metric.pairs)
        ],
        "Paired differences", "table-differences", title=f"B − A on the same {result.paired.count} robots",
    )  # fmt: skip


def _differences(result: DesignPair, metrics: Sequence[PairedMetric]) -> list[PageBlock]:
    intervals = (
        " The interval of the median is exact, by order statistics; those of the fractions are Clopper's and "
        "Pearson's. Each holds with 95 % by itself, not all of them together."
        if result.independent
        else ""
    )
    table = pair_table(result, (*result.paired.metrics, *result.paired.parts))
    blocks = [
        Paragraph(
            "Better is the smaller value, or the larger one where a requirement states a least value; values that "
            f"agree to four digits are equal.{intervals} A run that is unstable or does not reach its end is worse "
            "than all others; pairs of two such runs are left out."
        ),
        *([table] if table.rows else []),
    ]
    if not metrics:
        return [*blocks, Paragraph("No metric differs in any sample.")]
    histograms, bars = small_panels(len(metrics), 1.9)
    samples, clouds = small_panels(len(metrics), 2.2)
    for k, (pair, axis, cloud) in enumerate(zip(metrics, bars, clouds)):
        finite = pair.differences[np.isfinite(pair.differences)]
        histogram(axis, result.judged[0], pair.name, pair.unit, finite, "pairs" if k % 3 == 0 else "")
        axis.axvline(0.0, color=INK, linewidth=1.0)
        if math.isfinite(pair.median):
            axis.axvline(pair.median, color=SERIES[1], linewidth=1.4, dashes=DASHED)
        both = np.isfinite(pair.a) & np.isfinite(pair.b)
        a, b = pair.a[both][:POINTS], pair.b[both][:POINTS]
        ends = framed(np.array([*a, *b]))
        cloud.plot(ends, ends, color=INK, linewidth=1.0, dashes=DASHED)
        cloud.plot(a, b, ".", color=SERIES[0], markersize=3.0, alpha=0.5, markeredgewidth=0.0)
        cloud.set(xlim=ends, ylim=ends)
        cloud.set_title(metric_text(pair.name, pair.unit), wrap=True)
        cloud.set_xlabel("A")
        label(cloud, "B" if k % 3 == 0 else "", "")
        for each in (axis, cloud):
            few_ticks(each, max(map(abs, each.get_xlim())))
    few = f" The first {POINTS} samples are drawn." if result.paired.count > POINTS else ""
    return [
        *blocks,
        figure_block(
            "differences", histograms,
            "How many pairs have which difference B − A: right of zero B has the larger value. Dashed: the median. "
            "Differences that are not finite are left out.",
            "Distribution of the differences",
        ),
        figure_block(
            "samples", samples, f"A point for each robot; above the dashed line B has the larger value.{few}",
            "A against B",
        ),
    ]  # fmt: skip


def _extremes(result: DesignPair, varied: Sequence[PairedMetric]) -> list[PageBlock]:
    cases = [(m, who, sample) for m in varied for who, sample in zip("AB", m.extremes) if sample is not None]
    if not cases:
        return []
    folder, first = result.folder.name, (result.paired.main, varied[0].name)
    again = dict.fromkeys(sample for m, _, sample in cases if m.name in first)
    lines = [replay_command(f"{folder}/{side}", f"--sample {sample}") for sample in again for side in FOLDERS]
    return [
        Table(
            ("", "sample", "A", "B", "its numbers"),
            [
                (
                    f"{metric_text(m.name)}: {who} is better by most", sample,
                    *(value_text(float(x[sample]), m.unit) for x in (m.a, m.b)),
                    sample_changes(result.judged[0], sample),
                )
                for m, who, sample in cases
            ],
            "Largest differences each way", "table-extremes", stacks=True,
        ),
        Paragraph(f"These commands, beside the folder {folder}, run the first of them again, with A and with B:"),
        Listing("\n".join(lines)),
    ]  # fmt: skip
