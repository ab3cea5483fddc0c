"""Texts, tables and small panels of the reports of campaigns, on a page and in a terminal; the report
of two designs on the same samples: success and failure, paired differences, extremes."""

# Not checked strictly: parts of Matplotlib have no types.
# pyright: reportUnknownMemberType=false

from __future__ import annotations

import math
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Literal

import numpy as np

from flexhinf.campaign import (
    CampaignJudgement,
    EvaluatedPlant,
    Journal,
    MetricLimit,
    PairedMetric,
    Replayed,
    WorstCase,
)
from flexhinf.campaign.metrics import COMPLETED, DIVERGED, UNSTABLE
from flexhinf.design.campaign_folder import FOLDERS, DesignPair, GainRow, verdict_of
from flexhinf.design.requirements import REQUIREMENTS
from flexhinf.design.verdict import UNKNOWN
from flexhinf.files import write_file
from flexhinf.numerals import number, short_numbers
from flexhinf.pages.campaign_numbers import (
    display_scale_of,
    in_degrees,
    interval_text,
    limit_text,
    metric_text,
    own_value_text,
    percent_text,
    setting_rows,
    value_text,
)
from flexhinf.pages.design.step import histogram_bins
from flexhinf.pages.drawing import DASHED, figure_block, framed
from flexhinf.pages.page import design_statuses
from flexhinf.report import (
    INK,
    SERIES,
    Column,
    KeyNumber,
    Listing,
    Note,
    Page,
    PageBlock,
    Paragraph,
    Provenance,
    Section,
    Setting,
    Settings,
    Table,
    house_style,
    label,
    panels,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas
    from rich.table import Table as Terminal

#: The requirement of a design that a metric of its campaign judges.
JUDGED = {
    metric: REQUIREMENTS[name].what
    for metric, name in {
        "overshoot_percent": "overshoot", "settling_time_s": "unsettled", "input_limit_use": "peak",
        "speed_limit_use": "speed", "tracking_error_use": "tracking", "final_error_use": "final",
        "remaining_error_use": "remaining", "path_distance_use": "path", "wrong_way_percent_use": "undershoot",
        "ripple_percent_use": "ripple", "time_at_limit_s_use": "at_limit", "range_use": "range",
        "input_rate_use": "input_rate", "input_acceleration_use": "input_acceleration",
    }.items()
}  # fmt: skip

#: How samples are spread, in a sentence.
SPREAD = {
    "random": "independently", "latin-hypercube": "by a Latin hypercube", "sobol": "by a Sobol sequence",
}  # fmt: skip

#: Numbers of a sample that are listed.
LISTED = 4


def percent_change(name: str, value: float, nominal: float | None) -> str:
    """Change from the nominal number in per cent; empty where that is zero, not known, or a payload's."""
    if not nominal or "payload" in name:
        return ""
    change = 100.0 * (value / nominal - 1.0)
    return f"{'+' if change > 0.0 else ''}{number(change, 2)} %"


def _changes_text(
    numbers: Iterable[tuple[str, float, float | None, str]],
    others: str = "others by less",
    most: int = LISTED,
) -> str:
    # of each number name, value, nominal value and unit
    changes = [
        f"{name.replace('_', ' ')} {percent_change(name, value, nominal) or value_text(value, unit)}"
        for name, value, nominal, unit in numbers
        if value != nominal
    ]
    changes[most:] = [others.format(len(changes) - most)] if len(changes) > most else []
    return ", ".join(changes) or "nominal numbers"


def sample_changes(judged: CampaignJudgement, sample: int) -> str:
    """A sample by its numbers that are furthest from nominal, relative to their spread."""
    changes: list[tuple[float, tuple[str, float, float | None, str]]] = []
    for name, value in judged.table.numbers(sample).items():
        column, nominal = judged.column(name), judged.nominal.get(name)
        middle, spread = float(column.mean()) if nominal is None else nominal, float(column.std())
        if spread > 0.0 and value != middle:
            changes.append((abs(value - middle) / spread, (name, value, nominal, judged.table.unit(name))))
    return _changes_text(change for _, change in sorted(changes, key=lambda pair: -pair[0]))


def replay_command(folder: Path | str, which: str) -> str:
    """The command that runs one of a campaign's runs again: ``--sample 42``, ``--worst-case overshoot_percent``."""
    return f"flexhinf campaign replay {shlex.quote(str(folder))} {which}"


# Sentences and tables for a terminal too -----------------------------------------------------------------------
def campaign_verdict(judged: CampaignJudgement) -> str:
    """Number of failures, confidence interval of the success rate, and the worst sample by the main metric."""
    interval, unstable = judged.success, judged.of_status(UNSTABLE) + judged.of_status(DIVERGED)
    text = f"{judged.failures} of {judged.count} failed"
    text += f", {unstable} of them unstable ({unstable_text(judged)})" if unstable else ""
    text += (
        f"; no confidence interval holds for samples spread {SPREAD[judged.method]}"
        if interval is None
        else f"; {interval_text(interval)} succeed with 95 % confidence"
    )
    if (worst := judged.worst_of_all) is None:
        return f"{text}."
    value = own_value_text(judged, judged.main, float(judged.column(judged.main)[worst]))
    return f"{text}; worst {metric_text(judged.main)} {value}, at {sample_changes(judged, worst)} (sample {worst})."


def campaign_design(judged: CampaignJudgement, brief: bool = False) -> str:
    """What is known of the design itself, beside its campaign; "" for a campaign of something else."""
    verdict = verdict_of(judged.table.journal)
    names = (JUDGED.get(rule.metric, "") for rule in judged.requirements)
    return "" if verdict is None else verdict.beside(names, brief)


def journal_design(journal: Journal) -> str:
    """The verdict on the design of a campaign, for one of its runs; "" for a campaign of something else."""
    verdict = verdict_of(journal)
    return "" if verdict is None else f"The design: {verdict.unmet or verdict.brief}."


def unstable_text(judged: CampaignJudgement) -> str:
    """Number of unstable runs that still moved at their end, and number of those that diverged."""
    return (
        f"{judged.of_status(UNSTABLE)} oscillate or run away to the end of the run, "
        f"{judged.of_status(DIVERGED)} diverged"
    )


def worst_text(judged: CampaignJudgement, case: WorstCase) -> str:
    """Result of the search in one sentence: ``worst overshoot found: 2.6 % (1.42 times …), at mass −5 %``."""
    name, sampled = metric_text(case.metric), plant_text(judged, case, case.sampled)
    if not case.worse:
        return f"worst {name}: {sampled} of sample {case.sample}; the search found no worse robot."
    times = "" if math.isnan(case.factor) else f"{number(case.factor, 3)} times "
    numbers, nominal = case.found.numbers, case.nominal.numbers
    at = _changes_text([(n, numbers[n], nominal[n], case.units[n]) for n in by_effect(case)], "{} others")
    value, corner = (plant_text(judged, case, plant) for plant in (case.found, case.corner))
    known = f"{times}the {sampled} of sample {case.sample}; worst corner {corner}"
    return f"worst {name} found: {value} ({known}), at {at}."


def plant_text(judged: CampaignJudgement, case: WorstCase, plant: EvaluatedPlant) -> str:
    """The metric of a plant, or why it has none."""
    done = plant.status == COMPLETED
    return value_text(plant.value, case.unit, in_degrees(judged)) if done else plant.status


def by_effect(case: WorstCase) -> list[str]:
    """Names of the varied numbers, those first whose return to nominal changes the metric most."""
    effect = {name: abs(value - case.found.value) for name, value in case.alone.items()}
    return sorted(effect, key=lambda name: -np.nan_to_num(effect[name], nan=1e300, posinf=1e300))


def missed_by(case: WorstCase, requirements: Sequence[MetricLimit]) -> list[MetricLimit]:
    """Requirements on the metric that the worst plant misses; all of them if its run does not come to its end."""
    own, done = [rule for rule in requirements if rule.metric == case.metric], case.found.status == COMPLETED
    return [rule for rule in own if not (done and rule.met(np.array([case.found.value]))[0])]


def gain_text(row: GainRow, nominal: Mapping[str, float]) -> str:
    """``∫|z|²/∫|d|² 5.1·10³, 77 % of γ² of the synthesis: nominal robot, true state``."""
    of = "the proved γ²" if row.claim == "proved" else f"γ² of the {row.pair}"
    robot = "nominal robot" if row.robot == "nominal" else f"worst robot found ({gain_changes(row, nominal)})"
    return (
        f"worst disturbance found: ∫|z|²/∫|d|² = {square_text(row.gain)}, {share_text(row)} of {of}: {robot}, "
        f"{'the true state fed back' if row.loop == 'true state' else 'with the estimator'}."
    )


def square_text(gain: float) -> str:
    """The square of a gain as text; infinite where a run diverged."""
    return "infinite" if math.isinf(gain) else number(gain**2, 4)


def share_text(row: GainRow) -> str:
    """The attained ∫|z|²/∫|d|² in per cent of γ²."""
    return "more" if math.isinf(row.gain) else f"{number(100.0 * (row.gain / row.gamma) ** 2, 3)} %"


def gain_changes(row: GainRow, nominal: Mapping[str, float]) -> str:
    """The robot that a disturbance was searched for, by all its numbers that are not nominal."""
    numbers = [(name, value, nominal.get(name), "") for name, value in row.numbers.items()]
    return _changes_text(numbers, most=len(numbers))


def replay_table(replay: Replayed) -> Terminal:
    """Table of a sample that was run again: its numbers and metrics, as stored and now."""
    state = ("the same bits" if replay.same else "differs") if replay.recorded else "not in the table yet"
    return _again_table(
        f"sample {replay.sample}: {replay.run.status}; {state}",
        [
            (name, replay.recorded.get(name, "–"), value)
            for name, value in replay.again.items()
            if name not in ("sample", "failure") and value == value
        ],
        "table",
    )


def worst_table(case: WorstCase, again: EvaluatedPlant) -> Terminal:
    """Table of the worst plant, run again: its numbers and the metric, as stored and now."""
    same = again == case.found or (again.status == case.found.status != COMPLETED)
    return _again_table(
        f"worst {metric_text(case.metric)}: {again.status}; {'the same bits' if same else 'differs'}",
        [(case.metric, case.found.value, again.value)]
        + [(n, v, again.numbers[n]) for n, v in case.found.numbers.items()],
    )


def gain_replay_table(rows: Sequence[GainRow], again: Sequence[float]) -> Terminal:
    """Table of the attained gains, as stored and run again."""
    same = all(row.gain == value for row, value in zip(rows, again))
    cells = [(f"{r.robot}, {r.loop}, {r.pair}", r.gain, value, r.gamma) for r, value in zip(rows, again)]
    return _again_table(f"worst disturbances: {'the same bits' if same else 'differ'}", cells, "found", "γ")


def _again_table(title: str, rows: Iterable[Sequence[object]], before: str = "found", *more: str) -> Terminal:
    texts = [[f"{x:.10g}" if isinstance(x, float) else str(x) for x in row] for row in rows]
    return Table(("", before, "run again", *more), texts, title).terminal()


# Page and panels ----------------------------------------------------------------------------------------
def write_page(folder: Path, what: str, page: Page) -> Path:
    """Write index.html of a folder, whole or not at all; returns its path."""
    text, path = page.html(), folder / "index.html"
    write_file(path, what, lambda name: Path(name).write_text(text, encoding="utf-8"))
    return path


def small_panels(
    count: int, height: float, columns: int = 3, sharex: bool = False
) -> tuple[Canvas, list[Axes]]:
    """A figure with `count` panels in rows of at most `columns`, each row `height` inches high."""
    columns = min(columns, count)
    rows = -(-count // columns)
    figure, grid = panels(rows, columns, 0.4 + height * rows, sharex=sharex)
    axes = [axis for row in grid for axis in row]
    for axis in axes[count:]:
        axis.set_visible(False)
    return figure, axes[:count]


def few_ticks(axis: Axes, largest: float, which: Literal["both", "x"] = "both") -> None:
    """Few ticks with short numbers, of size up to `largest`."""
    axis.locator_params(axis=which, nbins=3 if largest > 5e-3 else 1)
    for ruler in (axis.xaxis,) if which == "x" else (axis.xaxis, axis.yaxis):
        ruler.set_major_formatter(_short)


def _short(value: float, place: object = None) -> str:
    """A number beside an axis of a small panel: 0.0001 would touch 0.0002."""
    text = number(value, 3)
    return text if len(text) < 6 else np.format_float_scientific(value, 2, trim="-", exp_digits=1)


def histogram(
    axis: Axes, judged: CampaignJudgement, name: str, unit: str, values: np.ndarray, counted: str
) -> None:
    """Draw a histogram of a metric; bins of a time are as wide as a multiple of the kept period."""
    time, spread = judged.table.journal.time, float(np.ptp(values))
    period = float(np.diff(time[:2])[0]) if time.size > 1 and unit == "s" else 0.0
    half = 0.5 * abs(float(values[0])) or 0.5
    bins = (
        histogram_bins(values, period if 10.0 * period < spread else 0.0).tolist()
        if spread
        else [float(values[0]) - half, float(values[0]) + half]
    )
    axis.hist(values, bins=bins, color=SERIES[0], alpha=0.55)
    axis.grid(axis="x", visible=False)
    axis.set_xlabel(fill(metric_text(name, unit), 16))
    label(axis, counted, "")


# Two designs on the same samples ------------------------------------------------------------------------
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
    rows = setting_rows(result.judged[0])
    stated = [Setting(*row) for row in rows if not row[0].startswith("design ")]
    with house_style():  # once for all figures
        blocks = [*_success(result), *_differences(result, varied[:6]), *_extremes(result, varied)]
    return write_page(
        result.folder,
        "report of the comparison",
        Page(
            f"Two designs on the same robots “{result.a.request.robot.name}”",
            f"{result.paired.count} robots, each with its own measurement noise, run twice for "
            f"{short_numbers(settings['duration'])} s: with the controller A of {result.names[0]} and "
            f"with the controller B of {result.names[1]}.",
            pair_verdict(result),
            (Section("A against B", blocks, "pair", True),),
            Settings({"Samples": stated}),
            Provenance(shlex.join(result.command), int(settings["seed"])),
            [
                *(
                    KeyNumber(
                        f"fail with {side}", failures, f"of {counts.count}", f"{only} with {side} alone"
                    )
                    for side, failures, only in zip("AB", counts.failures, (counts.only_a, counts.only_b))
                ),
                *(
                    KeyNumber(
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
        ),
    )


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
