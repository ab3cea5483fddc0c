"""The report of a campaign: success rate, worst robot and disturbance found, signals, distributions, sensitivities."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from flexhinf.campaign import (
    CampaignJudgement,
    FoundPlant,
    MergedTable,
    Requirement,
    WorstCase,
    stored_worsts,
)
from flexhinf.campaign.batches import PART, TRACE
from flexhinf.campaign.metrics import COMPLETED, DIVERGED, NOT_RUN, UNDAMPED, UNSTABLE
from flexhinf.design.campaign_gain import GainResults, stored_gains
from flexhinf.files import write_file
from flexhinf.loop import Trajectory
from flexhinf.pages.campaign_text import (
    METRIC_LABELS,
    NO_LIMIT,
    SPREAD,
    by_effect,
    campaign_verdict,
    changes,
    found_text,
    gain_changes,
    limit_text,
    metric_text,
    missed_by,
    percent_change,
    percent_text,
    replay_command,
    share_text,
    square_text,
    unbroken,
    unstable_text,
    value_text,
    worst_text,
)
from flexhinf.pages.design.step import histogram_bins
from flexhinf.pages.drawing import DASHED, figure_block, panels
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
    Status,
    Table,
    house_style,
    label,
    legend,
    new_figure,
    number,
    quantile_band,
)

Run = Callable[[int], Trajectory]
PlantRun = Callable[[WorstCase, FoundPlant], Trajectory]

#: What a level γ belongs to, by the claim of a `GainRow`.
CLAIMS = {"designed": "designed for", "proved": "proved", "not claimed": "designed for another loop"}

#: Failures that are listed, metrics whose sensitivity is drawn, and bars of each.
FAILURES, RANKED, BARS = 20, 4, 8

#: Half height of the panel close to the end, relative to the way of the signal.
CLOSE = 0.12

#: What `flexhinf.campaign.metrics` calls unstable.
UNSTABLE_MEANS = (
    "A run is unstable if it diverges to numbers that are not finite, or if, in the last third of the time in which "
    "command and disturbance stand still, a joint still swings by more than the settling band of ±2 % of its step, by "
    f"at least {100 * UNDAMPED:.0f} % of its swing in the second third, and either to and fro over the same positions "
    "or further from the command than before."
)


# Page --------------------------------------------------------------------------------------------------------
def write_campaign(
    table: MergedTable,
    requirements: Sequence[Requirement],
    run: Run | None = None,
    plant_run: PlantRun | None = None,
) -> CampaignJudgement:
    """Write index.html beside the table, with the worst cases that are kept there; returns what the page says.

    Parameters
    ----------
    run : callable, optional
        Sample → its run, for a worst run whose signals are not kept.
    plant_run : callable, optional
        Worst case and one of its plants → the run of that plant.
    """
    judged = CampaignJudgement(table, tuple(requirements))
    page = campaign_page(judged, run, stored_worsts(table.journal), plant_run)
    write_page(table.journal.folder, "report of the campaign", page)
    return judged


def write_page(folder: Path, what: str, page: Page) -> Path:
    """Write index.html of a folder, whole or not at all; returns its path."""
    text, path = page.html(), folder / "index.html"
    write_file(path, what, lambda name: Path(name).write_text(text, encoding="utf-8"))
    return path


def campaign_page(
    judged: CampaignJudgement,
    run: Run | None = None,
    worst: Sequence[WorstCase] = (),
    plant_run: PlantRun | None = None,
) -> Page:
    """Everything on one page; arguments as `write_campaign`."""
    journal, settings = judged.table.journal, judged.table.journal.settings
    gains = stored_gains(journal)
    with house_style():
        parts = (
            Section("Success", _success(judged), "success"),
            Section("Worst case", _worst_case(judged, worst, plant_run), "worst-case"),
            Section("Worst disturbance", _worst_disturbance(judged, gains), "worst-disturbance"),
            Section("Signals", _signals(judged, run), "signals"),
            Section("Metrics", _metrics(judged), "metrics"),
            Section("What matters", _sensitivities(judged), "sensitivity"),
            Section("Failures", _failures(judged), "failures"),
        )
    how = f", spread {SPREAD[judged.method]}" if "method" in settings else ""
    asked = (
        f"{judged.count} loops of {settings['duration']} s with the same controller, each with its own measurement "
        f"noise and with {len(judged.table.names('parameter'))} numbers of its own{how}."
    )
    case = next((one for one in worst if one.metric == judged.main), next(iter(worst), None))
    search = "" if case is None else f" Search: {worst_text(case)}"
    return Page(
        journal.about.get("title", "Campaign"), asked, f"{campaign_verdict(judged)}{search}",
        tuple(section for section in parts if section.blocks), Settings(_settings(settings)),
        Provenance(tuple(journal.manifest.get("command", ())), int(settings["seed"])), _key_numbers(judged),
        _statuses(judged, worst, gains),
    )  # fmt: skip


def _key_numbers(judged: CampaignJudgement) -> list[KeyNumber]:
    interval = judged.success
    sure = f"95 %: {percent_text(interval.low)} to {percent_text(interval.high)}" if interval else (
        f"no interval: spread {SPREAD[judged.method]}")  # fmt: skip
    unstable = judged.of_status(UNSTABLE) + judged.of_status(DIVERGED)
    found = [KeyNumber("success", percent_text(judged.rate), note=sure)]
    found.append(KeyNumber("unstable", unstable, f"of {judged.count}", unstable_text(judged)))
    names = [n for n in judged.table.names("metric") if n in METRIC_LABELS or n.startswith("peak")][:4]
    for name in names:
        worst, unit = judged.worst(name), judged.table.unit(name)
        if worst is not None:
            *_, median, _, largest = judged.quantiles(name)
            note = f"median {value_text(float(median), unit)}; sample {worst}"
            shown = ("never", "") if np.isinf(largest) else (largest, unit)
            found.append(KeyNumber(f"worst {metric_text(name)}", *shown, note))
    return found


def _statuses(judged: CampaignJudgement, cases: Sequence[WorstCase], gains: GainResults) -> list[Status]:
    """How many samples fail, which requirements a robot that was found misses, and gains that no theorem allows."""
    found = (
        [Status("not met", f"{judged.failures} of {judged.count} samples fail.")] if judged.failures else []
    )
    found += [
        Status(
            "not met",
            f"A search found a robot within the tolerances that misses {metric_text(one.metric)} "
            f"({limit_text(one, case.unit)}).",
        )
        for case in cases
        for one in missed_by(case, judged.requirements)
    ]
    if not found:
        searched = " and the worst robot found by search" if cases else ""
        text = f"Every one of {judged.count} samples{searched}; that is no proof for the robots between."
        found = [Status("met", text)]
    wrong = [row for row in gains.rows if row.claim == "proved" and not row.kept]
    text = "A disturbance attains more than the proved γ: the proof or the loop is wrong."
    return found + [Status("not proved", text) for _ in wrong]


def _settings(settings: dict[str, str]) -> dict[str, list[Setting]]:
    groups: dict[str, list[Setting]] = {"Campaign": [], "Numbers that differ": [], "Design": [], "Robot": []}
    heads = {
        "variable ": "Numbers that differ",
        "design ": "Design",
        "robot ": "Robot",
        "true robot ": "Robot",
    }
    for name, value in settings.items():
        head = next((head for head in heads if name.startswith(head)), "")
        shown = name.removeprefix(head) if head != "true robot " else name
        groups[heads.get(head, "Campaign")].append(Setting(shown, value))
    return {name: group for name, group in groups.items() if group}


# Success and failures ----------------------------------------------------------------------------------------
def _success(judged: CampaignJudgement) -> list[Any]:
    ends = judged.of_status(DIVERGED) + judged.of_status(NOT_RUN)
    kept = [("reaches the end of the run", "", ends)]
    kept.append(("is stable there", "", ends + judged.of_status(UNSTABLE)))
    for k, one in enumerate(judged.requirements):
        limit = limit_text(one, judged.table.unit(one.metric))
        kept.append((metric_text(one.metric), limit, int(judged.violations[:, k].sum())))
    rows = [(name, limit, bad, percent_text(1.0 - bad / judged.count)) for name, limit, bad in kept]
    interval = (
        "The interval of the rate is that of Clopper and Pearson, exact for independent samples."
        if judged.success else
        f"The samples are spread {SPREAD[judged.method]} and not independent, so no confidence interval of the rate is "
        "known from this campaign alone; how much rates of campaigns with other seeds differ says how sure it is, and "
        "`--method random` has an exact interval."
    )  # fmt: skip
    text = (
        "A sample is a success if its run reaches its end, is stable there, and keeps every requirement. "
        f"{interval} The rate is a statement about the distribution that was sampled, not a proof for every robot "
        f"within it. {UNSTABLE_MEANS}"
    )
    columns = ("requirement", "limit", "failures", "keep it")
    return [Paragraph(text), Table(columns, rows, "Requirements", "table-success")]


def _failures(judged: CampaignJudgement) -> list[Any]:
    replay = replay_command(judged.table.journal.folder.name, "--sample")
    worst = judged.worst_of_all
    if not judged.failures and worst is None:
        return [Paragraph("No sample fails.")]
    if not judged.failures:
        text = "No sample fails. This command, in the folder above, runs the worst one again:"
        return [Paragraph(text), Listing(f"{replay} {worst}")]
    rows = [
        (int(k), _reasons_text(judged, int(k)), unbroken(changes(judged, int(k))), f"`{replay} {int(k)}`")
        for k in judged.failed[:FAILURES]
    ]
    listed = f" The {FAILURES} worst are listed; all are in samples.parquet."
    text = f"{judged.failures} samples fail. The last column runs one again, in the folder above."
    columns = ("sample", "why", "its numbers", "replay")
    return [
        Paragraph(text + (listed if judged.failures > FAILURES else "")),
        Table(columns, rows, "Failures", "table-failures", stacks=True),
    ]


def _reasons_text(judged: CampaignJudgement, sample: int) -> str:
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


# Worst robot -------------------------------------------------------------------------------------------------
def _worst_case(judged: CampaignJudgement, cases: Sequence[WorstCase], runs: PlantRun | None) -> list[Any]:
    """What was found for each metric, and the worst run of the one nearest its limit."""
    if not cases:
        return []
    rows = []
    for case in cases:
        limits = [one for one in judged.requirements if one.metric == case.metric]
        rows.append((
            metric_text(case.metric), found_text(case, case.nominal),
            f"{found_text(case, case.sampled)} ({case.sample})", found_text(case, case.found),
            "–" if math.isnan(case.factor) else number(case.factor, 3),
            "; ".join(limit_text(one, case.unit) for one in limits) or "–",
            f"{case.together} of {case.starts}" if case.worse else "none",
        ))  # fmt: skip
    columns = (
        "metric", "nominal", "worst sample", "worst found", "times", "limit", "searches that end there",
    )  # fmt: skip
    case = max(cases, key=lambda one: _limit_use(one, judged.requirements))
    text = worst_text(case)
    return [
        Paragraph(_search_text(cases)),
        Table(columns, rows, "The worst robot inside the box of tolerances", "table-worst-case", stacks=True),
        *([] if runs is None else _worst_figure(judged, case, runs)),
        Paragraph(f"{text[0].upper()}{text[1:]} This command, in the folder above, runs it again:"),
        Listing(replay_command(judged.table.journal.folder.name, f"--worst-case {case.metric}")),
        _worst_numbers(case),
    ]


def _limit_use(case: WorstCase, requirements: Sequence[Requirement]) -> float:
    """How much of its limit the worst plant uses; −1 where it has none."""
    if case.found.status != COMPLETED:
        return math.inf
    own = [one.limit for one in requirements if one.metric == case.metric and one.at_most and one.limit > 0.0]
    return max((case.found.value / limit for limit in own), default=-1.0)


def _search_text(cases: Sequence[WorstCase]) -> str:
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


def _worst_numbers(case: WorstCase) -> Table:
    rows = []
    for name in by_effect(case):
        value, (low, high) = case.found.numbers[name], case.intervals[name]
        place = "lowest" if value == low else "highest" if value == high else "inside"
        change = percent_change(name, value, case.nominal.numbers[name]) or "–"
        alone = value_text(case.alone[name], case.unit)
        rows.append((name.replace("_", " "), number(value, 6), case.units[name], change, place, alone))
    alone = f"{metric_text(case.metric)} with it alone nominal"
    columns = ("number", "value", "unit", "change", "in its interval", alone)
    title = f"The robot with the worst {metric_text(case.metric)} found"
    return Table(columns, rows, title, "table-worst-numbers")


def _worst_figure(judged: CampaignJudgement, case: WorstCase, runs: PlantRun) -> list[Any]:
    """The tracked signal that differs most, its end, and the input that does, of three runs with one noise."""
    plants = {"worst found": case.found, f"sample {case.sample}": case.sampled, "nominal": case.nominal}
    drawn = {name: runs(case, plant) for name, plant in plants.items() if plant.status == COMPLETED}
    names = [name.removeprefix(TRACE) for name in judged.table.names("trace")]
    if len(drawn) < len(plants) or not names:
        return []
    worst, _, nominal = drawn.values()
    signal = max(names, key=lambda name: float(np.abs(worst.tracked(name) - nominal.tracked(name)).max()))
    moved = np.abs(worst.signals["input"] - nominal.signals["input"]).max(axis=0)
    u = worst.names["input"][int(np.argmax(moved))]
    figure, axes = new_figure(3)
    dashed = {"color": INK, "dashes": (5.0, 1.5)}
    styles: tuple[dict[str, Any], ...] = ({"color": SERIES[1]}, dashed, {"color": SERIES[0]})
    with house_style():
        for (name, run), style in zip(drawn.items(), styles):
            for axis, values in zip(axes, (run.tracked(signal), run.tracked(signal), run.signal("input", u))):
                axis.plot(run.time, values, linewidth=1.1, label=name, **style)
    reached, half = nominal.tracked(signal)[-1], CLOSE * float(np.ptp(nominal.tracked(signal))) or 1e-3
    axes[1].set_ylim(reached - half, reached + half)
    for axis, name, kind in zip(axes, (signal, signal, u), ("state", "state", "input")):
        label(axis, name.replace("_", " "), dict(zip(worst.names[kind], worst.units[kind])).get(name, ""))
    legend(axes[0])
    caption = (
        f"The robot with the worst {metric_text(case.metric)} that was found, the worst sample and the nominal robot, "
        f"all with the noise of sample {case.sample}. Middle: {signal.replace('_', ' ')} close to where it ends."
    )
    return [figure_block("worst-case", figure, caption, "The worst run")]


# Worst disturbance -------------------------------------------------------------------------------------------
def _worst_disturbance(judged: CampaignJudgement, found: GainResults) -> list[Any]:
    """What each search attained, against the level that belongs to it."""
    rows = found.rows
    if not rows:
        return []
    cells = [
        (
            "nominal" if row.robot == "nominal" else "worst found",
            row.loop, f"of the {row.pair}",
            square_text(row.gain), square_text(row.gamma), share_text(row), CLAIMS[row.claim],
        )
        for row in rows
    ]  # fmt: skip
    columns = ("robot", "loop", "z and d", "attained ∫|z|²/∫|d|²", "γ²", "share", "γ is")
    worst = next((row for row in rows if row.robot == "worst"), None)
    numbers = "" if worst is None else f" The worst robot found: {gain_changes(worst, judged.nominal)}."
    text = (
        "Finite-energy disturbances from rest at the goal, found by power iteration on the gradient of ∫|z|², under "
        "which V stays inside the sampled or proved level. Where a robot within the tolerances is searched too, robot "
        "and disturbance are improved in turn, each robot about its own equilibrium. Inputs are held for a period. "
        "An attained gain is a lower bound. A designed γ is that of the nominal robot with the true state; a proved "
        "one holds for the z, d, robots and level of its certificate, and for the loop with the true state alone."
        f"{numbers}{f' No γ is proved of this law: {found.unproved}.' if found.unproved else ''}"
    )
    figure, (axis,) = new_figure(1)
    dashed = {"color": INK, "dashes": (5.0, 1.5)}
    styles: tuple[dict[str, Any], ...] = (
        {"color": SERIES[0]},
        {"color": SERIES[1]},
        dashed,
        {"color": SERIES[2]},
    )
    with house_style():
        for row, style in zip(rows, styles):
            name, values = f"{row.robot}, {row.loop}, {row.pair}", np.array(row.disturbance)[:, 0]
            axis.plot(row.times, values, linewidth=1.1, label=name, **style)
    label(axis, rows[0].names[0].replace("_", " "), "")
    axis.set_xlabel("time (s)")
    legend(axis)
    title = "The worst disturbances found"
    return [
        Paragraph(text), Table(columns, cells, "Attained gains", "table-worst-disturbance", stacks=True),
        figure_block("worst-disturbance", figure, "The first component of d.", title),
        Paragraph("This command, in the folder above, runs the disturbances again:"),
        Listing(replay_command(judged.table.journal.folder.name, "--worst-case gain")),
    ]  # fmt: skip


# Signals -----------------------------------------------------------------------------------------------------
def _signals(judged: CampaignJudgement, run: Run | None) -> list[Any]:
    """Signals that are kept, in a panel each, and the one that differs most close to its end; the worst run apart."""
    names = judged.table.names("trace")
    traces = [judged.table.trace(name).astype(float) for name in names]
    ended = np.all([np.isfinite(trace).all(axis=1) for trace in traces], axis=0)
    if not traces or not ended.any():
        return []
    time, worst = judged.table.journal.time, judged.worst_of_all
    lines = _worst_lines(names, traces, ended, time, worst, run)
    close = int(np.argmax([_late_spread(trace[ended]) for trace in traces]))
    figure, axes = new_figure(len(names) + 1)
    for axis, k in zip(axes, (*range(len(names)), close)):
        quantile_band(axis, time, traces[k][ended])
        if lines:
            with house_style():
                axis.plot(
                    time, lines[k], color=INK, linewidth=1.1, dashes=(5.0, 1.5), label=f"sample {worst}"
                )
        label(axis, names[k].removeprefix(TRACE).replace("_", " "), judged.table.unit(names[k]))
    last = float(np.median(traces[close][ended, -1]))
    half = CLOSE * float(np.ptp(traces[close][ended])) or 1e-3
    axes[-1].set_ylim(last - half, last + half)
    legend(axes[0])
    missing, kept = int((~ended).sum()), len(ended)
    some = f"the first {kept} samples." if judged.count > kept else f"{int(ended.sum())} samples."
    caption = [
        f"All runs, 90 % of them, and their median, of {some}",
        f"{missing} that did not come to their end are left out." if missing else "",
        f"Dashed: the run with the worst {metric_text(judged.main)}, sample {worst}: {changes(judged, worst)}."
        if worst is not None and lines else "",
        f"Bottom: {names[close].removeprefix(TRACE).replace('_', ' ')} close to where it ends.",
    ]  # fmt: skip
    return [figure_block("signals", figure, caption, "Signals")]


def _late_spread(trace: np.ndarray) -> float:
    """How far apart runs (R, T) are in the second half, relative to the way of all."""
    way = float(np.ptp(trace))
    return float(np.ptp(trace[:, trace.shape[1] // 2 :], axis=0).max()) / way if way > 0.0 else 0.0


def _worst_lines(
    names: Sequence[str], traces: Sequence[np.ndarray], ended: np.ndarray, time: np.ndarray,
    worst: int | None, run: Run | None,
) -> list[np.ndarray]:  # fmt: skip
    """The kept signals (T,) of the worst sample: from the table, or run again; none where neither has them."""
    if worst is None:
        return []
    if worst < len(ended):
        return [trace[worst] for trace in traces] if ended[worst] else []
    if run is None:
        return []
    again = run(worst)
    at = np.minimum(np.searchsorted(again.time, time - 1e-9), len(again.time) - 1)
    return [again.tracked(name.removeprefix(TRACE))[at] for name in names]


# Metrics -----------------------------------------------------------------------------------------------------
def _metrics(judged: CampaignJudgement) -> list[Any]:
    names, parts = (
        [name for name in judged.table.names(kind) if judged.worst(name) is not None]
        for kind in ("metric", PART)
    )
    return [
        *_histograms(judged, names),
        *_quantiles(judged, names, "Metrics over all samples that have them", "table-metrics"),
        *_quantiles(judged, parts, "Joint by joint", "table-joints"),
    ]


def _quantiles(judged: CampaignJudgement, names: Sequence[str], title: str, anchor: str) -> list[Any]:
    """A table of metrics; none without any."""
    rows = []
    for name in names:
        cells = ["never" if np.isinf(value) else number(float(value), 3) for value in judged.quantiles(name)]
        rows.append((metric_text(name), judged.table.unit(name), *cells, judged.worst(name)))
    columns = (
        "", "unit", "least", "5 % are below", "median", "95 % are below", "largest", "sample of the worst",
    )  # fmt: skip
    return [Table(columns, rows, title, anchor)] if rows else []


def small_panels(count: int, height: float, columns: int = 3, **options: Any) -> tuple[Any, list[Any]]:
    """As many panels in rows of at most so many columns, each row of this height, inches."""
    columns = min(columns, count)
    rows = -(-count // columns)
    figure, grid = panels(rows, columns, 0.4 + height * rows, **options)
    axes = [axis for row in grid for axis in row]
    for axis in axes[count:]:
        axis.set_visible(False)
    return figure, axes[:count]


def plain_axis(axis: Any, *which: Any) -> None:
    """Few ticks with short numbers."""
    for one in which:
        one.set_major_formatter(lambda value, _: number(value, 3))
    axis.tick_params(axis="both" if len(which) > 1 else "x", labelsize=8)


def bins_of(judged: CampaignJudgement, values: np.ndarray, unit: str) -> list[float]:
    """Edges of a histogram's bins; times are multiples of the kept period."""
    time = judged.table.journal.time
    period = float(np.diff(time[:2])[0]) if time.size > 1 else 0.0
    grain = period if unit == "s" and 0.0 < 10.0 * period < np.ptp(values) else 0.0
    return histogram_bins(values, grain).tolist()


