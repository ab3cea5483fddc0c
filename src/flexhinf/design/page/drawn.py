"""The step on robots within their tolerances, with the controller as it was designed."""

from __future__ import annotations

from typing import Any

import numpy as np

from flexhinf.design.draws import Draws
from flexhinf.design.page.changes import change_words
from flexhinf.design.page.drawn_figure import fan_figure, spread_figure
from flexhinf.design.page.notes import section_notes
from flexhinf.design.page.units import units_of
from flexhinf.design.page.words import largest_overshoot, peak_input, slowest_settling
from flexhinf.design.result import Design
from flexhinf.report import Paragraph, Section, Table, number

__all__ = ["drawn_section", "spread_rows", "worst_draw"]


def drawn_section(design: Design) -> Section | None:
    """Fan, histograms and table; None where nothing was drawn."""
    draws = design.draws
    if draws is None or not len(draws):
        return None
    blocks: list[Any] = [*section_notes(design, "draws"), Paragraph(_words(design, draws))]
    return Section(
        f"The step on {len(draws)} robots within their tolerances",
        (*blocks, *fan_figure(design, worst_draw(draws)), *spread_figure(design), _table(design, draws)),
        "draws",
    )


def worst_draw(draws: Draws) -> int:
    """The robot that settles last; of those that never do, the one that passes the goal most."""
    return int(np.lexsort((draws.overshoot, draws.settling))[-1])


def _words(design: Design, draws: Draws) -> str:
    count = len(design.robot.uncertain)
    worst = worst_draw(draws)
    return (
        f"{count} numbers of the robot are drawn uniformly within their tolerances, {len(draws)} times; the controller "
        "and its estimator stay as designed for the nominal robot, and noise differs from robot to robot. The robot "
        f"that settles last (number {worst + 1}): {change_words(design, draws.values[worst])}."
    )


def spread_rows(design: Design) -> list[tuple[str, str, float | None, *tuple[float, ...]]]:
    """Figure of merit, unit, nominal, median, 95th percentile and worst; infinite for runs without one."""
    draws, unit = design.draws, units_of(design).effort
    assert draws is not None
    nominal = (
        largest_overshoot(design.response),
        slowest_settling(design.response),
        peak_input(design.response),
    )
    merits = (
        ("overshoot", "%", draws.overshoot),
        ("settling time", "s", draws.settling),
        ("peak input", unit, draws.peak),
    )
    return [
        (name, kind, value, *(float(np.quantile(found, q, method="higher")) for q in (0.5, 0.95, 1.0)))
        for (name, kind, found), value in zip(merits, nominal)
    ]


def _table(design: Design, draws: Draws) -> Table:
    rows = [(name, unit, *(_cell(value) for value in values)) for name, unit, *values in spread_rows(design)]
    settled = f"{len(draws) - draws.unsettled} of {len(draws)} settle, {draws.diverged} diverge"
    columns = ("", "unit", "nominal robot", "median", "95 % are below", "worst")
    return Table(columns, rows, f"Worst joint of each robot: {settled}", "table-draws")


def _cell(value: float | None) -> str:
    if value is None:
        return "–"
    return "never" if np.isinf(value) else number(value, 3)
