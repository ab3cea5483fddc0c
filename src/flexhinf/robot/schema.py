"""Schema of robot files: their keys, read, checked and converted to SI units in one walk.

`TABLES` states each key once: what may stand there, its units, and whether it must. Which unit a spring has depends on
its joint, N·m/rad where it turns and N/m where it slides, and on what the motors are driven by; a file may say that
only by its URDF or at its end. So both units are read, and compared with the robot that comes of it (`check_units`).
"""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any, NamedTuple

from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.robot.dynamics import KINDS
from flexhinf.robot.elastic import DRIVES, SPRING
from flexhinf.robot.parameters import INERTIA, QUANTITIES, Stated, measured, respelled
from flexhinf.robot.parts import ElasticJoint
from flexhinf.robot.signals import UNITS
from flexhinf.validation import nearest, real_number, value_text

#: A tolerance below this many per cent was probably meant as a fraction.
SMALLEST_TOLERANCE = 0.5

#: How the tables of a joint are written.
NESTING = (
    "[[joint]], two brackets, and below it [joint.link], [joint.spring] and [joint.motor] of that joint; each joint "
    "has its name in a line name = '…'"
)

#: What to write for a table that is missing.
MISSING = {
    "spring": "[joint.spring] with stiffness = … (N·m/rad; N/m for a prismatic joint)",
    "joint": "one [[joint]] table per joint, with name, link, spring and motor",
    "weights": "weights = {link_position = 60, link_position_integral = 300}",
    "name": "name = 'shoulder'",
}


class RobotFileWarning(UserWarning):
    """A robot file says something that is allowed and probably not meant."""


def ask(what: str, found: str, advice: str, wrong: bool = False) -> None:
    """Warn of a number that is probably not what was meant; refuse it where it is surely wrong."""
    refuse_if(wrong, what, found, advice)
    warnings.warn(f"{what}\n  found: {found}\n  try:   {advice}", RobotFileWarning, stacklevel=3)


class Unusable(ValueError):
    """A value that its key does not take; its texts are what was expected, and what to write behind "="."""


def _plain(file: RobotFile, value: Any, key: Key, place: tuple[Any, ...]) -> Any:
    return value


class Key(NamedTuple):
    """Values that a key of a robot file takes.

    ``read(file, value, key, place)`` returns the value, or raises `Unusable` as for one that is not `usable`. Units are
    SI, for a joint that turns and one that slides; a size is that of a list, 0 for any; `inside` names the table that
    is expected.
    """

    read: Callable[..., Any] = _plain
    units: tuple[str, ...] = ()
    size: int = 0
    inside: str = ""
    required: bool = False
    default: Any = None
    usable: Callable[[Any], bool] = lambda value: True
    expected: str = ""


