"""The weights that were searched for, what the tolerances cost, and the noise levels of the estimator."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from flexhinf.analysis.modes import JointScales
from flexhinf.designs.pose_evidence import PoseEvidence
from flexhinf.designs.problem.presets import ToleranceFraction, required_damping
from flexhinf.designs.problem.weights import SearchResult, TargetBehaviour, WeightCandidate
from flexhinf.designs.synthesis.noise import MOST_NOISE, NoiseCandidate, NoiseSearch
from flexhinf.designs.synthesis.steps import NOISE, WholeLoopSearch
from flexhinf.numerals import count_text, number
from flexhinf.pages.drawing import Blocks, Line, Panel, draw_figure, line_style, range_text
from flexhinf.plant import GeneralisedPlant
from flexhinf.report import INK, SERIES, Column, Figure, LineStyle, Paragraph, Table, finite
from flexhinf.robot.signals import signal_names

PRESETS = {
    "paper": "Preset paper: weights on positions and their integrals, as in Eq. (11) of the paper",
    "damped": "Preset damped: weights found by a search for bandwidth and damping",
    "robust": "Preset robust: weights and noise levels searched on the running loop for the tolerances of the robot",
    "proved": "Preset proved: weights, damping and γ of the first candidate, by rising gain, whose step is proved for "
    "all tolerances of the robot, with the true state fed back",
    "given": "Weights as given",
}

#: Candidates of the trade-off of noise levels in a table, beside the default and the one that is used.
ROWS = 6


def weights(design: PoseEvidence) -> Blocks:
    """Weights: preset, search and values; for the preset robust also coverage and cost of the tolerance channels."""
    problem, names, robust = design.design_problem, design.problem.disturbance_names, design.synthesis.robust
    kinds = [
        text
        for kind, text in (
            ("link_position", "the command"),
            ("link_torque", "link torque"),
            ("motor_torque", "motor torque"),
        )
        if any(name.startswith(kind) for name in names)
    ]
    which = " of this problem, with the channels of the tolerances" if problem.robustness is not None else ""
    yield Paragraph(
        f"{PRESETS[problem.preset]} ({problem.source}). Disturbances of the problem: "
        f"{', '.join(kinds) or f'{len(names)} signals'}. The smallest level γ*{which} is {number(problem.gamma_star)}, "
        f"from its linear part; the law is solved for γ = {problem.gamma / problem.gamma_star:g} γ* = "
        f"{number(problem.gamma)}."
    )
    if problem.search is not None and problem.target is not None:
        yield from _search(problem.search, problem.target, robust is not None and robust.better)
    yield from whole_loop(design)
    if problem.robustness is not None:
        yield from (robust_table(problem.robustness), Paragraph(_robust_text(problem.robustness)))
    joints, r2 = design.robot.joint_names, np.asarray(design.problem.r2, float)
    rows: dict[str, dict[str, tuple[float, str]]] = {}
    named = joints if len(joints) > 1 else ()
    for whole, value, unit in state_weights(design.problem, joints):
        joint = next((name for name in named if f"_{name}_" in f"{whole}_"), "")
        signal = whole.replace(f"_{joint}", "", 1) if joint else whole
        rows.setdefault(signal.replace("_", " "), {})[joint or next(iter(joints))] = value, unit
    if rows:
        yield Table(
            ("weight of", *(named or ["value"]), "unit"),
            [
                (
                    signal,
                    *(number(by[joint][0]) if joint in by else "–" for joint in joints),
                    " or ".join(dict.fromkeys(unit for _, unit in by.values())),
                )
                for signal, by in rows.items()
            ],
            "Weights: h(x) has one entry for each",
            "table-weights",
        )
    yield Paragraph(
        f"{'' if rows else 'The penalty of the states is code. '}R2 = "
        f"{range_text(np.diagonal(r2) if r2.ndim == 2 else np.atleast_1d(r2))} {effort_unit(design.problem)} "
        f"({problem.effort_source})."
    )


# The search for bandwidth and damping -------------------------------------------------------------------
def _search(search: SearchResult, target: TargetBehaviour, replaced: bool) -> Blocks:
    candidates = sorted(search.candidates[: -1 if replaced else None], key=lambda c: c.damping_weight)
    yield Paragraph(
        "R2 is fixed. For each damping weight ζ of all vibrations the target frequency ω of every joint is moved until "
        f"it has its bandwidth of {target.bandwidth_text}; ζ is the smallest with which every oscillation "
        f"has a damping ratio of {target.damping:g}. The search evaluated {count_text(len(candidates), 'candidate')} "
        "on the linear part with the true state fed back, each by its worst over the nominal robot and corners of its "
        f"tolerances.{' The weights in use are of the search on the running loop (below).' if replaced else ''}"
    )

    def lines(value: Callable[[WeightCandidate], float], name: str, color: str) -> list[Line]:
        dots: LineStyle = {"color": color, "marker": "o", "markersize": 3.5, "linewidth": 1.2}
        square: LineStyle = {"color": color, "marker": "s", "linestyle": "none"}
        groups = [(candidates, dots, name), *[([search.chosen], square, f"in use, {name}")] * replaced]
        return [
            Line(
                np.array([c.damping_weight for c in each]),
                np.array([v if np.isfinite(v := value(c)) else np.nan for c in each]),
                text,
                style,
            )
            for each, style, text in groups
        ]

    over: dict[str, Any] = {"vertical": search.chosen.damping_weight, "across": "largest damping weight ζ"}
    panels = (
        Panel(
            "smallest damping ratio",
            "",
            [
                *lines(lambda c: c.behaviour.damping, "worst of the tolerances", SERIES[1]),
                *lines(lambda c: c.behaviour.nominal_damping, "nominal robot", SERIES[0]),
            ],
            dashed=((target.damping, INK, "target"),),
            y=(0.0, None),
            **over,
        ),
        Panel("γ*", "", lines(lambda c: c.gamma_star, "γ*", SERIES[0]), **over),
    )
    yield from (
        lambda: draw_figure(
            "search",
            panels,
            "Candidates at the required bandwidth. The dotted line is the ζ that is used."
            + " Squares: those in use, which the search on the running loop found, with a bandwidth of "
            f"{range_text(search.chosen.behaviour.bandwidth)} rad/s." * replaced,
            "Search for the weights",
            3.2,
            columns=3,
        ),
        candidate_table(search, replaced),
    )


def candidate_table(search: SearchResult, replaced: bool = False) -> Table:
    """Table of some candidates by ζ: the first, the last, the one in use, and its neighbours."""
    candidates = sorted(search.candidates, key=lambda c: c.damping_weight)
    used, last = next(k for k, c in enumerate(candidates) if c is search.chosen), len(candidates) - 1
    rows = [
        (
            c.damping_weight,
            range_text(c.target_frequency),
            range_text(c.behaviour.bandwidth),
            finite(c.behaviour.damping),
            finite(c.behaviour.nominal_damping),
            c.gamma_star,
            ("used, of the running loop" if replaced else "used") if c is search.chosen else "",
        )
        for c in (candidates[k] for k in sorted({0, max(0, used - 1), used, min(last, used + 1), last}))
    ]
    count = f"{len(rows)} of {count_text(len(candidates), 'candidate')}"
    return Table(
        (
            Column("largest damping weight ζ", "", 3, brief="weight ζ"),
            Column("target frequency ω", "rad/s", brief="target ω, rad/s"),
            Column("bandwidth", "rad/s"),
            Column("damping, worst robot", "", 3, brief="damping: worst"),
            Column("damping, nominal robot", "", 3, brief="nominal"),
            "γ*",
            "",
        ),
        rows,
        f"{count}, by ζ; design.json has all",
        "table-tries",
        title=f"Search for the weights: {count}",
    )


# The tolerances -----------------------------------------------------------------------------------------
def whole_loop(design: PoseEvidence) -> Blocks:
    """Search of the preset robust on the running loop, and its result; nothing with other presets."""
    search = design.synthesis.robust
    if search is None:
        return
    result = "None was better, so the design is that of the preset damped."
    if search.better:
        unstable = f"First unstable: {search.corner}." if search.corner else "No corner became unstable."
        result = (
            f"Of those of damped the target frequencies were multiplied by {number(search.frequency, 3)}, ζ by "
            f"{number(search.damping, 3)}, the noise levels of the links by {number(search.links, 3)} and of the "
            f"motors by {number(search.motors, 3)}. {unstable}"
        )
    yield Paragraph(
        f"From the preset damped, {count_text(search.count, 'loop')} with other weights, noise levels and channels of "
        "the tolerances were tried for the largest factor of all tolerances up to which no corner is unstable, with no "
        f"more overshoot at the corners, the same limits, and at most {NOISE:g} times the noise at each motor. {result}"
    )
    volts = design.setup.model.unit(design.setup.model.inputs[0])
    yield Table(
        ("running loop", "preset damped", "preset robust", "unit"),
        [
            (what, number(damped, 3), number(robust, 3), volts if unit == "input" else unit)
            for what, unit, damped, robust in whole_loop_rows(search)
        ],
        "What the search for the tolerances gained and cost",
        "table-whole-loop",
    )


def whole_loop_rows(search: WholeLoopSearch) -> list[tuple[str, str, float, float]]:
    """Rows of the search on the running loop: quantity, unit or "input", value with the preset damped, and found."""
    d, r = search.damped, search.chosen
    return [
        ("factor of all tolerances at which a corner is unstable", "", d.scale, r.scale),
        ("largest overshoot of the corners that stepped", "%", d.overshoot, r.overshoot),
        ("noise at the loudest motor, rms", "input", float(d.noises.max()), float(r.noises.max())),
        ("peak sensitivity", "", d.margins.peak_sensitivity, r.margins.peak_sensitivity),
        ("gain margin", "", d.margins.gain_margin, r.margins.gain_margin),
        ("smallest damping ratio", "", d.margins.damping, r.margins.damping),
    ]


def robust_table(r: ToleranceFraction) -> Table:
    """Table of γ* and of the attained level, without and with the tolerance channels."""
    return Table(
        (
            "",
            Column("without tolerances", brief="without"),
            Column("with tolerances", brief="with"),
            Column("cost", "%", 1),
        ),
        [
            (what, plain, robust, 100.0 * (robust / plain - 1.0))
            for what, plain, robust in (
                ("γ* of the problem", r.nominal_gamma_star, r.gamma_star),
                ("level that the nominal robot attains", r.nominal_gain, r.robust_gain),
            )
        ],
        "What covering the tolerances costs (linear part)",
        "table-robust",
        title=f"Cost of the tolerances: {r.channels} channels, {100.0 * r.fraction:.3g} % of them covered",
    )


def _robust_text(r: ToleranceFraction) -> str:
    which = f"{'all' if r.all_corners else 'the sampled'} {r.corners} corners"
    larger = f" with the tolerances of the channels enlarged by {number(100.0 * (r.enlarged - 1.0), 2)} %"
    products = (
        f"{larger if r.enlarged > 1.0 else ''} the inequality of the linear part holds at {which} of the "
        "tolerances that act at the goal."
    )
    if r.failing_corners:
        products = (
            f" the inequality of the linear part fails at {r.failing_corners} of {which} of the tolerances that act at "
            "the goal, so it holds for each tolerance alone, and not for all of them together."
        )
    tolerances, beyond = "the whole of the stated tolerances", ""
    if r.fraction < 1.0:
        tolerances = f"{number(100.0 * r.fraction, 3)} % of them, as was best for the running loop"
        beyond = ", and nothing follows from them for robots beyond that fraction"
    scalings = (f"{group.replace('_', ' ')} {range_text(ends)}" for group, ends in sorted(r.scalings.items()))
    return (
        f"{r.channels} channels stand for the tolerances, and the problem has a solution for {tolerances}{beyond}. The "
        "channels are linear in each tolerance: the level holds on the linear part, with the true state fed back, "
        "for robots that such channels describe. Products of tolerances change a robot by more than its channels:"
        f"{products} Scalings s of the channels, each "
        f"seen s times and acting 1/s times as strongly: {', '.join(scalings)}."
    )


# The weights themselves ---------------------------------------------------------------------------------
def state_weights(problem: GeneralisedPlant, joints: Sequence[str]) -> list[tuple[str, float, str]]:
    """Weights of states, integrals, spring torques and their rates: signal, value, and the unit that makes the product
    dimensionless; empty for a penalty that is the user's code."""
    states, coded = problem.penalty.states, callable(problem.penalty.states)
    values = getattr(states, "states", None) if coded else problem.penalty.weights(problem.state_names)
    named = [] if values is None else list(zip(problem.state_names, np.asarray(values, dtype=float)))
    for group, attribute in (("joint_torque", "torques"), ("joint_torque_rate", "rates")):
        named += zip(signal_names(group, joints), getattr(states, attribute, ()) if coded else ())

    def inverse(unit: str) -> str:
        return f"1/({unit})" if "·" in unit or "/" in unit else f"1/{unit}" if unit else ""

    return [(name, float(value), inverse(problem.plant.unit(name))) for name, value in named if value]


