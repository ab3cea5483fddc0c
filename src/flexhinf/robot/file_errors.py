"""What is wrong with a robot file, in three parts: key, value, what is allowed."""

from __future__ import annotations

import difflib
import warnings
from typing import TYPE_CHECKING, Any

from flexhinf.errors import InvalidInput
from flexhinf.robot.quantities import QUANTITIES
from flexhinf.robot.schema import TABLES, JointTable, NumberTable, RobotTable

if TYPE_CHECKING:
    from pydantic import ValidationError

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
    where, table = place_text(tuple(before), data), _table(tuple(before))
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


#: Tables of one joint, which stand below its [[joint]].
OF_JOINT = ("link", "spring", "motor", "tolerances")


def nesting_advice(name: str = "") -> str:
    """How the tables of a joint are written."""
    stated = f" with name = {name!r}" if name else ""
    return f"[[joint]]{stated}, two brackets, and below it [joint.link], [joint.spring] and [joint.motor] of that joint"


def check_nesting(data: dict[str, Any], file: str) -> None:
    """Refuse tables that are not where a joint has them: [joint.yaw.spring], [yaw.spring], [spring], [[joint.spring]].

    Raises
    ------
    InvalidInput
        With the table as it is written, and how it is written for that joint.
    """
    rows = data.get("joint")
    each = [row for row in rows if isinstance(row, dict)] if isinstance(rows, list) else []
    names = {str(row.get("name")) for row in each}
    for word in ("joint", "joints"):
        table = data.get(word)
        if isinstance(table, dict):
            named = [
                key
                for key, value in table.items()
                if key not in JointTable.model_fields and isinstance(value, dict)
            ]
            written = [f"{word}.{key}" for key in named] or [word]
            raise _misplaced(file, written, named[0] if named else str(table.get("name", "")))
        if word == "joints" and isinstance(table, list) and any(isinstance(row, dict) for row in table):
            raise _misplaced(file, ["[joints]"], "")
    for row in each:
        for key, value in row.items():
            if key in OF_JOINT and isinstance(value, list):
                raise _misplaced(file, [f"[joint.{key}]"], str(row.get("name", "")))
            if _of_joint(key, value, names) and key not in JointTable.model_fields:
                raise _misplaced(file, _below(f"joint.{key}", value), key)
    for key, value in data.items():
        if key in RobotTable.model_fields:
            continue
        if key in ("link", "spring", "motor") and isinstance(value, (dict, list)):
            raise _misplaced(file, [key], "")
        if _of_joint(key, value, names):
            raise _misplaced(file, _below(key, value), key)


def _of_joint(key: str, value: Any, names: set[str]) -> bool:
    """Whether a table is that of a joint, by its name or by what is in it."""
    inside = value[0] if isinstance(value, list) and value else value
    return isinstance(inside, dict) and (key in names or any(part in OF_JOINT for part in inside))


def _below(word: str, value: Any) -> list[str]:
    inside = value[0] if isinstance(value, list) else value
    return [f"{word}.{part}" for part in OF_JOINT if part in inside] or [word]


def _misplaced(file: str, written: list[str], name: str) -> InvalidInput:
    tables = ", ".join(f"[{word}]" for word in written[:3])
    return InvalidInput(
        f"{file}: {tables} {'is no table' if len(written) == 1 else 'are no tables'} of a robot file.",
        f"expected [[joint]] for each joint and its tables below it, got {tables}",
        nesting_advice(name),
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


def _table(location: tuple[Any, ...]) -> type[Any]:
    names = [part for part in location if isinstance(part, str)]
    return TABLES.get(names[-1] if names else "", NumberTable)


def _keys(table: Any) -> str:
    return str(list(table)) if isinstance(table, dict) else repr(table)


def _lower(message: str) -> str:
    message = message.removeprefix("Input should be ").removeprefix("Value error, ")
    return message[:1].lower() + message[1:]
