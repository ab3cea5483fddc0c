"""Text for a page, escaped, with numbers written for reading; JSON, in which a number that is not finite is refused."""

from __future__ import annotations

import html
import json
import math
import re
from collections.abc import Mapping
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal
from numbers import Integral, Real

from flexhinf.errors import InvalidInput, NumericalFailure

_CODE = re.compile(r"`([^`]+)`")
_RAISED = re.compile(r"\bR(?:\^([vn])\b|([ᵛⁿ]))")
_LETTERS = {"ᵛ": "v", "ⁿ": "n"}
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def escape(text: object) -> str:
    """Text that is safe inside HTML elements and quoted attributes."""
    return html.escape(str(text), quote=True)


def prose(text: str) -> str:
    """Escaped text: words between backticks become a code element; Rᵛ and Rⁿ (or R^v, R^n) get a raised letter.

    Fonts draw the characters ᵛ and ⁿ in different sizes, or not at all; no other mark-up is known.

    Examples
    --------
    >>> prose("`--seed 3` changes Rᵛ")
    '<code>--seed 3</code> changes R<sup>v</sup>'
    """
    raised = _RAISED.sub(lambda found: f"R<sup>{found[1] or _LETTERS[found[2]]}</sup>", escape(text))
    return _CODE.sub(r"<code>\1</code>", raised)


def number(value: Real | float, digits: int = 4, decimals: int | None = None) -> str:
    """A number for reading: true minus sign, powers of ten instead of e-notation, ∞ for infinity.

    Parameters
    ----------
    value : real number
    digits : int
        Significant digits, where `decimals` is not given. Whole numbers keep all theirs.
    decimals : int, optional
        Fixed digits after the point, so that a column lines up.

    Examples
    --------
    >>> number(-0.123456), number(12), number(3.2e-7), number(float("inf")), number(2.0, decimals=2)
    ('−0.1235', '12', '3.2·10⁻⁷', '∞', '2.00')
    """
    if isinstance(value, Integral):
        return str(int(value)).replace("-", "−")
    x = float(value)
    if math.isnan(x):
        return "not a number"
    if math.isinf(x):
        return "∞" if x > 0 else "−∞"
    if decimals is not None:
        written = f"{x:.{decimals}f}"
        written = written.lstrip("-") if float(written) == 0.0 else written
    else:
        written = f"{x:.{digits}g}"
    if "e" in written:
        mantissa, _, power = written.partition("e")
        written = f"{mantissa}·10{str(int(power)).translate(_SUPERSCRIPT)}"
    return written.replace("-", "−")


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
    """The nearest number of so many digits on one side."""
    if not math.isfinite(value):
        return float(value)
    exact = Decimal(float(value))
    if decimals is not None:
        return float(exact.quantize(Decimal(1).scaleb(-decimals), rounding=rounding))
    return float(Context(prec=digits, rounding=rounding).create_decimal(exact))


def scalar(value: object, decimals: int | None = None) -> str:
    """One value of a table or a setting, as plain text (not yet escaped): yes, no, – for None, numbers, text.

    Lists and tuples are written with commas between their elements.
    """
    if value is None:
        return "–"
    if hasattr(value, "tolist"):  # NumPy scalars and arrays
        value = value.tolist()  # pyright: ignore[reportAttributeAccessIssue]
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, Real):
        return number(value, decimals=decimals)
    if isinstance(value, (list, tuple)):
        return ", ".join(scalar(element, decimals) for element in value)
    return str(value)


# JSON -------------------------------------------------------------------------------------------------
def to_json(value: object) -> str:
    """Text of a JSON document; lists of numbers stay on one line, the order of keys is kept.

    Parameters
    ----------
    value : object
        Mappings with text keys, lists, tuples, arrays, text, numbers (NumPy's too), True, False, None.

    Raises
    ------
    NumericalFailure
        A number is NaN or infinite; the message says which.
    InvalidInput
        A key is not text, or a value is of a kind that JSON does not have.

    Examples
    --------
    >>> print(to_json({"gamma": 2.5, "range": (1, 2.0, None)}), end="")
    {
      "gamma": 2.5,
      "range": [1, 2.0, null]
    }
    """
    return _written(value, (), 0) + "\n"


def _written(value: object, place: tuple[str, ...], depth: int) -> str:
    if hasattr(value, "tolist"):
        value = value.tolist()  # pyright: ignore[reportAttributeAccessIssue]
    if isinstance(value, Mapping):
        return _object(value, place, depth)
    if isinstance(value, (list, tuple)):
        return _list(value, place, depth)
    if value is None or isinstance(value, (str, bool)):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, Integral):
        return str(int(value))
    if isinstance(value, Real):
        if not math.isfinite(value):
            raise NumericalFailure(
                "A number of the report is not finite.",
                f"{_named(place)} = {float(value)}",
                "None, where there is no number to give (it is written as null)",
            )
        return repr(float(value))
    raise InvalidInput(
        "JSON has no such value.",
        f"expected text, a number, true, false, null, a list or a mapping; got {type(value).__name__} "
        f"at {_named(place)}",
        "a value of one of these kinds",
    )


def _object(value: Mapping[object, object], place: tuple[str, ...], depth: int) -> str:
    lines = []
    for key, element in value.items():
        if not isinstance(key, str):
            raise InvalidInput(
                "A key of a JSON object is text.", f"got {key!r} in {_named(place)}", f"the key {str(key)!r}"
            )
        written = _written(element, (*place, key), depth + 1)
        lines.append(f"{'  ' * (depth + 1)}{json.dumps(key, ensure_ascii=False)}: {written}")
    return "{\n" + ",\n".join(lines) + "\n" + "  " * depth + "}" if lines else "{}"


def _list(value: list[object] | tuple[object, ...], place: tuple[str, ...], depth: int) -> str:
    nested = any(
        isinstance(element, (Mapping, list, tuple)) or hasattr(element, "tolist") for element in value
    )
    written = [_written(element, (*place, str(index)), depth + 1) for index, element in enumerate(value)]
    if not nested or not written:
        return "[" + ", ".join(written) + "]"
    indent = "  " * (depth + 1)
    return "[\n" + ",\n".join(indent + element for element in written) + "\n" + "  " * depth + "]"


def _named(place: tuple[str, ...]) -> str:
    return ".".join(place) or "the document"
