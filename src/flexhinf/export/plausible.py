"""Which measurements of a robot are plausible: ranges and speeds from its limits, and what follows of them.

A link is within the range of its joint, with room for a twentieth of it on either side, so that an arm that swings past
an end of its range is still seen, and one that stands there can be led back. A motor is further by the twist of the
spring at most: the largest torque of the drive, applied at once, stretches a spring of stiffness K twice as far as at
rest, to 2 τ / K. Links and motors are no faster than twice the stated speed, as a spring that is let go throws its link
twice as fast as the motor that held it. Where none is stated and a voltage drives the motor, that is no faster than
twice the speed V / k_b at which the back-EMF takes the whole voltage, as a weight that the motor can hold drives it on
by as much again at most; and its link twice as fast as that. The torque of a spring is that of the twist.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from flexhinf.loop import Controller
from flexhinf.plant.instruments import SENSORS, JointRanges, SensorKind

if TYPE_CHECKING:
    from flexhinf.robot import Robot

#: How many standard deviations of a sensor's noise a plausible measurement may be beyond a limit.
NOISE = 6.0

#: How much further a torque stretches a spring that is applied at once, how much faster than without a load a motor is
#: that a weight drives, than its motor a link, and than their stated speed both.
TWICE = 2.0

#: Room beyond the ends of a joint's range, as a share of it.
ROOM = 0.05


def measurement_limits(
    controller: Controller, robot: Robot, speeds: np.ndarray | None = None
) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray], str]:
    """Least and largest measurements and their largest rates (p,), infinite where nothing says them; and which signals
    are not checked, with what to state, or "".

    There is room for `NOISE` standard deviations of the estimator's measurement noise.

    Parameters
    ----------
    controller : Controller
        With an estimator.
    speeds : (n,) array, optional
        Largest speeds of the links, rad/s or m/s, infinite for none; those of the robot by default.
    """
    assert controller.estimator is not None
    sensors, joints = _sensors(controller.measured, robot), _joints(controller, robot, speeds)
    rows = [
        sensor[0].plausible(joints[sensor[1]]) if sensor else (-np.inf, np.inf, np.inf) for sensor in sensors
    ]
    unchecked = [
        (name, sensor)
        for name, sensor, (_, high, rate) in zip(controller.measured, sensors, rows, strict=True)
        if np.isinf(rate if sensor and sensor[0].is_position else high)
    ]
    noise = NOISE * np.sqrt(np.diag(np.atleast_2d(controller.estimator.measurement_noise)))
    lower, upper, rate = np.transpose(rows)
    rate = rate + np.sqrt(2.0) * noise / controller.period
    text = ""
    if unchecked:
        names = ", ".join(name for name, _ in unchecked)
        text = f"Nothing says which values of {names} are plausible. To have them checked: "
        text += _advice(robot, [sensor for _, sensor in unchecked if sensor])
    return (lower - noise, upper + noise, rate), text


#: What helps whatever is missing.
IN_PYTHON = "in Python Controller(..., measurement_limits=(lower, upper, rate))"


def _advice(robot: Robot, sensors: Sequence[tuple[SensorKind, str]]) -> str:
    """What to state, and of which joints."""
    fast = dict.fromkeys(joint for kind, joint in sensors if not kind.force)
    weak = dict.fromkeys(joint for kind, joint in sensors if kind.force)
    stated = [
        f"{field} = {value} of the joint{'s' * (len(joints) > 1)} {', '.join(joints)} in the robot file, or "
        f"{option} {value} at the design"
        for field, value, option, joints in (
            ("speed_limit", 4.0, "--peak-speed", fast),
            ("effort_limit", 48.0, "--saturation", weak),
        )
        if joints
    ]
    return "; ".join([*stated, IN_PYTHON])


def _sensors(measured: Sequence[str], robot: Robot) -> list[tuple[SensorKind, str] | None]:
    """Kind and joint of each signal; None of one that is no sensor of the robot."""
    from flexhinf.robot.parameters import per_joint

    joints = robot.joint_names
    known = {
        per_joint(kind.name, joint, len(joints)): (kind, joint)
        for kind in SENSORS.values()
        for joint in joints
    }
    return [known.get(name) for name in measured]


def _with_room(low: float, high: float) -> tuple[float, float]:
    """A range with room on either side; as it is where an end is not known."""
    room = ROOM * (high - low) if np.isfinite(high - low) else 0.0
    return low - room, high + room


def _joints(controller: Controller, robot: Robot, speeds: np.ndarray | None) -> dict[str, JointRanges]:
    """What is known of each joint by its name."""
    from flexhinf.plant.parameters import Parameters
    from flexhinf.robot.drive_limits import largest_drive_torques
    from flexhinf.robot.parameters import per_joint

    joints, plant, limits = robot.joint_names, robot.plant(), controller.limits
    values = Parameters(plant.parameters.values)
    largest = np.maximum(np.abs(limits.lower), np.abs(limits.upper))
    torques = TWICE * np.minimum(
        np.abs(robot.drive_kind.torque_per_input(values)) * largest,
        largest_drive_torques(values, len(joints)),
    )
    links = TWICE * np.array(robot.speed_limits if speeds is None else speeds, dtype=float)
    motors = np.array(
        [sum(abs(f) * v for f, v in zip(row, links) if f) for row in robot.layout.matrix.tolist()]
    )
    free = robot.drive_kind.free_speeds(TWICE * largest, values)
    if free is not None:
        known = (links, TWICE), (motors, 1.0)
        links, motors = (np.where(np.isfinite(own), own, factor * free) for own, factor in known)

    def interval(quantity: str, joint: str) -> tuple[float, float]:
        name = per_joint(quantity, joint, len(joints))
        return robot[name].interval if name in robot.nominal else (0.0, 0.0)

    found: dict[str, JointRanges] = {}
    columns = (links.tolist(), motors.tolist(), torques.tolist())
    ranges = [
        _with_room(*plant.limits.get(per_joint("link_position", joint, len(joints)), (-np.inf, np.inf)))
        for joint in joints
    ]
    for joint, (low, high), row, speed, motor_speed, torque in zip(
        joints, ranges, robot.layout.matrix.tolist(), *columns, strict=True
    ):
        turned = [sorted((factor * a, factor * b)) for factor, (a, b) in zip(row, ranges) if factor]
        ends = sum(a for a, _ in turned), sum(b for _, b in turned)
        soft, stiff = interval("stiffness", joint)
        twist = 0.0 if joint in robot.rigid else torque / soft + interval("backlash", joint)[1]
        found[joint] = JointRanges(low, high, speed, motor_speed, torque, twist, stiff, ends)
    return found