def effort_unit(problem: GeneralisedPlant) -> str:
    """Unit of R2 with a dimensionless z."""
    return " or ".join(dict.fromkeys(problem.plant.weight_units(problem.input_names)))


# Noise levels of the estimator --------------------------------------------------------------------------
def noise_levels(design: PoseEvidence) -> Blocks:
    """Noise levels of the estimator, and their trade-off as figure and table; nothing without an estimator."""
    if design.specification.estimator == "none":
        return
    noise, search = design.setup.process_noise, design.synthesis.noise_search
    joints = design.robot.joint_names
    levels = {
        "every state": noise.all_states,
        "link velocities": noise.link_velocities,
        "motor velocities": noise.motor_velocities,
    }
    used = [f"{range_text(np.ravel(v), 2)} on {where}" for where, v in levels.items() if np.any(v)]
    robust = design.synthesis.robust is not None and design.synthesis.robust.better
    yield Paragraph(
        f"Rᵛ, the variance of the process noise per sample that the estimator assumes: {', '.join(used) or '0'} "
        f"({noise.source}). Rⁿ of the measurements: {range_text(design.setup.noise_variances, 2)}. A "
        "vibration that the estimator takes for undisturbed rings in its error, so a larger Rᵛ damps the running loop, "
        f"and gives it margins back; it costs noise at the motors.{_outcome(search, robust) if search else ''}"
    )
    if search is None:
        return
    yield from (lambda: _noise_figure(design, search), _noise_table(design, search))
    if "damping" in search.chosen.missed and all(n.startswith("motor") for n in design.setup.model.outputs):
        setup = design.setup
        scales = JointScales.of(setup.model, setup.goal_equilibrium)
        part = scales.link_inertia / (scales.link_inertia + scales.motor_inertia)
        worst = int(np.argmin(part))
        zero = np.sqrt(scales.stiffness[worst] / scales.link_inertia[worst]) / (2.0 * np.pi)
        yield Paragraph(
            "Only the motors are measured. Of a vibration their positions show the part M/(M + J) of the twist, "
            f"{part[worst]:.2g} in joint {setup.joints[worst]}, and nothing where the link swings while the motor "
            f"stands still ({zero:.3g} Hz there): near that zero the error of any estimator stays undamped unless "
            "noise is amplified. More damping takes a sensor of the link or of the joint's torque, or a less noisy one."
        )
    if len(joints) > 1:
        by_joint = (search.chosen.levels.link_velocities, search.chosen.levels.motor_velocities)
        yield Table(
            (
                "joint",
                Column("Rᵛ, link velocity", digits=2),
                Column("Rᵛ, motor velocity", digits=2),
                Column("noise at the motor (rms)", design.setup.model.unit(design.setup.model.inputs[0])),
            ),
            list(zip(joints, *np.broadcast_arrays(*by_joint, search.chosen.noises), strict=True)),
            "The levels that are used, joint by joint",
            "table-noise-levels",
        )


