"""The report of a campaign: success rate, worst robot and disturbance found, signals, distributions, sensitivities."""

# Not checked strictly: parts of Matplotlib have no types.
# pyright: reportUnknownMemberType=false

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import islice

import numpy as np

from flexhinf.campaign import (
    CampaignJudgement,
    EvaluatedPlant,
    MergedTable,
    MetricLimit,
    WorstCase,
    stored_worsts,
)
from flexhinf.campaign.batches import PART, TRACE
from flexhinf.campaign.metrics import COMPLETED, DIVERGED, NOT_RUN, UNDAMPED, UNSTABLE
from flexhinf.designs.campaign_folder import (
    GainResults,
    stored_campaign,
    stored_gains,
    stored_request,
    verdict_of,
)
from flexhinf.errors import FlexhinfError
from flexhinf.loop import Trajectory
from flexhinf.numerals import number, short_numbers
from flexhinf.pages.arm_film import two_arms
from flexhinf.pages.campaign_text import (
    METRIC_LABELS,
    NO_LIMIT,
    SPREAD,
    by_effect,
    campaign_design,
    campaign_verdict,
    column_scale,
    display_scale,
    gain_changes,
    histogram,
    in_degrees,
    interval_text,
    limit_text,
    metric_text,
    missed_by,
    own_value_text,
    percent_change,
    percent_text,
    plant_text,
    proof_text,
    replay_command,
    sample_changes,
    setting_rows,
    share_text,
    square_text,
    unlike_parts,
    unstable_text,
    value_in,
    value_text,
    worst_text,
)
from flexhinf.pages.drawing import (
    DASHED,
    Line,
    Panel,
    draw_figure,
    few_ticks,
    figure_block,
    legend_above,
    rounded,
    small_panels,
)
from flexhinf.pages.page import design_statuses, write_page
from flexhinf.report import (
    INK,
    SERIES,
    Badge,
    Column,
    Fact,
    Figure,
    LineStyle,
    Listing,
    Note,
    Page,
    PageBlock,
    Paragraph,
    Section,
    Table,
    house_style,
    legend,
    new_figure,
    quantile_band,
)
from flexhinf.robot.parts import file_warnings

PlantRun = Callable[[WorstCase, EvaluatedPlant], Trajectory]

#: What a level γ belongs to, by the claim of a `GainRow`.
CLAIMS = {"designed": "designed for", "proved": "proved", "not claimed": "designed for another loop"}

#: Metrics whose sensitivity is drawn, and bars of each.
RANKED, BARS = 4, 8

#: Lines of the runs that are compared in one panel.
_BLACK: LineStyle = {"color": INK, "dashes": (5.0, 1.5), "linewidth": 1.1}
_COLOURED = tuple(LineStyle(color=colour, linewidth=1.1) for colour in SERIES)


#: What a section of a campaign has, of which nothing shows where its data are not there.
Blocks = Sequence[PageBlock | None]

#: Settings by the beginnings of their names, with the headings under which they stand.
HEADS = {
    "variable ": "Numbers that differ", "design ": "Design", "robot ": "Robot", "true robot ": "Robot", "": "Campaign",
}  # fmt: skip


