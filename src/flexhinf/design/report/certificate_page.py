"""The page of a certificate: the theorem with its hypotheses, region, steps inside, budget, gain from both sides."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise
from textwrap import wrap
from typing import Any

import numpy as np

from flexhinf.certify import Certificate
from flexhinf.certify.pictures import WorstStep
from flexhinf.certify.theorem import AUTHOR, common_unit, persistent_bound, theorem_parts
from flexhinf.design.certification import CertifiedDegree, Evidence
from flexhinf.design.report.certificate_figures import (
    gain_figure,
    largest_figure,
    limit_figure,
    surface_figure,
    worst_figures,
)
from flexhinf.design.report.drawing import figure_block, thin
from flexhinf.design.report.formatting import law_name
from flexhinf.design.report.proof import RULES
from flexhinf.design.specification import Specification
from flexhinf.report import (
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
