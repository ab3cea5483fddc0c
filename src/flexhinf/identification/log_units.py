"""Units in the names of a log's columns: how people spell them, where they stand, what is none.

A unit stands at the end of a name, ``time_msec``, ``motorPositionDeg``, ``voltage/mV``, in its front, ``deg_motor``, or
is the whole name, ``ms``. One table of spellings serves to read numbers and to advise a unit.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress

from flexhinf.robot.parameters import Stated, measured

#: SI units of what logs have, and other units that a message names beside them.
COMMON = {
    "s": "ms, us",
    "rad": "deg, mrad, rev",
    "m": "mm",
    "rad/s": "deg/s, rpm",
    "m/s": "mm/s",
    "V": "mV",
    "A": "mA",
    "N·m": "mNm",
    "N": "kN",
}

#: Words for units, in small letters: those that prefixes stand before, and those that stand alone.
_SPELLINGS = {
    "s": ("sec", "secs", "second", "seconds"),
    "rad": ("rads", "radian", "radians"),
    "deg": ("degs", "degree", "degrees"),
    "m": ("meter", "meters", "metre", "metres"),
    "V": ("volt", "volts"),
    "A": ("amp", "amps", "ampere", "amperes"),
    "N": ("newton", "newtons"),
    "N·m": ("newtonmeter", "newtonmeters", "newtonmetre", "newtonmetres"),
}
_PREFIXES = {
    "m": 1e-3,
    "milli": 1e-3,
    "u": 1e-6,
    "µ": 1e-6,
    "micro": 1e-6,
    "n": 1e-9,
    "nano": 1e-9,
    "kilo": 1e3,
}
_TURN = f"{2.0 * math.pi!r} rad"
_SPELLED = {
    **{
        prefix + word: f"{size!r} {unit}"
        for unit, names in _SPELLINGS.items()
        for word in names
        for prefix, size in {"": 1.0, **_PREFIXES}.items()
    },
    **{
        prefix + unit: f"{size!r} {unit}"
        for unit in ("rad", "deg")
        for prefix, size in _PREFIXES.items()
        if len(prefix) == 1
    },
    **{
        unit.lower(): f"1 {unit}"
        for unit in (
            "s",
            "ms",
            "us",
            "µs",
            "ns",
            "m",
            "mm",
            "V",
            "mV",
            "kV",
            "A",
            "mA",
            "N",
            "Nm",
            "mNm",
            "rpm",
            "deg",
            "rad",
        )
    },
    **dict.fromkeys(("millis", "milli"), "1 ms"),
    **dict.fromkeys(("micros", "micro"), "1 us"),
    **dict.fromkeys(("nanos", "nano"), "1 ns"),
    **dict.fromkeys(("min", "mins", "minute", "minutes"), "60 s"),
    **dict.fromkeys(("hr", "hrs", "hour", "hours"), "3600 s"),
    "um": "1e-6 m",
    "inch": "0.0254 m",
    **dict.fromkeys(("rev", "revs", "revolution", "revolutions", "turns"), _TURN),
    **dict.fromkeys(("gon", "gons"), f"{math.pi / 200.0!r} rad"),
}

#: Large letters that are mega as they stand, and milli as many mean them: no unit.
_MEGA = re.compile(r"M(?=[VAN])")
#: Where a word of a name may begin: behind a separator, at a capital after a small letter, at a sign for degrees.
_BEGIN = re.compile(r"(?<=[_\-/ .\[(])|(?<=[a-z0-9])(?=[A-Z])|(?=°)")
_SEPARATORS = re.compile(r"[_\-/ .\[\]()]+")
#: A number right before a unit: tenths of milliseconds are 0.1ms.
_COUNTED = re.compile(r"(\d+(?:\.\d+)?)([^\W\d]{2,})\Z")

#: Words for what signals measure: a column with another one is another signal.
_QUANTITIES = {
    "position",
    "velocity",
    "acceleration",
    "voltage",
    "current",
    "torque",
    "force",
    "temperature",
    "time",
}


def unit_size(text: str, si: Sequence[str]) -> Stated:
    """What a unit, as people spell it, is in the first of these SI units that measures the same; ValueError if none."""
    plain = text.strip().replace("_per_", "/").replace(" per ", "/")
    spellings = [f"1 {plain.replace('_', ' ')}", f"1 {plain.replace('_', '/')}"]
    if plain.casefold() in _SPELLED and not _MEGA.match(plain):
        spellings.append(_SPELLED[plain.casefold()])
    elif "/" in plain:
        above, below = plain.split("/", 1)
        if above.casefold() in _SPELLED:
            spellings.append(f"{_SPELLED[above.casefold()]}/{below}")
    for spelling in spellings:
        with suppress(ValueError):
            return measured(spelling, *si)
    raise ValueError(text)


def _tails(name: str) -> Iterator[tuple[str, bool]]:
    """Ends of a name, the longest first, and whether a letter may stand alone: behind a separator it may."""
    for begin in sorted({0, *(match.start() for match in _BEGIN.finditer(name))}):
        tail = name[begin:].strip("[]() ")
        separated = begin > 0 and name[begin - 1] in "_-/ .[("
        if tail:
            yield tail, separated or tail == "°"


def named_unit(name: str) -> tuple[str, str]:
    """The unit in a column's name, as it can be stated, and the SI unit of what it measures; empty where none is known.

    Examples
    --------
    >>> named_unit("time_msec"), named_unit("motorPositionDeg"), named_unit("time_0.1ms"), named_unit("speed_index")
    (('msec', 's'), ('Deg', 'rad'), ('0.0001', 's'), ('', ''))
    """
    tails = [(tail, alone) for tail, alone in _tails(name)]
    first = _SEPARATORS.split(name)[0]
    for text, alone in [*tails, (first, False)]:
        counted = _COUNTED.match(text)
        unit = counted[2] if counted else text
        if re.search(r"\d", unit) or not (alone or len(unit) > 1):
            continue
        if text == first != name and unit.casefold() in ("min", "rev", "turns", "milli", "micro", "nano"):
            continue  # what stands in front may be another word
        with suppress(ValueError):
            size = unit_size(unit, tuple(COMMON))
            return (f"{float(counted[1]) * size:.12g}" if counted else unit), size.si
    return "", ""


def unit_in(name: str, si: str) -> str:
    """The unit in a column's name if it measures what the SI unit does, else nothing."""
    unit, measures = named_unit(name)
    return unit if measures == si else ""


