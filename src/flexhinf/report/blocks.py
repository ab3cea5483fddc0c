"""Blocks of a section: paragraphs, notes, lists, listings, figures, tables. See also `page`.

Every block is a frozen value that checks itself where it is made, and writes itself as HTML; numbers are written for
reading. JSON, in which a number that is not finite is refused.
"""

from __future__ import annotations

import json
import math
import re
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from html import escape
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any, ClassVar, cast

import numpy as np

from flexhinf.arrays import Number
from flexhinf.errors import InvalidInput, NumericalFailure, refuse_if
from flexhinf.numerals import number, unbroken
from flexhinf.report.figure import LIGHT, Film

if TYPE_CHECKING:
    from rich.table import Table as Terminal


def prose(text: str) -> str:
    """Escaped text: words between backticks become a code element; Rᵛ and Rⁿ (or R^v, R^n) get a raised letter.

    Fonts draw the characters ᵛ and ⁿ in different sizes, or not at all; no other mark-up is known.

    Examples
    --------
    >>> prose("`--seed 3` changes Rᵛ")
    '<code>--seed 3</code> changes R<sup>v</sup>'
    >>> prose("5 % of `sleep 2 s`")
    '5\\xa0% of <code>sleep 2 s</code>'
    """
    letters = {"^v": "v", "ᵛ": "v", "^n": "n", "ⁿ": "n"}
    whole = unbroken(escape(text))
    raised = re.sub(r"\bR(\^[vn]\b|[ᵛⁿ])", lambda match: f"R<sup>{letters[match[1]]}</sup>", whole)
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", raised)


def unit_html(unit: str, after_name: bool = False) -> str:
    """A unit after a number, degrees without a space, or after a name; nothing without one."""
    space = "" if unit.startswith("°") and not after_name else " "
    return f'{space}<span class="unit">{escape(unit)}</span>' if unit else ""


def scalar(value: object, decimals: int | None = None) -> str:
    """One value of a table or a setting, as plain text (not yet escaped): yes, no, – for None, numbers, text, lists."""
    if value is None:
        return "–"
    value = plain(value)
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, Real):
        return number(value, decimals=decimals)
    if isinstance(value, (list, tuple)):
        return ", ".join(scalar(element, decimals) for element in cast("Sequence[object]", value))
    return str(value)


def plain(value: object) -> object:
    """NumPy's scalars and arrays as Python's numbers and lists; anything else as it is."""
    return cast("object", value.tolist()) if isinstance(value, (np.ndarray, np.generic)) else value


# JSON -------------------------------------------------------------------------------------------------
def finite(value: Any) -> Any:
    """Convert arrays to plain lists, and numbers that are not finite to None, at any depth."""
    value = plain(value)
    if isinstance(value, Mapping):
        return {key: finite(entry) for key, entry in cast("Mapping[str, object]", value).items()}
    if isinstance(value, (list, tuple)):
        return [finite(entry) for entry in cast("Sequence[object]", value)]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def to_json(value: object) -> str:
    """Text of a JSON document; lists of numbers stay on one line, the order of keys is kept, NumPy's values are taken.

    Raises NumericalFailure: a number is NaN or infinite; the message says which. InvalidInput: a key is not text, or a
    value is of a kind that JSON does not have.

    Examples
    --------
    >>> print(to_json({"gamma": 2.5, "range": (1, 2.0, None)}), end="")
    {
      "gamma": 2.5,
      "range": [1, 2.0, null]
    }
    """
    return _json(value, (), "\n") + "\n"


