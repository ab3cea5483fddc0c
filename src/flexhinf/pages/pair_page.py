"""The report of two designs on the same samples: success and failure, paired differences, pictures, extremes."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from flexhinf.campaign import Interval, PairedMetric
from flexhinf.design.campaign_setup import SIDES, PairResult
from flexhinf.files import write_file
from flexhinf.pages.campaign_worst import (
    SPREAD,
    changes,
    limit_text,
    metric_text,
    percent_text,
    replay_command,
    value_text,
)
from flexhinf.pages.design.monte_carlo import histogram_bins
from flexhinf.pages.drawing import DASHED, figure_block, framed, panels
from flexhinf.report import (
    INK,
    SERIES,
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
    text = pair_page(result).html()
    path = result.folder / "index.html"
    write_file(path, "report of the comparison", lambda name: Path(name).write_text(text, encoding="utf-8"))
    return path


def pair_page(result: PairResult) -> Page:
    """Everything on one page."""
    settings = result.judged[0].table.journal.settings
    with house_style():
        parts = (
            Section("The designs", _designs(result), "designs"),
            Section("Success", _success(result), "success"),
            Section("Differences", _differences(result), "differences"),
            Section("Sample by sample", _scatter(result), "samples"),
            Section("Largest differences", _extremes(result), "extremes"),
        )
    asked = (
        f"{result.paired.count} robots, each with its own measurement noise, run twice for {settings['duration']} s: "
        f"with the controller A of {result.names[0]} and with the controller B of {result.names[1]}."
    )
    stated = {
        "Samples": [
            Setting(name, value) for name, value in settings.items() if not name.startswith("design ")
        ]
    }
    return Page(
        f"Two designs on the same robots “{result.pair.a.request.robot.name}”", asked, pair_verdict(result),
        tuple(section for section in parts if section.blocks), Settings(stated),
        Provenance(result.command, int(settings["seed"])), _key_numbers(result),
    )  # fmt: skip


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
    (first, second), (better_a, better_b) = one.medians, one.better
    return (
        f"{text}; median {metric_text(one.name)} {value_text(first, one.unit)} with A, "
        f"{value_text(second, one.unit)} with B; the difference B − A is {_signed(one.median, one.unit)} at the "
        f"median ({_interval_text(result, one)}); A is better in {percent_text(better_a.rate)} of the pairs, B in "
        f"{percent_text(better_b.rate)}."
    )


def _p_text(p: float) -> str:
    return f"p < {number(LEAST_P, 1)}" if p < LEAST_P else f"p = {number(p, 2)}"


def _signed(value: float, unit: str) -> str:
    """A difference with its sign."""
    if math.isnan(value):
        return "none"
    text = "∞" if math.isinf(value) else number(abs(value), 3)
    sign = "+" if value > 0.0 else "−" if value < 0.0 else ""
    return f"{sign}{text} {unit}".strip()


def _independent(result: PairResult) -> bool:
    """Whether the samples are independent, so that tests and intervals hold."""
    return result.judged[0].method == "random"


def _interval_text(result: PairResult, one: PairedMetric) -> str:
    if not _independent(result):
        return f"no interval: samples spread {SPREAD[result.judged[0].method]}"
    low, high = one.interval
    if math.isnan(low) or math.isnan(high):
        return "too few pairs for an interval"
    return f"95 %: {_signed(low, '')} to {_signed(high, '')}"


def _share_text(one: Interval, independent: bool) -> str:
    interval = f" ({percent_text(one.low)} to {percent_text(one.high)})" if independent else ""
    text = f"{percent_text(one.rate)}{interval}"
    return text.replace(" %", "\N{NO-BREAK SPACE}%")


def _key_numbers(result: PairResult) -> list[KeyNumber]:
    found = result.paired.success
    a, b = found.failures
    numbers = [
        KeyNumber("fail with A", a, f"of {found.count}", f"{found.only_a} with A alone"),
        KeyNumber("fail with B", b, f"of {found.count}", f"{found.only_b} with B alone"),
    ]
    for name in _varied(result)[:2]:
        one = result.paired.metric(name)
        note = f"median of B − A; {_interval_text(result, one)}"
        numbers.append(KeyNumber(metric_text(name), _signed(one.median, ""), one.unit, note))
    return numbers


# Sections ----------------------------------------------------------------------------------------------------
def _designs(result: PairResult) -> list[Any]:
    found: list[Any] = [
        Paragraph(
            "Robots, their numbers, noise, sensors, motors and step are the same for both; each design has its own "
            f"report in the folders {SIDES[0]} and {SIDES[1]}."
        )
    ]
    rows = [(name.replace("_", " "), a, b) for name, a, b in result.pair.differences]
    if not rows:
        return [*found, Note("The specifications do not differ: the controllers are two of the same design.")]
    return [*found, Table(("", "A", "B"), rows, "What differs in the specifications", "table-designs")]


def _success(result: PairResult) -> list[Any]:
    found, (a, b) = result.paired.success, result.judged
    limits = [
        f"{metric_text(one.metric)} {limit_text(one, a.table.unit(one.metric))}"
        for one in result.paired.requirements
    ]
    test = (
        "McNemar's test asks whether both fail equally often; only pairs in which one of them fails count, by the "
        f"binomial distribution: {_p_text(found.p_value)}."
        if _independent(result) else _caution(result)
    )  # fmt: skip
    text = (
        "A sample is a success if its run reaches its end, is stable there, and keeps the requirements: "
        f"{'; '.join(limits) or 'there are none'}. {test}"
    )
    rows = [
        ("A keeps them", found.neither, found.only_b),
        ("A fails", found.only_a, found.both_fail),
    ]
    rates = []
    for name, source, one in zip("AB", result.names, (a, b)):
        ends = ("–", "–") if one.success is None else map(percent_text, (one.success.low, one.success.high))
        rates.append((f"{name}: {source}", percent_text(one.rate), *ends))
    own = result.pair.b.requirements
    other = [Note(
        f"The specification of B by itself requires {', '.join(own)}; here both are judged by the same requirements."
    )] if own != result.pair.requirements else []  # fmt: skip
    return [
        Paragraph(text), *other,
        Table(("", "B keeps them", "B fails"), rows, "Pairs", "table-pairs"),
        Table(("", "success", "95 %: from", "to"), rates, "Each by itself, by Clopper and Pearson", "table-rates"),
    ]  # fmt: skip


def _differences(result: PairResult) -> list[Any]:
    independent = _independent(result)
    intervals = (
        "The interval of the median is exact, by order statistics (the sign test inverted, which asks for no "
        "symmetry); those of the fractions are Clopper's and Pearson's. Each holds with 95 % by itself, not "
        "all of them together."
        if independent else _caution(result)
    )  # fmt: skip
    text = (
        "Chosen before any run: of each metric the median of the differences B − A, and in how many pairs either is "
        "better: the one with the smaller value, or the larger one where a requirement states a least value. "
        f"{intervals} A run that is unstable or does not reach its end is worse than all others; pairs of two such "
        "runs are left out. Values that agree to four digits are equal."
    )
    rows = []
    for name in (*result.paired.metrics, *result.paired.parts):
        one = result.paired.metric(name)
        if len(one.pairs):
            a, b = one.medians
            (low, high), shares = one.interval, [_share_text(share, independent) for share in one.better]
            span = "too few" if math.isnan(low) else f"{_signed(low, '')} to {_signed(high, '')}"
            span = span if independent else "–"
            cells = ("never" if math.isinf(x) else number(x, 3) for x in (a, b))
            rows.append(
                (metric_text(name), one.unit, *cells, _signed(one.median, ""), span, *shares, len(one.pairs))
            )
    columns = ("", "unit", "median of A", "of B", "of B − A", "95 %", "A is better", "B is better", "pairs")
    figure = _histograms(result)
    table = [Table(columns, rows, "Paired differences", "table-differences")] if rows else []
    return [Paragraph(text), *table, *([] if figure is None else [figure])]


def _caution(result: PairResult) -> str:
    return (
        f"The samples are spread {SPREAD[result.judged[0].method]} and not independent: no test and no confidence "
        "interval holds for them, and none is stated (`--method random` has them)."
    )


def _varied(result: PairResult) -> list[str]:
    """Metrics that differ between both in some sample."""
    names = result.paired.metrics
    return [name for name in names if np.any(_finite(result.paired.metric(name)) != 0.0)]


def _finite(one: PairedMetric) -> np.ndarray:
    return one.differences[np.isfinite(one.differences)]


def _grid(count: int, height: float) -> tuple[Any, list[Any]]:
    columns = min(3, count)
    rows = -(-count // columns)
    figure, grid = panels(rows, columns, 0.4 + height * rows)
    axes = [axis for row in grid for axis in row]
    for axis in axes[count:]:
        axis.set_visible(False)
    return figure, axes[:count]


def _axis_text(one: PairedMetric) -> str:
    return f"{metric_text(one.name)} ({one.unit})" if one.unit else metric_text(one.name)


def _plain(axis: Any) -> None:
    axis.locator_params(nbins=3 if max(map(abs, axis.get_xlim())) > 5e-3 else 2)
    for one in (axis.xaxis, axis.yaxis):
        one.set_major_formatter(lambda value, _: number(value, 3))
    axis.tick_params(labelsize=8)


def _histograms(result: PairResult) -> Any:
    names = _varied(result)[:DRAWN]
    if not names:
        return None
    figure, axes = _grid(len(names), 1.9)
    for k, (axis, name) in enumerate(zip(axes, names)):
        one = result.paired.metric(name)
        values = _finite(one)
        with house_style():
            axis.hist(values, bins=_bins(values, one.unit, result), color=SERIES[0], alpha=0.55)
            axis.axvline(0.0, color=INK, linewidth=1.0)
            if math.isfinite(one.median):
                axis.axvline(one.median, color=SERIES[1], linewidth=1.4, dashes=DASHED)
            axis.grid(axis="x", visible=False)
        _plain(axis)
        axis.set_xlabel(_axis_text(one), fontsize=8)
        label(axis, "pairs" if k % 3 == 0 else "", "")
    caption = (
        "How many pairs have which difference B − A; to the right of the line at zero B has the larger value. Dashed: "
        "the median. Differences that are not finite are left out here."
    )
    return figure_block("differences", figure, caption, "Distribution of the differences")


def _bins(values: np.ndarray, unit: str, result: PairResult) -> list[float]:
    time = result.judged[0].table.journal.time
    period = float(np.diff(time[:2])[0]) if len(time) > 1 else 0.0
    grain = period if unit == "s" and 0.0 < 10.0 * period < np.ptp(values) else 0.0
    if np.ptp(values) == 0.0:
        half = 0.5 * abs(float(values[0])) or 0.5
        return [float(values[0]) - half, float(values[0]) + half]
    return histogram_bins(values, grain).tolist()


def _scatter(result: PairResult) -> list[Any]:
    names = _varied(result)[:DRAWN]
    if not names:
        return [Paragraph("No metric differs in any sample.")]
    figure, axes = _grid(len(names), 2.2)
    for k, (axis, name) in enumerate(zip(axes, names)):
        one = result.paired.metric(name)
        both = np.isfinite(one.a) & np.isfinite(one.b)
        a, b = one.a[both][:POINTS], one.b[both][:POINTS]
        ends = framed(np.array([*a, *b]))
        with house_style():
            axis.plot(ends, ends, color=INK, linewidth=1.0, dashes=DASHED)
            axis.plot(a, b, ".", color=SERIES[0], markersize=3.0, alpha=0.5, markeredgewidth=0.0)
            axis.set_xlim(*ends)
            axis.set_ylim(*ends)
        _plain(axis)
        axis.set_title(_axis_text(one), fontsize=9, wrap=True)
        axis.set_xlabel("A", fontsize=8)
        label(axis, "B" if k % 3 == 0 else "", "")
    few = f" The first {POINTS} samples are drawn." if result.paired.count > POINTS else ""
    caption = (
        f"A point for each robot; on the dashed line both are equal, above it B has the larger value.{few}"
    )
    return [figure_block("samples", figure, caption, "A against B")]


def _extremes(result: PairResult) -> list[Any]:
    """For each metric the sample in which either is better by most, with what runs it again."""
    rows, shown = [], list[int]()
    for name in _varied(result):
        one = result.paired.metric(name)
        for who, sample in zip("AB", one.extremes):
            if sample is None:
                continue
            shown += [sample] if name in (result.paired.main, *_varied(result)[:1]) else []
            values = (value_text(float(x[sample]), one.unit) for x in (one.a, one.b))
            rows.append(
                (f"{metric_text(name)}: {who} is better by most", sample, *values,
                 changes(result.judged[0], sample).replace(" %", "\N{NO-BREAK SPACE}%"))
            )  # fmt: skip
    if not rows:
        return []
    folder = result.folder.name
    lines = [
        replay_command(f"{folder}/{side}", f"--sample {sample}")
        for sample in dict.fromkeys(shown)
        for side in SIDES
    ]
    text = (
        f"These commands, beside the folder {folder}, run the first of them again, with A and with B; every other one "
        "by its number, with `--out run.nc` for all its signals:"
    )
    columns = ("", "sample", "A", "B", "its numbers")
    return [
        Table(columns, rows, "Largest differences each way", "table-extremes", stacks=True),
        Paragraph(text),
        Listing("\n".join(lines)),
    ]


# At the terminal ---------------------------------------------------------------------------------------------
def pair_table(result: PairResult) -> Any:
    """Paired differences of all metrics."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table as Terminal

    table = Terminal(
        title=f"B − A on the same {result.paired.count} robots", box=SIMPLE_HEAD, title_justify="left"
    )
    independent = _independent(result)
    for column in ("", "A", "B", "B − A (95 %)" if independent else "B − A", "A better"):
        table.add_column(column, justify="left" if not column else "right")
    for name in result.paired.metrics:
        one = result.paired.metric(name)
        if len(one.pairs):
            medians = [value_text(x, "") for x in one.medians]
            low, high = one.interval
            span = (
                "" if math.isnan(low) or not independent else f" ({_signed(low, '')} to {_signed(high, '')})"
            )
            share = percent_text(one.better[0].rate)
            table.add_row(_axis_text(one), *medians, f"{_signed(one.median, '')}{span}", share)
    return table
