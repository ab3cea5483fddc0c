"""The law: its poles, equilibrium at the goal and linear part; and the rigid design on the same robot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from flexhinf.design.problem.modes import Mode
from flexhinf.design.responses import Response
from flexhinf.design.result import Design
from flexhinf.design.rigid import RigidLoop
from flexhinf.design.specification import RINGS
from flexhinf.loop.simulation.metrics import damping_ratio
from flexhinf.pages.design.step import spring_torques, stiffness_of
from flexhinf.pages.drawing import (
    DOTTED,
    Blocks,
    count_text,
    figure_block,
    finite,
    framed,
    frequency_axis,
    in_joint,
    joint_table,
    legend_above,
    note,
    panels,
    range_text,
    reference_line,
    rounded,
    thin,
    units_of,
    vertical_line,
)
from flexhinf.report import (
    MUTED,
    SERIES,
    Column,
    Figure,
    Listing,
    Paragraph,
    Table,
    house_style,
    label,
    legend,
    new_figure,
    number,
)

#: An estimation error at a vibration with less damping than this is hardly corrected by the sensors.
HARDLY_SEEN = 0.01

#: Damping ratios whose lines are drawn in the s-plane.
RAYS = (0.1, 0.3, 0.7)

#: The s-plane reaches so many times as far as the fastest oscillation of robot and law; faster poles are on the right.
ROOM = 1.8

#: Below this frequency, Hz, a pole is at zero and has no place on a logarithmic axis.
SLOWEST = 1e-3

#: With more joints than these a terminal lists vibrations only.
MANY = 3

#: A panel shows so many steps on either side of the goal: a loop that diverges would hide the others.
SHOWN_STEPS = 2.5

#: A gain below this fraction of the largest is rounding, and shown as 0.
ROUNDING = 1e-13


# Poles --------------------------------------------------------------------------------------------------
#: Poles (1/s) of a loop: its name, and how Matplotlib draws them.
PoleGroup = tuple[str, np.ndarray, dict[str, Any]]


@house_style()
def poles_figure(groups: Sequence[PoleGroup]) -> Figure:
    """The s-plane near the imaginary axis, and damping over frequency for all poles."""
    figure, ((plane, damping),) = panels(1, 2, 3.6)
    groups = [group for group in groups if len(group[1])]
    poles = np.concatenate([each for _, each, _ in groups[:2]])  # without control, and with the law
    oscillating = np.abs(poles[np.abs(np.imag(poles)) > 0.0])
    size = ROOM * float(oscillating.max() if len(oscillating) else np.abs(poles).max(initial=1.0))
    dotted = {"color": MUTED, "linewidth": 0.8, "linestyle": DOTTED, "zorder": 0.5}
    for ray in RAYS:
        plane.plot([0.0, -ray * 2.0 * size], [0.0, np.sqrt(1.0 - ray**2) * 2.0 * size], **dotted)
    low = -0.05
    for name, each, marks in groups:
        style: dict[str, Any] = {"markersize": 6.0, "linestyle": "none", **marks}
        upper = each[np.imag(each) >= 0.0]
        plane.plot(np.real(upper), np.imag(upper), **style)
        hertz = np.abs(upper) / (2.0 * np.pi)
        ratio = damping_ratio(upper[hertz > SLOWEST])
        low = min([low, *(value - 0.05 for value in ratio.tolist() if value > -1.0 + 1e-9)])
        damping.plot(hertz[hertz > SLOWEST], ratio, label=name, **style)
    right = min(size, float(np.real(poles).max(initial=0.0)))
    plane.set(xlim=(-size, max(0.12 * size, 1.15 * right)), ylim=(-0.03 * size, size))
    plane.set(xlabel="Re λ (1/s)", ylabel="Im λ (rad/s)")
    vertical_line(plane, 0.0)
    frequency_axis(damping)
    damping.margins(x=0.06)
    damping.axhspan(-2.0, 0.0, color=SERIES[1], alpha=0.08, linewidth=0)
    damping.set(ylim=(max(low, -1.05), 1.08), xlabel="frequency |λ|/2π (Hz)", ylabel="damping ratio")
    reference_line(damping)
    legend_above(figure, damping, 2)
    return figure_block(
        "poles", figure,
        "Left: poles λ in the s-plane, upper half, near the imaginary axis; dotted rays have damping ratio "
        f"{', '.join(f'{ray:g}' for ray in RAYS)}. Right: damping ratio −Re λ/|λ| over frequency of all poles but "
        "those at zero; 1 decays without oscillating, below zero (shaded) grows.",
        "Poles",
    )  # fmt: skip


def poles(design: Design) -> Blocks:
    """Figure, a table of what oscillates or does not decay, and what decays without oscillating."""
    yield from _pole_notes(design)

    def figure() -> Figure:
        looks = (
            {"marker": "o", "color": MUTED, "markerfacecolor": "none"}, {"marker": "o", "color": SERIES[0]},
            {"marker": "^", "color": SERIES[2]},
        )  # fmt: skip
        groups = [
            (name, _eigenvalues(modes), look) for (name, modes), look in zip(_modes(design).items(), looks)
        ]
        if design.specification.estimator != "none":
            running, look = design.evaluation.frequency_response.poles, {"marker": "x", "color": SERIES[1]}
            groups.append(("running loop (sampled, estimator, delay)", running, look))
        for loop, marker in zip(design.rigid.loops if design.rigid else (), ("1", "2")):
            look = {"marker": marker, "color": SERIES[3]}
            groups.append((f"rigid law, {loop.side} side", _eigenvalues(loop.modes), look))
        return poles_figure(groups)

    yield figure
    yield mode_table(design)
    sentences = []
    for name, modes in list(_modes(design).items())[:2]:
        times = [1.0 / -mode.eigenvalue.real for mode in modes if not _listed(mode)]
        constants = f", time constant{'s' if len(times) > 1 else ''} {range_text(times)} s" if times else ""
        many = f"{len(times)} modes decay" if len(times) != 1 else "1 mode decays"
        sentences.append(f"{name.capitalize()}: {many} without oscillating{constants}.")
    yield Paragraph(f"{' '.join(sentences)} The law adds one mode for the integral of each joint's error.")


def _eigenvalues(modes: Sequence[Mode]) -> np.ndarray:
    return np.array([mode.eigenvalue for mode in modes], dtype=complex)


def _modes(design: Design) -> Mapping[str, Sequence[Mode]]:
    error = design.evaluation.estimator_modes
    found = {"without control": design.evaluation.open_modes, "law on the true state": design.law_modes}
    return {**found, "estimation error": error} if error else found


def _listed(mode: Mode) -> bool:
    """Whether a mode has a row of its own; those that decay without oscillating are summed up in a sentence."""
    return bool(mode.eigenvalue.imag) or not mode.stable


def mode_table(design: Design, brief: bool = False) -> Table:
    """Modes that oscillate or do not decay; `brief`: that oscillate, of many joints the vibrations alone."""
    joints = len(design.robot.joint_names)
    rows = [
        {
            "loop": name, "mode": mode.name, "joint": mode.joint, "frequency": mode.frequency, "damping": mode.damping,
            "time": mode.time_constant,
        }
        for name, modes in _modes(design).items()
        for mode in modes
        if _listed(mode)
        and not (brief and (not mode.eigenvalue.imag or (joints > MANY and not mode.vibration)))
    ]  # fmt: skip
    columns = (
        Column("loop", key="loop"),
        Column("mode", key="mode"),
        *([Column("mainly", key="joint")] if joints > 1 else []),
        Column("frequency", "Hz", digits=4, key="frequency", brief="Hz"),
        Column("damping ratio", digits=4, key="damping", brief="damping"),
        Column("time constant", "s", digits=4, key="time", brief=None),
    )
    caption = "Modes that oscillate or do not decay, linearised at the goal, continuous time"
    title = f"γ* of the problem = {design.gamma_star:.5g}, γ = {design.gamma:.5g}\nOscillations at the goal"
    return Table.of(columns, rows, caption, "table-modes", title=title)


def _pole_notes(design: Design) -> Blocks:
    """A vibration that rings, in the loop or in the estimation error."""
    after = vibration_damping(design.law_modes)
    if after and min(after) < RINGS:
        yield note(
            f"A vibration has a damping ratio of {min(after):.2g} with this law: its weights hardly act on it. "
            "`--damping 0.3` searches for weights that do."
        )
    error = [mode for mode in design.evaluation.estimator_modes if mode.vibration]
    if not error:
        return
    worst, target = min(error, key=lambda mode: mode.damping), design.design_problem.target
    where = in_joint(worst.joint, design.robot.joint_names)
    what = f"The estimator's error at {worst.frequency:.3g} Hz{where} has a damping ratio"
    if worst.damping < HARDLY_SEEN:
        yield note(
            f"{what} of {worst.damping:.1g} only, and noise keeps it ringing, in the robot too. Measure link positions "
            "or joint torques, or raise --process-noise."
        )
    elif target is not None and worst.damping < target.damping:
        yield note(
            f"{what} of {worst.damping:.2g}, less than required of the law: after unknown disturbances the loop rings "
            "with it. Try a larger --torque-noise, or another sensor (--measured)."
        )


def vibration_damping(modes: Sequence[Mode]) -> list[float]:
    """Damping ratios of the vibrations among some modes."""
    return [mode.damping for mode in modes if mode.vibration]


# The law and its equilibrium ----------------------------------------------------------------------------
def law(design: Design) -> Blocks:
    """The law in words, with its linear gain and the equilibrium about which it acts."""
    solution, problem, via = design.solution, design.problem, design.specification.via
    if design.specification.compare_rigid and design.rigid is None:
        why = "a penalty that is code cannot be applied to a rigid robot"
        if design.robot.rigid:
            why = "of a robot with rigid joints of its own it says nothing new"
        yield note(f"No rigid design was made: {why}.")
    text = (
        f"V of degree {solution.degree} solves the Hamilton–Jacobi–Isaacs equation at γ = {number(solution.gamma, 5)} "
        f"about the goal, as a power series. The law has degree {solution.degree - 1} in {len(solution.P)} states, "
        f"{count_text(len(solution.input_names), 'input')} and {np.size(solution.law_data)} coefficients."
    )
    if via:
        text += f" The same was done at {count_text(len(via), 'pose')} on the way."
    if design.design_problem.robustness is not None:
        text += (
            " The channels of the tolerances enter in proportion to γ; the listing below keeps them as they are at "
            f"this γ, so its gamma* is not the γ* = {number(design.gamma_star)} of the whole problem."
        )
    yield Paragraph(text)
    n, units, x = len(design.goal), units_of(design.evaluation), problem.operating_point
    motors = design.robot.layout.whole(x)[2 * n : 3 * n]
    torques = finite(stiffness_of(problem.plant, design.robot, np.nan) * (motors - x[:n]))
    inputs = problem.operating_input.tolist()
    rows = [
        {"joint": joint, "link": link, "motor": motor, "torque": torque, "input": effort}
        for joint, link, motor, torque, effort in zip(
            design.robot.joint_names, x[:n].tolist(), motors.tolist(), torques, inputs
        )
    ]
    columns = (
        Column("link position", units.angle, 4, key="link", scale=units.scale),
        Column("motor position, seen from the link", units.angle, 4, key="motor", scale=units.scale),
        Column("spring torque", units.spring, 3, key="torque"),
        Column("input", units.effort, 3, key="input"),
    )
    yield joint_table(columns, rows, "Equilibrium at the goal", "table-rest")
    gains = np.where(np.abs(solution.gain) < ROUNDING * np.abs(solution.gain).max(), 0.0, solution.gain)
    cells = [
        (name.replace("_", " "), *(number(float(value)) for value in gains[:, i]))
        for i, name in enumerate(problem.state_names)
    ]
    heads = ("state", *(name.replace("_", " ") for name in problem.input_names))
    yield Table(heads, cells, "Linear part K of u − u* = K (x − x*)", "table-gain")
    yield Listing(solution.report())


# The rigid design: what neglecting the springs would have done ------------------------------------------
def rigid(design: Design) -> Blocks:
    """Text, table and figure; none if no rigid design was made."""
    if design.rigid is None:
        return
    loops = design.rigid.loops
    yield Paragraph(
        "The same weights, γ/γ* and degree on a model with infinitely stiff springs, and that law on the elastic "
        "robot, where it gets the true position and velocity of one side of the springs without noise, more than it "
        f"would have. Its γ is {number(design.rigid.gamma)}, of the rigid problem."
    )
    fed = "estimator" if design.specification.estimator != "none" else "true state"
    ours = "stable" if all(mode.stable for mode in design.law_modes) else "unstable"
    laws: list[tuple[str, str, str, Sequence[Mode], Response]] = [
        ("this law", fed, ours, design.law_modes, design.evaluation.step)
    ]
    laws += [
        ("rigid", f"{loop.side} side, true values", loop_text(loop), loop.modes, loop.response)
        for loop in loops
    ]
    rows = []
    for name, fed, text, modes, response in laws:
        stable, end = all(mode.stable for mode in modes), response.diverged_at
        metrics = (
            rounded(one.value, 6) if stable else None for one in (response.overshoot, response.settling)
        )
        run = "to its end" if end is None else f"diverges at {number(end, 3)} s"
        rows.append((name, fed, text, min(vibration_damping(modes), default=None), *metrics, run))
    columns = (
        "law", "fed from", "linearised, true state", Column("smallest damping ratio of a vibration"),
        Column("largest overshoot", "%", 1), Column("settling time", "s", 3), "run",
    )  # fmt: skip
    yield Table(columns, rows, "", "table-rigid", stacks=True)
    yield lambda: _rigid_figure(design, loops)


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


def _rigid_figure(design: Design, loops: Sequence[RigidLoop]) -> Figure:
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
        few, line = (
            thin(response.run.time),
            {"color": SERIES[order], "linewidth": 1.4, "zorder": 3.0 - 0.1 * order},
        )
        signals = (
            units.scale * (response.positions[few, joint] - goal[joint]),
            spring_torques(e, response)[few, joint],
            response.inputs[few, joint],
        )
        for k, (axis, signal) in enumerate(zip(axes, signals)):
            axis.plot(response.run.time[few], signal, label=text, **line)
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
        f"The same step with the rigid design{where}. Lines that leave the panels go on.",
        "Rigid design",
    )  # fmt: skip
