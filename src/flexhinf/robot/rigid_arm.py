"""The rigid part of an arm, as a URDF or an MJCF file states it, joint by joint from the base outwards."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias, cast

import numpy as np

from flexhinf.errors import InvalidInput, located, refuse_if
from flexhinf.robot.arm import Frame
from flexhinf.robot.dynamics import Joint, Placement, lumped, matrix_of, six_of
from flexhinf.robot.faults import NO_BODY, NO_EXTENT, NO_MASS, refuse_part
from flexhinf.robot.mjcf_actuators import DcMotor
from flexhinf.robot.parameters import INERTIA
from flexhinf.robot.parts import Link, ask
from flexhinf.validation import HUGE, distinct, one_of, real_number, value_text

#: An inertia of less than this radius of gyration, m², squared is none; and what an inertia may lack of its largest
#: component to be taken as the nearest one that a body has, as rounded data sheets do.
NO_SIZE, NEARLY = 1e-12, 0.05

#: What stands for the inertia of a link: its six components as `INERTIA`, about the centre of mass in the axes of the
#: file's own, or the nearest that a body has.
NEAREST = "nearest"
Correction: TypeAlias = str | tuple[float, ...]

#: Limits beyond which a joint has none: exporters write ±1e16 then.
NO_LIMIT = 1e4

#: Radius of a plastic ball (1000 kg/m³) of one kilogram, m.
BALL = 0.062

#: Longest list of joints, in characters, that an advice writes out: longer texts are cut.
MOST_LISTED = 450

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
        Joints that do not move, and where they stand, rad or m; None, where nobody placed one, is 0 or the nearer
        limit.
    inertias
        By link what takes the place of the inertia that the file states.
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
    dc_motors
        Of MJCF only: the <dcmotor> of each joint that has one.
    repeated
        Of URDF only: elements that stand more than once, what is read of them and what is left, in sentences.
    doubtful
        Of links whose inertia no body has, and for which nobody asked for the nearest one: what is wrong.
    gravity, down
        Of MJCF only: free fall, m/s², and its direction (3,).
    """

    movable: tuple[str, ...]
    locked: Mapping[str, float | None]
    inertias: Mapping[str, Correction] = field(default_factory=dict[str, Correction])
    joints: list[Joint] = field(default_factory=list[Joint])
    links: list[Link] = field(default_factory=list[Link])
    frames: dict[str, Frame] = field(default_factory=dict[str, Frame])
    tips: list[str] = field(default_factory=list[str])
    efforts: list[float] = field(default_factory=list[float])
    speeds: list[float] = field(default_factory=list[float])
    motors: dict[str, dict[str, float]] = field(default_factory=dict[str, dict[str, float]])
    dc_motors: dict[str, DcMotor] = field(default_factory=dict[str, DcMotor])
    repeated: list[str] = field(default_factory=list[str])
    doubtful: dict[str, str] = field(default_factory=dict[str, str])
    gravity: float = GRAVITY
    down: tuple[float, float, float] | None = None
    _bodies: list[list[Any]] = field(default_factory=list[list[Any]])
    # of doubtful links: the nearest inertia of a body
    _nearest: dict[str, str] = field(default_factory=dict[str, str])
    _refused: bool = False  # whether one of them lacks much, and nobody asked for the nearest

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
                refuse_part(
                    True,
                    "",
                    (name,),
                    f"The joint {name!r} is locked outside its limits.",
                    f"expected {limits[0]:g} to {limits[1]:g}, got {value:g}",
                    f"locked = {{{toml_key(name)} = {min(max(value, low), high):g}}} at the top of the robot file, or "
                    "another position in between",
                )
            return carrier, place.then(moved(kind, axis, value))
        self.joints.append(
            Joint(name, kind, axis, place, limits, "world" if carrier is None else self.joints[carrier].name)
        )
        self._bodies.append([])
        return len(self.joints) - 1, Placement()

    def add_body(self, carrier: int, link: str, mass: float, inertia: np.ndarray, place: Placement) -> None:
        """Add a body with its centre of mass at `place` and inertia (3, 3) there; it may be a point, or massless."""
        correction = self.inertias.get(link)
        if correction is not None and correction != NEAREST:
            inertia = matrix_of(correction)
        a, b, c = np.linalg.eigvalsh(inertia).tolist()
        size, floor = max(abs(a), c), NO_SIZE * mass
        if refuse_part(
            mass < 0.0,
            "",
            (link,),
            f"The link {link!r} has a negative mass: no such body exists.",
            f"expected mass >= 0, got {mass:g} kg",
            "its mass, in kg",
        ):
            return
        # Second moments along the principal axes, which no body has below zero.
        moments = (a + b + c) / 2.0 - np.array([a, b, c])
        short = -min(float(moments.min()), a)
        if min(float(moments.min()), a) < 0.0:
            inertia = nearest_inertia(inertia)
        if short > max(1e-9 * size, floor):
            fault = "a negative inertia" if a < 0.0 else "none that keeps the triangle inequality"
            self.doubtful[link] = f"{link!r} has {fault}: ({a:.4g}, {b:.4g}, {c:.4g}) kg·m²"
            six = dict(zip(INERTIA, six_of(inertia)))
            self._nearest[link] = " ".join(f"i{axis}='{moment:.4g}'" for axis, moment in six.items())
        self._refused |= short > max(1e-9 * size, floor, NEARLY * size) and correction != NEAREST
        turn = np.array(place.rotation)
        self._bodies[carrier].append((link, mass, np.array(place.translation), turn @ inertia @ turn.T))

    def mass_of(self, link: str) -> float:
        """The mass of a link behind a moving joint, kg."""
        return sum(body[1] for bodies in self._bodies for body in bodies if body[0] == link)

    def merge(self) -> RigidArm:
        """The arm with the bodies that move together merged into one link each; inertias that no body has are refused
        all at once, or taken as the nearest one where little is missing."""
        corrected = [link for link in self.doubtful if self.inertias.get(link) == NEAREST]
        ask(
            corrected,
            f"The nearest inertia of a body is taken for {', '.join(map(repr, corrected))}.",
            "; ".join(self.doubtful.pop(link) for link in corrected),
            "the inertia as it was measured, in [links.NAME] of the robot file",
        )
        wrong = refuse_part(self._refused, NO_BODY, tuple(self.doubtful), *self._no_body())
        ask(self.doubtful and not wrong, *self._no_body())
        self._merge_links()
        return self

    def _no_body(self) -> tuple[str, str, str]:
        nearest = "; ".join(f"{self._nearest[link]} of {link!r}" for link in self.doubtful)
        return (
            f"{', '.join(map(repr, self.doubtful))}: no body has such an inertia.",
            "expected principal inertias >= 0 of which none exceeds the sum of the others; "
            + "; ".join(self.doubtful.values())
            + ("" if self._refused else "; the nearest that a body has are taken"),
            f"inertia = 'nearest' in {' and '.join(f'[links.{toml_key(link)}]' for link in self.doubtful)} of the "
            f"robot file; or in its <inertia>: {nearest}"
            if self._refused
            else "the inertia about the centre of mass, in kg·m²",
        )

    def _merge_links(self) -> None:
        masses = {
            joint.name: sum(body[1] for body in bodies) for joint, bodies in zip(self.joints, self._bodies)
        }
        empty = [name for name, mass in masses.items() if not mass > 0.0]
        refuse_part(
            empty,
            NO_MASS,
            tuple(empty),
            f"There is no mass directly behind {', '.join(map(repr, empty))}.",
            "expected an <inertial> in the links that a joint moves, before the next joint, got 0 kg",
            selection([name for name in masses if name not in empty], self.movable)
            if len(empty) < len(masses)
            else "a file with inertials: this one is made for display only",
        )
        moved_bodies = {
            joint.name: bodies for joint, bodies in zip(self.joints, self._bodies) if joint.name not in empty
        }
        wholes = {joint: lumped([body[1:] for body in bodies]) for joint, bodies in moved_bodies.items()}
        balls = {  # of those without size: the inertia of a plastic ball, by the heaviest link
            max(moved_bodies[joint], key=lambda body: body[1])[0]: (joint, ball_inertia(mass))
            for joint, (mass, _, inertia) in wholes.items()
            if not float(np.linalg.eigvalsh(inertia)[0]) > 0.0
        }
        names = {link: [body[0] for body in moved_bodies[joint]] for link, (joint, _) in balls.items()}
        refuse_part(
            balls,
            NO_EXTENT,
            tuple(balls),
            f"What a joint moves has no inertia about an axis: {', '.join(map(str, names.values()))}.",
            f"expected the <inertia> of links, got a principal moment of 0 in {', '.join(map(str, names.values()))}",
            "as measured, or of a plastic ball of that mass, "
            + "; ".join(
                f"ixx='{i:.2g}' iyy='{i:.2g}' izz='{i:.2g}' in {names[link]}"
                for link, (_, i) in balls.items()
            ),
        )
        small = {joint for joint, _ in balls.values()}
        for joint, (mass, centre, inertia) in wholes.items():
            if joint in small:
                continue
            with located(f"link {[body[0] for body in moved_bodies[joint]]}"):
                self.links.append(Link(mass, [float(c) for c in centre], six_of(inertia)))


