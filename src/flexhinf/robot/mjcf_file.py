"""What stands in an MJCF file outside of its bodies: units, default classes, gravity, actuators and couplings.

The elements of an MJCF file that say where things are and how heavy they are, with MuJoCo's defaults and units.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.robot.dynamics import Placement, matrix_of
from flexhinf.robot.urdf import NUMBER, check_body
from flexhinf.untrusted import HUGE, checked_name, distinct, value_text

#: Where an element is and how it is turned.
TURNS = ("quat", "axisangle", "euler", "xyaxes", "zaxis")

#: What may stand in the elements that are read, so that a misspelt name is not a default.
ATTRIBUTES = {
    "body": {"name", "childclass", "pos", *TURNS, "mocap", "gravcomp", "user", "sleep"},
    "frame": {"name", "childclass", "pos", *TURNS},
    "inertial": {"pos", *TURNS, "mass", "diaginertia", "fullinertia"},
    "joint": {
        "name", "class", "type", "group", "pos", "axis", "springdamper", "solreflimit", "solimplimit",
        "solreffriction", "solimpfriction", "stiffness", "range", "limited", "actuatorfrcrange",
        "actuatorfrclimited", "actuatorgravcomp", "margin", "ref", "springref", "armature", "damping",
        "frictionloss", "user",
    },
}  # fmt: skip

#: Density of a geom that states none, kg/m³.
DENSITY = 1000.0

#: Smallest size of a shape, and inverse of the largest, m.
SMALLEST = 1e-9

#: Shapes whose mass is computed, and how many of MuJoCo's (half) sizes each has.
SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2, "ellipsoid": 3, "box": 3}


@dataclass(frozen=True)
class Compiler:
    """What <compiler> says about units.

    Attributes
    ----------
    degrees : bool
        Whether angles are degrees; they are unless the file says radian.
    euler : str
        Axes of Euler angles, small letters moving with the body, capitals fixed.
    inertia_from_geom : {"auto", "true", "false"}
        Whether masses come from shapes: auto where a body states none.
    limited : bool
        Whether a range alone is a limit.
    """

    degrees: bool = True
    euler: str = "xyz"
    inertia_from_geom: str = "auto"
    limited: bool = True

    def angle(self, value: float) -> float:
        """An angle of the file in rad."""
        return math.radians(value) if self.degrees else value


def numbers(file: str, where: str, values: Mapping[str, str], key: str, counts: Sequence[int]) -> Any:
    """The numbers of an attribute, (count,), or None where it is not stated.

    Raises
    ------
    InvalidInput
        For another count, or what is no finite number.
    """
    text = values.get(key)
    if text is None:
        return None
    words = text.split(None, max(counts))  # of more numbers, none is looked at
    read = len(words) in counts and all(map(NUMBER.fullmatch, words))
    found = np.array([float(word) for word in words]) if read else np.array([])
    if len(found) not in counts or not np.all(np.abs(found) <= HUGE):
        raise InvalidInput(
            f"{file}: {key} of {where} cannot be read.",
            f"expected {' or '.join(map(str, counts))} numbers of at most {HUGE:g}, got {value_text(text, 60)}",
            f'{key}="{" ".join(["1", *["0"] * (counts[0] - 1)])}"',
        )
    return found


def check_attributes(file: str, where: str, tag: str, values: Mapping[str, str]) -> None:
    """Refuse attributes that MuJoCo does not know.

    Raises
    ------
    InvalidInput
        With the attribute.
    """
    unknown = sorted(set(values) - ATTRIBUTES[tag])
    if unknown:
        raise InvalidInput(
            f"{file}: {where} has an unknown attribute {value_text(unknown[0], 60)}.",
            f"expected attributes out of {sorted(ATTRIBUTES[tag])}, got {value_text(sorted(values), 120)}",
            "leave it out, or correct its name",
        )


# Places -------------------------------------------------------------------------------------------
def place_of(file: str, where: str, values: Mapping[str, str], compiler: Compiler) -> Placement:
    """Where an element is in the frame that holds it.

    Raises
    ------
    InvalidInput
        For an orientation that is stated twice, or is none.
    """
    stated = [key for key in TURNS if key in values]
    if len(stated) > 1:
        raise InvalidInput(f"{file}: {where} is turned twice.", f"got {stated}", "one of them")
    position = numbers(file, where, values, "pos", (3,))
    place = (0.0, 0.0, 0.0) if position is None else tuple(position.tolist())
    if not stated:
        return Placement(translation=place)  # type: ignore[arg-type]
    turn = _turn(file, where, values, stated[0], compiler)
    rows = tuple(tuple(float(x) for x in row) for row in turn)
    return Placement(translation=place).then(Placement(rows))  # type: ignore[arg-type]


def _turn(file: str, where: str, values: Mapping[str, str], key: str, compiler: Compiler) -> np.ndarray:
    """Rotation matrix of the orientation that `key` states."""
    count = {"quat": 4, "axisangle": 4, "euler": 3, "xyaxes": 6, "zaxis": 3}[key]
    v = numbers(file, where, values, key, (count,))
    if key == "euler":
        turn = np.eye(3)
        for letter, value in zip(compiler.euler, v):
            own = rotation(np.eye(3)["xyz".index(letter.lower())], compiler.angle(value))
            turn = turn @ own if letter.islower() else own @ turn
        return turn
    axis = {"quat": v, "axisangle": v[:3], "xyaxes": v[:3], "zaxis": v}[key]
    if not np.linalg.norm(axis) > 1e-12:
        raise InvalidInput(
            f"{file}: {key} of {where} is no orientation.", f"got {value_text(values[key], 60)}", "1 0 0 0"
        )
    if key == "quat":
        w, x, y, z = v / np.linalg.norm(v)
        return rotation(np.array([x, y, z]), 2.0 * math.atan2(math.hypot(x, y, z), w))
    if key == "axisangle":
        return rotation(axis, compiler.angle(v[3]))
    if key == "zaxis":
        z = v / np.linalg.norm(v)
        across = np.array([-z[1], z[0], 0.0])
        return rotation(
            across if np.linalg.norm(across) > 0.0 else np.eye(3)[0], math.atan2(math.hypot(z[0], z[1]), z[2])
        )
    x = v[:3] / np.linalg.norm(v[:3])
    y = v[3:] - (x @ v[3:]) * x
    if not np.linalg.norm(y) > 1e-12:
        raise InvalidInput(
            f"{file}: xyaxes of {where} are parallel.", f"got {value_text(values[key], 60)}", "1 0 0 0 1 0"
        )
    y = y / np.linalg.norm(y)
    return np.column_stack([x, y, np.cross(x, y)])


def rotation(axis: np.ndarray, angle: float) -> np.ndarray:
    """Rodrigues' formula; the axis need not be a unit vector."""
    length = float(np.linalg.norm(axis))
    if length == 0.0:
        return np.eye(3)
    x, y, z = axis / length
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross


