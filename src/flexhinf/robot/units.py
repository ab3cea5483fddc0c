"""Numbers with units as text in a robot file: read before anything else, checked once the robot is there.

Which unit a spring has depends on its joint: N·m/rad where it turns, N/m where it slides. A file may say that only by
its URDF, and what its motors are driven by only at the end; so both are read, and compared with the robot.

Numbers with units as text, ``"180deg"``, ``"10 kNm/rad"``: what a unit is in SI units, and what it measures.

A unit is a product of known ones with powers, over another such product: ``N·m·s/rad``, ``kg m^2``, ``g·cm²``,
``mNm/A``. Radians count: N·m is a torque, N·m/rad a stiffness. Large and small letters are those of the SI: MN are
meganewtons, mN millinewtons, and G is no gram. Only words that mean nothing else, as DEG, may be written in any.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from functools import lru_cache
from typing import Any, NamedTuple

from flexhinf.errors import InvalidInput
from flexhinf.robot.elastic import DRIVES
from flexhinf.robot.parameters import INERTIA, QUANTITIES
from flexhinf.robot.schema import place_text
from flexhinf.robot.signals import UNITS
from flexhinf.validation import value_text

#: Units of times, angles and lengths, and what one is in the SI unit that stands first.
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6}
TURNING = {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180.0, "°": math.pi / 180.0}
SLIDING = {"m": 1.0, "mm": 1e-3}

#: Nothing is looked at twice: a text of any length is read or refused at once.
_NUMBER = re.compile(r"\s*+([-+]?(?:\d++\.?\d*+|\.\d++)(?:[eE][-+]?\d++)?+|[-+]?inf|nan)\s*+")
#: Longest unit that is looked at.
_LONGEST = 40
#: Most spellings that are looked at where letters are others.
_MOST_SPELLED = 16

#: Powers of kg, m, s, rad and A.
Dimension = tuple[int, int, int, int, int]
_MASS, _LENGTH, _TIME, _ANGLE, _CURRENT = ((0,) * i + (1,) + (0,) * (4 - i) for i in range(5))
_FORCE, _TORQUE = (1, 1, -2, 0, 0), (1, 2, -2, 0, 0)
_VOLT, _OHM, _HENRY = (1, 2, -3, 0, -1), (1, 2, -3, 0, -2), (1, 2, -2, 0, -2)
_ALONE = (0, 0, 0, 0, 0)


def _atoms() -> Iterator[tuple[str, float, tuple[int, ...]]]:
    """Every unit that is not made of others: its name, what it is in SI units, and its dimension."""
    for table, dimension in ((SECONDS, _TIME), (TURNING, _ANGLE), (SLIDING, _LENGTH)):
        yield from ((name, size, dimension) for name, size in table.items())
    milli, kilo, mega = ("m", 1e-3), ("k", 1e3), ("M", 1e6)
    families = (
        (("g",), _MASS, 1e-3, (milli, kilo)),
        (("m",), _LENGTH, 1.0, (("c", 1e-2), ("µ", 1e-6), ("u", 1e-6))),
        (("N",), _FORCE, 1.0, (milli, kilo, mega)),
        (("Nm",), _TORQUE, 1.0, (milli, kilo, mega)),
        (("V",), _VOLT, 1.0, (milli, kilo)),
        (("A",), _CURRENT, 1.0, (milli,)),
        (("Ω", "Ω", "Ohm", "ohm"), _OHM, 1.0, (milli, kilo)),
        (("H",), _HENRY, 1.0, (milli, ("µ", 1e-6), ("μ", 1e-6), ("u", 1e-6))),
        (("rpm",), (0, 0, -1, 1, 0), math.pi / 30.0, (kilo,)),
    )
    for names, dimension, size, prefixes in families:
        for name in names:
            yield name, size, dimension
            yield from ((prefix + name, factor * size, dimension) for prefix, factor in prefixes)
    yield from (("Ncm", 1e-2, _TORQUE), ("Nmm", 1e-3, _TORQUE))
    yield from (("%", 1e-2, _ALONE), ("1", 1.0, _ALONE))


_ATOMS = {name: (size, dimension) for name, size, dimension in _atoms()}
_FACTOR = re.compile(
    rf"({'|'.join(sorted(map(re.escape, _ATOMS), key=len, reverse=True))})(?:\^?(-?[1-4])|([²³]))?[·⋅*. ]?"
)
#: Words that are units in any letters, a prefix before them in its own.
_WORD = re.compile(r"(?<![^\W\d_])([mk]?)((?i:rad|deg|rpm|ohm|hz))(?![^\W\d_])")
_FOLDED = re.compile(_FACTOR.pattern.partition("(?:")[0], re.IGNORECASE)
_POWERS = {"": 1, "²": 2, "³": 3}


class Stated(float):
    """A number in SI units that was stated in a unit; everything computed with it is a plain float.

    Attributes
    ----------
    number, unit : str
        As they were written: "30" and "mm".
    si : str
        The SI unit that it has: rad, m, rad/s, m/s, N·m, N or s.
    """

    number: str
    unit: str
    si: str

    def __new__(cls, value: float, number: str = "", unit: str = "", si: str = "") -> Stated:
        """The number, and how it was written."""
        found = super().__new__(cls, value)
        found.number, found.unit, found.si = number, unit, si
        return found


def split(text: str) -> tuple[str, str] | None:
    """Number and unit of a text, as they are written; None where it does not begin with a number."""
    match = _NUMBER.match(text)
    return None if match is None else (match[1], text[match.end() :].strip())


def measured(text: str, *si: str) -> Stated:
    """A finite number with a unit, in the first of these SI units that measures the same.

    Examples
    --------
    >>> measured("10 kNm/rad", "N·m/rad", "N/m")
    10000.0
    >>> measured("90deg", "rad") == math.pi / 2
    True

    Raises
    ------
    ValueError
        For text that is no number with a unit, and for a unit that measures something else.
    """
    parts = split(text)
    known = _unit(parts[1]) if parts is not None and len(parts[1]) <= _LONGEST else None
    fitting = [one for one in si if known is not None and _required(one)[1] == known[1]]
    if parts is None or known is None or not fitting:
        raise ValueError(text)
    value = float(parts[0]) * (known[0] / _required(fitting[0])[0])
    if not math.isfinite(value):
        raise ValueError(text)
    return Stated(value, *parts, fitting[0])


def _required(unit: str) -> tuple[float, Dimension]:
    known = _unit(unit)
    assert known is not None, unit
    return known


def lettered(unit: str) -> str:
    """A unit with its words, rad, deg, rpm, ohm and Hz, in the letters that they have; prefixes and symbols as written.

    Examples
    --------
    >>> lettered("N·m/RAD"), lettered("1/S"), lettered("MM")
    ('N·m/rad', '1/S', 'MM')
    """
    return _WORD.sub(lambda found: found[1] + found[2].lower().replace("hz", "Hz"), unit)


def respelled(text: str, *si: str) -> list[str]:
    """What a number with a unit in other letters may mean, in units that measure what one of `si` does.

    Examples
    --------
    >>> respelled("45 KNm/rad", "N·m/rad"), respelled("45 MNM", "N·m")
    (['45 kNm/rad'], ['45 mNm', '45 MNm'])
    """
    parts = split(text)
    if parts is None or len(parts[1]) > _LONGEST:
        return []
    found, at = [""], 0
    for match in _FOLDED.finditer(parts[1]):
        atoms = sorted((one for one in _ATOMS if one.lower() == match[1].lower()), reverse=True)
        between = parts[1][at : match.start()]
        found = [before + between + one for before in found for one in atoms][:_MOST_SPELLED]
        at = match.end()
    fitting = {_required(one)[1] for one in si}
    whole = [one + parts[1][at:] for one in found]
    known = [one for one in whole if one != parts[1] and (unit := _unit(one)) and unit[1] in fitting]
    return [f"{parts[0]} {one}" for one in known]


@lru_cache(256)
def _unit(text: str) -> tuple[float, Dimension] | None:
    """What a unit is in SI units, and its dimension."""
    above, *below = lettered(text).split("/")
    if not above:
        return None
    size, total = 1.0, [0] * 5
    for part, sign in [(above, 1), *((one, -1) for one in below)]:
        found = _product(part.strip())
        if found is None:
            return None
        size *= found[0] ** sign
        total = [a + sign * b for a, b in zip(total, found[1])]
    return size, (total[0], total[1], total[2], total[3], total[4])


def _product(text: str) -> tuple[float, list[int]] | None:
    size, total, at = 1.0, [0] * 5, 0
    while at < len(text):
        match = _FACTOR.match(text, at)
        if match is None:
            return None
        power = int(match[2]) if match[2] else _POWERS[match[3] or ""]
        one, dimension = _ATOMS[match[1]]
        size *= one**power
        total = [a + power * b for a, b in zip(total, dimension)]
        at = match.end()
    return (size, total) if text else None


Units = tuple[str, ...]

_METRES, _POSITION = ("m",), UNITS["link_position"]
_EFFORT = tuple(dict.fromkeys(unit for drive in DRIVES.values() for unit in UNITS[drive]))
_OF_JOINT = {name: tuple(dict.fromkeys(known[:2])) for name, known in QUANTITIES.items()}
_INERTIA: dict[str, Units] = dict.fromkeys(INERTIA, ("kg·m²",))

#: Units of the keys of each table; for a joint that turns and one that slides where there are two.
TABLES: dict[str, dict[str, Units]] = {
    "": {"gravity": ("m/s²",), "home": _POSITION},
    "joint": {
        "limits": _POSITION, "speed_limit": UNITS["link_velocity"], "effort_limit": _EFFORT, "xyz": _METRES,
        "rpy": ("rad",),
    },
    "payload": {
        "mass": ("kg",), "centre_of_mass": _METRES, "sphere": _METRES, "box": _METRES, "cylinder": _METRES,
    },
    "inertia": _INERTIA,
    "link": {
        "mass": ("kg",), "centre_of_mass": _METRES, "axis_inertia": ("kg·m²",), "length": _METRES,
    },
    "spring": _OF_JOINT, "motor": _OF_JOINT,
}  # fmt: skip


#: Keys whose numbers stand in a list, and how many; of home one for each joint.
LISTS = {"home": 0, "limits": 2, "xyz": 3, "rpy": 3, "centre_of_mass": 3, "box": 3, "cylinder": 2}


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
            elif key in LISTS and isinstance(text := _stated(table[key]), str):
                raise _no_list(text, LISTS[key], where, data, file)
            elif key in TABLES.get(kind, {}):
                table[key] = _read(table[key], TABLES[kind][key], where, data, file, found)
    return found


def _stated(value: Any) -> Any:
    return value.get("value") if isinstance(value, dict) else value


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
        if isinstance(ends := value.get("range"), str):
            raise _no_list(ends, 2, (*place, "range"), data, file)
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
    written = {"%": "1"}
    meant = [repr(one) for one in respelled(value, *(written.get(unit, unit) for unit in units))]
    example = "0.8" if units[0] == "1" else repr("5 " + units[0])
    return InvalidInput(
        f"{file}: {place_text(tuple(before), data)} has a value of {str(key)!r} that is no number, or in another unit.",
        f"expected a valid number in {plain}, or text of a number with such a unit, got {value_text(value, 60)}",
        f"{key} = {' or '.join(meant)}, in the letters of the SI" if meant else f"{key} = {example}",
    )


def _no_list(value: str, count: int, place: tuple[Any, ...], data: dict[str, Any], file: str) -> InvalidInput:
    *before, key = place
    shown = value_text(value, 60)
    return InvalidInput(
        f"{file}: {place_text(tuple(before), data)} has a value of {str(key)!r} that is no list.",
        f"expected a list of {count or 'one'} {'numbers' if count else 'number for each joint'}, got {shown}",
        f"{key} = [{', '.join([json.dumps(value[:60], ensure_ascii=False)] * (count or 1))}]",
    )


def check_units(found: list[Found], data: dict[str, Any], file: str, robot: Any) -> Any:
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
