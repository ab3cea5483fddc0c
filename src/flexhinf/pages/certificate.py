"""The page of a certificate: the theorem with its hypotheses, region, steps inside, budget, gain from both sides."""

# Not checked strictly: parts of Matplotlib have no types.
# pyright: reportUnknownMemberType=false

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np

from flexhinf.arrays import Number
from flexhinf.certify import Certificate, Start, Verification
from flexhinf.certify.certificate import (
    AUTHOR,
    NO_LATENCY,
    common_unit,
    persistent_bound,
    theorem_parts,
    verification_text,
)
from flexhinf.certify.starts import SMALLEST_VALUE, UNCHANGED_INPUT, SurfaceSlice
from flexhinf.designs.certification import CertifiedDegree, Evidence
from flexhinf.designs.specification import Specification
from flexhinf.designs.verdict import UNKNOWN, DesignVerdict
from flexhinf.numerals import at_least, at_most, number, short_bounds
from flexhinf.pages.design.region import rule_text
from flexhinf.pages.drawing import (
    DASHED,
    Line,
    Panel,
    display_scale,
    draw_figure,
    figure_block,
    law_name,
    reference_line,
    thin,
)
from flexhinf.pages.page import design_statuses
from flexhinf.pages.terminal import Ending, screen, wrapped
from flexhinf.report import (
    INK,
    MUTED,
    SERIES,
    Badge,
    Bullets,
    Column,
    Fact,
    Figure,
    LineStyle,
    Listing,
    Note,
    Page,
    PageBlock,
    Paragraph,
    Section,
    Table,
    house_style,
    legend,
    new_figure,
)

if TYPE_CHECKING:
    from rich.table import Table as Terminal

#: Names of a peak input, by its unit.
PEAKS = {"V": "peak voltage"}

#: Signs of a page instead of those of a terminal.
SIGNS = (
    ("<=", "≤"), ("dV/dt", "V̇"), ("gamma^2", "γ²"), ("gamma_e^2", "γₑ²"), ("gamma_e", "γₑ"), ("gamma", "γ"),
    ("R2^(1/2)", "√R2"), ("1/2 ", "½ "), ("^2", "²"), ("v'R2", "vᵀR2"), ("-R2^-1 g2'V_x'", "−R2⁻¹g2ᵀVₓᵀ"),
    ("e0'X e0", "e₀ᵀXe₀"), ("e0", "e₀"), (" - ", " − "), ("≤ -", "≤ −"), ("(-", "(−"),
    (", -", ", −"), ("pi", "π"), ("*", "·"), ("_", " "),
)  # fmt: skip


def certificate_page(
    laws: Sequence[CertifiedDegree],
    law: CertifiedDegree,
    evidence: Evidence,
    s: Specification,
    command: Sequence[str],
    verdict: DesignVerdict = UNKNOWN,
) -> Page:
    """The page of a certificate, with the proofs of all degrees, the command that makes it again and the verdict on the
    design."""
    claim, degrees, missing = evidence.certificate, s.in_degrees, _missing_text(evidence.certificate)
    smaller = [
        Note(f"Degree {high.choice.degree} proves a smaller step than degree {low.choice.degree}.")
        for low, high in pairwise(laws)
        if low.certificate is not None
        and high.certificate is not None
        and high.certificate.step_amplitude < low.certificate.step_amplitude
    ]
    with house_style():  # once for all figures
        sections = [
            *_theorem(claim),
            Section("Where steps may start", _starts(law, evidence, degrees), "starts", True),
            Section("Where the level ends", () if law.box else _limit(evidence), "limit"),
            Section("Steps inside the region", _steps(law, evidence, degrees), "steps"),
            Section("What disturbances may cost", _budget(evidence, degrees), "budget"),
            Section("The gain from both sides", _gain(evidence, degrees), "gain"),
            Section("The law of each degree", [*smaller, _degree_table(laws, degrees)], "degrees"),
            Section("How to check it", CHECK, "check"),
        ]
    parameters = (
        Fact(
            p.name.replace("_", " "),
            p.low if p.low == p.high else f"{number(p.low, 6)} to {number(p.high, 6)}",
            p.unit,
        )
        for p in claim.parameters
    )
    settings = (
        Fact("degree of V", claim.degree),
        Fact("feedback", claim.feedback),
        Fact("decay α", claim.decay, "1/s"),
        Fact("reach in z", claim.reach),
        Fact("latency covered", 0, "samples"),
        *parameters,
        *(Fact(name, value) for name, value in claim.provenance.items()),
    )
    proved = Badge("proved", f"{_parts_text(claim)}, by arithmetic that cannot round the wrong way.")
    return Page(
        f"Certificate: {claim.about.split(',')[0]}",
        f"{claim.about}. {_whom_text(claim)}",
        _proved_text(claim, degrees),
        sections,
        command,
        s.seed,
        {"Certificate": settings},
        _facts(law, claim, degrees),
        [proved, *design_statuses(verdict)],
        (f"The proof does not cover {missing[0].lower()}{missing[1:]}",),
        ("starts", "worst"),
    )


