"""The worst robots that a search found, in words and in the report of their campaign.

A campaign in words: the verdict in one line, samples by their numbers, limits, the table of a replay.

The worst disturbances of a campaign's design, in words, as a table and as a figure.
"""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from flexhinf.campaign import CampaignJudgement, FoundPlant, Replayed, Requirement, WorstCase
from flexhinf.campaign.metrics import COMPLETED, DIVERGED, NOT_RUN, UNSTABLE
from flexhinf.design.campaign_gain import GainResults, GainRow
from flexhinf.loop import Trajectory
from flexhinf.pages.drawing import figure_block
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

#: Names of metrics in sentences; others are written with spaces.
WORDS = {
    "overshoot_percent": "overshoot", "settling_time_s": "settling time", "rise_time_s": "rise time",
    "tracking_rmse": "RMS tracking error", "estimation_rmse": "RMS estimation error",
    "estimation_error": "largest estimation error", "input_limit_use": "use of the input's limit",
    "speed_limit_use": "use of the speed's limit", "tracking_error_use": "use of the tracking error's limit",
    "tracking_error": "tracking error", "final_error_use": "use of the limit after the move",
    "final_error": "distance after the move",
}  # fmt: skip

#: How samples are spread, in a sentence.
SPREAD = {
    "random": "independently", "latin-hypercube": "by a Latin hypercube", "sobol": "by a Sobol sequence",
}  # fmt: skip

#: Numbers of a sample that are listed.
LISTED = 4

#: Time limits beyond this are no limits: the run only has to get there.
ENDLESS = 1e8


def campaign_verdict(judged: CampaignJudgement) -> str:
    """How many fail, with what confidence, and the worst of the main metric with its parameters."""
    found, unstable = judged.success, judged.of_status(UNSTABLE) + judged.of_status(DIVERGED)
    text = f"{judged.failures} of {judged.count} failed"
    text += f", {unstable} of them unstable ({unstable_text(judged)})" if unstable else ""
    if found is None:
        text += f"; no confidence interval holds for samples spread {SPREAD[judged.method]}"
    else:
        text += f"; {percent_text(found.low)} to {percent_text(found.high)} succeed with 95 % confidence"
    worst = judged.worst_of_all
    if worst is not None:
        value = float(judged.column(judged.main)[worst])
        shown = value_text(value, judged.table.unit(judged.main))
        text += f"; worst {metric_text(judged.main)} {shown}, at {changes(judged, worst)}"
    return f"{text} (sample {worst})." if worst is not None else f"{text}."


def unstable_text(judged: CampaignJudgement) -> str:
    """How many of the unstable runs moved on to their end, and how many diverged."""
    return (
        f"{judged.of_status(UNSTABLE)} oscillate or run away to the end of the run, "
        f"{judged.of_status(DIVERGED)} diverged"
    )


def replay_command(folder: Path | str, which: str) -> str:
    """The command that runs one of a campaign's runs again: ``--sample 42``, ``--worst-case overshoot_percent``."""
    return f"flexhinf campaign replay {shlex.quote(str(folder))} {which}"


def metric_text(metric: str) -> str:
    """A metric in a sentence; of a joint with its name behind it."""
    whole = next((name for name in WORDS if metric.startswith(f"{name}_")), "")
    if whole and metric not in WORDS:
        return f"{WORDS[whole]} {metric.removeprefix(f'{whole}_').replace('_', ' ')}"
    return WORDS.get(metric, metric.replace("_", " "))


def changes(judged: CampaignJudgement, sample: int) -> str:
    """A sample by its numbers that are furthest from nominal, for their spread: ``stiffness −12 %``."""
    found = []
    for name, value in judged.numbers(sample).items():
        column, old = judged.column(name), judged.nominal.get(name)
        spread = float(column.std())
        middle = float(column.mean()) if old is None else old
        if spread <= 0.0 or value == middle:
            continue
        text = change_text(name, value, old, judged.table.unit(name))
        found.append((abs(value - middle) / spread, text))
    ordered = [text for _, text in sorted(found, key=lambda one: -one[0])]
    return (
        ", ".join([*ordered[:LISTED], *(["others by less"] if len(ordered) > LISTED else [])])
        or "nominal numbers"
    )


