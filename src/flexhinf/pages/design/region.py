"""Proofs of the law in a sentence, in design.json and on the page; where each solution was checked by samples, the
worst disturbance, and the dissipation budget."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence

import numpy as np

from flexhinf.analysis import BudgetTerm
from flexhinf.certify.certificate import NO_LATENCY
from flexhinf.certify.starts import SMALLEST_VALUE, UNCHANGED_INPUT
from flexhinf.designs.pose_evidence import PoseEvidence
from flexhinf.designs.synthesis.by_step import ACTING, GAIN, DegreeChoice, shrinking
from flexhinf.numerals import at_least, at_most, count_text, number
from flexhinf.pages.drawing import (
    Blocks,
    Line,
    Panel,
    amplitude_text,
    draw_figure,
    law_name,
    listed,
    note,
    thin,
    units_of,
)
from flexhinf.report import (
    INK,
    SERIES,
    Column,
    Figure,
    Listing,
    Paragraph,
    Table,
    finite,
)
from flexhinf.report.blocks import WIDTH

#: The certificate for all tolerances, beside that of the nominal robot.
BOX_FILE = "certificate-tolerances.json"


#: The rules by which steps start their integrators, as keys of design.json, and in words.
RULES = {
    SMALLEST_VALUE: ("V smallest", "input may jump, V smallest"),
    UNCHANGED_INPUT: ("input unchanged", "input without a jump"),
}


def rule_text(rule: str) -> str:
    """The rule by which a step starts its integrators, in a few words."""
    return RULES.get(rule, (rule, rule))[1]


# What is proved -----------------------------------------------------------------------------------------
def brief_proof_text(design: PoseEvidence) -> str:
    """`proof_text` for a terminal: without the reasons where nothing is proved."""
    proof = design.proof
    anything = design.step_proof.proved or proof.certificate is not None or proof.box is not None
    return proof_text(design) if anything else "Nothing is proved; the page says why."


def proof_text(design: PoseEvidence) -> str:
    """What is proved of the required step, then of the law for all tolerances and for the nominal robot; why
    nothing is."""
    proof, certificate, box = design.proof, design.proof.certificate, design.proof.box
    texts, beyond = [design.step_proof.text], "" if (certificate or box) is None else NO_LATENCY
    if box is not None:
        texts.append(
            f"Proved, for every robot within the tolerances with the true state fed back: the step of "
            f"{_amplitude_text(design, abs(box.step))} without a jump of the input, γ = {at_most(box.gamma)} for "
            f"{penalty_text(design)}."
        )
    if certificate is None:
        return " ".join(filter(None, [*texts, f"No region is proved: {proof.reason.rstrip('.')}.", beyond]))
    reach = "in the region,"
    if certificate.starts:  # first with the integrators as the controller starts them
        start = min(certificate.starts, key=lambda start: start.rule != UNCHANGED_INPUT)
        other = " (only with the integrators started where V is smallest)"
        reach = (
            f"rest-to-rest steps of up to {_amplitude_text(design, start.amplitude)}"
            f"{'' if start.rule == UNCHANGED_INPUT else other} stay in the region with"
        )
    whom = "every robot within the tolerances" if covers_tolerances(design) else "the nominal robot"
    texts.append(
        f"Proved, for {whom} with the true state fed back: {reach} γ = {at_most(certificate.gamma)}."
    )
    if proof.inside and proof.budget:
        spent, left = (
            f"{100.0 * value / certificate.level:.2g}"
            for value in (proof.budget[-1].budget.total, certificate.level - proof.start)
        )
        texts.append(
            f"Not proved, as it is of one simulated run of the step: {listed([term.name for term in proof.budget])} "
            f"spend {spent} % of the level there, of which the step leaves {left} %"
            f"{'' if proof.lasts else ', too little'}."
        )
    elif proof.inside:
        texts.append("What the estimator and the sampling spend is not covered.")
    return " ".join(filter(None, [*texts, beyond]))


def penalty_text(design: PoseEvidence) -> str:
    """Sentence on the z whose gain is proved for all tolerances."""
    own = "the robot's own penalty" if design.robot.penalty else "Eq. (11), scaled to the robot"
    return f"the z of {own if design.specification.checked_penalty is None else 'the checked penalty'}"


def covers_tolerances(design: PoseEvidence) -> bool:
    """Whether the proof is for a box of parameters."""
    certificate = design.proof.certificate
    return certificate is not None and any(p.low < p.high for p in certificate.parameters)


def _amplitude_text(design: PoseEvidence, amplitude: float) -> str:
    slides = any(design.robot.links.slides)
    if design.specification.in_degrees and not slides:
        return f"{at_least(math.degrees(amplitude), 3)}°"
    return f"{at_least(amplitude, 3)} {'m' if slides else 'rad'}"


def proof_numbers(design: PoseEvidence) -> dict[str, object]:
    """Numbers of the proofs for design.json."""
    proof, certificate, box = design.proof, design.proof.certificate, design.proof.box
    tolerances: dict[str, object] = {"proved": covers_tolerances(design), "reason": proof.box_reason}
    if box is not None and box.certificate is not None:
        tolerances = {
            "proved": True,
            "gamma": box.gamma,
            "step": abs(box.step),
            "level": box.certificate.level,
            "cpu_s": box.cpu_seconds,
            "file": BOX_FILE,
        }
    if certificate is None:
        return {
            "strength": "SampledCheck",
            "proved": False,
            "step_proved": design.step_proof.proved,
            "reason": proof.reason,
            "cpu_s": proof.cpu_seconds,
            "for_all_tolerances": tolerances,
        }
    return {
        "strength": "Certificate",
        "proved": True,
        "feedback": certificate.feedback,
        "parameters": "tolerances" if covers_tolerances(design) else "nominal",
        "gamma": certificate.gamma,
        "level": certificate.level,
        "sampled_level": certificate.sampled_level,
        "steps": {RULES.get(s.rule, (s.rule,))[0]: s.amplitude for s in certificate.starts},
        "step_proved": design.step_proof.proved,
        "latency_samples": 0,
        "start": proof.start,
        "starts_inside": proof.inside,
        "spent": proof.budget[-1].budget.total if proof.budget else math.nan,
        "lasts": proof.lasts,
        "attained_gain": certificate.attained_gain,
        "cpu_s": proof.cpu_seconds,
        "file": "certificate.json",
        "for_all_tolerances": tolerances,
    }


# The section --------------------------------------------------------------------------------------------
def region(design: PoseEvidence) -> Blocks:
    """The sampled region: level set and step of every degree, the attained gain, the dissipation budget."""
    attained, proved = design.attenuation.attained, design.synthesis.proved
    yield from _notes(design)
    yield Paragraph(_degree_text(design))
    yield from _proof(design)
    if proved is None:
        unit, most, rows = units_of(design.evaluation).position, widest_step(design), list[Sequence[object]]()
        for c in design.choices:
            level = "–" if not c.looked else "none" if math.isnan(c.level) else number(c.level)
            level = "everything sampled" if c.looked and math.isinf(c.level) else level
            step = amplitude_text(c.step_amplitude, unit, most) if c.looked else "–"
            cost, used = _cost(c, design.choices[0]), "used" if c is design.chosen else ""
            checks = (c.limit, number(c.residual, 1), 1e3 * c.solve_seconds, c.check_seconds)
            rows.append((c.degree, law_name(c.degree), used, level, step, cost, *checks))
        yield from (
            Paragraph(
                "Of every degree: the largest level set of V in which no violation of the dissipation inequality was "
                f"found, along random rays and by ascent: {_strength(design)}. Checked is a weaker pair than the "
                "designed "
                f"one, γ = {design.specification.checked_gamma_ratio:g} γ* and the penalty under Settings, for the law "
                "with the true state. The largest step moves all joints alike and starts with the integrals at which "
                "V is smallest; a controller starts with those at which the input does not jump, where V is larger."
            ),
            Table(
                (
                    Column("degree of V", brief="degree"),
                    "law",
                    "",
                    Column("V up to", brief="V ≤"),
                    Column("largest step sampled, V smallest", brief="sampled step"),
                    Column("cost of the step", brief="cost"),
                    Column("limited by", brief=None),
                    "residual",
                    Column("solve", "ms", 1),
                    Column("check", "s", 1),
                ),
                rows,
                "Step: of all joints alike, from rest to rest, with the integrals at which V is smallest",
                "table-region",
                stacks=True,
                title=f"{textwrap.fill(_degree_text(design), WIDTH)}\nRegion of each solution: {_strength(design)}\n"
                "Sampled step: with the integrals at which V is smallest, not the controller's",
            ),
        )
    if attained is not None and proved is not None:
        names = ", ".join(name.replace("_", " ") for name in proved.problem.disturbance_names)
        yield Paragraph(
            f"√(∫|z|²/∫|d|²) from the {names} to {penalty_text(design)} is proved to be at most "
            f"γ = {at_most(proved.gamma)}, for every robot of the box. A disturbance found by search attains "
            f"{number(attained.gain)} on the nominal robot, {number(100.0 * attained.gain / proved.gamma, 3)} % of γ, "
            f"with an energy ∫|d|² of {number(attained.energy, 3)}. The largest gain lies between the two."
        )
    elif attained is not None:
        yield Paragraph(
            "γ bounds √(∫|z|²/∫|d|²) from above for the law with the true state fed back, in a region where the "
            f"inequality holds. A search for the worst disturbance found {number(attained.gain)}, "
            f"{number(100.0 * attained.gain / design.gamma, 3)} % of γ, with an energy ∫|d|² of "
            f"{number(attained.energy, 3)} and V up to {number(attained.largest_value)} of "
            f"{number(design.chosen.level)}. The true value lies between the two, or above γ where the region is wrong."
        )
    if attained is not None or proved is not None:
        yield level_table(design)
    if budget_of(design):
        yield from _budget(design)


def _notes(design: PoseEvidence) -> Blocks:
    attained, proved = design.attenuation.attained, design.synthesis.proved
    for low, high in shrinking(design.choices):
        yield note(f"Degree {high} allows a smaller step than degree {low}.")
    if design.attenuation.failure:
        yield note(design.attenuation.failure)
    if attained is not None and proved is None and attained.gain > design.gamma:
        yield note(
            f"The disturbance found attains {number(attained.gain)}, more than γ = {number(design.gamma)}: the law "
            "does not keep its level there, because the truncated V or the sampling leaves too much out."
        )
    for budget in (term.budget for term in budget_of(design)[-1:]):
        if np.isfinite(budget.level) and not budget.kept:
            yield note(
                f"The step begins inside the region, but its parts use {number(budget.total, 3)} of the "
                f"level {number(budget.level - budget.start, 3)} that remains after V(x0). Nothing follows from "
                "the region for this step. Try a shorter --period, a faster estimator, or a smaller step."
            )
    if not design.chosen.looked and proved is None:
        why = (
            f": with {len(design.problem.state_names)} states it takes minutes. `--set rays=50` samples one."
        )
        yield note(f"No region was sampled{why if design.specification.rays is None else ' (--set rays=0).'}")


def _proof(design: PoseEvidence) -> Blocks:
    certificate, box = design.proof.certificate, design.proof.box
    if certificate is not None:
        covers, share, sampled = covers_tolerances(design), "was", certificate.sampled_level
        if sampled is not None:
            share = f"is {number(100.0 * certificate.level / sampled, 3)} % of the sampled one,"
        yield from (
            Paragraph(
                f"The level V ≤ {at_least(certificate.level, 5)} {share} proved in "
                f"{number(design.proof.cpu_seconds, 2)} s "
                "of CPU with exact (outward rounded) arithmetic; the theorem stands in `certificate.json`, which "
                "another program proves again:"
            ),
            Listing("flexhinf certify --check certificate.json"),
        )
        others = "parameters outside the tolerances" if covers else "other values of the parameters"
        yield Paragraph(
            f"Not covered by the proof: {others}; estimator, sampling, hold, delay, limits and noise"
            f"{'' if covers else ', of which the budget below looks at one simulated run'}. A planned move and "
            "payloads are judged by runs."
        )
    if box is not None:
        yield from (
            Paragraph(
                f"The proof for all robots within the tolerances took {number(box.cpu_seconds, 2)} s of CPU. Its V is "
                "another one, so its level and the budget below do not compare:"
            ),
            Listing(f"flexhinf certify --check {BOX_FILE}"),
        )
    elif reason := design.proof.box_reason.rstrip("."):
        yield Paragraph(f"For all robots within the tolerances nothing is proved: {reason}.")


def _degree_text(design: PoseEvidence) -> str:
    chosen, (lowest, *higher), proved = design.chosen, design.choices, design.synthesis.proved
    used = f"V of degree {chosen.degree} is used, a {law_name(chosen.degree)} law"
    if proved is not None:
        return (
            f"{used}: of {count_text(proved.candidates, 'candidate')} within the largest input, by rising gain, the "
            "first that is proved."
        )
    if not higher:
        return f"{used}: the only one that was tried."
    if design.specification.via:
        return f"{used}: with laws at several poses the robot is never far from the nearest one."
    if all(math.isnan(choice.cost) for choice in higher):
        return (
            f"{used}: along its step the laws of higher degree would change the input by "
            f"{100.0 * max(choice.acting for choice in higher):.2g} % of its largest deviation from the goal's (below "
            f"{100.0 * ACTING:.2g} % nothing is gained)."
        )
    steps = "; ".join(
        f"degree {choice.degree} {_cost(choice, lowest)}"
        + (f" (but misses: {', '.join(choice.missed)})" if choice.missed else "")
        for choice in higher
    )
    return (
        f"{used}. By the cost of the step, ∫|z|² without the integrals, against degree {lowest.degree}: {steps}. A "
        f"higher degree is used where it saves more than {100.0 * GAIN:.2g} % and keeps the same limits."
    )


def _cost(choice: DegreeChoice, lowest: DegreeChoice) -> str:
    if math.isnan(choice.cost) or choice is lowest:
        return "–" if math.isnan(choice.cost) else "0 %"
    if math.isinf(choice.cost) or math.isinf(lowest.cost):
        return "diverges" if math.isinf(choice.cost) else "finite"
    return f"{100.0 * (choice.cost / lowest.cost - 1.0):+.2g} %".replace("-", "−")


def _strength(design: PoseEvidence) -> str:
    certificate = design.proof.certificate
    own = "" if certificate is None else f"; of the law that is used V ≤ {at_least(certificate.level)} is"
    return f"sampled{own or ', not'} proved"


def widest_step(design: PoseEvidence) -> float:
    """The widest step of all joints alike, to the goal, that the joints' limits allow; infinite without limits."""
    ranges = [(-np.inf, np.inf) if limits is None else limits for limits in design.robot.links.limits]
    rooms = [(goal - low, high - goal) for goal, (low, high) in zip(design.goal.tolist(), ranges)]
    return float(max(min(side) for side in zip(*rooms)))


