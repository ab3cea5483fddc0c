"""The keys of robot files: what may stand in each table, its units, and whether it must.

`TABLES` states each key once. `RobotFile` reads, checks and converts a file to SI units in one walk. The unit of a
spring depends on its joint, N·m/rad where it turns, N/m where it slides, which a file may say only by its URDF: both
are read, and compared with the robot that comes of it.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields
from typing import Any, NamedTuple, Protocol, TypeAlias, TypeGuard, cast

from flexhinf.plant.instruments import SENSORS
from flexhinf.robot.actuators import (
    PublishedJoint,
    gear_advice,
    gear_name,
    published_gears,
    published_joints,
)
from flexhinf.robot.drive_limits import OF_COMMANDS, per_second
from flexhinf.robot.drives import DRIVES
from flexhinf.robot.dynamics import KINDS
from flexhinf.robot.elastic import SPRING
from flexhinf.robot.gears import CURVE
from flexhinf.robot.parameters import INERTIA, QUANTITIES, Stated, measured, respelled, split
from flexhinf.robot.parts import BESIDE, TIMES, ElasticJoint, ask
from flexhinf.robot.rigid_arm import NEAREST
from flexhinf.validation import nearest, real_number

#: Where a value stands: keys of tables, and numbers of rows.
Place: TypeAlias = tuple[str | int, ...]

#: Unit of a bandwidth, which may be stated in hertz.
BANDWIDTH = ("rad/s",)

#: A tolerance below this many per cent was probably meant as a fraction.
SMALLEST_TOLERANCE = 0.5

#: How the tables of a joint are written.
NESTING = (
    "[[joint]], two brackets, and below it [joint.link], [joint.spring] and [joint.motor] of that joint; each joint "
    "has its name in a line name = '…'"
)


def is_list(value: object) -> TypeGuard[list[object]]:
    """Whether a value of a TOML file is a list."""
    return isinstance(value, list)


def is_dict(value: object) -> TypeGuard[dict[str, object]]:
    """Whether a value of a TOML file is a table."""
    return isinstance(value, dict)


class Unusable(ValueError):
    """A value that its key does not take; its texts are what was expected, and what to write behind "="."""


class PartReader(Protocol):
    """A robot file while it is read, as far as the readers of its values use it."""

    file: str  # its name
    data: dict[str, Any]
    # Places, units and texts of numbers that state a unit.
    stated: list[tuple[Place, tuple[str, ...], Stated]]

    def table(self, data: object, keys: Mapping[str, Key], place: Place) -> dict[str, Any]:
        """The keys of a table that are stated or have a default."""
        ...


#: ``read(file, value, key, place)`` of a `Key`.
Reader: TypeAlias = "Callable[[PartReader, object, Key, Place], object]"


def _as_stated(file: PartReader, value: object, key: Key, place: Place) -> object:
    return value


class Key(NamedTuple):
    """Values that a key of a robot file takes.

    ``read(file, value, key, place)`` returns the value, or raises `Unusable` as for one that is not `usable`. Units are
    SI, for a joint that turns and one that slides; a size is that of a list, 0 for any; `inside` names the table that
    is expected, `field` what a `Robot` has of all joints, one value each.
    """

    read: Reader = _as_stated
    units: tuple[str, ...] = ()
    size: int = 0
    inside: str = ""
    required: bool = False
    default: Any = None
    usable: Callable[[object], bool] = lambda value: True
    expected: str = ""
    field: str = ""


#: What a stiffness in N/m means for a joint that turns.
BELT = (
    "{:g} r², N·m/rad, for a belt on a pulley of radius r, m: N/m is the stiffness of a belt or of a sliding joint "
    "(kind = 'prismatic')"
)


def number_in(value: Any, units: Any) -> tuple[str, str]:
    """Texts for an error: what is expected of a number with one of these units, and an example of it."""
    if not units:
        return "a valid number", ""
    meant = [repr(text) for text in respelled(value, *units)] if isinstance(value, str) else []
    if isinstance(value, str) and list(units) == ["N·m/rad"]:
        with suppress(ValueError):
            return f"a number in {units[0]}", BELT.format(measured(value, "N/m"))
    plain = " or ".join(unit.replace("1", "no unit") for unit in units)
    parts = split(value) if isinstance(value, str) else None
    example = (parts[0] if parts else "0.8") if units[0] == "1" else repr(_completed(value, units))
    return (
        f"a valid number in {plain}, or text of a number with such a unit",
        f"{' or '.join(meant)}, in the letters of the SI" if meant else example,
    )


def _completed(value: Any, units: Sequence[str]) -> str:
    """The same number with a divisor or a power that lacks, or with the first unit where it has none.

    A number keeps no unit that makes it another one.

    Examples
    --------
    >>> _completed("31 kNm", ["N·m/rad"]), _completed("31 s", ["kg·m²"]), _completed(None, ["kg·m²"])
    ('31 kNm/rad', '… kg·m²', '5 kg·m²')
    """
    parts = split(value) if isinstance(value, str) else None
    for lacking in ("/rad", "·s/rad", "·m²", "²", "/A", "/s") if parts and parts[1] else ():
        with suppress(ValueError):
            measured(f"{value}{lacking}", *units)
            return f"{value}{lacking}"
    return f"{('…' if parts[1] else parts[0]) if parts else 5} {units[0]}"


def _number(file: PartReader, value: object, key: Key, place: Place) -> float:
    parts = split(value) if key.units == BANDWIDTH and isinstance(value, str) else None
    if parts and parts[1].lower() == "hz":
        return 2.0 * math.pi * float(parts[0])
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


def _percent(file: PartReader, value: object, key: Key, place: Place) -> float:
    if isinstance(value, str) and value.rstrip().endswith("%"):
        value = 100.0 * _number(file, value, key._replace(units=("1",)), place)
    number = _number(file, value, key, place)
    ask(
        0.0 < number < SMALLEST_TOLERANCE,
        f"{file.file}: the tolerance of {place_text(place, file.data)} is {number:g} per cent.",
        f"expected per cent, got {number:g}, which looks like a fraction",
        f"tolerance = {100.0 * number:g} for ±{100.0 * number:g} %",
    )
    return number


def _list(file: PartReader, value: object, key: Key, place: Place) -> list[float]:
    if not is_list(value) or (key.size and len(value) != key.size):
        text = json.dumps(value[:60], ensure_ascii=False) if isinstance(value, str) else ""
        raise Unusable(
            f"a list of {key.size} numbers" if key.size else "a list of one number for each joint",
            f"[{', '.join([text] * (key.size or 1))}]" if text else "",
        )
    return [_number(file, entry, key, place) for entry in value]


def _quantity(file: PartReader, value: object, key: Key, place: Place) -> dict[str, Any]:
    """``4.0`` or ``{value = 4.0, tolerance = 12, source = "data sheet"}``; a vector is ``[x, y, z]`` or the like.

    A range is stated instead of a tolerance where the interval is not symmetric: ``{value = 0.0, range = [0.0, 3.0]}``.
    """
    entry = Key(_list if key.size else _number, key.units, key.size, required=True)
    if not is_dict(value):
        return {"value": entry.read(file, value, key, place), "source": "assumption"}
    ends = {} if key.size else {"range": Key(_list, key.units, 2)}
    return file.table(value, {"value": entry, **TOLERANCE, **ends}, place)


def _fall(file: PartReader, value: object, key: Key, place: Place) -> dict[str, Any]:
    if is_list(value):
        numbers = [real_number(entry) for entry in value]
        size = math.hypot(*numbers) if len(numbers) == 3 else math.nan
        advice = (
            f"{size:.6g} and down = {[float(f'{x / size:.6g}') for x in numbers]}"
            if 0.0 < size < math.inf
            else ""
        )
        raise Unusable("one number in m/s², its size; 'down' is its direction", advice)
    return _quantity(file, value, key, place)


def _numbers(file: PartReader, value: object, key: Key, place: Place) -> float | list[float]:
    return (_list if is_list(value) else _number)(file, value, key, place)


def _named(file: PartReader, value: object, key: Key, place: Place) -> dict[str, Any]:
    if not is_dict(value):
        raise Unusable("numbers by name", "")
    return {name: _numbers(file, entry, key, (*place, name)) for name, entry in value.items()}


def _shares(file: PartReader, value: object, key: Key, place: Place) -> dict[str, float]:
    if not is_dict(value) or not value:
        raise Unusable("what the motor turns by, by names of joints", "{ shoulder = 1.0, elbow = 1.0 }")
    return {name: _number(file, entry, key, (*place, name)) for name, entry in value.items()}


def _corrections(file: PartReader, value: object, key: Key, place: Place) -> dict[str, Any]:
    """``[links.NAME] inertia = "nearest"``, or its six components, by the names of links of a URDF or an MJCF file."""
    if not is_dict(value):
        raise Unusable("tables of links, by name", "")
    kind = Key(_correction, ("kg·m²",), required=True)
    return {name: file.table(row, {"inertia": kind}, (*place, name)) for name, row in value.items()}


def _correction(file: PartReader, value: object, key: Key, place: Place) -> str | tuple[float, ...]:
    if isinstance(value, str):
        if value.strip().lower() != NEAREST:
            raise Unusable(f"{NEAREST!r}, or a table with xx, yy, zz in kg·m²", repr(NEAREST))
        return NEAREST
    table = file.table(value, TABLES["inertia"], place)
    return tuple(table.get(axes) or 0.0 for axes in INERTIA)


def _table(file: PartReader, value: object, key: Key, place: Place) -> dict[str, Any]:
    return file.table(value, TABLES[key.inside], place)


def _spring(file: PartReader, value: object, key: Key, place: Place) -> dict[str, Any]:
    """A spring's table; the curve of a gear says its stiffness, and one whose name the joint states has a curve."""
    keys, row = TABLES["spring"], file.data["joint"][place[1]]
    if is_dict(value) and ({*value} & {*CURVE} or "gear" in row):
        keys = keys | {"stiffness": keys["stiffness"]._replace(required=False)}
    return file.table(value, keys, place)


