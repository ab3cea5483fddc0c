"""URDF: the rigid part of a robot. Fixed and locked joints are merged into the links that carry them.

The elements of a URDF: which of them stand once, their attributes, and the bodies that they describe.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from flexhinf.errors import InvalidInput, located
from flexhinf.robot.dynamics import Joint, Placement, lumped, matrix_of, six_of
from flexhinf.robot.dynamics.tree import KINDS
from flexhinf.robot.parameters import INERTIA
from flexhinf.robot.parts import Link
from flexhinf.validation import HUGE, checked_name, distinct, nearest, read_xml, real_number, value_text

#: What may stand in an element, and only once, with what else a URDF has there.
ONCE = {
    "link": ("inertial",),
    "joint": ("origin", "parent", "child", "axis", "limit", "mimic"),
    "inertial": ("origin", "mass", "inertia"),
}
OTHERS = {"link": ("visual", "collision"), "joint": ("dynamics", "calibration", "safety_controller")}

#: Attributes of the elements that are read: the first ones are required, the others are not.
ATTRIBUTES = {
    "origin": ((), ("xyz", "rpy")),
    "mass": (("value",), ()),
    "inertia": (("ixx", "iyy", "izz"), ("ixy", "ixz", "iyz")),
    "axis": (("xyz",), ()),
    "parent": (("link",), ()),
    "child": (("link",), ()),
}

#: A number as XML writes it. Python's own takes 2_5 for 25, and digits of other scripts.
NUMBER = re.compile(r"[+-]?(?:[0-9]++\.?[0-9]*+|\.[0-9]++)(?:[eE][+-]?[0-9]++)?")


def check_element(file: str, name: str, element: Element) -> None:
    """Refuse what could be read in two ways in the link or the joint `name`, and what is probably misspelt."""
    once, where = ONCE[element.tag], "<inertial> of" if element.tag == "inertial" else f"the {element.tag}"
    for tag in once:
        count = len(element.findall(tag))
        if count > 1:
            raise InvalidInput(
                f"{file}: <{tag}> stands {count} times in {where} {name!r}.",
                f"expected one <{tag}>, got {count}",
                "delete the others",
            )
    known = (*once, *OTHERS.get(element.tag, ()))
    for tag in sorted({str(child.tag) for child in element} - set(known)):
        close = difflib.get_close_matches(tag[:60].lower(), known, n=1, cutoff=0.75)
        if close:
            raise InvalidInput(
                f"{file}: there is an unknown element <{tag[:60]}> in {name!r}.",
                f"expected one of {list(known)}, got {tag[:60]!r}",
                f"<{close[0]}>",
            )
    for child in element:
        if child.tag in ATTRIBUTES:
            _check_attributes(file, name, child)
        elif child.tag == "inertial":
            check_element(file, name, child)


def _check_attributes(file: str, name: str, element: Element) -> None:
    required, optional = ATTRIBUTES[element.tag]
    missing = [key for key in required if key not in element.attrib]
    unknown = [key for key in element.attrib if key not in (*required, *optional)]
    if missing or unknown:
        raise InvalidInput(
            f"{file}: <{element.tag}> in {name!r} has no {missing[0]!r}."
            if missing
            else f"{file}: <{element.tag}> in {name!r} has an unknown attribute {value_text(unknown[0], 60)}.",
            f"expected {' '.join([*required, *(f'[{key}]' for key in optional)])}, got "
            f"{value_text(list(element.attrib), 120)}",
            f"{missing[0]}='…'" if missing else "leave it out, or correct its name",
        )


# Numbers ------------------------------------------------------------------------------------------
def _vector(file: str, name: str, element: Element | None, key: str, default: tuple[float, ...]) -> Any:
    if element is None or element.get(key) is None:
        return default
    words = str(element.get(key)).split()
    numbers = tuple(float(word) for word in words) if all(map(NUMBER.fullmatch, words)) else ()
    if len(numbers) != len(default) or not all(abs(number) <= HUGE for number in numbers):
        raise InvalidInput(
            f"{file}: {key} of <{element.tag}> in {name!r} cannot be read.",
            f"expected {len(default)} numbers of at most {HUGE:g}, got {value_text(element.get(key))}",
            f"{key}='0 0 1'" if len(default) == 3 else f"{key}='1.0'",
        )
    return numbers


def _number(file: str, name: str, element: Element, key: str) -> float:
    return _vector(file, name, element, key, (0.0,))[0]


def origin_of(file: str, name: str, element: Element) -> Placement:
    """The place that <origin> states, the identity without one."""
    origin, nothing = element.find("origin"), (0.0, 0.0, 0.0)
    return Placement.of(*(_vector(file, name, origin, key, nothing) for key in ("xyz", "rpy")))


def axis_of(file: str, name: str, joint: Element) -> tuple[float, float, float]:
    """Direction of a joint's axis, not zero; x without one."""
    axis = _vector(file, name, joint.find("axis"), "xyz", (1.0, 0.0, 0.0))
    if not np.linalg.norm(axis) > 1.0 / HUGE:
        raise InvalidInput(
            f"{file}: the axis of the joint {name!r} has no direction.",
            f"expected a vector that is not zero, got {axis}",
            "xyz='0 0 1'",
        )
    return axis