# Page --------------------------------------------------------------------------------------------------------
def write_campaign(
    table: MergedTable,
    requirements: Sequence[MetricLimit],
    plant_run: PlantRun | None = None,
) -> CampaignJudgement:
    """Write index.html beside the table, with the worst cases that are kept there; returns what the page says.

    `plant_run` runs one of a worst case's plants again.
    """
    judged, journal = CampaignJudgement(table, tuple(requirements)), table.journal
    settings, cases, gains = journal.settings, stored_worsts(journal), stored_gains(journal)
    runs = (
        "moves between random goals"
        if "goals" in settings
        else f"loops of {short_numbers(settings['duration'])} s"
    )
    spread = f", spread {SPREAD[judged.method]}" if "method" in settings else ""
    case = next((worst for worst in cases if worst.metric == judged.main), next(iter(cases), None))
    search = "" if case is None else f"Search: {worst_text(judged, case)}"
    sections = _sections(judged, cases, gains, plant_run)
    page = Page(
        journal.about.get("title", "Campaign"),
        f"{judged.count} {runs} with the same controller, each with its own measurement noise and with "
        f"{len(table.names('parameter'))} numbers of its own{spread}.",
        campaign_verdict(judged),
        sections,
        journal.command,
        int(settings["seed"]),
        _settings(judged),
        _facts(judged),
        _statuses(judged, cases, gains),
        [text for text in (campaign_design(judged, brief=True), search, proof_text(judged)) if text],
        ("signals", "arms"),
    )
    write_page(journal.folder, "report of the campaign", page)
    return judged


@house_style()
def _sections(
    judged: CampaignJudgement, cases: Sequence[WorstCase], gains: GainResults, plant_run: PlantRun | None
) -> list[Section]:
    return [
        Section("Success", _success(judged), "success", True),
        Section("Worst case", _worst_case(judged, cases, plant_run), "worst-case", True),
        Section("Worst disturbance", _worst_disturbance(judged, gains), "worst-disturbance"),
        Section("Signals", (_signals(judged), _arms(judged)), "signals"),
        Section("Metrics", _metrics(judged), "metrics"),
        Section("What matters", _sensitivities(judged), "sensitivity"),
        Section("Failures", _failures(judged), "failures"),
    ]


def _settings(judged: CampaignJudgement) -> dict[str, list[Fact]]:
    """The settings in groups, each name without the beginning that its group has."""
    groups = {name: list[Fact]() for name in ("Campaign", "Numbers that differ", "Design", "Robot")}
    for name, value, unit in setting_rows(judged):
        head = next(head for head in HEADS if name.startswith(head))
        own = name if head == "true robot " else name.removeprefix(head)
        groups[HEADS[head]].append(Fact(own, value, unit))
    return {name: group for name, group in groups.items() if group}


def _facts(judged: CampaignJudgement) -> list[Fact]:
    unstable, sure = judged.of_status(UNSTABLE) + judged.of_status(DIVERGED), judged.success
    how = f"95 %: {interval_text(sure)}" if sure else f"no interval: spread {SPREAD[judged.method]}"
    numbers = [
        Fact("success", percent_text(judged.rate), note=how),
        Fact("unstable", unstable, f"of {judged.count}", unstable_text(judged)),
    ]
    for name in [n for n in judged.table.names("metric") if n in METRIC_LABELS or n.startswith("peak")][:4]:
        worst = judged.worst(name)
        if worst is not None:
            *_, median, _, largest = judged.quantiles(name)
            size, unit = value_in(judged, name, float(largest))
            value = ("never", "") if np.isinf(largest) else (rounded(size), unit)
            note = f"median {own_value_text(judged, name, float(median))}; sample {worst}"
            numbers.append(Fact(f"worst {metric_text(name)}", *value, note))
    return numbers


def _statuses(judged: CampaignJudgement, cases: Sequence[WorstCase], gains: GainResults) -> list[Badge]:
    missed = [f"{judged.failures} of {judged.count} samples fail."] if judged.failures else []
    missed += [
        f"A search found a robot within the tolerances that misses {metric_text(requirement.metric)} "
        f"({limit_text(requirement, case.unit, in_degrees(judged))})."
        for case in cases
        for requirement in missed_by(case, judged.requirements)
    ]
    searched = " and the worst robot found by search" if cases else ""
    met = (
        f"Every one of {judged.count} samples{searched} keeps the {len(judged.requirements)} requirements of this "
        "campaign."
    )
    own = verdict_of(judged.table.journal)
    kept = [] if own is not None and own.missed else [Badge("met", met)]
    return [
        *([Badge("not met", text) for text in missed] or kept),
        *([] if own is None else design_statuses(own)),
        *(
            Badge(
                "not proved", "A disturbance attains more than the proved γ: the proof or the loop is wrong."
            )
            for row in gains.rows
            if row.claim == "proved" and not row.kept
        ),
    ]


