"""Runs beside the step: torques on the links, payloads that the model does not know, impulses, the planned move with
the margins along it, and a long run at rest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from flexhinf.arrays import Number
from flexhinf.designs import judge
from flexhinf.designs.checks import (
    AFTER,
    MOST_LAWS,
    WIDEST,
    ImpulseRuns,
    LimitCycleCheck,
    payload_requirements,
)
from flexhinf.designs.evaluation import LawEvaluation
from flexhinf.designs.pose_evidence import PoseEvidence
from flexhinf.designs.problem.presets import preset_of
from flexhinf.designs.responses import LoadResponse, Move
from flexhinf.designs.specification import RINGS
from flexhinf.loop.simulation.metrics import OSCILLATION_TAIL, tail_of
from flexhinf.loop.simulation.ring_down import VISIBLE
from flexhinf.numerals import number
from flexhinf.pages.design.step import input_panels, motion_table, peak_text, stiffness_of
from flexhinf.pages.drawing import (
    DASHED,
    ROW,
    Blocks,
    Line,
    Panel,
    draw_figure,
    in_joint,
    joint_panel,
    joint_panels,
    joint_table,
    listed,
    note,
    pose_text,
    units_of,
)
from flexhinf.report import MUTED, SERIES, Column, Figure, LineStyle, Paragraph, Table, finite
from flexhinf.robot import Weighing
from flexhinf.robot.elastic import DRY
from flexhinf.robot.parameters import payload_masses

#: Margins along a move, and what they are called.
MARGINS = {
    "damping": "smallest damping ratio",
    "peak_sensitivity": "peak sensitivity",
    "gain_margin": "gain margin",
}

#: Pieces of the run at rest in the figure: of each the extremes are drawn, so that no vibration is lost.
PIECES = 400


# Torques on the links ------------------------------------------------------------------------------------
def load(design: PoseEvidence) -> Blocks:
    """Figure and table of constant torques on the links at the goal."""
    e, run, units = design.evaluation, design.evaluation.load_response, units_of(design.evaluation)
    slow, (unit, scale) = [row["joint"] for row in run.metrics if row["recovery_time_s"] is None], units.small
    if run.response.diverged_at is not None:
        yield note("With torques on the links the loop diverges. Try a smaller `--set load`.")
    elif slow:
        yield note(
            f"With constant torques on the links, {' and '.join(slow)} {'is' if len(slow) == 1 else 'are'} still more "
            "than 2 % of the step away from the goal at the end of the run."
        )
    yield from (
        lambda: _load_figure(
            e,
            run,
            "load",
            f"From {run.at:g} s on (dotted) constant torques, unknown to law and estimator, act on all links at once.",
            "Torques on the links",
        ),
        joint_table(
            units,
            (
                Column("torque on the link", units.load, key="load"),
                Column("twist of its spring", unit, key="twist", scale=scale),
                Column("largest deviation", unit, key="peak_deviation", scale=scale),
                Column("recovered after", "s", 3, key="recovery_time_s"),
                Column("remaining deviation", unit, key="remaining_error", scale=scale),
            ),
            [
                {**row, "twist": abs(row["load"]) / float(k)}
                for row, k in zip(run.metrics, stiffness_of(e.setup.model, e.setup.robot, np.inf))
            ],
            "Twist: under this torque alone. Recovered: within 2 % of the joint's step from start to goal from then "
            "on. Remaining: largest in the last tenth of the time under load",
            "table-load",
        ),
    )


def _load_figure(e: LawEvaluation, loaded: LoadResponse, name: str, caption: str, title: str) -> Figure:
    response, units = loaded.response, units_of(e)
    (unit, scale), inputs = units.small, input_panels(e, response)[0]
    away, time = scale * (response.positions - response.goal), response.run.time
    return draw_figure(
        name,
        (
            *joint_panels(units, "link position − goal", unit, time, away, zero=True, vertical=loaded.at),
            *(replace(panel, vertical=loaded.at) for panel in inputs),
        ),
        caption,
        title,
    )


# Payloads ------------------------------------------------------------------------------------------------
def payload(design: PoseEvidence) -> Blocks:
    """Payloads: text, load step of the heaviest one, and table; nothing without a range of masses."""
    if not design.payloads:
        return
    yield from _payload_notes(design)
    e, heaviest, load_run = design.evaluation, design.payloads[-1], design.payloads[-1].load_step
    masses = payload_masses(design.robot.uncertain)
    ranges = ", ".join(
        f"{p.name.removeprefix('payload_mass').strip('_') or 'the link'}: {p.interval[0]:g} to {p.interval[1]:g} kg, "
        f"{p.value:g} kg in the model"
        for p in masses
    )
    text = f"Payload on {ranges}. Law and estimator know the model's mass alone; integral action compensates the rest."
    if (weighed := heaviest.weighed) is not None:
        text += f" {_weighing_text(heaviest.masses, weighed)}"
    yield Paragraph(text)
    if load_run is not None:
        yield lambda: _load_figure(
            e,
            load_run,
            "payload",
            f"At the goal the robot grips {number(heaviest.mass, 3)} kg at {load_run.at:g} s (dotted): the weight "
            "beyond the model's, unknown to law and estimator, acts on all links at once.",
            "Gripping the heaviest payload",
        )
    (unit, scale), limits = units_of(e).small, design.setup.limits
    rows: list[Sequence[object]] = []
    modelled = f"{number(sum(p.value for p in masses), 3)} kg, as in the model"
    for name, step, m, case in (
        (modelled, e.step, e.margins, None),
        *((f"{number(case.mass, 3)} kg", case.step, case.margins, case) for case in design.payloads),
    ):
        used = judge.measured("peak", limits, [step]).value if limits.limits_peak else step.peak_input
        load = case and case.load_step
        load_step: Sequence[Number | None] = (
            [scale * load.deflection.value, load.recovery.value, scale * load.remaining.value]
            if load
            else [None, None, None]
        )
        metrics = [step.overshoot.value, step.settling.value, used, *load_step, m.damping, m.peak_sensitivity]
        rows.append((name, *finite([*metrics, m.gain_margin])))
    yield Table(
        (
            "payload",
            Column("overshoot", "%", 2),
            Column("settling", "s", 3),
            Column("peak input", units_of(e).effort),
            Column("deflection under it", unit),
            Column("back after", "s", 2),
            Column("remaining deflection", unit),
            Column("damping", "", 3),
            Column("peak sensitivity", "", 2),
            Column("gain margin", "", 2),
        ),
        rows,
        "With the payload in the true robot. Worst joints; the peak input is that of the motor nearest to its limit. "
        "Back: within 2 % of the joint's step from then on",
        "table-payload",
        stacks=True,
    )


def _weighing_text(masses: Mapping[str, float], weighed: Weighing) -> str:
    """What the motor torques at rest say of payloads, kg by name, beside how much dry friction may hide of it."""
    pairs = [(masses.get(name, mass), mass, weighed.hidden[name]) for name, mass in weighed.masses.items()]
    phrase = listed([f"{number(true, 3)} kg as {number(mass, 3)} kg" for true, mass, _ in pairs])
    text = f"From the motor torques at rest with the heaviest payload, flexhinf.robot.weigh_payload finds {phrase}"
    hidden = max(hidden for *_, hidden in pairs)
    if any(hidden >= true > 0.0 for true, _, hidden in pairs):
        return (
            f"{text}: here this is no weighing, because dry friction can hide up to {number(hidden, 2)} kg."
        )
    friction = f", within the {number(hidden, 2)} kg that dry friction can hide" if hidden > 0.0 else ""
    return f"{text}{friction}; a design for that mass is one more call."


def _payload_notes(design: PoseEvidence) -> Blocks:
    for case in design.payloads:
        load_step = case.load_step
        if case.step.diverged_at is not None or (load_step and load_step.response.diverged_at is not None):
            yield note(
                f"The loop diverges with {number(case.mass, 3)} kg of payload. Try a nominal mass nearer to it, "
                "LOWER..NOMINAL..UPPER, or a lower `--bandwidth`."
            )
            return
    s, limits = design.specification, design.setup.limits
    places = {
        line.where for case in design.payloads for line in payload_requirements(s, limits, case, RINGS, 0.0)
    }
    missed = dict.fromkeys(line.what for line in design.requirements if line.missed and line.where in places)
    if missed:
        yield note(
            f"With a payload that the model does not know, requirements are not met: {listed(list(missed))}. Try a "
            "nominal mass in the middle of the range, `--payload LOWER..NOMINAL..UPPER@LINK`, or weigh it and design "
            "for it."
        )


def payload_text(design: PoseEvidence) -> str:
    """The heaviest payload in one sentence."""
    case, units = design.payloads[-1], units_of(design.evaluation)
    text = f"With {number(case.mass, 3)} kg of payload, which the model does not know, the step"
    if case.step.diverged_at is not None:
        return f"{text} diverges."
    text += f" overshoots by {number(case.step.overshoot.value, 2)} %"
    if (load := case.load_step) is None:
        return f"{text}."
    back = (
        f"and is back within 2 % of its step after {number(load.recovery.value, 2)} s"
        if np.isfinite(load.recovery.value)
        else "and is not back within 2 % of its step in the run"
    )
    joint = load.deflection.joint
    size = units.small_text(load.deflection.value, 2, joint) + in_joint(joint, design.robot.joint_names)
    return f"{text}; gripping it deflects the robot by {size} {back}."


# The planned move ---------------------------------------------------------------------------------------
def move(design: PoseEvidence) -> Blocks:
    """The planned move: what the plan changes, figure and table."""
    e, planned, units = design.evaluation, design.evaluation.move, units_of(design.evaluation)
    response, (unit, scale), s = planned.response, units.small, design.evaluation.setup.specification
    if response.diverged_at is not None:
        yield note(
            "The loop diverges while it follows the planned move. Ask for a slower move, a smaller step or a lower "
            "`--bandwidth`."
        )
    duration = f"{planned.plan.duration:.3g} s"
    about, origin, quantity = f"The stated move takes {duration} ({planned.plan.name}).", 0.0, "link position"
    if s.move is None:
        shaping = "quintic" if s.shaping == "quintic" else "limited jerk"
        about = f"Here the robot follows a plan: the way of the step in {duration} ({shaping})."
        origin, quantity = response.goal, "link position − goal"
    forward = "Without feedforward the law follows the positions alone."
    if s.feedforward:
        forward = "Its feedforward comes from the elastic inverse dynamics, and the law acts on the error that is left."
    yield Paragraph(
        f"{about} {forward} "
        f"The move needs at most {peak_text(response, units)}, the step {peak_text(e.step, units)}."
    )

    yield from (
        lambda: _plan_figure(e, planned, quantity, origin),
        joint_table(
            units,
            (
                Column("way", units.angle, key="way", scale=units.scale),
                Column("largest error", unit, key="largest_error", scale=scale),
                Column("of the way", "%", 2, key="relative", scale=100.0),
                Column("rms error", unit, key="rms_error", scale=scale),
                Column("error at the end", unit, key="final_error", scale=scale),
                Column("peak input", units.effort, key="peak_input"),
                Column("peak speed", units.rate, key="peak_speed", scale=units.scale),
            ),
            [
                {**row, "way": float(way), "relative": row["largest_error"] / float(way) if way else None}
                for row, way in zip(planned.metrics, planned.travel)
            ],
            "Errors: of the true link positions from the plan. Way: between its extremes. Error at the end: largest "
            "in the last tenth of the run",
            "table-move",
        ),
        motion_table(e, e.move.motion, "table-move-motion"),
    )


def _plan_figure(e: LawEvaluation, planned: Move, quantity: str, origin: Number) -> Figure:
    """Link positions less `origin`, their distance from the plan, and inputs."""
    response, units = planned.response, units_of(e)
    (unit, scale), time = units.small, response.run.time
    away, plan = units.scale * (response.positions - origin), units.scale * (planned.planned - origin)
    parts = (
        *joint_panels(units, quantity, units.angle, time, away, plan=plan),
        *joint_panels(units, "link position − plan", unit, time, scale * planned.error, zero=True),
        *input_panels(e, response)[0],
    )
    caption = "Link positions and the plan (dotted), their difference, and the inputs."
    return draw_figure("move", parts, caption, "The move", ROW * len(parts))


def margins_along(design: PoseEvidence) -> Blocks:
    """Margins at poses along the move, with the worst poses; nothing without a stated move."""
    along = design.synthesis.along
    if along is None:
        return
    if along.share > 1.0:
        used = f"{along.count} {'is' if along.count == 1 else 'are'} used: more did not help"
        tried = f"with up to {MOST_LAWS} laws scheduled along it, of which {used}"
        yield note(
            f"At {number(float(along.times[along.worst_pose]), 3)} s of the move the margins of the running loop are "
            f"not as required, {'with the poses of `--via`' if design.specification.via else tried}. Try a lower "
            "`--bandwidth`, another sensor, or poses of your own (`--via`)."
        )
    laws, colours = "one law acts everywhere", ""
    if along.count > 1:
        added = f", {along.added} of them where one law did not keep the limits" if along.added else ""
        laws = f"{along.count} laws are scheduled{added}; the one whose pose is nearest to the command acts"
        colours = " The colour of a point is that of the law that acts there."
    yield Paragraph(
        f"The running loop, linearised about the robot at rest at {len(along.times)} poses that are evenly apart on "
        f"the way of the move: {laws}. Velocities along the move are not in it."
    )
    slides, degrees = design.robot.links.slides, units_of(design.evaluation).degrees
    panels, rows, acting = list[Panel](), list[Sequence[object]](), np.array(along.laws)
    for name, quantity in MARGINS.items():
        values = np.array([along.limits.value(name, m) for m in along.margins], dtype=float)
        k = int((np.argmax if name == "peak_sensitivity" else np.argmin)(values))
        rows.append((quantity, values[k], along.times[k], pose_text(along.poses[k], slides, degrees)))
        limit = getattr(along.limits, name)
        lines = [
            *(
                Line(
                    along.times[acting == law],
                    values[acting == law],
                    None,
                    {
                        "color": SERIES[law % len(SERIES)],
                        "marker": "o",
                        "markersize": 4.5,
                        "linestyle": "none",
                    },
                )
                for law in sorted(set(along.laws))
            ),
            Line(along.times, values, None, {"color": SERIES[0], "linewidth": 1.0, "zorder": 1}),
        ]
        panels.append(Panel(quantity, "", lines, (limit,) if limit else ()))
    yield from (
        lambda: draw_figure(
            "along",
            panels,
            f"At poses along the move. Dotted: what is required, with its tolerance.{colours}",
            "Margins along the move",
            5.4,
        ),
        Table(
            ("figure", Column("worst", "", 3), Column("at", "s", 3), "pose"),
            rows,
            "The worst pose of each figure",
            "table-along",
        ),
    )


# Ring-down after an impulse ---------------------------------------------------------------------------
def ring_down(design: PoseEvidence) -> Blocks:
    """Ring-down of the loop after an impulse on each link: figure and table; nothing where a run diverged."""
    runs, units = design.evaluation.ring_down, units_of(design.evaluation)
    if runs.ring_down is None:
        yield note(
            f"After an impulse on {runs.responses[0].joints[runs.worst]} at the goal the loop diverges."
        )
        return
    if not runs.exponential:
        yield note(
            "After an impulse the loop does not decay as a linear one does (dry friction, backlash or limits), and "
            f"{'comes' if runs.ring_down.rests else 'does not come'} to rest; the damping ratios are those of the "
            "nearest decaying oscillations."
        )
    yield lambda: _ring_down_figure(runs)
    unit, scale = units.small
    yield joint_table(
        units,
        (
            Column("impulse", units.impulse, key="impulse"),
            Column("largest deviation", unit, key="peak_deviation", scale=scale),
            Column("least damping ratio", "", 3, key="damping"),
            Column("its frequency", "Hz", 3, key="frequency_Hz"),
            Column(f"left after {AFTER:g} periods", "%", 2, key="left", scale=100.0),
        ),
        ring_down_rows(runs),
        "Damping ratio: the least of the oscillations that make up "
        f"{100.0 * VISIBLE:g} % of the joint's own velocity or input, fitted to all samples of all runs; fit and "
        f"runs differ by {number(100.0 * runs.ring_down.error, 2)} % of the peak at most. Left: largest velocity of "
        "the link from then on, of its peak",
        "table-ring-down",
    )


def ring_down_rows(runs: ImpulseRuns) -> list[dict[str, Any]]:
    """Row of each joint: impulse, peak deviation of its link, least damped oscillation, and what is left of it."""
    fit = runs.ring_down
    return [
        {
            "joint": run.joints[k],
            "impulse": float(runs.impulses[k]),
            "peak_deviation": runs.peak_deviation(k),
            "damping": fit and fit.damping_of(k),
            "frequency_Hz": oscillation and oscillation.frequency,
            "left": None if fit is None else runs.left(k),
        }
        for k, (run, oscillation) in enumerate(
            zip(runs.responses, map(runs.least_damped, range(len(runs.responses))))
        )
    ]


def _ring_down_figure(runs: ImpulseRuns) -> Figure:
    joints, time, worst = runs.responses[0].joints, runs.responses[0].run.time, runs.worst
    oscillation = runs.least_damped(worst)
    early = time <= (time[-1] if oscillation is None else 8.0 / oscillation.frequency)  # some periods
    values = np.column_stack([runs.velocity(k)[early] for k in range(len(joints))])
    panel = joint_panel("link velocity / peak", "", time[early], joints, values, zero=True)
    caption = "Velocity of each link over its peak, after an impulse on it, without measurement noise."
    if oscillation is not None and oscillation.damping > 0.0:
        # begins at the peak: what decays slower is not the oscillation whose damping is given
        size = np.exp(-2.0 * np.pi * oscillation.frequency * oscillation.damping * time[early])
        dashed: LineStyle = {"color": MUTED, "linewidth": 1.0, "dashes": DASHED}
        decay = [Line(time[early], sign * size, None, dashed) for sign in (1.0, -1.0)]
        panel = replace(panel, lines=[*panel.lines, *decay])
        caption += (
            f" Dashed: the decay of the least damped oscillation{in_joint(joints[worst], joints)}, "
            f"{number(oscillation.frequency, 3)} Hz with a damping ratio of {number(oscillation.damping, 2)}."
        )
    return draw_figure("ringing", [panel], caption, "After an impulse", 2.9)


# At rest with dry friction or backlash -------------------------------------------------------------------
def long_run(design: PoseEvidence) -> Blocks:
    """Limit cycle check: figure and table; nothing without dry friction and backlash, or where the run diverged."""
    run, s, units = design.limit_cycle, design.specification, units_of(design.evaluation)
    if run is None:
        return

    def motion(run: LimitCycleCheck, joints: Sequence[int]) -> str:
        return listed(
            [
                f"{run.response.joints[k]} by ±{units.small_text(run.cycles[k].amplitude, 3, run.response.joints[k])} "
                f"({_frequency(run.cycles[k].frequency)})"
                for k in joints
            ]
        )

    def zone(run: LimitCycleCheck) -> str:
        joints = run.response.joints
        sizes: list[float] = [] if run.dead_zone is None else run.dead_zone.tolist()
        return listed(
            [
                f"{units.small_text(size, 2, joint)}{f' in {joint}' if len(joints) > 1 else ''}"
                for joint, size in zip(joints, sizes)
                if size > 0.0
            ]
        )

    if run.without is not None:
        yield note(
            f"{run.cause[0].upper()}{run.cause[1:]} and integral action would keep the robot moving: "
            f"{motion(run.without, [run.without.worst])}. So errors up to {zone(run)} are not integrated; they may "
            "remain. `--set integral_dead_zone` states another zone, 0 none."
        )
    if not run.cycles:
        if run.oscillating:
            yield note(f"The long run at rest with the robot's {run.cause} diverges.")
        return
    dry, outcome = [name for name in run.extras if name in DRY], ""
    if run.oscillating:
        outcome, narrow = f"{run.response.run.time[-1]:.3g} s at rest with {run.cause}: limit cycle", ""
        both = all(
            any(name.startswith(side) for name in s.measured) for side in ("link_position", "motor_position")
        )
        advice = {
            "`--set friction_model=yes`": bool(dry) and not s.friction_model,
            "another `--set integral_dead_zone`": True,
            "sensors on both sides of the springs": not both,
            "weights that damp the vibration (`--preset damped`)": preset_of(design.evaluation.setup.robot, s)
            == "paper",
        }
        if run.tried is not None and run.tried.cycles:
            narrow = (
                f" Errors up to {zone(run.tried)} left unintegrated do not end it: "
                f"{motion(run.tried, [run.tried.worst])}. The design sets no dead zone above {100.0 * WIDEST:g} % of "
                "the joint's step by itself; a wider one may leave an error as large as itself."
            )
        yield note(
            f"With {run.cause} the robot does not come to rest: {motion(run, run.oscillating)}.{narrow} "
            f"Try {' or '.join(text for text, there in advice.items() if there)}."
        )
    yield lambda: _long_run_figure(design, run)
    unit, scale = units.small
    yield joint_table(
        units,
        (
            Column("amplitude", unit, key="amplitude", scale=scale),
            Column("frequency", key="frequency"),
            Column("remaining error", unit, key="remaining_error", scale=scale),
            Column("result", key="result"),
        ),
        [
            {
                **row,
                "frequency": _frequency(row["frequency_Hz"]) if row["amplitude"] > 0.5 * run.limit else "–",
                "result": "limit cycle" if row["amplitude"] > run.limit else "below the limit",
            }
            for row in long_run_rows(run)
        ],
        f"With {run.cause}{'' if run.dead_zone is None else ', and a dead zone of the integrals'}. "
        "Amplitude: half of the distance between the extremes in the last half. Remaining error: largest in the last "
        "tenth",
        "table-hunting",
        outcome,
    )


def _frequency(frequency: float | None) -> str:
    if frequency is None:
        return "less than one period in the last half"
    return f"{number(frequency, 3)} Hz{f', every {number(1.0 / frequency, 3)} s' if frequency < 1.0 else ''}"


def long_run_rows(run: LimitCycleCheck) -> list[dict[str, Any]]:
    """Row of each joint: amplitude and frequency of its limit cycle, and the remaining error; none of a run that
    diverged."""
    return [
        {
            "joint": joint,
            "amplitude": cycle.amplitude,
            "frequency_Hz": cycle.frequency,
            "remaining_error": error,
        }
        for joint, cycle, error in zip(run.response.joints, run.cycles, run.errors.tolist())
    ]


def _long_run_figure(design: PoseEvidence, run: LimitCycleCheck) -> Figure:
    response, units = run.response, units_of(design.evaluation)
    (unit, scale), joints = units.small, response.joints
    time, positions, inputs = (
        tail_of(each, OSCILLATION_TAIL) for each in (response.run.time, response.positions, response.inputs)
    )
    few, deviation = _extremes(time, scale * (positions - response.goal))
    limit = {"limits": np.full(len(joints), run.limit) * scale, "limit_name": "limit"}
    sharp = "sharp: it holds a motor until the torque exceeds it" if run.sharp else "smoothed"
    friction = f" Dry friction is {sharp}." if set(run.extras) & set(DRY) else ""
    return draw_figure(
        "rest",
        (
            *joint_panels(units, "link position − goal", unit, few, deviation, zero=True, **limit),
            *joint_panels(units, "input", units.effort, few, _extremes(time, inputs)[1]),
        ),
        f"The last half of {response.run.time[-1]:.3g} s at the goal, without measurement "
        f"noise.{friction} An amplitude beyond {units.small_text(run.limit, 3)} is a limit cycle.",
        f"At rest with {run.cause}",
    )


def _extremes(time: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Times and rows (N, n) of the extremes in `PIECES` pieces, the smallest first where a signal rises."""
    times, rows = list[float](), list[np.ndarray]()
    for piece in np.array_split(np.arange(len(time)), min(PIECES, len(time))):
        part = values[piece]
        low, high, rises = part.min(axis=0), part.max(axis=0), part[-1] >= part[0]
        times += [time[piece[0]], time[piece[-1]]]
        rows += [np.where(rises, low, high), np.where(rises, high, low)]
    return np.array(times), np.array(rows)
