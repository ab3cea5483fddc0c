"""The law: its poles, equilibrium at the goal and linear part."""

# Not checked strictly: parts of Matplotlib have no types.
# pyright: reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from flexhinf.designs.pose_evidence import PoseEvidence
from flexhinf.designs.specification import RINGS
from flexhinf.numerals import count_text, number
from flexhinf.pages.design.step import stiffness_of
from flexhinf.pages.drawing import (
    DOTTED,
    Blocks,
    Line,
    Panel,
    draw_figure,
    in_joint,
    joint_table,
    note,
    range_text,
    units_of,
)
from flexhinf.report import MUTED, SERIES, Column, Figure, LineStyle, Listing, Paragraph, Table, finite
from flexhinf.robot.modes import Mode
from flexhinf.scalars.spectral import damping_ratio

#: Damping ratios whose lines are drawn in the s-plane.
RAYS = (0.1, 0.3, 0.7)

#: The s-plane reaches so many times as far as the fastest oscillation of robot and law; faster poles are on the right.
ROOM = 1.8

#: With more joints than these a terminal lists vibrations only.
MANY = 3


# Poles --------------------------------------------------------------------------------------------------
#: Poles (1/s) of a loop: its name, and how Matplotlib draws them.
PoleGroup = tuple[str, np.ndarray, LineStyle]


def poles_figure(groups: Sequence[PoleGroup]) -> Figure:
    """The s-plane near the imaginary axis, and damping over frequency for all poles."""
    groups = [group for group in groups if len(group[1])]
    poles = np.concatenate([each for _, each, _ in groups[:2]])  # without control, and with the law
    oscillating = np.abs(poles[np.abs(np.imag(poles)) > 0.0])
    size = ROOM * float(oscillating.max() if len(oscillating) else np.abs(poles).max(initial=1.0))
    dotted: LineStyle = {"color": MUTED, "linewidth": 0.8, "linestyle": DOTTED, "zorder": 0.5}
    rays = [2.0 * size * np.array([[0.0, -ray], [0.0, np.sqrt(1.0 - ray**2)]]) for ray in RAYS]
    plane, damping, low = [Line(ray[0], ray[1], None, dotted) for ray in rays], list[Line](), -0.05
    for name, each, marks in groups:
        style: LineStyle = {"markersize": 6.0, "linestyle": "none", **marks}
        upper = each[np.imag(each) >= 0.0]
        plane.append(Line(np.real(upper), np.imag(upper), None, style))
        upper = upper[np.abs(upper) / (2.0 * np.pi) > 1e-3]  # at zero it has no place on a logarithmic axis
        ratio = damping_ratio(upper)
        low = min([low, *(value - 0.05 for value in ratio.tolist() if value > -1.0 + 1e-9)])
        damping.append(Line(np.abs(upper) / (2.0 * np.pi), ratio, name, style))

    return draw_figure(
        "poles",
        (
            Panel(
                "Im λ",
                "rad/s",
                plane,
                vertical=0.0,
                across="Re λ (1/s)",
                x=(-size, max(0.12 * size, 1.15 * min(size, float(np.real(poles).max(initial=0.0))))),
                y=(-0.03 * size, size),
            ),
            Panel(
                "damping ratio",
                "",
                damping,
                (0.0,),
                across="frequency |λ|/2π (Hz)",
                log=True,
                y=(max(low, -1.05), 1.08),
                also=lambda axes: axes.axhspan(-2.0, 0.0, color=SERIES[1], alpha=0.08, linewidth=0),
            ),
        ),
        "Left: poles λ in the s-plane, upper half, near the imaginary axis; dotted rays have damping ratio "
        f"{', '.join(f'{ray:g}' for ray in RAYS)}. Right: damping ratio −Re λ/|λ| over frequency of all poles but "
        "those at zero; 1 decays without oscillating, below zero (shaded) grows.",
        "Poles",
        3.6,
        columns=2,
    )


def poles(design: PoseEvidence) -> Blocks:
    """Poles: figure, table of modes that oscillate or do not decay, sentence on those that decay monotonically."""
    after = vibration_damping(design.law_modes)
    if after and min(after) < RINGS:
        yield note(
            f"A vibration has a damping ratio of {min(after):.2g} with this law: its weights hardly act on it. "
            "`--damping 0.3` searches for weights that do."
        )
    error = [mode for mode in design.evaluation.estimator_modes if mode.vibration]
    if error:
        worst, target = min(error, key=lambda mode: mode.damping), design.design_problem.target
        what = (
            f"The estimator's error at {worst.frequency:.3g} Hz{in_joint(worst.joint, design.robot.joint_names)} has a "
            "damping ratio"
        )
        if worst.damping < 0.01:  # hardly corrected by the sensors
            yield note(
                f"{what} of {worst.damping:.1g} only, and noise keeps it ringing, in the robot too. Measure link "
                "positions or joint torques, or raise --process-noise."
            )
        elif target is not None and worst.damping < target.damping:
            yield note(
                f"{what} of {worst.damping:.2g}, less than required of the law: after unknown disturbances the loop "
                "rings with it. Try a larger --torque-noise, or another sensor (--measured)."
            )
    sentences: list[str] = []
    for name, modes in list(_modes(design).items())[:2]:
        times = [1.0 / -mode.eigenvalue.real for mode in modes if not _listed(mode)]
        constants = f", time constant{'s' * (len(times) > 1)} {range_text(times)} s" if times else ""
        decay = f"{count_text(len(times), 'mode')} {'decays' if len(times) == 1 else 'decay'}"
        sentences.append(f"{name.capitalize()}: {decay} without oscillating{constants}.")
    looks: tuple[LineStyle, ...] = (
        {"marker": "o", "color": MUTED, "markerfacecolor": "none"},
        {"marker": "o", "color": SERIES[0]},
        {"marker": "^", "color": SERIES[2]},
        {"marker": "x", "color": SERIES[1]},
    )
    poles = (
        ()
        if design.specification.estimator == "none"
        else design.evaluation.frequency_response.linear.closed_loop.poles
    )
    groups: list[tuple[str, Sequence[complex] | np.ndarray, LineStyle]] = [
        *(
            (name, [m.eigenvalue for m in modes], look)
            for (name, modes), look in zip(_modes(design).items(), looks)
        ),
        *([("running loop (sampled, estimator, delay)", poles, looks[-1])] if len(poles) else []),
    ]
    yield from (
        lambda: poles_figure(
            [(name, np.array(values, dtype=complex), look) for name, values, look in groups]
        ),
        mode_table(design),
        Paragraph(f"{' '.join(sentences)} The law adds one mode for the integral of each joint's error."),
    )


