"""Columns of a log's file, by name: CSV, Parquet, MCAP.

A file is looked at twice: first the names of its columns, by which a reader says what it needs, then the columns that
are needed. Everything else in the file may be text, or missing.
"""

from __future__ import annotations

import contextlib
import io
import json
import math
import re
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.robot.table import read_table
from flexhinf.validation import extra_package, open_regular, value_text

#: Largest file that is text, bytes, and most rows: an hour at 1 kHz.
LARGEST, MOST_ROWS = 1_000_000_000, 5_000_000

#: Most bytes of a row of a Parquet column, and of a chunk of an MCAP file, when they are unpacked.
LARGEST_CELL, LARGEST_CHUNK = 256, 1 << 28

#: What stands for a missing value, in small letters.
MISSING = ("", "nan", "na", "n/a", "null", "none", "-")

#: Most numbers of an array in a message: the joints of a robot, not the points of a cloud.
MOST_ELEMENTS = 100

#: The name under which the times of an MCAP file's messages are a column, and that of those in their headers.
LOG_TIME, STAMP = "time", "header/stamp"

#: A date with a time, the year first or, with points, the day; and whatever else may be meant as one.
_DATE = re.compile(
    r"(?:(?P<year>\d{4})-(?P<month>\d\d)-(?P<day>\d\d)"
    r"|(?P<day_last>\d\d?)\.(?P<month_last>\d\d?)\.(?P<year_last>\d{4}))"
    r"(?:(?:T|\s+)(?P<hours>\d\d?):(?P<minutes>\d\d)(?::(?P<seconds>\d\d)(?:[.,](?P<fraction>\d{1,18}))?)?"
    r"\s*(?P<zone>Z|UTC|[+-]\d\d(?::?\d\d)?)?)?\Z"
)
_LIKE_DATE = re.compile(r"[A-Za-z]*,?\s*\d{1,4}[-/. ]\w{1,9}[-/. ,]\s?\d{1,4}")

#: Seconds from 1970 to between 1973 and 2286, as a number of each unit: stamps of such a size are of that unit.
_EPOCHS = {"ns": (1e17, 1e19), "us": (1e14, 1e16), "ms": (1e11, 1e13)}


@dataclass(frozen=True)
class FileColumns:
    """The columns of a file before they are read.

    `names`: as they are written, units included. `load`: the numbers (N, k) of some of them, by their places, after
    the exact stamps of the time column; see `Loaded`.
    """

    path: Path
    names: tuple[str, ...]
    load: Callable[[int, Sequence[int]], Loaded]


@dataclass(frozen=True)
class Loaded:
    """Stamps and numbers of a file's rows.

    `stamps`: since the first row (N,), in the file's own unit: differences are taken before anything is rounded.
    `first`: the first stamp itself, rounded. `is_date`: whether stamps were dates, and count nanoseconds. `values`:
    (N, k), NaN where a value is missing. `place`: where the row of a number is, for messages: "line 17".
    """

    stamps: np.ndarray
    first: float
    is_date: bool
    values: np.ndarray
    place: Callable[[int], str]

    def unit(self) -> str:
        """Unit of the stamps where the file states none: by the size of stamps since 1970, else seconds."""
        if self.is_date:
            return "ns"
        return next((unit for unit, (low, high) in _EPOCHS.items() if low < abs(self.first) < high), "s")


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

    def load(time: int, places: Sequence[int]) -> Loaded:
        lines, needed = [], (time, *places)
        cells: list[list[str]] = [[] for _ in needed]
        for line, row in rows:
            lines.append(line)
            for column, k in zip(cells, needed):
                column.append(row[k])
        names = [heading[k].strip() for k in needed]
        dated = bool(cells[0]) and _date(cells[0][0]) is not None
        if separator != "," and _decimal_commas(cells[1:] if dated else cells):
            cells = [[cell.replace(",", ".", 1) for cell in column] for column in cells]

        def where(row: int) -> str:
            return f"line {lines[row]}"

        stamps, first, is_date = _stamps_of_text(path.name, names[0], cells[0], where)
        values = [_numbers(path.name, name, column, where) for name, column in zip(names[1:], cells[1:])]
        return Loaded(stamps, first, is_date, _stacked(values, len(lines)), where)

    return FileColumns(path, tuple(heading), load)