class RobotFile:
    """The tables of one file: `root` has the keys of `TABLES` that are stated or have a default.

    The first mistake is raised, with the number of the others.
    """

    def __init__(self, data: dict[str, Any], name: str) -> None:
        self.data, self.name = data, name
        self.stated: list[tuple[tuple[Any, ...], tuple[str, ...], Stated]] = []
        self._mistakes: list[tuple[str, str, str]] = []
        self.root = self.table(data, TABLES[""], ())
        if self._mistakes:
            what, found, advice = self._mistakes[0]
            others = f" (and {len(self._mistakes) - 1} more)" if len(self._mistakes) > 1 else ""
            raise InvalidInput(f"{name}: {what}{others}.", found, advice)

    def table(self, data: Any, keys: Mapping[str, Key], place: tuple[Any, ...]) -> dict[str, Any]:
        """The keys of a table that are stated or have a default."""
        if not isinstance(data, dict):
            raise Unusable("a table", "")
        where, values = place_text(place, self.data), {}
        unknown = [name for name in data if name not in keys]
        for name in unknown:
            found = f"expected keys out of {list(keys)}, got {name!r}"
            advice = nearest(name, keys, NESTING if _is_table(data[name]) else "one of these keys")
            self._mistakes.append((f"{where} has an unknown key {name!r}", found, advice))
        for name, key in keys.items():
            if name in data:
                values[name] = self._value(data[name], key, (*place, name))
            elif key.required and not unknown:
                unit = f" ({key.units[0]})" if key.units else ""
                found = f"expected {name!r}{unit}, got only {list(data)}"
                self._mistakes.append(
                    (f"{where} has no {name!r}", found, MISSING.get(name, f"{name} = …{unit}"))
                )
            elif key.default is not None:
                values[name] = key.default
        return values

    def _value(self, value: Any, key: Key, place: tuple[Any, ...]) -> Any:
        try:
            parsed = key.read(self, value, key, place)
            if not key.usable(parsed):
                raise Unusable(key.expected, "")
            return parsed
        except Unusable as wrong:
            *before, name = place if place[-1] != "value" else place[:-1]
            expected, advice = wrong.args
            self._mistakes.append((
                f"{place_text(tuple(before), self.data)} has a value of {name!r} that cannot be used",
                f"expected {expected}, got {value_text(value, 60)}",
                f"{name} = {advice}" if advice else NESTING if _is_table(value) else "correct the value",
            ))  # fmt: skip
            return None

    def check_units(self, robot: Any) -> Any:
        """Return the robot; refuse units of a joint that turns where it slides, and of another drive."""
        slides = dict(zip(robot.joint_names, robot.links.slides))
        for place, units, number in self.stated:
            kinds = set(slides.values()) if place[0] == "home" else set()
            if place[0] == "joint" and len(place) > 2:
                name = self.data["joint"][place[1]].get("name")
                kinds = {slides[name]} if name in slides else set()
            choices = UNITS[DRIVES[robot.drive]] if "effort_limit" in place else units
            fitting = sorted({choices[kind if len(choices) > 1 else 0] for kind in kinds})
            if fitting and number.si not in fitting:
                *before, key = (part for part in place if part not in ("value", "range"))
                value = number.number + " " + number.unit
                expected, advice = number_in(value, fitting)
                raise InvalidInput(
                    f"{self.name}: {place_text(tuple(before), self.data)} has a value of {key!r} in another unit.",
                    f"expected {expected}, got {value_text(value, 60)}",
                    f"{key} = {advice}",
                )
        return robot


def _is_table(value: Any) -> bool:
    return isinstance(value, dict) or (
        isinstance(value, list) and any(isinstance(row, dict) for row in value)
    )


# Values -------------------------------------------------------------------------------------------
def number_in(value: Any, units: Any) -> tuple[str, str]:
    """Texts for an error: what is expected of a number with one of these units, and an example of it."""
    if not units:
        return "a valid number", ""
    meant = [repr(text) for text in respelled(value, *units)] if isinstance(value, str) else []
    plain = " or ".join(unit.replace("1", "no unit") for unit in units)
    return (
        f"a valid number in {plain}, or text of a number with such a unit",
        f"{' or '.join(meant)}, in the letters of the SI"
        if meant
        else "0.8"
        if units[0] == "1"
        else repr("5 " + units[0]),
    )


def _number(file: RobotFile, value: Any, key: Key, place: tuple[Any, ...]) -> float:
    if isinstance(value, str) and key.units:
        try:
            number = measured(value, *key.units)
        except ValueError:
            raise Unusable(*number_in(value, key.units)) from None
        file.stated.append((place, key.units, number))
        return float(number)
    number = real_number(value) if type(value) in (int, float) else math.nan
    if not math.isfinite(number):
        raise Unusable(*number_in(value, key.units))
    return number


