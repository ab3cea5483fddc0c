"""The step from the start pose to the goal: responses, the arm at a few instants, table; on MuJoCo's plant; and on
robots sampled within their tolerances, with the controller as it was designed."""

# Not checked strictly: parts of Matplotlib have no types.
# pyright: reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from flexhinf.designs.evaluation import LawEvaluation
from flexhinf.designs.monte_carlo import MonteCarlo
from flexhinf.designs.pose_evidence import PoseEvidence
from flexhinf.designs.problem.presets import robust_applies
from flexhinf.designs.responses import ROBOT, Response
from flexhinf.designs.specification import ESTIMATED_BY
from flexhinf.numerals import number
from flexhinf.pages.drawing import (
    DASHED,
    ROW,
    Blocks,
    Line,
    Panel,
    Units,
    changes_text,
    draw_figure,
    figure_block,
    in_joint,
    joint_panels,
    joint_table,
    left_out_notes,
    legend_above,
    note,
    settling_text,
    units_of,
)
from flexhinf.plant import Plant
from flexhinf.report import (
    INK,
    MUTED,
    SERIES,
    WIDTH,
    Column,
    Figure,
    LineStyle,
    Paragraph,
    Table,
    house_style,
    label,
    legend,
    new_figure,
    panels,
    quantile_band,
    settling_band,
)
from flexhinf.robot import Robot
from flexhinf.robot.kinematics import picture_axes, skeleton, to_the_right

#: A peak input within so many samples of the start that is so much larger than all later ones is the estimator's.
STARTING, MUCH = 20, 1.5

#: Parts of the way at which the arm is drawn.
STAGES = (0.0, 0.25, 0.5, 0.75, 1.0)


def step(design: PoseEvidence) -> Blocks:
    """The step: figure and metrics of each joint; on MuJoCo's plant too."""
    e, mujoco = design.evaluation, design.mujoco
    s, units = e.setup.specification, units_of(e)
    yield from map(note, left_out_notes(e.setup.robot, e.setup.extras, "the true plant of this report"))
    if e.step.diverged_at is not None:
        yield note(
            f"The step diverges at {number(e.step.diverged_at, 3)} s. Start nearer to the goal, or change the weights."
        )
    sizes = np.abs(e.step.inputs).max(axis=1)
    at, late = int(np.argmax(sizes)), np.abs(e.step.inputs[STARTING:]).max(axis=0, initial=0.0)
    later = float(late.max())
    first, second = (e.setup.joints[int(np.argmax(row))] for row in (np.abs(e.step.inputs[at]), late))
    if s.estimator != "none" and 0 < at < STARTING < len(sizes) and sizes[at] >= MUCH * later:
        yield note(
            f"The peak input of {units.text(float(sizes[at]), units.effort, first)}"
            f"{in_joint(first, e.setup.joints)} occurs "
            f"{number(1e3 * at * s.period, 2)} ms after the start, while the gain of the estimator is still "
            f"settling. From {number(1e3 * STARTING * s.period, 3)} ms on the peak is "
            f"{units.text(later, units.effort, second)}. Let the estimator run before the law takes over."
        )
    yield from (lambda: _step_figure(e, units), lambda: arm_of(e))
    small, scale = units.small
    error = Column("steady-state error", small, key="steady_state_error", scale=scale)
    peak, last = Column("peak input", units.effort, key="peak_input"), float(e.step.run.time[-1])
    yield joint_table(
        units,
        (
            Column("from", units.angle, key="from", scale=units.scale),
            Column("to", units.angle, key="to", scale=units.scale),
            Column("overshoot", "%", 1, key="overshoot_percent"),
            Column("settling time", key="settling"),
            error,
            peak,
            Column("input noise", units.effort, key="input_noise"),
        ),
        [
            {
                **row,
                "from": float(begin),
                "to": float(end),
                "settling": settling_text(row["settling_time_s"], last) if "settling_time_s" in row else None,
            }
            for row, begin, end in zip(e.step.metrics, e.setup.start, e.setup.goal)
        ],
        "True link positions. Settling: to ±2 % of the joint's own step. Steady-state error: largest in the last tenth "
        "of the run. Input noise: standard deviation there",
        "table-step",
    )
    yield motion_table(e, e.step_motion, "table-step-motion")
    if mujoco is not None:
        plants = {"ours": e.step, "MuJoCo's": mujoco}
        columns = (
            Column("plant", key="plant"),
            Column("joint", key="joint"),
            Column("overshoot", "%", key="overshoot_percent"),
            Column("settling time", "s", 3, key="settling_time_s"),
            error,
            peak,
        )
        rows = [{**row, "plant": plant} for plant, response in plants.items() for row in response.metrics]
        yield Table.of(
            *units.by_joint(columns, rows),
            f"The same controller and noise on MuJoCo's plant: {difference_text(e.step, mujoco, units)}",
            "table-mujoco",
        )


