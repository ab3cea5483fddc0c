"""The step from the start pose to the goal: figure, the arm at a few instants, table; and on MuJoCo's plant."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from flexhinf.design.evaluation import LawEvaluation
from flexhinf.design.joint_limits import ROBOT
from flexhinf.design.report.drawing import (
    figure_block,
    framed,
    joint_lines,
    limit_lines,
    panels,
    plan_lines,
    reference_line,
    thin,
    widened,
)
from flexhinf.design.report.formatting import (
    ESTIMATORS,
    Units,
    joint_table,
    limit_text,
    listed,
    settling_text,
    units_of,
)
from flexhinf.design.responses import Response
from flexhinf.design.result import Design
from flexhinf.report import (
    INK,
    MUTED,
    SERIES,
    Column,
    Figure,
    Table,
    house_style,
    label,
    legend,
    new_figure,
    number,
)
from flexhinf.robot import Robot
from flexhinf.robot.skeleton import skeleton

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = [
    "arm_figure", "blocks", "difference_text", "effort_limit", "fed_text", "instants", "peak_text", "remarks",
    "spring_torques", "step_text",
]  # fmt: skip

#: A peak input within so many samples of the start that is so much larger than all later ones is the estimator's.
STARTING, MUCH = 20, 1.5

#: What a robot may state and a true plant leaves out unless asked: how the parameter's name begins, and the extra.
STATED = {"inductance": "inductance", "damping": "joint_damping", "coulomb_friction": "coulomb_friction"}

#: Parts of the way at which the arm is drawn.
PARTS = (0.0, 0.25, 0.5, 0.75, 1.0)

#: Height of the figure, in inches, that legend, titles and names of the axes take.
AROUND = 1.25

#: Points closer together than this part of the robot's size lie in one plane.
FLAT = 0.02


def blocks(design: Design) -> list[Any]:
    """What the step looks like, and its figures for each joint."""
    e = design.evaluation
    units, arm = units_of(e), _arm(e)
    drawn = [] if arm is None else [arm]
    return [_figure(e, units), *drawn, _table(e, units), *_mujoco(design, units)]


def remarks(design: Design) -> Iterator[str]:
    """What the reader must not miss."""
    e = design.evaluation
    left = _left_out(design)
    if left:
        yield (
            f"The robot states numbers of {listed(left).replace('_', ' ')} that the true plant of this report "
            f"leaves out. `--extras {','.join(left)}` includes them."
        )
    if e.step.diverged_at is not None:
        when = number(e.step.diverged_at, 3)
        yield f"The step diverges at {when} s. Start nearer to the goal, or change the weights."
    started = _estimator_start(e, units_of(e))
    if started:
        yield started
    if design.inside is False and not np.isnan(design.chosen.level):
        yield (
            "The step starts outside the region in which the sampled check found no violation, so the region says "
            "nothing about it. V at the start counts the integrals that the controller chooses so that the input does "
            "not jump; the largest step of the region has the integrals at which V is smallest, so it can be longer."
        )


def _left_out(design: Design) -> list[str]:
    """Extras for which the robot states numbers, and that are off."""
    names = [parameter.name for parameter in design.robot.parameters if parameter.value]
    return [
        extra
        for begins, extra in STATED.items()
        if extra not in design.specification.extras and any(name.startswith(begins) for name in names)
    ]


def _estimator_start(e: LawEvaluation, units: Units) -> str:
    """A sentence where the peak input falls into the estimator's first samples."""
    s, each = e.setup.specification, np.abs(e.step.inputs)
    sizes = each.max(axis=1)
    at = int(np.argmax(sizes))
    joint = f" ({e.setup.joints[int(np.argmax(each[at]))]})" if each.shape[1] > 1 else ""
    if s.estimator == "none" or not 0 < at < STARTING or len(sizes) <= STARTING:
        return ""
    later = float(sizes[STARTING:].max())
    if sizes[at] < MUCH * later:
        return ""
    return (
        f"The peak input of {number(float(sizes[at]), 3)} {units.effort}{joint} occurs "
        f"{number(1e3 * at * s.period, 2)} ms after the start, while the gain of the "
        "estimator is still settling and noise passes to the input. From "
        f"{number(1e3 * STARTING * s.period, 3)} ms on the peak is {number(later, 3)} {units.effort}. "
        "Let the estimator run before the law takes over."
    )


