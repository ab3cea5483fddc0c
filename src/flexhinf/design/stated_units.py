"""Whether the units of a specification are those of the joints: lengths where a joint slides, angles where it turns.

A specification is read before the robot, so its numbers remember their units (`flexhinf.design.units.Stated`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from flexhinf.design.specification import Specification, SpecificationError
from flexhinf.design.units import Stated
from flexhinf.robot import Robot
from flexhinf.robot.signals import SENSORS, expanded, signal_names, units_of
from flexhinf.untrusted import value_text

#: Fields with one number, or one per joint, and the signal that each is a value of.
SIGNALS = {
    "pose": "link_position",
    "start": "link_position",
    "tracking_error": "link_position",
    "integral_dead_zone": "link_position",
    "peak_speed": "link_velocity",
}

#: How people write numbers of an SI unit, for advice.
CUSTOMARY = {"rad": "deg", "m": "mm", "rad/s": "deg/s", "m/s": "mm/s", "N·m": "Nm", "N": "N"}


def check_stated_units(robot: Robot, s: Specification) -> None:
    """Refuse a length for a joint that turns, an angle for one that slides, and the same of speeds and sensors.

    A number without a unit fits every joint; so does a wrong count of numbers here, which is refused where it is used.

    Raises
    ------
    SpecificationError
        With the joint or the signal, its unit, and the same numbers in units that fit.
    """
    known = units_of(robot.joint_names, robot.links.slides)
    for field, values, signals in _stated(robot, s):
        parts, units = _parts(values), [known[name] for name in signals]
        each = parts * len(signals) if len(parts) == 1 else parts
        if len(each) != len(signals):
            continue
        for part, signal, unit in zip(each, signals, units):
            if isinstance(part, Stated) and part.si != unit:
                written = parts if len(set(units)) == 1 else each  # one for all joints, where one can be
                raise _refusal(field, part, signal, unit, ",".join(map(_fitted, written, units)))


def _stated(robot: Robot, s: Specification) -> Iterator[tuple[str, Any, Sequence[str]]]:
    """Fields with their values, and the signals that these are values of."""
    for field, signal in SIGNALS.items():
        yield field, getattr(s, field), signal_names(signal, robot.joint_names)
    for pose in s.via:
        yield "via", pose, signal_names("link_position", robot.joint_names)
    if any(isinstance(one, Stated) for one in _parts(s.quantisation)):
        yield "quantisation", *per_signal(robot, s.measured, s.quantisation)


def per_signal(robot: Robot, measured: Sequence[str], values: Any) -> tuple[tuple[Any, ...], tuple[str, ...]]:
    """Values of measured signals, and these signals: a value for each name counts for all that the name stands for.

    Another number of values is returned as it is.
    """
    signals = expanded(measured, SENSORS, robot.joint_names, robot.rigid)
    parts = _parts(values)
    if len(parts) != len(signals) and len(parts) == len(measured):
        groups = [expanded(name, SENSORS, robot.joint_names, robot.rigid) for name in measured]
        parts = tuple(part for group, part in zip(groups, parts) for _ in group)
    return parts, signals


def _parts(values: Any) -> tuple[Any, ...]:
    return values if isinstance(values, tuple) else (values,)


def _refusal(field: str, stated: Stated, signal: str, unit: str, example: str) -> SpecificationError:
    """One value whose unit is not that of its signal."""
    return SpecificationError(
        field,
        f"The {field.replace('_', ' ')} has a unit that {signal!r} does not have.",
        f"expected {unit} (or text with {CUSTOMARY[unit]}), got {value_text(stated.number + stated.unit, 60)}",
        example=example,
    )


def _fitted(value: float, unit: str) -> str:
    """A value as it was written, its unit exchanged for one of the same size that fits."""
    if not isinstance(value, Stated):
        return f"{value:g}"
    if value.si == unit:
        return value.number + value.unit
    plain = value.unit.lower() == value.si.lower()
    return value.number + (unit.replace("·", "") if plain else CUSTOMARY[unit])