def motion_table(e: LawEvaluation, rows: Sequence[Mapping[str, Any]], id: str) -> Table:
    """The motion of each joint in a run, by its `motion_metrics`."""
    units = units_of(e)
    unit, scale = units.small
    return joint_table(
        units,
        (
            Column("wrong way", "%", 2, key="wrong_way_percent"),
            Column("excursion", "%", 2, key="excursion_percent"),
            Column("from the path", unit, 3, key="path_distance", scale=scale),
            Column("remaining error", unit, 3, key="remaining_error", scale=scale),
            Column("ripple", "%", 2, key="ripple_percent"),
        ),
        rows,
        "Wrong way: how far a joint leaves the range of its command on the start's side, per cent of its travel. "
        "Excursion: of a joint that should rest, per cent of the largest travel. From the path: from its nearest "
        "point, early or late. Remaining error and ripple, in per cent of the motor's limit: in the last 0.3 s",
        id,
    )


def step_text(response: Response, units: Units) -> str:
    """The step in one sentence."""
    if response.diverged_at is not None:
        return f"The step diverges at {number(response.diverged_at, 3)} s."
    if not any("overshoot_percent" in row for row in response.metrics):
        return "No joint moves in this step."
    overshoot, settling = response.overshoot, response.settling
    late = f"does not settle within {number(float(response.run.time[-1]), 3)} s"
    settles = f"settles in {number(settling.value, 3)} s" if np.isfinite(settling.value) else late
    return (
        f"The step {settles}{in_joint(settling.joint, response.joints)}, overshoots by {number(overshoot.value, 2)} %"
        f"{in_joint(overshoot.joint, response.joints)} and needs at most {peak_text(response, units)}."
    )


def peak_text(response: Response, units: Units) -> str:
    """The largest input of a run, with its joint where there are several."""
    joint = response.peak.joint
    where = "" if response.diverged_at is not None else in_joint(joint, response.joints)
    return f"{units.text(response.peak_input, units.effort, joint)}{where}"


def stiffness_of(plant: Plant, robot: Robot, rigid: float) -> np.ndarray:
    """Stiffness of the nominal springs (n,), N·m/rad or N/m; `rigid` for a rigid joint."""
    stiffness = np.full(robot.layout.n, rigid)
    stiffness[robot.layout.elastic] = plant.parameters.named(plant.parameters.vector()).stiffness
    return stiffness


def spring_torques(e: LawEvaluation, response: Response) -> np.ndarray:
    """Torques of the nominal springs along a run (N, n), N·m or N; zero in a rigid joint."""
    layout = e.setup.robot.layout
    q, _, theta, _ = np.split(layout.whole(response.run.signals["state"].T), 4)
    return stiffness_of(e.setup.model, e.setup.robot, 0.0) * (theta - layout.at_motors(q)).T


