"""What a robot file may say, key by key: read, checked and put into SI units in one walk.

`TABLES` states each key once: what may stand there, its units, and whether it must. Which unit a spring has depends on
its joint, N·m/rad where it turns and N/m where it slides, and on what the motors are driven by; a file may say that
only by its URDF or at its end. So both units are read, and compared with the robot that comes of it (`check_units`).
"""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields
from types import SimpleNamespace
from typing import Any, NamedTuple

from flexhinf.errors import InvalidInput
from flexhinf.robot.dynamics import KINDS
from flexhinf.robot.elastic import DRIVES, SPRING
from flexhinf.robot.parameters import INERTIA, QUANTITIES
from flexhinf.robot.parts import ElasticJoint
from flexhinf.robot.signals import UNITS
from flexhinf.robot.units import Stated, measured, respelled
from flexhinf.validation import nearest, real_number, value_text

#: A tolerance below this many per cent was probably meant as a fraction.
SMALLEST_TOLERANCE = 0.5

#: What to write for a table that is missing.
MISSING = {
    "spring": "[joint.spring] with stiffness = … (N·m/rad; N/m for a prismatic joint)",
    "motor": "[joint.motor] with motor_inertia = … (kg·m², reflected to the link), or rotor_inertia and gear_ratio",
    "joint": "one [[joint]] table per joint, with name, link, spring and motor",
    "weights": "weights = {link_position = 60, link_position_integral = 300}",
    "name": "name = 'shoulder'",
}


class RobotFileWarning(UserWarning):
    """A robot file says something that is allowed and probably not meant."""


class Key(NamedTuple):
    """What may stand behind a key.

    ``read(file, value, key, place)`` returns what it is, or raises `Unusable`. Units are SI, for a joint that turns and
    one that slides; a size is that of a list, 0 for any; `inside` names the table that stands there.
    """

    read: Callable[..., Any]
    units: tuple[str, ...] = ()
    size: int = 0
    inside: str = ""
    required: bool = False
    default: Any = None


class Unusable(ValueError):
    """A value that cannot stand there; its text is what was expected."""


class RobotFile:
    """The tables of one file, as TOML has them: `root` has every key of `TABLES`.

    The first mistake is refused, with the number of the others.
    """

    def __init__(self, data: dict[str, Any], name: str) -> None:
        self.data, self.name = data, name
        self.stated: list[tuple[tuple[Any, ...], tuple[str, ...], Stated]] = []
        self._mistakes: list[tuple[str, str, str]] = []
        check_nesting(data, name)
        self.root = self.table(data, TABLES[""], ())
        if self._mistakes:
            what, found, advice = self._mistakes[0]
            others = f" (and {len(self._mistakes) - 1} more)" if len(self._mistakes) > 1 else ""
            raise InvalidInput(f"{name}: {what}{others}.", found, advice)

    def table(self, data: Any, keys: Mapping[str, Key], place: tuple[Any, ...]) -> SimpleNamespace:
        """The keys of a table, those that are left out with their defaults."""
        if not isinstance(data, dict):
            raise Unusable("a table")
        where, values = place_text(place, self.data), {}
        unknown = [name for name in data if name not in keys]
        self._mistakes += [
            (
                f"{where} has an unknown key {name!r}",
                f"expected keys out of {list(keys)}, got {name!r}",
                nearest(name, keys, "one of these keys"),
            )
            for name in unknown
        ]
        for name, key in keys.items():
            values[name] = key.default
            if name in data:
                values[name] = self._value(data[name], key, (*place, name))
            elif key.required and not unknown:
                unit = f" ({key.units[0]})" if key.units else ""
                found = f"expected {name!r}{unit}, got only {list(data)}"
                advice = MISSING.get(name, f"{name} = …{unit}")
                self._mistakes.append((f"{where} has no {name!r}", found, advice))
        return SimpleNamespace(**values)

    def _value(self, value: Any, key: Key, place: tuple[Any, ...]) -> Any:
        *before, name = place if place[-1] != "value" else place[:-1]
        try:
            return key.read(self, value, key, place)
        except Unusable as wrong:
            where = place_text(tuple(before), self.data)
            what, expected, advice = f"{where} has a value of {name!r} that cannot be used", str(wrong), ""
            if expected.startswith("a list of") and isinstance(value, str):
                what = f"{where} has a value of {name!r} that is no list"
                text = json.dumps(value[:60], ensure_ascii=False)
                advice = f"{name} = [{', '.join([text] * (key.size or 1))}]"
            elif expected.startswith("a valid number in"):
                what = f"{where} has a value of {name!r} that is no number, or in another unit"
                advice = unit_advice(str(name), value, key.units)
            self._mistakes.append(
                (what, f"expected {expected}, got {value_text(value, 60)}", advice or "correct the value")
            )
            return None

    def check_units(self, robot: Any) -> Any:
        """The robot; refuses units of a joint that turns where it slides, and of another drive."""
        slides = dict(zip(robot.joint_names, robot.links.slides))
        for place, units, number in self.stated:
            if place[0] != "home" and (len(place) < 3 or place[0] != "joint"):
                continue
            name = self.data["joint"][place[1]].get("name") if place[0] == "joint" else None
            kinds = {slides[name]} if name in slides else set(slides.values()) if name is None else set()
            if "effort_limit" in place:
                fitting = {UNITS[DRIVES[robot.drive]][kind] for kind in kinds}
            else:
                fitting = {units[kind if len(units) > 1 else 0] for kind in kinds}
            if fitting and number.si not in fitting:
                *before, key = (part for part in place if part not in ("value", "range"))
                value = number.number + " " + number.unit
                raise InvalidInput(
                    f"{self.name}: {place_text(tuple(before), self.data)} has a value of {key!r} in another unit.",
                    f"expected {number_in(sorted(fitting))}, got {value_text(value, 60)}",
                    unit_advice(str(key), value, tuple(sorted(fitting))),
                )
        return robot


