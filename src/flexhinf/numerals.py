"""Numbers as people read them: so many digits, a true minus sign, powers of ten, and a unit.

Texts for people have their numbers from here; files that programs read, code and command lines have Python's.
"""

from __future__ import annotations

import math
import re
from decimal import ROUND_CEILING, ROUND_FLOOR, ROUND_HALF_EVEN, Context, Decimal
from numbers import Integral, Real

#: Digits of a number that a user stated: enough for every number that is written, too few for 0.1 + 0.2.
DIGITS = 10

#: Digits of a number within a text that was not written for reading.
SHORT = 6

#: Numbers below this one have no power of ten, however few digits they have.
WHOLE = 1e5

#: The space between a number and its unit, outside of backticks.
_UNITS = re.compile(r"`[^`]*`|(?<=\d) (?=%|(?:[mkµ]?(?:s|V|A|W|Hz|m|rad|N)|kg|N·m)(?![\w'’]))")

#: A value below this share of its limit is rounding noise, and is written as 0.
NOISE = 1e-9

#: A decimal number of Python, alone: no part of a name, a version or a digest.
_DECIMAL = re.compile(r"(?<![\w.])-?(?:\d+\.\d+(?:e[-+]?\d+)?|\d+e[-+]?\d+)(?![\w.]|\.\d)")


def number(value: Real | float, digits: int = 4, decimals: int | None = None) -> str:
    """A number for reading: true minus sign, powers of ten instead of e-notation, ∞ for infinity.

    `digits` are significant ones (whole numbers keep all theirs), `decimals` fixed ones, so that a column lines up.

    Examples
    --------
    >>> number(-0.123456), number(2271.3, 3), number(3.2e-7), number(float("inf")), number(2.0, decimals=2)
    ('−0.1235', '2270', '3.2·10⁻⁷', '∞', '2.00')
    """
    if isinstance(value, Integral):
        return str(int(value)).replace("-", "−")
    x = float(value)
    if not math.isfinite(x):
        return "not a number" if math.isnan(x) else "∞" if x > 0 else "−∞"
    written = f"{x:.{digits}g}" if decimals is None else f"{x:z.{decimals}f}"
    if decimals is None and abs(float(written)) < WHOLE:
        written = written if "e-" in written else f"{float(written):.15g}"
    if "e" in written:
        mantissa, _, power = written.partition("e")
        raised = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
        written = f"{mantissa}·10{str(int(power)).translate(raised)}"
    return written.replace("-", "−")


def count_text(count: int, noun: str) -> str:
    """A number with a noun, in the plural where it needs one."""
    return f"{count} {noun if count == 1 else f'{noun}s'}"


def worst_text(count: int, noun: str) -> str:
    """Of which of some motions or robots a number is the worst."""
    return f"the {noun}" if count == 1 else f"the worst of {count} {noun}s"


def at_most(value: float, digits: int = 4) -> str:
    """A proved bound from above: as `number`, rounded up, so that what is written holds too.

    Examples
    --------
    >>> at_most(366.8925), at_most(98.0), at_least(63.99942, decimals=1)
    ('366.9', '98', '63.9')
    """
    return number(_rounded(value, digits, ROUND_CEILING), digits)


def at_least(value: float, digits: int = 4, decimals: int | None = None) -> str:
    """A proved bound from below: as `number`, rounded down."""
    return number(_rounded(value, digits, ROUND_FLOOR, decimals), digits, decimals)


def _rounded(value: float, digits: int, rounding: str, decimals: int | None = None) -> float:
    """Round to so many digits in one direction; to the nearest such number if that is the value but for its last
    bits: 50 degrees in radians and back are 49.99999999999999, and are to be written as 50."""
    if not math.isfinite(value):
        return float(value)
    exact, room = Decimal(float(value)), Decimal(4 * math.ulp(value))  # what a change of unit may move
    near, bound = (
        Context(prec=digits, rounding=way).create_decimal(exact)
        if decimals is None
        else exact.quantize(Decimal(1).scaleb(-decimals), rounding=way)
        for way in (ROUND_HALF_EVEN, rounding)
    )
    return float(near if abs(near - exact) <= room else bound)


def unbroken(text: str) -> str:
    """A text with no-break spaces between numbers and their units, but within backticks: code is copied as it is.

    Examples
    --------
    >>> unbroken("at most 5 % after 3 s")
    'at most 5\\xa0% after 3\\xa0s'
    """
    return _UNITS.sub(lambda match: match[0] if match[0] != " " else "\N{NO-BREAK SPACE}", text)


