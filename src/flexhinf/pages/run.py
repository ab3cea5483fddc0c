"""Report of a run of a deployed controller: requirements, deadlines, tracking, effort, the controller's status."""

# Not checked strictly: parts of Matplotlib have no types.
# pyright: reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np

from flexhinf.designs.deployed_run import DeployedRun
from flexhinf.designs.requirements import Requirement
from flexhinf.designs.responses import Move
from flexhinf.export.realtime import PERCENTILES, RealTimeRun, Timing, percentiles
from flexhinf.export.run_log import write_log
from flexhinf.loop import Status, Stop
from flexhinf.loop.controller.signs import SIGNS
from flexhinf.loop.controller.status import NEAR_LIMIT
from flexhinf.loop.simulation.metrics import peak_of
from flexhinf.numerals import count_text, number
from flexhinf.pages.design.overview import arm_picture, lead_height
from flexhinf.pages.drawing import (
    DASHED,
    Panel,
    Units,
    draw_figure,
    figure_block,
    joint_panels,
    pose_text,
    rounded,
    settling_text,
)
from flexhinf.pages.page import (
    design_statuses,
    report_files,
    requirement_table,
    requirements_text,
)
from flexhinf.pages.settings import loop_rows, robot_rows, sensor_rows
from flexhinf.pages.terminal import Ending, requirements_screen
from flexhinf.report import (
    MUTED,
    SERIES,
    Badge,
    Column,
    Drawing,
    Fact,
    Figure,
    Page,
    PageBlock,
    Section,
    Table,
    house_style,
    label,
    legend,
    new_figure,
)
from flexhinf.robot.signals import signal_names
from flexhinf.stops import STOPS

if TYPE_CHECKING:
    from rich.table import Table as Terminal

#: Places of missed deadlines that are listed, the latest first.
LISTED = 5

#: Whose requirements are judged, where the design has more.
THIS = "this run"

#: A run that takes this many times its own time did not keep up, beyond single late samples.
SLOW = 1.01

#: Rows of the table of times: what, and the array of `Timing`; in real time, and else.
ROWS = {
    True: {
        "lateness of the beginning": "woken", "step of the controller": "computed", "input is there": "ready",
        "simulated robot is done": "over",
    },
    False: {"step of the controller": "computed", "whole sample": "over"},
}  # fmt: skip


def run_met(prepared: DeployedRun, run: RealTimeRun) -> bool:
    """Whether a run met every requirement and came to its end, and no protective stop began."""
    is_whole = not run.trajectory.message and not run.stop
    return is_whole and all(line.met for line in prepared.requirements(run))


def run_tables(prepared: DeployedRun, run: RealTimeRun) -> list[Terminal]:
    """Tables of the requirements, of the metrics of each joint, and of the times of the samples."""
    tables = list[Table]()
    if _tracked(run):
        title = f"{prepared.robot.name}: what is required of this run (* our default)"
        lines = judged_requirements(prepared, run)
        tables += [requirement_table(lines, _units(prepared).degrees, title)] if lines else []
        tables.append(_joints_table(prepared, run))
    if tables or len(run.timing.time):
        tables.append(_times_table(run.timing))
    return [table.terminal() for table in tables]


def _units(prepared: DeployedRun) -> Units:
    s = prepared.plants.specification
    return Units(prepared.plants.model, prepared.robot.joint_names, s.in_degrees)


def _tracked(run: RealTimeRun) -> bool:
    """Whether the run has samples, all of them finite."""
    return not run.trajectory.message and len(run.trajectory.time) > 0


def judged_requirements(prepared: DeployedRun, run: RealTimeRun) -> list[Requirement]:
    """The requirements of a run that came to its end; none of one that was stopped or diverged."""
    is_whole = run.stopped is None and not run.stop and _tracked(run)
    return prepared.requirements(run) if is_whole else []