# Success and failures ----------------------------------------------------------------------------------------
def _success(judged: CampaignJudgement) -> Blocks:
    ends, limits = judged.of_status(DIVERGED) + judged.of_status(NOT_RUN), judged.requirements
    kept = [
        ("reaches the end of the run", "", ends),
        ("is stable there", "", ends + judged.of_status(UNSTABLE)),
        *((metric_text(limit.metric), limit_text(limit, judged.table.unit(limit.metric), in_degrees(judged)),
           int(judged.violations[:, k].sum())) for k, limit in enumerate(limits)),
    ]  # fmt: skip
    interval = (
        "The interval of the rate is that of Clopper and Pearson, exact for independent samples."
        if judged.success
        else f"The samples are spread {SPREAD[judged.method]} and not independent: no confidence interval of the rate "
        "is known from this campaign alone (`--method random` has one)."
    )
    rows = [(*row, percent_text(1.0 - row[-1] / judged.count)) for row in kept]
    return [
        Paragraph(
            "A sample is a success if its run reaches its end, is stable there, and keeps every requirement of this "
            f"table. {interval} "
            "The rate is a statement about the sampled distribution, not a proof. A run is unstable if it diverges to "
            "numbers that are not finite, or if, in the last third of the time in which command and disturbance stand "
            "still, a joint still swings by more than the settling band of ±2 % of its step, by at least "
            f"{100 * UNDAMPED:.0f} % of its swing in the second third, and either to and fro over the same positions "
            "or further from the command than before."
        ),
        Table(("requirement", "limit", "failures", "keep it"), rows, "Requirements", "table-success"),
    ]


def _failures(judged: CampaignJudgement) -> Blocks:
    replay, worst = replay_command(judged.table.journal.folder.name, "--sample"), judged.worst_of_all
    if not judged.failures:
        command = [] if worst is None else [Listing(f"{replay} {worst}")]
        again = " This command, in the folder above, runs the worst one again:" if command else ""
        return [Paragraph(f"No sample fails.{again}"), *command]
    columns = (
        Column("sample", of=lambda k: k),
        Column("why", of=lambda k: _why(judged, k)),
        Column("its numbers", of=lambda k: sample_changes(judged, k)),
        Column("replay", of=lambda k: f"`{replay} {k}`"),
    )
    listed = [*map(int, judged.failed[:20])]
    few = (
        f" Listed: the {len(listed)} worst; samples.parquet has all." if judged.failures > len(listed) else ""
    )
    return [
        Paragraph(
            f"{judged.failures} samples fail. The last column runs one again, in the folder above.{few}"
        ),
        Table.of(columns, listed, "Failures", "table-failures", stacks=True),
    ]


def _why(judged: CampaignJudgement, sample: int) -> str:
    """Why a sample fails."""
    status, unit_of = str(judged.column("status")[sample]), judged.table.unit
    if status == NOT_RUN:
        return f"not run: {judged.column('failure')[sample]}"
    if status == DIVERGED:
        return f"diverged at {judged.column('diverged_at_s')[sample]:g} s"
    missed = {rule.metric: float(judged.column(rule.metric)[sample]) for rule in judged.missed(sample)}
    reasons = [
        f"{metric_text(name)} {value_text(value, unit_of(name), in_degrees(judged))}"
        for name, value in missed.items()
    ]
    return ", ".join(["unstable to the end of the run"] * (status == UNSTABLE) + reasons)


