"""Numbers with units as text, ``"180deg"``, ``"10 kNm/rad"``: what a unit is in SI units, and what it measures.

A unit is a product of known ones with powers, over another such product: ``N·m·s/rad``, ``kg m^2``, ``g·cm²``,
``mNm/A``. Radians count: N·m is a torque, N·m/rad a stiffness. Large and small letters are those of the SI: MN are
meganewtons, mN millinewtons, and G is no gram. Only words that mean nothing else, as DEG, may be written in any.
"""

from __future__ import annotations

import math
import re
from functools import lru_cache

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
Dimension = tuple[int, ...]
_MASS, _LENGTH, _TIME, _ANGLE, _CURRENT = ((0,) * i + (1,) + (0,) * (4 - i) for i in range(5))
_FORCE, _TORQUE = (1, 1, -2, 0, 0), (1, 2, -2, 0, 0)
_VOLT, _OHM, _HENRY = (1, 2, -3, 0, -1), (1, 2, -3, 0, -2), (1, 2, -2, 0, -2)
_ALONE = (0, 0, 0, 0, 0)


#: Units that are not made of others: their names, what they measure, what one is in SI units, and prefixes.
_FAMILIES = (
    ("g", _MASS, 1e-3, "mk"),
    ("m", _LENGTH, 1.0, "cµu"),
    ("N", _FORCE, 1.0, "mkM"),
    ("Nm", _TORQUE, 1.0, "mkM"),
    ("V", _VOLT, 1.0, "mk"),
    ("A", _CURRENT, 1.0, "m"),
    *((name, _OHM, 1.0, "mk") for name in ("Ω", "Ω", "Ohm", "ohm")),
    ("H", _HENRY, 1.0, "mµμu"),
    ("rpm", (0, 0, -1, 1, 0), math.pi / 30.0, "k"),
)
_PREFIXES = {"": 1.0, "m": 1e-3, "k": 1e3, "M": 1e6, "c": 1e-2, "µ": 1e-6, "μ": 1e-6, "u": 1e-6}

_ATOMS: dict[str, tuple[float, Dimension]] = {
    name: (size, dimension)
    for table, dimension in ((SECONDS, _TIME), (TURNING, _ANGLE), (SLIDING, _LENGTH))
    for name, size in table.items()
}
for _name, _dimension, _size, _prefixes in _FAMILIES:
    _ATOMS |= {prefix + _name: (_PREFIXES[prefix] * _size, _dimension) for prefix in ("", *_prefixes)}
_ATOMS |= {"Ncm": (1e-2, _TORQUE), "Nmm": (1e-3, _TORQUE), "%": (1e-2, _ALONE), "1": (1.0, _ALONE)}
_FACTOR = re.compile(
    rf"({'|'.join(sorted(map(re.escape, _ATOMS), key=len, reverse=True))})(?:\^?(-?[1-4])|([²³]))?[·⋅*. ]?"
)
#: Words that are units in any letters, a prefix before them in its own.
_WORD = re.compile(r"(?<![^\W\d_])([mk]?)((?i:rad|deg|rpm|ohm|hz))(?![^\W\d_])")
_FOLDED = re.compile(_FACTOR.pattern.partition("(?:")[0], re.IGNORECASE)
_POWERS = {"": 1, "²": 2, "³": 3}


class Stated(float):
    """A number in SI units that was stated in a unit; everything computed with it is a plain float.

    `number` and `unit` are as they were written, "30" and "mm"; `si` is the SI unit that it has.
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
    """A finite number with a unit, in the first of these SI units that measures the same; ValueError for other text.

    Examples
    --------
    >>> measured("10 kNm/rad", "N·m/rad", "N/m")
    10000.0
    >>> measured("90deg", "rad") == math.pi / 2
    True
    """
    parts = split(text)
    known = _unit(parts[1]) if parts is not None and len(parts[1]) <= _LONGEST else None
    if parts is not None and known is not None:
        for unit in si:
            size, dimension = _unit(unit) or (1.0, ())
            value = float(parts[0]) * (known[0] / size)
            if dimension == known[1] and math.isfinite(value):
                return Stated(value, *parts, unit)
    raise ValueError(text)


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
    fitting = [unit[1] for one in si if (unit := _unit(one))]
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
    for part, sign in [(above.strip(), 1), *((one.strip(), -1) for one in below)]:
        factor, at = 1.0, 0
        while at < len(part):
            match = _FACTOR.match(part, at)
            if match is None:
                return None
            power = int(match[2]) if match[2] else _POWERS[match[3] or ""]
            one, dimension = _ATOMS[match[1]]
            factor *= one**power
            total = [a + sign * power * b for a, b in zip(total, dimension)]
            at = match.end()
        if not part:
            return None
        size *= factor**sign
    return size, tuple(total)
