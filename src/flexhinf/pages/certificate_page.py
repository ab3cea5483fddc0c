"""The page of a certificate: the theorem with its hypotheses, region, steps inside, budget, gain from both sides.

The figures of a certificate's page: slices of the region, steps with and without disturbance, the gain.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np

from flexhinf.certify import Certificate
from flexhinf.certify.pictures import LimitSlice, Slice, StartSurface, WorstStep
from flexhinf.certify.theorem import AUTHOR, common_unit, persistent_bound, theorem_parts
from flexhinf.design.certification import CertifiedDegree, Evidence
from flexhinf.design.specification import Specification
from flexhinf.pages.drawing import DASHED, figure_block, law_name, reference_line, thin
from flexhinf.pages.proof import RULES
from flexhinf.report import (
    INK,
    MUTED,
    SERIES,
    Bullets,
    Column,
    Figure,
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


def surface_figure(given: Certificate, surface: StartSurface) -> Figure:
    """The slice of the region where steps start."""
    scale = 180.0 / np.pi if given.states[0].unit == "rad" else 1.0
    unit = "°" if scale != 1.0 else given.states[0].unit
    figure, axis = _slice(given, surface, scale)
    for path, start, colour in zip(surface.paths, given.starts, SERIES[2:]):
        name = f"starts: {RULES.get(start.rule, start.rule)}"
        axis.plot(scale * path[:, 0], path[:, 1], color=colour, label=name)
        axis.plot(scale * path[-1, 0], path[-1, 1], "o", color=colour, markersize=5)
    axis.set_xlabel(f"step to the goal ({unit})")
    label(axis, "integral of the error", next(x.unit for x in given.states if x.name.endswith("_integral")))
    legend(axis)
    return figure_block(
        "starts", figure,
        ["Equilibria at a distance from the goal, with each value of the integrator: a slice of the proved region, "
         "which is the part that is connected to the goal (+).", *_said_of(given, surface)],
        "Starts of steps",
    )  # fmt: skip


def limit_figure(given: Certificate, plane: LimitSlice) -> Figure:
    """The plane in which the sampled level ends."""
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
    where = ", ".join(
        f"{s.name.replace('_', ' ')} {number(float(v), 3)} {s.unit}".rstrip()
        for s, v in zip(given.states, plane.point, strict=True)
    )
    return figure_block(
        "limit", figure,
        [f"The plane through the goal (+), {other}, and the point at which the sampled level ends: "
         f"deviation {where}. A larger level would have it inside.", *_said_of(given, plane)],
        "Where the level ends",
    )  # fmt: skip


def _slice(given: Certificate, one: Slice, scale: float) -> tuple[Canvas, Axes]:
    """r/V in bands, the proved level's line and the sampled one's, the goal, and the worst point inside."""
    figure, (axis,) = new_figure(1, height=5.0)
    across, edges = scale * one.across, _edges(one, given.level)
    rate = np.where(one.value < 0.0, np.inf, np.nan_to_num(one.rate, nan=edges[-1]))  # V = 0: the goal
    bands = list(zip([-np.inf, *edges], [*edges, 0.0]))
    for (low, high), depth in zip(bands, np.linspace(0.62, 0.12, len(bands))):
        axis.contourf(across, one.up, rate, levels=[low, high], colors=[SERIES[0]], alpha=depth)
        name = f"r/V < {number(high, 2)}/s" if high else "r < 0"
        axis.fill_between([], [], [], color=SERIES[0], alpha=depth, linewidth=0, label=name)
    if (rate > 0.0).any():
        axis.contourf(
            across, one.up, np.minimum(rate, 1e300), levels=[0.0, np.inf], colors=[SERIES[1]], alpha=0.4
        )
        axis.fill_between([], [], [], color=SERIES[1], alpha=0.4, linewidth=0, label="r ≥ 0")
    axis.contour(across, one.up, one.value, levels=[given.level], colors=[INK], linewidths=1.8)
    axis.plot([], [], color=INK, linewidth=1.8, label="proved: V ≤ c")
    if given.sampled_level is not None:
        style = {"colors": [SERIES[1]], "linewidths": 1.2, "linestyles": [(0, (3.0, 3.0))]}
        axis.contour(across, one.up, one.value, levels=[given.sampled_level], **style)
        axis.plot([], [], color=SERIES[1], linewidth=1.2, dashes=(3.0, 3.0), label="sampled level")
    a, b, _ = one.worst(given.level)
    axis.plot(scale * a, b, "x", color=INK, markersize=8, markeredgewidth=1.8, label="worst point here")
    axis.plot(0.0, 0.0, "+", color=INK, markersize=9)
    axis.grid(False)
    return figure, axis


def _edges(one: Slice, level: float) -> list[float]:
    """Three values of r/V between the bands of a slice, round numbers from the fastest to the slowest."""
    inside = one.rate[(one.value <= level) & (one.rate < 0.0)]
    fast = float(np.quantile(inside, 0.15)) if inside.size else -1.0
    return [float(f"{share * fast:.1g}") for share in (1.0, 0.5, 0.2)]


def _said_of(given: Certificate, one: Slice) -> list[str]:
    """What a slice shows of r."""
    worst, inside = one.worst(given.level)[2], "r is negative wherever V ≤ c"
    decays = " with the proved decay in r" if given.decay else ""
    text = f"Colours: r/V{decays}, the rate at which V falls beyond what the gain asks for; "
    text += f"{inside}, least so at the cross, {number(worst, 2)}/s." if worst < 0.0 else "see the cross."
    return [text, "" if (one.residual <= 0.0).all() else "Where r ≥ 0 nothing is proved."]


def gain_figure(proved: float, attained: float) -> Figure:
    """The gain on a line: proved from above, attained from below."""
    figure, (axis,) = new_figure(1, height=1.5)
    axis.barh(0.0, attained, height=0.5, color=SERIES[2], alpha=0.55, label=f"attained: {at_least(attained)}")
    axis.barh(
        0.0,
        proved - attained,
        left=attained,
        height=0.5,
        color=MUTED,
        alpha=0.35,
        label="the largest lies here",
    )
    axis.axvline(proved, color=SERIES[0], linewidth=2.4, label=f"proved: γ = {at_most(proved)}")
    axis.set_yticks([])
    axis.set_xlim(0.0, 1.08 * proved)
    axis.set_xlabel("√(∫|z|²/∫|d|²)")
    legend(axis)
    return figure_block(
        "gain",
        figure,
        "A disturbance was found that attains the lower end; none exceeds the upper one.",
        "Gain",
    )


def _until(time: np.ndarray, x: np.ndarray) -> float:
    """Until where a run is drawn, s."""
    moving = np.flatnonzero(np.abs(x) > SETTLED * np.abs(x[0]))
    return float(min(time[-1], LONGER * time[moving[-1]])) if moving.size else float(time[-1])


def largest_figure(one: CertifiedDegree, given: Certificate) -> Figure:
    """The largest proved steps, without disturbance."""
    scale = 180.0 / np.pi if given.states[0].unit == "rad" else 1.0
    value = one.choice.solution.value if one.box is None else one.box.value
    figure, axes = new_figure(3, height=6.4)
    for step, colour in zip(one.steps, SERIES[2:]):
        few, x = thin(step.time), scale * step.state
        name = RULES.get(step.rule, step.rule)
        axes[0].plot(step.time[few], x[few, 0], color=colour, label=f"starts: {name}")
        inputs = one.choice.solution.operating_input + one.choice.solution.inputs(step.state[few])
        axes[1].plot(step.time[few], inputs[:, 0], color=colour)
        axes[2].plot(step.time[few], value(step.state[few]) / given.level, color=colour)
    axes[2].axhline(1.0, color=SERIES[0], dashes=DASHED, linewidth=1.2)
    axes[0].set_xlim(0.0, max(_until(step.time, step.state[:, 0]) for step in one.steps))
    reference_line(axes[0])
    label(axes[0], "position − goal", "°" if scale != 1.0 else given.states[0].unit)
    label(axes[1], "input", given.inputs[0].unit)
    label(axes[2], "V / c", "")
    legend(axes[0])
    return figure_block(
        "largest", figure,
        "The largest proved step for each start of the integrator, without disturbance. V falls all the way.",
        "Largest steps",
    )  # fmt: skip


def worst_figures(shown: Evidence) -> list[Figure]:
    """Smaller steps with the worst disturbance; none where no step is stated."""
    if not shown.worst:
        return []
    given, runs = shown.certificate, shown.worst
    scale = 180.0 / np.pi if given.states[0].unit == "rad" else 1.0
    figure, axes = new_figure(3, height=6.4)
    for run, colour in zip(runs, SERIES[2:]):
        few, name = thin(run.time), RULES.get(run.rule, run.rule)
        axes[0].plot(run.time[few], scale * run.state[few, 0], color=colour, label=f"starts: {name}")
        axes[1].plot(run.time[few], np.linalg.norm(run.disturbance[few], axis=1), color=colour)
        axes[2].plot(run.time[few], run.value[few] / given.level, color=colour)
        bound = (run.value[0] + run.spent[few]) / given.level
        axes[2].plot(run.time[few], bound, color=MUTED, linewidth=1.0, dashes=(2.0, 1.5))
    axes[2].axhline(1.0, color=SERIES[0], dashes=DASHED, linewidth=1.2)
    axes[0].set_xlim(0.0, max(_until(run.time, run.state[:, 0]) for run in runs))
    reference_line(axes[0])
    label(axes[0], "position − goal", "°" if scale != 1.0 else given.states[0].unit)
    label(axes[1], "|d|", common_unit(given.disturbances))
    label(axes[2], "V / c", "")
    legend(axes[0])
    return [
        figure_block(
            "worst", figure,
            "Steps of 0.8 of the largest ones with the disturbance that V says is worst, d = g1ᵀV_xᵀ/γ², as long as "
            "the budget lasts. Thin lines: V(x0) + ½γ²∫|d|², which V stays below.",
            "Worst disturbance",
        )
    ]  # fmt: skip


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
    """Everything on one page.

    Parameters
    ----------
    found : sequence of CertifiedDegree
        All degrees.
    one : CertifiedDegree
        The one whose certificate is shown.
    command : sequence of str
        That makes the page again.
    """
    given = shown.certificate
    with house_style():
        sections = [
            *_theorem(given),
            Section("Where steps may start", _starts(one, shown), "starts"),
            *([] if one.box else [Section("Where the level ends", _limit(shown), "limit")]),
            Section("Steps inside the region", _steps(one, shown), "steps"),
            Section("What disturbances may cost", _budget(shown), "budget"),
            Section("The gain from both sides", _gain(shown), "gain"),
            Section("The law of each degree", _degrees(found), "degrees"),
            Section("How to check it", _check(given), "check"),
        ]
    proved = f"Proved: the gain is at most γ = {at_most(given.gamma)}"
    proved += (
        f", and steps of up to {_steps_text(given)} stay in the region."
        if given.starts
        else " in the region."
    )
    beyond = ", beyond the budget" if given.is_gradient_law else ""
    return Page(
        f"Certificate: {given.about.split(',')[0]}", f"{given.about}. {_covers(given)}", proved, sections,
        Settings({"Certificate": _settings(given)}), Provenance(tuple(command), s.seed), _numbers(one, given),
        [Status("proved", "By arithmetic that cannot round the wrong way."),
         Status("not proved", f"Estimator, sampling, hold, delay, limits and noise{beyond}.")],
    )  # fmt: skip


# Text -----------------------------------------------------------------------------------------------------
def _covers(given: Certificate) -> str:
    who = "all robots of the stated box of parameters" if _is_box(given) else "the nominal robot"
    channels = ", ".join(d.name.replace("_", " ") for d in given.disturbances)
    fed = "the true state or the observer's estimates" if given.observer else "the true state"
    return f"For {who}, fed {fed} in continuous time; disturbances: {channels}."


def _is_box(given: Certificate) -> bool:
    return any(p.low < p.high for p in given.parameters)


def _angle(value: float, unit: str) -> str:
    return (
        f"{at_least(float(np.degrees(value)), decimals=1)}°"
        if unit == "rad"
        else f"{at_least(value, 3)} {unit}"
    )


def _steps_text(given: Certificate) -> str:
    unit = given.states[0].unit
    return " or ".join(f"{_angle(s.amplitude, unit)} ({RULES.get(s.rule, s.rule)})" for s in given.starts)


def _numbers(one: CertifiedDegree, given: Certificate) -> list[KeyNumber]:
    unit, effort = given.states[0].unit, given.inputs[0].unit
    found = [
        KeyNumber("largest proved step", _angle(s.amplitude, unit), "", RULES.get(s.rule, s.rule))
        for s in given.starts
    ]
    attained = (
        "" if given.attained_gain is None else f"attained by a disturbance: {at_least(given.attained_gain)}"
    )
    found.append(KeyNumber("gain, proved", f"≤ {at_most(given.gamma)}", "", attained))
    share = (
        ""
        if given.sampled_level is None
        else f"{100 * given.level / given.sampled_level:.1f} % of the sampled one"
    )
    found.append(KeyNumber("level of V", at_least(given.level), "", share))
    found += [
        KeyNumber(
            f"{_peak(effort)}, simulated",
            number(float(step.peak_input.max()), 3),
            effort,
            f"nominal robot, {RULES.get(step.rule, step.rule)}; not proved",
        )
        for step in one.steps
    ]
    return found


def _peak(unit: str) -> str:
    return "peak voltage" if unit == "V" else "peak input"


def _theorem(given: Certificate) -> list[Section]:
    """Its parts, but for what it is about, which stands at the top."""
    parts = dict(theorem_parts(given, given.stated))
    region = [f"S is {text}" for text in parts.pop("Region S")]
    parts["Proved"] = region + parts["Proved"]
    sections = []
    for title, lines in parts.items():
        texts = tuple(lines if title == "Hypotheses" else map(_set, lines))
        if title == "Proved":  # with numbers of its own, by which the rest names it
            blocks: list[Any] = list(map(Paragraph, texts))
        elif title == "Hypotheses":
            blocks = _hypotheses(texts)
        else:
            blocks = [Bullets(texts)]
        anchor = "author" if title == AUTHOR else title.lower().replace(" ", "-")
        sections.append(Section(title, blocks, anchor))
    return sections


def _hypotheses(texts: tuple[str, ...]) -> list[Any]:
    """The plant with its equations in a table, R2, the law and V as they can be copied, then the rest."""
    rates = [text.removeprefix("d/dt ").partition(" = ") for text in texts if text.startswith("d/dt ")]
    rows = [(_set(name), _set(rate if rate[0] != "-" else f"−{rate[1:]}")) for name, _, rate in rates]
    formulas = [text for text in texts if _FORMULA.match(text)]
    plant, *rest = (text for text in texts if not text.startswith("d/dt ") and text not in formulas)
    return [
        Paragraph(_set(plant)),
        Table(("state", "its rate"), rows, "", "table-plant", stacks=True),
        Bullets(tuple(map(_set, rest))),
        *(Listing("\n".join(wrap(text, 110, subsequent_indent="  "))) for text in formulas),
    ]


def _set(text: str) -> str:
    """A sentence of the theorem with the signs of a page."""
    for plain, sign in SIGNS:
        text = text.replace(plain, sign)
    return text


def _settings(given: Certificate) -> list[Setting]:
    found = [Setting("degree of V", given.degree), Setting("feedback", given.feedback)]
    found += [Setting("decay α", given.decay, "1/s"), Setting("reach in z", given.reach)]
    for p in given.parameters:
        value = p.low if p.low == p.high else f"{number(p.low, 6)} to {number(p.high, 6)}"
        found.append(Setting(p.name.replace("_", " "), value, p.unit))
    return found + [Setting(name, value) for name, value in given.provenance.items()]


# Pictures -------------------------------------------------------------------------------------------------
def _starts(one: CertifiedDegree, shown: Evidence) -> list[Any]:
    given = shown.certificate
    if not one.steps:
        return [Paragraph("No steps from rest to rest are stated.")]
    unit = given.states[0].unit
    rows = [
        (
            RULES.get(s.rule, s.rule),
            _angle(s.amplitude, unit),
            number(s.overshoot_percent, decimals=1),
            number(float(s.first_input.max()), 3),
            number(float(s.peak_input.max()), 3),
        )
        for s in one.steps
    ]
    effort = given.inputs[0].unit
    table = Table(
        ("start of the integrator", "largest proved step", Column("overshoot", "%"), Column("first input", effort),
         Column(_peak(effort), effort)), rows, "Simulated, not proved: the nominal robot, undisturbed",
        "table-steps", stacks=True,
    )  # fmt: skip
    text = (
        "A step from rest starts at another equilibrium, with an integrator that the controller chooses. Where V is "
        "smallest the region reaches furthest, and the input jumps; where the input does not jump, V is larger."
    )
    if shown.surface is None:
        text = (
            "A step from rest starts at another equilibrium, of each robot its own, with the integrator at which its "
            "input does not jump. The run is that of the nominal robot."
        )
        return [Paragraph(text), table]
    return [Paragraph(text), surface_figure(given, shown.surface), table]


def _limit(shown: Evidence) -> list[Any]:
    given = shown.certificate
    if shown.limit is None:
        return [Paragraph("Sampling finds no point that limits the level.")]
    text = (
        "Sampling looks for points at which the inequality fails, and so says how large a level can be at most; the "
        f"proof covers all points of V ≤ c = {at_least(given.level, 5)}"
    )
    sampled = given.sampled_level
    text += "." if sampled is None else f", {number(100.0 * given.level / sampled, 4)} % of the sampled one."
    return [Paragraph(text), limit_figure(given, shown.limit)]


def _steps(one: CertifiedDegree, shown: Evidence) -> list[Any]:
    return [largest_figure(one, shown.certificate), *worst_figures(shown)] if one.steps else []


# Budget, gain, checks -------------------------------------------------------------------------------------
def _budget(shown: Evidence) -> list[Any]:
    given = shown.certificate
    text = (
        "From a start x0 inside, the region holds as long as V(x0) + ½γ²∫|d|² ≤ c. What is left of the level is the "
        "energy ∫|d|² that disturbances may have"
    )
    text += (
        "."
        if not given.is_gradient_law
        else (
            "; anything that makes the input differ by v from the law (hold, delay, estimator, limits) takes ½∫vᵀR2v "
            "from the same budget. `flexhinf design` shows what its own loop spends."
        )
    )
    rows = [_budget_row(given, run) for run in shown.worst]
    square = _energy_unit(given).strip()
    table = Table(
        ("start of the integrator", "step", Column("V(x0)", "% of c"), Column("left for disturbances", "% of c"),
         Column("energy ∫|d|² allowed", square)), rows, "Steps of 0.8 of the largest ones", "table-budget",
        stacks=True,
    )  # fmt: skip
    free = 2.0 * given.level / given.gamma**2
    energy = f"{at_least(free, 3)} {square}".rstrip()
    at_goal = f"From rest at the goal, disturbances may have an energy of {energy} in all."
    if given.decay:
        last = (
            f"Disturbances that last: with the proved rate α = {number(given.decay, 3)}/s the region is invariant for "
            f"|d(t)| ≤ √(2αc)/γ = {at_least(persistent_bound(given), 3)} {common_unit(given.disturbances)} at all "
            "times."
        )
    else:
        last = "Nothing is proved for disturbances that last for ever: no decay rate was asked for (`--decay 0.2`)."
    return [Paragraph(text), *([table] if rows else []), Paragraph(at_goal), Paragraph(last)]


def _energy_unit(given: Certificate) -> str:
    """Of ∫|d|², behind a number."""
    unit = common_unit(given.disturbances)
    return f" {unit}²·s" if unit.isalpha() else f" ({unit})²·s" if unit else ""


def _budget_row(given: Certificate, run: WorstStep) -> tuple[Any, ...]:
    start, left = float(run.value[0]), given.level - float(run.value[0])
    return (
        RULES.get(run.rule, run.rule), _angle(run.amplitude, given.states[0].unit),
        at_most(100.0 * start / given.level, 3), at_least(100.0 * left / given.level, 3),
        at_least(2.0 * left / given.gamma**2, 3),
    )  # fmt: skip


def _gain(shown: Evidence) -> list[Any]:
    given, attained = shown.certificate, shown.attained
    if attained is None:
        return [Paragraph("No disturbance was searched for, so the gain is bounded from above only.")]
    share = 100.0 * attained.gain / given.gamma
    where = f" and V up to {number(100.0 * attained.largest_value / given.level, 3)} % of the level"
    text = (
        f"√(∫|z|²/∫|d|²) is proved to be at most γ = {at_most(given.gamma, 5)}. A disturbance found by search attains "
        f"{number(attained.gain, 5)}{' on the nominal robot' if _is_box(given) else ''}, {number(share, 3)} % of it, "
        f"with an energy of {number(attained.energy, 3)}{_energy_unit(given)}{'' if _is_box(given) else where}. The "
        "largest gain of motions in the region lies between."
    )
    figure, axes = new_figure(2, height=4.6)
    few = thin(attained.times)
    for column, signal, colour in zip(attained.disturbance.T, given.disturbances, SERIES):
        axes[0].plot(attained.times[few], column[few], color=colour, label=signal.name.replace("_", " "))
    run = attained.trajectory
    states = run.signals["state"][:, 0] - run.signals["state"][0, 0]
    scale = 180.0 / np.pi if given.states[0].unit == "rad" else 1.0
    axes[1].plot(run.time[thin(run.time)], scale * states[thin(run.time)], color=SERIES[2])
    label(axes[0], "d", common_unit(given.disturbances))
    label(axes[1], "position − goal", "°" if scale != 1.0 else given.states[0].unit)
    legend(axes[0])
    picture = figure_block(
        "attained", figure, "The disturbance found, from rest at the goal, and the position.", "Attained gain"
    )
    return [Paragraph(text), gain_figure(given.gamma, attained.gain), picture]


def _degrees(found: Sequence[CertifiedDegree]) -> list[Any]:
    rows = []
    for one in found:
        given = one.certificate
        if given is None:
            rows.append((law_name(one.choice.degree), "–", "–", "–", f"{one.cpu_seconds:.1f}", one.reason))
            continue
        share = "–" if given.sampled_level is None else f"{100.0 * given.level / given.sampled_level:.1f}"
        steps = _steps_text(given) if given.starts else "–"
        rows.append(
            (law_name(one.choice.degree), at_least(given.level), share, steps, f"{one.cpu_seconds:.1f}",
             "used" if one.used else "")
        )  # fmt: skip
    columns = (
        "law", "proved level of V", Column("of the sampled", "%"), "largest steps", Column("CPU", "s"), "remark",
    )  # fmt: skip
    jumps = [(low, high) for low, high in pairwise(found) if _smaller(low, high)]
    notes = [
        Note(f"Degree {high.choice.degree} proves a smaller step than degree {low.choice.degree}.")
        for low, high in jumps
    ]
    return [*notes, Table(columns, rows, "", "table-degrees", stacks=True)]


def _smaller(low: CertifiedDegree, high: CertifiedDegree) -> bool:
    if low.certificate is None or high.certificate is None:
        return False
    return high.certificate.step_amplitude < low.certificate.step_amplitude


def _check(given: Certificate) -> list[Any]:
    text = (
        "The certificate's file has every number of the theorem exactly, and nothing of the search. A second program, "
        "which shares no code with the search, proves it again and says what it proved and what not:"
    )
    every = (
        "It trusts a bound of its own rounding in doubles, but for a random sample of cells. With `--every-cell` it "
        "proves all of them in exact rationals and balls too: minutes for V of degree 2, hours for degree 6."
    )
    return [Paragraph(text), Listing("flexhinf certify --check certificate.json"), Paragraph(every)]