def without_unit(name: str, si: str) -> tuple[str, str]:
    """A column's name without the unit at its end, and that unit, if it measures what the SI unit does; else the name.

    A small letter alone is none: ``pos_m`` may be that of a motor.

    Examples
    --------
    >>> without_unit("motor_position_deg", "rad"), without_unit("time (ms)", "s"), without_unit("pos_m", "m")
    (('motor_position', 'deg'), ('time', 'ms'), ('pos_m', ''))
    """
    for begin in sorted({match.start() for match in _BEGIN.finditer(name)}):
        unit = name[begin:].strip("[]() ")
        size = unit_in(unit, si)
        if (
            begin
            and (size == unit or _COUNTED.match(unit))
            and (len(size) > 1 or unit.isupper() or unit == si == "s")
        ):
            return name[:begin].rstrip("_-/ .[("), size
    return name, ""


def is_other(name: str, stated: str, signal: str, si: str) -> bool:
    """Whether a column, with the unit that is stated behind it, plainly measures something else than a signal does.

    A small letter alone says nothing: ``pos_m`` may be that of a motor.
    """
    with suppress(ValueError):
        if si and stated:
            return unit_size(stated, tuple(COMMON)).si != si
    unit, measures = named_unit(name)
    clear = len(unit) > 1 or unit.isupper()
    parts, own = _parts(name), _parts(signal)
    said = (parts & _QUANTITIES) - own
    return bool((si and unit and clear and measures != si) or (said and not parts & own & _QUANTITIES))


def is_plain(name: str, known: Iterable[str]) -> bool:
    """Whether a name ends with a word of known names, as it stands or with a letter less or wrong, or with a number."""
    end = [word for word in _SEPARATORS.split(_BEGIN.sub(" ", name)) if word][-1:]
    parts = set[str]().union(*map(_parts, known))
    return (
        not end
        or end[0].isdigit()
        or any(
            end[0].casefold() == word
            or (
                len(end[0]) <= len(word)
                and difflib.SequenceMatcher(None, end[0].casefold(), word).ratio() > 0.75
            )
            for word in parts
        )
    )


def _parts(name: str) -> set[str]:
    """Words of a name in small letters."""
    return {word.casefold() for word in _SEPARATORS.split(_BEGIN.sub(" ", name)) if word}


def with_unit(name: str, si: str, known: Iterable[str]) -> tuple[str, str]:
    """A column's name as an advice states it, with its unit, or UNIT where its end may be one; and what UNIT is."""
    if unit := unit_in(name, si):
        return f"{name} [{unit}]", ""
    if not si or is_plain(name, known):
        return name, ""
    return f"{name} [UNIT]", f", where UNIT is {units_of(si)}"


def units_of(si: str) -> str:
    """Units of a quantity, for messages."""
    return (
        f"the unit of its numbers: {si}, {COMMON.get(si, '')}, or what one of them is in {si}, such as 0.0001"
    )