def _joints_table(prepared: DeployedRun, run: RealTimeRun) -> Table:
    """Metrics of each joint: of its step, or its distance from the move."""
    units, response = _units(prepared), prepared.response(run)
    (small, factor), metrics, title = units.small, response.metrics, "Joints"
    columns = (
        Column("settled after", key="settled", right=True),
        Column("overshoot", "%", digits=3, key="overshoot_percent"),
        Column("end error", small, digits=3, key="steady_state_error", scale=factor),
    )
    if prepared.plan is not None:
        metrics = Move.along(prepared.plan, response, prepared.plants.limits).metrics
        title = "Joints: distance from the move"
        errors = {"largest": "largest_error", "rms": "rms_error", "at the end": "final_error"}
        columns = tuple(Column(name, small, digits=3, key=key, scale=factor) for name, key in errors.items())
    columns = (
        Column("joint", key="joint"),
        *columns,
        Column("peak", units.effort, digits=3, key="peak_input"),
    )
    joints = [
        {**row, "settled": settling_text(row["settling_time_s"]) if "settling_time_s" in row else None}
        for row in metrics
    ]
    return Table.of(*units.by_joint(columns, joints), title, "table-joints")


def _times_table(timing: Timing) -> Table:
    """Percentiles of the times of the samples."""
    rows = [
        (name, *(1e6 * value for value in percentiles(getattr(timing, field)).values()))
        for name, field in ROWS[timing.real_time].items()
    ]
    columns = ("", *(Column(name, decimals=1) for name in PERCENTILES))
    title = f"Times in µs; the period has {number(1e6 * timing.period)} µs"
    return Table(columns, rows, title, "table-times")


def run_ending(prepared: DeployedRun, run: RealTimeRun) -> Ending:
    """What a terminal says at the end: requirements that are missed or nearly missed, what the robot did, notes."""
    lines = judged_requirements(prepared, run)
    own = _of_design(prepared, lines)
    parts = [run_verdict(prepared, run), requirements_text(lines, THIS) if lines else "", own]
    return requirements_screen(lines, _units(prepared).degrees, parts, run_notes(run))


# Sentences ------------------------------------------------------------------------------------------
def run_verdict(prepared: DeployedRun, run: RealTimeRun) -> str:
    """Verdict on a run: a protective stop, deadlines, then what the robot did."""
    text = _real_time(run.timing)
    if run.trajectory.message:
        return f"{text} {run.trajectory.message}"
    if run.stop:
        return f"{run.stop_text} {text}"
    if run.stopped is not None:
        return f"{text} Stopped at {number(run.trajectory.time[-1] if len(run.trajectory.time) else 0.0)} s."
    response, several = prepared.response(run), len(prepared.robot.joint_names) > 1
    units = _units(prepared)

    def named(text: str, joint: str) -> str:
        return f"{text} ({joint})" if several and joint else text

    ends = " to ".join(
        pose_text(pose, prepared.robot.links.slides, units.degrees)
        for pose in (prepared.start, prepared.goal)
    )
    effort = named(units.text(response.peak.value, units.effort, response.peak.joint), response.peak.joint)
    if prepared.plan is not None:
        worst = Move.along(prepared.plan, response, prepared.plants.limits).largest
        error = named(units.small_text(worst.value, 3, worst.joint), worst.joint)
        found = f"was followed within {error} and needed at most {effort}"
        return f"{text} The move from {ends} {found}."
    settling, overshoot = response.settling, response.overshoot
    settled = (
        f"settled in {named(settling_text(settling.value), settling.joint)}"
        if np.isfinite(settling.value)
        else f"did not settle ({settling.joint})"
    )
    over = named(f"{number(overshoot.value, 2)} %", overshoot.joint)
    return f"{text} The step from {ends} {settled}, overshot by {over} and needed at most {effort}."


def _real_time(timing: Timing) -> str:
    count, rate = len(timing.time), number(1.0 / timing.period)
    if not count:
        return "The run was stopped before its first sample."
    length = number(timing.period * (count - 1))
    elapsed, missed = number(timing.elapsed, 3), int(timing.missed.sum())
    if not timing.real_time:
        return f"Not in real time: {count} samples of a loop at {rate} Hz, {length} s, in {elapsed} s."
    if timing.slowness > SLOW:
        step, robot = (
            number(1e3 * float(np.median(part)), 2) for part in (timing.computed, timing.over - timing.ready)
        )
        return (
            f"Real time was not kept: {length} s took {elapsed} s, and {missed} of {count} deadlines were missed. "
            f"Of a period of {number(1e3 * timing.period)} ms the controller's step takes {step} ms and the simulated "
            f"robot {robot} ms (medians)."
        )
    if not missed:
        return f"Every deadline was met: {count} samples at {rate} Hz in {number(timing.elapsed)} s."
    return (
        f"{missed} of {count} deadlines were missed ({number(100.0 * missed / count, 2)} %), the latest input by "
        f"{number(1e3 * timing.missed_spans()[0].worst, 2)} ms: {length} s of a loop at {rate} Hz took "
        f"{number(timing.elapsed)} s."
    )