def _json(value: object, place: tuple[str, ...], margin: str) -> str:
    where = ".".join(place) or "the document"
    value = plain(value)
    indent = f"{margin}  "
    if isinstance(value, Mapping):
        entries = cast("Mapping[object, object]", value)
        wrong = next((key for key in entries if not isinstance(key, str)), "")
        refuse_if(wrong != "", "A key of JSON is text.", f"got {wrong!r} in {where}", repr(str(wrong)))
        lines = [
            f"{json.dumps(key, ensure_ascii=False)}: {_json(each, (*place, str(key)), indent)}"
            for key, each in entries.items()
        ]
        return f"{{{indent}{f',{indent}'.join(lines)}{margin}}}" if lines else "{}"
    if isinstance(value, (list, tuple)):
        parts = cast("Sequence[object]", value)
        lines = [_json(each, (*place, str(index)), indent) for index, each in enumerate(parts)]
        if any(isinstance(each, (Mapping, list, tuple, np.ndarray, np.generic)) for each in parts):
            return f"[{indent}{f',{indent}'.join(lines)}{margin}]"
        return f"[{', '.join(lines)}]"
    try:
        return json.dumps(value, ensure_ascii=False, allow_nan=False)
    except ValueError as error:
        raise NumericalFailure(
            "A number of the report is not finite.", f"{where} = {value}", "None, which is written as null"
        ) from error
    except TypeError as error:
        raise InvalidInput(
            "JSON has no such value.",
            f"got {type(value).__name__} at {where}",
            "text, numbers, true, false, null, lists, mappings",
        ) from error


_ACTIVE = re.compile(
    r"<script|<foreignObject|\son[a-z]+\s*=|(?:href|src)\s*=\s*[\"'](?!#)|url\((?!#)|@import|<!\[CDATA|<!ENTITY",
    re.IGNORECASE,
)
_MARKUP = re.compile(r"<!--.*?-->|<style\b.*?</style\s*>|<(?:[^<>\"']|\"[^\"]*\"|'[^']*')*>", re.DOTALL)


class PageBlock:
    """Base of the parts of a page: HTML text, and perhaps anchors in it."""

    def html(self) -> str:
        """The block as HTML, every text escaped."""
        raise NotImplementedError

    def ids(self) -> tuple[str, ...]:
        """The anchors that this block makes on the page."""
        return ()


class Anchored(PageBlock):
    """A block with an anchor of its own.

    Raises InvalidInput: an anchor does not begin with a small letter, or has more than these, digits and hyphens.
    """

    id: str

    def __post_init__(self) -> None:
        refuse_if(
            not re.fullmatch(r"[a-z][a-z0-9-]*", self.id),
            "An anchor has small letters, digits, hyphens.",
            f"got {self.id!r}",
            "figure-03",
        )

    def ids(self) -> tuple[str, ...]:
        """The anchor, where the block has one."""
        return (self.id,) if self.id else ()


@dataclass(frozen=True)
class Paragraph(PageBlock):
    """A paragraph; `` `code` `` between backticks is set as code."""

    text: str
    _frame: ClassVar[str] = "<p>{}</p>"
    _escaped: ClassVar[Callable[[str], str]] = prose

    def html(self) -> str:
        """The text as an HTML element."""
        return self._frame.format(type(self)._escaped(self.text))


class Note(Paragraph):
    """A paragraph that stands out: a limit, or a warning the reader must not miss."""

    _frame = '<p class="note"><strong>Note.</strong> {}</p>'


class Listing(Paragraph):
    """Preformatted text: a command, a file, a few lines of code."""

    _frame = "<pre><code>{}</code></pre>"
    _escaped = escape


@dataclass(frozen=True)
class Bullets(PageBlock):
    """A list of short texts, which may be numbered."""

    items: tuple[str, ...]
    numbered: bool = False

    def html(self) -> str:
        """The list as HTML."""
        tag = "ol" if self.numbered else "ul"
        return f"<{tag}>{''.join(f'<li>{prose(item)}</li>' for item in self.items)}</{tag}>"


@dataclass(frozen=True)
class Figure(Anchored):
    """A drawing, as `flexhinf.report.figure_to_svg` writes it, with its caption, an anchor (``figure-03``) and a label
    (``Figure 3``); with a `film` the page can play it."""

    id: str
    svg: str
    caption: str
    label: str = ""
    film: Film | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        body = _parts(self.svg)[2]
        active = next(filter(None, map(_ACTIVE.search, _MARKUP.findall(body))), None)
        refuse_if(
            active or "<![CDATA[" in body,
            "A figure of a report may neither run a script nor fetch anything.",
            f"found {active.group() if active else '<![CDATA['!r} in the drawing for {self.id!r}",
            "a drawing without it",
        )

    def html(self) -> str:
        """The figure as HTML, the drawing inside it."""
        label = f"<strong>{escape(self.label)}.</strong> " if self.label else ""
        film = "" if self.film is None else f' data-film="{escape(self.film.text())}"'
        drawing = _inline(self.svg, self.id, f"{self.id}-caption")
        return (
            f'<figure id="{self.id}"{film}><div class="drawing">{drawing}</div>'
            f'<figcaption id="{self.id}-caption">{label}{prose(self.caption)}</figcaption></figure>'
        )