def limits_of(file: str, name: str, joint: Element) -> tuple[float, float] | None:
    """Range of a joint, rad or m; None where there is none: also of lower = upper = 0, which exporters write then."""
    limit = joint.find("limit")
    if limit is None or joint.get("type") == "continuous":
        return None
    lower, upper = (_number(file, name, limit, key) for key in ("lower", "upper"))
    if lower == upper == 0.0:
        return None
    if not lower < upper:
        raise InvalidInput(
            f"{file}: the limits of the joint {name!r} leave no room.",
            f"expected lower < upper, got lower {lower:g} and upper {upper:g} (0 where not stated)",
            "exchange them; or a fixed joint",
        )
    return lower, upper


def largest_of(file: str, name: str, joint: Element, key: str) -> float:
    """The limit that <limit effort velocity> states, N·m, N, rad/s or m/s; infinite without one, and for 0, which
    exporters write then."""
    limit = joint.find("limit")
    stated = 0.0 if limit is None else _number(file, name, limit, key)
    if stated < 0.0:
        raise InvalidInput(
            f"{file}: the {key} limit of the joint {name!r} is negative.",
            f"expected {key} >= 0 (0 for none) in <limit>, got {stated:g}",
            f"{key}='{-stated:g}'",
        )
    return stated or np.inf


# Bodies -------------------------------------------------------------------------------------------
def body_of(
    file: str, link: str, element: Element, placement: Placement
) -> list[tuple[str, float, np.ndarray, np.ndarray]]:
    """A link's name, mass, centre of mass and inertia about it, in the carrier's frame; nothing without <inertial>."""
    inertial = element.find("inertial")
    if inertial is None:
        return []
    mass_element, six = inertial.find("mass"), inertial.find("inertia")
    mass = 0.0 if mass_element is None else _number(file, link, mass_element, "value")
    if six is None and mass_element is not None and mass == 0.0:
        return []
    if mass_element is None or six is None:
        raise InvalidInput(
            f"{file}: the <inertial> of the link {link!r} has no {'mass' if mass_element is None else 'inertia'}.",
            "expected <mass value=…/>, kg, and <inertia ixx=… iyy=… izz=…/> about the centre of mass",
            "the missing one; or no <inertial> for a link without mass",
        )
    about = matrix_of([_number(file, link, six, f"i{axes}") for axes in INERTIA])
    check_body(file, link, mass, about)
    place = placement.then(origin_of(file, link, inertial))
    turn = np.array(place.rotation)
    return [(link, mass, np.array(place.translation), turn @ about @ turn.T)]


def check_body(file: str, link: str, mass: float, inertia: np.ndarray) -> None:
    """Refuse what no body has, before it is merged with others; a body may be a point, or have no mass at all."""
    a, b, c = np.linalg.eigvalsh(inertia)
    slack = 1e-9 * max(abs(a), c)
    if mass < 0.0 or a < -slack:
        wrong = "a negative mass" if mass < 0.0 else "a negative inertia"
    elif a + b < c - slack:
        wrong = "an inertia that violates the triangle inequality"
    else:
        return
    raise InvalidInput(
        f"{file}: the link {link!r} has {wrong}: no such body exists.",
        "expected mass >= 0 and principal inertias >= 0 of which none exceeds the sum of the others, got "
        f"{mass:g} kg and ({a:.4g}, {b:.4g}, {c:.4g}) kg·m²",
        "the inertia about the centre of mass, in kg·m²",
    )