def _outcome(search: NoiseSearch, robust: bool) -> str:
    if robust:
        return (
            " They were found together with the weights, for the tolerances: see there. The curve is of the same "
            "law."
        )
    chosen, beyond = search.chosen, ""
    if search.unreachable:
        beyond = f" No levels reach the limit of the {' and the '.join(search.unreachable)}, which counts only in part."
    kept = (
        f"every {'other ' if beyond else ''}limit of the running loop (peak sensitivity, gain margin, damping, load "
        f"compliance, and noise of at most {100.0 * MOST_NOISE:g} % of what a motor gives)"
    )
    if search.default is not None and is_used(search, search.default):
        return f"{beyond} The default levels keep {kept}."
    if chosen.feasible:
        return f"{beyond} The search took the levels with the least noise that keep {kept}."
    missed = [f"{limit} by {100.0 * np.expm1(value):.0f} %" for limit, value in chosen.avoidable.items()]
    parts = [
        *([f"missed: {', '.join(missed)}"] if missed else []),
        *([f"{chosen.unstable} corners of the tolerances are unstable"] if chosen.unstable else []),
    ]
    return f"{beyond} No levels were found that keep {kept}: used are those that miss them least ({'; '.join(parts)})."


def is_used(search: NoiseSearch, candidate: NoiseCandidate) -> bool:
    """Whether a candidate is the one whose noise levels the design uses."""
    return candidate.levels is search.chosen.levels


