"""The worst robots that a search found, in words and in the report of their campaign."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from flexhinf.campaign import CampaignJudgement, FoundPlant, Requirement, WorstCase
from flexhinf.campaign.outcomes import COMPLETED
from flexhinf.design.report.campaign_text import (
    LISTED,
    campaign_verdict,
    change_text,
    limit_text,
    metric_text,
    percent_change,
    replay_command,
    value_text,
)
from flexhinf.design.report.drawing import figure_block
from flexhinf.loop import Trajectory
from flexhinf.report import (
    INK,
    SERIES,
    Listing,
    Paragraph,
    Section,
    Status,
    Table,
    house_style,
    label,
    legend,
    new_figure,
    number,
)

Runs = Callable[[WorstCase, FoundPlant], Trajectory]

#: Half height of the panel close to the end, relative to the way of the signal.
CLOSE = 0.12


def worst_text(case: WorstCase) -> str:
    """What the search found, in one sentence: ``worst overshoot found: 2.6 %, 1.42 times …, at mass −5 %``."""
    name, sampled = metric_text(case.metric), found_text(case, case.sampled)
    if not case.worse:
        return f"worst {name}: {sampled} of sample {case.sample}; the search found no worse robot."
    times = "" if math.isnan(case.factor) else f"{number(case.factor, 3)} times "
    return (
        f"worst {name} found: {found_text(case, case.found)} ({times}the {sampled} of sample {case.sample}), "
        f"at {_numbers(case)}."
    )


def found_text(case: WorstCase, plant: FoundPlant) -> str:
    """The metric of a plant, or why it has none."""
    return value_text(plant.value, case.unit) if plant.status == COMPLETED else plant.status


def missed_by(case: WorstCase, requirements: Sequence[Requirement]) -> list[Requirement]:
    """The requirements of its metric that the worst plant misses, all where its run does not come to its end."""
    ended = case.found.status == COMPLETED
    return [
        one for one in requirements
        if one.metric == case.metric and not (ended and one.met(np.array([case.found.value]))[0])
    ]  # fmt: skip


def worst_verdict(judged: CampaignJudgement, cases: Sequence[WorstCase]) -> str:
    """The verdict of a campaign, with what was found of the main metric, or else of the first one."""
    case = next((one for one in cases if one.metric == judged.main), next(iter(cases), None))
    text = campaign_verdict(judged)
    return text if case is None else f"{text} Search: {worst_text(case)}"


def campaign_statuses(judged: CampaignJudgement, cases: Sequence[WorstCase]) -> list[Status]:
    """How many samples fail, and which requirements a robot that was found misses."""
    found = [
        Status(
            "not met",
            f"A search found a robot within the tolerances that misses {metric_text(one.metric)} "
            f"({limit_text(one, case.unit)}).",
        )
        for case in cases
        for one in missed_by(case, judged.requirements)
    ]
    if judged.failures:
        return [Status("not met", f"{judged.failures} of {judged.count} samples fail."), *found]
    searched = " and the worst robot found by search" if cases else ""
    text = f"Every one of {judged.count} samples{searched}; that is no proof for the robots between."
    return found or [Status("met", text)]


def _ordered(case: WorstCase) -> list[str]:
    """The numbers, those first whose return to nominal changes the metric most."""
    effect = {name: abs(value - case.found.value) for name, value in case.alone.items()}
    return sorted(effect, key=lambda name: -np.nan_to_num(effect[name], nan=1e300, posinf=1e300))


def _numbers(case: WorstCase) -> str:
    """The numbers of the plant found in a sentence."""
    numbers, nominal = case.found.numbers, case.nominal.numbers
    found = [change_text(name, numbers[name], nominal[name], case.units[name]) for name in _ordered(case)]
    found = [text for text in found if text]
    more = [f"{len(found) - LISTED} others"] if len(found) > LISTED else []
    return ", ".join([*found[:LISTED], *more]) or "nominal numbers"


def worst_table(case: WorstCase, again: FoundPlant) -> Any:
    """The worst plant that was run again: its numbers and the metric, in the folder and now."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table as Terminal

    same = again == case.found or (again.status == case.found.status != COMPLETED)
    title = f"worst {metric_text(case.metric)}: {again.status}; {'the same bits' if same else 'differs'}"
    table = Terminal(title=title, box=SIMPLE_HEAD, title_justify="left")
    for column in ("", "found", "run again"):
        table.add_column(column, justify="left" if not column else "right")
    table.add_row(case.metric, f"{case.found.value:.10g}", f"{again.value:.10g}")
    for name, value in case.found.numbers.items():
        table.add_row(name, f"{value:.10g}", f"{again.numbers[name]:.10g}")
    return table