def input_panels(e: LawEvaluation, response: Response) -> tuple[list[Panel], str]:
    """Inputs of a run, a panel for each unit, with the tighter of the required peak and the saturation; and the name of
    that limit."""
    limits, units, name = e.setup.limits, units_of(e), ""
    if limits.limits_effort:
        required = bool(np.all(limits.peak <= limits.saturation))
        source = limits.peak_source if required else limits.saturation_source
        name = (
            "limit of the motor" if source == ROBOT else "required: at most" if required else "saturation at"
        )
        name = f"{name} {units.effort_text(limits.effort)}"
    lines = {"limits": limits.effort, "limit_name": name} if name else {}
    return joint_panels(units, "input", units.effort, response.run.time, response.inputs, **lines), name


def _step_figure(e: LawEvaluation, units: Units) -> Figure:
    response, command, s = e.step, e.setup.command, e.setup.specification
    time, goal, (inputs, limit) = response.run.time, response.goal, input_panels(e, response)
    fed = ESTIMATED_BY[s.estimator]
    if s.estimator != "none":
        fed = f"with {fed} on {', '.join(s.measured).replace('_', ' ')} and measurement noise"
    near = any(panel.dashed for panel in inputs)
    bound = f" (dashed: {limit})" if near else f" ({limit}, beyond the panel)" if limit else ""
    away = joint_panels(
        units,
        "link position − goal",
        units.angle,
        time,
        units.scale * (response.positions - goal),
        zero=True,
        plan=None if command is None else units.scale * (command(time) - goal),
        plan_name="command",
        min_span=0.1 * units.scale * np.abs(goal - response.start),
    )
    springs = joint_panels(
        units, "spring torque", units.spring, time, spring_torques(e, response), min_span=0.0
    )
    parts = (*away, *springs, *inputs)
    return draw_figure(
        "step",
        parts,
        f"Nonlinear loop, {fed}{'' if command is None else f', its command {command.name}'}: link positions as "
        f"distance from the goal (dotted), torques of the springs, and inputs as applied{bound}.",
        "Step response",
        ROW * len(parts),
    )


def difference_text(own: Response, other: Response, units: Units) -> str:
    """Difference between the runs on MuJoCo's plant and on that of flexhinf, in words."""
    if other.diverged_at is not None or own.diverged_at is not None:
        return "it diverges" if other.diverged_at is not None else "it does not diverge"
    apart = units.scale * np.abs(other.positions - own.positions).max(axis=0)
    joint = own.joints[int(np.argmax(apart))]
    size = units.text(float(apart.max()), units.angle, joint, 2)
    return f"link positions differ by at most {size}{in_joint(joint, own.joints)}"


# The arm ------------------------------------------------------------------------------------------------
def arm_of(e: LawEvaluation) -> Figure | None:
    """The arm during the step; None for a run that diverges or links without a length."""
    response = e.step
    if response.diverged_at is not None:
        return None
    return arm_figure(
        e.setup.robot,
        response.run.time,
        response.positions,
        e.setup.robot.layout.relaxed(response.run.signals["state"].T).T,
        instants(response.positions, response.start, response.goal),
    )


def instants(positions: np.ndarray, start: np.ndarray, goal: np.ndarray) -> list[int]:
    """Samples at which a run (N, n) first has done these `STAGES` of its way, the last one at the end of the run."""
    way, last = goal - start, len(positions) - 1
    if not way.any():
        return [0]
    done = (positions - start) @ way / float(way @ way)
    return sorted(
        {*(int(np.argmax(done >= part)) if np.any(done >= part) else last for part in STAGES[:-1]), last}
    )


#: Links and motors in pictures of the arm.
LINKS: LineStyle = {"color": SERIES[0], "linewidth": 2.6, "alpha": 0.85}
MOTORS: LineStyle = {"color": SERIES[1], "linewidth": 1.3, "dashes": (4.0, 2.0)}