def number_text(value: float, unit: str = "", digits: int = 4) -> str:
    """A number with its unit, degrees without a space.

    Examples
    --------
    >>> number_text(3.2e-7, "rad"), number_text(0.30000000000000004), number_text(30.0, "°")
    ('3.2·10⁻⁷ rad', '0.3', '30°')
    """
    return f"{number(value, digits)}{'' if unit == '°' else ' '}{unit}".rstrip()


def percent(share: float, digits: int = 3) -> str:
    """A share in per cent.

    Examples
    --------
    >>> percent(0.12345), percent(-0.5, 2)
    ('12.3 %', '−50 %')
    """
    return number_text(100.0 * share, "%", digits)


def power_of(unit: str, exponent: str) -> str:
    """A unit to a power; "" of none.

    Examples
    --------
    >>> power_of("V", "²"), power_of("N·m", "⁻²"), power_of("rad/s", "²")
    ('V²', '(N·m)⁻²', '(rad/s)²')
    """
    return unit and (f"({unit}){exponent}" if "·" in unit or "/" in unit else f"{unit}{exponent}")


def without_noise(value: float, limit: float) -> float:
    """A value beside its limit: 0 where it is no more than the rounding errors of what it was computed of.

    Examples
    --------
    >>> without_noise(2.08e-14, 5.0), without_noise(0.02, 5.0)
    (0.0, 0.02)
    """
    return 0.0 if abs(value) < NOISE * abs(limit) < math.inf else value


def ends_text(low: float, high: float, unit: str = "") -> str:
    """Both ends of an interval, with as many decimals as tell them apart by two digits.

    Examples
    --------
    >>> ends_text(99.99993, 100.00724), ends_text(0.5, 2.0, "s"), ends_text(92.701, 92.701)
    ('99.9999 to 100.0072', '0.5 to 2 s', '92.7')
    """
    decimals = _decimals(low, high)
    texts = [number(end, 3) if decimals is None else number(round(end, decimals), 15) for end in (low, high)]
    return f"{' to '.join(dict.fromkeys(texts))} {unit}".rstrip()


def estimate_text(value: float, low: float, high: float, unit: str = "") -> str:
    """A number that is known within an interval, with as many decimals as the interval's ends; five digits without one.

    Examples
    --------
    >>> estimate_text(100.00358, 99.99993, 100.00724, "N·m/rad"), estimate_text(0.1, -1.0, 5.0)
    ('100.0036 N·m/rad', '0.1')
    """
    decimals = _decimals(low, high)
    return number_text(value, unit, 5) if decimals is None else number_text(round(value, decimals), unit, 15)


def _decimals(low: float, high: float) -> int | None:
    """Decimals that tell the ends of an interval apart by two digits; None where it has no width or is wide."""
    width = high - low
    return 1 - math.floor(math.log10(width)) if 0.0 < width < max(abs(low), abs(high)) < math.inf else None


def short_numbers(text: str, digits: int = SHORT) -> str:
    """A text in which numbers with decimals have at most so many digits.

    Examples
    --------
    >>> short_numbers("uniform in [9.702, 9.898000000000001] m, 1e-8, version 0.2.0")
    'uniform in [9.702, 9.898] m, 1·10⁻⁸, version 0.2.0'
    """

    def written(match: re.Match[str]) -> str:
        return number(float(match[0]), digits)

    return _DECIMAL.sub(written, text)


def short_bounds(text: str, lower: str, upper: str) -> str:
    """As `short_numbers`; a number behind `lower` is rounded down, and one behind `upper` up.

    Examples
    --------
    >>> short_bounds("V <= 503.5524866 with gamma = 86.80727131", "V <= ", "gamma = ")
    'V <= 503.552 with gamma = 86.8073'
    """
    for sign, rounded in ((lower, at_least), (upper, at_most)):
        for digits in set(re.findall(rf"(?<={re.escape(sign)})\d[\d.]*\d", text)):
            text = text.replace(f"{sign}{digits}", f"{sign}{rounded(float(digits), SHORT)}")
    return short_numbers(text)


def stated_number(value: float) -> str:
    """A number as Python reads it, in `DIGITS` digits.

    Examples
    --------
    >>> stated_number(0.1 + 0.2), stated_number(1e-7)
    ('0.3', '1e-07')
    """
    return repr(float(f"{value:.{DIGITS}g}"))