def _percent(file: RobotFile, value: Any, key: Key, place: tuple[Any, ...]) -> float:
    if isinstance(value, str) and value.rstrip().endswith("%"):
        value = 100.0 * _number(file, value, key._replace(units=("1",)), place)
    number = _number(file, value, key, place)
    if 0.0 < number < SMALLEST_TOLERANCE:
        ask(
            f"{file.name}: the tolerance of {place_text(place, file.data)} is {number:g} per cent.",
            f"expected per cent, got {number:g}, which looks like a fraction",
            f"tolerance = {100.0 * number:g} for ±{100.0 * number:g} %",
        )
    return number


def _list(file: RobotFile, value: Any, key: Key, place: tuple[Any, ...]) -> list[float]:
    if not isinstance(value, list) or (key.size and len(value) != key.size):
        expected = f"a list of {key.size} numbers" if key.size else "a list of one number for each joint"
        text = json.dumps(value[:60], ensure_ascii=False) if isinstance(value, str) else ""
        raise Unusable(expected, f"[{', '.join([text] * (key.size or 1))}]" if text else "")
    return [_number(file, entry, key, place) for entry in value]


def _quantity(file: RobotFile, value: Any, key: Key, place: tuple[Any, ...]) -> dict[str, Any]:
    """``4.0`` or ``{value = 4.0, tolerance = 12, source = "data sheet"}``; a vector is ``[x, y, z]`` or the like.

    A range is stated instead of a tolerance where the interval is not symmetric: ``{value = 0.0, range = [0.0, 3.0]}``.
    """
    entry = Key(_list if key.size else _number, key.units, key.size, required=True)
    if not isinstance(value, dict):
        return {"value": entry.read(file, value, key, place), "source": "assumption"}
    ends = {} if key.size else {"range": Key(_list, key.units, 2)}
    return file.table(value, {"value": entry, **TOLERANCE, **ends}, place)


def _numbers(file: RobotFile, value: Any, key: Key, place: tuple[Any, ...]) -> float | list[float]:
    return (_list if isinstance(value, list) else _number)(file, value, key, place)


def _named(file: RobotFile, value: Any, key: Key, place: tuple[Any, ...]) -> dict[str, Any]:
    """Numbers, or lists of them, by names that a file chooses."""
    if not isinstance(value, dict):
        raise Unusable("numbers by name", "")
    return {name: _numbers(file, entry, key, (*place, name)) for name, entry in value.items()}


def _table(file: RobotFile, value: Any, key: Key, place: tuple[Any, ...]) -> dict[str, Any]:
    return file.table(value, TABLES[key.inside], place)


def _rows(file: RobotFile, value: Any, key: Key, place: tuple[Any, ...]) -> list[dict[str, Any]]:
    if not isinstance(value, list) or (key.required and not value):
        raise Unusable(f"[[{key.inside}]] tables, one at least", "")
    return [_table(file, row, key, (*place, i)) for i, row in enumerate(value)]


# Keys ---------------------------------------------------------------------------------------------
_POSITION, _METRES = UNITS["link_position"], ("m",)
_EFFORT = tuple(dict.fromkeys(unit for drive in DRIVES.values() for unit in UNITS[drive]))
_POSITIVE = Key(_number, usable=lambda value: value > 0.0, expected="a number greater than 0")
_FLAG = Key(usable=lambda value: isinstance(value, bool), expected="true or false", default=False)
_KIND = Key(usable=lambda value: value in KINDS, expected="'revolute', 'continuous' or 'prismatic'")
_TEXT = Key(usable=lambda value: isinstance(value, str), expected="a text")
_TEXTS = Key(
    usable=lambda value: isinstance(value, list) and all(isinstance(entry, str) for entry in value),
    expected="a list of names",
)
_PERCENT = Key(
    _percent, ("%",),
    usable=lambda value: 0.0 <= value < 100.0, expected="a number of at least 0 and less than 100 per cent",
)  # fmt: skip
TOLERANCE = {"tolerance": _PERCENT, "source": _TEXT._replace(default="assumption")}
_MASS, _CENTRE, _THREE = Key(_quantity, ("kg",)), Key(_quantity, _METRES, 3), Key(_list, _METRES, 3)
_INERTIA_TABLE = Key(_table, inside="inertia")
_TOLERANCES = Key(_table, inside="tolerances", default={})