# Worst robot and worst disturbance ---------------------------------------------------------------------------
def _worst_case(judged: CampaignJudgement, cases: Sequence[WorstCase], runs: PlantRun | None) -> Blocks:
    if not cases:
        return []
    rows, used = list[Sequence[object]](), list[float]()
    for case in cases:
        own = [rule for rule in judged.requirements if rule.metric == case.metric]
        shares = (case.found.value / rule.limit for rule in own if rule.at_most and rule.limit > 0.0)
        used.append(math.inf if case.found.status != COMPLETED else max(shares, default=-1.0))
        rows.append((
            metric_text(case.metric), plant_text(judged, case, case.nominal),
            f"{plant_text(judged, case, case.sampled)} ({case.sample})", plant_text(judged, case, case.corner),
            plant_text(judged, case, case.found),
            "–" if math.isnan(case.factor) else number(case.factor, 3),
            "; ".join(limit_text(rule, case.unit, in_degrees(judged)) for rule in own) or "–",
            f"{case.together} of {case.starts}" if case.worse else "none",
        ))  # fmt: skip
    case, first = cases[used.index(max(used))], cases[0]
    every = f"the worst of {'all ' if first.all_corners else ''}{first.corners} corners"
    outside = (
        f" {first.outside} samples lie outside the box, since their distribution is not cut off; they are not compared."
        if first.outside
        else ""
    )
    varied = ((name, case.found.numbers[name], case.intervals[name]) for name in by_effect(case))
    metric, text = metric_text(case.metric), worst_text(judged, case)
    return [
        Paragraph(
            f"{first.starts} searches for each metric, by gradients from differences, begin at the worst "
            f"samples, {every} and random points of the box of tolerances: "
            f"{sum(worst.runs for worst in cases)} robots in all, with the "
            "measurement noise of the worst sample. What is found is a lower bound of the worst value inside the box, "
            f"not a proof.{outside}"
        ),
        Table(
            (
                "metric", "nominal", "worst sample", "worst corner", "worst found", "times", "limit",
                "searches that end there",
            ), rows, "The worst robot inside the box of tolerances", "table-worst-case", stacks=True,
        ),
        None if runs is None else _worst_figure(judged, case, runs),
        Paragraph(f"{text[0].upper()}{text[1:]} This command, in the folder above, runs it again:"),
        Listing(replay_command(judged.table.journal.folder.name, f"--worst-case {case.metric}")),
        Table(
            ("number", "value", "unit", "change", "in its interval", f"{metric} with it alone nominal"),
            [
                (
                    name.replace("_", " "), number(value, 6), case.units[name],
                    percent_change(name, value, case.nominal.numbers[name]) or "–",
                    "lowest" if value == low else "highest" if value == high else "inside",
                    value_text(case.alone[name], case.unit, in_degrees(judged)),
                )
                for name, value, (low, high) in varied
            ],
            f"The robot with the worst {metric} found", "table-worst-numbers",
        ),
    ]  # fmt: skip


def _worst_figure(judged: CampaignJudgement, case: WorstCase, runs: PlantRun) -> Figure | None:
    # three runs with one noise: the tracked signal that differs most, its end, and such an input
    plants = {"worst found": case.found, f"sample {case.sample}": case.sampled, "nominal": case.nominal}
    trajectories = {name: runs(case, plant) for name, plant in plants.items() if plant.status == COMPLETED}
    names = [name.removeprefix(TRACE) for name in judged.table.names("trace")]
    if len(trajectories) < len(plants) or not names:
        return None
    worst, _, nominal = trajectories.values()
    signal = max(names, key=lambda name: float(np.abs(worst.tracked(name) - nominal.tracked(name)).max()))
    u = worst.names["input"][
        int(np.argmax(np.abs(worst.signals["input"] - nominal.signals["input"]).max(axis=0)))
    ]

    def panel(name: str, kind: str, read: Callable[[Trajectory], np.ndarray], near: bool = False) -> Panel:
        unit = dict(zip(worst.names[kind], worst.units[kind])).get(name, "")
        scale, unit = display_scale(unit, in_degrees(judged))
        lines = [
            Line(run.time, scale * read(run), each, style)
            for (each, run), style in zip(trajectories.items(), (_COLOURED[1], _BLACK, _COLOURED[0]))
        ]
        tracked = scale * read(nominal)
        return Panel(name.replace("_", " "), unit, lines, y=_close(tracked[-1], tracked) if near else None)

    return draw_figure(
        "worst-case",
        [
            panel(signal, "state", lambda run: run.tracked(signal)),
            panel(signal, "state", lambda run: run.tracked(signal), near=True),
            panel(u, "input", lambda run: run.signal("input", u)),
        ],
        f"The robot with the worst {metric_text(case.metric)} that was found, the worst sample and the nominal robot, "
        f"all with the noise of sample {case.sample}. Middle: {signal.replace('_', ' ')} close to where it ends.",
        "The worst run",
    )