#: How a certificate's file is checked.
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


def _whom_text(claim: Certificate) -> str:
    boxed = any(p.low < p.high for p in claim.parameters)
    who = "all robots of the stated box of parameters" if boxed else "the nominal robot"
    channels = ", ".join(d.name.replace("_", " ") for d in claim.disturbances)
    fed = "the true state or the observer's estimates" if claim.observer else "the true state"
    return f"For {who}, fed {fed} in continuous time; disturbances: {channels}."


def _proved_text(claim: Certificate, degrees: bool) -> str:
    reach = f", and steps of up to {_steps_text(claim, degrees)} stay" if claim.starts else ""
    return f"Proved: the gain is at most γ = {at_most(claim.gamma)}{reach} in the region."


def _parts_text(claim: Certificate) -> str:
    """The statements that are proved, by name, and for whom."""
    proved = dict(theorem_parts(claim, claim.stated))["Proved"]
    names = [line.partition(". ")[2].partition(":")[0].lower() for line in proved]
    whom = _whom_text(claim).rstrip(".")
    return f"{', '.join(names).capitalize()}, {whom[0].lower()}{whom[1:]}"


def _missing_text(claim: Certificate) -> str:
    beyond = ", beyond the budget" if claim.is_gradient_law else ""
    return f"Estimator, sampling, hold, delay, limits and noise{beyond}. {NO_LATENCY} It is of {claim.controller}."


# Numbers --------------------------------------------------------------------------------------------------
def _position(claim: Certificate, degrees: bool) -> tuple[float, str]:
    return display_scale(claim.states[0].unit, degrees)


def _angle(claim: Certificate, value: float, degrees: bool) -> str:
    scale, unit = _position(claim, degrees)
    return f"{at_least(scale * value, decimals=1)}°" if unit == "°" else f"{at_least(value, 3)} {unit}"


def _steps_text(claim: Certificate, degrees: bool) -> str:
    return " or ".join(f"{_angle(claim, s.amplitude, degrees)} ({rule_text(s.rule)})" for s in claim.starts)


def _start_text(start: Start) -> str:
    """What the rule by which a step starts its integrator means."""
    return {
        UNCHANGED_INPUT: "the controller starts its integrator so that the input goes on as it was",
        SMALLEST_VALUE: "the integrator starts where V is smallest: there the region reaches furthest, and the input "
        "need not go on as it was",
    }.get(start.rule, start.rule)


def _facts(law: CertifiedDegree, claim: Certificate, degrees: bool) -> list[Fact]:
    effort, gain, sampled = claim.inputs[0].unit, claim.attained_gain, claim.sampled_level
    ends = [(s, rule_text(s.rule), *_angle(claim, s.amplitude, degrees).partition(" ")) for s in claim.starts]
    return [
        *(Fact(f"largest proved step, {rule}", text, unit, _start_text(s)) for s, rule, text, _, unit in ends),
        Fact(
            "gain, proved", f"≤ {at_most(claim.gamma)}", "",
            "" if gain is None else f"attained by a disturbance: {at_least(gain)}",
        ),
        Fact(
            "level of V", at_least(claim.level), "",
            "" if sampled is None else f"{100 * claim.level / sampled:.1f} % of the sampled one",
        ),
        *(
            Fact(
                f"{PEAKS.get(effort, 'peak input')}, simulated", number(float(step.peak_input.max()), 3), effort,
                f"nominal robot, {rule_text(step.rule)}; not proved",
            )
            for step in law.steps
        ),
    ]  # fmt: skip


