"""Tables: built once as data, written as HTML, for a terminal, and as records."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any

from flexhinf.errors import InvalidInput
from flexhinf.report.blocks import Block, check_id, escape, number, prose, scalar, unit_html

if TYPE_CHECKING:
    from rich.table import Table as Terminal

#: Columns of a terminal.
WIDTH = 80


@dataclass(frozen=True)
class Column:
    """How a column is headed and how its numbers are written: with so many `decimals` (numbers of comparable size get
    common ones), or each with so many significant `digits`.

    For `Table.of` it shows the entry `key` of a record, times `scale`. In a terminal the header is `brief` where it
    differs, and a column with None is left out; texts are aligned to the `right` too.
    """

    name: str
    unit: str = ""
    decimals: int | None = None
    digits: int | None = None
    key: str = ""
    scale: float = 1.0
    brief: str | None = ""
    right: bool = False


@dataclass(frozen=True)
class Cell:
    """A cell that stands out: `mark` is "best" or a colour, which only a terminal shows."""

    value: object
    mark: str = ""


@dataclass(frozen=True)
class Table(Block):
    """Rows under named columns.

    Columns of numbers are right-aligned; None is shown as –.

    Parameters
    ----------
    rows : sequence
        Each a sequence of text, numbers, yes/no, None or `Cell`, as many as there are columns; or one text, the title
        of the rows below it.
    caption, id : str, optional
        Above the table on a page; an anchor.
    stacks : bool, optional
        Whether a narrow screen shows each row as a list of its cells, for tables with sentences in them; other tables
        scroll sideways in their frame.
    title : str, optional
        In a terminal, instead of the caption.
    """

    columns: Sequence[Column | str]
    rows: Sequence[Sequence[object]]
    caption: str = ""
    id: str = ""
    stacks: bool = False
    title: str = ""

    def __post_init__(self) -> None:
        if self.id:
            check_id(self.id)
        for index, row in enumerate(self.rows):
            if not isinstance(row, str) and len(row) != len(self.columns):
                raise InvalidInput(
                    "A row of a table does not fit its columns.",
                    f"expected {len(self.columns)} cells, got {len(row)} in row {index} of {self.caption!r}",
                    "None for a cell that has no value",
                )

    @classmethod
    def of(
        cls, columns: Sequence[Column], records: Iterable[Mapping[str, Any]], *others: Any, **named: Any
    ) -> Table:
        """A table of records; columns say by `key` and `scale` what they show of each."""

        def cell(column: Column, value: Any) -> Any:
            return value if value is None or column.scale == 1.0 else column.scale * value

        rows = [tuple(cell(column, record.get(column.key)) for column in columns) for record in records]
        return cls(columns, rows, *others, **named)

    def records(self) -> list[dict[str, object]]:
        """Rows by the names of their columns."""
        names = [column.name for column in self.heads]
        return [dict(zip(names, row)) for row in self.rows if not isinstance(row, str)]

    @cached_property
    def heads(self) -> list[Column]:
        """The columns."""
        return [Column(column) if isinstance(column, str) else column for column in self.columns]

    @cached_property
    def _written(self) -> list[tuple[bool, list[str]]]:
        """Of each column whether it is right-aligned, and its texts."""
        found = []
        for index, column in enumerate(self.heads):
            cells = [row[index] for row in self.rows if not isinstance(row, str)]
            values: list[Any] = [cell.value if isinstance(cell, Cell) else cell for cell in cells]
            known = [value for value in values if value is not None]
            numeric = bool(known) and all(isinstance(v, Real) and not isinstance(v, bool) for v in known)
            decimals = column.decimals
            if numeric and decimals is None:  # 4 digits for the largest number, where sizes are comparable
                sizes = [
                    abs(float(v))
                    for v in known
                    if not isinstance(v, Integral) and math.isfinite(v) and v != 0
                ]
                if sizes and max(sizes) < 1e4 * min(sizes) and 1e-3 <= max(sizes) < 1e6:
                    decimals = max(0, 3 - math.floor(math.log10(max(sizes))))
            texts = [scalar(value, decimals) for value in values]
            if numeric and column.digits:
                texts = ["–" if v is None else number(v, column.digits) for v in values]
            found.append((numeric or column.right, texts))
        return found

    def _lines(self) -> Iterable[str | list[tuple[str, str]]]:
        """The title of some rows, or the texts and marks of one."""
        texts = zip(*(texts for _, texts in self._written))
        for row in self.rows:
            if isinstance(row, str):
                yield row
            else:
                yield [(text, getattr(cell, "mark", "")) for text, cell in zip(next(texts), row)]

    def html(self) -> str:
        """The table as HTML, in a frame that scrolls sideways on a narrow screen, or with rows that stack."""
        css = [' class="number"' if numeric else "" for numeric, _ in self._written]
        head = "".join(
            f'<th scope="col"{mark}>{prose(column.name)}{unit_html(column.unit)}</th>'
            for column, mark in zip(self.heads, css)
        )
        labels = [""] * len(css)
        if self.stacks:  # what a stacked row repeats before each cell but its first
            names = [f"{column.name} {column.unit}".strip() for column in self.heads[1:]]
            labels[1:] = [f' data-label="{escape(name)}"' for name in names]
        grouped = any(isinstance(row, str) for row in self.rows) and not self.stacks
        body = []
        for line in self._lines():
            if isinstance(line, str):
                cells = [f'<th scope="rowgroup" colspan="{len(css)}"><strong>{prose(line)}</strong></th>']
            else:
                best = '<strong>{}</strong><br><span class="unit">best</span>'
                texts = [(best if mark == "best" else "{}").format(prose(text)) for text, mark in line]
                cells = [f"<td{one}{label}>{text}</td>" for one, label, text in zip(css, labels, texts)]
                if grouped:
                    cells[0] = f'<th scope="row">{prose(line[0][0])}</th>'
            body.append(f"<tr>{''.join(cells)}</tr>")
        anchor = f' id="{self.id}"' if self.id else ""
        caption, named = "", ""
        if self.caption:  # above the table, not in it: a <caption> is no wider than its table
            mark = f' id="{self.id}-caption"' if self.id else ""
            named = f' aria-labelledby="{self.id}-caption"' if self.id else ""
            caption = f'<p class="caption"{mark}>{prose(self.caption)}</p>'
        return (
            f'<div class="{"table stacks" if self.stacks else "table"}"{anchor}>{caption}<table{named}>'
            f"<thead><tr>{head}</tr></thead><tbody>{''.join(body)}</tbody></table></div>"
        )

    def terminal(self, wide: bool = False) -> Terminal:
        """The table for a terminal; its texts are taken as they are, so a joint may be called [red] or :cat:.

        `wide`: no column may take several lines.
        """
        from rich.box import SIMPLE_HEAD
        from rich.table import Table as Terminal
        from rich.text import Text

        title = self.title or self.caption
        table = Terminal(
            title=Text(title, "table.title"), title_justify="left", box=SIMPLE_HEAD, pad_edge=False, show_edge=not wide,
            padding=(0, 1, 0, 0), min_width=min(WIDTH, max(map(len, title.split("\n")))),
        )  # fmt: skip
        indent = " " if any(isinstance(row, str) for row in self.rows) else ""
        there = [k for k, column in enumerate(self.heads) if column.brief is not None]
        for column, (right, _) in ((self.heads[k], self._written[k]) for k in there):
            heading = column.brief or ", ".join(part for part in (column.name, column.unit) if part)
            table.add_column(Text(heading), justify="right" if right else "left", no_wrap=wide or right)
        for line in self._lines():
            if isinstance(line, str):
                table.add_row(Text(line, "bold"))
            else:
                cells = [line[k] for k in there]
                cells[0] = (indent + cells[0][0], cells[0][1])
                table.add_row(*(Text(f"{t}*") if m == "best" else Text(t, m) for t, m in cells))
        return table