def level_table(design: PoseEvidence) -> Table:
    """Levels of attenuation from the smallest feasible one to the checked or proved one, and the lower bound found;
    in a terminal too where one is proved."""
    worst, proved, title = design.attenuation.attained, design.synthesis.proved, ""
    attained = [] if worst is None else [("worst disturbance found (lower bound)", worst.gain)]
    if proved is not None:
        star = ("γ* of this z, nominal robot near the goal, any law", proved.gamma_star)
        rows = [star, *attained, ("γ that is proved", proved.gamma)]
        title = f"{textwrap.fill(_degree_text(design), WIDTH)}\nGain √(∫|z|²/∫|d|²), {penalty_text(design)}"
    else:
        rows = [
            ("γ* of the problem, linear part", design.gamma_star),
            *attained,
            ("γ of the law", design.gamma),
            (
                "γ of the inequality checked in the region",
                design.specification.checked_gamma_ratio * design.gamma_star,
            ),
        ]
    return Table(
        ("√(∫|z|²/∫|d|²)", Column("value", digits=4)),
        rows,
        "Levels of attenuation",
        "table-attained",
        title=title,
    )


# Dissipation budget -------------------------------------------------------------------------------------
def budget_of(design: PoseEvidence) -> Sequence[BudgetTerm]:
    """The budget of the step against the proved level, or against the sampled one where nothing is proved; none where
    the step starts outside."""
    return design.attenuation.budget if design.proof.certificate is None else design.proof.budget


