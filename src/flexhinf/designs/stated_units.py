"""Whether the units that a specification states fit the joints of the robot, its sensors and its motors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

from flexhinf.designs.specification import Specification, SpecificationError
from flexhinf.options import Stated
from flexhinf.plant.instruments import SENSORS
from flexhinf.robot import Robot
from flexhinf.robot.signals import expanded, signal_names, units_of
from flexhinf.validation import value_text

#: Fields with one number, or one per joint, and the signal that each is a value of.
SIGNALS = {
    "pose": "link_position",
    "start": "link_position",
    "tracking_error": "link_position",
    "integral_dead_zone": "link_position",
    "peak_speed": "link_velocity",
    "remaining_error": "link_position",
    "path_distance": "link_position",
}
EFFORTS = ("saturation", "peak_effort")  # one number, or one per joint, of the motors' inputs
SMALL_UNITS = {"rad": "mrad", "m": "mm"}  # of `remaining_error` and `path_distance`

#: How people write numbers of an SI unit, for advice.
CUSTOMARY = {"rad": "deg", "m": "mm", "rad/s": "deg/s", "m/s": "mm/s", "N·m": "Nm", "N": "N"}


def check_stated_units(robot: Robot, s: Specification) -> None:
    """Refuse a length for a joint that turns and an angle for one that slides; likewise for speeds and sensors.

    A number without a unit fits every joint. A wrong count of numbers is refused where they are used.
    """
    joints = robot.joint_names
    known = units_of(joints, robot.links.slides)
    stated = [
        *((field, getattr(s, field), signal_names(signal, joints)) for field, signal in SIGNALS.items()),
        *(("via", pose, signal_names("link_position", joints)) for pose in s.via),
        *((field, getattr(s, field), signal_names(robot.drive_kind.quantity, joints)) for field in EFFORTS),
    ]
    for field in ("quantisation", "measurement_noise"):
        if any(isinstance(value, Stated) for value in parts_of(getattr(s, field))):
            stated.append((field, *per_signal(robot, s.measured, getattr(s, field))))
    for field, values, signals in stated:
        parts, units = parts_of(values), [known[name] for name in signals]
        each = parts * len(signals) if len(parts) == 1 else parts
        for part, signal, unit in zip(each, signals, units) if len(each) == len(signals) else ():
            if isinstance(part, Stated) and part.si != unit:
                written = parts if len(set(units)) == 1 else each  # one for all joints, where one can be
                if field in EFFORTS:  # volts make no amperes, whatever their number
                    raise SpecificationError(
                        field,
                        f"The {field.replace('_', ' ')} does not fit the robot {robot.name!r}, whose motors are driven "
                        f"by {robot.drive}.",
                        f"expected {unit} of {signal!r}, got {value_text(part.number + part.unit, 60)}",
                        f"`{field}` in {unit}, from the data sheet of motor or amplifier",
                    )
                usual = SMALL_UNITS if field in ("remaining_error", "path_distance") else CUSTOMARY
                raise SpecificationError(
                    field,
                    f"The {field.replace('_', ' ')} has a unit that {signal!r} does not have.",
                    f"expected {unit} (or text with {usual[unit]}), got {value_text(part.number + part.unit, 60)}",
                    example=",".join(_fitted(number, unit, usual) for number, unit in zip(written, units)),
                )


def _fitted(value: float, unit: str, usual: Mapping[str, str]) -> str:
    if not isinstance(value, Stated):
        return f"{value:g}"
    # as it was written, its unit exchanged for one of the same size that fits
    other = unit.replace("·", "") if value.unit.lower() == value.si.lower() else usual[unit]
    return value.number + (value.unit if value.si == unit else other)


def per_signal(robot: Robot, measured: Sequence[str], values: Any) -> tuple[tuple[Any, ...], tuple[str, ...]]:
    """A value for each measured signal, and the signals. A value of a name such as link_position holds for each of its
    signals."""
    signals = expanded(measured, SENSORS, robot.joint_names, robot.rigid)
    parts = parts_of(values)
    if len(parts) != len(signals) and len(parts) == len(measured):
        groups = [expanded(name, SENSORS, robot.joint_names, robot.rigid) for name in measured]
        parts = tuple(part for group, part in zip(groups, parts) for _ in group)
    return parts, signals


def parts_of(values: Any) -> tuple[Any, ...]:
    """Several values of a field, or its one, as a tuple."""
    return cast("tuple[Any, ...]", values) if isinstance(values, tuple) else (values,)
