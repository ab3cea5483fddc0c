"""Names, units and sensors of the signals of n elastic joints.

With one joint a signal has its plain name, ``link_position``. With several each has the joint's name behind
it, ``link_position_elbow``, and the plain name stands for all of them, wherever names are expected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.robot.extras import spring_torque
from flexhinf.untrusted import checked_names

__all__ = ["MECHANICAL", "SENSORS", "Sensors", "expanded", "groups_of", "signal_names", "units_of"]

#: The state of a joint, in the order of x: all link positions, all link velocities, and so on.
MECHANICAL = ("link_position", "link_velocity", "motor_position", "motor_velocity")

#: What a sensor can measure. Motor signals are seen from the link: the motor's angle over the gear ratio.
SENSORS = (*MECHANICAL, "joint_torque")

#: Units for joints that turn and joints that slide.
UNITS = {
    "link_position": ("rad", "m"),
    "link_velocity": ("rad/s", "m/s"),
    "motor_position": ("rad", "m"),
    "motor_velocity": ("rad/s", "m/s"),
    "coil_current": ("A", "A"),
    "motor_voltage": ("V", "V"),
    "drive_torque": ("N·m", "N"),
    "link_torque": ("N·m", "N"),
    "motor_torque": ("N·m", "N"),
    "joint_torque": ("N·m", "N"),
    "joint_torque_rate": ("N·m/s", "N/s"),
}


def signal_names(quantity: str, joints: Sequence[str]) -> tuple[str, ...]:
    """One name per joint."""
    return (quantity,) if len(joints) == 1 else tuple(f"{quantity}_{joint}" for joint in joints)


def groups_of(joints: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Plain names and what they stand for; none with one joint, whose names are plain."""
    if len(joints) == 1:
        return {}
    return {quantity: signal_names(quantity, joints) for quantity in UNITS}


def units_of(joints: Sequence[str], slides: Sequence[bool]) -> dict[str, str]:
    """Unit of each signal, by name."""
    units = {}
    for quantity, pair in UNITS.items():
        for name, sliding in zip(signal_names(quantity, joints), slides):
            units[name] = pair[sliding]
    integrals = {f"{name}_integral": f"{unit}·s" for name, unit in units.items() if "position" in name}
    return units | integrals


def expanded(names: str | Sequence[str], quantities: Sequence[str], joints: Sequence[str]) -> tuple[str, ...]:
    """Single names from single and plain ones.

    Raises
    ------
    InvalidInput
        For no name, an unknown one, or the same signal twice.
    """
    requested = checked_names("The sensors", names)
    single = {name: (name,) for quantity in quantities for name in signal_names(quantity, joints)}
    known = {**single, **{quantity: signal_names(quantity, joints) for quantity in quantities}}
    unknown = [name for name in requested if name not in known]
    if unknown or not requested:
        raise InvalidInput(
            f"Nothing measures {unknown[0]!r}." if unknown else "Nothing is measured.",
            f"expected one or more of {list(known)}, got {list(requested)}",
            "measured=('link_position',)",
        )
    found = tuple(name for part in requested for name in known[part])
    if len(set(found)) != len(found):
        raise InvalidInput(
            "A signal is measured twice.", f"expected distinct signals, got {list(found)}", "each signal once"
        )
    return found


@dataclass(frozen=True)
class Sensors:
    """y: the measured signals.

    Parameters
    ----------
    names : sequence of str
        Single names, see `expanded`.
    joints : sequence of str
    extras : sequence of str
        What the joint adds: a torque sensor feels the spring as it is.
    """

    names: tuple[str, ...]
    joints: tuple[str, ...]
    extras: tuple[str, ...] = ()

    def __call__(self, x: Any, u: Any, p: Any) -> Any:
        """The measured signals (p,) of any element."""
        n = len(self.joints)
        parts = {quantity: x[k * n : (k + 1) * n] for k, quantity in enumerate(MECHANICAL)}
        torques = signal_names("joint_torque", self.joints)
        if any(name in torques for name in self.names):
            twist = parts["motor_position"] - parts["link_position"]
            rate = parts["motor_velocity"] - parts["link_velocity"]
            parts["joint_torque"] = spring_torque(twist, rate, p, self.extras)
        signals = {
            name: part[i]
            for quantity, part in parts.items()
            for i, name in enumerate(signal_names(quantity, self.joints))
        }
        return np.array([signals[name] for name in self.names])
