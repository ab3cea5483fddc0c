"""Waypoints of the joints as people write them: a CSV file, columns by name, or a signal.

A file has a header with ``time`` and the joints' names, each with its unit behind it where that is not the SI unit, and
one row per waypoint; lines that begin with # are comments::

    time [s], shoulder [deg], elbow [deg]
    0,        0,              0
    0.8,      30,             -20
"""

from __future__ import annotations

import csv
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, WithJsonSchema

from flexhinf.design.options import SECONDS, SLIDING, TURNING, Allowed
from flexhinf.errors import InvalidInput
from flexhinf.validation import HUGE, nearest, read_text, real_array, value_text

#: Largest file, bytes, and most rows: 100 s at 1 kHz.
LARGEST, MOST_ROWS = 20_000_000, 100_000


class WaypointError(InvalidInput):
    """Waypoints that cannot be used, with where they stand."""


@dataclass(frozen=True)
class WaypointTable:
    """Positions of joints at times, not yet of a certain robot."""

    times: tuple[float, ...]  # From 0 on, increasing, s
    joints: tuple[str, ...]  # Names of the columns
    units: tuple[str, ...]  # Those that were stated; empty where none was
    rows: tuple[tuple[float, ...], ...]  # Positions at each time, rad or m

    def columns(self) -> dict[str, list[float]]:
        """Columns of the table by name, in SI units, as `waypoints` takes them: for a design file."""
        return {"time": list(self.times), **dict(zip(self.joints, np.array(self.rows).T.tolist()))}

    def positions(self, joints: Sequence[str], slides: Sequence[bool]) -> np.ndarray:
        """Positions (N, n) of a robot's joints, in their order."""
        from flexhinf.robot.signals import signal_names  # `flexhinf --help` reads fields, and no robot

        full = dict(zip(signal_names("link_position", joints), joints))
        named = [full.get(name, name) for name in self.joints]
        for name in named:
            if name not in joints:
                raise WaypointError(
                    f"The waypoints have a column {value_text(name, 60)}, and the robot no such joint.",
                    f"expected 'time' and {list(joints)}, got {['time', *self.joints]}",
                    nearest(name, joints, "the names of the joints as `flexhinf robots` shows them"),
                )
        missing = [name for name in joints if name not in named]
        if missing or len(set(named)) < len(named):
            raise WaypointError(
                "The waypoints do not have one column for each joint.",
                f"expected each of {list(joints)} once, got {list(self.joints)}",
                f"a column for {', '.join(missing)}; the same position in every row where a joint stays"
                if missing
                else "each joint once",
            )
        for name, unit in zip(named, self.units):
            fitting = SLIDING if slides[list(joints).index(name)] else TURNING
            if unit and unit not in fitting:
                raise WaypointError(
                    f"The unit of the waypoints of joint {name!r} does not fit it.",
                    f"expected one of {list(fitting)}, got {unit!r}",
                    f"'{name} [{next(iter(fitting))}]' in the header",
                )
        return np.array(self.rows)[:, [named.index(name) for name in joints]]


def waypoints(value: Any) -> Any:
    """A `WaypointTable` of a file or of columns by name; a signal with derivatives and a duration stays as it is."""
    if isinstance(value, (str, os.PathLike)) and str(value).strip():
        return _read(Path(value))
    if isinstance(value, Mapping):
        return _table(dict(value), "The waypoints", lambda row: f"row {row + 1}")
    if isinstance(value, WaypointTable) or (hasattr(value, "derivatives") and hasattr(value, "duration")):
        return value
    raise ValueError(value)