def _noise_figure(design: PoseEvidence, search: NoiseSearch) -> Figure:
    unit, target = design.setup.model.unit(design.setup.model.inputs[0]), design.design_problem.target
    marks, used = [("s", 7.0, search.chosen)], "squares: used (the default levels)"
    if search.default is not None and not is_used(search, search.default):
        marks.append(("D", 5.0, search.default))
        used = "squares: used, diamonds: the default levels"
    required = [] if target is None else [(required_damping(design.specification.damping, target), INK, None)]
    panels: list[Panel] = []
    for name, text, dashed in (
        ("damping", "smallest damping ratio", required),
        ("compliance", "compliance / true state", ()),
    ):
        lines: list[Line] = []
        for joint, joint_name in enumerate(design.robot.joint_names):
            own: LineStyle = {"color": line_style(joint)["color"], "linestyle": "none"}
            dots: LineStyle = {**own, "marker": "o", "markersize": 3.0}
            groups: list[tuple[str | None, Sequence[NoiseCandidate], LineStyle]] = [
                (joint_name, search.trade_off, dots),
                *(
                    (None, [c], {**own, "marker": m, "markersize": size, "markerfacecolor": "none"})
                    for m, size, c in marks
                ),
            ]
            for legend_name, candidates, style in groups:
                noise, value = np.array([(c.noises[joint], getattr(c, name)) for c in candidates]).T
                lines.append(Line(noise, value, legend_name, style))
        across = f"noise at the motor, rms ({unit})"
        panels.append(Panel(text, "", lines, dashed=dashed, across=across, y=(0.0, None), log=True))
    return draw_figure(
        "noise-trade-off",
        panels,
        f"Of {search.count} choices of Rᵛ with a stable loop, dots are those that no other one betters in noise, "
        f"damping and compliance at once, one dot for each motor; {used}. A choice to the left of the squares breaks "
        "another limit (see the table), or yields more to a "
        f"load.{'' if target is None else ' Dashed: the damping that is required.'}",
        "Noise at the motors against damping and load stiffness",
        3.2,
        columns=7,
    )


