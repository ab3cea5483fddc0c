"""The first screen of a design's page: the step with the band of sampled robots, and the arm while it moves; and the
result of each section in a few words."""

# Not checked strictly: parts of Matplotlib have no types.
# pyright: reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from flexhinf.designs.evaluation import LawEvaluation
from flexhinf.designs.pose_evidence import PoseEvidence
from flexhinf.designs.responses import Move, Response
from flexhinf.numerals import count_text, number
from flexhinf.pages.arm_film import film_of
from flexhinf.pages.design.step import arm_plane, input_panels, instants
from flexhinf.pages.drawing import (
    DOTTED,
    Units,
    figure_block,
    in_joint,
    joint_panels,
    line_style,
    thin,
    units_of,
)
from flexhinf.report import (
    INK,
    MUTED,
    SERIES,
    Figure,
    LineStyle,
    house_style,
    label,
    legend,
    new_figure,
    panels,
    settling_band,
)
from flexhinf.robot import Robot
from flexhinf.robot.kinematics import skeleton

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Height of the figures, inches: two of them side by side leave room for verdict and numbers on a screen.
HEIGHT = 4.3

#: Of what each panel takes of that height, where there are more than two.
SHARE = 0.35

#: Width and height of the panel in the picture of the arm, inches, beside names and numbers.
PANEL = (5.0, 3.1)

#: Length of the axis of time beside that of the worst move, where other moves take longer.
SEEN_MOVES = 3.0

#: Joints whose sampled robots are drawn, those that move most; lines of more hide each other.
BANDS = 3


def lead(design: PoseEvidence) -> list[Figure]:
    """The step and the arm; the step alone for links without a length, nothing for a robot that does not move."""
    e = design.evaluation
    if not len(e.step.run.time) or not np.any(e.setup.goal - e.setup.start):
        return []
    return [figure for figure in (_step(e), arm_picture(e.setup.robot, e.step)) if figure is not None]


@house_style()
def _step(e: LawEvaluation) -> Figure:
    """Link positions and inputs; several joints as a share of their own way, so that they fit one panel."""
    response, samples, units, joints = e.step, e.step_samples, units_of(e), e.setup.joints
    time, start, way = response.run.time, e.setup.start, e.setup.goal - e.setup.start
    several, moving = len(joints) > 1, np.flatnonzero(way)
    scale = 100.0 / np.where(way == 0.0, 1.0, way) if several else np.full(1, units.scale)
    origin = start if several else np.zeros(1)
    inputs, _ = input_panels(e, response)
    figure, (upper, *lower) = new_figure(1 + len(inputs), height=lead_height(1 + len(inputs)))
    ended = None if samples is None or not len(samples) else np.isfinite(samples.positions).all(axis=(1, 2))
    few = thin(time)
    for j in moving.tolist():
        style, name = line_style(j), joints[j] if several else "nominal robot"
        if samples is not None and ended is not None and ended.any() and j in moving[:BANDS]:
            runs = (samples.positions[ended, :, j] - origin[j]) * scale[j]
            low, high = runs.min(axis=0), runs.max(axis=0)
            band = None if several else f"{count_text(int(ended.sum()), 'sampled robot')}"
            upper.fill_between(
                samples.time, low, high, color=style["color"], alpha=0.25, linewidth=0, label=band
            )
        upper.plot(time[few], (response.positions[few, j] - origin[j]) * scale[j], **style, label=name)
    goal, size = (100.0, 100.0) if several else (float(units.scale * e.setup.goal[0]), units.scale * way[0])
    settling_band(upper, goal, float(size))
    label(upper, "share of the way" if several else "link position", "%" if several else units.angle)
    legend(upper)
    _end_after_settling(upper, e)
    for axes, panel in zip(lower, inputs):
        plain = [(value, color, None) for value, color, _ in panel.dashed]
        lines = [line._replace(name=None) for line in panel.lines]
        replace(panel, lines=lines, dotted=(0.0,), dashed=plain).draw(axes)
    robots = "" if ended is None else f" Band: all {int(ended.sum())} sampled robots that end the step."
    dashed = " Dashed: limit." * any(panel.dashed for panel in inputs)
    return figure_block(
        "result",
        figure,
        f"Link positions of the nominal robot (lines) and its inputs.{robots}{dashed}",
        "The step",
    )


