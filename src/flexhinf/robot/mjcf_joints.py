"""Joints of an MJCF file, as a robot file names them: which are driven, coupled, and where they rest."""

from __future__ import annotations

from typing import NamedTuple
from xml.etree.ElementTree import Element

from flexhinf.robot.mjcf import KINDS, check_whole, scene_of
from flexhinf.robot.mjcf_actuators import ON_JOINT, acted_on


class DrivenJoints(NamedTuple):
    """Joints of one coordinate of a file, and those among them that an actuator acts on."""

    every: list[str]
    names: set[str]


def driven_joints(root: Element) -> DrivenJoints:
    """The joints of a file that turn or slide, in its order, and which of them have an actuator of their own."""
    check_whole(root)
    every = [joint.name for joint in scene_of(root).joints if joint.type.name in KINDS]
    acted = {str(part.get(key)) for part in root.findall("actuator/*") for key in ON_JOINT}
    pulled = [acted_on(root, part) for part in root.findall("actuator/*")]
    return DrivenJoints(every, acted.union(*(names for names in pulled if len(names) == 1)) & set(every))


def coupled_joints(root: Element) -> set[str]:
    """Joints that <equality>, or the tendon of one actuator, couples to others: of grippers and hands, mostly."""
    rows = [*root.findall("equality/joint")]
    pulled = [names for part in root.findall("actuator/*") if len(names := acted_on(root, part)) > 1]
    return {name for row in rows for key in ("joint1", "joint2") if (name := row.get(key))}.union(*pulled)


def first_keyframe(root: Element) -> dict[str, float]:
    """Positions of joints, rad or m, of the first <key> that states all; none where there is none."""
    sizes = {"mjJNT_FREE": 7, "mjJNT_BALL": 4}
    joints = list(scene_of(root).joints)
    for key in root.findall("keyframe/key"):
        texts = (key.get("qpos") or "").split()
        if len(texts) != sum(sizes.get(joint.type.name, 1) for joint in joints):
            continue
        try:
            numbers, places, at = [float(text) for text in texts], dict[str, float](), 0
        except ValueError:
            continue
        for joint in joints:
            places[joint.name], at = numbers[at], at + sizes.get(joint.type.name, 1)
        return places
    return {}