def nearest_inertia(inertia: np.ndarray) -> np.ndarray:
    """The inertia (3, 3), kg·m², that a body can have and whose second moments are nearest to those of another one.

    A body's second moments Σ = ½ tr(I) 1 − I are positive semidefinite; negative ones become zero, which is nearest in
    the Frobenius norm (Wensing, Kim & Slotine, "Linear matrix inequalities for physically-consistent inertial
    parameter identification", IEEE Robotics and Automation Letters 3, 2018, for the condition).
    """
    principal, axes = np.linalg.eigh(inertia)
    moments = np.maximum(0.5 * principal.sum() - principal, 0.0)
    return axes @ np.diag(moments.sum() - moments) @ axes.T


def ball_inertia(mass: float) -> float:
    """The inertia of a plastic ball of a mass, kg, about its centre, kg·m²."""
    return 0.4 * mass ** (5.0 / 3.0) * BALL**2


def toml_key(name: str) -> str:
    """A joint's name as a key of TOML."""
    return name if re.fullmatch("[A-Za-z0-9_-]+", name) else json.dumps(name, ensure_ascii=False)


def selection(names: Sequence[str], every: Sequence[str]) -> str:
    """The line of a robot file by which, out of every joint, these move and no others."""
    text, where = (
        json.dumps(list(names), ensure_ascii=False),
        "at the top of the robot file: the others are locked",
    )
    if len(text) < MOST_LISTED:
        return f"joints = {text} {where}"
    others = [name for name in every if name not in names]
    return f"joints = [...] {where}; of {len(every)} joints all move but {json.dumps(others, ensure_ascii=False)}"


