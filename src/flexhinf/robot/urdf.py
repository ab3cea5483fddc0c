"""URDF: the rigid part of a robot. Fixed and locked joints are merged into the links that carry them."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from flexhinf.errors import InvalidInput, located, refuse_if
from flexhinf.robot.arm import Frame
from flexhinf.robot.dynamics import KINDS, ZERO, Joint, Placement, lumped, matrix_of, six_of
from flexhinf.robot.parameters import INERTIA
from flexhinf.robot.parts import Link, ask
from flexhinf.validation import (
    HUGE,
    checked_name,
    distinct,
    one_of,
    real_number,
    value_text,
)

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

#: An inertia of less than this radius of gyration, m², squared is none; and what an inertia may lack of its largest
#: component to be taken as the nearest one that a body has, as rounded data sheets do.
NO_SIZE, NEARLY = 1e-12, 0.05

#: N·m, N, rad/s or m/s that no motor of a robot has: a placeholder.
NO_MOTOR = 1e9

#: Limits beyond which a joint has none: exporters write ±1e16 then.
NO_LIMIT = 1e4

#: Free fall where a file states none, m/s².
GRAVITY = 9.81

#: Most joints that move, and most links of a file: a humanoid with its hands has 70 joints and 150 links.
MOST_JOINTS, MOST_LINKS = 100, 1000


@dataclass
class RigidArm:
    """What a URDF or an MJCF file says about dynamics; it grows joint by joint, parents before children.

    Attributes
    ----------
    movable
        All joints of the file that could move, the locked ones too.
    locked
        Joints that do not move, and where they stand, rad or m. One that nobody placed stands at 0, or at the nearer
        limit.
    joints, links
        That move; one link per joint, of the bodies that are fixed to it.
    frames
        Of each link behind a moving joint, and of that joint itself: the joint that carries it, and its place in the
        frame of that joint's link.
    tips
        Links that carry no other.
    efforts, speeds
        Largest torque (N·m) or force (N), and velocity (rad/s, m/s), of each joint; infinite where none is stated.
    motors
        Of each joint: numbers of its motor by their names in a robot file, seen from the link.
    gravity, down
        Of MJCF only: free fall, m/s², and its direction (3,).
    """

    movable: tuple[str, ...]
    locked: Mapping[str, float | None]
    joints: list[Joint] = field(default_factory=list)
    links: list[Link] = field(default_factory=list)
    frames: dict[str, Frame] = field(default_factory=dict)
    tips: list[str] = field(default_factory=list)
    efforts: list[float] = field(default_factory=list)
    speeds: list[float] = field(default_factory=list)
    motors: dict[str, dict[str, float]] = field(default_factory=dict)
    gravity: float = GRAVITY
    down: tuple[float, float, float] | None = None
    _bodies: list[list[Any]] = field(default_factory=list)
    _doubtful: dict[str, str] = field(
        default_factory=dict
    )  # of links whose inertia is no body's: what is wrong
    _hopeless: bool = False  # whether one of them is no body's by far

    def add_joint(
        self, carrier: int | None, name: str, kind: str, axis: Any, place: Placement, limits: Any
    ) -> tuple[int | None, Placement]:
        """Add a joint at `place`; return the moving joint that carries what is behind it, and its place on that link.

        A joint that is locked outside its limits, rad or m, is refused.
        """
        if name in self.locked:
            stated = self.locked[name]
            low, high = limits or (0.0, 0.0)
            value = min(max(0.0, low), high) if stated is None else float(stated)
            if limits is not None and not limits[0] <= value <= limits[1]:
                raise InvalidInput(
                    f"The joint {name!r} is locked outside its limits.",
                    f"expected {limits[0]:g} to {limits[1]:g}, got {value:g}",
                    "a position that the joint can have",
                )
            return carrier, place.then(moved(kind, axis, value))
        self.joints.append(
            Joint(name, kind, axis, place, limits, "world" if carrier is None else self.joints[carrier].name)
        )
        self._bodies.append([])
        return len(self.joints) - 1, Placement()

    def add_body(self, carrier: int, link: str, mass: float, inertia: np.ndarray, place: Placement) -> None:
        """Add a body with its centre of mass at `place` and inertia (3, 3) there; it may be a point, or massless."""
        (a, b, c), axes = np.linalg.eigh(inertia)
        size, floor = max(abs(a), c), NO_SIZE * mass
        refuse_if(
            mass < 0.0,
            f"The link {link!r} has a negative mass: no such body exists.",
            f"expected mass >= 0, got {mass:g} kg",
            "its mass, in kg",
        )
        # Second moments along the principal axes, which no body has below zero.
        moments = (a + b + c) / 2.0 - np.array([a, b, c])
        short = -min(float(moments.min()), a)
        if short > max(1e-9 * size, floor):
            fault = "a negative inertia" if a < 0.0 else "none that keeps the triangle inequality"
            self._doubtful[link] = f"{link!r} has {fault}: ({a:.4g}, {b:.4g}, {c:.4g}) kg·m²"
            self._hopeless |= short > NEARLY * size
        if min(float(moments.min()), a) < 0.0:
            moments = np.maximum(moments, 0.0)
            inertia = axes @ np.diag(moments.sum() - moments) @ axes.T
        turn = np.array(place.rotation)
        self._bodies[carrier].append((link, mass, np.array(place.translation), turn @ inertia @ turn.T))

    def merge(self) -> RigidArm:
        """The arm with the bodies that move together merged into one link each; inertias that no body has are refused
        all at once, or taken as the nearest one where little is missing."""
        ask(
            self._doubtful,
            f"{', '.join(map(repr, self._doubtful))}: no body has such an inertia.",
            "expected principal inertias >= 0 of which none exceeds the sum of the others; "
            + "; ".join(self._doubtful.values())
            + ("" if self._hopeless else "; the nearest that a body has are taken"),
            "the inertia about the centre of mass, in kg·m²",
            self._hopeless,
        )
        for joint, bodies in zip(self.joints, self._bodies):
            mass = sum(body[1] for body in bodies)
            refuse_if(
                not mass > 0.0,
                f"What the joint {joint.name!r} moves has no mass.",
                f"expected an <inertial> in the link behind it, got {mass:g} kg",
                "a file with inertials (some are made for display only), or lock the joint",
            )
            mass, centre, inertia = lumped([body[1:] for body in bodies])
            with located(f"link {[body[0] for body in bodies]}"):
                self.links.append(Link(mass, [float(c) for c in centre], six_of(inertia)))
        return self


def read_urdf(
    root: Element, joints: Sequence[str] | None = None, locked: Mapping[str, float] | None = None
) -> RigidArm:
    """The moving joints of a URDF, of its root, and their links; neither meshes nor transmissions.

    `joints` are those that move (by default all that are not fixed); `locked` is where others stand, rad or m. Those
    that `joints` leaves out stand at zero or at the nearer limit, or where the joint that they mimic takes them.
    """
    refuse_if(
        root.tag != "robot",
        "This is no URDF.",
        f"expected the root element <robot>, got <{root.tag[:60]}>",
        "arm.xml with the root <mujoco> is read as MJCF; convert other files to URDF first",
    )
    refuse_if(
        any("xacro" in element.tag for element in root.iter()),
        "This is a xacro file.",
        "expected plain URDF, got elements of xacro",
        "xacro arm.xacro > arm.urdf",
    )
    links, elements = _named(root, "link"), _named(root, "joint")
    behind, base = _tree(links, elements)
    movable = tuple(name for name, element in elements.items() if element.get("type") != "fixed")
    arm = RigidArm(movable, _with_mimics(elements, locked_joints(movable, joints, locked)))
    # From the base outwards, each link before those behind it, without recursion: chains may be long.
    ahead: list[Any] = [(name, None, Placement()) for name in reversed(behind.get(base, []))]
    while ahead:
        name, carrier, above = ahead.pop()
        element, link = elements[name], _link_at(elements[name], "child")
        kind, place = element.get("type", ""), above.then(_origin(name, element))
        refuse_if(
            kind not in (*KINDS, "fixed"),
            f"The joint {name!r} is of kind {value_text(kind, 60)}.",
            f"expected fixed or one of {list(KINDS)}",
            "a robot on a fixed base with joints of one degree of freedom",
        )
        if kind != "fixed":
            axis = _vector(name, element.find("axis"), "xyz", (1.0, 0.0, 0.0))
            refuse_if(
                not np.linalg.norm(axis) > 1.0 / HUGE,
                f"The axis of the joint {name!r} has no direction.",
                f"expected a vector that is not zero, got {axis}",
                "xyz='0 0 1'",
            )
            refuse_if(
                name not in arm.locked and element.find("mimic") is not None,
                f"The joint {name!r} mimics another one, which an elastic joint cannot.",
                f"expected independent joints, got <mimic> in {name!r}",
                f"locked={{{name!r}: 0.0}}, or joints=[...] without it",
            )
            carrier, place = arm.add_joint(carrier, name, kind, axis, place, _limits(name, element))
            if name not in arm.locked:
                arm.motors[name] = _dynamics(name, element)
        if carrier is not None:
            _add_body(arm, carrier, link, links[link], place)
            arm.frames[link] = Frame(arm.joints[carrier].name, place)
            arm.frames.setdefault(name, arm.frames[link])
            if link not in behind:
                arm.tips.append(link)
        ahead += [(after, carrier, place) for after in reversed(behind.get(link, []))]
    arm.efforts, arm.speeds = (
        [_largest(joint.name, elements[joint.name], key) for joint in arm.joints]
        for key in ("effort", "velocity")
    )
    return arm.merge()


# Elements -----------------------------------------------------------------------------------------
def _named(root: Element, tag: str) -> dict[str, Element]:
    elements = root.findall(tag)
    check_count(f"{tag}s", len(elements), MOST_LINKS)
    names = [checked_name(f"a {tag}", entry.get("name"), spaces=True) for entry in elements]
    distinct(f"The {tag}", names)
    for name, element in zip(names, elements):
        _check_element(name, element)
    return dict(zip(names, elements))


def _link_at(joint: Element, end: str) -> str:
    link = joint.find(end)
    return "" if link is None else link.get("link", "")


def _tree(links: Mapping[str, Element], joints: Mapping[str, Element]) -> tuple[Any, str]:
    behind: dict[str, list[str]] = {}
    for name, element in joints.items():
        for end in ("parent", "child"):
            if _link_at(element, end) not in links:
                raise InvalidInput(
                    f"The joint {name!r} has no {end} link.",
                    f"expected one of {list(links)}, got {_link_at(element, end)!r}",
                    f"<{end} link='…'/>",
                )
        behind.setdefault(_link_at(element, "parent"), []).append(name)
    children = [_link_at(element, "child") for element in joints.values()]
    free = [link for link in links if link not in children]
    reached, ahead = set[str](), list(free)
    while ahead:
        link = ahead.pop()
        if link not in reached:
            reached.add(link)
            ahead += [_link_at(joints[name], "child") for name in behind.get(link, [])]
    refuse_if(
        len(free) != 1 or len(set(children)) != len(children) or len(reached) != len(links),
        "The links are no tree.",
        "expected one link without a parent and one parent for every other, got the links without a parent "
        f"{free}, and in loops {[link for link in links if link not in reached]}",
        "a closed loop is cut, a second robot goes into a file of its own",
    )
    return behind, free[0]


def _check_element(name: str, element: Element) -> None:
    once, where = ONCE[element.tag], "<inertial> of" if element.tag == "inertial" else f"the {element.tag}"
    for tag in once:
        count = len(element.findall(tag))
        refuse_if(
            count > 1,
            f"<{tag}> stands {count} times in {where} {name!r}.",
            f"expected one <{tag}>, got {count}",
            "delete the others",
        )
    known = (*once, *OTHERS.get(element.tag, ()))
    for tag in sorted({str(child.tag) for child in element} - set(known)):
        for close in difflib.get_close_matches(tag[:60].lower(), known, n=1, cutoff=0.75):
            raise InvalidInput(
                f"There is an unknown element <{tag[:60]}> in {name!r}.",
                f"expected one of {list(known)}, got {tag[:60]!r}",
                f"<{close}>",
            )
    for child in element:
        if child.tag == "inertial":
            _check_element(name, child)
        required, optional = ATTRIBUTES.get(child.tag, ((), tuple(child.attrib)))
        missing = [key for key in required if key not in child.attrib]
        unknown = [key for key in child.attrib if key not in (*required, *optional)]
        if missing or unknown:
            fault = f"no {missing[0]!r}" if missing else f"an unknown attribute {value_text(unknown[0], 60)}"
            raise InvalidInput(
                f"<{child.tag}> in {name!r} has {fault}.",
                f"expected {' '.join([*required, *(f'[{key}]' for key in optional)])}, got "
                f"{value_text(list(child.attrib), 120)}",
                f"{missing[0]}='…'" if missing else "leave it out, or correct its name",
            )


# Numbers ------------------------------------------------------------------------------------------
def _vector(name: str, element: Element | None, key: str, default: Sequence[float]) -> Any:
    if element is None or element.get(key) is None:
        return default
    tokens = str(element.get(key)).split()
    numbers = tuple(float(word) for word in tokens) if all(map(NUMBER.fullmatch, tokens)) else ()
    refuse_if(
        len(numbers) != len(default) or not all(abs(number) <= HUGE for number in numbers),
        f"{key} of <{element.tag}> in {name!r} cannot be read.",
        f"expected {len(default)} numbers of at most {HUGE:g}, got {value_text(element.get(key))}",
        f"{key}='0 0 1'" if len(default) == 3 else f"{key}='1.0'",
    )
    return numbers


def _number(name: str, element: Element | None, key: str) -> float:
    return _vector(name, element, key, (0.0,))[0]


def _origin(name: str, element: Element) -> Placement:
    return Placement.of(*(_vector(name, element.find("origin"), key, ZERO) for key in ("xyz", "rpy")))


def _with_mimics(
    elements: Mapping[str, Element], locked: Mapping[str, float | None]
) -> dict[str, float | None]:
    """Locked joints, of which those that mimic a locked one stand where it takes them, if nobody placed them."""
    placed = dict(locked)
    for _ in range(len(placed)):  # a leader may follow another one
        for name in [name for name, value in placed.items() if value is None]:
            mimic = elements[name].find("mimic")
            leader = None if mimic is None else placed.get(mimic.get("joint", ""))
            if mimic is not None and leader is not None:
                factor = 1.0 if mimic.get("multiplier") is None else _number(name, mimic, "multiplier")
                placed[name] = factor * leader + _number(name, mimic, "offset")
    return placed


def _dynamics(name: str, joint: Element) -> dict[str, float]:
    """Friction of a joint, viscous and dry, as <dynamics damping friction> states it, by its names in a robot file."""
    stated = {
        "friction": _number(name, joint.find("dynamics"), "damping"),
        "coulomb_friction": _number(name, joint.find("dynamics"), "friction"),
    }
    refuse_if(
        min(stated.values()) < 0.0,
        f"<dynamics> of the joint {name!r} is negative.",
        f"expected damping and friction >= 0, got {list(stated.values())}",
        "0 for none",
    )
    return {quantity: value for quantity, value in stated.items() if value}


def whole_weight(stated: Mapping[str, Any]) -> Mapping[str, Any]:
    """What is stated of a single link; refuses one of which mass or length was forgotten: it would weigh nothing."""
    half = {"mass", "length"} & set(stated)
    refuse_if(
        len(half) == 1,
        f"A link has a {'mass and no length' if 'mass' in half else 'length and no mass'}.",
        f"expected both, whose product is its weight about the axis, or none for a vertical axis; got {list(stated)}",
        f"add {'length = 0.1' if 'mass' in half else 'mass = 1.0'}",
    )
    return stated


def tell_friction(file: str, rows: Sequence[Any], arm: RigidArm, source: str) -> None:
    """Warn of frictions that come from <dynamics> of a URDF, a guess in many files: the elastic file states none."""
    taken = [
        (row["name"], key, value)
        for row in rows
        for key, value in arm.motors.get(row["name"], {}).items()
        if key not in row["motor"] and arm.down is None  # a file of MuJoCo states it
    ]
    ask(
        taken,
        f"{file} does not state every friction: {source} does.",
        f"taken from <dynamics>: {', '.join(f'{key} {value:g} of {name}' for name, key, value in taken)}",
        "state it in [joint.motor], which is then taken instead",
    )


def range_of(lower: float, upper: float) -> tuple[float, float] | None:
    """The range of a joint; None where its ends are so far away that there is none."""
    return None if lower <= -NO_LIMIT and upper >= NO_LIMIT else (lower, upper)


def _limits(name: str, joint: Element) -> tuple[float, float] | None:
    """Range of a joint, rad or m; None where there is none: also of lower = upper = 0, which exporters write then."""
    if joint.get("type") == "continuous":
        return None
    lower, upper = (_number(name, joint.find("limit"), key) for key in ("lower", "upper"))
    refuse_if(
        lower > upper or lower == upper != 0.0,
        f"The limits of the joint {name!r} leave no room.",
        f"expected lower < upper, got lower {lower:g} and upper {upper:g} (0 where not stated)",
        "exchange them; or a fixed joint",
    )
    return range_of(lower, upper) if lower < upper else None


def _largest(name: str, joint: Element, key: str) -> float:
    """The limit that <limit effort velocity> states; infinite without one, and for 0 and -1, which exporters write
    then, and for what is beyond all motors."""
    stated = _number(name, joint.find("limit"), key)
    refuse_if(
        stated < 0.0 and stated != -1.0,
        f"The {key} limit of the joint {name!r} is negative.",
        f"expected {key} >= 0 (0 or -1 for none) in <limit>, got {stated:g}",
        f"{key}='0' for none, or the limit",
    )
    return stated if 0.0 < stated < NO_MOTOR else np.inf


def _add_body(arm: RigidArm, carrier: int, link: str, element: Element, place: Placement) -> None:
    inertial = element.find("inertial")
    if inertial is None:
        return
    mass_element, six = inertial.find("mass"), inertial.find("inertia")
    mass = _number(link, mass_element, "value")
    if six is None and mass_element is not None and mass == 0.0:
        return
    refuse_if(
        mass_element is None or six is None,
        f"The <inertial> of the link {link!r} has no {'mass' if mass_element is None else 'inertia'}.",
        "expected <mass value=…/>, kg, and <inertia ixx=… iyy=… izz=…/> about the centre of mass",
        "the missing one; or no <inertial> for a link without mass",
    )
    moments = matrix_of([_number(link, six, f"i{axes}") for axes in INERTIA])
    arm.add_body(carrier, link, mass, moments, place.then(_origin(link, inertial)))


# Joints of URDF and MJCF --------------------------------------------------------------------------
def check_count(what: str, count: int, most: int) -> None:
    """Refuse a file with more parts of a kind than any robot has."""
    refuse_if(
        count > most, f"There are too many {what}.", f"expected at most {most}, got {count}", "one robot"
    )


def check_selection(joints: Any, locked: Any) -> None:
    """Refuse a selection that does not say which joints move, and where the others stand."""
    listed = isinstance(joints, Sequence) and not isinstance(joints, (str, bytes))
    refuse_if(
        joints is not None and not (listed and all(isinstance(name, str) for name in joints)),
        "The joints that move are not named.",
        f"expected a list of names, got joints={value_text(joints, 60)}",
        "joints=['shoulder', 'elbow']",
    )
    distinct("joints: the joint", list(joints or ()))
    refuse_if(
        locked is not None
        and not (isinstance(locked, Mapping) and all(isinstance(name, str) for name in locked)),
        "The joints that are locked are not named.",
        f"expected names and positions, got locked={value_text(locked, 60)}",
        "locked={'elbow': 0.0}",
    )
    for name, value in (locked or {}).items():
        refuse_if(
            not abs(real_number(value)) <= HUGE,
            f"The joint {value_text(name, 60)} is locked at no position.",
            f"expected a finite number in rad or m, got {value_text(value, 60)}",
            "0.0",
        )


def locked_joints(
    movable: Sequence[str], joints: Sequence[str] | None, locked: Mapping[str, float] | None
) -> dict[str, float | None]:
    """Joints that are not fixed and do not move, and where they stand, rad or m, None where nobody placed them; refuses
    a selection of none."""
    check_selection(joints, locked)
    still: dict[str, float | None] = dict(locked or {})
    for name in (*(joints or ()), *still):
        one_of(f"There is no joint {value_text(name, 60)} that could move.", name, movable)
    if joints is not None:
        for name in [name for name in joints if name in still]:
            raise InvalidInput(f"The joint {name!r} is chosen and locked.", f"got {name!r}", "one of the two")
        still |= {name: None for name in movable if name not in joints and name not in still}
    count = len(movable) - len(still)
    refuse_if(
        not 0 < count <= MOST_JOINTS,
        "Too many joints move." if count else "Nothing moves.",
        f"expected 1 to {MOST_JOINTS}, got {count}; the file has {list(movable)}",
        "joints=[...]: the others are locked",
    )
    return still


def moved(kind: str, axis: Sequence[float], value: float) -> Placement:
    """The place of a joint's link at its position, rad (by Rodrigues' formula) or m."""
    unit = np.array(axis) / np.linalg.norm(axis)
    if kind == "prismatic":
        return Placement(translation=tuple((value * unit).tolist()))
    x, y, z = unit
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    rotation = np.eye(3) + math.sin(value) * cross + (1.0 - math.cos(value)) * cross @ cross
    return Placement(tuple(map(tuple, rotation.tolist())))
