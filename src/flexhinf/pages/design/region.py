"""What is proved of the law, where each solution was checked by samples, the worst disturbance, and the budget."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np

from flexhinf.analysis import BudgetTerm
from flexhinf.design.result import Design
from flexhinf.design.synthesis.degrees import ACTING, GAIN, DegreeChoice, shrinking
from flexhinf.hinf import smallest_gamma
from flexhinf.pages.drawing import (
    DASHED,
    Blocks,
    amplitude_text,
    count_text,
    figure_block,
    law_name,
    note,
    thin,
    units_of,
)
from flexhinf.pages.proof import BOX_FILE, covers_tolerances, penalty_text
from flexhinf.report import (
    INK,
    SERIES,
    Column,
    Figure,
    Listing,
    Paragraph,
    Table,
    at_least,
    at_most,
    label,
    legend,
    new_figure,
    number,
)
from flexhinf.report.table import WIDTH

PARTS = {
    "sampling": "the input is held between samples",
    "delay": "the input is delayed",
    "estimator": "the state is estimated from noisy sensors",
    "saturation": "the input is limited",
}

#: The level is drawn where the bound reaches this fraction of it.
NEAR = 0.05


def region(design: Design) -> Blocks:
    """Level set and step of every degree; the gain found; the budget."""
    attained, proved = design.attenuation.attained, design.synthesis.proved
    yield from _notes(design)
    yield Paragraph(_degree_text(design))
    yield from _proof(design)
    if proved is None:
        yield Paragraph(
            "Of every degree: the largest level set of V in which no violation of the dissipation inequality was "
            f"found, along random rays and by ascent: {_strength(design)}. Checked is a weaker pair than the designed "
            f"one, γ = {design.specification.checked_gamma_ratio:g} γ* and the penalty under Settings, for the law "
            "with the true state. The largest step moves all joints alike and starts with the integrals at which V is "
            "smallest; a controller starts with those at which the input does not jump, where V is larger."
        )
        yield _region_table(design)
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


def _notes(design: Design) -> Blocks:
    """What does not follow from the region."""
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
        why = f": with {len(design.problem.state_names)} states it takes minutes. `--rays 50` samples one."
        yield note(f"No region was sampled{why if design.specification.rays is None else ' (--rays 0).'}")


def _proof(design: Design) -> Blocks:
    certificate, box = design.proof.certificate, design.proof.box
    if certificate is not None:
        covers, level = covers_tolerances(design), f"The level V ≤ {at_least(certificate.level, 5)} was"
        if certificate.sampled_level is not None:
            share = number(100.0 * certificate.level / certificate.sampled_level, 3)
            level = f"The level V ≤ {at_least(certificate.level, 5)} is {share} % of the sampled one,"
        others = "parameters outside the tolerances" if covers else "other values of the parameters"
        yield Paragraph(
            f"{level} proved in {number(design.proof.cpu_seconds, 2)} s of CPU with exact (outward rounded) "
            "arithmetic; the theorem stands in `certificate.json`, which another program proves again:"
        )
        yield Listing("flexhinf certify --check certificate.json")
        yield Paragraph(
            f"Not covered by the proof: {others}; estimator, sampling, hold, delay, limits and noise"
            f"{'' if covers else ' beyond the budget below'}. A planned move and payloads are judged by runs."
        )
    if box is not None:
        yield Paragraph(
            f"The proof for all robots within the tolerances took {number(box.cpu_seconds, 2)} s of CPU. Its V is "
            "another one, so its level and the budget below do not compare:"
        )
        yield Listing(f"flexhinf certify --check {BOX_FILE}")
    elif reason := design.proof.box_reason.rstrip("."):
        yield Paragraph(f"For all robots within the tolerances nothing is proved: {reason}.")


def _degree_text(design: Design) -> str:
    """Which degree is used, and why."""
    chosen, (lowest, *higher) = design.chosen, design.choices
    used = f"V of degree {chosen.degree} is used, a {law_name(chosen.degree)} law"
    if design.synthesis.proved is not None:
        count = count_text(design.synthesis.proved.candidates, "candidate")
        return f"{used}: of {count} within the largest input the one with the smallest gain that is proved."
    if not higher:
        return f"{used}: the only one that was tried."
    if design.specification.via:
        return f"{used}: with laws at several poses the robot is never far from the nearest one."
    if all(math.isnan(choice.cost) for choice in higher):
        most = max(choice.acting for choice in higher)
        return (
            f"{used}: along its step the laws of higher degree would change the input by {100.0 * most:.2g} % of its "
            f"largest deviation from the goal's (below {100.0 * ACTING:.2g} % nothing is gained)."
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
    """The cost of a step relative to that of the lowest degree: "−5.9 %"."""
    if math.isnan(choice.cost) or choice is lowest:
        return "–" if math.isnan(choice.cost) else "0 %"
    if math.isinf(choice.cost):
        return "diverges"
    if math.isinf(lowest.cost):
        return "finite"
    return f"{100.0 * (choice.cost / lowest.cost - 1.0):+.2g} %".replace("-", "−")


def _strength(design: Design) -> str:
    """Of the regions of all degrees; of the law that is used, more may be proved."""
    certificate = design.proof.certificate
    if certificate is None:
        return "sampled, not proved"
    return f"sampled; of the law that is used V ≤ {at_least(certificate.level)} is proved"


def _region_table(design: Design) -> Table:
    """Level set, step and cost of each degree."""
    unit, most = units_of(design.evaluation).position, widest_step(design)
    rows = []
    for c in design.choices:
        level = "–" if not c.looked else "none" if math.isnan(c.level) else f"{c.level:.4g}"
        level = "everything sampled" if c.looked and math.isinf(c.level) else level
        step = amplitude_text(c.step_amplitude, unit, most) if c.looked else "–"
        cost, used = _cost(c, design.choices[0]), "used" if c is design.chosen else ""
        times = (1e3 * c.solve_seconds, c.check_seconds)
        residual = f"{c.residual:.0e}"
        rows.append((c.degree, law_name(c.degree), used, level, step, cost, c.limit, residual, *times))
    columns = (
        Column("degree of V", brief="degree"), "law", "", Column("V up to", brief="V ≤"),
        Column("largest step sampled, V smallest", brief="sampled step"), Column("cost of the step", brief="cost"),
        Column("limited by", brief=None), "residual", Column("solve", "ms", 1), Column("check", "s", 1),
    )  # fmt: skip
    caption = "Step: of all joints alike, from rest to rest, with the integrals at which V is smallest"
    title = (
        f"{textwrap.fill(_degree_text(design), WIDTH)}\nRegion of each solution: {_strength(design)}\n"
        "Sampled step: with the integrals at which V is smallest, not the controller's"
    )
    return Table(columns, rows, caption, "table-region", stacks=True, title=title)


def widest_step(design: Design) -> float:
    """The widest step of all joints alike, to the goal, that the joints' limits allow; infinite without limits."""
    ranges = [(-np.inf, np.inf) if limits is None else limits for limits in design.robot.links.limits]
    rooms = [(goal - low, high - goal) for goal, (low, high) in zip(design.goal.tolist(), ranges)]
    return float(max(min(side) for side in zip(*rooms)))


