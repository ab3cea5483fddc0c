"""What is wrong with a robot file, in three parts: key, value, what is allowed."""

from __future__ import annotations

import difflib
import warnings
from typing import TYPE_CHECKING, Any

from flexhinf.errors import InvalidInput
from flexhinf.robot.quantities import QUANTITIES
from flexhinf.robot.schema import TABLES, NumberTable

if TYPE_CHECKING:
    from pydantic import ValidationError

__all__ = ["RobotFileWarning", "check_tolerance", "file_error"]

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


def file_error(error: ValidationError, file: str, data: dict[str, Any]) -> InvalidInput:
    """The first mistake of a file as an error of ours, with the number of the others."""
    mistakes = error.errors(include_url=False)
    first = mistakes[0]
    location = tuple(part for part in first["loc"] if part != "value" or first["type"] == "extra_forbidden")
    *before, key = location
    where, table = _where(tuple(before), data), _table(tuple(before))
    others = f" (and {len(mistakes) - 1} more)" if len(mistakes) > 1 else ""
    if first["type"] == "extra_forbidden":
        allowed = list(table.model_fields)
        close = difflib.get_close_matches(str(key), allowed, n=1)
        return InvalidInput(
            f"{file}: {where} has an unknown key {key!r}{others}.",
            f"expected keys out of {allowed}, got {key!r}",
            f"{close[0]!r}" if close else "one of these keys",
        )
    unit = f" ({QUANTITIES[str(key)].unit})" if str(key) in QUANTITIES else ""
    if first["type"] == "missing":
        present = list(first["input"]) if isinstance(first["input"], dict) else []
        unknown = [name for name in present if name not in table.model_fields]
        meant = difflib.get_close_matches(str(key), unknown, n=1)
        if meant:
            return InvalidInput(
                f"{file}: {where} has an unknown key {meant[0]!r}{others}.",
                f"expected {key!r}{unit}, got {meant[0]!r}",
                f"{key!r}",
            )
        return InvalidInput(
            f"{file}: {where} has no {key!r}{others}.",
            f"expected {key!r}{unit}, got only {_keys(first['input'])}",
            MISSING.get(str(key), f"{key} = …{unit}"),
        )
    return InvalidInput(
        f"{file}: {where} has a value of {key!r} that cannot be used{others}.",
        f"expected {_lower(first['msg'])}{unit}, got {first['input']!r}",
        "4.0, or {value = 4.0, tolerance = 12, source = '…'} (tolerance in per cent)"
        if unit
        else "correct the value",
    )


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


def _where(location: tuple[Any, ...], data: dict[str, Any]) -> str:
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


def _table(location: tuple[Any, ...]) -> type[Any]:
    names = [part for part in location if isinstance(part, str)]
    return TABLES.get(names[-1] if names else "", NumberTable)


def _keys(table: Any) -> str:
    return str(list(table)) if isinstance(table, dict) else repr(table)


def _lower(message: str) -> str:
    message = message.removeprefix("Input should be ").removeprefix("Value error, ")
    return message[:1].lower() + message[1:]
