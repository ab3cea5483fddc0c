"""Tables as people write them: CSV whose header has names, each with its unit behind it where that is not the SI unit.

    time [s], shoulder [deg], elbow [deg]
    0,        0,              0

Columns are separated by commas, semicolons or tabs, where there are none by spaces. Lines that begin with # are
comments; one right above numbers, with as many cells, is their header. How numbers are written, who reads them decides.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.validation import read_text

#: What separates columns; the one that is most often in the header does, of two as frequent ones the first. Spaces do
#: where a header has none of them.
SEPARATORS = (";", "\t", ",")


class TableRow(NamedTuple):
    """One row: the number of its line in the file, from 1 on, and its cells."""

    line: int
    cells: Sequence[str]


def read_table(
    path: Path, largest: int, most_rows: int, kind: str
) -> tuple[list[str], Iterator[TableRow], str]:
    """The header's cells as they are written, the rows, each with as many cells, and what separates columns.

    The rows are checked as they are asked for. `largest`: size of the file in bytes. `kind`: "waypoints as CSV", for
    messages.

    Raises InvalidInput: for a file that cannot be read, too many rows, a row with more or fewer cells, quotes with line
    breaks in them.
    """
    lines = read_text(path, largest, kind).removeprefix("\ufeff").splitlines()
    kept = [k for k, line in enumerate(lines) if line.strip() and not line.lstrip().startswith("#")]
    first = lines[kept[0]] if kept else ""
    separator = max(SEPARATORS, key=first.count)
    second = lines[kept[1]].split() if len(kept) > 1 else []
    if separator not in first and len(first.split()) == len(second) and _are_numbers(second):
        separator = " "
    if kept and kept[0] and lines[kept[0] - 1].lstrip().startswith("#"):
        named = lines[kept[0] - 1].strip().lstrip("#").strip()
        if _are_numbers(_cells(first, separator)) and len(_cells(named, separator)) == len(
            _cells(first, separator)
        ):
            lines[kept[0] - 1] = named
            kept.insert(0, kept[0] - 1)
    rows = _rows(path.name, lines, kept, separator)
    heading = next(rows, TableRow(1, ())).cells
    refuse_if(
        len(kept) > most_rows + 1,
        f"{path.name} has too many rows.",
        f"expected at most {most_rows}, got {len(kept) - 1}",
        "fewer rows, or several files",
    )
    return list(heading), _even(path.name, rows, len(heading)), separator


def _cells(line: str, separator: str) -> list[str]:
    return line.split() if separator == " " else line.split(separator)


def _are_numbers(cells: Sequence[str]) -> bool:
    with suppress(ValueError):
        return bool([float(cell.replace(",", ".")) for cell in cells])
    return False


def _rows(name: str, lines: Sequence[str], kept: Sequence[int], separator: str) -> Iterator[TableRow]:
    spaced = separator == " "
    texts = (lines[k].strip() if spaced else lines[k] for k in kept)
    cells = csv.reader(texts, delimiter=separator, skipinitialspace=spaced)
    for place, k in enumerate(kept, 1):
        try:
            row = next(cells)
        except (csv.Error, StopIteration) as error:
            raise _unreadable(name, k + 1, str(error)) from None
        if cells.line_num != place:
            raise _unreadable(name, k + 1, "quotes that the line does not close")
        yield TableRow(k + 1, row)


def _unreadable(name: str, line: int, got: str) -> InvalidInput:
    return InvalidInput(
        f"{name}, line {line}: the row cannot be read.",
        f"expected one row a line, without line breaks in quotes, got {got}",
        "numbers between commas",
    )


def _even(name: str, rows: Iterator[TableRow], count: int) -> Iterator[TableRow]:
    for row in rows:
        if len(row.cells) == count + 1 and not row.cells[-1].strip():  # a separator behind the last value
            row = row._replace(cells=row.cells[:-1])
        if len(row.cells) != count:
            raise InvalidInput(
                f"{name}, line {row.line}: the number of values is not that of the columns.",
                f"expected {count}, got {len(row.cells)}",
                "one value for each column of the header, with a decimal point; nothing where one is missing",
            )
        yield row


def name_and_unit(text: str) -> tuple[str, str]:
    """Name and unit of a header's cell; the unit is empty where none is stated.

    Examples
    --------
    >>> name_and_unit("elbow [deg]"), name_and_unit("time(ms)"), name_and_unit("elbow")
    (('elbow', 'deg'), ('time', 'ms'), ('elbow', ''))
    """
    text = text.strip()
    for opening, closing in ("[]", "()"):
        if text.endswith(closing) and opening in text:
            name, _, unit = text[:-1].rpartition(opening)
            return name.strip(), unit.strip()
    return text, ""