def level_table(design: Design) -> Table:
    """Levels of attenuation from the smallest feasible one to the checked or proved one, and the lower bound found;
    in a terminal too where one is proved."""
    s, worst, proved = design.specification, design.attenuation.attained, design.synthesis.proved
    attained = [] if worst is None else [("worst disturbance found (lower bound)", worst.gain)]
    title = ""
    if proved is not None:
        star = ("γ* of this z, nominal robot near the goal, any law", smallest_gamma(proved.problem))
        rows = [star, *attained, ("γ that is proved", proved.gamma)]
        title = f"{textwrap.fill(_degree_text(design), WIDTH)}\nGain √(∫|z|²/∫|d|²), {penalty_text(design)}"
    else:
        rows = [
            ("γ* of the problem, linear part", design.gamma_star),
            *attained,
            ("γ of the law", design.gamma),
            ("γ of the inequality checked in the region", s.checked_gamma_ratio * design.gamma_star),
        ]
    columns = ("√(∫|z|²/∫|d|²)", Column("value", digits=4))
    return Table(columns, rows, "Levels of attenuation", "table-attained", title=title)


# Dissipation budget -------------------------------------------------------------------------------------
def budget_of(design: Design) -> Sequence[BudgetTerm]:
    """The budget of the step against the proved level, or against the sampled one where nothing is proved; none where
    the step starts outside."""
    return design.attenuation.budget if design.proof.certificate is None else design.proof.budget


