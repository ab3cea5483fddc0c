"""Columns of a log's file: their names before they are read, then their stamps and numbers, with what is refused."""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np

from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.validation import value_text

#: Largest file that is text, bytes, and most rows: an hour at 1 kHz.
LARGEST, MOST_ROWS = 1_000_000_000, 5_000_000

#: What stands for a missing value, in small letters.
MISSING = ("", "nan", "na", "n/a", "null", "none", "-")

#: A date with a time, the year first or, with points, the day; and whatever else may be meant as one.
_DATE = re.compile(
    r"(?:(?P<year>\d{4})(?P<mark>[-/])(?P<month>\d\d)(?P=mark)(?P<day>\d\d)"
    r"|(?P<day_last>\d\d?)\.(?P<month_last>\d\d?)\.(?P<year_last>\d{4}))"
    r"(?:(?:T|\s+)(?P<hours>\d\d?):(?P<minutes>\d\d)(?::(?P<seconds>\d\d)(?:[.,](?P<fraction>\d{1,18}))?)?"
    r"\s*(?P<zone>Z|UTC|[+-]\d\d(?::?\d\d)?)?)?\Z"
)
#: A time of the day, of 24 hours.
_CLOCK = re.compile(
    r"(?P<hours>[01]?\d|2[0-3]):(?P<minutes>[0-5]\d):(?P<seconds>[0-5]\d)(?:[.,](?P<fraction>\d{1,18}))?\Z"
)
_LIKE_CLOCK = re.compile(r"\d{1,3}:\d\d")
_LIKE_DATE = re.compile(r"[A-Za-z]*,?\s*\d{1,4}[-/. ]\w{1,9}[-/. ,]\s?\d{1,4}")

#: Seconds from 1970 to between 1973 and 2286, as a number of each unit: stamps of such a size are of that unit.
_EPOCHS = {"ns": (1e17, 1e19), "us": (1e14, 1e16), "ms": (1e11, 1e13)}


@dataclass(frozen=True)
class FileColumns:
    """The columns of a file before they are read.

    `names`: as they are written, units included; without a header their numbers from 1 on. `load`: the numbers (N, k)
    of some of them, by their places, after the exact stamps of the column of times, or of two, whole seconds and
    nanoseconds; see `Loaded`.
    """

    path: Path
    names: tuple[str, ...]
    load: Callable[[Sequence[int], Sequence[int]], Loaded]
    has_header: bool = True


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


def number_of(cell: str) -> float:
    """The number of a cell, NaN where one is missing; ValueError for text and infinity."""
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


def numbers_of(file: str, name: str, cells: Sequence[str], where: Callable[[int], str]) -> np.ndarray:
    """The numbers (N,) of a column of cells, NaN where one is missing; the refusal names the row."""
    try:
        return np.array([number_of(cell) for cell in cells], dtype=float)
    except ValueError:
        row = next(k for k, cell in enumerate(cells) if not is_number(cell))
        raise no_number(file, name, where(row), cells[row]) from None


def is_number(cell: str) -> bool:
    """Whether a cell is a number, or a missing one."""
    with contextlib.suppress(ValueError):
        number_of(cell)
        return True
    return False


def no_number(file: str, name: str, place: str, value: object) -> InvalidInput:
    """The refusal of a value among numbers."""
    text = value.strip().replace(",", ".", 1) if isinstance(value, str) else None
    return InvalidInput(
        f"{file}, {place}: this is no number.",
        f"expected a finite number, or nothing where it is missing, in the column {value_text(name, 60)}; got "
        f"{value_text(value, 60)}",
        f"a decimal point: {text}" if text is not None and is_number(text) else "0.5, or an empty cell",
    )


def stamps_of_text(
    file: str, name: str, cells: Sequence[str], where: Callable[[int], str]
) -> tuple[np.ndarray, float, bool]:
    """Stamps since the first one (N,), the first one, and whether they are dates; decimals are subtracted exactly."""
    if not cells:
        return np.zeros(0), 0.0, False
    for read in (date_of, clock_of) if not is_number(cells[0]) else ():
        if read(cells[0]) is None:
            continue
        dates = [read(cell) for cell in cells]
        wrong = next((k for k, date in enumerate(dates) if date is None), None)
        if wrong is not None:
            raise no_stamp(file, name, where(wrong), cells[wrong])
        stamps = np.array(dates, dtype="datetime64[ns]" if read is date_of else "timedelta64[ns]")
        return stamps_of_numbers(stamps if read is date_of else over_midnight(stamps))
    stamps = list[Decimal]()
    for row, cell in enumerate(cells):
        try:
            stamp = Decimal(_ascii(cell.strip()))
            if not stamp.is_finite() or not math.isfinite(float(stamp)):
                raise InvalidOperation
            stamps.append(stamp)
        except InvalidOperation:
            raise no_stamp(file, name, where(row), cell) from None
    return np.array([float(stamp - stamps[0]) for stamp in stamps]), float(stamps[0]), False