def _end_after_settling(axes: Axes, e: LawEvaluation) -> None:
    """End the time axis some time after the last robot has settled, where all of them do."""
    times: list[float] = [
        e.step.settling.value,
        *([] if e.step_samples is None else e.step_samples.settling.tolist()),
    ]
    end = float(e.step.run.time[-1])
    if np.isfinite(times).all() and max(times) > 0.0:
        axes.set_xlim(0.0, min(1.5 * max(times), end))


@house_style()
def arm_picture(robot: Robot, response: Response, what: str = "") -> Figure | None:
    """The arm of a run at a few instants, in one picture; None for a run that diverges or links without a length."""
    if response.diverged_at is not None:
        return None
    time = response.run.time
    at = instants(response.positions, response.start, response.goal)
    motors = robot.layout.relaxed(response.run.signals["state"].T).T
    seen = arm_plane(robot, [skeleton(robot, each[k]) for k in at for each in (response.positions, motors)])
    if seen is None:
        return None
    view, names, (low, high) = seen
    figure, ((axes,),) = panels(1, 1, HEIGHT)
    count = 0
    for k, place in enumerate(at):
        opacity = (k + 1) / len(at)
        looks: tuple[tuple[np.ndarray, LineStyle], ...] = (
            (
                motors[place],
                {"color": SERIES[1], "linewidth": 1.3, "dashes": (4.0, 2.0), "alpha": 0.75 * opacity},
            ),
            (response.positions[place], {"color": SERIES[0], "linewidth": 3.2, "alpha": opacity}),
        )
        for pose, style in looks:
            for line in skeleton(robot, pose):
                axes.plot(*(line @ view).T, **style, gid=f"pose-{count}")  # fades where the film is played
                count += 1
    joints = np.array([line[0] for line in skeleton(robot, response.positions[at[-1]])]) @ view
    axes.plot(*joints.T, "o", color=INK, markersize=4.0, gid="pose-joints")
    axes.axhline(float(joints[0, 1]), color=MUTED, linewidth=0.8, linestyle=DOTTED, zorder=0)
    axes.plot([], [], label="links", color=SERIES[0], linewidth=3.2)
    axes.plot([], [], label="motors", color=SERIES[1], linewidth=1.3, dashes=(4.0, 2.0))
    # As much to the inch in both directions, and the whole panel used.
    half = 0.5 * max((high - low) / PANEL) * np.array(PANEL)
    (left, bottom), (right, top) = 0.5 * (low + high) - half, 0.5 * (low + high) + half
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
    axes.set_xlabel(f"{names[0]} (m)")
    label(axes, names[1], "m")
    legend(axes)
    times = ", ".join(number(float(time[place]), 3) for place in at)
    block = figure_block(
        "result-arm",
        figure,
        f"{what}Drawn at {times} s, later ones stronger. The angle between a link and its motor is the twist of the "
        "spring.",
        "The arm",
    )
    return replace(block, film=film_of(axes, robot, time, ((1, response.positions), (2, motors)), view))


