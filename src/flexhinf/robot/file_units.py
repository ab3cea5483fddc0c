"""Numbers with units as text in a robot file: read before anything else, checked once the robot is there.

Which unit a spring has depends on its joint: N·m/rad where it turns, N/m where it slides. A file may say that only by
its URDF, and what its motors are driven by only at the end; so both are read, and compared with the robot.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

from flexhinf.errors import InvalidInput
from flexhinf.robot.drive import DRIVES
from flexhinf.robot.file_errors import place_text
from flexhinf.robot.quantities import INERTIA, QUANTITIES
from flexhinf.robot.robot import Robot
from flexhinf.robot.signals import UNITS
from flexhinf.robot.units import Stated, measured
from flexhinf.untrusted import value_text

Units = tuple[str, ...]

_LENGTH, _POSITION = ("m",), UNITS["link_position"]
_EFFORT = tuple(dict.fromkeys(unit for drive in DRIVES.values() for unit in UNITS[drive]))
_OF_JOINT = {name: tuple(dict.fromkeys(known[:2])) for name, known in QUANTITIES.items()}
_INERTIA: dict[str, Units] = dict.fromkeys(INERTIA, ("kg·m²",))

#: Units of the keys of each table; for a joint that turns and one that slides where there are two.
TABLES: dict[str, dict[str, Units]] = {
    "": {"gravity": ("m/s²",), "home": _POSITION},
    "joint": {
        "limits": _POSITION, "speed_limit": UNITS["link_velocity"], "effort_limit": _EFFORT, "xyz": _LENGTH,
        "rpy": ("rad",),
    },
    "payload": {
        "mass": ("kg",), "centre_of_mass": _LENGTH, "sphere": _LENGTH, "box": _LENGTH, "cylinder": _LENGTH,
    },
    "inertia": _INERTIA,
    "link": {
        "mass": ("kg",), "centre_of_mass": _LENGTH, "axis_inertia": ("kg·m²",), "length": _LENGTH,
    },
    "spring": _OF_JOINT, "motor": _OF_JOINT,
}  # fmt: skip


class Found(NamedTuple):
    """A number that was text: where it stands in the file, and what it is."""

    place: tuple[Any, ...]
    number: Stated


def read_units(data: dict[str, Any], file: str) -> list[Found]:
    """Put numbers where text with a unit stands in the tables of a file.

    Returns
    -------
    list of Found
        What `check_units` compares with the robot.

    Raises
    ------
    InvalidInput
        For text that is no number with a unit of what its key measures.
    """
    found: list[Found] = []
    for table, place, kind in _tables(data):
        for key in list(table):
            where = (*place, key)
            if key == "locked" and not place and isinstance(table[key], dict):
                for name, value in table[key].items():
                    table[key][name] = _read(value, _POSITION, (*where, name), data, file, found)
            elif kind == "tolerances" or key == "tolerance":
                table[key] = _percent(table[key], where, data, file)
            elif key in TABLES.get(kind, {}):
                table[key] = _read(table[key], TABLES[kind][key], where, data, file, found)
    return found


def _tables(data: dict[str, Any]) -> Iterator[tuple[dict[str, Any], tuple[Any, ...], str]]:
    """The tables of a file that hold numbers, where they stand, and what kind they are."""
    yield data, (), ""
    for kind in ("joint", "payload"):
        rows = data.get(kind)
        for number, row in enumerate(rows if isinstance(rows, list) else ()):
            if not isinstance(row, dict):
                continue
            yield row, (kind, number), kind
            below = {name: row.get(name) for name in ("link", "spring", "motor", "tolerances", "inertia")}
            for name, table in below.items():
                if isinstance(table, dict):
                    yield table, (kind, number, name), name
            link = below["link"]
            if isinstance(link, dict) and isinstance(link.get("inertia"), dict):
                yield link["inertia"], (kind, number, "link", "inertia"), "inertia"
    if isinstance(data.get("tolerances"), dict):
        yield data["tolerances"], ("tolerances",), "tolerances"


def _read(
    value: Any, units: Units, place: tuple[Any, ...], data: dict[str, Any], file: str, found: list[Found]
) -> Any:
    """A value with numbers for its text: text, a list, or a table with value, range and tolerance."""
    if isinstance(value, list):
        return [_read(one, units, place, data, file, found) for one in value]
    if isinstance(value, dict):
        numbers = {
            key: _read(value[key], units, place, data, file, found)
            for key in ("value", "range")
            if key in value
        }
        if "tolerance" in value:
            numbers["tolerance"] = _percent(value["tolerance"], (*place, "tolerance"), data, file)
        return {**value, **numbers}
    if not isinstance(value, str):
        return value
    try:
        number = measured(value, *units)
    except ValueError:
        raise _refusal(value, units, place, data, file) from None
    found.append(Found(place, number))
    return float(number)


def _percent(value: Any, place: tuple[Any, ...], data: dict[str, Any], file: str) -> Any:
    """A tolerance, per cent, from text with that sign."""
    if not isinstance(value, str):
        return value
    try:
        if not value.rstrip().endswith("%"):
            raise ValueError(value)
        return 100.0 * float(measured(value, "1"))
    except ValueError:
        raise _refusal(value, ("%",), place, data, file) from None


def _refusal(
    value: str, units: Units, place: tuple[Any, ...], data: dict[str, Any], file: str
) -> InvalidInput:
    *before, key = place
    plain = " or ".join(unit.replace("1", "no unit") for unit in units)
    return InvalidInput(
        f"{file}: {place_text(tuple(before), data)} has a value of {str(key)!r} that is no number, or in another unit.",
        f"expected a valid number in {plain}, or text of a number with such a unit, got {value_text(value, 60)}",
        f"{key} = {'0.8' if units[0] == '1' else repr('5 ' + units[0])}",
    )


def check_units(found: list[Found], data: dict[str, Any], file: str, robot: Robot) -> Robot:
    """The robot; refuses units of a joint that turns where it slides, and of another drive.

    Raises
    ------
    InvalidInput
        With the key, its value and the unit that the joint has.
    """
    slides = dict(zip(robot.joint_names, robot.links.slides))
    for place, number in found:
        if place[0] == "home" or (len(place) > 2 and place[0] == "joint"):
            key = place[-1]
            name = data["joint"][place[1]].get("name") if place[0] == "joint" else None
            kinds = {slides[name]} if name in slides else set(slides.values()) if name is None else set()
            if key == "effort_limit":
                fitting = {UNITS[DRIVES[robot.drive]][kind] for kind in kinds}
            else:
                units = TABLES.get(place[-2] if len(place) > 3 else place[0] if len(place) > 1 else "", {})[
                    key
                ]
                fitting = {units[kind if len(units) > 1 else 0] for kind in kinds}
            if fitting and number.si not in fitting:
                raise _refusal(number.number + " " + number.unit, tuple(sorted(fitting)), place, data, file)
    return robot