# Theorem --------------------------------------------------------------------------------------------------
def _theorem(claim: Certificate) -> list[Section]:
    parts = {
        heading: [line.strip().removeprefix("- ") for line in lines]
        for heading, lines in theorem_parts(claim, claim.stated)
    }
    parts["Proved"] = [f"S is {text}" for text in parts.pop("Region S")] + parts["Proved"]
    sections: list[Section] = []
    for title, lines in parts.items():
        blocks: list[PageBlock] = [Bullets(tuple(map(_set, lines)))]
        if title == "Proved":  # with numbers of its own, by which the rest names it
            blocks = [Paragraph(_set(short_bounds(line, "V <= ", "gamma = "))) for line in lines]
            blocks += [
                Paragraph("Numbers have six digits, bounds rounded to the safe side; the file has all.")
            ]
        # Equations in a table, R2, the law and V as they can be copied, then the rest.
        if title == "Hypotheses":
            rates = [line.removeprefix("d/dt ").split(" = ", 1) for line in lines if line.startswith("d/dt ")]
            formulas = [line for line in lines if re.match(r"\w+ = ", line)]  # R2, an input's law, V
            others = [_set(line) for line in lines if not re.match(r"\w+ = |d/dt ", line)]
            blocks = [
                Paragraph(others[0]),
                Table(
                    ("state", "its rate"),
                    [(_set(name), _set(f"−{rate[1:]}" if rate[0] == "-" else rate)) for name, rate in rates],
                    "", "table-plant", stacks=True,
                ),
                Bullets(tuple(others[1:])),
                *(Listing("\n".join(wrap(line, 110, subsequent_indent="  "))) for line in formulas),
            ]  # fmt: skip
        anchor = "author" if title == AUTHOR else title.lower().replace(" ", "-")
        # Of the theorem, what is proved is open; the hypotheses and the equations are for those who check it.
        sections.append(Section(title, blocks, anchor, anchor == "proved"))
    return sections


def _set(text: str) -> str:
    for plain, sign in SIGNS:
        text = text.replace(plain, sign)
    return text


# Slices of the region -------------------------------------------------------------------------------------
#: What is drawn over a slice: its points, marker and style, and its name in the legend.
_Mark = tuple[Number, Number, str, LineStyle, str | None]


def _starts(law: CertifiedDegree, evidence: Evidence, degrees: bool) -> list[PageBlock]:
    claim, surface = evidence.certificate, evidence.surface
    scale, unit = _position(claim, degrees)
    if not law.steps:
        return [Paragraph("No steps from rest to rest are stated.")]
    text, blocks = "A step from rest starts at another equilibrium, ", [_steps_table(law, claim, degrees)]
    if surface is None:
        return [Paragraph(f"{text}of each robot its own, without a jump of the input."), *blocks]
    integral = next(x.unit for x in claim.states if x.name.endswith("_integral"))
    (up, height), lines = display_scale(integral, degrees), list[_Mark]()
    for path, start, colour in zip(surface.paths, claim.starts, SERIES[2:]):
        name, (end, high) = f"starts: {rule_text(start.rule)}", path[-1]
        lines.append((scale * path[:, 0], up * path[:, 1], "-", {"color": colour}, name))
        lines.append((scale * end, up * high, "o", {"color": colour, "markersize": 5}, None))
    return [
        Paragraph(
            f"{text}with an integrator that the controller chooses. Where V is smallest the region reaches furthest, "
            "and the input jumps."
        ),
        _slice(
            ("starts", "Starts of steps"), claim, surface, (scale, up), lines,
            (f"step to the goal ({unit})", "integral of the error", height),
            "Equilibria at a distance from the goal (+), with each value of the integrator.",
        ),
        *blocks,
    ]  # fmt: skip