def _rows(file: PartReader, value: object, key: Key, place: Place) -> list[dict[str, Any]]:
    if not is_list(value) or (key.required and not value):
        raise Unusable(f"[[{key.inside}]] tables, one at least", "")
    return [_table(file, row, key, (*place, i)) for i, row in enumerate(value)]


def _sensors(file: PartReader, value: object, key: Key, place: Place) -> list[dict[str, Any]]:
    """Rows of sensors, whose step and noise have the unit of what each measures."""
    if not is_list(value):
        raise Unusable("[[joint.sensor]] tables, each with its kind", "")
    rows = list[dict[str, Any]]()
    for i, row in enumerate(value):
        kind = row.get("kind") if is_dict(row) else None
        units = SENSORS[kind].units if isinstance(kind, str) and kind in SENSORS else ()
        own = {name: TABLES["sensor"][name]._replace(units=units) for name in ("step", "noise")}
        rows.append(file.table(row, TABLES["sensor"] | own, (*place, i)))
    return rows


def _actuator(file: PartReader, value: object, key: Key, place: Place) -> PublishedJoint:
    published = published_joints()
    if not isinstance(value, str) or value not in published:
        raise Unusable(f"one of {list(published)}, which `flexhinf robots` lists", nearest(value, published))
    return published[value]


