"""The sensors that a robot has: what each measures, the step of its values, its noise."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from flexhinf.errors import located, refuse_if
from flexhinf.plant.instruments import SENSORS
from flexhinf.robot.parameters import per_joint
from flexhinf.validation import distinct, nearest


@dataclass(frozen=True)
class JointSensor:
    """A sensor of one joint, seen from the link.

    `signal`: the name of the measured signal, such as ``motor_position_elbow``. `step`: resolution of its values, 0 for
    none. `noise`: standard deviation. Both are in the unit of the signal, rad or m, rad/s or m/s, N·m or N. `delay`:
    age of a value when a controller has it, s.
    """

    signal: str
    step: float = 0.0
    noise: float = 0.0
    delay: float = 0.0

    @property
    def variance(self) -> float:
        """Variance of the noise; where none is stated that of a step of its values, step²/12."""
        return self.noise**2 if self.noise else self.step**2 / 12.0


def check_sensors(
    robot: str, sensors: Sequence[JointSensor], joints: Sequence[str], rigid: Collection[str]
) -> None:
    """Refuse sensors of a robot with these joints that measure nothing of it, the same twice, or without an error."""
    known = {
        per_joint(quantity, joint, len(joints))
        for quantity in SENSORS
        for joint in joints
        if joint not in rigid or not SENSORS[quantity].of_springs
    }
    for sensor in sensors:
        refuse_if(
            sensor.signal not in known,
            f"The robot {robot!r} has no signal {sensor.signal!r} for a sensor.",
            f"expected {list(SENSORS)} with the joint's name behind it, of {list(joints)}, got {sensor.signal!r}",
            nearest(
                sensor.signal,
                sorted(known),
                f"JointSensor({per_joint(next(iter(SENSORS)), joints[0], len(joints))!r})",
            ),
        )
        usable = all(math.isfinite(x) and x >= 0.0 for x in (sensor.step, sensor.noise))
        refuse_if(
            not usable or not sensor.variance,
            f"The sensor of {sensor.signal!r} has no usable step or noise.",
            f"expected numbers of at least 0, one above it, got step {sensor.step!r} and noise {sensor.noise!r}",
            "step = 1e-4, or noise = 1e-4, from its data sheet",
        )
        refuse_if(
            not 0.0 <= sensor.delay < math.inf,
            f"The sensor of {sensor.signal!r} has a delay that is no time.",
            f"expected seconds, zero or more, got {sensor.delay!r}",
            "delay = '2 ms', or without it",
        )
    distinct(f"The robot {robot!r}: the sensor of", tuple(sensor.signal for sensor in sensors))


def file_sensors(
    file: str,
    rows: Sequence[Mapping[str, Any]],
    joints: Sequence[str],
    slides: Sequence[bool],
    numbers: Mapping[str, float],
) -> tuple[JointSensor, ...]:
    """The sensors that the joints of a file state, by the rows of their tables and the robot's nominal numbers."""
    stated = {row["name"]: row["sensor"] for row in rows}
    found = list[JointSensor]()
    for joint, sliding in zip(joints, slides):
        ratio = numbers.get(per_joint("gear_ratio", joint, len(joints)))
        for row in stated.get(joint, ()):
            with located(f"{file}: joint {joint!r}, sensor of {row['kind']}"):
                signal = per_joint(row["kind"], joint, len(joints))
                found.append(
                    JointSensor(signal, *_step_and_noise(row, ratio, sliding), row.get("delay", 0.0))
                )
    return tuple(found)


def _step_and_noise(row: Mapping[str, Any], ratio: float | None, sliding: bool) -> tuple[float, float]:
    """Step and noise seen from the link, of a sensor of a joint with this gear ratio, rad/rad or rad/m."""
    kind, turns = SENSORS[row["kind"]], not sliding
    before = row.get("before_gear", kind.of_motors and ratio is not None)
    motors = [each.name for each in SENSORS.values() if each.of_motors]
    encoders = [each.name for each in SENSORS.values() if each.counted]
    refuse_if(
        before and not kind.of_motors,
        "It is before the gear, where no link is.",
        f"expected {' or '.join(motors)} there, got {kind.name!r}",
        "before_gear = false, or left out",
    )
    refuse_if(
        before and ratio is None,
        "It is before a gear whose ratio is not stated.",
        "expected gear_ratio in [joint.motor], got none",
        "gear_ratio with rotor_inertia instead of motor_inertia; or before_gear = false with numbers behind the gear",
    )
    refuse_if(
        "counts" in row and ("step" in row or not kind.counted or not (turns or before)),
        "Its counts per turn do not fit it.",
        f"expected counts or step of an encoder that turns ({', '.join(encoders)}), got "
        f"{[key for key in ('counts', 'step') if key in row]} of {kind.name!r}",
        f"step = … {kind.units[sliding]} alone",
    )
    step = 2.0 * math.pi / row["counts"] if "counts" in row else row.get("step", 0.0)
    scale = abs(ratio or 1.0) if before else 1.0
    return step / scale, row.get("noise", 0.0) / scale