def _limit(evidence: Evidence) -> list[PageBlock]:
    claim, plane, sampled = evidence.certificate, evidence.limit, evidence.certificate.sampled_level
    if plane is None:
        return [Paragraph("Sampling finds no point that limits the level.")]
    limits = {"inequality": "r = 0", "V stops increasing": "V grows no more"}
    points: list[_Mark] = [
        (0.0, 1.0, "D", {"color": INK, "markersize": 5}, f"limits the level: {limits[plane.limit]}")
    ]
    other, across = "the largest proved start", "share of the largest proved start"
    if plane.moved is None:
        points.append((1.0, 0.0, "o", {"color": SERIES[2], "markersize": 5}, other))
    else:
        state, unit = claim.states[plane.moved].name.replace("_", " "), claim.states[plane.moved].unit
        other, across = f"the {state} with the other states where V₂ is smallest", f"{state} ({unit})"
    share = "" if sampled is None else f", {number(100.0 * claim.level / sampled, 4)} % of the sampled level"
    where = ", ".join(
        f"{s.name.replace('_', ' ')} {number(float(v), 3)} {s.unit}".rstrip()
        for s, v in zip(claim.states, plane.point, strict=True)
    )
    return [
        Paragraph(
            f"The proof covers all points of V ≤ c = {at_least(claim.level, 5)}{share}; sampling looks for points at "
            "which the inequality fails, and so says how large a level can be at most."
        ),
        _slice(
            ("limit", "Where the level ends"), claim, plane, (1.0, 1.0), points,
            (across, "share of the limiting point", ""),
            f"The plane through the goal (+), {other}, and the point where the sampled level ends: deviation {where}.",
        ),
    ]  # fmt: skip


def _slice(
    place: tuple[str, str], claim: Certificate, cut: SurfaceSlice, scales: tuple[float, float],
    lines: Sequence[_Mark], names: tuple[str, str, str], caption: str,
) -> Figure:  # fmt: skip
    """Figure of r/V in bands, with the proved and the sampled level, the goal, the worst point inside, and `lines`.

    `place`: anchor and title; `names`: of the horizontal axis, of the vertical one, and its unit.
    """
    figure, (axis,) = new_figure(1, height=6.2, labels=[names[1:]], across=names[0])
    inside = cut.rate[(cut.value <= claim.level) & (cut.rate < 0.0)]
    fast = float(np.quantile(inside, 0.15)) if inside.size else -1.0
    edges = [float(f"{share * fast:.1g}") for share in (1.0, 0.5, 0.2)]  # from the fastest to the slowest
    across, up = scales[0] * cut.across, scales[1] * cut.up
    rate = np.where(cut.value < 0.0, np.inf, np.nan_to_num(cut.rate, nan=edges[-1]))  # V = 0: the goal
    areas = [  # values, limits, colour, depth and name of what is filled
        (rate, [low, high], SERIES[0], depth, f"r/V < {number(high, 2)}/s" if high else "r < 0")
        for (low, high), depth in zip(pairwise([-np.inf, *edges, 0.0]), np.linspace(0.62, 0.12, 4))
    ]
    if (rate > 0.0).any():
        areas.append((np.minimum(rate, 1e300), [0.0, np.inf], SERIES[1], 0.4, "r ≥ 0"))
    for values, levels, colour, depth, name in areas:
        axis.contourf(across, up, values, levels=levels, colors=[colour], alpha=depth)
        axis.fill_between([], [], [], color=colour, alpha=depth, linewidth=0, label=name)
    axis.contour(across, up, cut.value, levels=[claim.level], colors=[INK], linewidths=1.8)
    axis.plot([], [], color=INK, linewidth=1.8, label="proved: V ≤ c")
    if claim.sampled_level is not None:
        dashes = [(0, (3.0, 3.0))]
        axis.contour(
            across,
            up,
            cut.value,
            [claim.sampled_level],
            colors=[SERIES[1]],
            linewidths=1.2,
            linestyles=dashes,
        )
        axis.plot([], [], color=SERIES[1], linewidth=1.2, dashes=(3.0, 3.0), label="sampled level")
    a, b, worst = cut.worst(claim.level)
    a, b = scales[0] * a, scales[1] * b
    axis.plot(a, b, "x", color=INK, markersize=8, markeredgewidth=1.8, label="worst point here")
    axis.plot(0.0, 0.0, "+", color=INK, markersize=9)
    axis.grid(False)
    for x, y, marker, style, name in lines:
        axis.plot(x, y, marker, label=name, **style)
    legend(axis)
    decays = " with the proved decay in r" if claim.decay else ""
    cross = f"r is negative wherever V ≤ c, least so at the cross, {number(worst, 2)}/s."
    unproved = "" if (cut.residual <= 0.0).all() else " Where r ≥ 0 nothing is proved."
    return figure_block(
        place[0],
        figure,
        f"{caption} Colours: r/V{decays}, the rate at which V falls beyond what the gain asks for; "
        f"{cross if worst < 0.0 else 'see the cross.'}{unproved}",
        place[1],
    )