def step_text(response: Response, units: Units) -> str:
    """The step in one sentence."""
    if response.diverged_at is not None:
        return f"The step diverges at {number(response.diverged_at, 3)} s."
    overshoot, settling = response.overshoot, response.settling
    if not any("overshoot_percent" in row for row in response.metrics):
        return "No joint moves in this step."
    several = len(response.joints) > 1
    passed = f"overshoots by {number(overshoot.value, 2)} %{f' ({overshoot.joint})' if several else ''}"
    peak = f"needs at most {peak_text(response, units)}"
    last = float(response.run.time[-1])
    if not np.isfinite(settling.value):
        where = f" ({settling.joint})" if several else ""
        return f"The step does not settle within {number(last, 3)} s{where}, {passed} and {peak}."
    where = f" ({settling.joint})" if several else ""
    return f"The step settles in {number(settling.value, 3)} s{where}, {passed} and {peak}."


def peak_text(response: Response, units: Units) -> str:
    """The largest input of a run, with its joint where there are several."""
    text, several = f"{number(response.peak_input, 3)} {units.effort}", len(response.joints) > 1
    return f"{text} ({response.peak.joint})" if several and response.diverged_at is None else text


def fed_text(e: LawEvaluation) -> str:
    """What the law is fed with in the runs."""
    s = e.setup.specification
    if s.estimator == "none":
        return ESTIMATORS["none"]
    return (
        f"with {ESTIMATORS[s.estimator]} on {', '.join(s.measured).replace('_', ' ')} and measurement noise"
    )


def spring_torques(e: LawEvaluation, response: Response) -> np.ndarray:
    """Torques of the nominal springs along a run (N, n), N·m or N."""
    n = len(e.setup.goal)
    parameters = e.setup.model.parameters
    stiffness = np.atleast_1d(parameters.named(parameters.vector()).stiffness)
    state = response.run.signals["state"]
    return stiffness * (state[:, 2 * n : 3 * n] - state[:, :n])


def effort_limit(e: LawEvaluation, units: Units) -> tuple[np.ndarray | None, str]:
    """The tighter of the required peak and the saturation (n,), with its name for a legend."""
    limits = e.setup.limits
    if not limits.limits_effort:
        return None, ""
    required = bool(np.all(limits.peak <= limits.saturation))
    source = limits.peak_source if required else limits.saturation_source
    name = "limit of the motor" if source == ROBOT else "required: at most" if required else "saturation at"
    return limits.effort, f"{name} {limit_text(limits.effort)} {units.effort}"


def _figure(e: LawEvaluation, units: Units) -> Figure:
    """Distance from the goal, spring torques and inputs of every joint."""
    response, joints = e.step, e.setup.robot.joint_names
    figure, axes = new_figure(3, height=6.6)
    signals = (
        units.scale * (response.positions - response.goal),
        spring_torques(e, response),
        response.inputs,
    )
    for axis, signal in zip(axes, signals):
        joint_lines(axis, response.run.time, signal, joints)
    command, few = e.setup.command, thin(response.run.time)
    if command is not None:
        plan_lines(
            axes[0], response.run.time, units.scale * (command(response.run.time) - response.goal), "command"
        )
    steps = units.scale * np.abs(response.goal - response.start)
    axes[0].set_ylim(*widened(*framed(signals[0][few]), 0.1 * float(steps.max(initial=0.0))))
    axes[1].set_ylim(*framed(signals[1][few]))
    reference_line(axes[0])
    limit, name = effort_limit(e, units)
    shown = limit_lines(axes[2], limit, signals[2], name)
    label(axes[0], "link position − goal", units.angle)
    label(axes[1], "spring torque", units.spring)
    label(axes[2], "input", units.effort)
    if len(joints) > 1 or command is not None:
        legend(axes[0])
    bound = "" if limit is None else (f" (dashed: {name})" if shown else f" ({name}, beyond the panel)")
    return figure_block(
        "step", figure,
        f"The step from the start pose to the goal in the nonlinear loop, {fed_text(e)}"
        f"{'' if command is None else f', its command {command.name}'}: link positions as distance "
        f"from the goal (dotted), torques of the springs, and inputs as applied{bound}.",
        "Step response",
    )  # fmt: skip


