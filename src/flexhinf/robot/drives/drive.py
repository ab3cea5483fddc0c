"""A kind of drive: its input, the numbers that its motors state, the equations of its torque.

Everything that differs between drives stands in their kind. Readers ask it, and none compares a drive's name.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple, TypeAlias

from flexhinf.extensions import Registry

if TYPE_CHECKING:
    import numpy as np

    from flexhinf.arrays import Elements, Number

#: A number of each motor, by the parameters of a plant.
Gain: TypeAlias = Callable[[Any], Any]


class MotorTorque(NamedTuple):
    """Torques of motors with rotors that turn at the speed ω: `torque` − `damping` ω − `share` of the load.

    The load is the torque of the spring with dry friction. `damping` has the friction B that is left of it.
    """

    torque: Any
    damping: Any
    share: Any = 1.0


@dataclass(frozen=True)
class DriveKind(ABC):
    """How motors are driven.

    Parameters
    ----------
    name : str
        As a robot file has it.
    quantity : str
        What the input is; its signals have this name.
    units : pair of str
        Of the input, of a joint that turns and of one that slides.
    interface : str
        Of ros2_control, by which a command is written.
    constants : tuple of str
        The constants of a motor that say that it is driven so; none of a drive that takes torques, or has a loop.
    at_motor : str
        What the input is at the motor, with the operation by which the gear ratio makes it that, as in "motor angle /".
        Empty where it is the same.
    loop, gains : tuple of str
        Numbers of an inner loop in a robot file: as a loop, or as gains. One way is stated.
    usual_bandwidth : float
        Of the loop of a usual drive, Hz; `flexhinf init` writes it as an estimate.
    """

    name: str
    quantity: str
    units: tuple[str, str]
    interface: str
    constants: tuple[str, ...] = ()
    at_motor: str = ""
    loop: tuple[str, ...] = ()
    gains: tuple[str, ...] = ()
    usual_bandwidth: float = 0.0

    #: Whether the drive has a loop of its own, whose limit is that of a command and says nothing of torques.
    inner: ClassVar[bool] = False
    #: Whether the coil of a motor may be modelled: the input is its voltage.
    coil: ClassVar[bool] = False

    @property
    def commands(self) -> Literal["torque", "velocity", "position"]:
        """The motion that the input states, or else a torque: how a stop commands it."""
        return "torque"

    @property
    def takes_positions(self) -> bool:
        """Whether the input is where the motor shall be: a limit of it is a range of positions."""
        return self.commands == "position"

    @property
    def takes_velocities(self) -> bool:
        """Whether the input is how fast the motor shall be."""
        return self.commands == "velocity"

    @property
    def takes_torques(self) -> bool:
        """Whether the input is the torque itself, as a largest effort of a URDF file is."""
        return not (self.inner or self.constants)

    # Equations ----------------------------------------------------------------------------------------
    @abstractmethod
    def torque_per_input(self, p: Any) -> Elements | float:
        """Torque of a motor at rest per unit of its input, on the link side."""

    @abstractmethod
    def driven(self, u: Any, angle: Any, speed: Any, p: Any, limited: bool = False) -> MotorTorque:
        """The torque of motors (n,) with inputs, angles and speeds (n,). `limited`: within the limit of an inner loop,
        so that the damping of the loop is a part of the torque, and the whole load is stated."""

    @abstractmethod
    def input_for(self, torque: Any, angle: Any, speed: Any, p: Any) -> Elements:
        """Inputs (n,) with which motors have a torque at an angle and a speed, (n,) each. The torque has friction and
        the share of the load, as `share` states it."""

    @abstractmethod
    def holding_input(self, load: Any, p: Any) -> Any:
        """Inputs (n,) that hold a load (n,) at rest; of drives that take positions, beside the motor's position."""

    @property
    def actuator(self) -> str:
        """An inner loop as an element of MJCF, with places for the joint and gains; empty without a loop."""
        return ""

    def share(self, p: Any) -> Any:
        """The share of spring and friction that moves a motor: 1 but for loops that reject their load."""
        return 1.0

    def back_emf(self, p: Any) -> Any:
        """Torque per speed that a motor loses to its back-EMF, N·m·s/rad or N·s/m; 0 where the input is no voltage."""
        return 0.0

    def free_speeds(self, inputs: Any, p: Any) -> np.ndarray | None:
        """Speeds (n,) of motors without a load at these inputs (n,); None where the input limits no speed."""
        return None

    def coil_currents(self, load: Any, p: Any) -> Any:
        """Currents (n,) that hold a load (n,), of motors whose coils are modelled."""
        return self.holding_input(load, p)

    def gains_of(self, of: Callable[[str, Number], Number], inertia: Number) -> dict[str, Number]:
        """The loop's gains for one motor with an inertia; ``of(quantity, default)`` is what its joint states."""
        return {}