#: What the bits of a controller's status say.
STATUS_SENTENCES = {
    Status.OUTSIDE_WORKSPACE: "The command lay outside of the workspace that the controller is designed for",
    Status.LIMIT_CYCLE: "An input or a joint swung to and fro while the command rested (limit cycle)",
    Status.SATURATION: "An input had been at a limit for long",
    Status.REACTING: "The controller reacted: it replaced the command, or slowed it to rest along its path,",
    Status.DOUBTFUL_ESTIMATE: "The estimate was in doubt: rounding may have moved it, or a covariance was repaired,",
    Status.FOLLOWING_ERROR: "A joint was farther from its command than the limit of its following error",
    Status.BLOCKED: "Something blocked a joint, which let go",
    Status.REPEATED_FRAME: "A frame of measurements was a repeated one, which counts as missing",
    **{Status[name.upper()]: STOPS[name].says.capitalize() for name in SIGNS},
}


def run_notes(run: RealTimeRun) -> list[str]:
    """Notes on missed deadlines, on values that the controller refused, and on what the operating system permitted."""
    notes, spans = list(run.scheduling), run.timing.missed_spans() if run.timing.real_time else []
    if spans and run.timing.slowness <= SLOW:
        places = [
            f"at {number(rounded(span.begin, 4) or 0.0)} s ({count_text(span.samples, 'sample')}, up to "
            f"{number(1e3 * span.worst, 2)} ms)"
            for span in spans[:LISTED]
        ]
        more = f", and {len(spans) - LISTED} more places" if len(spans) > LISTED else ""
        notes.append(f"Missed deadlines: {', '.join(places)}{more}.")
    if spans and not run.scheduling:
        notes.append("A real-time priority and an own core keep other programs off: --priority 80 --core 1.")
    for bit in Status:
        samples = int(np.sum(run.status & bit > 0))
        if samples:
            notes.append(
                f"{STATUS_SENTENCES[bit].rstrip(',')}: the status says so in {count_text(samples, 'sample')}."
            )
    return notes + [
        f"The controller's step ended with {run.code_names[int(code)]} in {int(np.sum(run.codes == code))} samples."
        for code in np.unique(run.codes)
        if code
    ]


# Page -----------------------------------------------------------------------------------------------
def run_files(
    prepared: DeployedRun, run: RealTimeRun, command: Sequence[str], stated: Mapping[str, object]
) -> dict[str, str | bytes]:
    """Files of a run's report: index.html, run.json with every number of the page, and run.csv with every signal.

    `command` runs it again; `stated` are options of the run by their names, for the settings.
    """
    files = dict[str, str | bytes]()
    if len(run.timing.time):
        with TemporaryDirectory() as folder:
            files["run.csv"] = write_log(run, Path(folder) / "run.csv").read_bytes()
    return report_files(run_page(prepared, run, command, stated), "run.json", files)


