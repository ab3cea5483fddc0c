"""The parts that a robot is assembled from, whose doubtful numbers are warned of."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flexhinf.errors import refuse_if
from flexhinf.robot.arm import Arm, Pendulum
from flexhinf.robot.drive_limits import OF_COMMANDS
from flexhinf.robot.drives import DRIVES, POSITION, DriveKind
from flexhinf.robot.dynamics import Joint, Tree, matrix_of
from flexhinf.robot.elastic import SPRING, TEETH
from flexhinf.robot.gears import CURVE, SECANT, SECOND_CORNER, secant
from flexhinf.robot.parameters import INERTIA, VECTOR, Parameter, per_joint, unit_of
from flexhinf.robot.robot import Robot
from flexhinf.validation import checked_positive, one_of

#: A plain number, or one with tolerance and source.
Number = float | Parameter

#: What a joint states of its inner loop; the rest of its numbers are parameters of the robot too, but for these times.
INNER_NUMBERS = (
    "drive_bandwidth",
    "drive_damping_ratio",
    "drive_stiffness",
    "drive_damping",
    "load_share",
    "drive_torque_limit",
    "drive_delay",
    "drive_period",
)
TIMES = ("drive_delay", "drive_period")

#: Examples of a loop's numbers, for errors.
LOOP_EXAMPLES = {"drive_bandwidth": "'20 Hz'", "drive_damping_ratio": "0.9"}

#: What a motor states beside the parameters of a robot.
BESIDE = ("drive", *TIMES, *OF_COMMANDS[1:])

#: Relative excess of one principal moment over the sum of the others that is rounding in a data sheet.
TRIANGLE_SLACK = 1e-6


@dataclass(frozen=True)
class Link:
    """A rigid link, in the frame of the joint that carries it.

    Parameters
    ----------
    mass : number
        kg.
    centre_of_mass : three numbers
        m.
    inertia : six numbers
        xx, xy, xz, yy, yz, zz about the centre of mass, axes parallel to the link's frame, kg·m². Mass and principal
        moments are positive, and no moment is above the sum of the others.
    """

    mass: Number
    centre_of_mass: Sequence[Number]
    inertia: Sequence[Number]

    def __post_init__(self) -> None:
        for name, length in (("centre_of_mass", 3), ("inertia", 6)):
            value = tuple(getattr(self, name))
            refuse_if(
                len(value) != length,
                f"The {name.replace('_', ' ')} of a link is incomplete.",
                f"expected {length} numbers, got {len(value)}",
                "x, y, z" if length == 3 else "xx, xy, xz, yy, yz, zz",
            )
            object.__setattr__(self, name, value)
        checked_positive("The mass of a link", value_of(self.mass), "kg", "its mass")
        moments = np.linalg.eigvalsh(matrix_of(map(value_of, self.inertia)))
        refuse_if(
            not moments[0] > 0.0 or moments[2] > (moments[0] + moments[1]) * (1.0 + TRIANGLE_SLACK),
            "The inertia of a link is that of no rigid body.",
            "expected positive principal moments, none above the sum of the others (the triangle inequality), got "
            f"{[float(f'{moment:.6g}') for moment in moments]} kg·m²",
            "moments about the centre of mass (not the joint), in kg·m²; a point mass gets small ones",
        )


@dataclass(frozen=True)
class SingleLink:
    """A single link that turns about a horizontal axis, with its inertia about that axis, kg·m².

    Its mass is in kg, its length from the axis to the centre of mass in m; both are zero for an axis that is vertical.
    """

    inertia: Number
    mass: Number = 0.0
    length: Number = 0.0


@dataclass(frozen=True)
class ElasticJoint:
    """The spring of a joint, and the motor behind it; all seen from the link unless said.

    Parameters
    ----------
    stiffness : number, optional
        N·m/rad (N/m for a prismatic joint, and so on); None for a rigid joint, whose rotor turns with the link. With
        the curve of a gear and no stiffness it is the secant to T₂, with the slopes of the curve for its range.
    first_stiffness, second_stiffness, third_stiffness, first_torque, second_torque : number, optional
        The curve of a gear's catalogue, K₁, K₂, K₃ (N·m/rad), T₁, T₂ (N·m), see `flexhinf.robot.gears`; without K₃ and
        T₂ it has one corner.
    motor_inertia : number, optional
        Rotor's inertia reflected to the link side, N² J_m, kg·m².
    rotor_inertia, gear_ratio, hub_inertia : number, optional
        Instead: the rotor's own inertia J_m (kg·m²), the ratio N, and what turns with the output (kg·m²).
    friction : number
        Viscous, on the motor side of the spring, N·m·s/rad.
    resistance, torque_constant, back_emf_constant : number, optional
        Of the motor, Ω, N·m/A, V·s/rad; before the gear where there is a gear ratio. With all of them the input is
        a voltage, with the torque constant alone a current, without them a torque.
    gear_efficiency, motor_efficiency : number, optional
        η_g, η_m.
    inductance : number, optional
        H.
    kinematic_error, kinematic_error_phase, torque_ripple, torque_ripple_phase : number, optional
        Amplitudes (rad, N·m, seen from the link) and phases (rad) of what the teeth of a gear add, twice in each turn
        of the motor.
    damping, spring_hardening, backlash, coulomb_friction, load_friction : number, optional
    static_friction, stribeck_velocity, friction_smoothing : number, optional
        What a real joint adds, see `flexhinf.robot.elastic`.
    drive : str, optional
        What the input is, by the name of a kind in `flexhinf.robot.drives`; by default what the motor's constants say.
    drive_bandwidth, drive_damping_ratio : number, optional
        Of a drive with an inner loop, which takes velocities or positions: ω of ω/(s + ω), or ω and ζ of
        ω²/(s² + 2ζωs + ω²), rad/s.
    drive_stiffness, drive_damping : number, optional
        Instead, its gains: torque per position (not of a velocity drive) and per velocity, N·m/rad and N·m·s/rad.
    load_share : number, optional
        Share of the load that moves the motor: 1 of a loop with these gains alone (the default), 0 where the drive
        rejects its load.
    drive_torque_limit : number, optional
        Largest torque of the motor, N·m on the link side, whatever the command.
    drive_delay, drive_period : float
        Time from a command to the loop, and between two commands that the drive takes, s.
    drive_rate_limit, drive_acceleration_limit : float, optional
        Largest change of a command, in the unit of the input per s, and of that, per s²; of any drive.

    Raises InvalidInput: if the inertia on the motor side is stated twice or not at all, the motor in part, or a drive
    that its numbers contradict.
    """

    stiffness: Number | None = None
    motor_inertia: Number | None = None
    rotor_inertia: Number | None = None
    gear_ratio: Number | None = None
    hub_inertia: Number | None = None
    friction: Number = 0.0
    resistance: Number | None = None
    torque_constant: Number | None = None
    back_emf_constant: Number | None = None
    gear_efficiency: Number | None = None
    motor_efficiency: Number | None = None
    inductance: Number | None = None
    damping: Number | None = None
    spring_hardening: Number | None = None
    backlash: Number | None = None
    coulomb_friction: Number | None = None
    static_friction: Number | None = None
    stribeck_velocity: Number | None = None
    friction_smoothing: Number | None = None
    drive: str = ""
    drive_bandwidth: Number | None = None
    drive_damping_ratio: Number | None = None
    drive_stiffness: Number | None = None
    drive_damping: Number | None = None
    load_share: Number | None = None
    drive_torque_limit: Number | None = None
    drive_delay: float = 0.0
    drive_period: float = 0.0
    drive_rate_limit: float | None = None
    drive_acceleration_limit: float | None = None
    first_stiffness: Number | None = None
    second_stiffness: Number | None = None
    third_stiffness: Number | None = None
    first_torque: Number | None = None
    second_torque: Number | None = None
    kinematic_error: Number | None = None
    kinematic_error_phase: Number | None = None
    torque_ripple: Number | None = None
    torque_ripple_phase: Number | None = None
    load_friction: Number | None = None

    def __post_init__(self) -> None:
        self._check_curve()
        self._check_teeth()
        twisting = [name for name in SPRING if getattr(self, name) is not None]
        refuse_if(
            self.stiffness is None and twisting,
            "A rigid joint has no spring.",
            f"expected no number of a spring, got {twisting}",
            "its stiffness; or leave them out",
        )
        refuse_if(
            self.stiffness is None and self.load_friction is not None,
            "The friction of a rigid joint by its load is not modelled: no spring says what the load is.",
            "expected no load_friction, got one",
            "[joint.spring] with its stiffness; or coulomb_friction at the usual load",
        )
        refuse_if(
            (self.motor_inertia is None) == (self.rotor_inertia is None),
            "The inertia on the motor side must be stated once.",
            "expected motor_inertia (reflected to the link side, N² J_m) or rotor_inertia with gear_ratio, got "
            + ("neither" if self.motor_inertia is None else "both"),
            "one of them; the rotor's inertia is never part of the link's",
        )
        refuse_if(
            self.rotor_inertia is not None and self.gear_ratio is None,
            "A rotor inertia needs its gear ratio.",
            "expected gear_ratio beside rotor_inertia, got none",
            "gear_ratio = 1 for a direct drive; or motor_inertia, reflected to the link side",
        )
        refuse_if(
            self.hub_inertia is not None and self.rotor_inertia is None,
            "A hub inertia is added to a reflected rotor inertia.",
            "expected rotor_inertia and gear_ratio beside hub_inertia, got motor_inertia",
            "add it to motor_inertia",
        )
        motors = [kind for kind in DRIVES.values() if not kind.inner]
        known = dict.fromkeys(name for kind in motors for name in kind.constants)
        stated = tuple(name for name in known if getattr(self, name) is not None)
        refuse_if(
            stated not in [kind.constants for kind in motors],
            "A motor is stated in part.",
            f"expected {_by_constants(motors)}, got {list(stated)}",
            "the missing numbers from its data sheet",
        )
        self._check_drive(stated)
        refuse_if(
            self.inductance is not None and not DRIVES[self.drive].coil,
            f"A motor whose input is its {self.drive} has no use for an inductance.",
            f"expected none, got {0.0 if self.inductance is None else value_of(self.inductance):g} H",
            "leave it out; or resistance and back_emf_constant, for a motor whose input is a voltage",
        )

    @property
    def numbers(self) -> dict[str, Number]:
        """The numbers that are stated, by quantity."""
        return {name: value for name, value in vars(self).items() if name not in BESIDE and value is not None}

    @property
    def slopes(self) -> list[Number]:
        """Those of the curve; none without one."""
        stated = [getattr(self, name) for name in CURVE[:3]]
        return [number for number in stated if number is not None]

    def _check_curve(self) -> None:
        """Refuse a curve in part or with corners in the wrong order; take its secant where no stiffness is stated."""
        stated = {name: getattr(self, name) for name in CURVE if getattr(self, name) is not None}
        if not stated:
            return
        whole = CURVE if {*SECOND_CORNER} & {*stated} else [x for x in CURVE if x not in SECOND_CORNER]
        missing = [name for name in whole if name not in stated]
        refuse_if(
            missing,
            "The stiffness curve of a gear is stated in part.",
            "expected first_stiffness, second_stiffness and first_torque (K₁, K₂, T₁), and third_stiffness and "
            f"second_torque (K₃, T₂) together or not at all, got {list(stated)}",
            f"add {' and '.join(missing)} from the gear's catalogue",
        )
        refuse_if(
            self.spring_hardening is not None,
            "What a spring is beside its stiffness is stated twice.",
            "expected the curve of a gear or spring_hardening, got both",
            "one of the two",
        )
        ends = {name: interval_of(number) for name, number in stated.items()}
        low, high = ends["first_torque"], ends.get("second_torque", (np.inf, np.inf))
        refuse_if(
            not 0.0 < low[0] <= low[1] < high[0],
            "The torques of a stiffness curve are not in order.",
            f"expected 0 < first_torque < second_torque with their tolerances, got {low[0]:g} to {low[1]:g} and "
            f"{high[0]:g} to {high[1]:g}",
            "T₁ and T₂ of the gear's catalogue, N·m",
        )
        slopes = [interval_of(number) for number in self.slopes]
        refuse_if(
            not min(slope[0] for slope in slopes) > 0.0,
            "A slope of a stiffness curve is not positive.",
            f"expected > 0 N·m/rad, got {[slope[0] for slope in slopes]}",
            "K₁, K₂ and K₃ of the gear's catalogue",
        )
        if self.stiffness is None:
            numbers = (
                value_of(stated[name]) for name in CURVE if name in stated and name != "third_stiffness"
            )
            first, second, *torques = numbers
            of = secant(first, second, *(torques if len(torques) == 2 else (torques[0], np.inf)))
            spread = min(slope[0] for slope in slopes), max(slope[1] for slope in slopes)
            object.__setattr__(self, "stiffness", Parameter("stiffness", of, source=SECANT, range=spread))

    def _check_teeth(self) -> None:
        """Refuse teeth without the ratio of their gear, and an error that turns the link back."""
        stated = [name for name in TEETH if getattr(self, name) is not None]
        refuse_if(
            stated and self.gear_ratio is None,
            "The teeth of a gear need its ratio: they pass twice in a turn of the motor.",
            f"expected gear_ratio beside {stated}, got none",
            "gear_ratio in [joint.motor], where torque_constant and back_emf_constant are then before the gear",
        )
        for name in TEETH:
            refuse_if(
                getattr(self, f"{name}_phase") is not None and name not in stated,
                f"A phase of no {name.replace('_', ' ')} is stated.",
                f"expected {name} beside {name}_phase, got none",
                f"{name} = …, its amplitude; or without the phase",
            )
        if self.kinematic_error is None or self.gear_ratio is None:
            return
        error, ratio = (interval_of(number)[1] for number in (self.kinematic_error, self.gear_ratio))
        refuse_if(
            not 2.0 * ratio * error < 1.0,
            "The kinematic error of a gear would turn its link back.",
            f"expected less than 1/(2 gear_ratio) = {0.5 / ratio:.4g} with their tolerances, got {error:g}",
            "its amplitude, seen from the link: half of the accuracy that the catalogue states",
        )

    def _check_drive(self, constants: tuple[str, ...]) -> None:
        """Take the drive that the motor's constants say where none is stated; refuse one that its numbers
        contradict."""
        by_constants = next(drive for drive, kind in DRIVES.items() if kind.constants == constants)
        if not self.drive:
            object.__setattr__(self, "drive", by_constants)
        one_of("The motor is driven in an unknown way.", self.drive, DRIVES, repr(POSITION.name))
        drive, kind = self.drive, DRIVES[self.drive]
        refuse_if(
            kind.constants != constants,
            f"The drive {drive!r} contradicts the constants of its motor.",
            f"expected {' and '.join(kind.constants) or 'none'} beside drive = {drive!r}, got {list(constants)}",
            f"drive = {by_constants!r}; or {'these constants alone' if kind.constants else 'leave them out'}",
        )
        stated = [name for name in INNER_NUMBERS if getattr(self, name) not in (None, 0.0)]
        inner = [kind for kind in DRIVES.values() if kind.inner]
        refuse_if(
            stated and not kind.inner,
            f"A drive that takes a {drive} has no inner loop.",
            f"expected drive = {' or '.join(repr(each.name) for each in inner)} beside {stated}, got {drive!r}",
            f"drive = {POSITION.name!r} in [joint.motor]; or leave these numbers out",
        )
        if kind.inner:
            self._check_loop(kind, stated, inner)

    def _check_loop(self, kind: DriveKind, stated: list[str], others: list[DriveKind]) -> None:
        """Refuse numbers of a drive's loop that it does not have, or that say no loop; `others` are all with loops."""
        loops = [name for name in stated if any(name in each.loop for each in others)]
        gains = [name for name in stated if any(name in each.gains for each in others)]
        examples = [f"{name} = {LOOP_EXAMPLES.get(name, '…')}" for name in kind.loop]
        refuse_if(
            (tuple(loops), tuple(gains)) not in ((kind.loop, ()), ((), kind.gains)),
            f"The inner loop of a {kind.name} drive is not stated once.",
            f"expected {' and '.join(kind.loop)}, or its gains {' and '.join(kind.gains)}, got {loops + gains}",
            ", ".join([*(f"{example} in [joint.motor]" for example in examples[:1]), *examples[1:]]),
        )
        share = 1.0 if self.load_share is None else value_of(self.load_share)
        refuse_if(
            self.stiffness is None and share != 1.0,
            "The drive of a rigid joint cannot reject its load: the link is a part of it.",
            f"expected load_share = 1 without a spring, got {share:g}",
            "leave load_share out; or [joint.spring] with its stiffness",
        )
        refuse_if(
            not 0.0 <= share <= 1.0,
            "The share of its load that moves a motor is none.",
            f"expected 0 (the drive rejects its load) to 1, got {share:g}",
            "load_share = 1.0",
        )
        for name in ("drive_delay", "drive_period"):
            time = getattr(self, name)
            refuse_if(
                not 0.0 <= time < np.inf,
                f"The {name} of a motor is no time.",
                f"expected seconds, zero or more, got {time!r}",
                f"{name} = '4 ms'",
            )