#: Most joints that move, and most links of a file: a humanoid with its hands has 70 joints and 150 links.
MOST_JOINTS, MOST_LINKS = 100, 1000


@dataclass(frozen=True)
class RigidArm:
    """What a URDF or an MJCF file says about dynamics.

    Attributes
    ----------
    joints : tuple of Joint
        That move, parents before children.
    links : tuple of Link
        One per joint, with everything that is fixed to it.
    movable : tuple of str
        All joints of the file that could move, the locked ones too.
    frames : dict
        Of each link behind a moving joint, and of that joint itself: the joint that carries it, and its place in the
        frame of that joint's link.
    tips : tuple of str
        Links that carry no other.
    efforts, speeds : tuple of float
        Largest torque (N·m) or force (N), and velocity (rad/s, m/s), of each joint; infinite where none is stated.
    motors : mapping
        Of each joint: numbers of its motor by their names in a robot file, seen from the link; of MJCF only.
    gravity, down : float, (3,), or None
        Free fall, m/s², and its direction; of MJCF only.
    """

    joints: tuple[Joint, ...]
    links: tuple[Link, ...]
    movable: tuple[str, ...]
    frames: dict[str, tuple[str, Placement]]
    tips: tuple[str, ...]
    efforts: tuple[float, ...]
    speeds: tuple[float, ...]
    motors: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    gravity: float | None = None
    down: tuple[float, float, float] | None = None


def read_urdf(
    path: str | Path, joints: Sequence[str] | None = None, locked: Mapping[str, float] | None = None
) -> RigidArm:
    """The moving joints of a URDF and their links. Meshes, transmissions and ``<dynamics>`` are not read.

    Parameters
    ----------
    joints : sequence of str, optional
        Joints that move; the others are locked. By default all that are not fixed.
    locked : mapping of str to float, optional
        Joints that do not move, and where they stand (rad or m); zero for those that `joints` leaves out.

    Raises
    ------
    InvalidInput
        For a file that is no URDF, joint names that are not in it, mimic joints that are not locked, kinds of
        joints that are not supported, and moving links without mass.
    """
    check_selection(joints, locked)
    path = Path(path)
    file = _File(path.name, _root(path))
    walk = _Walk(file, locked_joints(path.name, file.movable, joints, locked))
    walk.visit(file.base())
    if not 0 < len(walk.joints) <= MOST_JOINTS:
        raise InvalidInput(
            f"{path.name}: too many joints move." if walk.joints else f"{path.name}: nothing moves.",
            f"expected 1 to {MOST_JOINTS}, got {len(walk.joints)}; the file has {list(file.movable)}",
            "joints=[...]: the others are locked",
        )
    links = [merged(bodies, joint.name, path.name) for joint, bodies in zip(walk.joints, walk.bodies)]
    efforts, speeds = (
        tuple(largest_of(path.name, j.name, file.joints[j.name], key) for j in walk.joints)
        for key in ("effort", "velocity")
    )
    return RigidArm(
        tuple(walk.joints), tuple(links), file.movable, walk.frames, tuple(walk.tips), efforts, speeds
    )


def _root(path: Path) -> ElementTree.Element:
    root = read_xml(path)
    if root.tag != "robot":
        raise InvalidInput(
            f"{path.name}: this is no URDF.",
            f"expected the root element <robot>, got <{root.tag[:60]}>",
            "arm.xml with the root <mujoco> is read as MJCF; convert other files to URDF first",
        )
    if any("xacro" in element.tag for element in root.iter()):
        raise InvalidInput(
            f"{path.name}: this is a xacro file.",
            "expected plain URDF, got elements of xacro",
            "xacro arm.xacro > arm.urdf",
        )
    return root