# Bodies -------------------------------------------------------------------------------------------
def inertial_body(
    file: str, where: str, values: Mapping[str, str], compiler: Compiler
) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, centre and inertia about it, in the body's frame, of <inertial>.

    Raises
    ------
    InvalidInput
        For what is missing, stated twice, or no body.
    """
    check_attributes(file, where, "inertial", values)
    mass = numbers(file, where, values, "mass", (1,))
    diagonal = numbers(file, where, values, "diaginertia", (3,))
    full = numbers(file, where, values, "fullinertia", (6,))
    if mass is None or (diagonal is None) == (full is None) or "pos" not in values:
        raise InvalidInput(
            f"{file}: {where} is incomplete.",
            f"expected pos, mass, and diaginertia or fullinertia, got {value_text(sorted(values), 120)}",
            '<inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>',
        )
    if full is None:
        about = np.diag(diagonal)
    else:
        xx, yy, zz, xy, xz, yz = full
        about = matrix_of([xx, xy, xz, yy, yz, zz])
    check_body(file, where, float(mass[0]), about)
    place = place_of(file, where, values, compiler)
    turn = np.array(place.rotation)
    return float(mass[0]), np.array(place.translation), turn @ about @ turn.T


def geom_body(
    file: str, where: str, values: Mapping[str, str], compiler: Compiler
) -> tuple[float, np.ndarray, np.ndarray] | None:
    """The same of a <geom>, uniform; None for one without mass.

    Raises
    ------
    InvalidInput
        For shapes whose mass is not computed here.
    """
    kind = values.get("type", "mesh" if "mesh" in values else "sphere")
    mass = numbers(file, where, values, "mass", (1,))
    density = numbers(file, where, values, "density", (1,))
    weight = float(mass[0]) if mass is not None else None
    heavy = DENSITY if density is None else float(density[0])
    if kind == "plane" or weight == 0.0 or (weight is None and heavy == 0.0):
        return None
    shell, spanned = values.get("shellinertia", "false") != "false", kind == "sphere" and "fromto" in values
    if kind not in SIZES or shell or spanned or "mesh" in values:
        raise InvalidInput(
            f"{file}: the mass of {where} would have to come from its shape.",
            f"expected <inertial> in its body, or a solid {', '.join(SIZES)}, got type {value_text(kind, 40)}",
            'an <inertial> with mass and inertia; mass="0" for a shape that is only drawn',
        )
    sizes = numbers(file, where, values, "size", (1, 2, 3))
    ends = numbers(file, where, values, "fromto", (6,))
    if ends is not None:
        along = ends[3:] - ends[:3]
        half = 0.5 * float(np.linalg.norm(along))
        values = {
            **{key: value for key, value in values.items() if key not in TURNS},
            "pos": _text(0.5 * (ends[:3] + ends[3:])), "zaxis": _text(-along),
        }  # fmt: skip
        sizes = None if sizes is None else _sizes_of(kind, sizes, half)
    needed = () if sizes is None else sizes[: SIZES[kind]]
    if len(needed) < SIZES[kind] or not all(SMALLEST < size < 1.0 / SMALLEST for size in needed):
        raise InvalidInput(
            f"{file}: {where} has no size.",
            f"expected {SIZES[kind]} positive numbers for a {kind}, got {value_text(values.get('size'), 60)}",
            'size="0.05"',
        )
    volume, moments = _uniform(kind, *needed)
    total = volume * heavy if weight is None else weight
    place = place_of(file, where, values, compiler)
    check_body(file, where, total, np.diag(total * moments))
    turn = np.array(place.rotation)
    return total, np.array(place.translation), turn @ np.diag(total * moments) @ turn.T


def _text(vector: np.ndarray) -> str:
    return " ".join(repr(float(x)) for x in vector)


def _sizes_of(kind: str, sizes: np.ndarray, half: float) -> np.ndarray:
    """Sizes of a shape between two points: its radius, or half widths, and half its length."""
    return np.array([sizes[0], half] if SIZES[kind] == 2 else [sizes[0], sizes[0], half])


def _uniform(kind: str, *sizes: float) -> tuple[float, np.ndarray]:
    """Volume, m³, and principal moments over mass, m²."""
    if kind == "capsule":
        r, h = sizes[0], 2.0 * sizes[1]
        ball, tube = 4.0 / 3.0 * np.pi * r**3, np.pi * r**2 * h
        whole = ball + tube
        across = tube * (r**2 / 4 + h**2 / 12) + ball * (0.4 * r**2 + h**2 / 4 + 3.0 / 8.0 * h * r)
        along = tube * r**2 / 2 + ball * 0.4 * r**2
        return whole, np.array([across, across, along]) / whole
    if kind == "cylinder":
        r, h = sizes[0], 2.0 * sizes[1]
        across = r**2 / 4 + h**2 / 12
        return np.pi * r**2 * h, np.array([across, across, r**2 / 2])
    a, b, c = sizes * 3 if kind == "sphere" else sizes
    spread = np.array([b * b + c * c, a * a + c * c, a * a + b * b])
    if kind == "box":
        return 8.0 * a * b * c, spread / 3.0
    return 4.0 / 3.0 * np.pi * a * b * c, spread / 5.0


#: Attributes of <compiler> that change masses after the file is read.
CHANGED = {"boundmass": "0", "boundinertia": "0", "settotalmass": "-1", "balanceinertia": "false"}


class MjcfFile:
    """The parts of a file that its bodies refer to.

    Parameters
    ----------
    name : str
        Of the file, for messages.
    root : Element
        <mujoco>.

    Raises
    ------
    InvalidInput
        For units and masses that are not read.
    """

    def __init__(self, name: str, root: Element) -> None:
        self.name, self.root = name, root
        self.compiler = self._compiler()
        self._classes: dict[str, dict[str, dict[str, str]]] = {}
        self._main = "main"
        for default in root.findall("default"):
            self._main = default.get("class", "main")
            self._read_class(default, self._classes.get(self._main, {}), self._main)

    # Units ------------------------------------------------------------------------------------------
    def _compiler(self) -> Compiler:
        values: dict[str, str] = {}
        for element in self.root.findall("compiler"):
            values |= element.attrib
        for key, usual in CHANGED.items():
            if key in values and values[key] != usual and real_text(values[key]) != real_text(usual):
                raise self._refusal(
                    f"<compiler {key}> is not read",
                    f"it changes masses: {values[key]}",
                    "inertials as they are",
                )
        euler = values.get("eulerseq", "xyz")
        if len(euler) != 3 or set(euler.lower()) - set("xyz"):
            raise self._refusal("eulerseq cannot be read", f"got {value_text(euler, 40)}", 'eulerseq="xyz"')
        for key, known in (
            ("angle", ("degree", "radian")),
            ("inertiafromgeom", ("auto", "true", "false")),
            ("autolimits", ("true", "false")),
            ("coordinate", ("local",)),
        ):
            if values.get(key, known[0]) not in known:
                raise self._refusal(
                    f"{key} cannot be read", f"expected {known}, got {value_text(values[key], 40)}", known[0]
                )
        return Compiler(
            values.get("angle", "degree") == "degree", euler,
            values.get("inertiafromgeom", "auto"), values.get("autolimits", "true") == "true",
        )  # fmt: skip

    def _refusal(self, what: str, found: str, advice: str) -> InvalidInput:
        return InvalidInput(f"{self.name}: {what}.", found, advice)

    def gravity(self) -> tuple[float, tuple[float, float, float]]:
        """Strength, m/s², and direction of free fall."""
        vector, air = np.array([0.0, 0.0, -9.81]), 0.0
        for option in self.root.findall("option"):
            stated = numbers(self.name, "<option>", option.attrib, "gravity", (3,))
            vector = vector if stated is None else stated
            if any(flag.get("gravity", "enable") == "disable" for flag in option.findall("flag")):
                vector = np.zeros(3)
            for key in ("density", "viscosity"):
                air = max(air, real_text(option.get(key, "0")))
        if not air == 0.0:
            raise self._refusal("<option> has a medium", "expected density and viscosity 0", "a robot in air")
        size = float(np.linalg.norm(vector))
        x, y, z = (vector / size if size else np.array([0.0, 0.0, -1.0])).tolist()
        return size, (x, y, z)

    # Defaults ---------------------------------------------------------------------------------------
    def _read_class(self, element: Element, above: Mapping[str, dict[str, str]], name: str) -> None:
        own = {tag: dict(values) for tag, values in above.items()}
        for child in element:
            if child.tag != "default":
                own.setdefault(child.tag, {}).update(child.attrib)
        self._classes[name] = own
        for child in element.findall("default"):
            if child.get("class") is None:
                raise self._refusal(
                    "a default class inside another has no name", "got <default>", "class='…'"
                )
            if child.get("class") in self._classes:
                raise self._refusal(
                    f"the default class {value_text(child.get('class'), 60)} stands there twice",
                    "expected distinct names, as MuJoCo does",
                    "another name, or one of the two",
                )
            self._read_class(child, own, child.get("class", ""))

    def childclass(self, element: Element, inherited: str | None) -> str | None:
        """The class of what an element holds."""
        return element.get("childclass", inherited)

    def values(self, element: Element, inherited: str | None) -> dict[str, str]:
        """Attributes of an element over those of its class."""
        name = element.get("class", inherited or self._main)
        if name not in self._classes and name != self._main:
            raise self._refusal(
                f"there is no default class {value_text(name, 60)}",
                f"expected one of {sorted(self._classes)}"
                if self._classes
                else "expected none: there are no classes",
                "one of these" if self._classes else "leave out class and childclass",
            )
        values = {**self._classes.get(name, {}).get(str(element.tag), {}), **element.attrib}
        values.pop("class", None)
        return values

    # Joints -----------------------------------------------------------------------------------------
    def joint_names(self) -> list[str]:
        """Of all joints of all bodies, in the order of the file."""
        found = [joint for world in self.root.findall("worldbody") for joint in world.iter("joint")]
        names = [checked_name(f"a joint of {self.name}", joint.get("name"), spaces=True) for joint in found]
        distinct(f"{self.name}: the joint", names)
        self._check_bodies()
        return names

    def _check_bodies(self) -> None:
        """Names of bodies can be shown and stand once: a payload hangs on one. The world itself has no joint."""
        bodies = [
            body.get("name", "") for world in self.root.findall("worldbody") for body in world.iter("body")
        ]
        named = [checked_name(f"a body of {self.name}", name, spaces=True) for name in bodies if name]
        distinct(f"{self.name}: the body", named)
        if any(world.find("joint") is not None for world in self.root.findall("worldbody")):
            raise self._refusal("<worldbody> has a joint", "expected joints in bodies", "a <body> around it")

    def range(self, where: str, values: Mapping[str, str], key: str, limited: str) -> np.ndarray | None:
        """A range that acts, (2,), or None: it is not stated, switched off, or 0 0 and not switched on.

        Parameters
        ----------
        where, values
            As for `numbers`.
        key, limited : str
            Names of the range, and of the attribute that switches it: true, false or auto.

        Raises
        ------
        InvalidInput
            For ends in the wrong order, and another word.
        """
        stated, switch = numbers(self.name, where, values, key, (2,)), values.get(limited, "auto")
        if switch not in ("true", "false", "auto"):
            raise self._refusal(
                f"{limited} of {where} cannot be read", f"got {value_text(switch, 40)}", "true, false or auto"
            )
        if switch == "false" or (switch == "auto" and (stated is None or not self.compiler.limited)):
            return None
        ends = np.zeros(2) if stated is None else stated
        if switch == "auto" and not ends.any():
            return None
        if not ends[0] < ends[1]:
            raise self._refusal(
                f"{key} of {where} is none",
                f"expected two ends in order, got {ends.tolist()}",
                f'{key}="-1 1"',
            )
        return ends

    def check_couplings(self, moving: set[str]) -> None:
        """Refuse constraints and elastic tendons of joints that move."""
        for group in self.root.findall("equality"):
            for element in group:
                names = {element.get("joint1"), element.get("joint2")}
                locked = element.tag == "joint" and not names & moving
                if not locked and element.get("active", "true") != "false":
                    raise self._refusal(
                        f"<equality> {element.tag} {value_text(element.get('name', ''), 60)} couples what moves",
                        "expected a tree of independent joints",
                        "lock the joints that it couples: locked={'finger': 0.0}",
                    )
        for group in self.root.findall("tendon"):
            for element in group:
                values = self.values(element, None)
                acting = [
                    key
                    for key in ("stiffness", "damping", "frictionloss", "armature")
                    if any(real_text(word) != 0.0 for word in values.get(key, "").split())
                ]
                coupled = {part.get("joint") for part in element}
                if acting and (element.tag != "fixed" or coupled & moving):
                    raise self._refusal(
                        f"a tendon has {acting[0]}", "expected joints that are coupled by links alone",
                        "the robot without it",
                    )  # fmt: skip

    def effort(self, joint: str) -> float:
        """Largest torque or force of the actuators of a joint; infinite where one of them has no limit, or none."""
        total, any_found = 0.0, False
        for group in self.root.findall("actuator"):
            for element in group:
                if element.get("joint") != joint:
                    continue
                values, where = self.values(element, None), f"the actuator of {joint!r}"
                gear = numbers(self.name, where, values, "gear", (1, 2, 3, 4, 5, 6))
                force = self.range(where, values, "forcerange", "forcelimited")
                if force is None and element.tag == "motor":
                    force = self.range(where, values, "ctrlrange", "ctrllimited")
                if force is None:
                    return np.inf
                any_found = True
                total += float(np.abs(force).max() * abs(1.0 if gear is None else gear[0]))
        return total if any_found and total > 0.0 else np.inf


def real_text(text: str) -> float:
    """A number, NaN for another text."""
    try:
        return float(text)
    except ValueError:
        return float("nan")
