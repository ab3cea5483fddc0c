"""What the promise of γ is worth: the worst disturbance found, and what the controller's parts spend of the region."""

from __future__ import annotations

from typing import Any

import numpy as np

from flexhinf.design.page.guarantee_figure import budget_figure
from flexhinf.design.page.notes import section_notes
from flexhinf.design.result import Design
from flexhinf.report import Paragraph, Section, Table, number

__all__ = ["attained_section", "budget_rows", "budget_section", "level_rows"]

PARTS = {
    "sampling": "the input held between samples",
    "delay": "the delay of the input",
    "estimator": "the estimator, and the noise of the sensors",
    "saturation": "the limits of the input",
}


def attained_section(design: Design) -> Section | None:
    """γ from above, a disturbance from below; None where none was looked for."""
    attained = design.guarantee.attained
    if attained is None:
        return None
    blocks = (*section_notes(design, "attained"), Paragraph(_attained_words(design)), _levels(design))
    return Section("The worst disturbance found", blocks, "attained")


def _attained_words(design: Design) -> str:
    found = design.guarantee.attained
    assert found is not None
    share = 100.0 * found.gain / design.solution.gamma
    return (
        "γ bounds √(∫|z|²/∫|d|²) from above for the law fed the true state, as long as the state stays in the sampled "
        f"region. A search for the disturbance that makes it largest bounds it from below: {number(found.gain)}, "
        f"{number(share, 3)} % of γ, with an energy ∫|d|² of {number(found.energy, 3)} and V up to "
        f"{number(found.largest_value)} of {number(design.chosen.level)}. The truth lies between."
    )


def level_rows(design: Design) -> list[tuple[str, float]]:
    """Levels from the smallest feasible to the checked one, and what was attained."""
    s, found = design.specification, design.guarantee.attained
    attained = [] if found is None else [("attained by the worst disturbance found", found.gain)]
    return [
        ("smallest level γ*, linear part", design.gamma_star),
        *attained,
        ("γ of the law", design.solution.gamma),
        ("γ of the inequality that was checked in the region", s.checked_gamma_ratio * design.gamma_star),
    ]


def _levels(design: Design) -> Table:
    rows = [(what, number(value)) for what, value in level_rows(design)]
    return Table(("√(∫|z|²/∫|d|²)", "value"), rows, "From below, and from above", "table-attained")


def budget_section(design: Design) -> Section | None:
    """The step's budget, part by part; None where there is none."""
    if not design.guarantee.expenses:
        return None
    blocks = [
        *section_notes(design, "budget"),
        Paragraph(_budget_words(design)),
        _expenses(design),
        *budget_figure(design),
    ]
    return Section("What sampling and estimator spend of the region", tuple(blocks), "budget")


def budget_rows(design: Design) -> list[dict[str, Any]]:
    """Of the loop with each part and all above: what it adds to ½ ∫ vᵀR2v, the whole, and what is left of the level."""
    return [
        {
            "part": expense.name,
            "added": expense.added,
            "spent": expense.budget.total,
            "start": expense.budget.start,
            "level": expense.budget.level,
            "left": expense.budget.left,
            "kept": expense.budget.kept,
        }
        for expense in design.guarantee.expenses
    ]


def _budget_words(design: Design) -> str:
    row = budget_rows(design)[-1]
    text = (
        "Whatever makes the input differ by v from the law's own, on the true state and at every instant, costs "
        "½∫vᵀR2v of the level: while V(x0) and this stay below it, so does V, and the promise holds for the controller "
        "as it runs. For the step of the nominal robot, extras left out, "
    )
    if row["spent"] is None or not np.isfinite(row["spent"]):
        return text + "the loop with all its parts diverges."
    text += f"V(x0) is {number(row['start'])} and {number(row['spent'], 3)} is spent"
    if not np.isfinite(row["level"]):
        return text + "; no region was looked at to hold it against."
    kept = "the budget lasts" if row["kept"] else "the budget does not last"
    if row["start"] > row["level"]:
        kept = "V(x0) alone is beyond it, so nothing follows for this step, however little is spent"
    return f"{text}, of a level of {number(row['level'])}: {kept}."


def _expenses(design: Design) -> Table:
    rows = []
    for row in budget_rows(design):
        left = number(row["left"]) if np.isfinite(row["left"]) else "–"
        kept = "–" if not np.isfinite(row["level"]) else ("yes" if row["kept"] else "NO")
        rows.append((PARTS[row["part"]], number(row["added"], 3), number(row["spent"], 3), left, kept))
    columns = ("part", "spends ½∫vᵀR2v", "with all above", "left of the level", "lasts")
    return Table(columns, rows, "Added one after the other", "table-budget")