# Steps ----------------------------------------------------------------------------------------------------
def _steps(law: CertifiedDegree, evidence: Evidence, degrees: bool) -> list[PageBlock]:
    claim, solution, blocks = evidence.certificate, law.choice.solution, list[PageBlock]()
    value = solution.value if law.box is None else law.box.value
    scale, unit = _position(claim, degrees)
    size, d_unit = display_scale(common_unit(claim.disturbances), degrees)
    kinds: tuple[Any, ...] = (
        (law.steps, "largest", "Largest steps", ("input", claim.inputs[0].unit),
         "The largest proved step for each start of the integrator, without disturbance."),
        (evidence.worst, "worst", "Worst disturbance", ("|d|", d_unit),
         "Steps of 0.8 of the largest ones with the disturbance that V says is worst, d = g1ᵀV_xᵀ/γ², as long as the "
         "budget lasts. Thin lines: V(x0) + ½γ²∫|d|², which V stays below."),
    )  # fmt: skip
    for runs, name, title, second, caption in kinds if law.steps else ():
        if not runs:
            continue
        figure, axes = new_figure(3, height=6.4, labels=(("position − goal", unit), second, ("V / c", "")))
        ends: list[float] = []  # how long the runs are drawn
        for run, colour in zip(runs, SERIES[2:]):
            few = thin(run.time)
            time, state = run.time[few], run.state[few]
            axes[0].plot(time, scale * state[:, 0], color=colour, label=f"starts: {rule_text(run.rule)}")
            effort, v = (
                ((solution.operating_input + solution.inputs(state))[:, 0], value(state))
                if name == "largest"
                else (size * np.linalg.norm(run.disturbance[few], axis=1), run.value[few])
            )
            axes[1].plot(time, effort, color=colour)
            axes[2].plot(time, v / claim.level, color=colour)
            if name == "worst":
                bound = (run.value[0] + run.spent[few]) / claim.level
                axes[2].plot(time, bound, color=MUTED, linewidth=1.0, dashes=(2.0, 1.5))
            # until |x1| has stayed below a hundredth of the step, and half as long again
            moving = np.flatnonzero(np.abs(run.state[:, 0]) > 0.01 * np.abs(run.state[0, 0]))
            ends.append(float(min(run.time[-1], 1.5 * run.time[moving[-1]] if moving.size else np.inf)))
        axes[0].set_xlim(0.0, max(ends))
        axes[2].axhline(1.0, color=SERIES[0], dashes=DASHED, linewidth=1.2)
        reference_line(axes[0])
        legend(axes[0])
        blocks.append(figure_block(name, figure, caption, title))
    return blocks