@house_style()
def arm_figure(
    robot: Robot, time: np.ndarray, links: np.ndarray, motors: np.ndarray, at: Sequence[int]
) -> Figure | None:
    """Links and motors (N, n) of a run at some samples, the motors as seen from the link side; None for a robot whose
    links have no length."""
    poses = [(skeleton(robot, links[k]), skeleton(robot, motors[k])) for k in at]
    seen = arm_plane(robot, [lines for pair in poses for lines in pair])
    if seen is None:
        return None
    view, names, (low, high) = seen
    wide, flat = high - low
    lack = np.array([0.0, max(0.0, 0.6 * wide - flat)])  # of a flat arm, whose numbers stand on each other
    low, high = low - 0.5 * lack, high + 0.5 * lack
    tall = max(0.6, float(flat / wide))  # of each panel, over its width
    # beside the arm, inches: legend, titles and names of the axes in height, numbers in width
    figure, (axes,) = panels(
        1, len(at), 1.5 + min(tall, 2.0) * (WIDTH - 0.8) / len(at), sharex=True, sharey=True
    )
    for k, (axis, (own, behind)) in enumerate(zip(axes, poses, strict=True)):
        for lines, name, style in ((behind, "motors", MOTORS), (own, "links", LINKS)):
            for j, line in enumerate(lines):
                axis.plot(*(line @ view).T, label=name if k == j == 0 else None, **style)
        joints = np.array([line[0] for line in own]) @ view
        axis.plot(*joints.T, "o", color=INK, markersize=3.5, label=None if k else "joints")
        axis.axhline(float(joints[0, 1]), color=MUTED, linewidth=0.6, zorder=0)
        axis.set_title(f"{number(float(time[at[k]]), 3)} s")
        axis.locator_params(nbins=2)
        if k == len(at) // 2:
            axis.set_xlabel(f"{names[0]} (m)")
        axis.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    legend_above(figure, axes[0], 3)
    label(axes[0], names[1], "m")
    return figure_block(
        "arm",
        figure,
        "The angle between a link and its motor, seen from the link side of the gear, is the twist of the spring. A "
        "last link is drawn to twice the distance of its centre of mass.",
        "The arm during the step",
    )


def arm_plane(
    robot: Robot, arms: Sequence[Sequence[np.ndarray]]
) -> tuple[np.ndarray, tuple[str, str], tuple[np.ndarray, np.ndarray]] | None:
    """Axes of a picture of some arms (3, 2), their names, and its corners, m; None for links without a length."""
    points = np.concatenate([line for lines in arms for line in lines])
    size = float(np.ptp(points, axis=0).max())
    if size < 1e-9:
        return None
    view, names = viewing_plane(robot, points, size)
    flat = points @ view
    return view, names, (flat.min(axis=0) - 0.08 * size, flat.max(axis=0) + 0.08 * size)


def viewing_plane(robot: Robot, points: np.ndarray, size: float) -> tuple[np.ndarray, tuple[str, str]]:
    """Axes of the picture (3, 2), to the right and up, and their names: along the axes of the turning joints; of an arm
    whose axes differ upright if its points leave the horizontal, else from above."""
    if (seen := picture_axes(robot)) is not None:
        return seen.axes, seen.names
    down = np.asarray(robot.links.down, dtype=float)
    up, centred = -down / np.linalg.norm(down), points - points.mean(axis=0)
    spread = np.linalg.svd(centred - np.outer(centred @ up, up), full_matrices=True)[2]
    right, name = to_the_right(next(row for row in spread if abs(row @ up) < 0.5))
    if np.ptp(centred @ up) > 0.02 * size:  # else all points lie in one plane
        return np.column_stack([right, up]), (name, "height")
    return np.column_stack([right, np.cross(up, right)]), (name, "seen from above")


# Sampled robots -----------------------------------------------------------------------------------------
#: Panels of link positions: of the joints whose robots differ most, relative to the largest step.
PANELS = 3