def _gear(file: PartReader, value: object, key: Key, place: Place) -> PublishedJoint:
    known = published_gears()
    name = gear_name(value)
    if name not in known:
        raise Unusable(*gear_advice(name, "'CSG-25-100'"))
    return known[name]


def _kind_name(kinds: Collection[str]) -> Reader:
    """The reader of a kind's name, of those that are registered when it reads."""

    def read(file: PartReader, value: object, key: Key, place: Place) -> object:
        if not isinstance(value, str) or value not in kinds:
            raise Unusable(f"one of {', '.join(map(repr, kinds))}", "")
        return value

    return read


def _of_command(order: int) -> Reader:
    """The reader of a limit of a command, or of its derivative of an order, in the units of any drive's input."""

    def read(file: PartReader, value: object, key: Key, place: Place) -> object:
        units = dict.fromkeys(per_second(unit, order) for kind in DRIVES.values() for unit in kind.units)
        return _number(file, value, key._replace(units=tuple(units)), place)

    return read


def _is_positive(value: object) -> bool:
    return cast("float", value) > 0.0


def _is_percent(value: object) -> bool:
    return 0.0 <= cast("float", value) < 100.0


def _is_text(value: object) -> bool:
    return isinstance(value, str)


def _are_texts(value: object) -> bool:
    return is_list(value) and all(map(_is_text, value))


