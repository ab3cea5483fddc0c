"""The long run at rest with dry friction: which joints hunt, how far, how often, and what helps."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from flexhinf.design.limit_cycle import WIDEST, LimitCycleCheck
from flexhinf.design.problem.presets import preset_of
from flexhinf.design.result import Design
from flexhinf.loop.simulation.metrics import REST_TAIL, tail_of
from flexhinf.pages.drawing import (
    figure_block,
    joint_lines,
    joint_table,
    limit_lines,
    listed,
    reference_line,
    units_of,
)
from flexhinf.report import Column, Figure, label, legend, new_figure, number
from flexhinf.robot.elastic import DRY

#: Pieces of the run in the figure: of each the extremes are drawn, so that no vibration is lost.
PIECES = 400

#: An oscillation of at least this fraction of the limit has its frequency in the table.
SEEN = 0.5


def blocks(design: Design) -> list[Any]:
    """Figure and table; nothing for a robot without dry friction, or a run that diverged."""
    run = design.rest
    if run is None or not run.cycles:
        return []
    return [_figure(design, run), _table(design, run)]


def remarks(design: Design) -> Iterator[str]:
    """Who hunts, and what may be tried."""
    run, s = design.rest, design.specification
    if run is not None and run.without is not None:
        before, worst = run.without, run.without.worst
        yield (
            f"Dry friction and integral action would keep the robot moving: {_motion(design, before, worst)}. "
            f"So errors up to {_zone(design, run)} are not integrated; they may remain. "
            "`--integral-dead-zone` states another zone, 0 none."
        )
    if run is None or not run.oscillates:
        return
    if not run.cycles:
        yield "The long run at rest with the robot's dry friction diverges."
        return
    joints = [_motion(design, run, k) for k in run.oscillating]
    dry = [name for name in run.extras if name in DRY]
    extras = ",".join(dict.fromkeys((*s.extras, *dry)))
    both = all(
        any(name.startswith(side) for name in s.measured) for side in ("link_position", "motor_position")
    )
    own = preset_of(design.evaluation.setup.robot, s) == "paper"
    advice = [
        *([] if s.friction_model else [f"`--extras {extras} --friction-model`"]),
        "another `--integral-dead-zone`",
        *([] if both else ["sensors on both sides of the springs"]),
        *(["weights that damp the vibration (`--preset damped`)"] if own else []),
    ]
    narrow = ""
    if run.tried is not None and run.tried.cycles:
        left, most = run.tried, f"{100.0 * WIDEST:g} % of the joint's step"
        narrow = (
            f" Errors up to {_zone(design, left)} left unintegrated do not end it: "
            f"{_motion(design, left, left.worst)}. The design sets no dead zone above {most} by itself; a wider one "
            "may leave an error as large as itself."
        )
    yield (
        f"With dry friction the robot does not come to rest: {listed(joints)}.{narrow} Try {' or '.join(advice)}."
    )


def _motion(design: Design, run: LimitCycleCheck, joint: int) -> str:
    """How far and how often a joint moves."""
    cycle = run.cycles[joint]
    return f"{run.response.joints[joint]} by ±{_length(design, cycle.amplitude, 3)} ({frequency_text(cycle.frequency)})"


def _zone(design: Design, run: LimitCycleCheck) -> str:
    """The dead zone of the integrals of a run, of the joints that have one."""
    joints = run.response.joints
    sizes = [] if run.dead_zone is None else run.dead_zone.tolist()
    each = [
        f"{_length(design, size, 2)}{f' in {joint}' if len(joints) > 1 else ''}"
        for joint, size in zip(joints, sizes)
        if size > 0.0
    ]
    return listed(each)


def _length(design: Design, value: float, digits: int) -> str:
    unit, scale = units_of(design.evaluation).small
    return f"{number(scale * value, digits)}{'' if unit == '°' else ' '}{unit}"


def frequency_text(frequency: float | None) -> str:
    """Of an oscillation, with its period where it is slow."""
    if frequency is None:
        return "less than one period in the last half"
    slow = f", every {number(1.0 / frequency, 3)} s" if frequency < 1.0 else ""
    return f"{number(frequency, 3)} Hz{slow}"


def _figure(design: Design, run: LimitCycleCheck) -> Figure:
    response, units = run.response, units_of(design.evaluation)
    unit, scale = units.small
    time, positions, inputs = (
        tail_of(each, REST_TAIL) for each in (response.run.time, response.positions, response.inputs)
    )
    deviation = scale * (positions - response.goal)
    figure, axes = new_figure(2)
    for axis, values in zip(axes, (deviation, inputs)):
        joint_lines(axis, *_extremes(time, values), response.joints)
    reference_line(axes[0])
    limit_lines(axes[0], np.full(len(response.joints), scale * run.limit), deviation, "limit")
    label(axes[0], "link position − goal", unit)
    label(axes[1], "input", units.effort)
    if len(response.joints) > 1:
        legend(axes[0])
    return figure_block(
        "rest", figure,
        f"The last half of {response.run.time[-1]:.3g} s at the goal, without measurement noise. Dry friction is "
        f"{'sharp: it holds a motor until the torque exceeds it' if run.sharp else 'smoothed'}. An amplitude beyond "
        f"{_length(design, run.limit, 3)} is hunting.",
        "At rest with dry friction",
    )  # fmt: skip


def _extremes(time: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Times and rows (N, n) of the extremes in `PIECES` pieces, the smallest first where a signal rises."""
    pieces = np.array_split(np.arange(len(time)), min(PIECES, len(time)))
    times, rows = [], []
    for piece in pieces:
        part = values[piece]
        low, high, rises = part.min(axis=0), part.max(axis=0), part[-1] >= part[0]
        times += [time[piece[0]], time[piece[-1]]]
        rows += [np.where(rises, low, high), np.where(rises, high, low)]
    return np.array(times), np.array(rows)


def _table(design: Design, run: LimitCycleCheck) -> Any:
    unit, scale = units_of(design.evaluation).small
    rows = [
        (joint, scale * cycle.amplitude, frequency_text(cycle.frequency) if cycle.amplitude > SEEN * run.limit else "–",
         scale * error, "hunts" if cycle.amplitude > run.limit else "below the limit")
        for joint, cycle, error in zip(run.response.joints, run.cycles, run.errors.tolist())
    ]  # fmt: skip
    zone = "" if run.dead_zone is None else ", and a dead zone of the integrals"
    columns = ("joint", Column("amplitude", unit), "frequency", Column("remaining error", unit), "result")
    friction = [name.replace("_", " ") for name in run.extras if name in DRY]
    caption = (
        f"With {listed(friction)}{zone}. Amplitude: half of the distance between the extremes in the last half. "
        "Remaining error: largest in the last tenth"
    )
    return joint_table(columns, rows, caption, "table-hunting")