#: Half height of the panel about the goal, relative to the step.
CLOSE = 0.12


def samples(design: PoseEvidence) -> Blocks:
    """Bands, histograms and a table of the sampled robots; none where no robot was sampled."""
    e, runs = design.evaluation, design.evaluation.step_samples
    if runs is None or not len(runs):
        return
    if runs.diverged:
        applies = robust_applies(e.setup.robot, e.setup.specification, e.setup.goal)
        yield note(
            f"{runs.diverged} of {len(runs)} robots within their tolerances diverge with this controller."
            + " --preset robust includes the tolerances in the synthesis." * applies
        )
    robot, extras = e.setup.true.robot, e.setup.extras
    which = (
        f" {what}: robot {k + 1} ({changes_text(runs.values[k], robot, extras)})."
        for what, k in (
            {"Largest overshoot and slowest settling": runs.worst}
            if runs.worst == runs.slowest
            else {"Largest overshoot": runs.worst, "Slowest settling": runs.slowest}
        ).items()
    )
    yield Paragraph(
        f"{len(robot.uncertain)} parameters are sampled uniformly within their tolerances, {len(runs)} times, each "
        "with its own measurement noise. The controller stays as designed for the nominal robot. A sample says nothing "
        f"about the robots between.{''.join(which)}"
    )
    if np.isfinite(runs.positions).all(axis=(1, 2)).any():
        yield lambda: _bands(e, runs)
    if len(runs) >= 15 and np.isfinite([runs.overshoot, runs.settling]).any():
        yield lambda: _histograms(e, runs)
    yield spread_table(e, runs)