def _is_flag(value: object) -> bool:
    return isinstance(value, bool)


def _among(names: Collection[str]) -> Callable[[object], bool]:
    return lambda value: isinstance(value, str) and value in names


_POSITION, _SPEED, _METRES = ("rad", "m"), ("rad/s", "m/s"), ("m",)
_POSITIVE = Key(_number, usable=_is_positive, expected="a number greater than 0")
_TEXT = Key(usable=_is_text, expected="a text")
_PERCENT = Key(
    _percent,
    ("%",),
    usable=_is_percent,
    expected="a number of at least 0 and less than 100 per cent",
)
TOLERANCE = {"tolerance": _PERCENT, "source": _TEXT._replace(default="assumption")}
_MASS, _CENTRE, _THREE = Key(_quantity, ("kg",)), Key(_quantity, _METRES, 3), Key(_list, _METRES, 3)
_INERTIA_TABLE = Key(_table, inside="inertia")
_TOLERANCES = Key(_table, inside="tolerances", default={})

#: Numbers of a motor, its gear and its friction; its constants say what its input is.
MOTOR = tuple(each.name for each in fields(ElasticJoint) if each.name not in (*BESIDE, *SPRING))

#: What says how a motor is driven beside its constants, with times of its drive, and limits of its command.
_DRIVE = {
    "drive": Key(_kind_name(DRIVES)),
    **dict.fromkeys(TIMES, Key(_number, ("s",))),
    **{name: _POSITIVE._replace(read=_of_command(order)) for order, name in enumerate(OF_COMMANDS[1:], 1)},
}

_OF_JOINT = {
    name: Key(_quantity, tuple(dict.fromkeys(QUANTITIES[name][:2])), required=name == "stiffness")
    for name in (*SPRING, *MOTOR)
}

#: What may stand in each table. The tolerances, in per cent, are those of numbers that state none themselves: of one
#: joint and its link, or of all. That of the inertia is one number for all moments of a link, so that what is drawn is
#: the inertia of a body; that of the motor inertia holds for a rotor inertia too.
TABLES: dict[str, dict[str, Key]] = {
    "": {
        "name": _TEXT._replace(default=""),
        "description": _TEXT._replace(default=""),
        "gravity": Key(_fall, ("m/s²",)),
        "down": Key(_list, size=3),
        "home": Key(_list, _POSITION),
        "urdf": _TEXT,
        "mjcf": _TEXT,
        "joints": Key(
            usable=_are_texts,
            expected="a list of names",
        ),
        "locked": Key(_named, _POSITION, default={}),
        "links": Key(_corrections, default={}),
        "penalty": Key(_table, inside="penalty"),
        "tolerances": _TOLERANCES,
        "payload": Key(_rows, inside="payload", default=[]),
        "joint": Key(_rows, inside="joint", required=True),
    },
    "joint": {
        "name": _TEXT._replace(required=True),
        "actuator": Key(_actuator),
        "gear": Key(_gear),
        "kind": Key(usable=_among(KINDS), expected="'revolute', 'continuous' or 'prismatic'"),
        "axis": Key(_list, size=3),
        "xyz": _THREE,
        "rpy": Key(_list, ("rad",), 3),
        "limits": Key(_list, _POSITION, 2),
        "parent": _TEXT,
        "speed_limit": _POSITIVE._replace(units=_SPEED, field="speed_limits"),
        "effort_limit": _POSITIVE._replace(read=_of_command(0), field="effort_limits"),
        "link": Key(_table, inside="link"),
        "rigid": Key(usable=_is_flag, expected="true or false", default=False),
        "brakes": Key(usable=_is_flag, expected="true or false", default=False, field="brakes"),
        "coupling": Key(_shares),
        "spring": Key(_spring, inside="spring"),
        "motor": Key(_table, inside="motor", default={}),
        "sensor": Key(_sensors, inside="sensor", default=[]),
        "tolerances": _TOLERANCES,
    },
    "sensor": {
        "kind": Key(
            _kind_name(SENSORS),
            required=True,
        ),
        "counts": _POSITIVE,
        "step": _POSITIVE,
        "noise": _POSITIVE,
        "delay": _POSITIVE._replace(units=("s",)),
        "before_gear": Key(usable=_is_flag, expected="true or false"),
    },
    "link": {
        "mass": _MASS,
        "centre_of_mass": _CENTRE,
        "inertia": _INERTIA_TABLE,
        "axis_inertia": Key(_quantity, ("kg·m²",)),
        "length": Key(_quantity, _METRES),
    },
    "inertia": {
        axes: Key(_number, ("kg·m²",), required=axes[0] == axes[1], default=0.0)
        for axes in sorted(INERTIA, key=lambda axes: axes[0] != axes[1])
    }
    | TOLERANCE,
    "spring": {name: _OF_JOINT[name] for name in SPRING},
    "motor": {name: _OF_JOINT[name] for name in MOTOR} | _DRIVE,
    "tolerances": {
        name: _PERCENT
        for name in ("mass", "centre_of_mass", "inertia", *_OF_JOINT)
        if name not in QUANTITIES or QUANTITIES[name].shared
    },
    "payload": {
        "at": _TEXT,
        "mass": _MASS._replace(required=True),
        "centre_of_mass": _CENTRE,
        "inertia": _INERTIA_TABLE,
        "sphere": Key(_number, _METRES),
        "box": _THREE,
        "cylinder": Key(_list, _METRES, 2),
    },
    "penalty": {"weights": Key(_named, required=True), "effort": Key(_numbers, default=1.0)},
}