# Selection ----------------------------------------------------------------------------------------
def check_count(what: str, count: int, most: int) -> None:
    """Refuse a file with more parts of a kind than any robot has."""
    refuse_if(
        count > most,
        f"There are too many {what}.",
        f"expected at most {most}, got {count}",
        "one robot; of its joints those that a task moves: the others are locked",
    )


def check_selection(joints: object, locked: object) -> None:
    """Refuse a selection that does not say which joints move, and where the others stand."""
    listed = isinstance(joints, Sequence) and not isinstance(joints, (str, bytes))
    names = cast("Sequence[object]", joints) if listed else ()
    chosen = [name for name in names if isinstance(name, str)]
    refuse_if(
        joints is not None and not (listed and len(chosen) == len(names)),
        "The joints that move are not named.",
        f"expected a list of names, got joints={value_text(cast(object, joints), 60)}",
        "joints=['shoulder', 'elbow']",
    )
    distinct("joints: the joint", chosen)
    places = (
        cast("Mapping[object, object]", locked) if isinstance(locked, Mapping) else dict[object, object]()
    )
    refuse_if(
        locked is not None
        and not (isinstance(locked, Mapping) and all(isinstance(name, str) for name in places)),
        "The joints that are locked are not named.",
        f"expected names and positions, got locked={value_text(cast(object, locked), 60)}",
        "locked={'elbow': 0.0}",
    )
    for name, value in places.items():
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


def check_turns(where: str, angles: Sequence[float], line: str) -> None:
    """Refuse roll, pitch and yaw, rad, beyond one turn: degrees; `line` is what to write, with {0}, {1} and {2}."""
    radians = [float(f"{math.radians(angle):.6g}") for angle in angles]
    refuse_if(
        max(map(abs, angles)) > 2.0 * math.pi * (1.0 + 1e-6),
        f"{where}: roll, pitch and yaw turn by more than once around.",
        f"expected angles in rad within ±2π, got {list(angles)}; were degrees meant?",
        f"{line.format(*radians)} for {list(angles)}°",
    )


def range_of(lower: float, upper: float) -> tuple[float, float] | None:
    """The range of a joint; None where its ends are so far away that there is none."""
    return None if lower <= -NO_LIMIT and upper >= NO_LIMIT else (lower, upper)