def change_text(name: str, value: float, nominal: float | None, unit: str) -> str:
    """A number of a sample against its nominal one: ``stiffness −12 %``; empty where it is nominal."""
    text = percent_change(name, value, nominal) or value_text(value, unit)
    return "" if value == nominal else f"{name.replace('_', ' ')} {text}"


def percent_change(name: str, value: float, nominal: float | None) -> str:
    """Per cent of the nominal number; empty where that is zero, not known, or a payload's."""
    if not nominal or "payload" in name:
        return ""
    change = 100.0 * (value / nominal - 1.0)
    return f"{'+' if change > 0.0 else ''}{number(change, 2)} %"


def percent_text(fraction: float) -> str:
    """A fraction with the digits that tell it from zero and from one."""
    if fraction in (0.0, 1.0):
        return f"{100 * fraction:.0f} %"
    if fraction < 0.01:
        return f"{number(100 * fraction, 2)} %"
    digits = int(np.clip(np.ceil(-np.log10(1.0 - fraction)), 1, 6)) if fraction > 0.5 else 1
    return f"{100 * fraction:.{digits}f} %"


def value_text(value: float, unit: str) -> str:
    """A number with its unit; infinity is a time that is never reached."""
    if np.isinf(value):
        return "never"
    return f"{number(value, 3)} {unit}".strip()


def limit_text(one: Requirement, unit: str) -> str:
    """The limit of a requirement."""
    if one.at_most and one.limit >= ENDLESS:
        return "within the run"
    return f"at {'most' if one.at_most else 'least'} {value_text(one.limit, unit)}"


def reasons_text(judged: CampaignJudgement, sample: int) -> str:
    """Why a sample fails: its status, or the requirements that it misses."""
    status = str(judged.column("status")[sample])
    if status == NOT_RUN:
        return f"not run: {judged.column('failure')[sample]}"
    if status == DIVERGED:
        return f"diverged at {judged.column('diverged_at_s')[sample]:g} s"
    found = ["unstable to the end of the run"] if status == UNSTABLE else []
    for one in judged.missed(sample):
        value = float(judged.column(one.metric)[sample])
        found.append(f"{metric_text(one.metric)} {value_text(value, judged.table.unit(one.metric))}")
    return ", ".join(found)