def run_page(
    prepared: DeployedRun, run: RealTimeRun, command: Sequence[str], stated: Mapping[str, object]
) -> Page:
    """The report of a run; parameters as for `run_files`."""
    robot, lines, timing, plants = (
        prepared.robot,
        judged_requirements(prepared, run),
        run.timing,
        prepared.plants,
    )
    kind, tracked = "step" if prepared.plan is None else "move", _tracked(run)
    verdict, more = _sentences(prepared, run)
    sensors = [] if plants.specification.estimator == "none" else sensor_rows(plants)
    return Page(
        f"A run of the {kind} on {robot.name}",
        f"The deployed controller drives the robot “{robot.name}” in MuJoCo, "
        f"{'in real time' if timing.real_time else 'as fast as it goes'}, with "
        f"{'measurement noise' if prepared.arguments['noise'] is not None else 'exact measurements'}.",
        verdict,
        (
            _requirements(prepared, lines),
            _timing(timing),
            Section(
                f"Tracking of the {kind}",
                (lambda: _tracking_figure(prepared, run), _joints_table(prepared, run)) if tracked else (),
                "tracking",
                numbers={"joints": prepared.response(run).metrics if tracked else []},
            ),
            Section(
                "Inputs and saturation",
                _effort(prepared, run) if tracked else (),
                "effort",
                numbers={"at_limit": _saturated(prepared, run) if tracked else []},
            ),
            _status(run),
        ),
        command,
        plants.specification.seed,
        {
            "Run": [
                *(Fact(name.replace("_", " "), value) for name, value in stated.items()),
                Fact("length", float(prepared.arguments["duration"]), "s"),
            ],
            "Loop": [*loop_rows(plants), *sensors],
            "Robot that is driven": robot_rows(robot),
        },
        _facts(prepared, run),
        _statuses(prepared, lines),
        [*more, *run_notes(run)],
        (lambda: _result_figure(prepared, run), lambda: arm_picture(robot, prepared.response(run))) if tracked else (),
        {
            "version": 1, "robot": robot.name, "kind": kind, "verdict": run_verdict(prepared, run),
            "met": run_met(prepared, run), "design": prepared.design.numbers, "stopped_by_signal": run.stopped,
            "protective_stop": [str(bit.name).lower() for bit in Stop if bit in run.stop],
            "start": prepared.start, "goal": prepared.goal, "notes": run_notes(run),
        },
    )  # fmt: skip


def _requirements(prepared: DeployedRun, lines: Sequence[Requirement]) -> Section:
    """What is required of the run, where it came to its end."""
    keys = ("what", "where", "limit", "found", "unit", "met", "judged")
    return Section(
        "Requirements",
        (requirement_table(lines, _units(prepared).degrees),) if lines else (),
        "specification",
        True,
        brief=f"{sum(line.met for line in lines)} of {len(lines)} met",
        numbers={"requirements": [{key: getattr(line, key) for key in keys} for line in lines]},
    )


def _timing(timing: Timing) -> Section:
    """When the inputs were there."""
    count, missed = len(timing.time), int(timing.missed.sum())
    names = ROWS[timing.real_time].values() if count else ()
    return Section(
        "Deadlines and jitter",
        (lambda: _times_figure(timing), _times_table(timing)) if count else (),
        "timing",
        True,
        brief=f"{missed} of {count} deadlines missed" if timing.real_time else "",
        numbers={
            "timing": {
                "real_time": timing.real_time, "period_s": timing.period, "samples": count,
                "elapsed_s": timing.elapsed, "missed": missed, "overrun": int(timing.overrun.sum()),
                "percentiles_s": {name: percentiles(getattr(timing, name)) for name in names},
            }
        },
    )  # fmt: skip


def _of_design(prepared: DeployedRun, lines: Sequence[Requirement], brief: bool = False) -> str:
    """The verdict on the design, and how much of it this run judges."""
    return prepared.design.beside((line.what for line in lines if line.judged), brief)


def _statuses(prepared: DeployedRun, lines: Sequence[Requirement]) -> list[Badge]:
    """What the run misses, or cannot judge, and the design's own verdict; met only where the design is too."""
    degrees, own = _units(prepared).degrees, prepared.design
    kinds = {
        "not met": [line for line in lines if line.missed],
        "not judged": [line for line in lines if not line.judged],
    }
    found = [
        Badge(
            kind, f"This run: {'; '.join(replace(line.converted(degrees), where='').text for line in some)}."
        )
        for kind, some in kinds.items()
        if some
    ]
    if lines and not found and not own.missed:
        found = [Badge("met", f"The {len(lines)} requirements of this run.")]
    return [*found, *design_statuses(own)]


def _sentences(prepared: DeployedRun, run: RealTimeRun) -> tuple[str, list[str]]:
    """The verdict of the page, and what stands below it."""
    lines = judged_requirements(prepared, run)
    if not lines:
        return run_verdict(prepared, run), []
    deadlines = _real_time(run.timing)
    moved = run_verdict(prepared, run).removeprefix(deadlines).strip()
    own = _of_design(prepared, lines, brief=True)
    return f"{requirements_text(lines, THIS)} {moved}", [text for text in (own, deadlines) if text]


