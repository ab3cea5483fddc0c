"""Waypoints as people write them, of the joints or of a point of the robot: a CSV file, or columns by name.

A file has a header with ``time`` and the joints' names, each with its unit behind it where that is not the SI unit, and
one row per waypoint; lines that begin with # are comments::

    time [s], shoulder [deg], elbow [deg]
    0,        0,              0
    0.8,      30,             -20
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, cast

from flexhinf.errors import InvalidInput
from flexhinf.robot.parameters import SECONDS, SLIDING, TURNING, per_joint, split
from flexhinf.robot.table import name_and_unit, read_table
from flexhinf.validation import HUGE, late_package, nearest, real_array, value_text

if TYPE_CHECKING:
    import numpy as np

    from flexhinf.arrays import Vector
    from flexhinf.robot.kinematics import Reached
    from flexhinf.robot.robot import Robot
else:
    np = late_package("numpy")

#: The workspace that is the default: all poses within the joint ranges.
LIMITS = "limits"

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
        full = {per_joint("link_position", joint, len(joints)): joint for joint in joints}
        named = [full.get(name, name) for name in self.joints]
        for name in named:
            if name not in joints:
                raise WaypointError(
                    f"The waypoints have a column {value_text(name, 60)}, and the robot no such joint.",
                    f"expected 'time' and {list(joints)}, got {['time', *self.joints]}",
                    nearest(
                        name, joints, "the joints as `flexhinf robots` shows them, or x, y and z of a point"
                    ),
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


class TimedSignal(Protocol):
    """A signal that ends, with its derivatives."""

    duration: float
    derivatives: Callable[..., object]


def waypoints(value: object, timed: bool = True) -> WaypointTable | TimedSignal:
    """A `WaypointTable` of a file or of columns by name; a signal with derivatives and a duration stays as it is.

    Without a column ``time`` rows are 1 s apart where they need not be `timed`.
    """
    if path := _path_text(value):
        return _read(Path(path), timed)
    if isinstance(value, Mapping):
        columns = cast("Mapping[object, Any]", value)
        return _table(
            list(columns), list(columns.values()), "The waypoints", lambda row: f"row {row + 1}", timed
        )
    if isinstance(value, WaypointTable) or (hasattr(value, "derivatives") and hasattr(value, "duration")):
        return cast("WaypointTable | TimedSignal", value)
    raise ValueError(value)


def _path_text(value: object) -> str:
    path = str(cast(object, value)) if isinstance(value, (str, os.PathLike)) else ""
    return path if path.strip() else ""


def states_range(workspace: str) -> bool:
    """Whether a text is a workspace itself, and no file of waypoints."""
    return workspace.strip() == LIMITS or ":" in workspace or "=" in workspace


def stated_workspace(value: Any) -> str | WaypointTable:
    """Text; one (low, high) per joint, as text; or a `WaypointTable` of a file, of columns by name, or of a table."""
    value = value.to_dict("list") if hasattr(value, "to_dict") else value
    if isinstance(value, str) and states_range(value):
        return value.strip()
    if isinstance(value, (list, tuple, np.ndarray)):
        pairs = np.array(value, dtype=object)
        if pairs.ndim != 2 or pairs.shape[1] != 2:
            raise ValueError(value_text(cast(object, value)))
        return ",".join(f"{low}:{high}" for low, high in pairs)
    if isinstance(value, str) and all(_is_position(part) for part in value.split(",")):
        ends = [part.strip() for part in value.split(",")]
        ends = ends if len(ends) > 1 else ["-1", "1"]
        raise WaypointError(
            "A workspace is one range for each joint.",
            f"expected LOW:HIGH, got {value_text(value, 60)}",
            f"--workspace {','.join(map(':'.join, zip(ends[::2], ends[1::2])))}",
        )
    table = waypoints(value, timed=False)
    if isinstance(table, WaypointTable):
        return table
    raise ValueError(value_text(value))


def _is_position(text: str) -> bool:
    parts = split(text.strip())
    return parts is not None and parts[1] in ("", *TURNING, *SLIDING)


def _read(path: Path, timed: bool) -> WaypointTable:
    try:
        heading, numbered, _ = read_table(path, LARGEST, MOST_ROWS, "waypoints as CSV")
        rows = list(numbered)
    except InvalidInput as error:
        raise WaypointError(error.what, error.found, error.advice) from None
    columns = [[_number(row.cells[k]) for row in rows] for k in range(len(heading))]
    return _table(
        heading, columns, f"{path.name}: the waypoints", lambda row: f"line {rows[row].line}", timed
    )


def _number(cell: str) -> float | str:
    try:
        return float(cell.replace("_", "x"))
    except ValueError:
        return cell


def _table(
    heading: Sequence[object],
    columns: Sequence[Any],
    what: str,
    place: Callable[[int], str],
    timed: bool = True,
) -> WaypointTable:
    named = [name_and_unit(name) if isinstance(name, str) else ("", "") for name in heading]
    if not timed and columns and ("time" not in (name for name, _ in named)):
        named, columns = [("time", ""), *named], [list(range(np.size(columns[0]))), *columns]
    names = [name for name, _ in named]
    if "time" not in names or len(names) < 2 or not all(names) or len(set(names)) < len(names):
        raise WaypointError(
            f"{what} need one column 'time' and one for each joint.",
            f"expected time,shoulder,elbow, each once, got {value_text(list(heading))}",
            "a header 'time [s],shoulder [deg],elbow [deg]'",
        )
    values: dict[str, Vector] = {}
    for (name, unit), column in zip(named, columns):
        units = SECONDS if name == "time" else {**TURNING, **SLIDING}
        if unit and unit not in units:
            raise WaypointError(
                f"{what} have a unit that is not known.",
                f"expected one of {list(units)} for {value_text(name, 60)}, got {value_text(unit, 60)}",
                f"'{name} [{next(iter(units))}]'",
            )
        values[name] = units.get(unit, 1.0) * _numbers(column)
    times = values["time"]
    if times.ndim != 1 or any(column.shape != times.shape for column in values.values()) or len(times) < 2:
        raise WaypointError(
            f"{what} do not make a motion.",
            "expected at least two, one position of each joint per time, got "
            + ", ".join(f"{array.size} of {name!r}" for name, array in values.items()),
            "a first row where the motion begins, and one where it ends",
        )
    usable = np.abs(np.column_stack([values[name] for name in names])) <= HUGE
    if not usable.all():
        row, column = np.argwhere(~usable)[0].tolist()
        raise WaypointError(
            f"{what} hold what is no usable number.",
            f"expected finite ones of at most {HUGE:g}, units in the header ('elbow [deg]'), got "
            f"{value_text(columns[column][row], 60)} of {value_text(cast(object, names[column]), 60)} in {place(row)}",
            "0.5, or leave the row out",
        )
    del values["time"]
    if not (np.diff(times) > 0.0).all():
        row = int(np.argmax(np.diff(times) <= 0.0)) + 1
        raise WaypointError(
            f"{what} are not in the order of time.",
            f"expected increasing times, got {times[row]:g} s after {times[row - 1]:g} s in {place(row)}",
            "sort the rows, and drop repeated times",
        )
    rows = tuple(tuple(row) for row in np.column_stack(list(values.values())).tolist())
    units = tuple(unit for name, unit in named if name != "time")
    return WaypointTable(tuple((times - times[0]).tolist()), tuple(values), units, rows)


def _numbers(column: Any) -> np.ndarray:
    """Numbers of a column; NaN where something else stands, true, false and text included."""
    entries: object = column
    if isinstance(column, np.ndarray) and column.ndim == 1:
        entries = cast("object", column.tolist())
    if isinstance(entries, (list, tuple)):
        listed = cast("Sequence[object]", entries)
        entries = [np.nan if isinstance(entry, (bool, np.bool_, str)) else entry for entry in listed]
    return real_array(entries)


AXES = ("x", "y", "z")

#: Most waypoints of a point: each is a search.
MOST = 500


class Tool(NamedTuple):
    """The point that goals are for: of a link, by the name of its joint (None: the last), at an offset (3,), m."""

    link: str | None = None
    offset: tuple[float, ...] = (0.0, 0.0, 0.0)


#: The origin of the last link.
ORIGIN = Tool()


def in_space(robot: Robot, table: Any) -> bool:
    """Whether waypoints are places x, y, z of a point, and not positions of joints that are called so."""
    return isinstance(table, WaypointTable) and set(table.joints) == set(AXES) != set(robot.joint_names)


def reached_waypoints(robot: Robot, table: WaypointTable, tool: Tool) -> tuple[WaypointTable, Reached]:
    """Waypoints x, y, z of a point as those of the joints, each pose by a search from the one before; the worst pose.

    Raises WaypointError: for a place out of reach, for too many waypoints, for columns that are not x, y, z.
    """
    from flexhinf.robot import kinematics  # not for `flexhinf --help`

    wrong = [unit for unit in table.units if unit and unit not in SLIDING]
    if set(table.joints) != set(AXES) or len(table.joints) != 3 or wrong or len(table.rows) > MOST:
        raise WaypointError(
            "The waypoints are not those of a point.",
            f"expected columns x, y, z in m or mm, at most {MOST}, got {list(table.joints)} in {list(table.units)}, "
            f"{len(table.rows)} rows",
            "time,x [m],y [m],z [m]",
        )
    order, joints = [table.joints.index(axis) for axis in AXES], robot.joint_names
    poses: list[Reached] = []
    for time, row in zip(table.times, table.rows):
        near = poses[-1].pose if poses else None
        try:
            poses.append(kinematics.pose_at(robot, [row[k] for k in order], tool.link, tool.offset, near))
        except InvalidInput as error:
            raise WaypointError(f"{error.what} (waypoint at {time:g} s)", error.found, error.advice) from None
    rows = tuple(tuple(reached.pose.tolist()) for reached in poses)
    worst = min(poses, key=lambda reached: reached.mobility)
    return WaypointTable(table.times, joints, ("",) * len(joints), rows), worst