def _arm(e: LawEvaluation) -> Figure | None:
    response, n = e.step, len(e.setup.goal)
    if response.diverged_at is not None:
        return None
    motors = response.run.signals["state"][:, 2 * n : 3 * n]
    at = instants(response.positions, response.start, response.goal)
    return arm_figure(e.setup.robot, response.run.time, response.positions, motors, at)


def _table(e: LawEvaluation, units: Units) -> Table:
    rows = [
        (
            row["joint"],
            units.scale * float(begin),
            units.scale * float(end),
            row.get("overshoot_percent"),
            settling_text(row["settling_time_s"], float(e.step.run.time[-1]))
            if "settling_time_s" in row
            else "–",
            units.scale * row["steady_state_error"],
            row["peak_input"],
            row["input_noise"],
        )
        for row, begin, end in zip(e.step.metrics, e.setup.start, e.setup.goal)
    ]
    columns = (
        "joint",
        Column("from", units.angle),
        Column("to", units.angle),
        Column("overshoot", "%", 1),
        "settling time",
        Column("steady-state error", units.angle),
        Column("peak input", units.effort),
        Column("input noise", units.effort),
    )
    caption = (
        "True link positions. Settling: to ±2 % of the joint's own step. Steady-state error: largest in the last tenth "
        "of the run. Input noise: standard deviation there"
    )
    return joint_table(columns, rows, caption, "table-step")


def _mujoco(design: Design, units: Units) -> list[Table]:
    """The same controller and noise on MuJoCo's plant, beside ours; empty where it was not run."""
    theirs = design.mujoco
    if theirs is None:
        return []
    rows = [
        (
            plant,
            row["joint"],
            row.get("overshoot_percent"),
            row.get("settling_time_s"),
            units.scale * row["steady_state_error"],
            row["peak_input"],
        )
        for plant, response in (("ours", design.evaluation.step), ("MuJoCo's", theirs))
        for row in response.metrics
    ]
    columns = (
        "plant",
        "joint",
        Column("overshoot", "%"),
        Column("settling time", "s", 3),
        Column("steady-state error", units.angle),
        Column("peak input", units.effort),
    )
    caption = f"The same controller and noise on MuJoCo's plant: {difference_text(design, units)}"
    return [Table(columns, rows, caption, "table-mujoco")]


def difference_text(design: Design, units: Units) -> str:
    """How far the run on MuJoCo's plant is from ours."""
    ours, theirs = design.evaluation.step, design.mujoco
    assert theirs is not None
    if theirs.diverged_at is not None or ours.diverged_at is not None:
        return "it diverges" if theirs.diverged_at is not None else "it does not diverge"
    apart = units.scale * np.abs(theirs.positions - ours.positions).max(axis=0)
    where = f" ({ours.joints[int(np.argmax(apart))]})" if len(ours.joints) > 1 else ""
    return f"link positions differ by at most {number(float(apart.max()), 2)} {units.angle}{where}"


# The arm ---------------------------------------------------------------------------------------------
def instants(positions: np.ndarray, start: np.ndarray, goal: np.ndarray) -> list[int]:
    """Samples at which a run (N, n) first has done these `PARTS` of its way, the last one at the end of the run.

    Parameters
    ----------
    positions : (N, n)
        Link positions.
    start, goal : (n,)
    """
    way = goal - start
    length = float(way @ way)
    if not length:
        return [0]
    done = (positions - start) @ way / length
    found = [int(np.argmax(done >= part)) if np.any(done >= part) else len(done) - 1 for part in PARTS[:-1]]
    return sorted({*found, len(done) - 1})