def _modes(design: PoseEvidence) -> Mapping[str, Sequence[Mode]]:
    error = design.evaluation.estimator_modes
    modes = {"without control": design.evaluation.open_modes, "law on the true state": design.law_modes}
    return {**modes, "estimation error": error} if error else modes


def _listed(mode: Mode) -> bool:
    return bool(mode.eigenvalue.imag) or not mode.stable  # the others are summed up in a sentence


def mode_table(design: PoseEvidence, brief: bool = False) -> Table:
    """Modes that oscillate or do not decay; `brief`: only those that oscillate, of many joints only vibrations."""
    several, many = (len(design.robot.joint_names) > few for few in (1, MANY))
    return Table(
        (
            "loop",
            "mode",
            *(["mainly"] if several else []),
            Column("frequency", "Hz", digits=4, brief="Hz"),
            Column("damping ratio", digits=4, brief="damping"),
            Column("time constant", "s", digits=4, brief=None),
        ),
        [
            (
                name,
                mode.name,
                *([mode.joint] if several else []),
                mode.frequency,
                mode.damping,
                mode.time_constant,
            )
            for name, modes in _modes(design).items()
            for mode in modes
            if _listed(mode) and not (brief and (not mode.eigenvalue.imag or (many and not mode.vibration)))
        ],
        "Modes that oscillate or do not decay, linearised at the goal, continuous time",
        "table-modes",
        title=f"γ* of the problem = {design.gamma_star:.5g}, γ = {design.gamma:.5g}\nOscillations at the goal",
    )


def vibration_damping(modes: Sequence[Mode]) -> list[float]:
    """Damping ratios of the vibrations among some modes."""
    return [mode.damping for mode in modes if mode.vibration]


# The law and its equilibrium ----------------------------------------------------------------------------
def law(design: PoseEvidence) -> Blocks:
    """The law in words, with its linear gain and the equilibrium about which it acts."""
    solution, problem, via = design.solution, design.problem, design.specification.via
    poses = f" The same was done at {count_text(len(via), 'pose')} on the way."
    channels = (
        " The channels of the tolerances enter in proportion to γ; the listing below keeps them as they are at this "
        f"γ, so its gamma* is not the γ* = {number(design.gamma_star)} of the whole problem."
    )
    yield Paragraph(
        f"V of degree {solution.degree} solves the Hamilton–Jacobi–Isaacs equation at γ = {number(solution.gamma, 5)} "
        f"about the goal, as a power series. The law has degree {solution.degree - 1} in {len(solution.P)} states, "
        f"{count_text(len(solution.input_names), 'input')} and {np.size(solution.law_data)} coefficients."
        f"{poses if via else ''}{'' if design.design_problem.robustness is None else channels}"
    )
    n, units, x = len(design.goal), units_of(design.evaluation), problem.operating_point
    motors = design.robot.layout.whole(x)[2 * n : 3 * n]
    yield joint_table(
        units,
        (
            Column("link position", units.angle, 4, key="link", scale=units.scale),
            Column("motor position, seen from the link", units.angle, 4, key="motor", scale=units.scale),
            Column("spring torque", units.spring, 3, key="torque"),
            Column("input", units.effort, 3, key="input"),
        ),
        [
            dict(zip(("joint", "link", "motor", "torque", "input"), row))
            for row in zip(
                *(
                    design.robot.joint_names,
                    x[:n].tolist(),
                    motors.tolist(),
                    finite(stiffness_of(problem.plant, design.robot, np.nan) * (motors - x[:n])),
                    problem.operating_input.tolist(),
                )
            )
        ],
        "Equilibrium at the goal",
        "table-rest",
    )
    yield from (
        Table(
            ("state", *(name.replace("_", " ") for name in problem.input_names)),
            [
                (name.replace("_", " "), *(number(float(value)) for value in column))
                for name, column in zip(
                    problem.state_names,
                    np.where(
                        np.abs(solution.gain) < 1e-13 * np.abs(solution.gain).max(), 0.0, solution.gain
                    ).T,
                )
            ],
            "Linear part K of u − u* = K (x − x*)",
            "table-gain",
        ),
        Listing(solution.report()),
    )
