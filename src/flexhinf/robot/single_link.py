"""The single-link arm of Sec. 6: Spong's model (Eq. 2) with a voltage-driven DC motor."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.plant import Plant

__all__ = ["REQUIRED", "SENSORS", "single_link_plant"]

#: Parameters of the model; "inductance" counts only with the coil.
REQUIRED = (
    "mass",
    "stiffness",
    "length",
    "gravity",
    "link_inertia",
    "motor_inertia",
    "resistance",
    "inductance",
    "torque_constant",
    "back_emf_constant",
    "friction",
)

STATES = ("link_position", "link_velocity", "motor_position", "motor_velocity")
UNITS = {
    "link_position": "rad",
    "link_velocity": "rad/s",
    "motor_position": "rad",
    "motor_velocity": "rad/s",
    "coil_current": "A",
    "motor_voltage": "V",
    "link_torque": "N·m",
    "motor_torque": "N·m",
    "joint_torque": "N·m",
    "link_position_integral": "rad·s",
}

#: What a sensor can measure, as a function of the state and the parameters.
SENSORS: dict[str, Callable[[Any, Any], Any]] = {
    "link_position": lambda x, p: x[0],
    "link_velocity": lambda x, p: x[1],
    "motor_position": lambda x, p: x[2],
    "motor_velocity": lambda x, p: x[3],
    "joint_torque": lambda x, p: p.stiffness * (x[2] - x[0]),
}

#: Divisors, and what no arm has with the other sign.
POSITIVE = ("link_inertia", "motor_inertia", "stiffness", "resistance", "inductance")


def mechanics(x: Any, motor_torque: Any, damping: Any, d: Any, p: Any) -> tuple[Any, Any, Any, Any]:
    """Rates of the four mechanical states, Sec. 6; d = (link torque, motor torque).

    Parameters stand together, as in the paper: a kernel computes their quotients once for all sigma points.
    """
    q, dq, theta, dtheta = x[0], x[1], x[2], x[3]
    gravity = p.mass * p.gravity * p.length / p.link_inertia * np.sin(q)
    twist = q - theta
    link_acceleration = d[0] / p.link_inertia - gravity - p.stiffness / p.link_inertia * twist
    motor_acceleration = (
        p.stiffness / p.motor_inertia * twist
        - damping / p.motor_inertia * dtheta
        + (motor_torque + d[1]) / p.motor_inertia
    )
    return dq, link_acceleration, dtheta, motor_acceleration


def flow(x: Any, u: Any, d: Any, p: Any) -> Any:
    """ẋ with the coil's pole neglected: the torque k_m (V − k_b θ̇)/R, as in Sec. 6."""
    gain = p.torque_constant / p.resistance
    return np.array(mechanics(x, gain * u[0], p.friction + gain * p.back_emf_constant, d, p))


def flow_with_coil(x: Any, u: Any, d: Any, p: Any) -> Any:
    """ẋ with the coil: the torque k_m i, and L di/dt = V − R i − k_b θ̇ (Table 2)."""
    current_rate = (u[0] - p.resistance * x[4] - p.back_emf_constant * x[3]) / p.inductance
    return np.array([*mechanics(x, p.torque_constant * x[4], p.friction, d, p), current_rate])


@dataclass(frozen=True)
class Sensors:
    """y: the measured signals, in the order of their names."""

    names: tuple[str, ...]

    def __call__(self, x: Any, u: Any, p: Any) -> Any:
        return np.array([SENSORS[name](x, p) for name in self.names])


def single_link_plant(parameters: Mapping[str, float], measured: tuple[str, ...], inductance: bool) -> Plant:
    """The plant with named states; see `flexhinf.robot.robot.Robot.plant`."""
    unknown = [name for name in measured if name not in SENSORS]
    if unknown or not measured:
        raise InvalidInput(
            f"Nothing measures {unknown[0]!r}." if unknown else "Nothing is measured.",
            f"expected one or more of {list(SENSORS)}, got {list(measured)}",
            "measured=('link_position',)",
        )
    for name in POSITIVE:
        if not parameters[name] > 0.0:
            raise InvalidInput(
                f"The parameter {name!r} must be positive.",
                f"expected > 0, got {parameters[name]!r}",
                "correct the value",
            )
    return Plant(
        flow_with_coil if inductance else flow,
        Sensors(measured),
        states=(*STATES, "coil_current") if inductance else STATES,
        inputs=("motor_voltage",),
        disturbances=("link_torque", "motor_torque"),
        parameters=dict(parameters),
        outputs=measured,
        units=UNITS,
    )
