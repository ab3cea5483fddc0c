"""URDF: the rigid part of a robot. Fixed and locked joints are merged into the links that carry them."""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.robot.dynamics import Joint, Placement, lumped, six_of
from flexhinf.robot.dynamics.tree import KINDS
from flexhinf.robot.parts import Link
from flexhinf.robot.urdf_elements import axis_of, body_of, check_element, largest_of, limits_of, origin_of
from flexhinf.untrusted import HUGE, checked_name, distinct, read_xml, real_number, value_text

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
    if len(walk.joints) > MOST_JOINTS:
        raise InvalidInput(
            f"{path.name}: too many joints move.",
            f"expected at most {MOST_JOINTS}, got {len(walk.joints)}",
            "joints=[...]: the others are locked",
        )
    if not walk.joints:
        raise InvalidInput(
            f"{path.name}: nothing moves.", f"all of {list(file.movable)} are fixed or locked", "joints=[...]"
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
            close = difflib.get_close_matches(name, movable, n=1)
            raise InvalidInput(
                f"{file}: there is no joint {value_text(name, 60)} that could move.",
                f"expected one of {list(movable)}",
                f"{close[0]!r}" if close else "one of these",
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
    """Refuse a joint that is locked outside its limits, rad or m.

    Raises
    ------
    InvalidInput
        With the limits and the value.
    """
    if limits is not None and not limits[0] <= value <= limits[1]:
        raise InvalidInput(
            f"{file}: the joint {name!r} is locked outside its limits.",
            f"expected {limits[0]:g} to {limits[1]:g}, got {value:g}",
            "a position that the joint can have",
        )


def check_selection(joints: Any, locked: Any) -> None:
    """Refuse what does not say which joints move, and where the others stand.

    Raises
    ------
    InvalidInput
        Unless `joints` is None or a sequence of distinct names, and `locked` None or a mapping of names to finite
        numbers.
    """
    names = joints is None or (
        isinstance(joints, Sequence)
        and not isinstance(joints, (str, bytes))
        and all(isinstance(name, str) for name in joints)
    )
    if not names:
        raise InvalidInput(
            "The joints that move are not named.",
            f"expected a list of names, got joints={value_text(joints, 60)}",
            "joints=['shoulder', 'elbow']",
        )
    distinct("joints: the joint", list(joints or ()))
    if not (
        locked is None or (isinstance(locked, Mapping) and all(isinstance(name, str) for name in locked))
    ):
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


def moved(kind: str, axis: tuple[float, float, float], value: float) -> Placement:
    """The place of a locked joint's link at its position."""
    unit = np.array(axis) / np.linalg.norm(axis)
    if kind == "prismatic":
        return Placement(translation=tuple(float(entry) for entry in value * unit))  # type: ignore[arg-type]
    x, y, z = unit
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    rotation = np.eye(3) + math.sin(value) * cross + (1.0 - math.cos(value)) * cross @ cross
    return Placement(tuple(tuple(float(entry) for entry in row) for row in rotation))  # type: ignore[arg-type]


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
    try:
        return Link(mass, [float(c) for c in centre], six_of(inertia))
    except InvalidInput as error:
        names = [body[0] for body in bodies]
        raise InvalidInput(f"{file}: link {names}: {error.what}", error.found, error.advice) from error