def _close(middle: float, values: np.ndarray) -> tuple[float, float]:
    half = 0.12 * float(np.ptp(values)) or 1e-3
    return middle - half, middle + half


def _worst_disturbance(judged: CampaignJudgement, gains: GainResults) -> Blocks:
    if not gains.rows:
        return []
    worst = next((row for row in gains.rows if row.robot == "worst"), None)
    numbers = "" if worst is None else f" The worst robot found: {gain_changes(worst, judged.nominal)}."
    return [
        Paragraph(
            "Finite-energy disturbances from rest at the goal, found by power iteration on the gradient of ∫|z|², "
            "under "
            "which V stays inside the sampled or proved level; inputs are held for a period. An attained gain is a "
            "lower "
            "bound. A designed γ is that of the nominal robot with the true state; a proved one holds for the z, d, "
            f"robots and level of its certificate, and for the loop with the true state alone.{numbers}"
            f"{f' No γ is proved of this law: {gains.unproved}.' if gains.unproved else ''}"
        ),
        Table(
            ("robot", "loop", "z and d", "attained ∫|z|²/∫|d|²", "γ²", "share", "γ is"),
            [
                (
                    "nominal" if row.robot == "nominal" else "worst found", row.loop, f"of the {row.pair}",
                    square_text(row.gain), square_text(row.gamma), share_text(row), CLAIMS[row.claim],
                )
                for row in gains.rows
            ],
            "Attained gains", "table-worst-disturbance", stacks=True,
        ),
        draw_figure(
            "worst-disturbance",
            [Panel(gains.rows[0].names[0].replace("_", " "), "", [
                Line(
                    np.array(row.times), np.array(row.disturbance)[:, 0], f"{row.robot}, {row.loop}, {row.pair}", style
                )
                for row, style in zip(gains.rows, (*_COLOURED[:2], _BLACK, _COLOURED[2]))
            ], also=legend)],
            "The first component of d.", "The worst disturbances found",
        ),
        Paragraph("This command, in the folder above, runs the disturbances again:"),
        Listing(replay_command(judged.table.journal.folder.name, "--worst-case gain")),
    ]  # fmt: skip


