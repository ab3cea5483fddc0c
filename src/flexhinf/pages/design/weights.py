"""The weights that were searched for, and what covering the tolerances costs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from flexhinf.design.problem.presets import Robustness
from flexhinf.design.result import Design
from flexhinf.design.synthesis.whole_loop import NOISE, WholeLoopSearch
from flexhinf.pages.drawing import (
    DASHED,
    count_text,
    figure_block,
    finite,
    panels,
    range_text,
    vertical_line,
)
from flexhinf.plant import GeneralisedPlant
from flexhinf.report import INK, SERIES, Column, Figure, Paragraph, Table, house_style, label, number
from flexhinf.robot.signals import signal_names

PRESETS = {
    "paper": "Preset paper: weights on positions and their integrals, as in Eq. (11) of the paper",
    "damped": "Preset damped: weights found by a search for bandwidth and damping",
    "robust": "Preset robust: weights and noise levels searched on the running loop for the tolerances of the robot",
    "proved": "Preset proved: weights, damping and γ searched for the step's smallest gain that is proved for all "
    "tolerances of the robot, with the true state fed back",
    "given": "Weights as given",
}


class Weight(NamedTuple):
    """One weight: of which signal, its value, and the unit that makes the product dimensionless."""

    signal: str
    value: float
    unit: str


def blocks(design: Design) -> list[Any]:
    """Preset, search and weights; with the preset robust what its channels cover and cost."""
    problem = design.design_problem
    found: list[Any] = [Paragraph(_preset(design))]
    if problem.search is not None:
        found += [Paragraph(_search(design)), _search_figure(design), _candidates(design)]
    if design.synthesis.robust is not None:
        found += [
            Paragraph(_whole_loop_text(design.synthesis.robust)),
            _whole_loop(design, design.synthesis.robust),
        ]
    if problem.robustness is not None:
        found += [_robust(design), Paragraph(_robust_text(design))]
    return [*found, *_weights(design)]


def _preset(design: Design) -> str:
    problem = design.design_problem
    which = " of this problem, with the channels of the tolerances" if problem.robustness is not None else ""
    return (
        f"{PRESETS[problem.preset]} ({problem.source}). Disturbances of the problem: "
        f"{', '.join(_disturbances(design))}. "
        f"The smallest level γ*{which} is {number(problem.gamma_star)}, from its linear part; the law is solved for "
        f"γ = {problem.gamma / problem.gamma_star:g} γ* = {number(problem.gamma)}."
    )


def _disturbances(design: Design) -> list[str]:
    """Kinds of disturbances, without repeating every joint."""
    names = design.problem.disturbance_names
    found = []
    for kind in ("link_position_command", "link_torque", "motor_torque"):
        if any(name.startswith(kind.removesuffix("_command")) for name in names):
            found.append("the command" if kind.endswith("command") else kind.replace("_", " "))
    return found or [f"{len(names)} signals"]


def _search(design: Design) -> str:
    target, search = design.design_problem.target, design.design_problem.search
    assert target is not None
    assert search is not None
    return (
        "R2 is fixed. Each joint has a target frequency ω, and all vibrations share one damping weight ζ. For each ζ "
        f"the target frequencies are moved until every joint has its bandwidth of {range_text(target.bandwidth)} "
        f"rad/s; ζ grows from 0 until every oscillation has a damping ratio of {target.damping:g}, and is then "
        f"bisected to the smallest value that gives it. The search evaluated "
        f"{count_text(len(search.candidates), 'candidate')} on the linear part "
        "with the true state fed back. Each is judged by its worst over the nominal robot and "
        "corners of its tolerances, so the nominal robot gets more damping than the target."
    )


def candidate_rows(design: Design) -> list[tuple[float, str, str, float, float, float, bool]]:
    """Largest ζ, ω, bandwidth, worst and nominal damping, γ*, and whether it is the one that is used; by ζ."""
    search = design.design_problem.search
    assert search is not None
    return [
        (
            c.damping_weight,
            range_text(c.target_frequency),
            range_text(c.behaviour.bandwidth),
            c.behaviour.damping,
            c.behaviour.nominal_damping,
            c.design.gamma_star,
            c is search.chosen,
        )
        for c in sorted(search.candidates, key=lambda c: c.damping_weight)
    ]


def selected_candidates(rows: list[Any]) -> list[Any]:
    """The first, the last, the one that is used, and its neighbours."""
    used = next(k for k, row in enumerate(rows) if row[-1])
    shown = {0, max(0, used - 1), used, min(len(rows) - 1, used + 1), len(rows) - 1}
    return [rows[k] for k in sorted(shown)]


def _candidates(design: Design) -> Table:
    every = candidate_rows(design)
    rows = [(*finite(row[:-1]), "used" if row[-1] else "") for row in selected_candidates(every)]
    columns = (
        Column("largest damping weight ζ", "", 3),
        Column("target frequency ω", "rad/s"),
        Column("bandwidth", "rad/s"),
        Column("damping, worst robot", "", 3),
        Column("damping, nominal robot", "", 3),
        "γ*",
        "",
    )
    caption = f"{len(rows)} of {count_text(len(every), 'candidate')}, by ζ; design.json has all"
    return Table(columns, rows, caption, "table-tries")


def _search_figure(design: Design) -> Figure:
    """Damping and γ* over the damping weight."""
    search, target = design.design_problem.search, design.design_problem.target
    assert search is not None
    assert target is not None
    candidates = sorted(search.candidates, key=lambda c: c.damping_weight)
    weight = np.array([c.damping_weight for c in candidates])
    curves = (
        ("worst of the tolerances", [c.behaviour.damping for c in candidates], SERIES[1]),
        ("nominal robot", [c.behaviour.nominal_damping for c in candidates], SERIES[0]),
    )
    figure, ((left, right),) = panels(1, 2, 3.2)
    dots: dict[str, Any] = {"markersize": 3.5, "linewidth": 1.2}
    with house_style():
        for name, values, colour in curves:
            left.plot(
                weight, np.where(np.isfinite(values), values, np.nan), "o-", color=colour, label=name, **dots
            )
        left.axhline(target.damping, color=INK, linewidth=1.0, dashes=DASHED, label="target")
        right.plot(weight, [c.design.gamma_star for c in candidates], "o-", color=SERIES[0], **dots)
        for axis in (left, right):
            vertical_line(axis, search.chosen.damping_weight)
            axis.set_xlabel("largest damping weight ζ")
        left.set_ylim(bottom=0.0)
        figure.legend(*left.get_legend_handles_labels(), loc="outside upper left", ncols=3, frameon=False)
    label(left, "smallest damping ratio", "")
    label(right, "γ*", "")
    return figure_block(
        "search", figure,
        "Candidates at the required bandwidth: the smallest damping ratio of an oscillation, and γ*, over the largest "
        "damping weight ζ. The dotted line is the ζ that is used.",
        "Search for the weights",
    )  # fmt: skip


def whole_loop_blocks(design: Design) -> list[Any]:
    """What the preset robust searched for on the running loop; nothing with other presets."""
    found = design.synthesis.robust
    return [] if found is None else [Paragraph(_whole_loop_text(found)), _whole_loop(design, found)]


def _whole_loop_text(found: WholeLoopSearch) -> str:
    """What was searched, under which conditions, and what came of it."""
    searched = (
        f"From the preset damped, {count_text(found.count, 'loop')} with other weights, noise levels and channels of "
        "the tolerances were tried, with the estimator, for the largest factor of all tolerances up to which no corner "
        "of them is unstable; with no more overshoot at the corners than with damped, the same limits of the running "
        f"loop, and at most {NOISE:g} times the noise at each motor. "
    )
    if not found.better:
        return f"{searched}None was better, so the design is that of the preset damped."
    return (
        f"{searched}Of those of damped the target frequencies were multiplied by {number(found.frequency, 3)}, ζ by "
        f"{number(found.damping, 3)}, the noise levels of the links by {number(found.links, 3)} and of the motors by "
        f"{number(found.motors, 3)}. "
        + (f"First unstable: {found.corner}." if found.corner else "No corner became unstable.")
    )


def whole_loop_rows(found: WholeLoopSearch) -> list[tuple[str, str, float, float]]:
    """What, its unit or "input", with the preset damped, and as found."""
    return [
        ("factor of all tolerances at which a corner is unstable", "", found.damped.scale, found.found.scale),
        ("largest overshoot of the corners that stepped", "%", found.damped.overshoot, found.found.overshoot),
        (
            "noise at the loudest motor, rms",
            "input",
            float(found.damped.noises.max()),
            float(found.found.noises.max()),
        ),
        *(
            (what, "", getattr(found.damped.margins, name), getattr(found.found.margins, name))
            for what, name in (
                ("peak sensitivity", "peak_sensitivity"),
                ("gain margin", "gain_margin"),
                ("smallest damping ratio", "damping"),
            )
        ),
    ]


def _whole_loop(design: Design, found: WholeLoopSearch) -> Table:
    volts = design.setup.model.unit(design.setup.model.inputs[0])
    rows = [
        (what, number(damped, 3), number(robust, 3), volts if unit == "input" else unit)
        for what, unit, damped, robust in whole_loop_rows(found)
    ]
    columns = ("running loop", "preset damped", "preset robust", "unit")
    return Table(
        columns, rows, "What the search for the tolerances gained, and what it cost", "table-whole-loop"
    )


def robust_rows(design: Design) -> list[tuple[str, float, float]]:
    """What, without the channels of the tolerances, and with them."""
    r = design.design_problem.robustness
    assert r is not None
    return [
        ("γ* of the problem", r.nominal_gamma_star, r.gamma_star),
        ("level that the nominal robot attains", r.nominal_gain, r.robust_gain),
    ]


def _robust(design: Design) -> Table:
    rows = [
        (what, plain, robust, 100.0 * (robust / plain - 1.0)) for what, plain, robust in robust_rows(design)
    ]
    columns = ("", "without tolerances", "with tolerances", Column("cost", "%", 1))
    return Table(columns, rows, "What covering the tolerances costs (linear part)", "table-robust")


def _products(r: Robustness) -> str:
    """What is known of products of tolerances."""
    which = f"{'all' if r.all_corners else 'the sampled'} {r.corners} corners"
    if r.failing_corners:
        return (
            "Products of tolerances (for example mass times length) change a robot by more than its channels: the "
            f"inequality of the linear part fails at {r.failing_corners} of {which} of the tolerances that act at the "
            "goal, so it holds for each tolerance alone, and not for all of them together."
        )
    enlarged = (
        f" with the tolerances of the channels enlarged by {number(100.0 * (r.enlarged - 1.0), 2)} %"
        if r.enlarged > 1.0
        else ""
    )
    return (
        "Products of tolerances (for example mass times length) change a robot by more than its channels:"
        f"{enlarged} the inequality of the linear part holds at {which} of the tolerances that act at the goal."
    )


def _robust_text(design: Design) -> str:
    r = design.design_problem.robustness
    assert r is not None
    covered = (
        "the whole of the stated tolerances"
        if r.fraction >= 1.0
        else f"{number(100.0 * r.fraction, 3)} % of them, as was best for the running loop"
    )
    beyond = "" if r.fraction >= 1.0 else ", and nothing follows from them for robots beyond that fraction"
    return (
        f"{r.channels} channels stand for the tolerances, and the problem has a solution for {covered}{beyond}. The "
        "channels are linear in each tolerance: the level holds on the linear part, with the true state fed back, for "
        f"robots that such channels describe. {_products(r)} Scalings s of the channels, each seen s times and "
        f"acting 1/s times as strongly: {_scalings(design)}."
    )


def _scalings(design: Design) -> str:
    assert design.design_problem.robustness is not None
    found = sorted(design.design_problem.robustness.scalings.items())
    return ", ".join(f"{group.replace('_', ' ')} {range_text(ends)}" for group, ends in found)


# The weights themselves ---------------------------------------------------------------------------------
def state_weights(problem: GeneralisedPlant, joints: Sequence[str]) -> list[Weight]:
    """Of states, integrals, spring torques and their rates; empty for a penalty that is code of the user's."""
    states = problem.penalty.states
    coded = callable(states)
    given = getattr(states, "states", None) if coded else problem.penalty.weights(problem.state_names)
    named = [] if given is None else list(zip(problem.state_names, np.asarray(given, dtype=float)))
    for group, attribute in (("joint_torque", "torques"), ("joint_torque_rate", "rates")):
        named += zip(signal_names(group, joints), getattr(states, attribute, ()) if coded else ())
    unit = problem.plant.unit
    return [Weight(name, float(weight), _inverse(unit(name))) for name, weight in named if weight]