def _by_constants(motors: Sequence[DriveKind]) -> str:
    """The constants that a motor may state, with what they say of its input."""
    *most, last = (
        f"{' and '.join(', '.join(kind.constants).rsplit(', ', 1)) or 'none'}{' alone' * (len(kind.constants) == 1)} "
        f"({kind.name} driven)"
        for kind in motors
    )
    return f"{', '.join(most)} or {last}"


def driven(elastic: Sequence[ElasticJoint]) -> dict[str, Any]:
    """The drive of all joints, the longest delay and period of one, and limits of each, by the fields of a robot."""
    times = {name: max(getattr(joint, name) for joint in elastic) for name in TIMES}
    limits = zip(("command_rates", "command_accelerations"), OF_COMMANDS[1:])
    return {
        "drive": elastic[0].drive,
        **times,
        **{field: [getattr(joint, name) for joint in elastic] for field, name in limits},
    }


def value_of(number: Number) -> float:
    """The value of a number or `Parameter`; refused where it is not finite."""
    return number.value if isinstance(number, Parameter) else Parameter("of a part", number).value


def interval_of(number: Number) -> tuple[float, float]:
    """Smallest and largest value of a number or `Parameter`."""
    return number.interval if isinstance(number, Parameter) else (number, number)


def assembled(
    name: str,
    joints: Sequence[Joint],
    links: Sequence[Link],
    elastic: Sequence[ElasticJoint],
    *,
    gravity: Number = 9.81,
    down: Sequence[float] = (0.0, 0.0, -1.0),
    **settings: Any,
) -> Robot:
    """A robot of one link and one elastic joint per joint; numbers become parameters with their joint's name.

    Parameters
    ----------
    gravity : number
        m/s².
    down : (3,)
        Direction of free fall in the world's frame.
    **settings
        penalty, home, description, effort_limits, speed_limits and coupling as for `Robot`.

    Raises InvalidInput: if the parts do not fit each other, are driven in different ways, or do not make a robot.
    """
    refuse_if(
        not len(joints) == len(links) == len(elastic),
        f"The parts of the robot {name!r} do not fit each other.",
        f"expected one link and one elastic joint per joint, got {len(joints)} joints, {len(links)} links and "
        f"{len(elastic)} elastic joints",
        "one of each",
    )
    parameters = [_parameter("gravity", gravity, "gravity")]
    for joint, link, spring in zip(joints, links, elastic):
        numbers = {
            "mass": link.mass,
            **{f"centre_of_mass_{axis}": value for axis, value in zip(VECTOR, link.centre_of_mass)},
            **{f"inertia_{axes}": value for axes, value in zip(INERTIA, link.inertia)},
            **spring.numbers,
        }
        parameters += [
            _parameter(per_joint(quantity, joint.name, len(joints)), number, quantity, joint.slides)
            for quantity, number in numbers.items()
        ]
    drives = {joint.name: spring.drive for joint, spring in zip(joints, elastic)}
    refuse_if(
        len(set(drives.values())) > 1,
        f"The robot {name!r} is driven by {' and by '.join(sorted(set(drives.values())))}.",
        f"expected the same drive, or the same motor constants, for all joints, got {drives}",
        "resistance, torque_constant and back_emf_constant of every motor (voltages), torque_constant alone "
        "(currents), none (torques), or the same drive = '…' in each [joint.motor]",
    )
    return Robot(
        name,
        tuple(parameters),
        links=Arm(Tree(tuple(joints)), tuple(down)),
        **driven(elastic),
        rigid=tuple(joint.name for joint, spring in zip(joints, elastic) if spring.stiffness is None),
        **settings,
    )


