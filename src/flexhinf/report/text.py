"""Text for a page: everything is escaped here, numbers are written for reading."""

from __future__ import annotations

import html
import math
import re
from numbers import Integral, Real

__all__ = ["escape", "number", "prose", "scalar"]

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