# Budget and gain ------------------------------------------------------------------------------------------
def _budget(evidence: Evidence, degrees: bool) -> list[PageBlock]:
    claim, square = evidence.certificate, _energy_unit(evidence.certificate).strip()
    also = "; an input that differs by v from the law takes ½∫vᵀR2v from the same budget."
    rows = [
        (
            rule_text(run.rule), _angle(claim, run.amplitude, degrees), at_most(100.0 * start / claim.level, 3),
            at_least(100.0 * (claim.level - start) / claim.level, 3),
            at_least(2.0 * (claim.level - start) / claim.gamma**2, 3),
        )
        for run, start in ((run, float(run.value[0])) for run in evidence.worst)
    ]  # fmt: skip
    table = Table(
        (
            "start of the integrator", "step", Column("V(x0)", "% of c"), Column("left for disturbances", "% of c"),
            Column("energy ∫|d|² allowed", square),
        ),
        rows, "Steps of 0.8 of the largest ones", "table-budget", stacks=True,
    )  # fmt: skip
    energy = f"{at_least(2.0 * claim.level / claim.gamma**2, 3)} {square}".rstrip()
    last = (
        "Nothing is proved for disturbances that last for ever: no decay rate was asked for (`--decay 0.2`)."
        if not claim.decay
        else f"Disturbances that last: with the proved rate α = {number(claim.decay, 3)}/s the region is invariant for "
        f"|d(t)| ≤ √(2αc)/γ = {at_least(persistent_bound(claim), 3)} {common_unit(claim.disturbances)} at all times."
    )
    return [
        Paragraph(
            "From a start x0 inside, the region holds as long as V(x0) + ½γ²∫|d|² ≤ c. What is left of the level is "
            f"the energy ∫|d|² that disturbances may have{also if claim.is_gradient_law else '.'}"
        ),
        *([table] if rows else []),
        Paragraph(f"From rest at the goal, disturbances may have an energy of {energy} in all. {last}"),
    ]


def _energy_unit(claim: Certificate) -> str:
    unit = common_unit(claim.disturbances)
    return f" {unit}²·s" if unit.isalpha() else f" ({unit})²·s" if unit else ""


def _gain(evidence: Evidence, degrees: bool) -> list[PageBlock]:
    claim, attained = evidence.certificate, evidence.attained
    if attained is None:
        return [Paragraph("No disturbance was searched for, so the gain is bounded from above only.")]
    nominal, where = " on the nominal robot", ""
    if all(p.low == p.high for p in claim.parameters):
        share = number(100.0 * attained.largest_value / claim.level, 3)
        nominal, where = "", f" and V up to {share} % of the level"
    line, (axis,) = new_figure(1, height=1.5, across="√(∫|z|²/∫|d|²)")
    found, between = f"attained: {at_least(attained.gain)}", "the largest lies here"
    axis.barh(0.0, attained.gain, height=0.5, color=SERIES[2], alpha=0.55, label=found)
    left, width = attained.gain, claim.gamma - attained.gain
    axis.barh(0.0, width, left=left, height=0.5, color=MUTED, alpha=0.35, label=between)
    axis.axvline(claim.gamma, color=SERIES[0], linewidth=2.4, label=f"proved: γ = {at_most(claim.gamma)}")
    axis.set(yticks=[], xlim=(0.0, 1.08 * claim.gamma))
    legend(axis)
    (scale, unit), run, few = _position(claim, degrees), attained.trajectory, thin(attained.times)
    moved = run.signals["state"][:, 0] - run.signals["state"][0, 0]
    size, d_unit = display_scale(common_unit(claim.disturbances), degrees)
    position = Line(run.time[thin(run.time)], scale * moved[thin(run.time)], None, {"color": SERIES[2]})
    return [
        Paragraph(
            f"√(∫|z|²/∫|d|²) is proved to be at most γ = {at_most(claim.gamma, 5)}. A disturbance found by search "
            f"attains {number(attained.gain, 5)}{nominal}, {number(100.0 * attained.gain / claim.gamma, 3)} % of it, "
            f"with an energy of {number(attained.energy, 3)}{_energy_unit(claim)}{where}. The largest gain of motions "
            "in the region lies between."
        ),
        figure_block(
            "gain", line, "A disturbance was found that attains the lower end; none exceeds the upper one.", "Gain"
        ),
        draw_figure(
            "attained",
            (
                Panel("d", d_unit, [
                    Line(attained.times[few], size * column[few], signal.name.replace("_", " "), {"color": colour})
                    for column, signal, colour in zip(attained.disturbance.T, claim.disturbances, SERIES)
                ], also=legend),
                Panel("position − goal", unit, [position]),
            ),
            "The disturbance found, from rest at the goal, and the position.", "Attained gain", 4.6,
        ),
    ]  # fmt: skip