def name_with_unit(name: str, unit: str) -> str:
    """``overshoot (%)``."""
    return f"{metric_text(name)} ({unit})" if unit else metric_text(name)


def _histograms(judged: CampaignJudgement, names: Sequence[str]) -> list[Any]:
    finite = {name: judged.column(name)[np.isfinite(judged.column(name))] for name in names}
    varied = {name: values for name, values in finite.items() if len(values) and np.ptp(values) > 0.0}
    if not varied:
        return []
    figure, axes = small_panels(len(varied), 1.9)
    for k, (axis, (name, values)) in enumerate(zip(axes, varied.items())):
        unit, most = judged.table.unit(name), np.abs(values).max()
        limits = [one.limit for one in judged.requirements if one.metric == name and one.limit < NO_LIMIT]
        with house_style():
            axis.hist(values, bins=bins_of(judged, values, unit), color=SERIES[0], alpha=0.55)
            axis.grid(axis="x", visible=False)
            axis.locator_params(axis="x", nbins=3 if most > 5e-3 else 2)
            plain_axis(axis, axis.xaxis)
            for limit in limits:
                if most > 0.5 * abs(limit):
                    axis.axvline(limit, color=INK, linewidth=1.0, dashes=DASHED)
        axis.set_xlabel(name_with_unit(name, unit), fontsize=8)
        label(axis, "samples" if k % 3 == 0 else "", "")
    missing = judged.of_status(DIVERGED) + judged.of_status(NOT_RUN)
    caption = [
        "How many samples have which value; dashed: a limit that is near or exceeded. Values that are never reached "
        "are left out.",
        f"{missing} samples without metrics are left out." if missing else "",
    ]
    return [figure_block("metrics", figure, caption, "Distribution of the metrics")]


