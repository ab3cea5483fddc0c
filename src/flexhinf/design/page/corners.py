"""The linearised loop at the corners of the tolerances, over the process noise that the estimator assumes."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from flexhinf.campaign import Swept
from flexhinf.campaign.sweep import ALL_STATES
from flexhinf.design.page.notes import section_notes
from flexhinf.design.result import Design
from flexhinf.design.tolerances import Tolerances
from flexhinf.report import Column, Paragraph, Section, Table, number

__all__ = ["SweepRow", "corners_section", "sweep_rows"]


class SweepRow(NamedTuple):
    """One R^v: what it is, plants that are unstable, their share in per cent, and the fastest growth rate, 1/s."""

    what: str
    unstable: int
    percent: float
    rate: float


def corners_section(design: Design) -> Section | None:
    """Shares that are unstable; None for a robot without tolerances."""
    tolerances = design.tolerances
    if tolerances is None:
        return None
    blocks: list[Any] = [*section_notes(design, "corners"), Paragraph(_words(tolerances)), _table(design)]
    return Section("Corners of the tolerances", tuple(blocks), "corners")


def sweep_rows(design: Design) -> list[SweepRow]:
    """As designed, with the true state, then q on all states and on the velocities alone."""
    tolerances = design.tolerances
    assert tolerances is not None
    rows = [_row("true state fed back", tolerances.with_state)]
    if design.specification.estimator != "none":
        rows.insert(0, _row("the estimator as designed", tolerances.own))
    for swept, ratio in zip(tolerances.swept, tolerances.ratios):
        assert swept.noise is not None
        form = "all states" if swept.noise.form == ALL_STATES else "velocities"
        rows.append(_row(f"q on {form}, q/R^n = {number(ratio, 2)}", swept))
    return rows


def _row(what: str, swept: Swept) -> SweepRow:
    return SweepRow(what, int((swept.rates >= 0.0).sum()), 100.0 * swept.share(), float(swept.rates.max()))


def _words(tolerances: Tolerances) -> str:
    population, worst = tolerances.population, tolerances.own.worst
    kinds = {kind: int((population.kinds == kind).sum()) for kind in ("corner", "single")}
    return (
        f"{kinds['corner']} corners of the tolerances, {kinds['single']} plants with one number at one end, and the nominal "
        "one: is the sampled loop at the goal, linearised, stable with each? R^v of the estimator is a guess, and its "
        "gain depends on q/R^n alone, so the guess is swept over. The plant that is worst for the loop as designed: "
        f"{population.describe(worst)}; its slowest mode {_grows(float(tolerances.own.rates[worst]))}."
    )


def _grows(rate: float) -> str:
    if not np.isfinite(rate):
        return "cannot be told, as the loop has no rest"
    return f"{'grows' if rate >= 0.0 else 'decays'} with {number(abs(rate), 3)} 1/s"


def _table(design: Design) -> Table:
    rows = [
        (row.what, row.unstable, row.percent, row.rate if np.isfinite(row.rate) else None)
        for row in sweep_rows(design)
    ]
    columns = ("R^v", "unstable", Column("share", "%", 1), Column("fastest growth", "1/s", 2))
    return Table(
        columns, rows, "Plants with which the loop is unstable; a negative growth decays", "table-corners"
    )