class _File:
    """The elements of a URDF by name."""

    def __init__(self, name: str, root: ElementTree.Element) -> None:
        self.name = name
        self.links = self._named(root, "link")
        self.joints = self._named(root, "joint")
        for one, element in (*self.links.items(), *self.joints.items()):
            check_element(name, one, element)
        self.children: dict[str, list[str]] = {}
        for joint, element in self.joints.items():
            for end in ("parent", "child"):
                if self.end(element, end) not in self.links:
                    raise InvalidInput(
                        f"{name}: the joint {joint!r} has no {end} link.",
                        f"expected one of {list(self.links)}, got {self.end(element, end)!r}",
                        f"<{end} link='…'/>",
                    )
            self.children.setdefault(self.end(element, "parent"), []).append(joint)

    def _named(self, root: ElementTree.Element, tag: str) -> dict[str, ElementTree.Element]:
        """Elements by their names, which are usable and stand once."""
        found = root.findall(tag)
        if len(found) > MOST_LINKS:
            raise InvalidInput(
                f"{self.name}: there are too many {tag}s.",
                f"expected at most {MOST_LINKS}, got {len(found)}",
                "one robot",
            )
        names = [checked_name(f"a {tag} of {self.name}", one.get("name"), spaces=True) for one in found]
        distinct(f"{self.name}: the {tag}", names)
        return dict(zip(names, found))

    @staticmethod
    def end(joint: ElementTree.Element, which: str) -> str:
        """Name of the link at one end of a joint."""
        found = joint.find(which)
        return "" if found is None else found.get("link", "")

    @property
    def movable(self) -> tuple[str, ...]:
        """Joints that are not fixed."""
        return tuple(name for name, joint in self.joints.items() if joint.get("type") != "fixed")

    def base(self) -> str:
        """The link that no joint carries."""
        carried = [self.end(joint, "child") for joint in self.joints.values()]
        free = [link for link in self.links if link not in carried]
        reached, ahead = set[str](), list(free)
        while ahead:
            link = ahead.pop()
            if link not in reached:
                reached.add(link)
                ahead += [self.end(self.joints[joint], "child") for joint in self.children.get(link, [])]
        if len(free) != 1 or len(set(carried)) != len(carried) or len(reached) != len(self.links):
            raise InvalidInput(
                f"{self.name}: the links are no tree.",
                "expected one link without a parent and one parent for every other, got the links without a parent "
                f"{free}, and in loops {[link for link in self.links if link not in reached]}",
                "a closed loop is cut, a second robot goes into a file of its own",
            )
        return free[0]


@dataclass
class _Walk:
    """From the base outwards: the moving joints, and the bodies that each carries, in its frame."""

    file: _File
    locked: Mapping[str, float]
    joints: list[Joint] = field(default_factory=list)
    bodies: list[list[Any]] = field(default_factory=list)
    frames: dict[str, tuple[str, Placement]] = field(default_factory=dict)
    tips: list[str] = field(default_factory=list)

    def visit(self, base: str) -> None:
        """The tree from its base on, each link before those behind it, without recursion: chains may be long."""
        ahead = [(name, None, Placement()) for name in reversed(self.file.children.get(base, []))]
        while ahead:
            name, carrier, placement = ahead.pop()
            carrier, placement = self.cross(name, carrier, placement)
            link = self.file.end(self.file.joints[name], "child")
            if carrier is not None:
                self.bodies[carrier] += body_of(self.file.name, link, self.file.links[link], placement)
                self.frames[link] = place = self.joints[carrier].name, placement
                self.frames.setdefault(name, place)
                if link not in self.file.children:
                    self.tips.append(link)
            ahead += [(after, carrier, placement) for after in reversed(self.file.children.get(link, []))]

    def cross(self, name: str, carrier: int | None, placement: Placement) -> tuple[int | None, Placement]:
        """The joint that carries the link behind `name` (None: the world), and where the link is in its frame."""
        element = self.file.joints[name]
        kind = element.get("type")
        place = placement.then(origin_of(self.file.name, name, element))
        if kind == "fixed":
            return carrier, place
        if kind not in KINDS:
            raise InvalidInput(
                f"{self.file.name}: the joint {name!r} is of kind {value_text(kind, 60)}.",
                f"expected fixed or one of {list(KINDS)}",
                "a robot on a fixed base with joints of one degree of freedom",
            )
        axis = axis_of(self.file.name, name, element)
        if name in self.locked:
            value = float(self.locked[name])
            check_lock(self.file.name, name, limits_of(self.file.name, name, element), value)
            return carrier, place.then(moved(kind, axis, value))
        if element.find("mimic") is not None:
            raise InvalidInput(
                f"{self.file.name}: the joint {name!r} mimics another one, which an elastic joint cannot.",
                f"expected independent joints, got <mimic> in {name!r}",
                f"locked={{{name!r}: 0.0}}, or joints=[...] without it",
            )
        above = "world" if carrier is None else self.joints[carrier].name
        self.joints.append(Joint(name, kind, axis, place, limits_of(self.file.name, name, element), above))
        self.bodies.append([])
        return len(self.joints) - 1, Placement()


