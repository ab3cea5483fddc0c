"""Modes without control, with the law, and of the estimation error."""

from __future__ import annotations

from typing import Any

from flexhinf.design.modes import Mode
from flexhinf.design.page.modes_figure import modes_figure
from flexhinf.design.page.notes import section_notes
from flexhinf.design.page.words import range_of
from flexhinf.design.result import Design
from flexhinf.report import Column, Paragraph, Section, Table

__all__ = ["modes_section"]


def modes_section(design: Design) -> Section:
    """Drawn, and in a table."""
    blocks = (
        *section_notes(design, "modes"),
        modes_figure(design),
        _table(design),
        Paragraph(_decays(design)),
    )
    return Section("Modes", blocks, "modes")


def _table(design: Design) -> Table:
    loops = (
        ("without control", design.open_modes),
        ("with this law", design.closed_modes),
        ("estimation error", design.estimator_modes),
    )
    rows = [(name, *_row(mode)) for name, modes in loops for mode in modes if _told(mode)]
    columns = (
        "loop",
        "mode",
        "mainly",
        Column("frequency", "Hz", 3),
        Column("damping ratio"),
        Column("time constant", "s"),
    )
    return Table(columns, rows, "What oscillates or does not decay, linearised at the goal", "table-modes")


def _row(mode: Mode) -> tuple[Any, ...]:
    return mode.name, mode.joint, mode.frequency, mode.damping, mode.time_constant


def _told(mode: Mode) -> bool:
    """Whether a mode has a row of its own: what decays without oscillating is told in a sentence."""
    return bool(mode.eigenvalue.imag) or not mode.stable


def _decays(design: Design) -> str:
    words = []
    for name, modes in (("Without control", design.open_modes), ("with this law", design.closed_modes)):
        times = [1.0 / -mode.eigenvalue.real for mode in modes if not _told(mode)]
        many = f"{len(times)} modes decay" if len(times) != 1 else "1 mode decays"
        words.append(
            f"{name} {many} without oscillating"
            + (f" (time constant{'s' if len(times) > 1 else ''} {range_of(times)} s)" if times else "")
        )
    return "; ".join(words) + ". With the law, the integral of each joint's error adds a mode."