def effort_unit(problem: GeneralisedPlant) -> str:
    """Of R2, with a dimensionless z."""
    units = dict.fromkeys(problem.plant.unit(name) for name in problem.input_names)
    return " or ".join(f"({unit})⁻²" if "·" in unit else f"{unit}⁻²" for unit in units)


def _inverse(unit: str) -> str:
    if not unit:
        return ""
    return f"1/({unit})" if "·" in unit or "/" in unit else f"1/{unit}"


def _weights(design: Design) -> list[Any]:
    joints = design.robot.joint_names
    found, several = state_weights(design.problem, joints), len(joints) > 1
    effort = np.asarray(design.problem.r2, dtype=float)
    diagonal = np.diagonal(effort) if effort.ndim == 2 else np.atleast_1d(effort)
    price = (
        f"R2 = {range_text(diagonal)} {effort_unit(design.problem)} ({design.design_problem.effort_source})."
    )
    if not found:
        return [Paragraph(f"The penalty of the states is code. {price}")]
    if several:
        return [_weights_by_joint(design, found), Paragraph(price)]
    rows = [(weight.signal.replace("_", " "), number(weight.value), weight.unit) for weight in found]
    table = Table(
        ("weight of", "value", "unit"), rows, "Weights: h(x) has one entry for each", "table-weights"
    )
    return [table, Paragraph(price)]


def _weights_by_joint(design: Design, found: list[Weight]) -> Table:
    """One row for each signal, one column for each joint."""
    joints, rows = design.robot.joint_names, dict[str, dict[str, Weight]]()
    for weight in found:
        joint = next((name for name in joints if f"_{name}_" in f"{weight.signal}_"), "")
        signal = weight.signal.replace(f"_{joint}", "", 1) if joint else weight.signal
        rows.setdefault(signal.replace("_", " "), {})[joint] = weight
    cells = [
        (
            signal,
            *(number(by[joint].value) if joint in by else "–" for joint in joints),
            " or ".join(dict.fromkeys(weight.unit for weight in by.values())),
        )
        for signal, by in rows.items()
    ]
    return Table(
        ("weight of", *joints, "unit"), cells, "Weights: h(x) has one entry for each", "table-weights"
    )