# Values -------------------------------------------------------------------------------------------
def number_in(units: Any) -> str:
    """What is expected of a number with one of these units."""
    plain = " or ".join(unit.replace("1", "no unit") for unit in units)
    return f"a valid number in {plain}, or text of a number with such a unit"


def unit_advice(name: str, value: Any, units: tuple[str, ...]) -> str:
    """How a number of this key is written."""
    si = ["1" if unit == "%" else unit for unit in units]
    meant = [repr(text) for text in respelled(value, *si)] if isinstance(value, str) else []
    example = "0.8" if units[0] == "1" else repr("5 " + units[0])
    return f"{name} = {' or '.join(meant)}, in the letters of the SI" if meant else f"{name} = {example}"


def _number(file: RobotFile, value: Any, key: Key, place: tuple[Any, ...]) -> float:
    if isinstance(value, str) and key.units:
        try:
            number = measured(value, *key.units)
        except ValueError:
            raise Unusable(number_in(key.units)) from None
        file.stated.append((place, key.units, number))
        return float(number)
    number = real_number(value) if type(value) in (int, float) else math.nan
    if not math.isfinite(number):
        raise Unusable(number_in(key.units) if key.units else "a valid number")
    return number


def _positive(file: RobotFile, value: Any, key: Key, place: tuple[Any, ...]) -> float:
    number = _number(file, value, key, place)
    if not number > 0.0:
        raise Unusable("a number greater than 0")
    return number


def _checked(usable: Callable[[Any], bool], expected: str) -> Callable[..., Any]:
    """A reader of values that stand as they are."""

    def read(file: RobotFile, value: Any, key: Key, place: tuple[Any, ...]) -> Any:
        if not usable(value):
            raise Unusable(expected)
        return value

    return read


def _table(file: RobotFile, value: Any, key: Key, place: tuple[Any, ...]) -> SimpleNamespace:
    return file.table(value, TABLES[key.inside], place)


def _percent(file: RobotFile, value: Any, key: Key, place: tuple[Any, ...]) -> float:
    if isinstance(value, str):
        try:
            value = 100.0 * float(measured(value if value.rstrip().endswith("%") else "", "1"))
        except ValueError:
            raise Unusable(number_in(key.units)) from None
    number = _number(file, value, key, place)
    if not 0.0 <= number < 100.0:
        raise Unusable("a number of at least 0 and less than 100 per cent")
    return number


def _list(file: RobotFile, value: Any, key: Key, place: tuple[Any, ...]) -> list[float]:
    if not isinstance(value, list) or (key.size and len(value) != key.size):
        raise Unusable(f"a list of {key.size} numbers" if key.size else "a list of one number for each joint")
    return [_number(file, entry, key, place) for entry in value]


def _quantity(file: RobotFile, value: Any, key: Key, place: tuple[Any, ...]) -> SimpleNamespace:
    """``4.0`` or ``{value = 4.0, tolerance = 12, source = "data sheet"}``; a vector is ``[x, y, z]`` or the like.

    A range is stated instead of a tolerance where the interval is not symmetric: ``{value = 0.0, range = [0.0, 3.0]}``.
    """
    one = Key(_list if key.size else _number, key.units, key.size, required=True)
    if not isinstance(value, dict):
        return SimpleNamespace(
            value=one.read(file, value, key, place), tolerance=None, range=None, source="assumption"
        )
    ends = {} if key.size else {"range": Key(_list, key.units, 2)}
    return file.table(value, {"value": one, **TOLERANCE, **ends}, place)


