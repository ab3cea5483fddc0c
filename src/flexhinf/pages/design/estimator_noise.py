"""The noise levels of the estimator: those in use, and what they trade off on the running loop."""

from __future__ import annotations

from typing import Any

import numpy as np

from flexhinf.design.problem.modes import JointScales
from flexhinf.design.problem.presets import required_damping
from flexhinf.design.result import Design
from flexhinf.design.synthesis.noise import MOST_NOISE, NoiseCandidate, NoiseSearch
from flexhinf.pages.drawing import figure_block, frequency_axis, line_style, panels, range_text
from flexhinf.report import INK, Column, Figure, Paragraph, Table, house_style, label, number

#: Candidates of the trade-off in a table, beside the default and the one that is used.
ROWS = 6


def blocks(design: Design) -> list[Any]:
    """Levels in use, the trade-off as a curve and a table; none without an estimator."""
    if design.specification.estimator == "none":
        return []
    if design.noise_search is None:
        return [Paragraph(_levels_text(design))]
    found: list[Any] = [Paragraph(f"{_levels_text(design)} {_outcome(design)}"), _figure(design)]
    found.append(_candidates(design))
    if (why := _hardly_seen(design)) is not None:
        found.append(Paragraph(why))
    return [*found, _by_joint(design)] if len(design.robot.joint_names) > 1 else found


def _levels_text(design: Design) -> str:
    noise = design.setup.process_noise
    levels = (
        ("every state", noise.all_states),
        ("link velocities", noise.link_velocities),
        ("motor velocities", noise.motor_velocities),
    )
    used = (
        ", ".join(f"{range_text(np.ravel(level), 2)} on {where}" for where, level in levels if np.any(level))
        or "0"
    )
    return (
        f"Rᵛ, the variance of the process noise per sample that the estimator assumes: {used} ({noise.source}). Rⁿ "
        f"of a measured position: {number(design.specification.measurement_noise, 3)}. Rᵛ is a parameter of the "
        "design: a vibration that the estimator takes for undisturbed rings in its error, so larger levels damp the "
        "running loop, and give it margins back; they cost noise at the motors."
    )


def _outcome(design: Design) -> str:
    """What the search reached."""
    search, robust = design.noise_search, design.synthesis.robust
    assert search is not None
    if robust is not None and robust.better:
        return "They were found together with the weights, for the tolerances: see there. The curve is of the same law."
    chosen, beyond, other = search.chosen, "", ""
    if search.unreachable:
        missed = " and the ".join(search.unreachable)
        beyond, other = (
            f"No levels reach the limit of the {missed}, which counts only in part. ",
            "other ",
        )
    kept = (
        f"every {other}limit of the running loop (peak sensitivity, gain margin, damping, load compliance, and "
        f"noise of at most {100.0 * MOST_NOISE:g} % of what a motor gives)"
    )
    if search.default is not None and chosen.levels is search.default.levels:
        return f"{beyond}The default levels keep {kept}."
    if chosen.feasible:
        return f"{beyond}The search took the levels with the least noise that keep {kept}."
    excess = chosen.avoidable.items()
    missed = ", ".join(f"{limit} by {100.0 * np.expm1(value):.0f} %" for limit, value in excess)
    corners = f"{chosen.unstable} corners of the tolerances are unstable" if chosen.unstable else ""
    what = "; ".join(text for text in (missed and f"missed: {missed}", corners) if text)
    return (
        f"{beyond}No levels were found that keep {kept}: the search took those that miss them least ({what})."
    )


def _hardly_seen(design: Design) -> str | None:
    """Why more is not possible with the motors' positions alone, where the damping is missed with them."""
    search, setup = design.noise_search, design.setup
    assert search is not None
    sensors = [name for name in setup.model.outputs if not name.startswith("motor")]
    if sensors or "damping" not in search.chosen.missed:
        return None
    scales = JointScales.of(setup.model, setup.goal_equilibrium)
    part = scales.link_inertia / (scales.link_inertia + scales.motor_inertia)
    worst = int(np.argmin(part))
    held = np.sqrt(scales.stiffness[worst] / scales.link_inertia[worst]) / (2.0 * np.pi)
    return (
        "Only the motors are measured. Of a vibration their positions show the part M/(M + J) of the twist, "
        f"{part[worst]:.2g} in joint {setup.joints[worst]}, and where the link swings on its spring while the motor "
        f"stands still ({held:.3g} Hz there) they show nothing of what the motor does. Near that zero the error of any "
        "estimator stays undamped unless the link is taken to be strongly disturbed, which amplifies the noise of the "
        "sensors. More damping takes a sensor of the link or of the joint's torque, or a less noisy one."
    )


def is_used(search: NoiseSearch, candidate: NoiseCandidate) -> bool:
    """Whether it is the candidate whose levels the design has."""
    return candidate.levels is search.chosen.levels


