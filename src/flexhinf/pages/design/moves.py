"""Runs beside the step: torques on the links, payloads that the model does not know, the planned move, and the margins
along it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from flexhinf.analysis import Margins
from flexhinf.design.along_move import MOST_LAWS, AlongMove
from flexhinf.design.evaluation import LawEvaluation
from flexhinf.design.payload import PayloadEvaluation, payload_requirements
from flexhinf.design.responses import LoadResponse, Response
from flexhinf.design.result import Design
from flexhinf.design.specification import RINGS
from flexhinf.pages.design.step import effort_limit, peak_text, stiffness_of
from flexhinf.pages.drawing import (
    Panel,
    figure_block,
    finite,
    joint_table,
    listed,
    pose_text,
    reference_line,
    time_figure,
    units_of,
    vertical_line,
)
from flexhinf.report import SERIES, Column, Figure, Paragraph, Table, label, new_figure, number

#: Margins along a move, and what they are called.
MARGINS = (
    ("damping", "smallest damping ratio"),
    ("peak_sensitivity", "peak sensitivity"),
    ("gain_margin", "gain margin"),
)


# Torques on the links ------------------------------------------------------------------------------------
def load_blocks(design: Design) -> list[Any]:
    """Figure and table of constant torques on the links at the goal."""
    e = design.evaluation
    figure = _load_figure(
        e, e.load_response, "load",
        f"The robot is in equilibrium at the goal. At {e.load_response.at:g} s (dotted) constant torques begin to act "
        "on all links at once. Neither law nor estimator knows of them.",
        "Torques on the links",
    )  # fmt: skip
    units, (unit, scale) = units_of(e), units_of(e).small
    rows = [
        {**row, "twist": abs(row["load"]) / float(k)}
        for row, k in zip(e.load_response.metrics, stiffness_of(e.setup.model, e.setup.robot, np.inf))
    ]
    columns = (
        Column("joint", key="joint"),
        Column("torque on the link", units.load, key="load"),
        Column("twist of its spring", unit, key="twist", scale=scale),
        Column("largest deviation", unit, key="peak_deviation", scale=scale),
        Column("recovered after", "s", 3, key="recovery_time_s"),
        Column("remaining deviation", unit, key="remaining_error", scale=scale),
    )
    caption = (
        "Twist: of the spring under this torque alone. Recovered: within 2 % of the joint's step from start to goal "
        "from then on. Remaining: largest in the last tenth of the time under load"
    )
    return [figure, joint_table(Table.of(columns, rows, caption, "table-load"))]


def load_remarks(design: Design) -> Iterator[str]:
    """A load run that diverges, or does not recover."""
    run = design.evaluation.load_response
    slow = [row["joint"] for row in run.metrics if row["recovery_time_s"] is None]
    if run.response.diverged_at is not None:
        yield "With torques on the links the loop diverges. Try a smaller `--load`."
    elif slow:
        yield (
            f"With constant torques on the links, {' and '.join(slow)} {'is' if len(slow) == 1 else 'are'} still more "
            "than 2 % of the step away from the goal at the end of the load run."
        )


def _load_figure(e: LawEvaluation, loaded: LoadResponse, name: str, caption: str, title: str) -> Figure:
    units, response, (limits, limit_name) = units_of(e), loaded.response, effort_limit(e)
    unit, scale = units.small
    panels = (
        Panel("link position − goal", unit, scale * (response.positions - response.goal), zero=True),
        Panel("input", units.effort, response.inputs, limits=limits, limit_name=limit_name),
    )
    figure, axes = time_figure(response.run.time, response.joints, panels)
    for axis in axes:
        vertical_line(axis, loaded.at)
    return figure_block(name, figure, caption, title)


# Payloads ------------------------------------------------------------------------------------------------
def payload_blocks(design: Design) -> list[Any]:
    """What the robot carries, the heaviest payload as it is gripped, and a table; none without a range of masses."""
    if not design.payloads:
        return []
    one, figures = design.payloads[-1], []
    if one.load_step is not None:
        caption = (
            f"At rest at the goal the robot grips {number(one.mass, 3)} kg at {one.load_step.at:g} s (dotted): the "
            "weight beyond what the model carries acts on all links at once. Neither law nor estimator knows of it."
        )
        title = "Gripping the heaviest payload"
        figures.append(_load_figure(design.evaluation, one.load_step, "payload", caption, title))
    return [Paragraph(_payload_text(design)), *figures, _payload_table(design)]


def payload_text(design: Design) -> str:
    """The heaviest payload in one sentence."""
    one, (unit, scale) = design.payloads[-1], units_of(design.evaluation).small
    if one.step.diverged_at is not None:
        return f"With {number(one.mass, 3)} kg of payload, which the model does not know, the step diverges."
    text = (
        f"With {number(one.mass, 3)} kg of payload, which the model does not know, the step overshoots by "
        f"{number(one.step.overshoot.value, 2)} %"
    )
    if one.load_step is None:
        return f"{text}."
    back = "and is not back within 2 % of its step in the run"
    if np.isfinite(one.recovery.value):
        back = f"and is back within 2 % of its step after {number(one.recovery.value, 2)} s"
    where = f" ({one.deflection.joint})" if len(design.robot.joint_names) > 1 else ""
    sag = f"{number(scale * one.deflection.value, 2)}{'' if unit == '°' else ' '}{unit}"
    return f"{text}; gripping it the robot sags by {sag}{where} {back}."


def payload_remarks(design: Design) -> Iterator[str]:
    """A payload that is not carried, or not as required."""
    for one in design.payloads:
        if one.step.diverged_at is not None or (
            one.load_step and one.load_step.response.diverged_at is not None
        ):
            yield (
                f"The loop diverges with {number(one.mass, 3)} kg of payload. Try a nominal mass nearer to it, "
                "LOWER..NOMINAL..UPPER, or a lower `--bandwidth`."
            )
            return
    places = {
        line.where
        for one in design.payloads
        for line in payload_requirements(design.specification, design.setup.limits, one, RINGS)
    }
    missed = [line.what for line in design.requirements if not line.met and line.where in places]
    if missed:
        yield (
            "With a payload that the model does not know, requirements are not met: "
            f"{listed(list(dict.fromkeys(missed)))}. Try a nominal mass in the "
            "middle of the range, `--payload LOWER..NOMINAL..UPPER@LINK`, or weigh it and design for it."
        )


def _payload_text(design: Design) -> str:
    ranges = ", ".join(
        f"{p.name.removeprefix('payload_mass').strip('_') or 'the link'}: {p.interval[0]:g} to {p.interval[1]:g} kg, "
        f"{p.value:g} kg in the model"
        for p in design.robot.uncertain
        if p.name.startswith("payload_mass")
    )
    text = (
        f"Payload on {ranges}. Law and estimator know the model's mass alone. Integral action compensates the rest of "
        "the weight."
    )
    weighed = design.payloads[-1].weighed
    if weighed is None:
        return text
    said = ", ".join(f"{number(mass, 3)} kg" for mass in weighed.masses.values())
    hidden = max(weighed.hidden.values())
    friction = f", of which dry friction may hide {number(hidden, 2)} kg" if hidden > 0.0 else ""
    return (
        f"{text} At rest the motor torques correspond to {said} for the heaviest{friction}. "
        "flexhinf.robot.weigh_payload weighs, and a design for that mass is one more call."
    )


def _payload_table(design: Design) -> Table:
    e, (unit, scale), limits = design.evaluation, units_of(design.evaluation).small, design.setup.limits

    def row(name: str, step: Response, one: PayloadEvaluation | None, m: Margins) -> tuple[Any, ...]:
        used = limits.input_use(step).value if limits.limits_peak else step.peak_input
        gripped: list[float | None] = [None, None, None]
        if one is not None and one.load_step is not None:
            gripped = [scale * one.deflection.value, one.recovery.value, scale * one.remaining.value]
        figures = [step.overshoot.value, step.settling.value, used, *gripped]
        return (name, *finite([*figures, m.damping, m.peak_sensitivity, m.gain_margin]))

    known = sum(p.value for p in design.robot.uncertain if p.name.startswith("payload_mass"))
    rows = [row(f"{number(known, 3)} kg, as in the model", e.step, None, e.margins)]
    rows += [row(f"{number(one.mass, 3)} kg", one.step, one, one.margins) for one in design.payloads]
    columns = (
        "payload", Column("overshoot", "%", 2), Column("settling", "s", 3),
        Column("peak input", units_of(e).effort), Column("sag when gripped", unit), Column("back after", "s", 2),
        Column("remaining sag", unit), Column("damping", "", 3), Column("peak sensitivity", "", 2),
        Column("gain margin", "", 2),
    )  # fmt: skip
    caption = (
        "Step, gripping, and the running loop at the goal, with the payload in the true robot. Worst joints; the peak "
        "input is that of the motor nearest to its limit. Back: within 2 % of the joint's step from then on"
    )
    return Table(columns, rows, caption, "table-payload", stacks=True)


# The planned move ---------------------------------------------------------------------------------------
def move_blocks(design: Design) -> list[Any]:
    """What a plan changes, figure and table."""
    e, move = design.evaluation, design.evaluation.move
    units, response, (limits, limit_name) = units_of(e), move.response, effort_limit(e)
    (unit, scale), s = units.small, e.setup.specification
    duration, stated = f"{move.plan.duration:.3g} s", s.move is not None
    about = f"The stated move takes {duration} ({move.plan.name})."
    if not stated:
        about = (
            "Robots follow plans more often than steps. Here the plan covers the way of the step in "
            f"{duration} ({s.shaping if s.shaping == 'quintic' else 'limited jerk'})."
        )
    text = (
        f"{about} Its feedforward comes from the elastic inverse dynamics, and the law acts on the error that is left. "
        f"The move needs at most {peak_text(response, units)}, the step {peak_text(e.step, units)}."
    )
    origin, quantity = (0.0, "link position") if stated else (response.goal, "link position − goal")
    position, plan = (units.scale * (values - origin) for values in (response.positions, move.planned))
    panels = (
        Panel(quantity, units.angle, position, plan=plan),
        Panel("link position − plan", unit, scale * move.error, zero=True),
        Panel("input", units.effort, response.inputs, limits=limits, limit_name=limit_name),
    )
    figure = figure_block(
        "move", time_figure(response.run.time, e.setup.joints, panels, 6.6)[0],
        "Link positions and the plan (dotted), the difference of the two, and the inputs. The inputs jump where the "
        "fourth derivative of the plan does.",
        "The move",
    )  # fmt: skip
    rows = [
        {**row, "way": float(way), "relative": row["largest_error"] / float(way) if way else None}
        for row, way in zip(move.metrics, move.ways)
    ]
    columns = (
        Column("joint", key="joint"),
        Column("way", units.angle, key="way", scale=units.scale),
        Column("largest error", unit, key="largest_error", scale=scale),
        Column("of the way", "%", 2, key="relative", scale=100.0),
        Column("rms error", unit, key="rms_error", scale=scale),
        Column("error at the end", unit, key="final_error", scale=scale),
        Column("peak input", units.effort, key="peak_input"),
        Column("peak speed", units.rate, key="peak_speed", scale=units.scale),
    )
    caption = (
        "Errors of the true link positions from the plan. Way: between the extreme positions of the plan. Error at the "
        "end: largest in the last tenth of the run"
    )
    return [Paragraph(text), figure, joint_table(Table.of(columns, rows, caption, "table-move"))]


def move_remarks(design: Design) -> Iterator[str]:
    """A move that diverges."""
    if design.evaluation.move.response.diverged_at is not None:
        yield (
            "The loop diverges while it follows the planned move. Ask for a slower move, "
            "a smaller step or a lower `--bandwidth`."
        )


# Margins along the move ---------------------------------------------------------------------------------
def along_blocks(design: Design) -> list[Any]:
    """Which poses were looked at, the curves, and the worst poses; nothing without a stated move."""
    along = design.synthesis.along
    if along is None:
        return []
    laws = "one law acts everywhere"
    if along.count > 1:
        added = (
            f", {along.added} of them at poses where one law did not keep the limits" if along.added else ""
        )
        laws = f"{along.count} laws are scheduled{added}; the one whose pose is nearest to the command acts"
    text = (
        f"The running loop, estimator included, linearised about the robot at rest at {len(along.times)} poses that "
        f"are evenly apart on the way of the move: {laws}. Velocities along the move are not in it."
    )
    slides, degrees, rows = design.robot.links.slides, units_of(design.evaluation).degrees, []
    for name, quantity in MARGINS:
        values = np.array([getattr(one, name) for one in along.margins], dtype=float)
        k = int(np.argmax(values) if name == "peak_sensitivity" else np.argmin(values))
        rows.append(
            (quantity, float(values[k]), float(along.times[k]), pose_text(along.poses[k], slides, degrees))
        )
    columns = ("figure", Column("worst", "", 3), Column("at", "s", 3), "pose")
    table = Table(columns, rows, "The worst pose of each figure", "table-along")
    return [Paragraph(text), _along_figure(along), table]


def along_remarks(design: Design) -> Iterator[str]:
    """Limits that are exceeded with every law that was tried."""
    along = design.synthesis.along
    if along is None or along.share <= 1.0:
        return
    tried = (
        "with the poses of `--via`"
        if design.specification.via
        else f"with up to {MOST_LAWS} laws scheduled along it, of which {along.count} "
        f"{'is' if along.count == 1 else 'are'} used: more did not help"
    )
    yield (
        f"At {number(float(along.times[along.worst_pose]), 3)} s of the move the margins of the running loop are not "
        f"as required, {tried}. Try a lower `--bandwidth`, another sensor, or poses of your own (`--via`)."
    )


def along_rows(along: AlongMove | None) -> list[dict[str, Any]] | None:
    """Time, pose, law and margins at each pose; None without a stated move."""
    if along is None:
        return None
    return [
        {
            "time_s": float(time), "pose": pose, "law": law, "stable": margins.stable,
            **{name: getattr(margins, name) for name, _ in MARGINS},
        }
        for time, pose, law, margins in zip(along.times, along.poses, along.laws, along.margins)
    ]  # fmt: skip


def _along_figure(along: AlongMove) -> Figure:
    figure, axes = new_figure(3, height=5.4)
    laws = np.array(along.laws)
    for axis, (name, text) in zip(axes, MARGINS):
        values = np.array([getattr(one, name) for one in along.margins], dtype=float)
        for law in sorted(set(along.laws)):
            at, color = laws == law, SERIES[law % len(SERIES)]
            axis.plot(along.times[at], values[at], "o", color=color, markersize=4.5)
        axis.plot(along.times, values, color=SERIES[0], linewidth=1.0, zorder=1)
        if limit := getattr(along.least, name):
            reference_line(axis, limit)
        label(axis, text, "")
    colours = " The colour of a point is that of the law that acts there." if along.count > 1 else ""
    return figure_block(
        "along", figure,
        f"Least damping ratio of all oscillations, peak of |S| and gain margin at poses along the move. Dotted: what "
        f"is required, with its tolerance.{colours}",
        "Margins along the move",
    )  # fmt: skip
