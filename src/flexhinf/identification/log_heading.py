"""The columns of a log's file, by the names that people call them, with the units that stand there."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.identification.log_columns import FileColumns, Loaded
from flexhinf.identification.log_units import is_other, unit_in, unit_size, units_of, with_unit, without_unit
from flexhinf.robot.parameters import SECONDS, respelled
from flexhinf.robot.table import name_and_unit
from flexhinf.validation import checked_kind, is_real, nearest, real_number, value_text

#: Names of the column of times that need not be stated.
TIMES = ("time", "t", "timestamp", "stamp")

#: Ends of the names of two columns that are a time together: whole seconds, and nanoseconds above them.
_SECONDS, _NANOSECONDS = ("sec", "secs", "s"), ("nanosec", "nsec", "nsecs", "nanosecs", "ns")


class NamedColumn(NamedTuple):
    """A column of the file: its place, its name without the unit, and the unit or number that stands there.

    `nanoseconds`: of whole seconds the place of the column with their fractions, else None.
    """

    place: int
    name: str
    unit: str
    nanoseconds: int | None = None

    @property
    def places(self) -> list[int]:
        """The places of the column, and of its fractions."""
        return [self.place, *([] if self.nanoseconds is None else [self.nanoseconds])]


class Heading:
    """The columns of a file, by the names that people call them."""

    def __init__(self, file: FileColumns, units: Mapping[str, str | float]) -> None:
        self.file, self.units = file, units
        self.columns: list[NamedColumn] = []
        for place, text in enumerate(file.names):
            name, unit = name_and_unit(text)
            if unit.isdigit():  # position[0] of an array
                name, unit = text.strip(), ""
            self.columns.append(NamedColumn(place, name, unit))
        self._unused = dict.fromkeys(map(str, units))

    def named(self, text: str) -> list[NamedColumn]:
        """The columns that are called so, with their unit or without it."""
        exact = [column for column in self.columns if self.file.names[column.place].strip() == text.strip()]
        return exact or [column for column in self.columns if column.name == text.strip()]

    def column(self, text: str, what: str) -> NamedColumn:
        """The column of a stated name, with the unit that is stated behind it."""
        checked_kind(f"The column of {what} has no name.", text, str, "text", "'pos' or 'pos [deg]'")
        columns, (name, unit) = self.named(text), name_and_unit(text)
        if not columns and unit:
            columns = [column._replace(unit=unit) for column in self.named(name)]
        if not columns:
            raise InvalidInput(
                f"{self.file.path.name} has no column {value_text(text, 60)} for {what}.",
                f"expected one of {[name.strip() for name in self.file.names]}",
                nearest(name, [column.name for column in self.columns], "a name of the header"),
            )
        return self.only(columns, what)

    def only(self, columns: Sequence[NamedColumn], what: str) -> NamedColumn:
        """The one of several columns of a name; refused if there are more."""
        count = {2: "two", 3: "three"}.get(len(columns), str(len(columns)))
        places = ", ".join(f"column {column.place + 1}" for column in columns)
        refuse_if(
            len(columns) > 1,
            f"{self.file.path.name} has {count} columns for {what}: {places}.",
            f"expected one, got {[self.file.names[column.place].strip() for column in columns]}",
            f"other names in the file for all but one of the columns {columns[0].name!r}",
        )
        return columns[0]

    def in_stated_unit(self, column: NamedColumn, signal: str = "") -> NamedColumn:
        """The column with the unit that is stated for it or for its signal, else as it is."""
        for key in (signal, column.name, self.file.names[column.place].strip()):
            if key in self.units:
                self._unused.pop(key, None)
                unit = self.units[key]
                text = unit if isinstance(unit, str) else repr(float(unit)) if is_real(unit) else ""
                refuse_if(
                    not text,
                    f"The unit of {key!r} is none.",
                    f"expected text or a number, got {value_text(unit)}",
                    f"units={{{key!r}: 'deg'}}",
                )
                column = column._replace(unit=text.strip())
        return column

    def check_units(self) -> None:
        """Refuse units of columns and signals that are not read."""
        for key in self._unused:
            names = [column.name for column in self.columns]
            raise InvalidInput(
                f"A unit is stated for {value_text(key, 60)}, which is not read from {self.file.path.name}.",
                f"expected a signal of the plant or one of {names}",
                nearest(key, names, "leave it out"),
            )

    def stamp(self, time: str | None) -> NamedColumn:
        """The column of times: that of the name; else time, t, timestamp or stamp, such a name with its unit behind it,
        whole seconds and nanoseconds, or the only column with such a name behind a path, ``header.stamp``."""
        if time is not None:
            pair = None if self.named(time) else self._paired(time)
            return pair or self._whole(self.in_stated_unit(self.column(time, "the time")))
        called = [[each for each in self.columns if _plain(each.name) == name] for name in TIMES]
        pairs = [pair for each in self.columns if (pair := self._paired(each.name)) is not None]
        ending = [each for each in self.columns if _plain(without_unit(each.name, "s")[0]) in TIMES]
        paths = [each for each in self.columns if _plain(re.split(r"[./]", each.name)[-1]) in TIMES]
        columns = next(filter(None, [*called, list(dict.fromkeys(pairs)), ending]), list[NamedColumn]())
        if columns or len(paths) == 1:
            return self._whole(self.in_stated_unit(self.only(columns or paths, "the time")))
        names = [column.name for column in self.columns]
        refuse_if(
            len(names) == 1 or not self.file.has_header,
            f"{self.file.path.name} has no header.",
            "expected the names of columns in the first row, got "
            + (f"{names}" if self.file.has_header else f"{len(names)} numbers"),
            "a header 'time,motor_torque,motor_position' as the first row; what stands before it begins with #"
            + "; or columns by their numbers, time='1', columns={'motor_position': '2'}"
            * (not self.file.has_header),
        )
        raise InvalidInput(
            f"{self.file.path.name} has no column of times.",
            f"expected one of {list(TIMES)}, got {names}",
            self._advised_time(),
        )

    def _advised_time(self) -> str:
        """What to state where no column has a name of times: one with a unit of times before all others."""
        free = [column for column in self.columns if not is_other(column.name, column.unit, "time", "s")]
        choices = [each for each in free if unit_in(each.unit or each.name, "s")] or free or self.columns
        near = nearest("time", [column.name for column in choices], "")
        column = next((each for each in choices if repr(each.name) == near), choices[0])
        name = column.name
        text, what = (f"{name} [{column.unit}]", "") if column.unit else with_unit(name, "s", TIMES)
        plain = text == name
        return f"time={text!r}{what}" + f", or with the unit of its numbers: time='{name} [ms]'" * plain

    def _paired(self, name: str) -> NamedColumn | None:
        """Whole seconds with the column of their nanoseconds, of the name of the first one or of what both begin with;
        None where there are none. Where the file has both as one column, ``topic/header/stamp``, that one."""
        text = name.strip()
        for seconds in _SECONDS:
            start = text.removesuffix(seconds) if text.endswith(seconds) else None
            starts = [f"{text}{mark}" for mark in "._/"] if start is None else [start]
            for begin in starts:
                whole = self.named(f"{begin}{seconds}")
                parts = [column for end in _NANOSECONDS for column in self.named(f"{begin}{end}")]
                if len(whole) == len(parts) == 1:
                    joint = self.named(begin.rstrip("._/"))
                    if len(joint) == 1:
                        return joint[0]
                    return whole[0]._replace(unit="ns", nanoseconds=parts[0].place)
        return None

    def _whole(self, stamp: NamedColumn) -> NamedColumn:
        """A column of times; of whole seconds with the column of their nanoseconds."""
        return (self._paired(stamp.name) if not stamp.unit or stamp.unit == "s" else None) or stamp

    def seconds(self, stamp: NamedColumn, loaded: Loaded) -> float:
        """What a unit of the stamps is in seconds."""
        unit = stamp.unit or unit_in(stamp.name, "s")
        return self.size(stamp._replace(unit=unit), "the time", ("s",)) if unit else SECONDS[loaded.unit()]

    def scale(self, column: NamedColumn, what: str, unit: str, plain: bool) -> float:
        """What a unit of the column of a signal is in the signal's unit; `plain`: its name is none with a unit, where
        ``pos_deg`` is in deg."""
        if not column.unit and not plain:
            column = column._replace(unit=unit_in(column.name, unit))
        return self.size(column, what, (unit,) if unit else ()) if column.unit else 1.0

    def size(self, column: NamedColumn, what: str, si: Sequence[str]) -> float:
        """What a unit of the column is in one of these SI units; a plant without units takes SI units as they are."""
        size = real_number(_float(column.unit.strip()))
        if np.isfinite(size) and size != 0.0:
            return size
        with suppress(ValueError):
            return unit_size(column.unit, si)
        meant = [spelled.removeprefix("1 ") for spelled in respelled(f"1 {column.unit.strip()}", *si)]
        raise InvalidInput(
            f"{self.file.path.name}: the unit of {column.name!r} does not fit {what}.",
            f"expected {' or '.join(si) or 'the unit of a plant that states one'}, or what measures the same, got "
            f"{column.unit!r}",
            " or ".join(meant)
            or f"in the place of {column.unit!r} "
            + (units_of(si[0]) if si else "a number: what one is in the unit of the plant"),
        )


def _plain(name: str) -> str:
    """A name of a column of times in small letters, without what some programs write before it."""
    return name.casefold().lstrip("%_ ")


def _float(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return float("nan")