def _decimal_commas(columns: Sequence[Sequence[str]]) -> bool:
    """Whether numbers are written with decimal commas: some cell has a comma, and none a point."""
    comma = False
    for cell in (cell for column in columns for cell in column):
        if "." in cell:
            return False
        comma = comma or "," in cell
    return comma


def _number(cell: str) -> float:
    text = cell.strip()
    if text.casefold() in MISSING:
        return math.nan
    number = float(_ascii(text))
    if math.isinf(number):
        raise ValueError(text)
    return number


def _ascii(text: str) -> str:
    """The text of a number without what only Python reads: 1_000, and the digits of other scripts."""
    return text.replace("_", "x") if text.isascii() else "x"


def _numbers(file: str, name: str, cells: Sequence[str], where: Callable[[int], str]) -> np.ndarray:
    try:
        return np.array([_number(cell) for cell in cells], dtype=float)
    except ValueError:
        row = next(k for k, cell in enumerate(cells) if not _is_number(cell))
        raise _no_number(file, name, where(row), cells[row]) from None


def _is_number(cell: str) -> bool:
    with contextlib.suppress(ValueError):
        _number(cell)
        return True
    return False


def _no_number(file: str, name: str, place: str, value: Any) -> InvalidInput:
    comma = isinstance(value, str) and _is_number(value.replace(",", ".", 1))
    return InvalidInput(
        f"{file}, {place}: this is no number.",
        f"expected a finite number, or nothing where it is missing, in the column {value_text(name, 60)}; got "
        f"{value_text(value, 60)}",
        f"a decimal point: {value.strip().replace(',', '.')}" if comma else "0.5, or an empty cell",
    )


def _stamps_of_text(
    file: str, name: str, cells: Sequence[str], where: Callable[[int], str]
) -> tuple[np.ndarray, float, bool]:
    """Stamps since the first one (N,), the first one, and whether they are dates; decimals are subtracted exactly."""
    if not cells:
        return np.zeros(0), 0.0, False
    if not _is_number(cells[0]) and _date(cells[0]) is not None:
        dates = [_date(cell) for cell in cells]
        wrong = next((k for k, date in enumerate(dates) if date is None), None)
        if wrong is not None:
            raise _no_stamp(file, name, where(wrong), cells[wrong])
        return _stamps_of_numbers(np.array(dates, dtype="datetime64[ns]"))
    stamps = list[Decimal]()
    for row, cell in enumerate(cells):
        try:
            stamp = Decimal(_ascii(cell.strip()))
            if not stamp.is_finite() or not math.isfinite(float(stamp)):
                raise InvalidOperation
            stamps.append(stamp)
        except InvalidOperation:
            raise _no_stamp(file, name, where(row), cell) from None
    return np.array([float(stamp - stamps[0]) for stamp in stamps]), float(stamps[0]), False


def _date(cell: str) -> np.datetime64 | None:
    """A date with a time in UTC: 2026-01-31T12:00:00.5+02:00, or with the day first, 31.01.2026 12:00:00,5; else None.

    Digits behind the ninth of a second are left out.
    """
    match = _DATE.match(cell.strip())
    if match is None:
        return None
    part = match.groupdict()
    seconds = (part["fraction"] or "")[:9].ljust(9, "0")
    year, month, day = (part[name] or part[f"{name}_last"] for name in ("year", "month", "day"))
    text = (
        f"{year}-{month.zfill(2)}-{day.zfill(2)}T{(part['hours'] or '0').zfill(2)}:{part['minutes'] or '00'}"
    )
    try:
        stamp = np.datetime64(f"{text}:{part['seconds'] or '00'}.{seconds}", "ns")
    except ValueError:
        return None
    zone = (part["zone"] or "").replace(":", "").removeprefix("Z").ljust(5, "0")
    ahead = int(f"{zone[0]}1") * (60 * int(zone[1:3]) + int(zone[3:5])) if zone[0] in "+-" else 0
    return stamp - np.timedelta64(ahead, "m")