#: Numbers of a motor, its gear and its friction; its constants say what its input is.
MOTOR = tuple(joint_field.name for joint_field in fields(ElasticJoint) if joint_field.name not in SPRING)

_OF_JOINT = {
    name: Key(_quantity, tuple(dict.fromkeys(QUANTITIES[name][:2])), required=name == "stiffness")
    for name in (*SPRING, *MOTOR)
}
_EXACT = ("rotor_inertia", "hub_inertia", "gear_ratio", "friction_smoothing")

#: What may stand in each table. The tolerances, in per cent, are those of numbers that state none themselves: of one
#: joint and its link, or of all. That of the inertia is one number for all moments of a link, so that what is drawn is
#: the inertia of a body; that of the motor inertia holds for a rotor inertia too.
TABLES: dict[str, dict[str, Key]] = {
    "": {
        "name": _TEXT._replace(default=""), "description": _TEXT._replace(default=""),
        "gravity": Key(_quantity, ("m/s²",)), "down": Key(_list, size=3), "home": Key(_list, _POSITION),
        "urdf": _TEXT, "mjcf": _TEXT, "joints": _TEXTS,
        "locked": Key(_named, _POSITION, default={}), "penalty": Key(_table, inside="penalty"),
        "tolerances": _TOLERANCES, "payload": Key(_rows, inside="payload", default=[]),
        "joint": Key(_rows, inside="joint", required=True),
    },
    "joint": {
        "name": _TEXT._replace(required=True), "kind": _KIND, "axis": Key(_list, size=3), "xyz": _THREE,
        "rpy": Key(_list, ("rad",), 3), "limits": Key(_list, _POSITION, 2), "parent": _TEXT,
        "speed_limit": _POSITIVE._replace(units=UNITS["link_velocity"]),
        "effort_limit": _POSITIVE._replace(units=_EFFORT), "link": Key(_table, inside="link"), "rigid": _FLAG,
        "spring": Key(_table, inside="spring"), "motor": Key(_table, inside="motor", default={}),
        "tolerances": _TOLERANCES,
    },
    "link": {
        "mass": _MASS, "centre_of_mass": _CENTRE, "inertia": _INERTIA_TABLE,
        "axis_inertia": Key(_quantity, ("kg·m²",)), "length": Key(_quantity, _METRES),
    },
    "inertia": {
        axes: Key(_number, ("kg·m²",), required=axes[0] == axes[1], default=0.0)
        for axes in sorted(INERTIA, key=lambda axes: axes[0] != axes[1])
    } | TOLERANCE,
    "spring": {name: _OF_JOINT[name] for name in SPRING}, "motor": {name: _OF_JOINT[name] for name in MOTOR},
    "tolerances": {
        name: _PERCENT for name in ("mass", "centre_of_mass", "inertia", *_OF_JOINT) if name not in _EXACT
    },
    "payload": {
        "at": _TEXT, "mass": _MASS._replace(required=True), "centre_of_mass": _CENTRE, "inertia": _INERTIA_TABLE,
        "sphere": Key(_number, _METRES), "box": _THREE, "cylinder": Key(_list, _METRES, 2),
    },
    "penalty": {"weights": Key(_named, required=True), "effort": Key(_numbers, default=1.0)},
}  # fmt: skip


def place_text(location: tuple[Any, ...], data: dict[str, Any]) -> str:
    """A place in the file as text: joint 2 ('elbow'), spring."""
    parts, value = [], data
    for part in location:
        try:
            value = value[part]  # type: ignore[assignment]
        except (KeyError, IndexError, TypeError):
            value = {}
        if isinstance(part, int):
            name = value.get("name") if isinstance(value, dict) else None
            parts[-1] += f" {part + 1}" + (f" ({name!r})" if name else "")
        else:
            parts.append(str(part))
    return ", ".join(parts) if parts else "the file"