def single_link_robot(
    name: str,
    joint: Joint,
    link: SingleLink,
    elastic: ElasticJoint,
    *,
    gravity: Number = 9.81,
    **settings: Any,
) -> Robot:
    """A robot of a single link about a horizontal axis, in closed form; position zero hangs. It cannot slide."""
    refuse_if(
        joint.slides,
        f"The joint {joint.name!r} slides, so its link has no inertia about an axis.",
        "expected a revolute joint, got a prismatic one",
        "mass, centre_of_mass and inertia of the link",
    )
    refuse_if(
        elastic.stiffness is None,
        f"The only joint of the robot {name!r} is rigid.",
        "expected an elastic joint, got none",
        "[joint.spring] with stiffness = … (N·m/rad)",
    )
    inertia, least = value_of(link.inertia), value_of(link.mass) * value_of(link.length) ** 2
    ask(
        0.0 < inertia < least * (1.0 - TRIANGLE_SLACK),
        f"The link of joint {joint.name!r} has less inertia about its axis than a point of its mass.",
        f"expected axis_inertia >= mass length² = {least:.6g} kg·m², got {inertia:g}: is it about the centre of mass?",
        f"axis_inertia = {inertia + least:.6g}, with mass length² added; or the mass and the length as they are",
    )
    numbers = {"mass": link.mass, "length": link.length, "gravity": gravity, "link_inertia": link.inertia}
    numbers |= elastic.numbers
    return Robot(
        name,
        tuple(_parameter(name, number, name) for name, number in numbers.items()),
        links=Pendulum(Tree((Joint(joint.name, limits=joint.limits),))),
        **driven([elastic]),
        **settings,
    )


def _parameter(label: str, number: Number, quantity: str, slides: bool = False) -> Parameter:
    stated = number if isinstance(number, Parameter) else Parameter(label, float(number))
    return replace(stated, name=label, unit=stated.unit or unit_of(quantity, slides))


class RobotFileWarning(UserWarning):
    """A robot file says something that is allowed and probably not meant."""


@contextmanager
def file_warnings(tell: Callable[[str], object] = lambda text: None) -> Generator[list[str]]:
    """Keep warnings about robot files from Python; when the block ends their texts are told, and in the list."""
    texts: list[str] = []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", RobotFileWarning)
        yield texts
    texts += [str(record.message) for record in caught if issubclass(record.category, RobotFileWarning)]
    for text in texts:
        tell(text)


def ask(doubtful: object, what: str, found: str, advice: str, wrong: bool = False) -> None:
    """Warn of a number that is probably not what was meant; refuse it where it is surely wrong."""
    if doubtful:
        refuse_if(wrong, what, found, advice)
        warnings.warn(f"{what}\n  found: {found}\n  try:   {advice}", RobotFileWarning, stacklevel=3)