def _no_stamp(file: str, name: str, place: str, value: Any) -> InvalidInput:
    text = value.strip() if isinstance(value, str) else ""
    advice = "leave the row out"
    if "," in text and _is_number(text.replace(",", ".", 1)):
        advice = f"a decimal point: {text.replace(',', '.')}"
    elif _LIKE_DATE.match(text):
        advice = "dates as 2026-01-31T12:00:00.5, year, month and day in this order"
    return InvalidInput(
        f"{file}, {place}: this is no time.",
        f"expected a finite number in every row of the column {value_text(name, 60)}, or a date such as "
        f"2026-01-31T12:00:00.5 or 31.01.2026 12:00:00,5 in every row; got {value_text(value, 60)}",
        advice,
    )


def _stacked(columns: Sequence[np.ndarray], rows: int) -> np.ndarray:
    return np.column_stack(columns) if columns else np.zeros((rows, 0))


# Parquet --------------------------------------------------------------------------------------------
def _row(row: int) -> str:
    return f"row {row + 1}"


def _parquet_columns(path: Path) -> FileColumns:
    parquet: Any = extra_package("pyarrow.parquet", "log", "A log in Parquet needs another package.")
    with _foreign(path, "Parquet"):
        names = tuple(parquet.read_schema(path).names)

    def load(time: int, places: Sequence[int]) -> Loaded:
        chosen = [names[k] for k in (time, *places)]
        with _foreign(path, "Parquet"), parquet.ParquetFile(path) as file:
            _check_size(file, path.name, chosen)
            table = file.read(columns=chosen)
            arrays = [table.column(name).to_numpy() for name in chosen]
        bad = _first(np.array([entry is None or entry != entry for entry in arrays[0]], dtype=bool))
        if arrays[0].dtype.kind not in "iufM" or bad is not None:
            raise _no_stamp(path.name, names[time], _row(bad or 0), arrays[0][bad or 0 : (bad or 0) + 1])
        values = [
            _finite_numbers(path.name, names[k], array) for k, array in zip(places, arrays[1:], strict=True)
        ]
        stamps = _stamps_of_numbers(arrays[0])
        return Loaded(*stamps, _stacked(values, len(table)), _row)

    return FileColumns(path, names, load)


def _check_size(file: Any, name: str, chosen: Sequence[str]) -> None:
    """Refuse, by the footer alone, what would take much memory when it is unpacked, and columns of lists."""
    from pyarrow import types

    rows, schema = file.metadata.num_rows, file.schema_arrow
    if nested := [column for column in chosen if types.is_nested(schema.field(column).type)]:
        raise _no_number(name, nested[0], _row(0), str(schema.field(nested[0]).type))
    _refuse_rows(name, rows)
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