#: A drawing with more units of width than these, of which a letter has 12.8, has room for larger texts.
WIDE = 520.0


# Drawings inside a page ------------------------------------------------------------------------------
def _parts(svg: str) -> tuple[str, str, str]:
    """View box, its width, and what follows the start of the ``svg`` element, of a drawing; else an InvalidInput."""
    drawing = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)  # with addresses in it
    root = re.search(r"<svg\b[^>]*>", drawing)
    view = re.search(r'\bviewBox="\S+\s+\S+\s+([\d.]+)\s[^"]*"', root.group()) if root else None
    if root is None or view is None or "</svg>" not in drawing:
        raise InvalidInput("A figure is an SVG document.", f"got {svg[:40]!r} …", "figure_to_svg")
    return view[0], view[1], drawing[root.end() : drawing.rindex("</svg>") + len("</svg>")]


#: In markup: what comes before a name, the size of a text, and the colours that have a role.
_OWN = re.compile(r'id(?<!\wid)="|url\(#|href="#|font-size: ([\d.]+px)|' + "|".join(LIGHT.values()))
_ROLES = {colour: f"var(--{role})" for role, colour in LIGHT.items()}


def _inline(svg: str, prefix: str, described_by: str) -> str:
    """The ``svg`` element of a drawing for the inside of an HTML page, named by the element `described_by`.

    Declarations, metadata and name spaces go; every id gets `prefix`, since all drawings of a page share one
    set of names; the colours of `LIGHT` become variables of the style sheet, so that a drawing follows
    light and dark; its size is left to the page, as is that of its texts: a drawing is laid out for a telephone, and
    the style sheet makes texts smaller, relative to the drawing, where it is wide. Only markup is looked at: a joint
    may be called ``url(x)``.
    """
    view, width, body = _parts(svg)

    def own(part: re.Match[str]) -> str:
        sized = f"font-size: calc({part[1]}*var(--text))" if part[1] else f"{part[0]}{prefix}-"
        return _ROLES.get(part[0], sized)

    wide = ' class="wide"' * (float(width) > WIDE) + f' style="--units: {width}"'
    inside = _MARKUP.sub(lambda mark: _OWN.sub(own, mark[0]), body)
    return f'<svg {view}{wide} role="img" aria-labelledby="{described_by}">{inside}'


# Tables ----------------------------------------------------------------------------------------------
#: Columns of a terminal.
WIDTH = 80


@dataclass(frozen=True)
class Column:
    """Head of a table's column and format of its numbers: so many `decimals` (numbers of comparable size get
    common ones), or each with so many significant `digits`.

    For `Table.of` it shows the entry `key` of a record, or what `of` makes of the record, times `scale`. In a
    terminal the header is `brief` where it differs, and a column with None is left out; texts are aligned to the
    `right` too.
    """

    name: str
    unit: str = ""
    decimals: int | None = None
    digits: int | None = None
    key: str = ""
    scale: Number = 1.0
    brief: str | None = ""
    right: bool = False
    of: Callable[[Any], object] | None = None

    def cell(self, record: Any) -> Any:
        """What the column shows of a record."""
        value: Any = record.get(self.key) if self.of is None else self.of(record)
        return value if value is None or self.scale == 1.0 else self.scale * value


@dataclass(frozen=True)
class Cell:
    """A cell that stands out: `mark` is "best" or a colour, which only a terminal shows."""

    value: object
    mark: str = ""


