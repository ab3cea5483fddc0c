"""The page of a certificate: the theorem with its hypotheses, region, steps inside, budget, gain from both sides."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np

from flexhinf.certify import Certificate
from flexhinf.certify.pictures import Slice
from flexhinf.certify.theorem import AUTHOR, common_unit, persistent_bound, theorem_parts
from flexhinf.design.certification import CertifiedDegree, Evidence
from flexhinf.design.specification import Specification
from flexhinf.pages.design.region import RULES
from flexhinf.pages.drawing import DASHED, figure_block, law_name, reference_line, thin
from flexhinf.report import (
    INK,
    MUTED,
    SERIES,
    Bullets,
    Column,
    KeyNumber,
    Listing,
    Note,
    Page,
    Paragraph,
    Provenance,
    Section,
    Setting,
    Settings,
    Status,
    Table,
    at_least,
    at_most,
    house_style,
    label,
    legend,
    new_figure,
    number,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas


#: A run is drawn until |x1| has stayed below this share of the step, and half as long again.
SETTLED, LONGER = 0.01, 1.5

#: What ends a sampled level, in short.
_LIMITS = {"inequality": "r = 0", "V stops increasing": "V grows no more"}

#: Signs of a page instead of those of a terminal.
SIGNS = (
    ("<=", "≤"), ("dV/dt", "V̇"), ("gamma^2", "γ²"), ("gamma_e^2", "γₑ²"), ("gamma_e", "γₑ"), ("gamma", "γ"),
    ("R2^(1/2)", "√R2"), ("1/2 ", "½ "), ("^2", "²"), ("v'R2", "vᵀR2"), ("-R2^-1 g2'V_x'", "−R2⁻¹g2ᵀVₓᵀ"),
    ("e0'X e0", "e₀ᵀXe₀"), ("e0", "e₀"), (" - ", " − "), ("≤ -", "≤ −"), ("(-", "(−"),
    (", -", ", −"), ("pi", "π"), ("*", "·"), ("_", " "),
)  # fmt: skip

_FORMULA = re.compile(r"\w+ = ")  # R2, an input's law, V


def certificate_page(
    found: Sequence[CertifiedDegree],
    one: CertifiedDegree,
    shown: Evidence,
    s: Specification,
    command: Sequence[str],
) -> Page:
    """Everything on one page: all degrees, the one whose certificate is shown, and the command that makes it again."""
    given = shown.certificate
    with house_style():  # once for all figures
        sections = [
            *_theorem(given),
            Section("Where steps may start", _starts(one, shown), "starts"),
            *([] if one.box else [Section("Where the level ends", _limit(shown), "limit")]),
            Section("Steps inside the region", _steps(one, shown), "steps"),
            Section("What disturbances may cost", _budget(shown), "budget"),
            Section("The gain from both sides", _gain(shown), "gain"),
            Section("The law of each degree", [*_degree_notes(found), _degree_table(found)], "degrees"),
            Section("How to check it", CHECK, "check"),
        ]
    who = "all robots of the stated box of parameters" if _is_box(given) else "the nominal robot"
    channels = ", ".join(d.name.replace("_", " ") for d in given.disturbances)
    fed = "the true state or the observer's estimates" if given.observer else "the true state"
    reach = (
        f", and steps of up to {_steps_text(given)} stay in the region."
        if given.starts
        else " in the region."
    )
    settings = [
        Setting("degree of V", given.degree), Setting("feedback", given.feedback),
        Setting("decay α", given.decay, "1/s"), Setting("reach in z", given.reach),
        *(
            Setting(
                p.name.replace("_", " "),
                p.low if p.low == p.high else f"{number(p.low, 6)} to {number(p.high, 6)}", p.unit,
            )
            for p in given.parameters
        ),
        *(Setting(name, value) for name, value in given.provenance.items()),
    ]  # fmt: skip
    beyond = ", beyond the budget" if given.is_gradient_law else ""
    return Page(
        f"Certificate: {given.about.split(',')[0]}",
        f"{given.about}. For {who}, fed {fed} in continuous time; disturbances: {channels}.",
        f"Proved: the gain is at most γ = {at_most(given.gamma)}{reach}", sections,
        Settings({"Certificate": settings}), Provenance(tuple(command), s.seed), _numbers(one, given),
        [Status("proved", "By arithmetic that cannot round the wrong way."),
         Status("not proved", f"Estimator, sampling, hold, delay, limits and noise{beyond}.")],
    )  # fmt: skip


# Numbers --------------------------------------------------------------------------------------------------
def _is_box(given: Certificate) -> bool:
    return any(p.low < p.high for p in given.parameters)


def _position(given: Certificate) -> tuple[float, str]:
    """Scale and unit in which positions are drawn: degrees of a joint that turns."""
    unit = given.states[0].unit
    return (180.0 / np.pi, "°") if unit == "rad" else (1.0, unit)


def _angle(given: Certificate, value: float) -> str:
    unit = given.states[0].unit
    return (
        f"{at_least(float(np.degrees(value)), decimals=1)}°"
        if unit == "rad"
        else f"{at_least(value, 3)} {unit}"
    )


def _rule(rule: str) -> str:
    return RULES.get(rule, rule)


def _steps_text(given: Certificate) -> str:
    return " or ".join(f"{_angle(given, s.amplitude)} ({_rule(s.rule)})" for s in given.starts)


def _peak(unit: str) -> str:
    return "peak voltage" if unit == "V" else "peak input"


def _numbers(one: CertifiedDegree, given: Certificate) -> list[KeyNumber]:
    effort, gain, sampled = given.inputs[0].unit, given.attained_gain, given.sampled_level
    attained = "" if gain is None else f"attained by a disturbance: {at_least(gain)}"
    share = "" if sampled is None else f"{100 * given.level / sampled:.1f} % of the sampled one"
    return [
        *(KeyNumber("largest proved step", _angle(given, s.amplitude), "", _rule(s.rule)) for s in given.starts),
        KeyNumber("gain, proved", f"≤ {at_most(given.gamma)}", "", attained),
        KeyNumber("level of V", at_least(given.level), "", share),
        *(
            KeyNumber(
                f"{_peak(effort)}, simulated", number(float(step.peak_input.max()), 3), effort,
                f"nominal robot, {_rule(step.rule)}; not proved",
            )
            for step in one.steps
        ),
    ]  # fmt: skip


# Theorem --------------------------------------------------------------------------------------------------
def _theorem(given: Certificate) -> list[Section]:
    """Its parts, but for what it is about, which stands at the top."""
    parts = dict(theorem_parts(given, given.stated))
    parts["Proved"] = [f"S is {text}" for text in parts.pop("Region S")] + parts["Proved"]
    sections = []
    for title, lines in parts.items():
        blocks: list[Any] = [Bullets(tuple(map(_set, lines)))]
        if title == "Proved":  # with numbers of its own, by which the rest names it
            blocks = [Paragraph(_set(line)) for line in lines]
        if (
            title == "Hypotheses"
        ):  # equations in a table, R2, the law and V as they can be copied, then the rest
            rates = [line.removeprefix("d/dt ").split(" = ", 1) for line in lines if line.startswith("d/dt ")]
            rest = [line for line in lines if not line.startswith("d/dt ")]
            formulas = [line for line in rest if _FORMULA.match(line)]
            others = [_set(line) for line in rest if not _FORMULA.match(line)]
            rows = [(_set(name), _set(f"−{rate[1:]}" if rate[0] == "-" else rate)) for name, rate in rates]
            blocks = [
                Paragraph(others[0]), Table(("state", "its rate"), rows, "", "table-plant", stacks=True),
                Bullets(tuple(others[1:])),
                *(Listing("\n".join(wrap(line, 110, subsequent_indent="  "))) for line in formulas),
            ]  # fmt: skip
        sections.append(
            Section(title, blocks, "author" if title == AUTHOR else title.lower().replace(" ", "-"))
        )
    return sections


def _set(text: str) -> str:
    """A sentence of the theorem with the signs of a page."""
    for plain, sign in SIGNS:
        text = text.replace(plain, sign)
    return text


# Slices of the region -------------------------------------------------------------------------------------
def _starts(one: CertifiedDegree, shown: Evidence) -> list[Any]:
    """The largest proved steps, and the slice of the region where they start."""
    given, surface, (scale, unit) = shown.certificate, shown.surface, _position(shown.certificate)
    if not one.steps:
        return [Paragraph("No steps from rest to rest are stated.")]
    text = "A step from rest starts at another equilibrium, "
    if surface is None:
        return [
            Paragraph(f"{text}of each robot its own, without a jump of the input."),
            _steps_table(one, given),
        ]
    figure, axis = _slice(given, surface, scale)
    for path, start, colour in zip(surface.paths, given.starts, SERIES[2:]):
        axis.plot(scale * path[:, 0], path[:, 1], color=colour, label=f"starts: {_rule(start.rule)}")
        axis.plot(scale * path[-1, 0], path[-1, 1], "o", color=colour, markersize=5)
    axis.set_xlabel(f"step to the goal ({unit})")
    label(axis, "integral of the error", next(x.unit for x in given.states if x.name.endswith("_integral")))
    legend(axis)
    caption = "Equilibria at a distance from the goal (+), with each value of the integrator."
    return [
        Paragraph(
            f"{text}with an integrator that the controller chooses. Where V is smallest the region reaches furthest, "
            "and the input jumps."
        ),
        figure_block("starts", figure, [caption, *_slice_text(given, surface)], "Starts of steps"),
        _steps_table(one, given),
    ]


def _limit(shown: Evidence) -> list[Any]:
    """The plane in which the sampled level ends."""
    given, plane, sampled = shown.certificate, shown.limit, shown.certificate.sampled_level
    if plane is None:
        return [Paragraph("Sampling finds no point that limits the level.")]
    figure, axis = _slice(given, plane, 1.0)
    axis.plot(0.0, 1.0, "D", color=INK, markersize=5, label=f"limits the level: {_LIMITS[plane.limit]}")
    if plane.moved is None:
        other = "the largest proved start"
        axis.plot(1.0, 0.0, "o", color=SERIES[2], markersize=5, label=other)
        axis.set_xlabel(f"share of {other}")
    else:
        state = given.states[plane.moved]
        other = f"the {state.name.replace('_', ' ')} with the other states where V₂ is smallest"
        axis.set_xlabel(f"{state.name.replace('_', ' ')} ({state.unit})")
    label(axis, "share of the limiting point", "")
    legend(axis)
    share = "" if sampled is None else f", {number(100.0 * given.level / sampled, 4)} % of the sampled level"
    where = ", ".join(
        f"{s.name.replace('_', ' ')} {number(float(v), 3)} {s.unit}".rstrip()
        for s, v in zip(given.states, plane.point, strict=True)
    )
    caption = f"The plane through the goal (+), {other}, and the point where the sampled level ends: deviation {where}."
    return [
        Paragraph(
            f"The proof covers all points of V ≤ c = {at_least(given.level, 5)}{share}; sampling looks for points at "
            "which the inequality fails, and so says how large a level can be at most."
        ),
        figure_block("limit", figure, [caption, *_slice_text(given, plane)], "Where the level ends"),
    ]


def _slice(given: Certificate, one: Slice, scale: float) -> tuple[Canvas, Axes]:
    """r/V in bands, the proved level's line and the sampled one's, the goal, and the worst point inside."""
    figure, (axis,) = new_figure(1, height=5.0)
    inside = one.rate[(one.value <= given.level) & (one.rate < 0.0)]
    fast = float(np.quantile(inside, 0.15)) if inside.size else -1.0
    edges = [
        float(f"{share * fast:.1g}") for share in (1.0, 0.5, 0.2)
    ]  # round, from the fastest to the slowest
    across = scale * one.across
    rate = np.where(one.value < 0.0, np.inf, np.nan_to_num(one.rate, nan=edges[-1]))  # V = 0: the goal
    areas = [  # values, limits, colour, depth and name of what is filled
        (rate, [low, high], SERIES[0], depth, f"r/V < {number(high, 2)}/s" if high else "r < 0")
        for (low, high), depth in zip(
            pairwise([-np.inf, *edges, 0.0]), np.linspace(0.62, 0.12, len(edges) + 1)
        )
    ]
    if (rate > 0.0).any():
        areas.append((np.minimum(rate, 1e300), [0.0, np.inf], SERIES[1], 0.4, "r ≥ 0"))
    for values, levels, colour, depth, name in areas:
        axis.contourf(across, one.up, values, levels=levels, colors=[colour], alpha=depth)
        axis.fill_between([], [], [], color=colour, alpha=depth, linewidth=0, label=name)
    axis.contour(across, one.up, one.value, levels=[given.level], colors=[INK], linewidths=1.8)
    axis.plot([], [], color=INK, linewidth=1.8, label="proved: V ≤ c")
    if given.sampled_level is not None:
        dashed = {"colors": [SERIES[1]], "linewidths": 1.2, "linestyles": [(0, (3.0, 3.0))]}
        axis.contour(across, one.up, one.value, levels=[given.sampled_level], **dashed)
        axis.plot([], [], color=SERIES[1], linewidth=1.2, dashes=(3.0, 3.0), label="sampled level")
    a, b, _ = one.worst(given.level)
    axis.plot(scale * a, b, "x", color=INK, markersize=8, markeredgewidth=1.8, label="worst point here")
    axis.plot(0.0, 0.0, "+", color=INK, markersize=9)
    axis.grid(False)
    return figure, axis


def _slice_text(given: Certificate, one: Slice) -> list[str]:
    """What a slice shows of r."""
    worst, decays = one.worst(given.level)[2], " with the proved decay in r" if given.decay else ""
    text = f"Colours: r/V{decays}, the rate at which V falls beyond what the gain asks for; "
    inside = f"r is negative wherever V ≤ c, least so at the cross, {number(worst, 2)}/s."
    uncovered = "" if (one.residual <= 0.0).all() else "Where r ≥ 0 nothing is proved."
    return [text + (inside if worst < 0.0 else "see the cross."), uncovered]


# Steps ----------------------------------------------------------------------------------------------------
def _steps(one: CertifiedDegree, shown: Evidence) -> list[Any]:
    """The largest proved steps without disturbance, and smaller ones with the worst; none where none is stated."""
    given, solution, blocks = shown.certificate, one.choice.solution, list[Any]()
    value = solution.value if one.box is None else one.box.value
    scale, unit = _position(given)
    kinds: tuple[Any, ...] = (one.steps, shown.worst)
    for runs in kinds if one.steps else ():
        if not runs:
            continue
        figure, axes = new_figure(3, height=6.4)
        ends = []  # how long the runs are drawn
        for run, colour in zip(runs, SERIES[2:]):
            few = thin(run.time)
            time, state = run.time[few], run.state[few]
            axes[0].plot(time, scale * state[:, 0], color=colour, label=f"starts: {_rule(run.rule)}")
            if runs is one.steps:
                axes[1].plot(time, (solution.operating_input + solution.inputs(state))[:, 0], color=colour)
                axes[2].plot(time, value(state) / given.level, color=colour)
            else:
                bound = (run.value[0] + run.spent[few]) / given.level
                axes[1].plot(time, np.linalg.norm(run.disturbance[few], axis=1), color=colour)
                axes[2].plot(time, run.value[few] / given.level, color=colour)
                axes[2].plot(time, bound, color=MUTED, linewidth=1.0, dashes=(2.0, 1.5))
            moving = np.flatnonzero(np.abs(run.state[:, 0]) > SETTLED * np.abs(run.state[0, 0]))
            ends.append(float(min(run.time[-1], LONGER * run.time[moving[-1]] if moving.size else np.inf)))
        axes[0].set_xlim(0.0, max(ends))
        axes[2].axhline(1.0, color=SERIES[0], dashes=DASHED, linewidth=1.2)
        reference_line(axes[0])
        label(axes[0], "position − goal", unit)
        label(axes[2], "V / c", "")
        legend(axes[0])
        name, title, quantity, caption = (
            ("largest", "Largest steps", ("input", given.inputs[0].unit),
             "The largest proved step for each start of the integrator, without disturbance.")
            if runs is one.steps else
            ("worst", "Worst disturbance", ("|d|", common_unit(given.disturbances)),
             "Steps of 0.8 of the largest ones with the disturbance that V says is worst, d = g1ᵀV_xᵀ/γ², as long as "
             "the budget lasts. Thin lines: V(x0) + ½γ²∫|d|², which V stays below.")
        )  # fmt: skip
        label(axes[1], *quantity)
        blocks.append(figure_block(name, figure, caption, title))
    return blocks


# Budget and gain ------------------------------------------------------------------------------------------
def _budget(shown: Evidence) -> list[Any]:
    given, square = shown.certificate, _energy_unit(shown.certificate).strip()
    also = "; an input that differs by v from the law takes ½∫vᵀR2v from the same budget."
    rows = []
    for run in shown.worst:
        start, left = float(run.value[0]), given.level - float(run.value[0])
        rows.append((
            _rule(run.rule), _angle(given, run.amplitude), at_most(100.0 * start / given.level, 3),
            at_least(100.0 * left / given.level, 3), at_least(2.0 * left / given.gamma**2, 3),
        ))  # fmt: skip
    columns = (
        "start of the integrator", "step", Column("V(x0)", "% of c"), Column("left for disturbances", "% of c"),
        Column("energy ∫|d|² allowed", square),
    )  # fmt: skip
    energy = f"{at_least(2.0 * given.level / given.gamma**2, 3)} {square}".rstrip()
    last = (
        "Nothing is proved for disturbances that last for ever: no decay rate was asked for (`--decay 0.2`)."
        if not given.decay else
        f"Disturbances that last: with the proved rate α = {number(given.decay, 3)}/s the region is invariant for "
        f"|d(t)| ≤ √(2αc)/γ = {at_least(persistent_bound(given), 3)} {common_unit(given.disturbances)} at all times."
    )  # fmt: skip
    table = Table(columns, rows, "Steps of 0.8 of the largest ones", "table-budget", stacks=True)
    return [
        Paragraph(
            "From a start x0 inside, the region holds as long as V(x0) + ½γ²∫|d|² ≤ c. What is left of the level is "
            f"the energy ∫|d|² that disturbances may have{also if given.is_gradient_law else '.'}"
        ),
        *([table] if rows else []),
        Paragraph(f"From rest at the goal, disturbances may have an energy of {energy} in all. {last}"),
    ]


def _energy_unit(given: Certificate) -> str:
    """Of ∫|d|², behind a number."""
    unit = common_unit(given.disturbances)
    return f" {unit}²·s" if unit.isalpha() else f" ({unit})²·s" if unit else ""


def _gain(shown: Evidence) -> list[Any]:
    given, attained = shown.certificate, shown.attained
    if attained is None:
        return [Paragraph("No disturbance was searched for, so the gain is bounded from above only.")]
    nominal, where = " on the nominal robot", ""
    if not _is_box(given):
        share = number(100.0 * attained.largest_value / given.level, 3)
        nominal, where = "", f" and V up to {share} % of the level"
    line, (axis,) = new_figure(1, height=1.5)
    name = f"attained: {at_least(attained.gain)}"
    axis.barh(0.0, attained.gain, height=0.5, color=SERIES[2], alpha=0.55, label=name)
    between = {"left": attained.gain, "height": 0.5, "color": MUTED, "alpha": 0.35}
    axis.barh(0.0, given.gamma - attained.gain, **between, label="the largest lies here")
    axis.axvline(given.gamma, color=SERIES[0], linewidth=2.4, label=f"proved: γ = {at_most(given.gamma)}")
    axis.set(yticks=[], xlim=(0.0, 1.08 * given.gamma), xlabel="√(∫|z|²/∫|d|²)")
    legend(axis)
    figure, axes = new_figure(2, height=4.6)
    few = thin(attained.times)
    for column, signal, colour in zip(attained.disturbance.T, given.disturbances, SERIES):
        axes[0].plot(attained.times[few], column[few], color=colour, label=signal.name.replace("_", " "))
    (scale, unit), run = _position(given), attained.trajectory
    moved = run.signals["state"][:, 0] - run.signals["state"][0, 0]
    axes[1].plot(run.time[thin(run.time)], scale * moved[thin(run.time)], color=SERIES[2])
    label(axes[0], "d", common_unit(given.disturbances))
    label(axes[1], "position − goal", unit)
    legend(axes[0])
    return [
        Paragraph(
            f"√(∫|z|²/∫|d|²) is proved to be at most γ = {at_most(given.gamma, 5)}. A disturbance found by search "
            f"attains {number(attained.gain, 5)}{nominal}, {number(100.0 * attained.gain / given.gamma, 3)} % of it, "
            f"with an energy of {number(attained.energy, 3)}{_energy_unit(given)}{where}. The largest gain of motions "
            "in the region lies between."
        ),
        figure_block(
            "gain",
            line,
            "A disturbance was found that attains the lower end; none exceeds the upper one.",
            "Gain",
        ),
        figure_block(
            "attained",
            figure,
            "The disturbance found, from rest at the goal, and the position.",
            "Attained gain",
        ),
    ]


# Degrees and check ----------------------------------------------------------------------------------------
def _degree_table(found: Sequence[CertifiedDegree]) -> Table:
    """What is proved of the law of each degree."""
    rows = []
    for one in found:
        given, name = one.certificate, law_name(one.choice.degree) + (" *" if one.used else "")
        proved: tuple[Any, ...] = (None, None, None, None)
        if given is not None:
            sampled = given.sampled_level
            proved = (
                at_least(given.level), None if sampled is None else f"{100.0 * given.level / sampled:.1f}",
                _steps_text(given) if given.starts else None, given.provenance.get("cells"),
            )  # fmt: skip
        remark = one.reason if given is None else "used" if one.used else ""
        rows.append((name, *proved, one.cpu_seconds, remark))
    columns = (
        "law", Column("proved level of V", brief="level of V", right=True), Column("of the sampled", "%", right=True),
        "largest steps", Column("cells", right=True), Column("CPU", "s", 1), Column("remark", brief=None),
    )  # fmt: skip
    whom = "all parameters within the tolerances" if any(one.box for one in found) else "nominal parameters"
    title = f"What is proved, with the true state fed back and {whom} (* used)"
    return Table(columns, rows, "", "table-degrees", stacks=True, title=title)


def _steps_table(one: CertifiedDegree, given: Certificate) -> Table:
    """Runs from the largest proved starts."""
    effort = given.inputs[0].unit
    inputs = [
        [", ".join(number(float(v), 3) for v in u) for u in (run.first_input, run.peak_input)]
        for run in one.steps
    ]
    rows = [
        (_rule(run.rule), _angle(given, run.amplitude), run.overshoot_percent, *texts)
        for run, texts in zip(one.steps, inputs)
    ]
    columns = (
        Column("start of the integrator", brief="integrators start"),
        Column("largest proved step", brief="step", right=True), Column("overshoot", "%", 1),
        Column("first input", effort, right=True), Column(_peak(effort), effort, right=True),
    )  # fmt: skip
    caption = "Simulated, not proved: the nominal robot, undisturbed"
    title = f"{law_name(one.choice.degree)}: simulated, not proved: the nominal robot from the largest proved starts"
    return Table(columns, rows, caption, "table-steps", stacks=True, title=title)


def certification_tables(found: Sequence[CertifiedDegree]) -> list[Any]:
    """For a terminal: what is proved of the law of each degree, and the runs from the largest proved steps."""
    steps = (_steps_table(one, one.certificate) for one in found if one.steps and one.certificate)
    return [table.terminal() for table in (_degree_table(found), *steps)]


def certification_notes(found: Sequence[CertifiedDegree]) -> list[str]:
    """Of which laws nothing is proved, and why."""
    return [f"{law_name(one.choice.degree)}: nothing is proved: {one.reason}" for one in found if one.reason]


def _degree_notes(found: Sequence[CertifiedDegree]) -> list[Note]:
    return [
        Note(f"Degree {high.choice.degree} proves a smaller step than degree {low.choice.degree}.")
        for low, high in pairwise(found)
        if low.certificate is not None
        and high.certificate is not None
        and high.certificate.step_amplitude < low.certificate.step_amplitude
    ]


CHECK = (
    Paragraph(
        "A second program, which shares no code with the search, proves the certificate's file again and says what it "
        "proved and what not:"
    ),
    Listing("flexhinf certify --check certificate.json"),
    Paragraph(
        "It trusts a bound of its own rounding in doubles, but for a random sample of cells; with `--every-cell` it "
        "proves all of them in exact rationals and balls too (minutes for V of degree 2, hours for degree 6)."
    ),
)