# Signals and metrics -----------------------------------------------------------------------------------------
def _signals(judged: CampaignJudgement) -> Figure | None:
    # the kept signals, and the end of the one that differs most; the worst run is drawn apart
    names = judged.table.names("trace")
    traces = [judged.table.trace(name).astype(float) for name in names]
    ended = np.all([np.isfinite(trace).all(axis=1) for trace in traces], axis=0)
    if not traces or not ended.any():
        return None
    time, worst = judged.table.journal.time, judged.worst_of_all
    lines: list[np.ndarray] = []  # of the worst sample: from the table, or run again
    if worst is not None and worst < len(ended):
        lines = [trace[worst] for trace in traces] if ended[worst] else []
    elif worst is not None:  # its signals are not kept
        again = stored_campaign(judged.table.journal.folder)[0].replay(worst)
        at = np.minimum(np.searchsorted(again.time, time - 1e-9), len(again.time) - 1)
        lines = [again.tracked(name.removeprefix(TRACE))[at] for name in names]
    spreads = [0.0] * len(names)  # how far apart runs are in the second half, relative to the range of all
    for k, trace in enumerate(trace[ended] for trace in traces):
        if np.ptp(trace) > 0.0:
            spreads[k] = float(np.ptp(trace[:, trace.shape[1] // 2 :], axis=0).max()) / float(np.ptp(trace))
    close = int(np.argmax(spreads))
    panels = (*range(len(names)), close)
    degrees = in_degrees(judged)
    scales = [display_scale(judged.table.unit(name), degrees) for name in names]
    labels = [(names[k].removeprefix(TRACE).replace("_", " "), scales[k][1]) for k in panels]
    figure, axes = new_figure(len(panels), labels=labels)
    for axis, k in zip(axes, panels):
        quantile_band(axis, time, scales[k][0] * traces[k][ended])
        if lines:
            axis.plot(time, scales[k][0] * lines[k], label=f"sample {worst}", **_BLACK)
    last = scales[close][0] * traces[close][ended]
    axes[-1].set_ylim(*_close(float(np.median(last[:, -1])), last))
    legend(axes[0])
    missing, kept = int((~ended).sum()), len(ended)
    some = f"the first {kept} samples." if judged.count > kept else f"{int(ended.sum())} samples."
    caption = [
        f"All runs, 90 % of them, and their median, of {some}",
        f"{missing} that did not come to their end are left out." if missing else "",
        f"Dashed: the run with the worst {metric_text(judged.main)}, sample {worst}: {sample_changes(judged, worst)}."
        if worst is not None and lines
        else "",
        f"Bottom: {labels[-1][0]} close to where it ends.",
    ]
    return figure_block("signals", figure, caption, "Signals")


def _arms(judged: CampaignJudgement) -> PageBlock | None:
    """The arm of the worst sample beside that of the middle one, in the same run."""
    worst = judged.worst_of_all
    if worst is None:
        return None
    values = judged.column(judged.main)
    middle = int(np.argsort(values)[len(values) // 2])
    try:
        with file_warnings():  # the design has told them
            campaign, journal = stored_campaign(judged.table.journal.folder)
            robot = stored_request(journal).request.robot
            runs = [campaign.replay(sample) for sample in (worst, middle)]
    except FlexhinfError as error:  # the page is of the samples all the same
        return Paragraph(f"The arm is not drawn. {error.what} {error.found}")
    count, n = min(len(run.time) for run in runs), len(robot.joint_names)
    links = [np.asarray(run.signals["state"])[:count, :n] for run in runs]
    if middle == worst or count < 2 or not all(np.isfinite(each).all() for each in links):
        return None
    names = (f"sample {worst}, the worst", f"sample {middle}, the median")
    says = f"The links of the worst sample and of that with the median {metric_text(judged.main)}, in their runs."
    return two_arms(
        "arms", robot, runs[0].time[:count], list(zip(names, links, strict=True)), says, "The arms"
    )


def _metrics(judged: CampaignJudgement) -> Blocks:
    whole, joints = (
        [n for n in judged.table.names(kind) if judged.worst(n) is not None] for kind in ("metric", PART)
    )
    parts = [part for name in whole for part in unlike_parts(judged, name) or [name]]
    return (
        _histograms(judged, parts),
        _metric_table(judged, whole, "Metrics over all samples that have them", "table-metrics"),
        _metric_table(judged, joints, "Joint by joint", "table-joints"),
    )


def _metric_table(judged: CampaignJudgement, names: Sequence[str], title: str, anchor: str) -> Table | None:
    rows: list[Sequence[object]] = []
    for name in (name for name in names if not unlike_parts(judged, name)):  # those stand joint by joint
        scale, unit = column_scale(judged, name)
        sizes = ("never" if np.isinf(x) else number(scale * float(x), 3) for x in judged.quantiles(name))
        rows.append((metric_text(name), unit, *sizes, judged.worst(name)))
    heads = (
        "",
        "unit",
        "least",
        "5 % are below",
        "median",
        "95 % are below",
        "largest",
        "sample of the worst",
    )
    return Table(heads, rows, title, anchor, stacks=True) if rows else None


def _histograms(judged: CampaignJudgement, names: Sequence[str]) -> Figure | None:
    finite = {name: judged.column(name)[np.isfinite(judged.column(name))] for name in names}
    varied = {name: values for name, values in finite.items() if len(values) and np.ptp(values) > 0.0}
    if not varied:
        return None
    figure, axes = small_panels(len(varied), 1.9)
    for k, (axis, (name, raw)) in enumerate(zip(axes, varied.items())):
        factor, unit = column_scale(judged, name)
        values, most = factor * raw, factor * np.abs(raw).max()
        histogram(axis, judged, name, unit, values, "samples" if k % 3 == 0 else "")
        few_ticks(axis, most, "x")
        for rule in judged.requirements:
            if rule.metric == name and rule.limit < NO_LIMIT and most > 0.5 * factor * abs(rule.limit):
                axis.axvline(factor * rule.limit, color=INK, linewidth=1.0, dashes=DASHED)
    missing = judged.of_status(DIVERGED) + judged.of_status(NOT_RUN)
    return figure_block(
        "metrics", figure,
        "How many samples have which value; dashed: a limit that is near or exceeded. Values that are never reached "
        f"are left out.{f' {missing} samples without metrics are left out.' if missing else ''}",
        "Distribution of the metrics",
    )  # fmt: skip


def _sensitivities(judged: CampaignJudgement) -> Blocks:
    names = judged.table.names("metric")  # the use of a limit changes as the metric itself does
    names = tuple(name for name in names if name.removesuffix("_use") not in {*names} - {name})
    ranked = ((name, judged.sensitivity(name)) for name in names)
    sensitivities = dict(islice(((name, sobol) for name, sobol in ranked if sobol is not None), RANKED))
    if not sensitivities:
        few = Paragraph("The samples are too few to say which number matters: ten for each number, at least.")
        return [few] if judged.table.names("parameter") else []
    bars = min(BARS, max(len(sobol.names) for sobol in sensitivities.values()))
    figure, axes = small_panels(len(sensitivities), 0.9 + 0.2 * bars, columns=2, sharex=True)
    for axis, (name, sobol) in zip(axes, sensitivities.items()):
        places = np.arange(min(bars, len(sobol.names)))[::-1]
        axis.barh(places, sobol.total[: len(places)], color=SERIES[0], alpha=0.35, label="with all others")
        axis.barh(places, sobol.first[: len(places)], color=SERIES[0], height=0.4, label="alone")
        axis.set_yticks(places, [n.replace("_", " ") for n in sobol.names[: len(places)]])
        axis.set_xlim(0.0, 1.0)
        axis.grid(axis="y", visible=False)
        axis.set_title(f"{metric_text(name)}, R² {number(sobol.r_squared, 2)}", loc="right")
    legend_above(figure, axes[0], 2)
    first = next(iter(sensitivities.values()))
    low = [metric_text(name) for name, sobol in sensitivities.items() if sobol.r_squared < 0.5]
    return [
        *([Note(f"The ranking says little for {', '.join(low)}: R² is less than half.")] if low else []),
        figure_block(
            "sensitivity",
            figure,
            f"Sobol indices by SciPy of {first.terms} in the numbers, fitted to {first.count} samples: of this "
            "surrogate, not of the loop itself. R² is the fraction of the variance that it explains in samples left "
            "out of the fit.",
            "Which number matters",
        ),
    ]