# The section ------------------------------------------------------------------------------------------------------
def worst_section(judged: CampaignJudgement, cases: Sequence[WorstCase], runs: Runs | None) -> Section:
    """What was found for each metric, and the worst run of the one nearest its limit."""
    if not cases:
        return Section("Worst case", [], "worst-case")
    rows = []
    for case in cases:
        limits = [one for one in judged.requirements if one.metric == case.metric]
        limit = "; ".join(limit_text(one, case.unit) for one in limits) or "–"
        rows.append((
            metric_text(case.metric), found_text(case, case.nominal),
            f"{found_text(case, case.sampled)} ({case.sample})", found_text(case, case.found),
            "–" if math.isnan(case.factor) else number(case.factor, 3), limit,
            f"{case.together} of {case.starts}" if case.worse else "none",
        ))  # fmt: skip
    columns = (
        "metric", "nominal", "worst sample", "worst found", "times", "limit", "searches that end there",
    )  # fmt: skip
    case = max(cases, key=lambda one: _use(one, judged.requirements))
    text = worst_text(case)
    return Section("Worst case", [
        Paragraph(_method(cases)),
        Table(columns, rows, "The worst robot inside the box of tolerances", "table-worst-case", stacks=True),
        *([] if runs is None else _figure(judged, case, runs)),
        Paragraph(f"{text[0].upper()}{text[1:]} This command, in the folder above, runs it again:"),
        Listing(replay_command(judged.table.journal.folder.name, f"--worst-case {case.metric}")),
        _table_of_numbers(case),
    ], "worst-case")  # fmt: skip


def _use(case: WorstCase, requirements: Sequence[Requirement]) -> float:
    """How much of its limit the worst plant uses; −1 where it has none."""
    if case.found.status != COMPLETED:
        return math.inf
    limits = [
        one.limit for one in requirements if one.metric == case.metric and one.at_most and one.limit > 0.0
    ]
    return max((case.found.value / limit for limit in limits), default=-1.0)


def _method(cases: Sequence[WorstCase]) -> str:
    case = cases[0]
    began = "the worst samples, the worst corners of the box and random points" if case.all_corners else (
        "the worst samples and random points of the box")  # fmt: skip
    every = f"; each of the {1 << len(case.intervals)} corners was run" if case.all_corners else ""
    outside = (
        f" {case.outside} samples lie outside the box, since their distribution is not cut off; they are not compared."
        if case.outside else ""
    )  # fmt: skip
    return (
        f"{case.starts} searches for each metric, by gradients from differences and smaller and smaller steps, begin "
        f"at {began}{every}: {sum(one.runs for one in cases)} runs in all. The box is that of the tolerances, its ends "
        "included. All runs of a search have the measurement noise of the worst sample; noise is not searched, since "
        f"it has no bounds. What is found is a lower bound of the worst value inside the box, not a proof.{outside}"
    )


def _table_of_numbers(case: WorstCase) -> Table:
    rows = []
    for name in _ordered(case):
        value, (low, high) = case.found.numbers[name], case.intervals[name]
        place = "lowest" if value == low else "highest" if value == high else "inside"
        change = percent_change(name, value, case.nominal.numbers[name]) or "–"
        rows.append((
            name.replace("_", " "), number(value, 6), case.units[name], change, place,
            value_text(case.alone[name], case.unit),
        ))  # fmt: skip
    columns = (
        "number",
        "value",
        "unit",
        "change",
        "in its interval",
        f"{metric_text(case.metric)} with it alone nominal",
    )
    return Table(
        columns, rows, f"The robot with the worst {metric_text(case.metric)} found", "table-worst-numbers"
    )


def _figure(judged: CampaignJudgement, case: WorstCase, runs: Runs) -> list[Any]:
    """The tracked signal that differs most, its end, and the input that does, of three runs with one noise."""
    plants = {"worst found": case.found, f"sample {case.sample}": case.sampled, "nominal": case.nominal}
    drawn = {name: runs(case, plant) for name, plant in plants.items() if plant.status == COMPLETED}
    if len(drawn) < len(plants):
        return []
    worst, _, nominal = drawn.values()
    names = [name.removeprefix("trace.") for name in judged.table.names("trace")]
    signal = max(
        names, key=lambda name: float(np.abs(worst.tracked(name) - nominal.tracked(name)).max()), default=None
    )
    if signal is None:
        return []
    moved = np.abs(worst.signals["input"] - nominal.signals["input"]).max(axis=0)
    u = worst.names["input"][int(np.argmax(moved))]
    figure, axes = new_figure(3)
    styles: tuple[dict[str, Any], ...] = (
        {"color": SERIES[1]},
        {"color": INK, "dashes": (5.0, 1.5)},
        {"color": SERIES[0]},
    )
    with house_style():
        for (name, run), style in zip(drawn.items(), styles):
            for axis, values in zip(axes, (run.tracked(signal), run.tracked(signal), run.signal("input", u))):
                axis.plot(run.time, values, linewidth=1.1, label=name, **style)
    reached, way = nominal.tracked(signal)[-1], float(np.ptp(nominal.tracked(signal)))
    axes[1].set_ylim(reached - (CLOSE * way or 1e-3), reached + (CLOSE * way or 1e-3))
    for axis, name, kind in zip(axes, (signal, signal, u), ("state", "state", "input")):
        label(axis, name.replace("_", " "), dict(zip(worst.names[kind], worst.units[kind])).get(name, ""))
    legend(axes[0])
    caption = [
        f"The robot with the worst {metric_text(case.metric)} that was found, the worst sample and the nominal robot, "
        f"all with the noise of sample {case.sample}. Middle: {signal.replace('_', ' ')} close to where it ends.",
    ]  # fmt: skip
    return [figure_block("worst-case", figure, caption, "The worst run")]