def is_table(value: object) -> bool:
    """Whether a value is a table or a list of tables."""
    return is_dict(value) or (is_list(value) and any(is_dict(x) for x in value))


#: What other programs and data sheets call our keys that are no numbers of `QUANTITIES`.
_CALLED = {
    "speed_limit": "velocity_limit max_velocity max_speed maximum_speed maximum_velocity velocity speed vel_limit",
    "effort_limit": "torque_limit max_torque maximum_torque peak_torque force_limit max_force max_effort effort "
    "torque voltage_limit max_voltage current_limit max_current",
    "limits": "limit range position_limits joint_limits angle_limits",
    "centre_of_mass": "center_of_mass com cog centre_of_gravity center_of_gravity",
    "xyz": "position pos origin translation",
    "rpy": "orientation rotation euler",
    "kind": "type joint_type",
    "down": "gravity_direction",
}

#: What other programs and data sheets call our keys.
SYNONYMS = {
    other: key
    for key, others in ({name: known.also for name, known in QUANTITIES.items()} | _CALLED).items()
    for other in others.split()
}


def key_advice(key: str, keys: Mapping[str, Key], table: bool) -> str:
    """What to write for an unknown key: one that is called so elsewhere, the table of a joint that has it, else the key
    that is most like it."""
    homes = {"joint": "[[joint]], below its name", **{x: f"[joint.{x}]" for x in ("link", "spring", "motor")}}
    plain = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", key[:200]).replace("-", "_").replace(" ", "_").lower()
    same = SYNONYMS.get(plain, plain)
    if same in keys and (not table or plain == same):
        return repr(same)
    for name in (plain, same) if not table else ():
        if found := [text for home, text in homes.items() if name in TABLES[home]]:
            return f"{name} in {' or '.join(found)}"
    return nearest(plain, keys, NESTING if table else "one of these keys")


def place_text(location: Place, data: object) -> str:
    """A place in the file as text: joint 2 ('elbow'), spring."""
    parts, value = list[str](), data
    for part in location:
        try:
            value = cast("Mapping[str | int, object]", value)[part]
        except (KeyError, IndexError, TypeError):
            value = None
        if isinstance(part, int):
            name = value.get("name") if is_dict(value) else None
            parts[-1] += f" {part + 1}" + (f" ({name!r})" if name else "")
        else:
            parts.append(part)
    return ", ".join(parts) or "the file"
