"""Where the solution can be trusted: looked at, not proved."""

from __future__ import annotations

import math

from flexhinf.design.page.notes import section_notes
from flexhinf.design.page.units import step_words, units_of
from flexhinf.design.page.words import law_name
from flexhinf.design.result import Design
from flexhinf.report import Column, Paragraph, Section, Table

__all__ = ["region_section"]


def region_section(design: Design) -> Section:
    """Level set and step of every degree."""
    blocks = (*section_notes(design, "region"), Paragraph(_words(design)), _table(design))
    return Section("Where the solution can be trusted", blocks, "region")


def _words(design: Design) -> str:
    s = design.specification
    return (
        "The largest level set of V on which nothing was found against the dissipation inequality, along random "
        "rays and by ascent from many starts: sampled, not proved. Checked is the weaker pair "
        f"γ = {s.checked_gamma_ratio:g} γ* and the penalty of the settings. It covers the law with the true state, "
        "not the estimator. Where the checked pair has no margin in some direction there is no region. Of the degrees "
        "tried, the one with the largest step is used (the highest one where no degree has a region)."
    )


def _table(design: Design) -> Table:
    unit = units_of(design).position
    rows = [
        (
            c.degree,
            law_name(c.degree),
            "chosen" if c is design.chosen else "",
            _level(c.level),
            step_words(c.step_amplitude, unit),
            c.limit,
            f"{c.residual:.0e}",
            1e3 * c.solve_seconds,
            c.check_seconds,
        )
        for c in design.choices
    ]
    columns = (
        "degree of V",
        "law",
        "",
        "V up to",
        "rest-to-rest step of all joints",
        "limited by",
        "residual",
        Column("solve", "ms", 1),
        Column("check", "s", 1),
    )
    return Table(columns, rows, "", "table-region")


def _level(value: float) -> str:
    if math.isnan(value):
        return "–"
    return "everything looked at" if math.isinf(value) else f"{value:.4g}"
