"""The law: equilibrium at the goal and linear part; and the rigid design on the same robot."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from flexhinf.design.problem.modes import Mode
from flexhinf.design.responses import Response
from flexhinf.design.result import Design
from flexhinf.design.rigid import RigidLoop
from flexhinf.design.specification import RINGS
from flexhinf.pages.design.frequency import vibration_damping
from flexhinf.pages.design.step import spring_torques, stiffness_of
from flexhinf.pages.drawing import (
    count_text,
    figure_block,
    finite,
    framed,
    joint_table,
    range_text,
    reference_line,
    rounded,
    thin,
    units_of,
)
from flexhinf.report import (
    SERIES,
    Column,
    Figure,
    Listing,
    Paragraph,
    Table,
    label,
    legend,
    new_figure,
    number,
)

#: A panel shows so many steps on either side of the goal: a loop that diverges would hide the others.
SHOWN_STEPS = 2.5

#: A gain below this fraction of the largest is rounding, and shown as 0.
ROUNDING = 1e-13


def law_blocks(design: Design) -> list[Any]:
    """In words, with its linear gain and the equilibrium about which it acts."""
    solution, via = design.solution, design.specification.via
    n, m, terms = len(solution.P), len(solution.input_names), np.size(solution.law_data)
    at = f" The same was done at {count_text(len(via), 'pose')} on the way." if via else ""
    rescaled = ""
    if design.design_problem.robustness is not None:
        rescaled = (
            " The channels of the tolerances enter in proportion to γ; the listing below keeps them as they are at "
            f"this γ, so its gamma* is not the γ* = {number(design.gamma_star)} of the whole problem."
        )
    text = (
        f"V of degree {solution.degree} solves the Hamilton–Jacobi–Isaacs equation at γ = {number(solution.gamma, 5)} "
        f"about the goal, as a power series. The law has degree {solution.degree - 1} in {n} states, "
        f"{count_text(m, 'input')} and {terms} coefficients.{at}{rescaled}"
    )
    gains = np.where(np.abs(solution.gain) < ROUNDING * np.abs(solution.gain).max(), 0.0, solution.gain)
    rows = [
        (name.replace("_", " "), *(number(float(value)) for value in gains[:, i]))
        for i, name in enumerate(design.problem.state_names)
    ]
    inputs = (name.replace("_", " ") for name in design.problem.input_names)
    gain = Table(("state", *inputs), rows, "Linear part K of u − u* = K (x − x*)", "table-gain")
    return [Paragraph(text), _equilibrium(design), gain, Listing(solution.report())]


def law_remarks(design: Design) -> Iterator[str]:
    """A rigid design that was required and could not be made."""
    if design.specification.compare_rigid and design.rigid is None:
        yield (
            "No rigid design was made: of a robot with rigid joints of its own it says nothing new."
            if design.robot.rigid
            else "No rigid design was made: a penalty that is code cannot be applied to a rigid robot."
        )


def _equilibrium(design: Design) -> Table:
    """State and input with which the robot is held at the goal."""
    n, plant, units = len(design.goal), design.problem.plant, units_of(design.evaluation)
    x, u = design.problem.operating_point, design.problem.operating_input
    motors = design.robot.layout.whole(x)[2 * n : 3 * n]
    torques = finite(stiffness_of(plant, design.robot, np.nan) * (motors - x[:n]))
    rows = list(zip(design.robot.joint_names, units.scale * x[:n], units.scale * motors, torques, u.tolist()))
    columns = (
        Column("joint"),
        Column("link position", units.angle, 4),
        Column("motor position, seen from the link", units.angle, 4),
        Column("spring torque", units.spring, 3),
        Column("input", units.effort, 3),
    )
    return joint_table(Table(columns, rows, "Equilibrium at the goal", "table-rest"))


# The rigid design: what neglecting the springs would have done ------------------------------------------
def rigid_blocks(design: Design) -> list[Any]:
    """Text, table and figure; none if no rigid design was made."""
    rigid = design.rigid
    if rigid is None:
        return []
    text = (
        "The same weights, γ/γ* and degree on a model with infinitely stiff springs, link and reflected rotor "
        "inertia as one, and that law on the elastic robot. On a rigid robot position and velocity are the same on "
        "both sides of the springs; here they are not. The rigid law gets the true values without noise, more than "
        f"it would have. Its γ is {number(rigid.gamma)}, of the rigid problem."
    )
    return [Paragraph(text), _table(design, rigid.loops), _figure(design, rigid.loops)]


def loop_text(loop: RigidLoop) -> str:
    """What the rigid law does when it is fed from one side."""
    damping = vibration_damping(loop.modes)
    if not loop.stable:
        worst = max(loop.modes, key=lambda mode: mode.eigenvalue.real)
        time = worst.time_constant
        grows = "does not decay" if time is None else f"grows with a time constant of {time:.2g} s"
        return f"unstable (a mode at {worst.frequency:.3g} Hz {grows})"
    if damping and min(damping) < RINGS:
        return f"stable, but rings (damping ratio {min(damping):.2g})"
    return "stable" + (f", damping ratio of vibrations {range_text(damping, 2)}" if damping else "")


def _table(design: Design, loops: Sequence[RigidLoop]) -> Table:
    fed = "estimator" if design.specification.estimator != "none" else "true state"
    ours = "stable" if all(mode.stable for mode in design.law_modes) else "unstable"

    def row(law: str, fed: str, modes: Sequence[Mode], response: Response, text: str) -> tuple[Any, ...]:
        stable, end = all(mode.stable for mode in modes), response.diverged_at
        overshoot, settling = rounded(response.overshoot.value, 6), rounded(response.settling.value, 6)
        return (
            law, fed, text, min(vibration_damping(modes), default=None),
            overshoot if stable else None, settling if stable else None,
            "to its end" if end is None else f"diverges at {number(end, 3)} s",
        )  # fmt: skip

    rows = [row("this law", fed, design.law_modes, design.evaluation.step, ours)]
    for loop in loops:
        rows.append(
            row("rigid", f"{loop.side} side, true values", loop.modes, loop.response, loop_text(loop))
        )
    columns = (
        "law", "fed from", "linearised, true state", Column("smallest damping ratio of a vibration"),
        Column("largest overshoot", "%", 1), Column("settling time", "s", 3), "run",
    )  # fmt: skip
    return Table(columns, rows, "", "table-rigid", stacks=True)


def _figure(design: Design, loops: Sequence[RigidLoop]) -> Figure:
    e, goal, late = design.evaluation, design.goal, np.zeros(len(design.goal))
    units = units_of(e)
    for loop in loops:
        positions = loop.response.positions
        error = np.abs(positions[len(positions) // 2 :] - goal)
        late += np.nan_to_num(error, nan=1e9, posinf=1e9).max(axis=0)
    joint = int(np.argmax(late))
    fed = "" if design.specification.estimator == "none" else ", with its estimator"
    runs = [(f"this law{fed}", e.step)]
    runs += [(f"rigid law, fed from the {loop.side} side", loop.response) for loop in loops]
    figure, axes = new_figure(3, height=6.6)
    for order, (text, response) in enumerate(runs):
        few = thin(response.run.time)
        signals = (
            units.scale * (response.positions[few, joint] - goal[joint]),
            spring_torques(e, response)[few, joint],
            response.inputs[few, joint],
        )
        for k, (axis, signal) in enumerate(zip(axes, signals)):
            axis.plot(
                response.run.time[few], signal, label=text, color=SERIES[order], linewidth=1.4, zorder=3.0 - 0.1 * order
            )  # fmt: skip
            if k and not order:  # where our law stays: a rigid law that diverges would hide it
                axis.set_ylim(*framed(signal, 0.75))
    axes[0].set_xlim(0.0, float(e.step.run.time[-1]))
    reference_line(axes[0])
    step = units.scale * abs(design.start[joint] - goal[joint]) or 1.0
    axes[0].set_ylim(-SHOWN_STEPS * step, SHOWN_STEPS * step)
    names = (("link position − goal", units.angle), ("spring torque", units.spring), ("input", units.effort))
    for axis, name in zip(axes, names):
        label(axis, *name)
    legend(axes[0])
    where = f", joint {e.setup.joints[joint]}, where it does worst" if len(goal) > 1 else ""
    return figure_block(
        "rigid", figure,
        f"The same step with the rigid design{where}, fed the true position and velocity of one side without noise. "
        "Lines that leave the panels go on.",
        "Rigid design",
    )  # fmt: skip