# A controller for a workspace ---------------------------------------------------------------------------
@house_style()
def moves_lead(robot: Robot, moves: Sequence[Move], worst: int, units: Units) -> list[Figure]:
    """The move with the largest remaining error beside the errors of all moves; and the arm during that move."""
    response, time, small = moves[worst].response, moves[worst].response.run.time, units.small[0]
    plan, kinds = np.reshape(moves[worst].plan(time), (len(time), -1)), units.kinds(small)
    parts = joint_panels(
        units, "link position", units.angle, time, units.scale * response.positions, plan=units.scale * plan
    )
    figure, axes = new_figure(len(parts) + len(kinds), height=lead_height(len(parts) + len(kinds)))
    for axis, part in zip(axes, parts):
        part.draw(axis)
    errors = axes[len(parts) :]
    for k, move in enumerate((*moves, moves[worst])):
        few, error = _errors(move, units)
        last = k == len(moves)
        style: LineStyle = {
            "color": SERIES[0] if last else MUTED,
            "linewidth": 1.6 if last else 0.7,
            "alpha": 1.0 if last else 0.4,
        }
        for j, (axis, places) in enumerate(zip(errors, kinds.values())):
            name = "the worst move" if last else None if k else f"all {count_text(len(moves), 'move')}"
            axis.plot(few, error[:, places].max(axis=1), label=None if j else name, **style)
    for axis, unit in zip(errors, kinds):
        label(axis, "largest error", unit)
        axis.set_ylim(bottom=0.0)
    ends = [float(move.response.run.time[-1]) for move in moves]
    length = SEEN_MOVES * ends[worst]  # a longer move would leave the worst one a sliver of the picture
    axes[0].set_xlim(0.0, min(length, max(ends)))
    longer = sum(end > length for end in ends)
    for axis in (axes[0], errors[0]):
        legend(axis)
    block = figure_block(
        "result",
        figure,
        "Above: links in the move with the largest remaining error; dotted: its plan. Below: the largest error of any "
        f"link in that move and in all others{f', of which {longer} take longer than is drawn' * (longer > 0)}.",
        "The worst move",
    )
    arm = arm_picture(robot, moves[worst].response, "The arm in that move. ")
    return [block] if arm is None else [block, arm]


def lead_height(rows: int) -> float:
    """Height of a figure of so many panels on the first screen, inches."""
    return HEIGHT * max(1.0, SHARE * rows)


def _errors(move: Move, units: Units) -> tuple[np.ndarray, np.ndarray]:
    """Some times (N,) of a move, and the distances (N, n) of the links from its plan there, small deviations."""
    time = move.response.run.time
    few = thin(time)
    plan = np.reshape(move.plan(time[few]), (len(time[few]), -1))
    return time[few], units.small[1] * np.abs(move.response.positions[few] - plan)


# Results in a few words ---------------------------------------------------------------------------------
def briefs(design: PoseEvidence) -> dict[str, str]:
    """The result of some sections, by their anchors."""
    e, joints = design.evaluation, design.evaluation.setup.joints
    m, units = e.margins, units_of(design.evaluation)
    texts = {
        "specification": f"{sum(line.met for line in design.requirements)} of {len(design.requirements)} met",
        "weights": f"preset {design.design_problem.preset}",
        "law": f"degree {design.chosen.degree} of V, γ = {number(design.gamma, 3)}",
    }
    if m.stable:
        texts["margins"] = (
            f"gain × {number(m.gain_margin, 3)}, delay {number(1e3 * m.delay_margin_s, 3)} ms, "
            f"sensitivity {number(m.peak_sensitivity, 3)}"
        )
        texts["modes"] = (
            f"smallest damping ratio {number(m.damping, 2)}{in_joint(e.least_damped_joint, joints)}"
        )
    if e.corners is not None:
        texts["corners"] = f"{e.corners.unstable} of {e.corners.count} unstable"
    samples = e.step_samples
    if samples is not None and len(samples):
        texts["draws"] = f"{len(samples) - samples.unsettled} of {len(samples)} settle"
    if e.step.diverged_at is None:
        texts["step"] = f"peak input {units.text(e.step.peak_input, units.effort, e.step.peak.joint)}"
    return texts | {
        anchor: "diverges"
        for anchor, run in (("load", e.load_response.response), ("move", e.move.response), ("step", e.step))
        if run.diverged_at is not None
    }