def _refuse_rows(name: str, rows: int) -> None:
    refuse_if(
        rows > MOST_ROWS,
        f"{name} has too many rows.",
        f"expected at most {MOST_ROWS}, got {rows}",
        "several files",
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
        raise _no_number(file, name, _row(0), array[0] if len(array) else array.dtype) from None
    bad = _first(np.isinf(numbers))
    if bad is not None:
        raise _no_number(file, name, _row(bad), float(numbers[bad]))
    return numbers


def _stamps_of_numbers(stamps: np.ndarray) -> tuple[np.ndarray, float, bool]:
    """As `_stamps_of_text`; integers and dates are subtracted as integers, of which no digit is lost."""
    if not len(stamps):
        return np.zeros(0), 0.0, False
    is_date = stamps.dtype.kind == "M"
    numbers = stamps.astype("datetime64[ns]").astype(np.int64) if is_date else stamps
    if numbers.dtype.kind in "iu":
        first = int(numbers[0])
        return (
            np.array([int(stamp) - first for stamp in numbers.tolist()], dtype=float),
            float(first),
            is_date,
        )
    return numbers.astype(float) - float(numbers[0]), float(numbers[0]), is_date


def _first(flags: np.ndarray) -> int | None:
    return int(np.argmax(flags)) if flags.any() else None


@contextlib.contextmanager
def _foreign(path: Path, kind: str) -> Iterator[None]:
    """Errors of another library about a file as ours."""
    try:
        yield
    except (InvalidInput, MemoryError):
        raise
    except Exception as error:  # whatever a damaged file makes it raise
        raise InvalidInput(
            f"{path.name}: this is no {kind}, or it is damaged.",
            f"expected a log as {kind}, got {type(error).__name__}: {error}",
            "the file as it was written, or the log as CSV",
        ) from error


# MCAP -----------------------------------------------------------------------------------------------
def _mcap_columns(path: Path) -> FileColumns:
    """A column for each number of a topic's messages: ``topic/field``, ``joint_states/position/elbow``.

    Messages in JSON, and those of ROS 2. In messages with arrays and as many names, as those of joints, the names stand
    in the column's; else the places from 0 on. The times of the messages are the column `LOG_TIME`, in nanoseconds.
    With the column ``topic/header/stamp`` as time each topic has the times of its headers, and those of the log where
    it has no headers.
    """
    columns: dict[str, _Values] = defaultdict(lambda: _Values([], [], []))
    stamped = set[str]()
    with _foreign(path, "MCAP"):
        decoders: dict[int, Callable[[bytes], Any] | None] = {}
        for schema, channel, message in _messages(path):
            if channel.id not in decoders:
                decoders[channel.id] = _decoder(channel.message_encoding, schema)
            decode, topic = decoders[channel.id], channel.topic.strip("/")
            content = decode(message.data) if decode else {}
            stamp = _stamp(content)
            numbers = list(_fields(topic, content)) if decode else []
            if stamp is not None:
                stamped.add(f"{topic}/{STAMP}")
                numbers.append((f"{topic}/{STAMP}", float(stamp)))
            for name, value in numbers:
                columns[name].times.append(message.log_time)
                columns[name].stamps.append(message.log_time if stamp is None else stamp)
                columns[name].values.append(value)
    names = tuple(columns)

    def load(time: int, places: Sequence[int]) -> Loaded:
        by_header = time > 0 and names[time - 1] in stamped
        chosen = [columns[names[k - 1]] for k in places]
        if time and not by_header:
            chosen.append(columns[names[time - 1]])
        every = [np.array(each.stamps if by_header else each.times, dtype=np.int64) for each in chosen]
        stamps = np.unique(np.concatenate(every)) if every else np.zeros(0, dtype=np.int64)
        table = np.full((len(stamps), len(chosen)), np.nan)
        for k, (times, each) in enumerate(zip(every, chosen)):
            again = np.diff(np.sort(times)) == 0
            refuse_if(
                again.any(), f"{path.name}: two messages of one topic have the same time.",
                f"expected increasing times of {names[(*places, time)[k] - 1]!r}, got {int(again.sum())} repeated ones",
                "the times of the log, which need no time='...'" if by_header
                else "a log with one message of a topic at a time",
            )  # fmt: skip
            table[np.searchsorted(stamps, times), k] = each.values
        infinite = _first(np.asarray(np.isinf(table).any(axis=1)))
        if infinite is not None:
            raise _no_number(path.name, "of a message", _row(infinite), math.inf)
        if not time or by_header:
            return Loaded(*_stamps_of_numbers(stamps), table, _row)
        known = np.isfinite(table[:, -1])
        return Loaded(*_stamps_of_numbers(table[known, -1]), table[known, :-1], _row)

    headings = (f"{name} [ns]" if name in stamped else name for name in names)
    return FileColumns(path, (f"{LOG_TIME} [ns]", *headings) if names else (), load)


class _Values(NamedTuple):
    """Numbers of a column, with the times of the messages in the log and in their headers, ns."""

    times: list[int]
    stamps: list[int]
    values: list[float]


def _stamp(message: Any) -> int | None:
    """The stamp of a message's header, ns, as ROS writes it; None where it has none."""

    def entry(of: Any, *names: str) -> Any:
        found = (of.get(name) if isinstance(of, Mapping) else getattr(of, name, None) for name in names)
        return next((value for value in found if value is not None), None)

    stamp = entry(entry(message, "header"), "stamp")
    parts = entry(stamp, "sec", "secs"), entry(stamp, "nanosec", "nsec", "nsecs")
    if not all(isinstance(part, int) and abs(part) < 1 << 33 for part in parts):
        return None
    return 1_000_000_000 * parts[0] + parts[1]


def _messages(path: Path) -> Iterator[tuple[Any, Any, Any]]:
    """Schema, channel and message of each message, in the order of the file.

    Before anything is unpacked the footer says how many there are; no chunk unpacks to more than `LARGEST_CHUNK`.
    """
    make_reader = extra_package("mcap.reader", "log", "A log in MCAP needs another package.").make_reader
    from mcap.records import Channel, Chunk, Message, Schema
    from mcap.stream_reader import StreamReader

    schemas: dict[int, Any] = {0: None}
    channels: dict[int, Any] = {}
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
        if summary is not None and summary.statistics is not None:
            _refuse_rows(path.name, summary.statistics.message_count)
        file.seek(0)
        found = 0
        for record in StreamReader(file, emit_chunks=True, record_size_limit=LARGEST).records:
            packed = [record]
            if isinstance(record, Chunk):
                content = io.BytesIO(_unpacked(path.name, record))
                packed = _records(
                    StreamReader(content, skip_magic=True, record_size_limit=LARGEST_CHUNK), content
                )
            for one in packed:
                if isinstance(one, Schema):
                    schemas[one.id] = one
                elif isinstance(one, Channel):
                    channels[one.id] = one
                elif isinstance(one, Message):
                    found += 1
                    _refuse_rows(path.name, found)  # the footer may be wrong
                    channel = channels[one.channel_id]
                    yield schemas[channel.schema_id], channel, one


def _records(reader: Any, content: io.BytesIO) -> Iterator[Any]:
    """The records of a chunk, which ends without a footer."""
    size, records = content.getbuffer().nbytes, reader.records
    while content.tell() < size:
        yield next(records)


def _unpacked(name: str, chunk: Any) -> bytes:
    """The records of a chunk, unpacked as far as its size is allowed."""
    most = LARGEST_CHUNK + 1
    if chunk.compression == "zstd":
        import zstandard

        content = zstandard.ZstdDecompressor().stream_reader(chunk.data).read(most)
    elif chunk.compression == "lz4":
        import lz4.frame

        content = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=most)
    else:
        content = chunk.data
    refuse_if(
        len(content) == most,
        f"{name} is too large.",
        f"expected chunks of at most {LARGEST_CHUNK} bytes, got a larger one",
        "the same messages in smaller chunks",
    )
    return content