@dataclass(frozen=True)
class Table(Anchored):
    """Rows under named columns.

    Columns of numbers are right-aligned; None is shown as –.

    Each of the `rows` is a sequence of text, numbers, yes/no, None or `Cell`, as many as there are columns; or one
    text, the title of the rows below it. The `caption` stands above the table on a page, whose anchor is `id`; in a
    terminal the `title` does, if there is one. `stacks`: whether a narrow screen shows each row as a list of its cells,
    for tables with sentences in them; other tables scroll sideways in their frame.
    """

    columns: Sequence[Column | str]
    rows: Sequence[Sequence[object]]
    caption: str = ""
    id: str = ""
    stacks: bool = False
    title: str = ""

    def __post_init__(self) -> None:
        if self.id:
            super().__post_init__()
        for index, row in enumerate(self.rows):
            refuse_if(
                not isinstance(row, str) and len(row) != len(self.columns),
                "A row of a table does not fit its columns.",
                f"expected {len(self.columns)} cells, got {len(row)} in row {index} of {self.caption!r}",
                "None for a cell that has no value",
            )

    @classmethod
    def of(cls, columns: Sequence[Column], records: Iterable[Any], *others: Any, **named: Any) -> Table:
        """Make a table with a row for each record, of what the columns show of it."""
        return cls(
            columns,
            [tuple(column.cell(record) for column in columns) for record in records],
            *others,
            **named,
        )

    @cached_property
    def heads(self) -> list[Column]:
        """The columns as `Column`s; a text becomes a `Column` with that name."""
        return [Column(column) if isinstance(column, str) else column for column in self.columns]

    @cached_property
    def _written(self) -> tuple[list[bool], list[str | list[tuple[str, str]]]]:
        """Whether each column is aligned to the right; the rows, a title as text, each cell as text and mark."""
        right: list[bool] = []
        columns: list[list[str]] = []
        for index, column in enumerate(self.heads):
            values: list[Any] = [
                cell.value if isinstance(cell, Cell) else cell
                for cell in (row[index] for row in self.rows if not isinstance(row, str))
            ]
            known = [value for value in values if value is not None]
            numeric = bool(known) and all(
                isinstance(v, Real) and v is not True and v is not False for v in known
            )
            decimals = column.decimals
            if numeric and decimals is None:  # 4 digits for the largest number, where sizes are comparable
                sizes = [abs(v) for v in known if not isinstance(v, Integral) and math.isfinite(v) and v != 0]
                if sizes and max(sizes) < 1e4 * min(sizes) and 1e-3 <= max(sizes) < 1e6:
                    decimals = max(0, 3 - math.floor(math.log10(max(sizes))))
            digits = column.digits if numeric else None
            texts = [number(v, digits) if digits and v is not None else scalar(v, decimals) for v in values]
            right.append(numeric or column.right)
            columns.append(texts)
        texts = zip(*columns)
        return right, [
            row
            if isinstance(row, str)
            else [(text, getattr(cell, "mark", "")) for text, cell in zip(next(texts), row)]
            for row in self.rows
        ]

    @cached_property
    def _longest(self) -> list[int]:
        """Letters of the longest cell of each column."""
        rows = [line for line in self._written[1] if not isinstance(line, str)]
        return [max((len(line[k][0]) for line in rows), default=0) for k in range(len(self.heads))]

    def html(self) -> str:
        """The table as HTML, in a frame that scrolls sideways on a narrow screen, or with rows that stack."""
        numeric, lines = self._written
        css = [
            "" if not right else ' class="number long"' if longest > VALUE else ' class="number"'
            for right, longest in zip(numeric, self._longest)
        ]
        head = "".join(
            f'<th scope="col"{mark}>{prose(column.name)}{unit_html(column.unit, after_name=True)}</th>'
            if column.name
            else "<td></td>"
            for column, mark in zip(self.heads, css)
        )
        labels, units = [""] * len(css), [""] * len(css)
        if self.stacks:  # what a stacked row writes around each cell but its first
            labels[1:] = [f' data-label="{escape(c.name)}"' if c.name else "" for c in self.heads[1:]]
            units[1:] = [f"{' ' * (u != '' and u[0] != '°')}{u}" for u in (c.unit for c in self.heads[1:])]
        grouped = any(isinstance(row, str) for row in self.rows) and not self.stacks
        body: list[str] = []
        for line in lines:
            if isinstance(line, str):
                cells = [f'<th scope="rowgroup" colspan="{len(css)}"><strong>{prose(line)}</strong></th>']
            else:
                best = '<strong>{}</strong><br><span class="unit">best</span>'
                texts = [(best if mark == "best" else "{}").format(prose(text)) for text, mark in line]
                own = [
                    f' data-unit="{escape(unit)}"' if unit and text not in ("", "–") else ""
                    for unit, (text, _) in zip(units, line)
                ]
                cells = [f"<td{''.join(marks)}>{text}</td>" for *marks, text in zip(css, labels, own, texts)]
                if grouped:
                    cells[0] = f'<th scope="row">{prose(line[0][0])}</th>'
            body.append(f"<tr>{''.join(cells)}</tr>")
        anchor, mark, named = "", "", ""
        if self.id:
            anchor, mark = f' id="{self.id}"', f' id="{self.id}-caption"'
            named = f' aria-labelledby="{self.id}-caption"' if self.caption else ""
        # above the table, not in it: a <caption> is no wider than its table
        caption = f'<p class="caption"{mark}>{prose(self.caption)}</p>' if self.caption else ""
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
            title=Text(title, "table.title"),
            title_justify="left",
            box=SIMPLE_HEAD,
            pad_edge=False,
            show_edge=not wide,
            padding=(0, 1, 0, 0),
            min_width=min(WIDTH, max(map(len, title.split("\n")))),
        )
        indent = " " if any(isinstance(row, str) for row in self.rows) else ""
        there = [k for k, column in enumerate(self.heads) if column.brief is not None]
        numeric, lines = self._written
        named = {there[0]} if not indent and self._longest[there[0]] <= NAME else set[int]()
        whole = {k: wide or k in named or (numeric[k] and self._longest[k] <= VALUE) for k in there}
        for k, heading in self._headings(whole, wide).items():
            table.add_column(Text(heading), justify="right" if numeric[k] else "left", no_wrap=whole[k])
        for line in lines:
            if isinstance(line, str):
                table.add_row(Text(line, "bold"))
            else:
                cells = [line[k] for k in there]
                cells[0] = (indent + cells[0][0], cells[0][1])
                table.add_row(*(Text(f"{t}*") if m == "best" else Text(t, m) for t, m in cells))
        return table

    def _headings(self, whole: Mapping[int, bool], wide: bool) -> dict[int, str]:
        """Headings for a terminal, broken where it would else cut cells; a unit stays beside its name if it can."""

        def fit(heads: Mapping[int, int]) -> bool:
            cells = {k: self._longest[k] if whole[k] else min(self._longest[k], NAME) for k in whole}
            return sum(1 + max(heads[k], cells[k]) for k in whole) <= WIDTH - 2  # of its edges

        columns = {k: self.heads[k] for k in whole}
        headings = {
            k: one.brief or ", ".join(filter(None, (one.name, one.unit))) for k, one in columns.items()
        }
        if wide or fit({k: max(map(len, text.split("\n"))) for k, text in headings.items()}):
            return headings
        parts = {k: text.replace(", ", ",\N{NO-BREAK SPACE}") for k, text in headings.items()}
        if not fit({k: _longest_part(text) for k, text in parts.items()}):
            parts = headings
        rooms = {k: max(self._longest[k], _longest_part(text)) for k, text in parts.items()}
        broken = {
            k: "\n".join(textwrap.fill(line, rooms[k]) for line in text.split("\n"))
            for k, text in parts.items()
        }
        return {k: broken[k].replace("\N{NO-BREAK SPACE}", " ") if whole[k] else headings[k] for k in whole}


def _longest_part(text: str) -> int:
    return max(map(len, re.split(r"[ \n]", text)))


#: Names in the first column of a table without titles stay whole in a terminal if they are no longer than this.
NAME = 16

#: So do values at the right, which else would leave the other columns no room: names of joints may be long.
VALUE = 32
