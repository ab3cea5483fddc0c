"""Tables: names and units in the header, numbers lined up."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Integral, Real

from flexhinf.errors import InvalidInput
from flexhinf.report.blocks import check_id, escape, number, prose, scalar


@dataclass(frozen=True)
class Column:
    """A column's name and unit (shown in the header), and its fixed digits after the point, if any."""

    name: str
    unit: str = ""
    decimals: int | None = None


@dataclass(frozen=True)
class Table:
    """Rows under named columns.

    Columns of numbers are right-aligned with common decimals; None is shown as –.

    Parameters
    ----------
    rows : sequence of sequences
        Text, numbers, yes/no or None; as many as there are columns.
    id : str, optional
        An anchor.
    stacks : bool, optional
        Whether a narrow screen shows each row as a list of its cells, for tables with sentences in them; other tables
        scroll sideways in their frame.
    """

    columns: Sequence[Column | str]
    rows: Sequence[Sequence[object]]
    caption: str = ""
    id: str = ""
    stacks: bool = False

    def __post_init__(self) -> None:
        if self.id:
            check_id(self.id)
        for index, row in enumerate(self.rows):
            if len(row) != len(self.columns):
                raise InvalidInput(
                    "A row of a table does not fit its columns.",
                    f"expected {len(self.columns)} cells, got {len(row)} in row {index} of {self.caption!r}",
                    "None for a cell that has no value",
                )

    def html(self) -> str:
        """The table as HTML, in a frame that scrolls sideways on a narrow screen, or with rows that stack."""
        columns = [Column(column) if isinstance(column, str) else column for column in self.columns]
        cells = [[row[index] for row in self.rows] for index in range(len(columns))]
        numeric = [_is_numeric(values) for values in cells]
        written = [
            _numbers(values, column.decimals)
            if right
            else [scalar(value, column.decimals) for value in values]
            for column, values, right in zip(columns, cells, numeric, strict=True)
        ]
        css = [' class="number"' if right else "" for right in numeric]
        head = "".join(
            f'<th scope="col"{mark}>{prose(column.name)}{_unit(column.unit)}</th>'
            for column, mark in zip(columns, css, strict=True)
        )
        body = "".join(
            "<tr>"
            + "".join(
                f"<td{mark}{label}>{prose(text)}</td>"
                for mark, label, text in zip(css, self._labels(columns), row, strict=True)
            )
            + "</tr>"
            for row in zip(*written, strict=True)
        )
        anchor = f' id="{self.id}"' if self.id else ""
        kind = "table stacks" if self.stacks else "table"
        caption, named = "", ""
        if self.caption:  # above the table, not in it: a <caption> is no wider than its table
            mark = f' id="{self.id}-caption"' if self.id else ""
            named = f' aria-labelledby="{self.id}-caption"' if self.id else ""
            caption = f'<p class="caption"{mark}>{prose(self.caption)}</p>'
        return (
            f'<div class="{kind}"{anchor}>{caption}<table{named}><thead><tr>{head}</tr></thead>'
            f"<tbody>{body}</tbody></table></div>"
        )

    def _labels(self, columns: Sequence[Column]) -> list[str]:
        """What a stacked row repeats before each cell but its first."""
        if not self.stacks:
            return [""] * len(columns)
        names = [f"{column.name} {column.unit}".strip() for column in columns]
        return ["", *(f' data-label="{escape(name)}"' for name in names[1:])]

    def ids(self) -> tuple[str, ...]:
        """The table's anchor, if it has one."""
        return (self.id,) if self.id else ()


def _unit(unit: str) -> str:
    return f' <span class="unit">{escape(unit)}</span>' if unit else ""


def _is_numeric(values: Sequence[object]) -> bool:
    given = [value for value in values if value is not None]
    return bool(given) and all(isinstance(value, Real) and not isinstance(value, bool) for value in given)


def _numbers(values: Sequence[object], decimals: int | None) -> list[str]:
    """A column of numbers; common decimals where their sizes are comparable (4 digits for the largest)."""
    if decimals is None:
        sizes = [
            abs(float(value))
            for value in values
            if isinstance(value, Real)
            and not isinstance(value, Integral)
            and math.isfinite(value)
            and value != 0
        ]
        if sizes and max(sizes) < 1e4 * min(sizes) and 1e-3 <= max(sizes) < 1e6:
            decimals = max(0, 3 - math.floor(math.log10(max(sizes))))
    return ["–" if value is None else number(value, decimals=decimals) for value in values]  # pyright: ignore[reportArgumentType]