def _numbers(file: RobotFile, value: Any, key: Key, place: tuple[Any, ...]) -> float | list[float]:
    one = _list if isinstance(value, list) else _number
    return one(file, value, key._replace(size=0), place)


def _named(file: RobotFile, value: Any, key: Key, place: tuple[Any, ...]) -> dict[str, Any]:
    """Numbers, or lists of them, by names that a file chooses."""
    if not isinstance(value, dict):
        raise Unusable("numbers by name")
    one = _number if key.units else _numbers
    return {name: one(file, entry, key, (*place, name)) for name, entry in value.items()}


def _stated_keys(file: RobotFile, value: Any, key: Key, place: tuple[Any, ...]) -> dict[str, Any]:
    """A table's keys that are stated, by name."""
    table = vars(_table(file, value, key, place))
    return {name: entry for name, entry in table.items() if entry is not None}


def _rows(file: RobotFile, value: Any, key: Key, place: tuple[Any, ...]) -> list[SimpleNamespace]:
    if not isinstance(value, list) or (key.required and not value):
        raise Unusable(f"[[{key.inside}]] tables, one at least")
    return [_table(file, row, key, (*place, i)) for i, row in enumerate(value)]


# Keys ---------------------------------------------------------------------------------------------
_POSITION, _METRES = UNITS["link_position"], ("m",)
_EFFORT = tuple(dict.fromkeys(unit for drive in DRIVES.values() for unit in UNITS[drive]))
_text = _checked(lambda value: isinstance(value, str), "a text")
_flag = _checked(lambda value: isinstance(value, bool), "true or false")
_kind = _checked(lambda value: value in KINDS, "'revolute', 'continuous' or 'prismatic'")
_texts = _checked(
    lambda value: isinstance(value, list) and all(isinstance(entry, str) for entry in value),
    "a list of names",
)
_TEXT, _PERCENT = Key(_text), Key(_percent, ("%",))
TOLERANCE = {"tolerance": _PERCENT, "source": Key(_text, default="assumption")}
_MASS, _CENTRE = Key(_quantity, ("kg",)), Key(_quantity, _METRES, 3)
_THREE = Key(_list, _METRES, 3)
_INERTIA_TABLE = Key(_table, inside="inertia")

#: Numbers of a motor, its gear and its friction; its constants say what its input is.
MOTOR = tuple(one.name for one in fields(ElasticJoint) if one.name not in SPRING)


def _quantities(names: tuple[str, ...], required: tuple[str, ...] = ()) -> dict[str, Key]:
    return {
        name: Key(_quantity, tuple(dict.fromkeys(QUANTITIES[name][:2])), required=name in required)
        for name in names
    }


_SHARED = ("mass", "centre_of_mass", "inertia", *SPRING, *MOTOR)
_EXACT = ("rotor_inertia", "hub_inertia", "gear_ratio", "friction_smoothing")

#: What may stand in each table. The tolerances, in per cent, are those of numbers that state none themselves: of one
#: joint and its link, or of all. That of the inertia is one number for all moments of a link, so that what is drawn is
#: the inertia of a body; that of the motor inertia holds for a rotor inertia too.
TABLES: dict[str, dict[str, Key]] = {
    "": {
        "name": Key(_text, default=""), "description": Key(_text, default=""), "gravity": Key(_quantity, ("m/s²",)),
        "down": Key(_list, size=3), "home": Key(_list, _POSITION), "urdf": _TEXT, "mjcf": _TEXT, "joints": Key(_texts),
        "locked": Key(_named, _POSITION, default={}), "penalty": Key(_table, inside="penalty"),
        "tolerances": Key(_stated_keys, inside="tolerances", default={}),
        "payload": Key(_rows, inside="payload", default=[]), "joint": Key(_rows, inside="joint", required=True),
    },
    "joint": {
        "name": Key(_text, required=True), "kind": Key(_kind), "axis": Key(_list, size=3), "xyz": _THREE,
        "rpy": Key(_list, ("rad",), 3), "limits": Key(_list, _POSITION, 2), "parent": _TEXT,
        "speed_limit": Key(_positive, UNITS["link_velocity"]), "effort_limit": Key(_positive, _EFFORT),
        "link": Key(_table, inside="link"), "rigid": Key(_flag, default=False),
        "spring": Key(_stated_keys, inside="spring"),
        "motor": Key(_stated_keys, inside="motor", required=True),
        "tolerances": Key(_stated_keys, inside="tolerances", default={}),
    },
    "link": {
        "mass": _MASS, "centre_of_mass": _CENTRE, "inertia": _INERTIA_TABLE,
        "axis_inertia": Key(_quantity, ("kg·m²",)), "length": Key(_quantity, _METRES),
    },
    "inertia": {
        axes: Key(_number, ("kg·m²",), required=axes[0] == axes[1], default=0.0)
        for axes in sorted(INERTIA, key=lambda axes: axes[0] != axes[1])
    } | TOLERANCE,
    "spring": _quantities(SPRING, required=("stiffness",)),
    "motor": _quantities(MOTOR),
    "tolerances": {name: _PERCENT for name in _SHARED if name not in _EXACT},
    "payload": {
        "at": _TEXT, "mass": _MASS._replace(required=True), "centre_of_mass": _CENTRE, "inertia": _INERTIA_TABLE,
        "sphere": Key(_number, _METRES), "box": _THREE, "cylinder": Key(_list, _METRES, 2),
    },
    "penalty": {"weights": Key(_named, required=True), "effort": Key(_numbers, default=1.0)},
}  # fmt: skip