def _sensitivities(judged: CampaignJudgement) -> list[Any]:
    """Sobol indices of a surrogate for the first metrics that have one."""
    found = {}
    for name in judged.table.names("metric"):
        one = judged.sensitivity(name) if len(found) < RANKED else None
        if one is not None:
            found[name] = one
    if not found:
        few = "The samples are too few to say which number matters: ten for each number, at least."
        return [Paragraph(few)] if judged.table.names("parameter") else []
    bars = min(BARS, max(len(one.names) for one in found.values()))
    figure, axes = small_panels(len(found), 0.9 + 0.2 * bars, columns=2, sharex=True)
    for axis, (name, one) in zip(axes, found.items()):
        places = np.arange(min(bars, len(one.names)))[::-1]
        with house_style():
            axis.barh(places, one.total[: len(places)], color=SERIES[0], alpha=0.35, label="with all others")
            axis.barh(places, one.first[: len(places)], color=SERIES[0], height=0.4, label="alone")
            axis.set_yticks(places, [n.replace("_", " ") for n in one.names[: len(places)]], fontsize=8)
            axis.set_xlim(0.0, 1.0)
            axis.grid(axis="y", visible=False)
            axis.set_title(f"{metric_text(name)}, R² {number(one.r_squared, 2)}", fontsize=9)
    with house_style():
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper left", ncols=2, frameon=False)
    first = next(iter(found.values()))
    low = [metric_text(name) for name, one in found.items() if one.r_squared < 0.5]
    notes = [Note(
        f"The polynomial explains less than half of the variance of {', '.join(low)} in samples that were left out of "
        "its fit: there the ranking says little."
    )] if low else []  # fmt: skip
    caption = (
        f"Sobol indices by SciPy of {first.terms} in the numbers, fitted to {first.count} samples: of this surrogate, "
        "not of the loop itself. R² is the fraction of the variance that it explains in samples left out of the fit; "
        "the rest is of higher order, or measurement noise."
    )
    return [*notes, figure_block("sensitivity", figure, caption, "Which number matters")]
