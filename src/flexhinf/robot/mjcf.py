"""MJCF: the rigid part of a robot that is described for MuJoCo, and its motors' inertia and friction where it has them.

What is read: <compiler>, <default> classes, <option gravity>, bodies, frames, hinge and slide joints, <inertial> and
the mass of simple shapes, and the largest forces of actuators. An actuator's own control is not part of the robot.
What would change the dynamics and is not read is refused by name.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.robot.dynamics import Joint, Placement
from flexhinf.robot.mjcf_file import (
    MjcfFile,
    check_attributes,
    geom_body,
    inertial_body,
    numbers,
    place_of,
    real_text,
)
from flexhinf.robot.urdf import (
    MOST_JOINTS,
    RigidArm,
    check_lock,
    check_selection,
    locked_joints,
    merged,
    moved,
)
from flexhinf.untrusted import value_text

KINDS = {"hinge": "revolute", "slide": "prismatic"}

#: Elements that add bodies or forces which are not read, and what to do instead.
REFUSED = {
    "include": "one file: mujoco.mj_saveLastXML writes it",
    "attach": "one file: mujoco.mj_saveLastXML writes it",
    "replicate": "the copies written out: mujoco.mj_saveLastXML writes them",
    "composite": "bodies and joints",
    "flexcomp": "bodies and joints",
    "freejoint": "a robot on a fixed base",
    "plugin": "the robot without it",
}

#: Attributes of bodies and joints that act on the dynamics, and what stands there when they do not.
ACTING = {
    "stiffness": "a spring that pulls the link to a place; that behind the motor stands in the elastic file",
    "springdamper": "a spring that pulls the link to a place; that behind the motor stands in the elastic file",
    "gravcomp": "a weight that is carried by something else",
}


def read_mjcf(
    root: Element, file: str, joints: Sequence[str] | None = None, locked: Mapping[str, float] | None = None
) -> RigidArm:
    """The moving joints of an MJCF file and their links.

    Parameters
    ----------
    root : Element
        <mujoco>, from `flexhinf.untrusted.read_xml`.
    file : str
        Name of the file, for messages.
    joints, locked
        As for `flexhinf.robot.urdf.read_urdf`.

    Raises
    ------
    InvalidInput
        For joint names that are not in it, and what is not read and would change the dynamics.
    """
    check_selection(joints, locked)
    for element in root.iter():
        if element.tag in REFUSED:
            raise InvalidInput(
                f"{file}: <{element.tag}> is not read.",
                "expected bodies, joints and inertials in this file",
                REFUSED[element.tag],
            )
    found = MjcfFile(file, root)
    movable = tuple(found.joint_names())
    walk = _Walk(found, locked_joints(file, movable, joints, locked))
    for world in root.findall("worldbody"):
        walk.children(world, _Place(None, Placement(), found.childclass(world, None)))
    if not walk.joints or len(walk.joints) > MOST_JOINTS:
        raise InvalidInput(
            f"{file}: nothing moves, or too much.",
            f"expected 1 to {MOST_JOINTS} joints, got {len(walk.joints)}",
            "joints=[...]: the others are locked",
        )
    found.check_couplings({joint.name for joint in walk.joints})
    gravity, down = found.gravity()
    return RigidArm(
        joints=tuple(walk.joints),
        links=tuple(
            merged(bodies, joint.name, file, "an <inertial>")
            for joint, bodies in zip(walk.joints, walk.bodies)
        ),
        movable=movable,
        frames=walk.frames,
        tips=tuple(walk.tips),
        efforts=tuple(min(walk.efforts[j.name], found.effort(j.name)) for j in walk.joints),
        speeds=(np.inf,) * len(walk.joints),
        motors=walk.motors,
        gravity=gravity,
        down=down,
    )


@dataclass(frozen=True)
class _Place:
    """Where the walk is: the joint that carries (None: the world), the place in its link's frame, the class."""

    carrier: int | None
    placement: Placement
    childclass: str | None