def _decoder(encoding: str, schema: Any) -> Callable[[bytes], Any] | None:
    if encoding == "json":
        return json.loads
    if encoding == "cdr":
        factory = extra_package("mcap_ros2.decoder", "log", "A log of ROS 2 needs another package.")
        return factory.DecoderFactory().decoder_for(encoding, schema)
    return None


def _fields(name: str, message: Any) -> Iterator[tuple[str, float]]:
    """Every number of a message, with the path to it."""
    if isinstance(message, (bool, int, float)):
        yield name, float(message)
    elif _is_array(message):
        if len(message) <= MOST_ELEMENTS:
            for k, entry in enumerate(message):
                yield from _fields(f"{name}/{k}", entry)
    elif isinstance(message, Mapping) or hasattr(message, "__slots__"):
        entries = (
            message if isinstance(message, Mapping) else {k: getattr(message, k) for k in message.__slots__}
        )
        labels = entries.get("name")
        labels = (
            labels if isinstance(labels, list) and all(isinstance(label, str) for label in labels) else []
        )
        for key, entry in entries.items():
            if labels and _is_array(entry) and len(entry) == len(labels):
                for label, element in zip(labels, entry):
                    yield from _fields(f"{name}/{key}/{label}", element)
            else:
                yield from _fields(f"{name}/{key}", entry)


def _is_array(value: Any) -> bool:
    return (
        hasattr(value, "__len__")
        and hasattr(value, "__getitem__")
        and not isinstance(value, (str, bytes, Mapping))
    )


#: What reads the columns of a file, by its ending.
READERS: dict[str, Callable[[Path], FileColumns]] = {
    ".csv": _csv_columns, ".txt": _csv_columns, ".tsv": _csv_columns, ".parquet": _parquet_columns,
    ".mcap": _mcap_columns,
}  # fmt: skip