def selected(search: NoiseSearch) -> list[tuple[NoiseCandidate, str]]:
    """A few candidates of the trade-off, the default and the one that is used, the quietest first, each with a note."""
    places = np.unique(np.linspace(0, len(search.trade_off) - 1, ROWS).round().astype(int))
    apart = [(search.chosen, "used")]
    if search.default is not None and not is_used(search, search.default):
        apart.append((search.default, "default"))
    # The edge of the family where a level is at its least may be the default by another name.
    shown = [
        one
        for one in (search.trade_off[k] for k in places)
        if not any(_alike(one, other) for other, _ in apart)
    ]
    shown = [*((one, "") for one in shown), *apart]
    return sorted(shown, key=lambda one: one[0].input_noise)


def _alike(one: NoiseCandidate, other: NoiseCandidate) -> bool:
    """Whether a table would show the same figures of both."""
    figures = [
        (c.input_noise, c.damping, c.compliance, c.peak_sensitivity, c.gain_margin) for c in (one, other)
    ]
    return bool(np.allclose(*figures, rtol=1e-3))


def _note(candidate: NoiseCandidate, note: str) -> str:
    """Which limits a candidate misses, and what it is."""
    missed = ", ".join(candidate.missed)
    return f"{note}; missed: {missed}" if note and missed else note or missed


def _figure(design: Design) -> Figure:
    """Damping, and compliance, over the noise of each motor, for the candidates that no other one betters."""
    search = design.noise_search
    assert search is not None
    unit = design.setup.model.unit(design.setup.model.inputs[0])
    noises = np.array([one.noises for one in search.trade_off])
    figure, ((left, right),) = panels(1, 2, 3.2)
    with house_style():
        marks = [("s", 7.0, search.chosen)]
        if search.default is not None and not is_used(search, search.default):
            marks.append(("D", 5.0, search.default))
        for axis, figure_of in ((left, lambda one: one.damping), (right, lambda one: one.compliance)):
            figures = [figure_of(one) for one in search.trade_off]
            for joint, name in enumerate(design.robot.joint_names):
                color = line_style(joint)["color"]
                axis.plot(noises[:, joint], figures, "o", markersize=3.0, color=color, label=name)
                for mark, size, one in marks:
                    axis.plot(one.noises[joint], figure_of(one), mark, markersize=size, mfc="none", mec=color)
            axis.set_ylim(bottom=0.0)
        target = design.design_problem.target
        if target is not None:
            left.axhline(
                required_damping(design.specification, target), color=INK, linewidth=1.0, dashes=(6.0, 3.0)
            )
        if len(design.robot.joint_names) > 1:
            figure.legend(*left.get_legend_handles_labels(), loc="outside upper left", ncols=7, frameon=False)
    for axis in (left, right):
        frequency_axis(axis)
        axis.set_xlabel(f"noise at the motor, rms ({unit})")
    label(left, "smallest damping ratio", "")
    label(right, "compliance / true state", "")
    return figure_block(
        "noise-trade-off", figure,
        f"What noise at the motors buys. Of {search.count} choices of Rᵛ with a stable loop, dots are those that "
        "no other one betters in noise, damping and compliance at once, one dot for each motor; squares: used"
        f"{', diamonds: the default levels' if len(marks) > 1 else ' (the default levels)'}. "
        "A choice to the left of the squares breaks another limit (see the table), or yields more to a load."
        f"{'' if target is None else ' The dashed line is the damping that is required.'}",
        "Noise at the motors against damping and load stiffness",
    )  # fmt: skip


def _candidates(design: Design) -> Table:
    search = design.noise_search
    assert search is not None
    rows = [
        (
            number(one.input_noise, 3), one.damping, one.compliance, one.peak_sensitivity,
            one.gain_margin if np.isfinite(one.gain_margin) else None, _note(one, note),
        )
        for one, note in selected(search)
    ]  # fmt: skip
    columns = (
        Column("noise at the noisiest motor (rms)", design.setup.model.unit(design.setup.model.inputs[0])),
        Column("smallest damping ratio", "", 3),
        Column("compliance / true state", "", 2),
        Column("peak sensitivity", "", 2),
        Column("gain margin", "", 2),
        "limits missed, or used",
    )
    return Table(
        columns,
        rows,
        f"{len(rows)} of {search.count} choices of Rᵛ: the default, the one used, and some of the dots",
        "table-noise-search",
        stacks=True,
    )


def _by_joint(design: Design) -> Table:
    search, joints = design.noise_search, design.robot.joint_names
    assert search is not None
    links, motors = (
        np.broadcast_to(levels, len(joints))
        for levels in (search.chosen.levels.link_velocities, search.chosen.levels.motor_velocities)
    )
    rows = [
        (name, number(float(link), 2), number(float(motor), 2), float(noise))
        for name, link, motor, noise in zip(joints, links, motors, search.chosen.noises, strict=True)
    ]
    unit = design.setup.model.unit(design.setup.model.inputs[0])
    columns = ("joint", "Rᵛ, link velocity", "Rᵛ, motor velocity", Column("noise at the motor (rms)", unit))
    return Table(columns, rows, "The levels that are used, joint by joint", "table-noise-levels")