@dataclass
class _Walk:
    """From the world outwards: the moving joints, and the bodies that each carries, in its frame."""

    file: MjcfFile
    locked: Mapping[str, float]
    joints: list[Joint] = field(default_factory=list)
    bodies: list[list[Any]] = field(default_factory=list)
    frames: dict[str, tuple[str, Placement]] = field(default_factory=dict)
    tips: list[str] = field(default_factory=list)
    efforts: dict[str, float] = field(default_factory=dict)
    motors: dict[str, dict[str, float]] = field(default_factory=dict)

    def children(self, element: Element, at: _Place) -> bool:
        """The bodies in an element, through frames; whether there are any. Depth is limited where XML is read."""
        any_found = False
        for child in element:
            if child.tag == "body":
                any_found = True
                self.body(child, at)
            elif child.tag == "frame":
                any_found |= self.children(child, self.inside(child, "frame", at))
        return any_found

    def inside(self, element: Element, tag: str, at: _Place) -> _Place:
        """The place of a body or a frame."""
        where = f"<{tag}> {value_text(element.get('name', ''), 60)}"
        check_attributes(self.file.name, where, tag, element.attrib)
        for key in ("gravcomp",):
            self.check_acting(where, key, element.attrib)
        place = at.placement.then(place_of(self.file.name, where, element.attrib, self.file.compiler))
        return _Place(at.carrier, place, self.file.childclass(element, at.childclass))

    def check_acting(self, where: str, key: str, values: Mapping[str, str]) -> None:
        """Refuse a spring or a compensation that acts."""
        if any(real_text(word) != 0.0 for word in values.get(key, "0").split()):
            raise InvalidInput(
                f"{self.file.name}: {where} has {key}.",
                f"expected none, got {key} = {value_text(values[key], 40)}: {ACTING[key]}",
                f"leave out {key}",
            )

    def body(self, element: Element, at: _Place) -> None:
        """A body with its joint, its mass, and the bodies behind it."""
        here = self.inside(element, "body", at)
        found = [(joint, here) for joint in element.findall("joint")]
        for frame in element.findall("frame"):
            found += [(joint, self.inside(frame, "frame", here)) for joint in frame.findall("joint")]
        name = element.get("name", "")
        if len(found) > 1:
            raise InvalidInput(
                f"{self.file.name}: the body {value_text(name, 60)} has {len(found)} joints.",
                "expected at most one joint for each body: a link between two joints has a mass",
                "a body for each joint, with what moves there",
            )
        for joint, place in found:
            here = self.cross(joint, place, here)
        if here.carrier is not None:
            self.bodies[here.carrier] += self.masses(element, here)
        more = self.children(element, here)
        if here.carrier is not None and name:
            self.frames[name] = self.joints[here.carrier].name, here.placement
            if not more:
                self.tips.append(name)

    def cross(self, element: Element, at: _Place, body: _Place) -> _Place:
        """The place of a body behind its joint, whose anchor and axis stand in the frame `at` of the body."""
        file, name = self.file.name, element.get("name", "")
        where, values = f"the joint {name!r}", self.file.values(element, at.childclass)
        check_attributes(file, where, "joint", values)
        kind = values.get("type", "hinge")
        if kind not in KINDS:
            raise InvalidInput(
                f"{file}: {where} is of type {value_text(kind, 40)}.",
                f"expected one of {list(KINDS)}",
                "a robot on a fixed base with joints of one degree of freedom",
            )
        for key in ("stiffness", "springdamper"):
            self.check_acting(where, key, values)
        axis = numbers(file, where, values, "axis", (3,))
        anchor = numbers(file, where, values, "pos", (3,))
        turns = kind == "hinge"

        def angle(value: float) -> float:
            return self.file.compiler.angle(value) if turns else value

        zero = numbers(file, where, values, "ref", (1,))
        if axis is not None and not np.linalg.norm(axis) > 1e-10:
            raise InvalidInput(
                f"{file}: the axis of {where} has no direction.",
                f"expected a vector that is not zero, got {axis.tolist()}",
                'axis="0 0 1"',
            )
        direction = (0.0, 0.0, 1.0) if axis is None else tuple(axis.tolist())
        shift = np.zeros(3) if anchor is None else anchor
        there = at.placement.then(Placement(translation=tuple(shift.tolist())))  # type: ignore[arg-type]
        own = self.relative(there, body.placement)
        back = moved(KINDS[kind], direction, 0.0 if zero is None else -angle(float(zero[0])))
        limits = self.limits(where, values, angle)
        if name in self.locked:
            check_lock(file, name, limits, float(self.locked[name]))
            place = there.then(back).then(moved(KINDS[kind], direction, float(self.locked[name])))
            return _Place(at.carrier, place.then(own), body.childclass)
        above = "world" if at.carrier is None else self.joints[at.carrier].name
        unlimited = "continuous" if turns else "prismatic"
        shown = KINDS[kind] if limits is not None else unlimited
        self.joints.append(Joint(name, shown, direction, there.then(back), limits, above))
        self.bodies.append([])
        self.efforts[name] = self.effort(where, values)
        self.motors[name] = self.motor(where, values)
        self.frames[name] = name, Placement()
        return _Place(len(self.joints) - 1, own, body.childclass)

    @staticmethod
    def relative(frame: Placement, other: Placement) -> Placement:
        """Where `other` is in `frame`, both in one frame."""
        turn = np.array(frame.rotation).T
        rows = turn @ np.array(other.rotation)
        place = turn @ (np.array(other.translation) - np.array(frame.translation))
        entries = tuple(tuple(float(x) for x in row) for row in rows)
        return Placement(translation=tuple(place.tolist())).then(Placement(entries))  # type: ignore[arg-type]

    def limits(self, where: str, values: Mapping[str, str], angle: Any) -> tuple[float, float] | None:
        """Range of a joint, rad or m."""
        ends = self.file.range(where, values, "range", "limited")
        return None if ends is None else (angle(float(ends[0])), angle(float(ends[1])))

    def effort(self, where: str, values: Mapping[str, str]) -> float:
        """Largest force of all actuators on the joint."""
        ends = self.file.range(where, values, "actuatorfrcrange", "actuatorfrclimited")
        return np.inf if ends is None else float(np.abs(ends).max())

    def motor(self, where: str, values: Mapping[str, str]) -> dict[str, float]:
        """Armature, damping and friction loss as numbers of the motor, seen from the link; what is zero is left out."""
        names = {"armature": "motor_inertia", "damping": "friction", "frictionloss": "coulomb_friction"}
        stated = {own: numbers(self.file.name, where, values, key, (1,)) for key, own in names.items()}
        return {own: float(found[0]) for own, found in stated.items() if found is not None and found[0]}

    def masses(self, element: Element, here: _Place) -> list[Any]:
        """The body's mass, stated or of its shapes, in the carrier's frame."""
        file, mode, name = self.file.name, self.file.compiler.inertia_from_geom, element.get("name", "")
        stated = element.findall("inertial")
        if len(stated) > 1:
            raise InvalidInput(
                f"{file}: <inertial> stands {len(stated)} times in the body {name!r}.",
                f"expected one, got {len(stated)}",
                "delete the others",
            )
        found: list[Any] = []
        if stated and mode != "true":
            where = f"<inertial> of the body {name!r}"
            found.append((here.placement, inertial_body(file, where, stated[0].attrib, self.file.compiler)))
        elif mode != "false":
            found += self.shapes(element, here)
        bodies = []
        for place, (mass, centre, about) in found:
            turn = np.array(place.rotation)
            bodies.append((name, mass, np.array(place.translation) + turn @ centre, turn @ about @ turn.T))
        return bodies

    def shapes(self, element: Element, here: _Place) -> list[Any]:
        """Bodies of the geoms in an element and in its frames, with the place of what holds them."""
        found = []
        for child in element:
            if child.tag == "geom":
                values = self.file.values(child, here.childclass)
                where = f"the geom {value_text(child.get('name', ''), 60)} of {element.get('name', '')!r}"
                if (body := geom_body(self.file.name, where, values, self.file.compiler)) is not None:
                    found.append((here.placement, body))
            elif child.tag == "frame":
                found += self.shapes(child, self.inside(child, "frame", here))
        return found