def _noise_table(design: PoseEvidence, search: NoiseSearch) -> Table:
    unit = design.setup.model.unit(design.setup.model.inputs[0])

    def metrics(c: NoiseCandidate) -> tuple[float, ...]:
        return c.input_noise, c.damping, c.compliance, c.peak_sensitivity, c.gain_margin

    apart = [(search.chosen, "used")]
    if search.default is not None and not is_used(search, search.default):
        apart.append((search.default, "default"))
    # The edge of the family where a level is at its least may be the default by another name.
    others = [
        (search.trade_off[k], "")
        for k in map(int, np.unique(np.linspace(0, len(search.trade_off) - 1, ROWS).round().astype(int)))
        if not any(np.allclose(metrics(search.trade_off[k]), metrics(c), rtol=1e-3) for c, _ in apart)
    ]
    rows: list[Sequence[object]] = []
    for candidate, note in sorted([*others, *apart], key=lambda each: each[0].input_noise):
        missed = f"{'missed: ' if note and candidate.missed else ''}{', '.join(candidate.missed)}"
        *sizes, gain = metrics(candidate)
        rows.append((*sizes, finite(gain), "; ".join(filter(None, (note, missed)))))
    return Table(
        (
            Column("noise at the noisiest motor (rms)", unit, digits=3, brief=f"noise, {unit}"),
            Column("smallest damping ratio", "", 3, brief="damping"),
            Column("compliance / true state", "", 2, brief="compliance"),
            Column("peak sensitivity", "", 2, brief="|S|"),
            Column("gain margin", "", 2, brief="gain"),
            Column("limits missed, or used", brief="missed"),
        ),
        rows,
        f"{len(rows)} of {search.count} choices of Rᵛ: the default, the one used, and some of the dots",
        "table-noise-search",
        True,
        f"Noise levels of the estimator: {len(rows)} of {count_text(search.count, 'candidate')}",
    )
