"""The same table for a terminal: as many laws side by side as fit, the reference in each part."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from flexhinf.design.compare.result import Comparison, Row
from flexhinf.design.compare.table import Line, lines

if TYPE_CHECKING:
    from rich.table import Table

__all__ = ["comparison_tables"]

#: Characters between columns.
GAP = 2


def comparison_tables(comparison: Comparison, width: int = 80) -> list[Table]:
    """Tables of at most `width` columns; * marks the best of all laws."""
    first, found = comparison.first, []
    names = max(len(_label(line)) for line in lines(comparison, (first,), short=True))
    left = width - names - GAP - _width(comparison, first)
    part: list[Row] = [first]
    room = left
    for row in comparison.others:
        needed = _width(comparison, row)
        if needed > room and len(part) > 1:
            found.append(_part(comparison, part, not found))
            part, room = [first], left
        part.append(row)
        room -= needed
    return [*found, _part(comparison, part, not found)]


def _width(comparison: Comparison, row: Row) -> int:
    """Of a law's column."""
    cells = [len(_cell(line, 0)) for line in lines(comparison, (row,), short=True) if line.cells]
    return max(len(row.name), *cells) + GAP


def _label(line: Line) -> str:
    return f" {line.label}{', ' + line.unit if line.unit else ''}" if line.cells else line.label


def _cell(line: Line, place: int) -> str:
    return f"{line.cells[place]}{'*' if line.best[place] else ''}"


def _part(comparison: Comparison, rows: Sequence[Row], first: bool) -> Table:
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    title = f"{comparison.reference.robot.name}: laws on the same loop, * best of all" if first else None
    table = Table(
        title=title,
        title_justify="left",
        box=SIMPLE_HEAD,
        show_edge=False,
        pad_edge=False,
        padding=(0, GAP - 1, 0, 0),
    )
    table.add_column("", no_wrap=True)
    for row in rows:
        table.add_column(row.name, justify="right", no_wrap=True)
    for line in lines(comparison, rows, short=True):
        if line.cells:
            table.add_row(_label(line), *(_cell(line, place) for place in range(len(rows))))
        else:
            table.add_row(f"[bold]{line.label}[/]")
    return table
