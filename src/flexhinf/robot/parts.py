"""The parts a robot is assembled from, and the keys of robot files that state them.

`TABLES` states each key of a robot file once: what may stand there, its units, and whether it must. `RobotFile` reads,
checks and converts a file to SI units in one walk. The unit of a spring depends on its joint, N·m/rad where it turns,
N/m where it slides, which a file may say only by its URDF: both are read, and compared with the robot that comes of it.
"""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, fields, replace
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.robot.arm import Arm, Pendulum
from flexhinf.robot.dynamics import KINDS, Joint, Tree, matrix_of
from flexhinf.robot.elastic import CONSTANTS, DRIVES, SPRING
from flexhinf.robot.parameters import (
    INERTIA,
    QUANTITIES,
    VECTOR,
    Parameter,
    Stated,
    measured,
    per_joint,
    respelled,
    split,
    unit_of,
)
from flexhinf.robot.robot import Robot
from flexhinf.robot.signals import UNITS
from flexhinf.validation import checked_path, checked_positive, nearest, real_number, value_text

#: A plain number, or one with tolerance and source.
Number = float | Parameter

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
        N·m/rad (N/m for a prismatic joint, and so on); None for a rigid joint, whose rotor turns with the link.
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
    damping, spring_hardening, backlash, coulomb_friction, static_friction, stribeck_velocity, friction_smoothing
        What a real joint adds, see `flexhinf.robot.elastic`.

    Raises InvalidInput: if the inertia on the motor side is stated twice or not at all, or the motor in part.
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

    def __post_init__(self) -> None:
        twisting = [name for name in SPRING if getattr(self, name) is not None]
        refuse_if(
            self.stiffness is None and twisting,
            "A rigid joint has no spring.",
            f"expected no number of a spring, got {twisting}",
            "its stiffness; or leave them out",
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
        stated = tuple(name for name in CONSTANTS["voltage"] if getattr(self, name) is not None)
        refuse_if(
            stated not in CONSTANTS.values(),
            "A motor is stated in part.",
            "expected resistance, torque_constant and back_emf_constant (voltage driven), torque_constant alone "
            f"(current driven) or none (torque driven), got {list(stated)}",
            "the missing numbers from its data sheet",
        )
        refuse_if(
            self.inductance is not None and self.drive == "current",
            "A motor whose input is its current has no use for an inductance.",
            f"expected none beside torque_constant alone, got {value_text(self.inductance)} H",
            "leave it out; or resistance and back_emf_constant, for a motor whose input is a voltage",
        )

    @property
    def drive(self) -> str:
        """Kind of the motor's input: "voltage", "current" or "torque"."""
        other = "torque" if self.torque_constant is None else "current"
        return other if self.resistance is None else "voltage"


def value_of(number: Number) -> float:
    """The value of a number or `Parameter`; refused where it is not finite."""
    return number.value if isinstance(number, Parameter) else Parameter("of a part", number).value


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
        penalty, home, description, effort_limits and speed_limits as for `Robot`.

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
            **{quantity: number for quantity, number in vars(spring).items() if number is not None},
        }
        parameters += [
            _parameter(per_joint(quantity, joint.name, len(joints)), number, quantity, joint.slides)
            for quantity, number in numbers.items()
        ]
    drives = {joint.name: spring.drive for joint, spring in zip(joints, elastic)}
    refuse_if(
        len(set(drives.values())) > 1,
        f"The robot {name!r} is driven by {' and by '.join(sorted(set(drives.values())))}.",
        f"expected the same motor constants for all joints, got {drives}",
        "resistance, torque_constant and back_emf_constant of every motor (voltages), torque_constant alone "
        "(currents), or none (torques)",
    )
    return Robot(
        name,
        tuple(parameters),
        links=Arm(Tree(tuple(joints)), tuple(down)),
        drive=elastic[0].drive,
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
    numbers = {"mass": link.mass, "length": link.length, "gravity": gravity, "link_inertia": link.inertia}
    numbers |= vars(elastic)
    return Robot(
        name,
        tuple(_parameter(name, number, name) for name, number in numbers.items() if number is not None),
        links=Pendulum(Tree((Joint(joint.name, limits=joint.limits),))),
        drive=elastic.drive,
        **settings,
    )


def _parameter(label: str, number: Number, quantity: str, slides: bool = False) -> Parameter:
    stated = number if isinstance(number, Parameter) else Parameter(label, float(number))
    return replace(stated, name=label, unit=stated.unit or unit_of(quantity, slides))


#: A tolerance below this many per cent was probably meant as a fraction.
SMALLEST_TOLERANCE = 0.5

#: How the tables of a joint are written.
NESTING = (
    "[[joint]], two brackets, and below it [joint.link], [joint.spring] and [joint.motor] of that joint; each joint "
    "has its name in a line name = '…'"
)


class RobotFileWarning(UserWarning):
    """A robot file says something that is allowed and probably not meant."""


@contextmanager
def file_warnings(tell: Callable[[str], object] = lambda text: None) -> Iterator[list[str]]:
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


class Unusable(ValueError):
    """A value that its key does not take; its texts are what was expected, and what to write behind "="."""


class PartReader(Protocol):
    """A robot file while it is read, as far as the readers of its values use it."""

    file: str  # its name
    data: dict[str, Any]
    # Places, units and texts of numbers that state a unit.
    stated: list[tuple[tuple[Any, ...], tuple[str, ...], Stated]]

    def table(self, data: Any, keys: Mapping[str, Key], place: tuple[Any, ...]) -> dict[str, Any]:
        """The keys of a table that are stated or have a default."""
        ...


class Key(NamedTuple):
    """Values that a key of a robot file takes.

    ``read(file, value, key, place)`` returns the value, or raises `Unusable` as for one that is not `usable`. Units are
    SI, for a joint that turns and one that slides; a size is that of a list, 0 for any; `inside` names the table that
    is expected.
    """

    read: Callable[..., Any] = lambda file, value, key, place: value
    units: tuple[str, ...] = ()
    size: int = 0
    inside: str = ""
    required: bool = False
    default: Any = None
    usable: Callable[[Any], bool] = lambda value: True
    expected: str = ""


#: What a stiffness in N/m means for a joint that turns.
BELT = (
    "{:g} r², N·m/rad, for a belt on a pulley of radius r, m: N/m is the stiffness of a belt or of a sliding joint "
    "(kind = 'prismatic')"
)


def robot_files(folder: Path) -> list[str]:
    """Paths of the robot files in a folder, at most a hundred."""
    try:
        found = (entry for entry in folder.iterdir() if entry.suffix.lower() in (".toml", ".urdf", ".xml"))
        return sorted(map(str, islice(found, 100)))
    except (OSError, ValueError):  # no such folder, or none that this user may read
        return []


def file_beside(file: Path, name: str) -> Path:
    """The file of the links that a robot's file names, relative to it; InvalidInput if there is none."""
    path = file.parent / checked_path(f"The URDF of {file.name}", name)
    with suppress(OSError, ValueError):  # a name that no file can have
        if path.is_file():
            return path
    names = [Path(other).name for other in robot_files(path.parent) if Path(other) != file]
    raise InvalidInput(
        f"{file.name}: there is no file {value_text(name, 120)} beside it.",
        f"expected a URDF or an MJCF file, got {value_text(name, 120)}; beside it are {names[:10]}",
        f"urdf = {nearest(path.name, names, '…, its path as seen from this file')}",
    )


def number_in(value: Any, units: Any) -> tuple[str, str]:
    """Texts for an error: what is expected of a number with one of these units, and an example of it."""
    if not units:
        return "a valid number", ""
    meant = [repr(text) for text in respelled(value, *units)] if isinstance(value, str) else []
    if isinstance(value, str) and list(units) == ["N·m/rad"]:
        with suppress(ValueError):
            return f"a number in {units[0]}", BELT.format(measured(value, "N/m"))
    plain = " or ".join(unit.replace("1", "no unit") for unit in units)
    example = "0.8" if units[0] == "1" else repr(_completed(value, units))
    return (
        f"a valid number in {plain}, or text of a number with such a unit",
        f"{' or '.join(meant)}, in the letters of the SI" if meant else example,
    )


def _completed(value: Any, units: Sequence[str]) -> str:
    """The same number with a divisor or a power that lacks, or with the first unit where it has none.

    A number keeps no unit that makes it another one.

    Examples
    --------
    >>> _completed("31 kNm", ["N·m/rad"]), _completed("31 s", ["kg·m²"]), _completed(None, ["kg·m²"])
    ('31 kNm/rad', '… kg·m²', '5 kg·m²')
    """
    parts = split(value) if isinstance(value, str) else None
    for lacking in ("/rad", "·s/rad", "·m²", "²", "/A", "/s") if parts and parts[1] else ():
        with suppress(ValueError):
            measured(f"{value}{lacking}", *units)
            return f"{value}{lacking}"
    return f"{('…' if parts[1] else parts[0]) if parts else 5} {units[0]}"


def _number(file: PartReader, value: Any, key: Key, place: tuple[Any, ...]) -> float:
    if isinstance(value, str) and key.units:
        try:
            number = measured(value, *key.units)
        except ValueError:
            raise Unusable(*number_in(value, key.units)) from None
        file.stated.append((place, key.units, number))
        return float(number)
    number = real_number(value) if type(value) in (int, float) else math.nan
    if not math.isfinite(number):
        raise Unusable(*number_in(value, key.units))
    return number


def _percent(file: PartReader, value: Any, key: Key, place: tuple[Any, ...]) -> float:
    if isinstance(value, str) and value.rstrip().endswith("%"):
        value = 100.0 * _number(file, value, key._replace(units=("1",)), place)
    number = _number(file, value, key, place)
    ask(
        0.0 < number < SMALLEST_TOLERANCE,
        f"{file.file}: the tolerance of {place_text(place, file.data)} is {number:g} per cent.",
        f"expected per cent, got {number:g}, which looks like a fraction",
        f"tolerance = {100.0 * number:g} for ±{100.0 * number:g} %",
    )
    return number


def _list(file: PartReader, value: Any, key: Key, place: tuple[Any, ...]) -> list[float]:
    if not isinstance(value, list) or (key.size and len(value) != key.size):
        text = json.dumps(value[:60], ensure_ascii=False) if isinstance(value, str) else ""
        raise Unusable(
            f"a list of {key.size} numbers" if key.size else "a list of one number for each joint",
            f"[{', '.join([text] * (key.size or 1))}]" if text else "",
        )
    return [_number(file, entry, key, place) for entry in value]


def _quantity(file: PartReader, value: Any, key: Key, place: tuple[Any, ...]) -> dict[str, Any]:
    """``4.0`` or ``{value = 4.0, tolerance = 12, source = "data sheet"}``; a vector is ``[x, y, z]`` or the like.

    A range is stated instead of a tolerance where the interval is not symmetric: ``{value = 0.0, range = [0.0, 3.0]}``.
    """
    entry = Key(_list if key.size else _number, key.units, key.size, required=True)
    if not isinstance(value, dict):
        return {"value": entry.read(file, value, key, place), "source": "assumption"}
    ends = {} if key.size else {"range": Key(_list, key.units, 2)}
    return file.table(value, {"value": entry, **TOLERANCE, **ends}, place)


def _numbers(file: PartReader, value: Any, key: Key, place: tuple[Any, ...]) -> float | list[float]:
    return (_list if isinstance(value, list) else _number)(file, value, key, place)


def _named(file: PartReader, value: Any, key: Key, place: tuple[Any, ...]) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise Unusable("numbers by name", "")
    return {name: _numbers(file, entry, key, (*place, name)) for name, entry in value.items()}


def _table(file: PartReader, value: Any, key: Key, place: tuple[Any, ...]) -> dict[str, Any]:
    return file.table(value, TABLES[key.inside], place)


def _rows(file: PartReader, value: Any, key: Key, place: tuple[Any, ...]) -> list[dict[str, Any]]:
    if not isinstance(value, list) or (key.required and not value):
        raise Unusable(f"[[{key.inside}]] tables, one at least", "")
    return [_table(file, row, key, (*place, i)) for i, row in enumerate(value)]


_POSITION, _METRES = UNITS["link_position"], ("m",)
_EFFORT = tuple(dict.fromkeys(unit for drive in DRIVES.values() for unit in UNITS[drive]))
_POSITIVE = Key(_number, usable=lambda value: value > 0.0, expected="a number greater than 0")
_TEXT = Key(usable=lambda value: isinstance(value, str), expected="a text")
_PERCENT = Key(
    _percent, ("%",),
    usable=lambda value: 0.0 <= value < 100.0, expected="a number of at least 0 and less than 100 per cent",
)  # fmt: skip
TOLERANCE = {"tolerance": _PERCENT, "source": _TEXT._replace(default="assumption")}
_MASS, _CENTRE, _THREE = Key(_quantity, ("kg",)), Key(_quantity, _METRES, 3), Key(_list, _METRES, 3)
_INERTIA_TABLE = Key(_table, inside="inertia")
_TOLERANCES = Key(_table, inside="tolerances", default={})

#: Numbers of a motor, its gear and its friction; its constants say what its input is.
MOTOR = tuple(joint_field.name for joint_field in fields(ElasticJoint) if joint_field.name not in SPRING)

_OF_JOINT = {
    name: Key(_quantity, tuple(dict.fromkeys(QUANTITIES[name][:2])), required=name == "stiffness")
    for name in (*SPRING, *MOTOR)
}

#: What may stand in each table. The tolerances, in per cent, are those of numbers that state none themselves: of one
#: joint and its link, or of all. That of the inertia is one number for all moments of a link, so that what is drawn is
#: the inertia of a body; that of the motor inertia holds for a rotor inertia too.
TABLES: dict[str, dict[str, Key]] = {
    "": {
        "name": _TEXT._replace(default=""), "description": _TEXT._replace(default=""),
        "gravity": Key(_quantity, ("m/s²",)), "down": Key(_list, size=3), "home": Key(_list, _POSITION),
        "urdf": _TEXT, "mjcf": _TEXT, "joints": Key(
            usable=lambda value: isinstance(value, list) and all(isinstance(entry, str) for entry in value),
            expected="a list of names",
        ),
        "locked": Key(_named, _POSITION, default={}), "penalty": Key(_table, inside="penalty"),
        "tolerances": _TOLERANCES, "payload": Key(_rows, inside="payload", default=[]),
        "joint": Key(_rows, inside="joint", required=True),
    },
    "joint": {
        "name": _TEXT._replace(required=True),
        "kind": Key(usable=lambda value: value in KINDS, expected="'revolute', 'continuous' or 'prismatic'"),
        "axis": Key(_list, size=3), "xyz": _THREE,
        "rpy": Key(_list, ("rad",), 3), "limits": Key(_list, _POSITION, 2), "parent": _TEXT,
        "speed_limit": _POSITIVE._replace(units=UNITS["link_velocity"]),
        "effort_limit": _POSITIVE._replace(units=_EFFORT), "link": Key(_table, inside="link"),
        "rigid": Key(usable=lambda value: isinstance(value, bool), expected="true or false", default=False),
        "spring": Key(_table, inside="spring"), "motor": Key(_table, inside="motor", default={}),
        "tolerances": _TOLERANCES,
    },
    "link": {
        "mass": _MASS, "centre_of_mass": _CENTRE, "inertia": _INERTIA_TABLE,
        "axis_inertia": Key(_quantity, ("kg·m²",)), "length": Key(_quantity, _METRES),
    },
    "inertia": {
        axes: Key(_number, ("kg·m²",), required=axes[0] == axes[1], default=0.0)
        for axes in sorted(INERTIA, key=lambda axes: axes[0] != axes[1])
    } | TOLERANCE,
    "spring": {name: _OF_JOINT[name] for name in SPRING}, "motor": {name: _OF_JOINT[name] for name in MOTOR},
    "tolerances": {
        name: _PERCENT
        for name in ("mass", "centre_of_mass", "inertia", *_OF_JOINT)
        if name not in ("rotor_inertia", "hub_inertia", "gear_ratio", "friction_smoothing")
    },
    "payload": {
        "at": _TEXT, "mass": _MASS._replace(required=True), "centre_of_mass": _CENTRE, "inertia": _INERTIA_TABLE,
        "sphere": Key(_number, _METRES), "box": _THREE, "cylinder": Key(_list, _METRES, 2),
    },
    "penalty": {"weights": Key(_named, required=True), "effort": Key(_numbers, default=1.0)},
}  # fmt: skip


def is_table(value: Any) -> bool:
    """Whether a value is a table or a list of tables."""
    return isinstance(value, dict) or (isinstance(value, list) and any(isinstance(x, dict) for x in value))


def key_advice(key: str, keys: Mapping[str, Key], table: bool) -> str:
    """What to write for an unknown key: the table of a joint that has it, else the key that is most like it."""
    homes = {"joint": "[[joint]], below its name", **{x: f"[joint.{x}]" for x in ("link", "spring", "motor")}}
    found = [text for name, text in homes.items() if key in TABLES[name]]
    if found and not table:
        return f"{key} in {' or '.join(found)}"
    return nearest(key, keys, NESTING if table else "one of these keys")


def place_text(location: tuple[Any, ...], data: dict[str, Any]) -> str:
    """A place in the file as text: joint 2 ('elbow'), spring."""
    parts, value = [], data
    for part in location:
        try:
            value = value[part]  # type: ignore[assignment]
        except (KeyError, IndexError, TypeError):
            value = {}
        if isinstance(part, int):
            name = value.get("name") if isinstance(value, dict) else None
            parts[-1] += f" {part + 1}" + (f" ({name!r})" if name else "")
        else:
            parts.append(str(part))
    return ", ".join(parts) or "the file"
