"""The step from the start pose to the goal: figure and table; and on MuJoCo's plant."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from flexhinf.design.evaluation import LawEvaluation
from flexhinf.design.joint_limits import ROBOT
from flexhinf.design.responses import Response
from flexhinf.design.result import Design
from flexhinf.pages.design.arm_figure import arm_of
from flexhinf.pages.drawing import (
    ESTIMATORS,
    Units,
    figure_block,
    framed,
    joint_lines,
    joint_table,
    limit_lines,
    limit_text,
    listed,
    plan_lines,
    reference_line,
    settling_text,
    thin,
    units_of,
    widened,
)
from flexhinf.report import (
    Column,
    Figure,
    Table,
    label,
    legend,
    new_figure,
    number,
)

#: A peak input within so many samples of the start that is so much larger than all later ones is the estimator's.
STARTING, MUCH = 20, 1.5

#: What a robot may state and a true plant leaves out unless asked: how the parameter's name begins, and the extra.
STATED = {"inductance": "inductance", "damping": "joint_damping", "coulomb_friction": "coulomb_friction"}


def blocks(design: Design) -> list[Any]:
    """What the step looks like, and its figures for each joint."""
    e = design.evaluation
    units, arm = units_of(e), arm_of(e)
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
    """Torques of the nominal springs along a run (N, n), N·m or N; none of a rigid joint: zero."""
    parameters, layout = e.setup.model.parameters, e.setup.robot.layout
    stiffness = np.zeros(layout.n)
    stiffness[layout.elastic] = parameters.named(parameters.vector()).stiffness
    q, _, theta, _ = np.split(layout.whole(response.run.signals["state"].T), 4)
    return stiffness * (theta - q).T


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