# Degrees and check ----------------------------------------------------------------------------------------
def _degree_table(laws: Sequence[CertifiedDegree], degrees: bool) -> Table:
    rows: list[Sequence[object]] = []
    for law in laws:
        claim, name = law.certificate, law_name(law.choice.degree) + (" *" if law.used else "")
        proved: tuple[object, ...] = (None, None, None, None)
        if claim is not None:
            sampled = claim.sampled_level
            proved = (
                at_least(claim.level), None if sampled is None else f"{100.0 * claim.level / sampled:.1f}",
                _steps_text(claim, degrees) if claim.starts else None, claim.provenance.get("cells"),
            )  # fmt: skip
        rows.append(
            (name, *proved, law.cpu_seconds, (law.reason if claim is None else "used" if law.used else ""))
        )
    whom = "all parameters within the tolerances" if any(law.box for law in laws) else "nominal parameters"
    return Table(
        (
            "law", Column("proved level of V", brief="level of V", right=True),
            Column("of the sampled", "%", right=True), "largest steps",
            Column("cells", right=True), Column("CPU", "s", 1), Column("remark", brief=None),
        ),
        rows, "", "table-degrees", stacks=True,
        title=f"What is proved, with the true state fed back and {whom} (* used)",
    )  # fmt: skip


def _steps_table(law: CertifiedDegree, claim: Certificate, degrees: bool) -> Table:
    effort = claim.inputs[0].unit
    return Table(
        (
            Column("start of the integrator", brief="integrators start"),
            Column("largest proved step", brief="step", right=True), Column("overshoot", "%", 1),
            Column("first input", effort, right=True), Column(PEAKS.get(effort, "peak input"), effort, right=True),
        ),
        [
            (
                rule_text(run.rule), _angle(claim, run.amplitude, degrees), run.overshoot_percent,
                *(", ".join(number(float(v), 3) for v in u) for u in (run.first_input, run.peak_input)),
            )
            for run in law.steps
        ],
        "Simulated, not proved: the nominal robot, undisturbed", "table-steps", stacks=True,
        title=f"{law_name(law.choice.degree)}: simulated, not proved: the nominal robot from the largest proved starts",
    )  # fmt: skip


def certification_tables(laws: Sequence[CertifiedDegree], degrees: bool) -> list[Terminal]:
    """Tables for a terminal: what is proved of the law of each degree, and runs from the largest proved steps."""
    steps = (_steps_table(law, law.certificate, degrees) for law in laws if law.steps and law.certificate)
    return [table.terminal() for table in (_degree_table(laws, degrees), *steps)]


def certification_ending(
    laws: Sequence[CertifiedDegree], claim: Certificate, verdict: DesignVerdict, degrees: bool
) -> Ending:
    """What a terminal says at the end: what is proved of the law of each degree, for whom, what is not, and the verdict
    on the design."""
    own = verdict.unmet or verdict.brief
    parts = (
        _proved_text(claim, degrees), _whom_text(claim), f"Not proved: {_missing_text(claim)}",
        f"{own[:1].upper()}{own[1:]}.",
    )  # fmt: skip
    return screen(lambda _: _degree_table(laws, degrees), [1], parts, certification_notes(laws))


def check_text(claim: Certificate, verification: Verification) -> str:
    """What a terminal says of a certificate that was checked, in the units of its file."""
    proved = [_proved_text(claim, False), _whom_text(claim), f"Not proved: {_missing_text(claim)}"]
    parts = [*(proved if verification.proved else [claim.about]), verification_text(verification)]
    return "\n".join(map(wrapped, parts))


def certification_notes(laws: Sequence[CertifiedDegree]) -> list[str]:
    """Notes that name the laws of which nothing is proved, and why."""
    return [f"{law_name(law.choice.degree)}: nothing is proved: {law.reason}" for law in laws if law.reason]
