"""The rigid links of a URDF, as a chain or tree of the joints that a robot file names.

Links behind joints that do not move become part of the link before them.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

__all__ = ["Body", "RigidJoint", "read_urdf", "turned"]

#: Kinds of joints that move.
MOVING = ("revolute", "continuous", "prismatic")


def turned(rpy: list[float]) -> np.ndarray:
    """Rotation by roll, pitch and yaw about fixed axes (rad), Rz Ry Rx, (3, 3)."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    x = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    y = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    z = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    return z @ y @ x


@dataclass
class Body:
    """Mass (kg), centre of mass (3,) and moments about it (3, 3), in the frame of a link."""

    mass: float = 0.0
    centre: np.ndarray = field(default_factory=lambda: np.zeros(3))
    inertia: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))

    def joined(self, other: Body) -> Body:
        """Both as one rigid body, in the same frame."""
        mass = self.mass + other.mass
        if mass == 0.0:
            return Body()
        centre = (self.mass * self.centre + other.mass * other.centre) / mass
        inertia = np.zeros((3, 3))
        for body in (self, other):
            away = body.centre - centre
            inertia += body.inertia + body.mass * (away @ away * np.eye(3) - np.outer(away, away))
        return Body(mass, centre, inertia)

    def seen(self, rotation: np.ndarray, offset: np.ndarray) -> Body:
        """The same in the frame that carries this one."""
        return Body(self.mass, rotation @ self.centre + offset, rotation @ self.inertia @ rotation.T)


@dataclass
class RigidJoint:
    """A joint that moves, with the frame of its link in that of the link before, and that link."""

    name: str
    parent: int
    slides: bool
    axis: np.ndarray
    rotation: np.ndarray
    offset: np.ndarray
    limits: tuple[float, float] | None = None
    effort: float | None = None
    speed: float | None = None
    body: Body = field(default_factory=Body)
    carries: dict[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)  # frames of links


def read_urdf(path: Path, names: list[str]) -> list[RigidJoint]:
    """The joints of these names, in this order; others do not move, and stand at zero. ValueError otherwise."""
    root = ET.parse(path).getroot()  # a file of the user's own
    children = {link.get("name"): list[ET.Element]() for link in root.iter("link")}
    for joint in root.findall("joint"):
        children[_link(joint, "parent")].append(joint)
    below = {_link(joint, "child") for joint in root.findall("joint")}
    bodies = {link.get("name"): _body(link) for link in root.iter("link")}
    found = dict[str, RigidJoint]()

    def walk(link: str | None, owner: str | None, rotation: np.ndarray, offset: np.ndarray) -> None:
        """Add a link, seen in its owner's frame, and what hangs on it."""
        if owner is not None:
            found[owner].body = found[owner].body.joined(bodies[link].seen(rotation, offset))
            found[owner].carries[str(link)] = (rotation, offset)
        for joint in children[link]:
            xyz, own = _origin(joint)
            at, turn = rotation @ xyz + offset, rotation @ own
            name = str(joint.get("name"))
            if name in names and joint.get("type") in MOVING:
                found[name] = _joint(joint, list(found).index(owner) if owner else -1, turn, at)
                walk(_link(joint, "child"), name, np.eye(3), np.zeros(3))
            else:
                walk(_link(joint, "child"), owner, turn, at)

    for link in [name for name in children if name not in below]:
        walk(link, None, np.eye(3), np.zeros(3))
    if list(found) != names:
        raise ValueError(f"{path.name}: expected the joints {names} in this order, got {list(found)}")
    return list(found.values())


def _link(joint: ET.Element, side: str) -> str:
    element = joint.find(side)
    if element is None:
        raise ValueError(f"the joint {joint.get('name')!r} has no {side}")
    return str(element.get("link"))


def _numbers(text: str | None, usual: str) -> np.ndarray:
    return np.array([float(part) for part in (text or usual).split()])


def _origin(element: ET.Element) -> tuple[np.ndarray, np.ndarray]:
    origin = element.find("origin")
    attributes = {} if origin is None else origin.attrib
    return _numbers(attributes.get("xyz"), "0 0 0"), turned(list(_numbers(attributes.get("rpy"), "0 0 0")))


def _body(link: ET.Element) -> Body:
    inertial = link.find("inertial")
    if inertial is None:
        return Body()
    centre, turn = _origin(inertial)
    mass, moments = inertial.find("mass"), inertial.find("inertia")
    if mass is None or moments is None:
        raise ValueError(f"the link {link.get('name')!r} has no mass or no inertia")
    xx, xy, xz, yy, yz, zz = (float(moments.get(f"i{k}", 0.0)) for k in ("xx", "xy", "xz", "yy", "yz", "zz"))
    inertia = turn @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ turn.T
    return Body(float(mass.get("value", 0.0)), centre, inertia)


def _joint(joint: ET.Element, parent: int, rotation: np.ndarray, offset: np.ndarray) -> RigidJoint:
    axis, limit = joint.find("axis"), joint.find("limit")
    along = _numbers(None if axis is None else axis.get("xyz"), "1 0 0")
    bounds = {} if limit is None else {key: float(value) for key, value in limit.attrib.items()}
    ends = bounds.get("lower", -math.inf), bounds.get("upper", math.inf)
    return RigidJoint(
        str(joint.get("name")), parent, joint.get("type") == "prismatic", along / np.linalg.norm(along), rotation,
        offset, None if joint.get("type") == "continuous" else ends, bounds.get("effort"), bounds.get("velocity"),
    )  # fmt: skip