def joint_stamps(
    file: str, names: Sequence[str], columns: Sequence[Sequence[str]], where: Callable[[int], str]
) -> Sequence[str]:
    """Stamps (N,) of one column as they are; of two, whole seconds and nanoseconds, as one number of nanoseconds."""
    if len(columns) == 1:
        return columns[0]
    stamps = list[str]()
    for row, (seconds, part) in enumerate(zip(*columns)):
        for name, cell in zip(names, (seconds, part)):
            if not re.fullmatch(r"\s*[+-]?\d{1,18}(?:\.0*)?\s*", cell, re.ASCII):
                raise no_stamp(file, name, where(row), cell)
        stamps.append(str(1_000_000_000 * int(float(seconds)) + int(float(part))))
    return stamps


def date_of(cell: str) -> np.datetime64 | None:
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


def clock_of(cell: str) -> np.timedelta64 | None:
    """A time of the day, 23:59:59.5, since midnight; else None. Digits behind the ninth of a second are left out."""
    match = _CLOCK.match(cell.strip())
    if match is None:
        return None
    hours, minutes, seconds = (int(match[name]) for name in ("hours", "minutes", "seconds"))
    fraction = int((match["fraction"] or "")[:9].ljust(9, "0"))
    return np.timedelta64(1_000_000_000 * (3600 * hours + 60 * minutes + seconds) + fraction, "ns")


def over_midnight(stamps: np.ndarray) -> np.ndarray:
    """Times of the day (N,) that go on after midnight: it lies where they go back by more than half a day."""
    days = np.cumsum(np.diff(stamps, prepend=stamps[:1]) < -np.timedelta64(12, "h"))
    return stamps + days.astype("timedelta64[D]")


def no_stamp(file: str, name: str, place: str, value: object) -> InvalidInput:
    """The refusal of a value among times."""
    text = value.strip() if isinstance(value, str) else ""
    advice = "leave the row out"
    if "," in text and is_number(text.replace(",", ".", 1)):
        advice = f"a decimal point: {text.replace(',', '.')}"
    elif _LIKE_CLOCK.match(text):
        advice = "times of the day as 23:59:59.5, of 24 hours, or seconds"
    elif _LIKE_DATE.match(text):
        advice = "dates as 2026-01-31T12:00:00.5, year, month and day in this order"
    return InvalidInput(
        f"{file}, {place}: this is no time.",
        f"expected a finite number in every row of the column {value_text(name, 60)}, or a date such as "
        f"2026-01-31T12:00:00.5 or 31.01.2026 12:00:00,5, or a time of the day in every row; got "
        f"{value_text(value, 60)}",
        advice,
    )


def stamps_of_numbers(stamps: np.ndarray) -> tuple[np.ndarray, float, bool]:
    """As `stamps_of_text`; integers and dates are subtracted as integers, of which no digit is lost."""
    if not len(stamps):
        return np.zeros(0), 0.0, False
    is_date = stamps.dtype.kind in "mM"
    numbers = stamps.astype(f"{stamps.dtype.kind}8[ns]").astype(np.int64) if is_date else stamps
    if numbers.dtype.kind in "iu":
        first = int(numbers[0])
        return (
            np.array([int(stamp) - first for stamp in numbers.tolist()], dtype=float),
            float(first),
            is_date,
        )
    return numbers.astype(float) - float(numbers[0]), float(numbers[0]), is_date


def nanoseconds(seconds: np.ndarray, fractions: np.ndarray) -> np.ndarray:
    """Whole seconds (N,) and nanoseconds (N,) as one integer of nanoseconds (N,)."""
    return 1_000_000_000 * seconds.astype(np.int64) + fractions.astype(np.int64)


def row_place(row: int) -> str:
    """Where the row of a file without lines is, for messages."""
    return f"row {row + 1}"


def first_place(flags: np.ndarray) -> int | None:
    """The place of the first of flags (N,) that is set, None where none is."""
    return int(np.argmax(flags)) if flags.any() else None


def refuse_rows(name: str, rows: int) -> None:
    """Refuse a file of too many rows or messages."""
    refuse_if(
        rows > MOST_ROWS,
        f"{name} has too many rows.",
        f"expected at most {MOST_ROWS}, got {rows}",
        "several files",
    )


@contextlib.contextmanager
def foreign_errors(path: Path, kind: str) -> Generator[None]:
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
