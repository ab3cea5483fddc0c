"""The drives of flexhinf: motors that take a voltage, a current or a torque; loops of velocity or position.

τ = k_t (V − k_b θ̇) / R        τ = k_t i        τ = u
τ = k_v (c − θ̇)                τ = k_p (c − θ) − k_d θ̇
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from flexhinf.robot.drives.drive import DriveKind, InnerLoop, MotorTorque, register
from flexhinf.validation import late_package

if TYPE_CHECKING:
    import numpy as np

    from flexhinf.arrays import Elements
else:
    np = late_package("numpy")  # the help of the command line names the drives, and computes nothing


@dataclass(frozen=True)
class _Torque(DriveKind):
    """A motor within a torque loop that is taken as ideal."""

    def torque_per_input(self, p: Any) -> float:
        """Torque per unit of the input, as of `DriveKind`."""
        return 1.0

    def driven(self, u: Any, angle: Any, speed: Any, p: Any, limited: bool = False) -> MotorTorque:
        """The torque of motors, as of `DriveKind`."""
        return MotorTorque(u, p.friction)

    def input_for(self, torque: Any, angle: Any, speed: Any, p: Any) -> Elements:
        """Inputs for a torque, as of `DriveKind`."""
        return torque

    def holding_input(self, load: Any, p: Any) -> Any:
        """Inputs that hold a load, as of `DriveKind`."""
        return load


@dataclass(frozen=True)
class _Current(DriveKind):
    """A motor whose current is controlled so fast that it is the input."""

    def torque_per_input(self, p: Any) -> Elements:
        """Torque per unit of the input, as of `DriveKind`."""
        return p.torque_constant

    def driven(self, u: Any, angle: Any, speed: Any, p: Any, limited: bool = False) -> MotorTorque:
        """The torque of motors, as of `DriveKind`."""
        return MotorTorque(p.torque_constant * u, p.friction)

    def input_for(self, torque: Any, angle: Any, speed: Any, p: Any) -> Elements:
        """Inputs for a torque, as of `DriveKind`."""
        return (1.0 / p.torque_constant) * torque

    def holding_input(self, load: Any, p: Any) -> Any:
        """Inputs that hold a load, as of `DriveKind`."""
        return load / p.torque_constant


@dataclass(frozen=True)
class _Voltage(DriveKind):
    """A motor at an amplifier of voltages."""

    coil: ClassVar[bool] = True

    def torque_per_input(self, p: Any) -> Elements:
        """Torque per unit of the input, as of `DriveKind`."""
        return p.torque_constant / p.resistance

    def driven(self, u: Any, angle: Any, speed: Any, p: Any, limited: bool = False) -> MotorTorque:
        """The torque of motors, as of `DriveKind`."""
        return MotorTorque(self.torque_per_input(p) * u, p.friction + self.back_emf(p))

    def input_for(self, torque: Any, angle: Any, speed: Any, p: Any) -> Elements:
        """Inputs for a torque, as of `DriveKind`."""
        return (p.resistance / p.torque_constant) * torque + p.back_emf_constant * speed

    def holding_input(self, load: Any, p: Any) -> Any:
        """Inputs that hold a load, as of `DriveKind`."""
        return p.resistance * np.asarray(load / p.torque_constant, dtype=float)

    def back_emf(self, p: Any) -> Elements:
        """k_t k_b / R."""
        return self.torque_per_input(p) * p.back_emf_constant

    def free_speeds(self, inputs: Any, p: Any) -> np.ndarray | None:
        """The speeds at which the back-EMF takes the whole voltage."""
        back = np.abs(np.broadcast_to(p.back_emf_constant, np.shape(inputs)))
        return np.divide(inputs, back, out=np.full(np.shape(inputs), np.inf), where=back > 0.0)

    def coil_currents(self, load: Any, p: Any) -> Any:
        """The torque over the torque constant."""
        return load / p.torque_constant


_TORQUE, _SPEED, _ANGLE = ("N·m", "N"), ("rad/s", "m/s"), ("rad", "m")

VOLTAGE = register(
    _Voltage(
        "voltage",
        "motor_voltage",
        ("V", "V"),
        "voltage",
        constants=("resistance", "torque_constant", "back_emf_constant"),
    )
)
CURRENT = register(
    _Current("current", "motor_current", ("A", "A"), "current", constants=("torque_constant",))
)
TORQUE = register(_Torque("torque", "drive_torque", _TORQUE, "effort", at_motor="motor torque *"))
VELOCITY = register(
    InnerLoop(
        "velocity",
        "velocity_command",
        _SPEED,
        "velocity",
        at_motor="command of the motor's speed /",
        order=1,
        loop=("drive_bandwidth",),
        gains=("drive_damping",),
        damping_ratio=0.5,  # so that k_v = 2ζωJ is J ω
        usual_bandwidth=60.0,  # of servo drives, see docs/drives.md
    )
)
POSITION = register(
    InnerLoop(
        "position",
        "position_command",
        _ANGLE,
        "position",
        at_motor="command of the motor's angle /",
        order=0,
        gain=lambda p: p.drive_stiffness,
        loop=("drive_bandwidth", "drive_damping_ratio"),
        gains=("drive_stiffness", "drive_damping"),
        usual_bandwidth=20.0,  # of servo drives, see docs/drives.md
    )
)