def _bands(e: LawEvaluation, samples: MonteCarlo) -> Figure:
    units, names, time = units_of(e), e.setup.joints, samples.time
    ended = np.flatnonzero(np.isfinite(samples.positions).all(axis=(1, 2)))
    away = units.scale * (samples.positions[ended] - e.setup.goal)
    steps = units.scale * np.abs(e.setup.goal - e.setup.start)
    spread = np.ptp(away, axis=0)  # of all robots, at each time and joint
    widest = sorted(np.argsort(-spread.max(axis=0))[:PANELS].tolist())
    late = spread[away.shape[1] // 2 :].max(axis=0) / np.where(steps > 0.0, steps, 1.0)
    close = int(np.argmax(np.where(steps > 0.0, late, -1.0)))
    worst = {samples.worst: "largest overshoot"}
    worst[samples.slowest] = f"{worst.get(samples.slowest, '')}, slowest settling".removeprefix(", ")
    styles: tuple[LineStyle, ...] = (
        {"color": INK, "linewidth": 1.1, "dashes": (5.0, 1.5)},
        {"color": SERIES[1], "linewidth": 1.1, "dashes": (2.0, 1.2)},
    )
    figure, axes = new_figure(len(widest) + 1)
    for axis, joint in zip(axes, [*widest, close]):
        quantile_band(axis, time, away[:, :, joint])
        lines = [
            Line(time, line, name, style)
            for (robot, name), style in zip(worst.items(), styles)
            for line in away[ended == robot, :, joint]
        ]
        unit = units.of(units.angle, names[joint])
        Panel(f"{names[joint] if len(names) > 1 else 'link'} − goal", unit, lines, (0.0,)).draw(axis)
    settling_band(axes[-1], 0.0, float(steps[close]))
    axes[-1].set_ylim(-CLOSE * steps[close] or -1e-3, CLOSE * steps[close] or 1e-3)
    legend(axes[0])
    some = f", the {len(widest)} joints that differ most" if len(widest) < len(names) else ""
    closer = f"{names[close]}, close to its goal" if len(names) > 1 else "the same, close to the goal"
    missing = len(samples) - len(ended)
    return figure_block(
        "draws",
        figure,
        f"Link positions as distance from the goal{some}, of {len(ended)} sampled robots."
        f"{f' {missing} that diverged are left out.' if missing else ''} Bottom: {closer}, "
        "with the band of ±2 % of the step.",
        "Sampled robots",
    )


def _metrics(e: LawEvaluation, samples: MonteCarlo) -> list[tuple[str, str, np.ndarray, float, str]]:
    own, m, joints, units = e.step, samples, samples.joints, units_of(e)
    strongest = joints["peak"][int(np.argmax(m.peak))]
    return [
        ("overshoot", "%", m.overshoot, own.overshoot.value, joints["overshoot"][m.worst]),
        ("settling time", "s", m.settling, own.settling.value, joints["settling"][m.slowest]),
        ("peak input", units.of(units.effort, strongest), m.peak, own.peak_input, strongest),
    ]


def _histograms(e: LawEvaluation, samples: MonteCarlo) -> Figure:
    s, peaks = e.setup.specification, e.setup.limits.peak
    same = np.isfinite(peaks[0]) and len(set(peaks.tolist())) == 1
    limits, grains = (s.limit("overshoot"), None, float(peaks[0]) if same else None), (0.0, s.period, 0.0)
    figure, (axes,) = panels(1, 3, 2.5)
    for axis, (name, unit, every, own, _), limit, grain in zip(axes, _metrics(e, samples), limits, grains):
        values = every[np.isfinite(every)]
        axis.set(xlabel=f"{name} ({unit})", ylabel="robots")
        if not len(values):
            continue
        axis.hist(values, bins=histogram_bins(values, grain).tolist(), color=SERIES[0], alpha=0.55)
        axis.grid(axis="x", visible=False)
        axis.locator_params(axis="x", nbins=3)
        if np.isfinite(own):
            axis.axvline(own, color=SERIES[1], linewidth=1.6)
        if limit is not None and float(values.max()) > 0.5 * limit:
            axis.axvline(limit, color=INK, linewidth=1.0, dashes=DASHED)
    return figure_block(
        "spread",
        figure,
        "Worst joint of each robot. Orange: the nominal robot. Dashed: a limit that is near.",
        "Spread of the sampled robots",
    )


def histogram_bins(values: np.ndarray, grain: float) -> np.ndarray:
    """Edges of bins over values; where these are multiples of a grain, such as the period, so is the bins' width: other
    bins would hold now more, now fewer of the possible values, and look like a comb."""
    count = min(20, max(5, len(values) // 5))
    if not grain:
        return np.histogram_bin_edges(values, count)
    first, last = (round(float(end) / grain) for end in (values.min(), values.max()))
    wide = max(1, -(-(last - first + 1) // count))
    return grain * (np.arange(first, last + wide + 1, wide) - 0.5)


def spread_table(e: LawEvaluation, samples: MonteCarlo) -> Table:
    """Nominal robot, median, 95th percentile and worst of the samples, with the joint of the worst."""
    several, rows = len(e.setup.joints) > 1, list[Sequence[object]]()
    for name, unit, values, nominal, joint in _metrics(e, samples):
        quantiles = (float(np.quantile(values, q, method="higher")) for q in (0.5, 0.95, 1.0))
        cells = ("never" if np.isinf(value) else number(value, 3) for value in (nominal, *quantiles))
        rows.append((name, unit, *cells, *([joint or "–"] if several else [])))
    settled = f"{len(samples) - samples.unsettled} of {len(samples)} settle, {samples.diverged} diverge"
    return Table(
        (
            "",
            "unit",
            Column("nominal robot", brief="nominal", right=True),
            Column("median", right=True),
            Column("95 % are below", brief="95 % below", right=True),
            Column("worst", right=True),
            *(["worst joint"] if several else []),
        ),
        rows,
        f"Worst joint of each robot: {settled}" if several else settled,
        "table-draws",
        title=f"The step on {len(samples)} robots sampled within their tolerances: {settled}",
    )