def _facts(prepared: DeployedRun, run: RealTimeRun) -> list[Fact]:
    """Tracking, effort, and deadlines."""
    timing, units, facts = run.timing, _units(prepared), list[Fact]()
    if _tracked(run):
        response = prepared.response(run)

        def fact(name: str, value: float | None, unit: str, joint: str) -> Fact:
            where = joint if len(units.joints) > 1 else ""
            if value is None:
                return Fact(name, "not settled", "", where)
            return Fact(name, value, units.of(unit, joint), where)

        if prepared.plan is None:
            settling, overshoot = response.settling, response.overshoot
            facts = [
                fact("settling time", rounded(settling.value), "s", settling.joint),
                fact("overshoot", rounded(overshoot.value), "%", overshoot.joint),
            ]
        else:
            worst = Move.along(prepared.plan, response, prepared.plants.limits).largest
            small, factor = units.small
            size = rounded(units.factor_of(factor, worst.joint) * worst.value)
            facts = [fact("largest error", size, small, worst.joint)]
        full = rounded(100.0 * float(_saturated(prepared, run).max()), 2)
        facts += [
            fact("peak input", rounded(response.peak_input), units.effort, response.peak.joint),
            Fact("at a limit", full, "% of the samples"),
        ]
    if not len(timing.time):
        return facts
    step, late = percentiles(timing.computed), percentiles(timing.woken)
    if timing.real_time:
        note = f"99.9 % of samples; largest {1e6 * late['max']:.0f} µs"
        facts += [
            Fact("missed deadlines", int(timing.missed.sum()), f"of {len(timing.time)}"),
            Fact("jitter", rounded(1e6 * late["p99.9"]), "µs", note),
        ]
    note = f"median; period {number(1e6 * timing.period)} µs, largest {1e6 * step['max']:.0f} µs"
    return [*facts, Fact("controller's step", rounded(1e6 * step["p50"]), "µs", note)]


def _saturated(prepared: DeployedRun, run: RealTimeRun) -> np.ndarray:
    """Share of the samples at which each motor is at a limit (m,)."""
    low, high = run.input_range
    inputs = run.trajectory.signals["input"]
    edge = NEAR_LIMIT * np.where(np.isfinite(high - low), 0.5 * (high - low), 0.0)
    return np.mean((inputs <= low + edge) | (inputs >= high - edge), axis=0)


def _command(prepared: DeployedRun, run: RealTimeRun) -> np.ndarray:
    """Commanded link positions (N, n), rad or m: the reference where there is one, else the goal."""
    trajectory, names = run.trajectory, signal_names("link_position", prepared.robot.joint_names)
    if prepared.plan is not None:
        return np.reshape(prepared.plan(trajectory.time), (len(trajectory.time), -1))
    known = trajectory.names.get("reference", ())
    columns = [
        trajectory.signal("reference", name) if name in known else np.full(len(trajectory.time), goal)
        for name, goal in zip(names, prepared.goal)
    ]
    return np.stack(columns, axis=1)


def _result_figure(prepared: DeployedRun, run: RealTimeRun) -> Figure:
    """Links with their command, and inputs."""
    response, units, time = prepared.response(run), _units(prepared), run.trajectory.time
    links = joint_panels(
        units,
        "link position",
        units.angle,
        time,
        units.scale * response.positions,
        plan=units.scale * _command(prepared, run),
        plan_name="command",
    )
    inputs = joint_panels(units, "input", units.effort, time, response.inputs, limits=_bounds(run))
    figure, axes = new_figure(len(links) + len(inputs), height=lead_height(len(links) + len(inputs)))
    for axis, panel in zip(axes, (*links, *inputs)):
        panel.draw(axis)
    legend(axes[0])
    return figure_block(
        "result", figure,
        f"Links and inputs as simulated by MuJoCo. Dotted: the command.{_dashed(inputs)}",
        "The run",
    )  # fmt: skip


def _dashed(parts: Sequence[Panel]) -> str:
    """What dashed lines are, where there are some."""
    return " Dashed: limits." * any(panel.dashed for panel in parts)


def _bounds(run: RealTimeRun) -> np.ndarray:
    """Limits of the inputs (m,): the nearer of both sides, infinite where there is none."""
    return np.minimum(*np.abs(run.input_range))