#: Tables of one joint, which stand below its [[joint]].
OF_JOINT = ("link", "spring", "motor", "tolerances")


# Places -------------------------------------------------------------------------------------------
def nesting_advice(name: str = "") -> str:
    """How the tables of a joint are written."""
    stated = f" with name = {name!r}" if name else ""
    return f"[[joint]]{stated}, two brackets, and below it [joint.link], [joint.spring] and [joint.motor] of that joint"


def check_nesting(data: dict[str, Any], file: str) -> None:
    """Refuse tables that are not where a joint has them: [joint.yaw.spring], [yaw.spring], [[joint.spring]]."""
    for written, name in _misplaced(data):
        tables = ", ".join(f"[{word}]" for word in written[:3])
        raise InvalidInput(
            f"{file}: {tables} {'is no table' if len(written) == 1 else 'are no tables'} of a robot file.",
            f"expected [[joint]] for each joint and its tables below it, got {tables}",
            nesting_advice(name),
        )


def _misplaced(data: dict[str, Any]) -> Iterator[tuple[list[str], str]]:
    """Tables as written, and the joint that they seem to be of."""
    rows = data.get("joint")
    each = [row for row in rows if isinstance(row, dict)] if isinstance(rows, list) else []
    names = {str(row.get("name")) for row in each}
    for word in ("joint", "joints"):
        table = data.get(word)
        if isinstance(table, dict):
            named = [k for k, value in table.items() if k not in TABLES["joint"] and isinstance(value, dict)]
            written = [f"{word}.{key}" for key in named] or [word]
            yield written, named[0] if named else str(table.get("name", ""))
        if word == "joints" and isinstance(table, list) and any(isinstance(row, dict) for row in table):
            yield ["[joints]"], ""
    for row in each:
        for key, value in row.items():
            if key in OF_JOINT and isinstance(value, list):
                yield [f"[joint.{key}]"], str(row.get("name", ""))
            if key not in TABLES["joint"] and (parts := _parts_of_joint(key, value, names)):
                yield [f"joint.{part}" for part in parts], key
    for key, value in data.items():
        if key in ("link", "spring", "motor") and isinstance(value, (dict, list)):
            yield [key], ""
        if key not in TABLES[""] and (parts := _parts_of_joint(key, value, names)):
            yield parts, key


def _parts_of_joint(key: str, value: Any, names: set[str]) -> list[str]:
    """Tables as written, of one that is a joint's by its name or by what is in it; else none."""
    inside = value[0] if isinstance(value, list) and value else value
    if not isinstance(inside, dict):
        return []
    parts = [f"{key}.{part}" for part in OF_JOINT if part in inside]
    return parts or [key] * (key in names)


def check_tolerance(file: str, where: str, tolerance: float) -> None:
    """Warn of a tolerance that looks like a fraction."""
    if 0.0 < tolerance < SMALLEST_TOLERANCE:
        warnings.warn(
            f"{file}: the tolerance of {where} is {tolerance:g} per cent.\n"
            f"  found: expected per cent, got {tolerance:g}, which looks like a fraction\n"
            f"  try:   tolerance = {100.0 * tolerance:g} for ±{100.0 * tolerance:g} %",
            RobotFileWarning,
            stacklevel=2,
        )


def place_text(location: tuple[Any, ...], data: dict[str, Any]) -> str:
    """A place in the file as text: joint 2 ('elbow'), spring."""
    words, value = [], data
    for part in location:
        try:
            value = value[part]  # type: ignore[assignment]
        except (KeyError, IndexError, TypeError):
            value = {}
        if isinstance(part, int):
            name = value.get("name") if isinstance(value, dict) else None
            words[-1] += f" {part + 1}" + (f" ({name!r})" if name else "")
        else:
            words.append(str(part))
    return ", ".join(words) if words else "the file"
