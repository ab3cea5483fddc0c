"""The report of two designs on the same samples: success and failure, paired differences, extremes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from flexhinf.campaign import PairedMetric
from flexhinf.design.campaign_folder import SIDES, PairResult
from flexhinf.pages.campaign import few_ticks, histogram, small_panels, write_page
from flexhinf.pages.campaign_text import (
    SPREAD,
    interval_text,
    limit_text,
    metric_text,
    percent_text,
    replay_command,
    sample_changes,
    unbroken,
    value_text,
)
from flexhinf.pages.drawing import DASHED, figure_block, framed
from flexhinf.report import (
    INK,
    SERIES,
    Column,
    KeyNumber,
    Listing,
    Note,
    Page,
    Paragraph,
    Provenance,
    Section,
    Setting,
    Settings,
    Table,
    house_style,
    label,
    number,
)

#: Metrics that are drawn, and points of a panel, at most.
DRAWN, POINTS = 6, 2000

#: Probabilities below this are not told apart.
LEAST_P = 1e-6


def write_pair(result: PairResult) -> Path:
    """Write index.html of a comparison; returns its path."""
    settings, found = result.judged[0].table.journal.settings, result.paired.success
    request = (
        f"{result.paired.count} robots, each with its own measurement noise, run twice for {settings['duration']} s: "
        f"with the controller A of {result.names[0]} and with the controller B of {result.names[1]}."
    )
    varied = [one for one in map(result.paired.metric, result.paired.metrics) if np.any(_finite(one) != 0.0)]
    numbers = [
        *(
            KeyNumber(f"fail with {side}", failures, f"of {found.count}", f"{only} with {side} alone")
            for side, failures, only in zip("AB", found.failures, (found.only_a, found.only_b))
        ),
        *(
            KeyNumber(
                metric_text(one.name),
                _signed(one.median),
                one.unit,
                f"median of B − A; {_interval_text(result, one)}",
            )
            for one in varied[:2]
        ),
    ]
    stated = [Setting(name, value) for name, value in settings.items() if not name.startswith("design ")]
    with house_style():  # once for all figures
        blocks = [*_success(result), *_differences(result, varied[:DRAWN]), *_extremes(result, varied)]
    title = f"Two designs on the same robots “{result.pair.a.request.robot.name}”"
    page = Page(
        title, request, pair_verdict(result), (Section("A against B", blocks, "pair"),),
        Settings({"Samples": stated}), Provenance(result.command, int(settings["seed"])), numbers,
    )  # fmt: skip
    return write_page(result.folder, "report of the comparison", page)


# In words ----------------------------------------------------------------------------------------------------
def pair_verdict(result: PairResult) -> str:
    """Failures of both with the test of McNemar, and the main metric."""
    paired, found = result.paired, result.paired.success
    a, b = found.failures
    text = f"Of the same {paired.count} robots {a} fail with A, {b} with B"
    if found.only_a + found.only_b:
        test = f"; McNemar: {_p_text(found.p_value)}" if _independent(result) else ""
        text += f" ({found.only_a} with A alone, {found.only_b} with B alone{test})"
    if not paired.main:
        return f"{text}."
    one = paired.metric(paired.main)
    medians, better = (
        [value_text(x, one.unit) for x in one.medians],
        [percent_text(x.rate) for x in one.better],
    )
    return (
        f"{text}; median {metric_text(one.name)} {medians[0]} with A, {medians[1]} with B; the difference B − A is "
        f"{_signed(one.median, one.unit)} at the median ({_interval_text(result, one)}); A is better in {better[0]} of "
        f"the pairs, B in {better[1]}."
    )


def _p_text(p: float) -> str:
    return f"p < {number(LEAST_P, 1)}" if p < LEAST_P else f"p = {number(p, 2)}"


def _signed(value: float, unit: str = "") -> str:
    if math.isnan(value):
        return "none"
    text = "∞" if math.isinf(value) else number(abs(value), 3)
    return f"{'+' if value > 0.0 else '−' if value < 0.0 else ''}{text} {unit}".strip()


def _independent(result: PairResult) -> bool:
    """Whether the samples are independent, so that tests and intervals hold."""
    return result.judged[0].method == "random"


def _interval_text(result: PairResult, one: PairedMetric) -> str:
    if not _independent(result):
        return f"no interval: samples spread {SPREAD[result.judged[0].method]}"
    return f"95 %: {_span(one)}" if _span(one) else "too few pairs for an interval"


def _span(one: PairedMetric) -> str:
    """The interval of the median; empty where the pairs are too few."""
    return "" if np.isnan(one.interval).any() else " to ".join(map(_signed, one.interval))


def _finite(one: PairedMetric) -> np.ndarray:
    return one.differences[np.isfinite(one.differences)]


# Blocks ------------------------------------------------------------------------------------------------------
def _success(result: PairResult) -> list[Any]:
    """What differs in the specifications, and which pairs fail."""
    differing = [(name.replace("_", " "), a, b) for name, a, b in result.pair.differences]
    designs: Any = Note("The specifications do not differ: the controllers are two of the same design.")
    if differing:
        designs = Table(("", "A", "B"), differing, "What differs in the specifications", "table-designs")
    found, first, own = result.paired.success, result.judged[0], result.pair.b.requirements
    limits = [
        f"{metric_text(one.metric)} {limit_text(one, first.table.unit(one.metric))}"
        for one in result.paired.requirements
    ]
    test = (
        f"McNemar's test, by the binomial distribution over pairs in which one of them fails: {_p_text(found.p_value)}."
        if _independent(result) else
        f"The samples are spread {SPREAD[first.method]} and not independent: no test and no confidence interval holds "
        "for them, and none is stated (`--method random` has them)."
    )  # fmt: skip
    text = (
        "Robots, noise, sensors, motors and step are the same for both; the folders "
        f"{SIDES[0]} and {SIDES[1]} have the report of each. A sample is a success if its run reaches its end, is "
        f"stable there, and keeps the requirements: {'; '.join(limits) or 'there are none'}. {test}"
    )
    rates = [
        (f"{name}: {source}", percent_text(one.rate),
         *(("–", "–") if one.success is None else map(percent_text, (one.success.low, one.success.high))))
        for name, source, one in zip("AB", result.names, result.judged)
    ]  # fmt: skip
    pairs = [("A keeps them", found.neither, found.only_b), ("A fails", found.only_a, found.both_fail)]
    other = f"B by itself requires {', '.join(own)}; here both are judged by the same requirements."
    return [
        designs,
        Paragraph(text),
        *([Note(other)] if own != result.pair.a.requirements else []),
        Table(("", "B keeps them", "B fails"), pairs, "Pairs", "table-pairs"),
        Table(
            ("", "success", "95 %: from", "to"),
            rates,
            "Each by itself, by Clopper and Pearson",
            "table-rates",
        ),
    ]


def _difference_table(result: PairResult, names: Sequence[str]) -> Table:
    """Medians of both and of B − A, and in how many pairs either is better; a terminal shows some of the columns."""
    rows, independent = [], _independent(result)
    for one in map(result.paired.metric, names):
        if len(one.pairs):
            medians = (value_text(median, "") for median in one.medians)
            span = (_span(one) or "too few") if independent else "–"
            better = [
                text
                for share in one.better
                for text in (percent_text(share.rate), unbroken(interval_text(share)) if independent else "–")
            ]
            row = (*medians, _signed(one.median), span, *better, len(one.pairs))
            rows.append((metric_text(one.name), one.unit, *row))
    columns = (
        "", "unit", Column("median of A", brief="A"), Column("of B", brief="B"), Column("of B − A", brief="B − A"),
        "95 %", Column("A is better", brief="A better"), Column("95 %", brief=None), Column("B is better", brief=None),
        Column("95 %", brief=None), Column("pairs", brief=None),
    )  # fmt: skip
    title = f"B − A on the same {result.paired.count} robots"
    return Table(columns, rows, "Paired differences", "table-differences", title=title)


def pair_table(result: PairResult) -> Any:
    """Paired differences of all metrics, for a terminal."""
    return _difference_table(result, result.paired.metrics).terminal()


def _differences(result: PairResult, drawn: Sequence[PairedMetric]) -> list[Any]:
    """Paired differences in a table, as histograms, and sample by sample."""
    intervals = (
        " The interval of the median is exact, by order statistics; those of the fractions are Clopper's and "
        "Pearson's. Each holds with 95 % by itself, not all of them together."
        if _independent(result) else ""
    )  # fmt: skip
    text = (
        "Better is the smaller value, or the larger one where a requirement states a least value; values that agree to "
        f"four digits are equal.{intervals} A run that is unstable or does not reach its end is worse than all others; "
        "pairs of two such runs are left out."
    )
    table = _difference_table(result, (*result.paired.metrics, *result.paired.parts))
    blocks = [Paragraph(text), *([table] if table.rows else [])]
    if not drawn:
        return [*blocks, Paragraph("No metric differs in any sample.")]
    histograms, bars = small_panels(len(drawn), 1.9)
    samples, clouds = small_panels(len(drawn), 2.2)
    for k, (one, axis, cloud) in enumerate(zip(drawn, bars, clouds)):
        histogram(axis, result.judged[0], one.name, one.unit, _finite(one), "pairs" if k % 3 == 0 else "")
        axis.axvline(0.0, color=INK, linewidth=1.0)
        if math.isfinite(one.median):
            axis.axvline(one.median, color=SERIES[1], linewidth=1.4, dashes=DASHED)
        both = np.isfinite(one.a) & np.isfinite(one.b)
        a, b = one.a[both][:POINTS], one.b[both][:POINTS]
        ends = framed(np.array([*a, *b]))
        cloud.plot(ends, ends, color=INK, linewidth=1.0, dashes=DASHED)
        cloud.plot(a, b, ".", color=SERIES[0], markersize=3.0, alpha=0.5, markeredgewidth=0.0)
        cloud.set(xlim=ends, ylim=ends)
        cloud.set_title(metric_text(one.name, one.unit), fontsize=9, wrap=True)
        cloud.set_xlabel("A", fontsize=8)
        label(cloud, "B" if k % 3 == 0 else "", "")
        for each in (axis, cloud):
            few_ticks(each, max(map(abs, each.get_xlim())))
    caption = (
        "How many pairs have which difference B − A: right of zero B has the larger value. Dashed: the median. "
        "Differences that are not finite are left out."
    )
    few = f" The first {POINTS} samples are drawn." if result.paired.count > POINTS else ""
    points = f"A point for each robot; above the dashed line B has the larger value.{few}"
    return [
        *blocks,
        figure_block("differences", histograms, caption, "Distribution of the differences"),
        figure_block("samples", samples, points, "A against B"),
    ]


def _extremes(result: PairResult, varied: Sequence[PairedMetric]) -> list[Any]:
    """For each metric the sample in which either is better by most, with what runs it again."""
    cases = [
        (one, who, sample) for one in varied for who, sample in zip("AB", one.extremes) if sample is not None
    ]
    if not cases:
        return []
    rows = [
        (
            f"{metric_text(one.name)}: {who} is better by most", sample,
            *(value_text(float(x[sample]), one.unit) for x in (one.a, one.b)),
            unbroken(sample_changes(result.judged[0], sample)),
        )
        for one, who, sample in cases
    ]  # fmt: skip
    folder, first = result.folder.name, (result.paired.main, varied[0].name)
    again = dict.fromkeys(sample for one, _, sample in cases if one.name in first)
    lines = [replay_command(f"{folder}/{side}", f"--sample {sample}") for sample in again for side in SIDES]
    columns = ("", "sample", "A", "B", "its numbers")
    return [
        Table(columns, rows, "Largest differences each way", "table-extremes", stacks=True),
        Paragraph(
            f"These commands, beside the folder {folder}, run the first of them again, with A and with B:"
        ),
        Listing("\n".join(lines)),
    ]
