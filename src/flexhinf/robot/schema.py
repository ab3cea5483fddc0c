"""What a robot file may say, key by key.

What is wrong with a robot file, in three parts: key, value, what is allowed.
"""

from __future__ import annotations

import difflib
import warnings
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from flexhinf.errors import InvalidInput
from flexhinf.robot.parameters import QUANTITIES

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


Two = Annotated[list[float], Field(min_length=2, max_length=2)]
Three = Annotated[list[float], Field(min_length=3, max_length=3)]
Percent = Annotated[float, Field(ge=0.0, lt=100.0)]


class _Table(BaseModel):
    """A table whose unknown keys are mistakes, and whose numbers are numbers (not text)."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class NumberTable(_Table):
    """``4.0`` or ``{value = 4.0, tolerance = 12, source = "data sheet"}``; the tolerance is in per cent.

    A range is stated instead of a tolerance where the interval is not symmetric: ``{value = 0.0, range = [0.0, 3.0]}``.
    """

    value: float
    tolerance: Percent | None = None
    range: Two | None = None
    source: str = "assumption"


class VectorTable(_Table):
    """``[x, y, z]`` or ``{value = [x, y, z], tolerance = 3, source = "CAD"}``."""

    value: Three
    tolerance: Percent | None = None
    source: str = "assumption"


def _spelled_out(value: Any) -> Any:
    return value if isinstance(value, (dict, BaseModel)) else {"value": value}


Number = Annotated[NumberTable, BeforeValidator(_spelled_out)]
Vector = Annotated[VectorTable, BeforeValidator(_spelled_out)]


class InertiaTable(_Table):
    """Moments about the centre of mass, kg·m²: ``{xx = 1e-3, yy = 1e-3, zz = 5e-4}``; products are zero if left out."""

    xx: float
    yy: float
    zz: float
    xy: float = 0.0
    xz: float = 0.0
    yz: float = 0.0
    tolerance: Percent | None = None
    source: str = "assumption"


class LinkTable(_Table):
    """mass, centre_of_mass, inertia; or, for a single link, axis_inertia with mass and length."""

    mass: Number | None = None
    centre_of_mass: Vector | None = None
    inertia: InertiaTable | None = None
    axis_inertia: Number | None = None
    length: Number | None = None


class SpringTable(_Table):
    """The joint's elasticity, seen from the link."""

    stiffness: Number
    damping: Number | None = None
    spring_hardening: Number | None = None
    backlash: Number | None = None


class MotorTable(_Table):
    """The motor, its gear and its friction; its constants say what its input is."""

    motor_inertia: Number | None = None
    rotor_inertia: Number | None = None
    hub_inertia: Number | None = None
    gear_ratio: Number | None = None
    gear_efficiency: Number | None = None
    motor_efficiency: Number | None = None
    friction: Number | None = None
    coulomb_friction: Number | None = None
    static_friction: Number | None = None
    stribeck_velocity: Number | None = None
    friction_smoothing: Number | None = None
    resistance: Number | None = None
    inductance: Number | None = None
    torque_constant: Number | None = None
    back_emf_constant: Number | None = None


class TolerancesTable(_Table):
    """Tolerances in per cent of numbers that state none themselves: of one joint and its link, or of all.

    That of the inertia is one number for all moments of a link, so that what is drawn is the inertia of a body; that of
    the motor inertia holds for a rotor inertia too.
    """

    mass: Percent | None = None
    centre_of_mass: Percent | None = None
    inertia: Percent | None = None
    stiffness: Percent | None = None
    damping: Percent | None = None
    spring_hardening: Percent | None = None
    backlash: Percent | None = None
    motor_inertia: Percent | None = None
    gear_efficiency: Percent | None = None
    motor_efficiency: Percent | None = None
    friction: Percent | None = None
    coulomb_friction: Percent | None = None
    static_friction: Percent | None = None
    stribeck_velocity: Percent | None = None
    resistance: Percent | None = None
    inductance: Percent | None = None
    torque_constant: Percent | None = None
    back_emf_constant: Percent | None = None


class JointTable(_Table):
    """One joint with its link, spring, motor and limits. With a URDF only name, limits, spring, motor, tolerances."""

    name: str
    kind: Literal["revolute", "continuous", "prismatic"] | None = None
    axis: Three | None = None
    xyz: Three | None = None
    rpy: Three | None = None
    limits: Two | None = None
    speed_limit: Annotated[float, Field(gt=0.0)] | None = None
    effort_limit: Annotated[float, Field(gt=0.0)] | None = None
    parent: str | None = None
    link: LinkTable | None = None
    rigid: bool = False
    spring: SpringTable | None = None
    motor: MotorTable
    tolerances: TolerancesTable = Field(default_factory=TolerancesTable)


class PayloadTable(_Table):
    """What a link carries: mass, where, and its inertia (of its largest mass) or a shape; a point without both."""

    at: str | None = None
    mass: Number
    centre_of_mass: Vector | None = None
    inertia: InertiaTable | None = None
    sphere: float | None = None
    box: Three | None = None
    cylinder: Two | None = None


class PenaltyTable(_Table):
    """``weights = {link_position = 60, link_position_integral = 300}`` and ``effort = 10`` (R2)."""

    weights: dict[str, float | list[float]]
    effort: float | list[float] = 1.0


class RobotTable(_Table):
    """The whole file."""

    name: str = ""
    description: str = ""
    gravity: Number | None = None
    down: Three | None = None
    home: list[float] | None = None
    urdf: str | None = None
    mjcf: str | None = None
    joints: list[str] | None = None
    locked: dict[str, float] = Field(default_factory=dict)
    penalty: PenaltyTable | None = None
    tolerances: TolerancesTable = Field(default_factory=TolerancesTable)
    payload: list[PayloadTable] = Field(default_factory=list)
    joint: Annotated[list[JointTable], Field(min_length=1)]


#: The table behind each key, to name what is allowed there.
TABLES: dict[str, type[BaseModel]] = {
    "": RobotTable, "joint": JointTable, "link": LinkTable, "spring": SpringTable, "motor": MotorTable,
    "tolerances": TolerancesTable, "payload": PayloadTable, "inertia": InertiaTable, "penalty": PenaltyTable,
    "centre_of_mass": VectorTable,
}  # fmt: skip