def arm_figure(
    robot: Robot, time: np.ndarray, links: np.ndarray, motors: np.ndarray, at: Sequence[int]
) -> Figure | None:
    """Links and motors of a run at some samples; None for a robot whose links have no length.

    Parameters
    ----------
    robot : Robot
    time : (N,)
        s.
    links, motors : (N, n)
        Positions, the motors' seen from the link side.
    at : sequence of int
    """
    poses = [(skeleton(robot, links[k]), skeleton(robot, motors[k])) for k in at]
    points = np.concatenate([line for pair in poses for lines in pair for line in lines])
    size = float(np.ptp(points, axis=0).max())
    if size < 1e-9:
        return None
    right, up, names = _plane(np.asarray(robot.links.down, dtype=float), points, size)
    flat = points @ np.column_stack([right, up])
    low, high = flat.min(axis=0) - 0.08 * size, flat.max(axis=0) + 0.08 * size
    tall = float((high - low)[1] / (high - low)[0])  # of each panel, over its width
    height = AROUND + min(max(tall, 0.3), 2.0) * 7.0 / len(at)
    figure, (axes,) = panels(1, len(at), height, 8.4, sharex=True, sharey=True)
    for k, (axis, (own, held)) in enumerate(zip(axes, poses, strict=True)):
        _drawn(axis, own, held, right, up, first=k == 0)
        axis.set_title(f"{number(float(time[at[k]]), 3)} s")
        axis.set_xlabel(f"{names[0]} (m)")
    with house_style():
        for axis in axes:
            axis.set_xlim(low[0], high[0])
            axis.set_ylim(low[1], high[1])
            axis.set_aspect("equal")
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper left", ncols=3, frameon=False)
    label(axes[0], names[1], "m")
    return figure_block(
        "arm",
        figure,
        "The arm at five instants of the step. The angle between a link and its motor is the twist of the spring; "
        "motors are seen from the link side of their gears. A last link is drawn to twice the distance of its centre "
        "of mass.",
        "The arm during the step",
    )


def _drawn(
    axis: Axes,
    own: Sequence[np.ndarray],
    held: Sequence[np.ndarray],
    right: np.ndarray,
    up: np.ndarray,
    first: bool,
) -> None:
    """One pose: motors dashed behind the links, joints as dots."""
    with house_style():
        for j, line in enumerate(held):
            axis.plot(
                line @ right, line @ up, color=SERIES[1], linewidth=1.3, dashes=(4.0, 2.0),
                label="motors (springs without twist)" if first and j == 0 else None,
            )  # fmt: skip
        for j, line in enumerate(own):
            axis.plot(
                line @ right, line @ up, color=SERIES[0], linewidth=2.6, alpha=0.85,
                label="links" if first and j == 0 else None,
            )  # fmt: skip
        joints = np.array([line[0] for line in own])
        axis.plot(
            joints @ right, joints @ up, "o", color=INK, markersize=3.5, label="joints" if first else None
        )
        axis.axhline(float(own[0][0] @ up), color=MUTED, linewidth=0.6, zorder=0.5)


def _plane(
    down: np.ndarray, points: np.ndarray, size: float
) -> tuple[np.ndarray, np.ndarray, tuple[str, str]]:
    """Two directions to look along, and their names: upright where the robot leaves the horizontal, else from above."""
    up = -down / np.linalg.norm(down)
    centred = points - points.mean(axis=0)
    level = centred - np.outer(centred @ up, up)
    spread = np.linalg.svd(level, full_matrices=True)[2]
    across = [row for row in spread if abs(row @ up) < 0.5]
    right = across[0] * (1.0 if across[0].sum() >= 0.0 else -1.0)
    if np.ptp(centred @ up) > FLAT * size:
        return right, up, ("horizontal", "height")
    ahead = np.cross(up, right)
    return right, ahead, ("horizontal", "seen from above")
