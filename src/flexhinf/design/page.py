"""The report of a design: one page, and the same numbers as JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from flexhinf.design.figures import estimation_figure, modes_figure, response_figure, rigid_figure
from flexhinf.design.modes import Mode
from flexhinf.design.numbers import numbers_of
from flexhinf.design.result import Design
from flexhinf.design.settings import setting_groups
from flexhinf.design.words import (
    law_name,
    mujoco_words,
    notes,
    range_of,
    rigid_words,
    step_words,
    verdict,
    vibrations,
)
from flexhinf.report import (
    Column,
    KeyNumber,
    Listing,
    Note,
    Page,
    Paragraph,
    Provenance,
    Section,
    Settings,
    Table,
    to_json,
)

__all__ = ["design_files", "design_page"]


def design_files(design: Design, command: Sequence[str], warnings: Sequence[str] = ()) -> dict[str, str]:
    """index.html and design.json."""
    return {
        "index.html": design_page(design, command, warnings).html(),
        "design.json": to_json(numbers_of(design)),
    }


def design_page(design: Design, command: Sequence[str], warnings: Sequence[str] = ()) -> Page:
    """Everything on one page."""
    robot, s = design.robot, design.specification
    joints = f"{len(robot.joint_names)} elastic joint{'s' if len(robot.joint_names) > 1 else ''}"
    about = f" {robot.description}." if robot.description else ""
    described = f"{robot.name}, {joints}, {robot.drive} driven.{about}"
    measured = ", ".join(s.measured).replace("_", " ")
    sections = [
        Section("Step response", tuple(_step_blocks(design, warnings)), "step"),
        Section("Modes", (modes_figure(design), _mode_table(design), Paragraph(_decays(design))), "modes"),
    ]
    if design.rigid is not None:
        sections.append(Section("The rigid design on the same robot", tuple(_rigid_blocks(design)), "rigid"))
    sections += [
        Section("Where the solution can be trusted", tuple(_region_blocks(design)), "region"),
        Section("Rest at the goal", (_rest_table(design),), "rest"),
        Section(
            "The law",
            (Paragraph(_law_text(design)), _gain_table(design), Listing(design.solution.report())),
            "law",
        ),
    ]
    return Page(
        f"{law_name(design.chosen.degree).capitalize()} nonlinear H∞ control of {robot.name}",
        f"{described} Measured: {measured}. Goal: {_pose(design.goal)}; start of the step: {_pose(design.start)}.",
        verdict(design),
        tuple(sections),
        Settings(setting_groups(design)),
        Provenance(tuple(command), s.seed),
        _key_numbers(design),
    )


def _pose(values: np.ndarray) -> str:
    return f"({', '.join(f'{value:.4g}' for value in values)})"


def _key_numbers(design: Design) -> list[KeyNumber]:
    solution, chosen = design.solution, design.chosen
    moved = [m for m in design.response.metrics if m.get("overshoot_percent") is not None]
    times = [m["settling_time_s"] for m in moved]
    settling = None if not times or None in times else max(times)
    unit = design.problem.plant.unit(design.problem.input_names[0])
    peak = float(np.abs(design.response.run.signals["input"]).max())
    tracked = design.problem.plant.unit(design.problem.integrate[0])
    trusted = step_words(chosen.step_amplitude, tracked)
    numbers = [
        KeyNumber(
            "smallest feasible γ*",
            f"{design.gamma_star:.4g}",
            note=f"{', '.join(_kinds(design))}; used: {design.specification.gamma_ratio:g} γ* = {solution.gamma:.4g}",
        ),
        KeyNumber(
            "damping of vibrations",
            range_of(vibrations(design.closed_modes), 2),
            note=f"open: {range_of(vibrations(design.open_modes), 2)}",
        ),
        KeyNumber("settling time", settling, "s", "slowest joint, ±2 % of its step"),
        KeyNumber(
            "overshoot",
            max((round(m["overshoot_percent"], 1) for m in moved), default=None),
            "%",
            "largest of all joints",
        ),
        KeyNumber("peak input", float(f"{peak:.3g}"), unit),
    ]
    last = KeyNumber("sampled step", trusted, note="largest rest to rest, all joints; not proved")
    return [*numbers, last] if chosen.looked else numbers


def _kinds(design: Design) -> list[str]:
    """What disturbs, without repeating every joint."""
    names = design.problem.disturbance_names
    joints = design.robot.joint_names
    found = []
    for kind in ("link_position_command", "link_torque", "motor_torque"):
        stem = kind.removesuffix("_command")
        if any(name.startswith(stem) for name in names):
            found.append("command as disturbance" if kind.endswith("command") else kind.replace("_", " "))
    return found or [f"{len(names)} disturbances on {len(joints)} joints"]


def _step_blocks(design: Design, warnings: Sequence[str]) -> list[Any]:
    blocks: list[Any] = [Note(text[:1].upper() + text[1:]) for text in notes(design)]
    unit = design.problem.plant.unit(design.problem.input_names[0])
    blocks += [Note(" ".join(line.strip() for line in text.splitlines())) for text in warnings]
    rows = [
        (
            name,
            float(begin),
            float(end),
            m.get("overshoot_percent"),
            m.get("settling_time_s"),
            m.get("steady_state_error"),
            m.get("peak_input"),
            m.get("input_noise"),
        )
        for name, begin, end, m in zip(
            design.robot.joint_names, design.start, design.goal, design.response.metrics
        )
    ]
    columns = (
        "joint",
        Column("from", "rad"),
        Column("to", "rad"),
        Column("overshoot", "%", 1),
        Column("settling time", "s", 3),
        Column("largest error in the last tenth", "rad"),
        Column("peak input", unit),
        Column("input noise", unit),
    )
    blocks += [
        response_figure(design),
        Table(
            columns,
            rows,
            "Of the true link positions; m for joints that slide. Input noise: standard deviation in the last tenth",
        ),
    ]
    if design.mujoco is not None:
        blocks.append(_mujoco_table(design))
    estimate = estimation_figure(design)
    return blocks if estimate is None else [*blocks, estimate]


def _mujoco_table(design: Design) -> Table:
    """The figures of merit of both plants side by side."""
    assert design.mujoco is not None
    rows = [
        (plant, name, m.get("overshoot_percent"), m.get("settling_time_s"), m.get("steady_state_error"))
        for plant, response in (("ours", design.response), ("MuJoCo's", design.mujoco))
        for name, m in zip(design.robot.joint_names, response.metrics)
    ]
    columns = (
        "plant",
        "joint",
        Column("overshoot", "%"),
        Column("settling time", "s"),
        "largest error in the last tenth",
    )
    return Table(columns, rows, f"The same controller and noise on MuJoCo's plant: {mujoco_words(design)}")


def _mode_table(design: Design) -> Table:
    loops = (
        ("without control", design.open_modes),
        ("with this law", design.closed_modes),
        ("estimation error", design.estimator_modes),
    )
    rows = [(name, *_mode_row(mode)) for name, modes in loops for mode in modes if _told(mode)]
    return Table(
        (
            "loop",
            "mode",
            "mainly",
            Column("frequency", "Hz", 3),
            Column("damping ratio"),
            Column("time constant", "s"),
        ),
        rows,
        "What oscillates or does not decay, linearised at the goal",
    )


def _told(mode: Mode) -> bool:
    """Whether a mode has a row of its own: what decays without oscillating is told in a sentence."""
    return bool(mode.eigenvalue.imag) or not mode.stable


def _decays(design: Design) -> str:
    words = []
    for name, modes in (("Without control", design.open_modes), ("with this law", design.closed_modes)):
        times = [1.0 / -mode.eigenvalue.real for mode in modes if not _told(mode)]
        many = f"{len(times)} modes decay" if len(times) != 1 else "1 mode decays"
        words.append(
            f"{name} {many} without oscillating" + (f" (time constants {range_of(times)} s)" if times else "")
        )
    return "; ".join(words) + ". With the law, the integral of each joint's error adds a mode."


def _mode_row(mode: Mode) -> tuple[Any, ...]:
    return mode.name, mode.joint, mode.frequency, mode.damping, mode.time_constant


def _rigid_blocks(design: Design) -> list[Any]:
    rigid, figure = design.rigid, rigid_figure(design)
    assert rigid is not None
    text = (
        "The same weights, γ/γ* and degree, designed on the model whose springs are infinitely stiff, link and "
        "reflected rotor inertia as one, then put to work on the elastic robot. On a rigid robot it does not "
        "matter on which side of the springs position and velocity are taken; here it does. The rigid law is fed "
        f"the true values, more than it would have. Its own γ is {rigid.gamma:.4g}."
    )
    fed = "estimator" if design.specification.estimator != "none" else "true state"
    ours = "stable" if all(mode.stable for mode in design.closed_modes) else "unstable"
    rows: list[tuple[Any, ...]] = [
        _compared("this law", fed, design.closed_modes, design.response, ours),
        *(
            _compared("rigid", f"{loop.side} side, true", loop.modes, loop.response, rigid_words(loop))
            for loop in rigid.loops
        ),
    ]
    columns = (
        "law",
        "fed from",
        "linearised loop",
        Column("lowest damping ratio of a vibration"),
        Column("largest overshoot", "%", 1),
        Column("settling time", "s", 3),
        "run",
    )
    found: list[Any] = [Paragraph(text), Table(columns, rows)]
    return found if figure is None else [*found, figure]


def _compared(law: str, fed: str, modes: Sequence[Mode], response: Any, words: str) -> tuple[Any, ...]:
    stable = all(mode.stable for mode in modes)
    moved = [m for m in response.metrics if m.get("overshoot_percent") is not None and stable]
    times = [m["settling_time_s"] for m in moved]
    ended = "to its end" if response.diverged is None else f"diverged at {response.diverged:.3g} s"
    settling = None if not times or None in times else max(times)
    return (
        law,
        fed,
        words,
        min(vibrations(modes), default=None),
        max((m["overshoot_percent"] for m in moved), default=None),
        settling,
        ended,
    )


def _region_blocks(design: Design) -> list[Any]:
    unit = design.problem.plant.unit(design.problem.integrate[0])
    rows = [
        (
            c.degree,
            law_name(c.degree),
            "chosen" if c is design.chosen else "",
            _finite(c.level),
            step_words(c.step_amplitude, unit),
            c.limit,
            f"{c.residual:.0e}",
            1e3 * c.solve_seconds,
            c.check_seconds,
        )
        for c in design.choices
    ]
    columns = (
        "degree of V",
        "law",
        "",
        "V up to",
        "rest-to-rest step of all joints",
        "limited by",
        "residual",
        Column("solve", "ms", 1),
        Column("check", "s", 1),
    )
    s = design.specification
    text = (
        "The largest level set of V on which nothing was found against the dissipation inequality, along random "
        "rays and by ascent on the worst of them: looked at, not proved. Checked is the weaker pair "
        f"γ = {s.checked_gamma_ratio:g} γ* and the penalty of the settings. It covers the law with the true state, "
        "not the estimator. Of the degrees tried, the one with the largest step is used (the highest one where no "
        "region was looked at)."
    )
    return [Paragraph(text), Table(columns, rows)]


def _finite(value: float) -> str:
    if math.isnan(value):
        return "–"
    return "everything looked at" if math.isinf(value) else f"{value:.4g}"


def _rest_table(design: Design) -> Table:
    n, plant = len(design.goal), design.problem.plant
    x, u = design.problem.operating_point, design.problem.operating_input
    p = plant.parameters.named(plant.parameters.vector())
    stiffness = np.atleast_1d(p.stiffness)
    rows = [
        (name, float(x[j]), float(x[2 * n + j]), float(stiffness[j] * (x[2 * n + j] - x[j])), float(u[j]))
        for j, name in enumerate(design.robot.joint_names)
    ]
    columns = (
        "joint",
        Column("link position", "rad", 5),
        Column("motor position, seen from the link", "rad", 5),
        Column("gravity held by the spring", "N·m", 3),
        Column("holding input", plant.unit(plant.inputs[0]), 3),
    )
    return Table(columns, rows, "The operating point; m and N for joints that slide")


def _law_text(design: Design) -> str:
    solution = design.solution
    n, m, terms = len(solution.P), len(solution.input_names), np.size(solution.law_data)
    return (
        f"V of degree {solution.degree} solves the Hamilton–Jacobi–Isaacs equation at γ = {solution.gamma:.5g} "
        f"about the goal: a law of degree {solution.degree - 1} in {n} states for {m} "
        f"input{'s' if m > 1 else ''}, {terms} coefficients. Its linear part, u − u* = K (x − x*):"
    )


def _gain_table(design: Design) -> Table:
    gain = design.solution.gain
    names = design.problem.state_names
    rows = [(name, *(f"{value:.4g}" for value in gain[:, i])) for i, name in enumerate(names)]
    return Table(("state", *(name for name in design.problem.input_names)), rows)