def _tracking_figure(prepared: DeployedRun, run: RealTimeRun) -> Figure:
    response, units, time = prepared.response(run), _units(prepared), run.trajectory.time
    small, factor = units.small
    error = factor * (response.positions - _command(prepared, run))
    theta = prepared.robot.layout.relaxed(run.trajectory.signals["state"].T).T
    return draw_figure(
        "tracking",
        (
            *joint_panels(units, "link − command", small, time, error, zero=True),
            *joint_panels(units, "wind-up, motor − link", small, time, factor * (theta - response.positions)),
        ),
        "Distance of the links from their command, and twist of the springs as seen from the link side.",
        "Tracking",
    )


def _effort(prepared: DeployedRun, run: RealTimeRun) -> list[PageBlock | Drawing]:
    """Inputs over time, and how large they are."""
    response, units, time = prepared.response(run), _units(prepared), run.trajectory.time
    parts = joint_panels(units, "input", units.effort, time, response.inputs, limits=_bounds(run))
    low, high = run.input_range
    rows = [
        (joint, float(peak_of(u)), float(np.sqrt(np.square(u).mean())), float(a) if np.isfinite(a) else None,
         float(b) if np.isfinite(b) else None, 100.0 * float(share))
        for joint, u, a, b, share in zip(
            response.joints, response.inputs.T, low, high, _saturated(prepared, run), strict=True
        )
    ]  # fmt: skip
    columns = (
        "joint", Column("peak", units.effort, digits=3), Column("rms", units.effort, digits=3),
        Column("lower limit", units.effort), Column("upper limit", units.effort), Column("at a limit", "%", digits=3),
    )  # fmt: skip
    table = Table(columns, rows, "Inputs, and the share of the samples at a limit", "table-effort")
    return [lambda: draw_figure("effort", parts, f"Inputs as applied.{_dashed(parts)}", "Inputs"), table]


def _status(run: RealTimeRun) -> Section:
    """What the controller reported."""
    said = {bit: run.status & bit > 0 for bit in Status}
    columns = (
        Column("status", of=lambda bit: STATUS_SENTENCES[bit].rstrip(",")),
        Column("samples", f"of {len(run.status)}", of=lambda bit: int(said[bit].sum())),
        Column(
            "first at",
            "s",
            of=lambda bit: float(run.trajectory.time[int(np.argmax(said[bit]))]) if said[bit].any() else None,
        ),
    )
    title = "What the controller watches at run time"
    codes = {run.code_names[int(code)]: int(np.sum(run.codes == code)) for code in np.unique(run.codes)}
    return Section(
        "What the controller says",
        (Table.of(columns, [*Status], title, "table-status", stacks=True),),
        "status",
        numbers={
            "status": {str(bit.name).lower(): int(samples.sum()) for bit, samples in said.items()},
            "codes": codes,
        },
    )


@house_style()
def _times_figure(timing: Timing) -> Figure:
    """When the input of each sample was there, and how long the controller's step took."""
    figure, (upper, lower) = new_figure(2)
    ready, few = 1e6 * timing.ready, _highest(timing.ready)
    upper.plot(timing.time[few], ready[few], color=SERIES[0], linewidth=1.0)
    if timing.real_time and 4.0 * ready.max() > 1e6 * timing.period:
        upper.axhline(1e6 * timing.period, color=MUTED, linewidth=1.0, dashes=DASHED)
    label(upper, "input ready after", "µs")
    few = _highest(timing.computed)
    lower.plot(timing.time[few], 1e6 * timing.computed[few], color=SERIES[1], linewidth=1.0)
    label(lower, "controller's step", "µs")
    for axes in (upper, lower):
        axes.set_ylim(bottom=0.0)
    return figure_block(
        "times", figure,
        "Above: from the moment a sample is due until its input is there; the deadline is the period, dashed where it "
        "is near. Below: computing time of the controller. Of neighbouring samples the slowest is drawn.",
        "Times of the samples",
    )  # fmt: skip


def _highest(values: np.ndarray, points: int = 800) -> np.ndarray:
    """Places of the largest values, one out of each of as many neighbourhoods."""
    edges = np.linspace(0, len(values), min(points, len(values)) + 1).astype(int)
    return np.array([a + int(np.argmax(values[a:b])) for a, b in pairwise(edges)])