def locked_joints(
    file: str, movable: Sequence[str], joints: Sequence[str] | None, locked: Mapping[str, float] | None
) -> dict[str, float]:
    """Joints of a URDF or an MJCF file that do not move, and where they stand, rad or m.

    Parameters
    ----------
    file : str
        Its name, for messages.
    movable : sequence of str
        Joints that are not fixed.
    joints, locked
        As for `read_urdf`, checked by `check_selection`.

    Raises
    ------
    InvalidInput
        For a name that is none of `movable`, and a joint that is chosen and locked.
    """
    still = dict(locked or {})
    for name in (*(joints or ()), *still):
        if name not in movable:
            raise InvalidInput(
                f"{file}: there is no joint {value_text(name, 60)} that could move.",
                f"expected one of {list(movable)}",
                nearest(name, movable),
            )
    if joints is None:
        return still
    both = [name for name in joints if name in still]
    if both:
        raise InvalidInput(
            f"{file}: the joint {both[0]!r} is both chosen and locked.", f"got {both}", "one of the two"
        )
    return still | {name: 0.0 for name in movable if name not in joints and name not in still}


def check_lock(file: str, name: str, limits: tuple[float, float] | None, value: float) -> None:
    """Refuse a joint that is locked outside its limits, rad or m."""
    if limits is not None and not limits[0] <= value <= limits[1]:
        raise InvalidInput(
            f"{file}: the joint {name!r} is locked outside its limits.",
            f"expected {limits[0]:g} to {limits[1]:g}, got {value:g}",
            "a position that the joint can have",
        )


def check_selection(joints: Any, locked: Any) -> None:
    """Refuse what does not say which joints move, and where the others stand."""
    listed = isinstance(joints, Sequence) and not isinstance(joints, (str, bytes))
    if joints is not None and not (listed and all(isinstance(name, str) for name in joints)):
        raise InvalidInput(
            "The joints that move are not named.",
            f"expected a list of names, got joints={value_text(joints, 60)}",
            "joints=['shoulder', 'elbow']",
        )
    distinct("joints: the joint", list(joints or ()))
    mapped = isinstance(locked, Mapping) and all(isinstance(name, str) for name in locked)
    if locked is not None and not mapped:
        raise InvalidInput(
            "The joints that are locked are not named.",
            f"expected names and positions, got locked={value_text(locked, 60)}",
            "locked={'elbow': 0.0}",
        )
    for name, value in (locked or {}).items():
        if not abs(real_number(value)) <= HUGE:
            raise InvalidInput(
                f"The joint {value_text(name, 60)} is locked at no position.",
                f"expected a finite number in rad or m, got {value_text(value, 60)}",
                "0.0",
            )


def moved(kind: str, axis: Sequence[float], value: float) -> Placement:
    """The place of a joint's link at its position, rad (by Rodrigues' formula) or m."""
    unit = np.array(axis) / np.linalg.norm(axis)
    if kind == "prismatic":
        return Placement(translation=tuple((value * unit).tolist()))
    x, y, z = unit
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    rotation = np.eye(3) + math.sin(value) * cross + (1.0 - math.cos(value)) * cross @ cross
    return Placement(tuple(map(tuple, rotation.tolist())))


def merged(bodies: list[Any], joint: str, file: str, element: str = "<inertial>") -> Link:
    """Several bodies that move together as one link."""
    mass = sum(body[1] for body in bodies)
    if not mass > 0.0:
        raise InvalidInput(
            f"{file}: what the joint {joint!r} moves has no mass.",
            f"expected {element} in the link behind it, got {mass:g} kg",
            "a file with inertials (some are made for display only), or lock the joint",
        )
    mass, centre, inertia = lumped([body[1:] for body in bodies])
    with located(f"{file}: link {[body[0] for body in bodies]}"):
        return Link(mass, [float(c) for c in centre], six_of(inertia))