def replay_table(found: Replayed) -> Any:
    """A sample that was run again: its numbers and metrics, in the table and now."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table as Terminal

    state = (
        "the same bits"
        if found.same and found.recorded
        else "not in the table yet"
        if found.same
        else "differs"
    )
    table = Terminal(
        title=f"sample {found.sample}: {found.run.status}; {state}", box=SIMPLE_HEAD, title_justify="left"
    )
    for column in ("", "table", "run again"):
        table.add_column(column, justify="left" if not column else "right")
    for name, value in found.again.items():
        if name not in ("sample", "failure") and value == value:
            old = found.recorded.get(name, "–")
            table.add_row(name, *(f"{v:.10g}" if isinstance(v, float) else str(v) for v in (old, value)))
    return table


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


CLAIMS = {"designed": "designed for", "proved": "proved", "not claimed": "designed for another loop"}


def gain_text(row: GainRow, nominal: Mapping[str, float]) -> str:
    """``∫|z|²/∫|d|² 5.1·10³, 77 % of γ² of the synthesis: nominal robot, true state``."""
    of = "the proved γ²" if row.claim == "proved" else f"γ² of the {row.pair}"
    robot = "nominal robot" if row.robot == "nominal" else f"worst robot found ({_changes(row, nominal)})"
    return (
        f"worst disturbance found: ∫|z|²/∫|d|² = {_square(row.gain)}, {_share(row)} of {of}: {robot}, "
        f"{'the true state fed back' if row.loop == 'true state' else 'with the estimator'}."
    )


def _square(gain: float) -> str:
    return "infinite" if math.isinf(gain) else number(gain**2, 4)


def _share(row: GainRow) -> str:
    return "more" if math.isinf(row.gain) else f"{number(100.0 * (row.gain / row.gamma) ** 2, 3)} %"


def _changes(row: GainRow, nominal: Mapping[str, float]) -> str:
    found = [change_text(name, value, nominal.get(name), "") for name, value in row.numbers.items()]
    return ", ".join(text for text in found if text) or "nominal numbers"


def gain_statuses(found: GainResults) -> list[Status]:
    """Rows that no theorem allows: a proof or this program is wrong."""
    return [
        Status("not proved", "A disturbance attains more than the proved γ: the proof or the loop is wrong.")
        for row in found.rows
        if row.claim == "proved" and not row.kept
    ]


def gain_section(judged: CampaignJudgement, found: GainResults) -> Section:
    """What each search attained, against the level that belongs to it."""
    rows = found.rows
    if not rows:
        return Section("Worst disturbance", [], "worst-disturbance")
    cells = [
        (
            "nominal" if row.robot == "nominal" else "worst found",
            row.loop, f"of the {row.pair}", _square(row.gain), number(row.gamma**2, 4), _share(row), CLAIMS[row.claim],
        )
        for row in rows
    ]  # fmt: skip
    columns = ("robot", "loop", "z and d", "attained ∫|z|²/∫|d|²", "γ²", "share", "γ is")
    worst = next((row for row in rows if row.robot == "worst"), None)
    numbers = "" if worst is None else f" The worst robot found: {_changes(worst, judged.nominal)}."
    text = (
        "Finite-energy disturbances from rest at the goal, found by power iteration on the gradient of ∫|z|², under "
        "which V stays inside the sampled or proved level. Where a robot within the tolerances is searched too, robot "
        "and disturbance are improved in turn, each robot about its own equilibrium. Inputs are held for a period. "
        "An attained gain is a lower bound. A designed γ is that of the nominal robot with the true state; a proved "
        "one holds for the z, d, robots and level of its certificate, and for the loop with the true state alone."
        f"{numbers}{f' No γ is proved of this law: {found.unproved}.' if found.unproved else ''}"
    )
    return Section("Worst disturbance", [
        Paragraph(text), Table(columns, cells, "Attained gains", "table-worst-disturbance", stacks=True),
        _gain_figure(rows),
        Paragraph("This command, in the folder above, runs the disturbances again:"),
        Listing(replay_command(judged.table.journal.folder.name, "--worst-case gain")),
    ], "worst-disturbance")  # fmt: skip


def _gain_figure(rows: Sequence[GainRow]) -> Any:
    """The first channel of each disturbance."""
    figure, (axis,) = new_figure(1)
    styles: tuple[dict[str, Any], ...] = (
        {"color": SERIES[0]}, {"color": SERIES[1]}, {"color": INK, "dashes": (5.0, 1.5)}, {"color": SERIES[2]},
    )  # fmt: skip
    with house_style():
        for row, style in zip(rows, styles):
            name = f"{row.robot}, {row.loop}, {row.pair}"
            values = np.array(row.disturbance)[:, 0]
            axis.plot(row.times, values, linewidth=1.1, label=name, **style)
    label(axis, rows[0].names[0].replace("_", " "), "")
    axis.set_xlabel("time (s)")
    legend(axis)
    return figure_block(
        "worst-disturbance", figure, "The first component of d.", "The worst disturbances found"
    )


def gain_replay_table(rows: Sequence[GainRow], again: Sequence[float]) -> Any:
    """Gains in the folder, and run again."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table as Terminal

    same = all(row.gain == value for row, value in zip(rows, again))
    title = f"worst disturbances: {'the same bits' if same else 'differ'}"
    table = Terminal(title=title, box=SIMPLE_HEAD, title_justify="left")
    for column in ("", "found", "run again", "γ"):
        table.add_column(column, justify="left" if not column else "right")
    for row, value in zip(rows, again):
        name = f"{row.robot}, {row.loop}, {row.pair}"
        table.add_row(name, f"{row.gain:.10g}", f"{value:.10g}", f"{row.gamma:.10g}")
    return table
