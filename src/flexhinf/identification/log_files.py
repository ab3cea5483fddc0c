"""Columns of a log's file, by name: CSV, Parquet, MCAP.

A file is looked at twice: first the names of its columns, by which a reader says what it needs, then the columns that
are needed. Everything else in the file may be text, or missing.
"""

# pyarrow has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false, reportUnknownVariableType=false

from __future__ import annotations

import datetime
from collections.abc import Callable, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.identification.log_columns import (
    LARGEST,
    MISSING,
    MOST_ROWS,
    FileColumns,
    Loaded,
    clock_of,
    date_of,
    first_place,
    foreign_errors,
    is_number,
    joint_stamps,
    nanoseconds,
    no_number,
    no_stamp,
    numbers_of,
    over_midnight,
    refuse_rows,
    row_place,
    stamps_of_numbers,
    stamps_of_text,
)
from flexhinf.identification.log_messages import mcap_columns
from flexhinf.robot.table import TableRow, name_and_unit, read_table
from flexhinf.validation import extra_package, open_regular, value_text

#: Most bytes of a row of a Parquet column when it is unpacked.
LARGEST_CELL = 64


def file_columns(path: Path) -> FileColumns:
    """The columns of a file, whose ending says what it is.

    Raises InvalidInput: no such file, another ending, a package that is missing, or it cannot be read.
    """
    ending = path.suffix.lower()
    refuse_if(
        ending not in READERS,
        "The format of the log is not known.",
        f"expected a name that ends with {', '.join(READERS)}, got {value_text(str(path), 120)}",
        "a CSV file with a header: log.csv",
    )
    try:
        with open_regular(path):
            pass
    except (OSError, ValueError) as error:
        raise InvalidInput(
            f"There is no log {value_text(str(path), 120)} that can be read.",
            f"expected a file with columns, got: {getattr(error, 'strerror', None) or error}",
            "the path of a file that you may read",
        ) from error
    columns = READERS[ending](path)
    refuse_if(
        not columns.names,
        f"{path.name} is empty.",
        "expected a column of times, the inputs and what was measured, got no column",
        "a header 'time,motor_torque,motor_position' and a row for each sample",
    )
    return columns


# CSV ------------------------------------------------------------------------------------------------
def _csv_columns(path: Path) -> FileColumns:
    heading, rows, separator = read_table(path, LARGEST, MOST_ROWS, "a log as CSV")
    first = next(rows, None)
    has_header = not all(is_number(_pointed(cell, separator)) for cell in heading)
    if not has_header:  # as MATLAB writes matrices
        above = TableRow(max(1, first.line - 1) if first is not None else 1, heading)
        rows = chain([above], [] if first is None else [first], rows)
        heading = [str(place + 1) for place in range(len(heading))]
    elif first is not None and (units := _units_of(first.cells)):
        heading = [
            f"{name.strip()} [{unit}]" if unit and not name_and_unit(name)[1] else name
            for name, unit in zip(heading, units)
        ]
    elif first is not None:
        rows = chain([first], rows)

    def load(time: Sequence[int], places: Sequence[int]) -> Loaded:
        lines, needed = list[int](), (*time, *places)
        cells: list[list[str]] = [[] for _ in needed]
        for line, row in rows:
            lines.append(line)
            for column, k in zip(cells, needed):
                column.append(row[k])
        names = [heading[k].strip() for k in needed]
        dated = bool(cells[0]) and (date_of(cells[0][0]) is not None or clock_of(cells[0][0]) is not None)
        if separator != "," and _decimal_commas(cells[1:] if dated else cells):
            cells = [[cell.replace(",", ".", 1) for cell in column] for column in cells]

        def where(row: int) -> str:
            return f"line {lines[row]}"

        count = len(time)
        written = joint_stamps(path.name, names[:count], cells[:count], where)
        stamps, first, is_date = stamps_of_text(path.name, names[0], written, where)
        values = [
            numbers_of(path.name, name, column, where) for name, column in zip(names[count:], cells[count:])
        ]
        return Loaded(stamps, first, is_date, _stacked(values, len(lines)), where)

    return FileColumns(path, tuple(heading), load, has_header)


def _pointed(cell: str, separator: str) -> str:
    """A cell with a decimal point, where commas do not separate columns."""
    return cell if separator == "," else cell.replace(",", ".", 1)


def _units_of(cells: Sequence[str]) -> list[str]:
    """The units of a row below the header that has nothing else; none if it is one of values."""
    texts = [cell.strip() for cell in cells]
    known = [text for text in texts if text.casefold() not in MISSING]
    if not known or any(is_number(text.replace(",", ".", 1)) for text in known):
        return []
    return [text.strip("[]()") if text in known else "" for text in texts]


def _decimal_commas(columns: Sequence[Sequence[str]]) -> bool:
    """Whether numbers are written with decimal commas: some cell has a comma, and none a point."""
    comma = False
    for cell in (cell for column in columns for cell in column):
        if "." in cell:
            return False
        comma = comma or "," in cell
    return comma


