"""A kind of sensor: all that differs between the quantities that are measured at a joint.

Readers ask the kind, and none compares the name of a sensor.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, Protocol

from flexhinf.extensions import Registry

#: A measured velocity has the noise of a position that is differentiated at this rate, 1/s.
VELOCITY_RATE = 100.0


class JointSignals(Protocol):
    """The joints of a robot at an instant, on any element; seen from the links."""

    @property
    def link_positions(self) -> Any:
        """Of all joints (n,), rad or m."""
        ...

    @property
    def link_velocities(self) -> Any:
        """Of all joints (n,), rad/s or m/s."""
        ...

    @property
    def motor_positions(self) -> Any:
        """Of all joints (n,), rad or m; those of the links where joints are rigid."""
        ...

    @property
    def motor_velocities(self) -> Any:
        """Of all joints (n,), rad/s or m/s."""
        ...

    @property
    def twists(self) -> Any:
        """Of the springs, rad or m, one per elastic joint: motor minus link."""
        ...

    @property
    def twist_rates(self) -> Any:
        """Of the springs, rad/s or m/s, one per elastic joint."""
        ...

    @property
    def spring_torques(self) -> Any:
        """Of the springs on the links, N·m or N, one per elastic joint."""
        ...


class JointRanges(NamedTuple):
    """What is known of one joint, infinite where it is not.

    `low`, `high`: Of the link's position, rad or m. `speed`, `motor_speed`: rad/s or m/s. `torque`, `twist`: Of the
    spring, N·m or N, and rad or m. `stiffness`: The largest, N·m/rad or N/m. `ends`: Of the output of the motor's gear,
    rad or m.
    """

    low: float
    high: float
    speed: float
    motor_speed: float
    torque: float
    twist: float
    stiffness: float
    ends: tuple[float, float]


@dataclass(frozen=True)
class SensorKind:
    """A quantity that is measured at a joint.

    Parameters
    ----------
    name : str
        Of the quantity. A signal has the joint's name behind it where there are several joints.
    units : pair of str
        Of a joint that turns and of one that slides.
    side : {"link", "motor", "spring"}
        Where it is. A rigid joint has no spring, and no sensor of one.
    measure : callable
        The values by `JointSignals`: of all joints, or of the springs one per elastic joint.
    plausible : callable
        Least and largest value and largest change per s, by `JointRanges`.
    coarsest : pair of float
        Steps beyond which nothing is left to be measured, in the units.
    interface : str
        Of ros2_control: on the link's side those that it knows, on the motor's side names of our own.
    pair : (4,) and int, optional
        What it sees of a pair's state (z, ż, w, ẇ), and the power of K^½ that scales its signal, for
        `flexhinf.estimation.ModalFilter`; without them that filter refuses it.
    rate : bool
        Whether it measures a velocity, whose noise is `VELOCITY_RATE` times that of a position.
    force : bool
        Whether it measures a torque, whose noise is the stiffness times that of a position.
    counted : bool
        Whether it is an encoder, of which a file may state the counts per turn.
    at_motor : str
        What it is at the motor, with the operation by which the gear ratio makes it that: "motor angle /".
    instruments : tuple of str
        Parts of the names of instruments that measure it, for advice.
    instrument : str
        What such an instrument is called, with where it is.
    """

    name: str
    units: tuple[str, str]
    side: Literal["link", "motor", "spring"]
    measure: Callable[[JointSignals], Any]
    plausible: Callable[[JointRanges], tuple[float, float, float]]
    coarsest: tuple[float, float]
    interface: str
    pair: tuple[tuple[float, float, float, float], int] | None = None
    rate: bool = False
    force: bool = False
    counted: bool = False
    at_motor: str = ""
    instruments: tuple[str, ...] = ()
    instrument: str = ""

    @property
    def of_springs(self) -> bool:
        """Whether it measures what twists, which a rigid joint has not."""
        return self.side == "spring"

    @property
    def of_motors(self) -> bool:
        """Whether it measures a motor, seen from the link."""
        return self.side == "motor"

    @property
    def tells_links(self) -> bool:
        """Whether it tells of the link of a motor that does not feel its load."""
        return self.side != "motor"

    @property
    def is_position(self) -> bool:
        """Whether it measures where a link or a motor is."""
        return not (self.rate or self.force or self.of_springs)

    @property
    def tells_twist(self) -> bool:
        """Whether the twist of a spring follows of it alone."""
        return self.of_springs and not self.rate

    def twist_per_unit(self, stiffness: float) -> float:
        """The twist of a spring with a stiffness per unit of the signal."""
        return 1.0 / stiffness if self.force else 1.0

    def variance_factor(self, stiffness: float) -> float:
        """Variance of the noise over that of a position, for a spring with a stiffness."""
        return (VELOCITY_RATE**2 if self.rate else 1.0) * (stiffness**2 if self.force else 1.0)


#: All kinds of sensors, by the names of the quantities.
SENSORS: Registry[SensorKind] = Registry("sensor", "flexhinf.plant.instruments")


def register(kind: SensorKind) -> SensorKind:
    """Add a kind of sensor: robot files, plants, designs and exports then take it.

    Raises `InvalidInput` for a name that is used, or cannot be one.
    """
    return SENSORS.register(kind)


def quantity_of(signal: str) -> str:
    """The quantity of a measured signal, without the name of its joint. The signal is one of `SENSORS`."""
    kind = sensor_of(signal)
    assert kind is not None, signal
    return kind.name


def sensor_of(signal: str) -> SensorKind | None:
    """The kind that measures a signal, by its name with or without a joint's; None of a signal of something else."""
    found = [name for name in SENSORS if signal == name or signal.startswith(f"{name}_")]
    return SENSORS[max(found, key=len)] if found else None
