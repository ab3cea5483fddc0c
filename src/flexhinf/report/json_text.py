"""JSON for metrics: a number that is not finite is refused with its place, never written."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from numbers import Integral, Real

from flexhinf.errors import InvalidInput, NumericalFailure

__all__ = ["to_json"]


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