def _budget(design: PoseEvidence) -> Blocks:
    terms, which = budget_of(design), "sampled" if design.proof.certificate is None else "proved"
    budget, attained = terms[-1].budget, design.attenuation.attained
    bounded, outcome = np.isfinite(budget.level), "the loop with all its parts diverges."
    if np.isfinite(budget.total):
        judged = "this is within the budget" if budget.kept else "the budget is exceeded"
        against = f", of the {which} level of {number(budget.level)}: {judged}."
        outcome = (
            f"V(x0) is {number(budget.start)} and {number(budget.total, 3)} is used"
            f"{against if bounded else '; no region was sampled to compare it with.'}"
        )
    yield Paragraph(
        "Dissipation budget. What makes the input differ by v from the law's own, on the true state at every instant, "
        "uses ½∫vᵀR2v of the level. While V(x0) and this stay below it, the inequality holds for the controller as it "
        f"runs. In one simulated run of the step of the nominal robot, extras left out, {outcome} Of other runs and "
        "other noise this says nothing."
    )
    what = {
        "sampling": "the input is held between samples",
        "delay": "the input is delayed",
        "estimator": "the state is estimated from noisy sensors",
        "saturation": "the input is limited",
    }
    lower_bound = ""
    if attained is not None:
        gains = f"{number(attained.gain)} found (lower bound), γ = {number(design.gamma)} designed"
        lower_bound = f"√(∫|z|²/∫|d|²): {gains}\n"
    yield Table(
        (
            Column("part of the loop", brief="part"),
            Column("uses ½∫vᵀR2v", digits=3, brief="uses"),
            Column("with all above", digits=3),
            Column("remaining level", digits=4, brief="remaining"),
            "within the budget",
        ),
        [
            (
                what[term.name],
                term.added,
                b.total,
                finite(b.left),
                ("yes" if b.kept else "NO") if np.isfinite(b.level) else None,
            )
            for term, b in ((term, term.budget) for term in terms)
        ],
        "Parts are added one after the other",
        "table-budget",
        stacks=True,
        title=f"{lower_bound}Dissipation budget of the step",
    )
    if budget.complete:
        yield lambda: _budget_figure(terms[-1])


def _budget_figure(term: BudgetTerm) -> Figure:
    budget = term.budget
    few, bound = thin(budget.times), budget.start + budget.disturbance + budget.spent
    curves = ((bound, "V(x0) + ½∫vᵀR2v until then", SERIES[1]), (budget.value, "V", SERIES[0]))
    near = np.isfinite(budget.level) and 0.05 * budget.level < float(bound.max())  # the level is drawn then
    far = "" if near or not np.isfinite(budget.level) else f" The level, {budget.level:.3g}, is far above."
    return draw_figure(
        "budget",
        [
            Panel(
                "V",
                "",
                [
                    Line(budget.times[few], values[few], name, {"color": color})
                    for values, name, color in curves
                ],
                dashed=[(budget.level, INK, "level of the region")] if near else [],
                y=(0.0, None),
            )
        ],
        f"V along the step of the nominal robot, and its bound.{far}",
        "Dissipation budget",
    )
