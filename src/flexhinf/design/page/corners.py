"""The linearised loop at the corners of the tolerances, over the process noise that the estimator assumes."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from flexhinf.analysis import ALL_STATES, VELOCITIES, GrowthRates
from flexhinf.design.page.changes import change_words
from flexhinf.design.page.notes import section_notes
from flexhinf.design.result import Design
from flexhinf.design.tolerances import Tolerances
from flexhinf.report import Paragraph, Section, Table, number

__all__ = ["SweepRow", "corners_section", "sweep_cells", "sweep_rows", "sweep_words"]


class SweepRow(NamedTuple):
    """One loop.

    Attributes
    ----------
    form : {"as designed", "true state", "all states", "velocities only"}
        The last two: where q stands in Rᵛ.
    ratio : float or None
        q / Rⁿ, of these two.
    unstable : int
        Plants.
    percent, rate : float
        Their share, and the fastest growth of all, 1/s.
    """

    form: str
    ratio: float | None
    unstable: int
    percent: float
    rate: float


def corners_section(design: Design) -> Section | None:
    """Shares that are unstable; None for a robot without tolerances."""
    tolerances = design.tolerances
    if tolerances is None:
        return None
    blocks: list[Any] = [*section_notes(design, "corners"), Paragraph(_words(design, tolerances))]
    blocks += [_table(design)] if tolerances.swept else []
    return Section("Corners of the tolerances", tuple(blocks), "corners")


def sweep_rows(design: Design) -> list[SweepRow]:
    """As designed, with the true state, then q on all states and on the velocities alone."""
    tolerances = design.tolerances
    assert tolerances is not None
    rows = [_row("true state", None, tolerances.with_state)]
    if design.specification.estimator != "none":
        rows.insert(0, _row("as designed", None, tolerances.own))
    for swept, ratio in zip(tolerances.swept, tolerances.ratios):
        assert swept.noise is not None
        rows.append(_row(swept.noise.form, ratio, swept))
    return rows


def _row(form: str, ratio: float | None, swept: GrowthRates) -> SweepRow:
    unstable = int((swept.rates >= 0.0).sum())
    return SweepRow(form, ratio, unstable, 100.0 * swept.share(), float(swept.rates.max()))


def sweep_cells(design: Design) -> list[tuple[str, str, str, str, str]]:
    """q / Rⁿ, then plants that are unstable and fastest growth of either form."""
    rows = sweep_rows(design)
    found = {(row.form, row.ratio): row for row in rows}
    ratios = dict.fromkeys(row.ratio for row in rows if row.ratio is not None)
    cells = []
    for ratio in ratios:
        every, moving = found[ALL_STATES, ratio], found[VELOCITIES, ratio]
        cells.append((_power(ratio), *_cells(every), *_cells(moving)))
    return cells


def _cells(row: SweepRow) -> tuple[str, str]:
    share = f"{row.unstable} ({number(row.percent, 2)} %)" if row.unstable else "0"
    return share, number(row.rate, 3) if np.isfinite(row.rate) else "no rest"


def _power(ratio: float) -> str:
    exponent = round(float(np.log10(ratio)))
    return number(10.0**exponent, 1).removeprefix("1·") if abs(exponent) > 3 else number(ratio)


def sweep_words(design: Design) -> str:
    """How many are unstable as the loop is, and with the true state."""
    told = {"as designed": "as designed", "true state": "with the true state fed back"}
    rows = [row for row in sweep_rows(design) if row.form in told]
    assert design.tolerances is not None
    found = " and ".join(f"{row.unstable} {told[row.form]}" for row in rows)
    return f"of {len(design.tolerances.population)} plants unstable: {found}"


def _words(design: Design, tolerances: Tolerances) -> str:
    population, worst = tolerances.population, tolerances.own.worst
    kinds = {kind: int((population.kinds == kind).sum()) for kind in ("corner", "single")}
    furthest = change_words(design, population.values[worst])
    text = (
        f"{kinds['corner']} corners of the tolerances, {kinds['single']} plants with one number at one end, and the "
        "nominal one: is the sampled loop at the goal, linearised, stable with each? "
        f"{sweep_words(design).capitalize()}. The worst for the loop as designed is {furthest}; "
        f"there its slowest mode {_grows(float(tolerances.own.rates[worst]))}."
    )
    if not tolerances.swept:
        return text
    return (
        text + " Rᵛ of an estimator is a guess, and its gain depends on q/Rⁿ alone: the guess is swept over."
    )


def _grows(rate: float) -> str:
    if not np.isfinite(rate):
        return "cannot be told, as the loop has no rest"
    return f"{'grows' if rate >= 0.0 else 'decays'} with {number(abs(rate), 3)} 1/s"


def _table(design: Design) -> Table:
    columns = (
        "q/Rⁿ",
        "q on all states: unstable",
        "fastest growth, 1/s",
        "q on velocities: unstable",
        "fastest growth, 1/s",
    )
    caption = "Plants with which the loop is unstable over Rᵛ; a negative growth decays"
    return Table(columns, sweep_cells(design), caption, "table-corners")