@dataclass(frozen=True)
class InnerLoop(DriveKind):
    """A drive with a loop of its own: τ = k (c − θ) − d θ̇ for a position, d (c − θ̇) for a velocity c.

    With `order` None it is τ = k c − d θ̇, the command being no motion.

    Parameters
    ----------
    order : int or None
        Derivative of the motor's position that is commanded: 0 or 1.
    gain, damping : callable
        k and d of each motor, by the parameters of a plant.
    damping_ratio : float or None
        That of all such loops; None where a robot file states it.
    """

    order: int | None = None
    gain: Gain = lambda p: p.drive_damping
    damping: Gain = lambda p: p.drive_damping
    damping_ratio: float | None = None

    inner: ClassVar[bool] = True

    @property
    def commands(self) -> Literal["torque", "velocity", "position"]:
        """The motion of this order."""
        if self.order is None:
            return "torque"
        return "velocity" if self.order else "position"

    @property
    def actuator(self) -> str:
        """The loop as an element of MJCF, with places for the joint, k and d."""
        if self.takes_positions:
            return 'position joint={} kp="{}" kv="{}"'
        if self.takes_velocities:
            return 'velocity joint={} kv="{}"'
        return 'general joint={} biastype="affine" gainprm="{}" biasprm="0 0 -{}"'

    def torque_per_input(self, p: Any) -> Elements | float:
        """Torque per unit of the input, as of `DriveKind`."""
        return self.gain(p)

    def driven(self, u: Any, angle: Any, speed: Any, p: Any, limited: bool = False) -> MotorTorque:
        """The torque of motors, as of `DriveKind`."""
        torque = self.gain(p) * u
        if self.takes_positions:
            torque = torque - self.gain(p) * angle
        if limited:
            return MotorTorque(torque - self.damping(p) * speed, p.friction)
        return MotorTorque(torque, self.damping(p) + p.load_share * p.friction, p.load_share)

    def input_for(self, torque: Any, angle: Any, speed: Any, p: Any) -> Elements:
        """Inputs for a torque, as of `DriveKind`."""
        ahead = (1.0 / self.gain(p)) * (torque + self.damping(p) * speed)
        return angle + ahead if self.takes_positions else ahead

    def holding_input(self, load: Any, p: Any) -> Any:
        """Inputs that hold a load, as of `DriveKind`."""
        return p.load_share * load / self.gain(p)

    def share(self, p: Any) -> Any:
        """The share that the loop states."""
        return p.load_share

    def gains_of(self, of: Callable[[str, Number], Number], inertia: Number) -> dict[str, Number]:
        """The gains of the loop, stated or by its bandwidth and its damping ratio."""
        rate = of("drive_bandwidth", 0.0)
        ratio = of("drive_damping_ratio", 0.0) if self.damping_ratio is None else self.damping_ratio
        numbers: dict[str, Callable[[], Number]] = {
            "drive_stiffness": lambda: inertia * rate * rate,
            "drive_damping": lambda: 2.0 * ratio * rate * inertia,
        }
        found = {name: of(name, make()) for name, make in numbers.items() if name in self.gains}
        return found | {"load_share": of("load_share", 1.0)}


#: All kinds of drives, by name.
DRIVES: Registry[DriveKind] = Registry("drive", "flexhinf.robot.drives")


def register(kind: DriveKind) -> DriveKind:
    """Add a kind of drive: robot files, plants, designs and exports then take it.

    Raises `InvalidInput` for a name that is used, or cannot be one.
    """
    return DRIVES.register(kind)


def input_units() -> dict[str, tuple[str, str]]:
    """Units of the inputs, of joints that turn and that slide, by quantity."""
    return {kind.quantity: kind.units for kind in DRIVES.values()}