def _stacked(columns: Sequence[np.ndarray], rows: int) -> np.ndarray:
    return np.column_stack(columns) if columns else np.zeros((rows, 0))


# Parquet --------------------------------------------------------------------------------------------
def _parquet_columns(path: Path) -> FileColumns:
    parquet: Any = extra_package("pyarrow.parquet", "log", "A log in Parquet needs another package.")
    with foreign_errors(path, "Parquet"):
        names = tuple(parquet.read_schema(path).names)

    def load(time: Sequence[int], places: Sequence[int]) -> Loaded:
        chosen = [names[k] for k in (*time, *places)]
        with foreign_errors(path, "Parquet"), parquet.ParquetFile(path) as file:
            _check_size(file, path.name, chosen)
            table = file.read(columns=chosen)
            arrays = [table.column(name).to_numpy() for name in chosen]
        parts, kinds = [_clocks(array) for array in arrays[: len(time)]], "iufmM" if len(time) == 1 else "iu"
        for place, part in zip(time, parts):
            bad = first_place(np.array([entry is None or entry != entry for entry in part], dtype=bool))
            if part.dtype.kind not in kinds or bad is not None:
                raise no_stamp(path.name, names[place], row_place(bad or 0), part[bad or 0 : (bad or 0) + 1])
        values = [
            _finite_numbers(path.name, names[k], array)
            for k, array in zip(places, arrays[len(time) :], strict=True)
        ]
        stamps = stamps_of_numbers(parts[0] if len(parts) == 1 else nanoseconds(*parts))
        return Loaded(*stamps, _stacked(values, len(table)), row_place)

    return FileColumns(path, names, load)


def _clocks(stamps: np.ndarray) -> np.ndarray:
    """Times of the day as durations (N,); all other stamps as they are."""
    if stamps.dtype.kind != "O" or not len(stamps) or not isinstance(stamps[0], datetime.time):
        return stamps
    texts = [clock.isoformat() if isinstance(clock, datetime.time) else "" for clock in stamps]
    durations = [clock_of(text) or np.timedelta64("NaT", "ns") for text in texts]
    return over_midnight(np.array(durations, dtype="timedelta64[ns]"))


def _check_size(file: Any, name: str, chosen: Sequence[str]) -> None:
    """Refuse, by the footer alone, columns that are no numbers, and what would take much memory when it is unpacked.

    A text of any length may be a single entry of a column's dictionary, which the footer counts once for all rows: no
    column of texts is read.
    """
    from pyarrow import types

    rows, schema = file.metadata.num_rows, file.schema_arrow
    for k, column in enumerate(chosen):
        kind = schema.field(column).type
        known = (types.is_primitive(kind) and not types.is_interval(kind)) or types.is_decimal(kind)
        refuse_if(
            not (known or types.is_null(kind)),
            f"{name}: the column {value_text(column, 60)} has no numbers.",
            f"expected a column of numbers{'' if k else ' or times'}, got one of {kind}",
            f"another column, or pandas.{'to_numeric' if k else 'to_datetime'}(...) before the file is written",
        )
    refuse_rows(name, rows)
    groups = [file.metadata.row_group(k) for k in range(file.metadata.num_row_groups)]
    parts = [group.column(k) for group in groups for k in range(group.num_columns)]
    unpacked = sum(part.total_uncompressed_size for part in parts if part.path_in_schema in chosen)
    most = LARGEST_CELL * len(chosen) * (rows + 4096)
    refuse_if(
        unpacked > most,
        f"{name} is too large.",
        f"expected at most {most} bytes in {len(chosen)} columns of {rows} numbers, got {unpacked}",
        "columns of numbers",
    )


def _finite_numbers(file: str, name: str, array: np.ndarray) -> np.ndarray:
    """A column of numbers as float64, NaN where one is missing; booleans are numbers, text and infinity are not."""
    if array.dtype.kind == "O":  # booleans, integers or decimals of which some are missing, or no numbers
        array = np.array([np.nan if entry is None else entry for entry in array], dtype=object)
    try:
        if array.dtype.kind not in "iufbO" or any(isinstance(entry, (str, bytes)) for entry in array[:1]):
            raise ValueError(array.dtype)
        numbers = array.astype(float)
    except (TypeError, ValueError):
        raise no_number(file, name, row_place(0), array[0] if len(array) else array.dtype) from None
    bad = first_place(np.isinf(numbers))
    if bad is not None:
        raise no_number(file, name, row_place(bad), float(numbers[bad]))
    return numbers


#: What reads the columns of a file, by its ending.
READERS: dict[str, Callable[[Path], FileColumns]] = {
    ".csv": _csv_columns,
    ".txt": _csv_columns,
    ".tsv": _csv_columns,
    ".dat": _csv_columns,
    ".parquet": _parquet_columns,
    ".mcap": mcap_columns,
}