def budget_rows(design: Design) -> list[dict[str, Any]]:
    """For each part of the loop with all above it: what it adds, what is used in all, and the level that remains."""
    return [
        {
            "part": term.name, "added": term.added, "spent": term.budget.total, "start": term.budget.start,
            "level": term.budget.level, "left": term.budget.left, "kept": term.budget.kept,
        }
        for term in budget_of(design)
    ]  # fmt: skip


def _budget(design: Design) -> Blocks:
    """What the parts of the controller use of the level; the lower bound of the gain in the title."""
    records, which = budget_rows(design), "sampled" if design.proof.certificate is None else "proved"
    last, term = records[-1], budget_of(design)[-1]
    bounded, outcome = np.isfinite(last["level"]), "the loop with all its parts diverges."
    if last["spent"] is not None and np.isfinite(last["spent"]):
        judged = "this is within the budget" if last["kept"] else "the budget is exceeded"
        against = f", of the {which} level of {number(last['level'])}: {judged}."
        outcome = f"V(x0) is {number(last['start'])} and {number(last['spent'], 3)} is used"
        outcome += against if bounded else "; no region was sampled to compare it with."
    yield Paragraph(
        "Dissipation budget. What makes the input differ by v from the law's own, on the true state at every instant, "
        "uses ½∫vᵀR2v of the level. While V(x0) and this stay below it, the inequality holds for the controller as it "
        f"runs. For the step of the nominal robot, extras left out, {outcome}"
    )
    rows = [
        {
            **row,
            "text": PARTS[row["part"]],
            "left": row["left"] if np.isfinite(row["left"]) else None,
            "within": ("yes" if row["kept"] else "NO") if np.isfinite(row["level"]) else None,
        }
        for row in records
    ]
    columns = (
        Column("part of the loop", key="text", brief="part"),
        Column("uses ½∫vᵀR2v", digits=3, key="added", brief="uses"),
        Column("with all above", digits=3, key="spent"),
        Column("remaining level", digits=4, key="left", brief="remaining"),
        Column("within the budget", key="within"),
    )
    title, attained = "Dissipation budget of the step", design.attenuation.attained
    if attained is not None:
        gain = f"{number(attained.gain)} found (lower bound), γ = {number(design.gamma)} designed"
        title = f"√(∫|z|²/∫|d|²): {gain}\n{title}"
    caption = "Parts are added one after the other"
    yield Table.of(columns, rows, caption, "table-budget", stacks=True, title=title)
    if term.budget.complete:
        yield lambda: _budget_figure(term)


def _budget_figure(term: BudgetTerm) -> Figure:
    budget = term.budget
    few, bound = thin(budget.times), budget.start + budget.disturbance + budget.spent
    near = np.isfinite(budget.level) and NEAR * budget.level < float(bound.max())
    figure, (axis,) = new_figure(1)
    axis.plot(budget.times[few], bound[few], color=SERIES[1], label="V(x0) + ½∫vᵀR2v until then")
    axis.plot(budget.times[few], budget.value[few], color=SERIES[0], label="V")
    if near:
        axis.axhline(budget.level, color=INK, linewidth=1.0, dashes=DASHED, label="level of the region")
    axis.set_ylim(bottom=0.0)
    label(axis, "V", "")
    legend(axis)
    far = "" if near or not np.isfinite(budget.level) else f" The level, {budget.level:.3g}, is far above."
    caption = f"V along the step of the nominal robot, and its bound.{far}"
    return figure_block("budget", figure, caption, "Dissipation budget")