def _read(path: Path) -> WaypointTable:
    try:
        text = read_text(path, LARGEST, "waypoints as CSV")
    except InvalidInput as error:
        raise WaypointError(error.what, error.found, error.advice) from None
    numbered = enumerate(text.removeprefix("\ufeff").splitlines(), 1)
    kept = [(k, line) for k, line in numbered if line.strip() and not line.lstrip().startswith("#")]
    delimiter = ";" if kept and ";" in kept[0][1] else ","
    try:
        cells = list(csv.reader((line for _, line in kept), delimiter=delimiter))
    except csv.Error as error:
        raise WaypointError(
            f"{path.name}: this is no CSV file.", f"expected rows of numbers, got: {error}", "time,shoulder"
        ) from None
    if len(cells) != len(kept) or len(kept) > MOST_ROWS + 1:
        raise WaypointError(
            f"{path.name}: its rows cannot be read.",
            f"expected one waypoint a line, at most {MOST_ROWS}, without line breaks in quotes; got {len(kept)} lines",
            "fewer rows: the motion between them is smooth",
        )
    lines = [k for k, _ in kept[1:]]
    heading = [name.strip() for name in (cells[0] if cells else [])]
    if len(set(heading)) < len(heading) or not all(heading):
        raise WaypointError(
            f"{path.name}: the header does not name each column once.",
            f"expected time and the names of the joints, got {value_text(heading)}",
            "time,shoulder,elbow",
        )
    columns: dict[str, list[float]] = {name: [] for name in heading}
    for line, row in zip(lines, cells[1:]):
        if len(row) != len(heading):
            raise WaypointError(
                f"{path.name}, line {line}: the number of values is not that of the columns.",
                f"expected {len(heading)}, got {len(row)}", "one value for each column of the header",
            )  # fmt: skip
        for name, cell in zip(heading, row):
            try:
                columns[name].append(float(cell.replace("_", "x")))
            except ValueError:
                raise WaypointError(
                    f"{path.name}, line {line}: {value_text(name, 60)} is no number.",
                    f"expected a number, its unit in the header ('elbow [deg]'), got {value_text(cell, 60)}",
                    "0.5",
                ) from None
    return _table(columns, f"{path.name}: the waypoints", lambda row: f"line {lines[row]}")


def _table(columns: dict[Any, Any], what: str, place: Any) -> WaypointTable:
    named = [_heading(name) if isinstance(name, str) else ("", "") for name in columns]
    names = [name for name, _ in named]
    if "time" not in names or len(names) < 2 or not all(names) or len(set(names)) < len(names):
        raise WaypointError(
            f"{what} need one column 'time' and one for each joint.",
            f"expected time,shoulder,elbow, got {value_text(list(columns))}",
            "a header 'time [s],shoulder [deg],elbow [deg]'",
        )
    values = {}
    for (name, unit), column in zip(named, columns.values()):
        units = SECONDS if name == "time" else {**TURNING, **SLIDING}
        if unit and unit not in units:
            raise WaypointError(
                f"{what} have a unit that is not known.",
                f"expected one of {list(units)} for {value_text(name, 60)}, got {value_text(unit, 60)}",
                f"'{name} [{next(iter(units))}]'",
            )
        values[name] = units.get(unit, 1.0) * _numbers(column)
    times = values.pop("time")
    positions = list(values.values())
    if times.ndim != 1 or any(column.shape != times.shape for column in positions) or len(times) < 2:
        raise WaypointError(
            f"{what} do not make a motion.",
            "expected at least two, one position of each joint per time, got "
            + ", ".join(f"{array.size} of {name!r}" for name, array in {"time": times, **values}.items()),
            "a first row where the motion begins, and one where it ends",
        )
    both = np.column_stack([times, *positions])
    usable = np.abs(both) <= HUGE
    if not usable.all():
        row, column = np.argwhere(~usable)[0].tolist()
        raise WaypointError(
            f"{what} hold what is no usable number.",
            f"expected finite ones of at most {HUGE:g}, got {both[row, column]} of "
            f"{value_text(['time', *values][column], 60)} in {place(row)}",
            "leave the row out",
        )
    if not (np.diff(times) > 0.0).all():
        row = int(np.argmax(np.diff(times) <= 0.0)) + 1
        raise WaypointError(
            f"{what} are not in the order of time.",
            f"expected increasing times, got {times[row]:g} s after {times[row - 1]:g} s in {place(row)}",
            "sort the rows, and drop repeated times",
        )
    rows = tuple(map(tuple, np.column_stack(positions).tolist()))
    units = tuple(unit for name, unit in named if name != "time")
    return WaypointTable(tuple((times - times[0]).tolist()), tuple(values), units, rows)


def _numbers(column: Any) -> np.ndarray:
    """Numbers of a column; NaN where something else stands, true and false included."""
    entries = column.tolist() if isinstance(column, np.ndarray) and column.ndim == 1 else column
    if isinstance(entries, (list, tuple)):
        entries = [np.nan if isinstance(entry, (bool, np.bool_)) else entry for entry in entries]
    return real_array(entries)


def _heading(text: str) -> tuple[str, str]:
    text = text.strip()
    for opening, closing in ("[]", "()"):
        if text.endswith(closing) and opening in text:
            name, _, unit = text[:-1].rpartition(opening)
            return name.strip(), unit.strip()
    return text, ""


Move = Annotated[
    Any,
    BeforeValidator(waypoints),
    Allowed("a CSV file with columns time and joints, or such columns by name"),
    WithJsonSchema({"anyOf": [{"type": "string"}, {"type": "object"}]}),
]
