"""An exported controller's robot as a description for ROS 2: URDF of its joints with interfaces of ros2_control."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from flexhinf.export.controller_c import ControllerCode
from flexhinf.export.names import distinct_names
from flexhinf.robot.dynamics import Joint, Tree

#: A limit that URDF wants where the robot has none.
UNLIMITED = 1e9


def description_values(
    code: ControllerCode,
    measurements: Sequence[Mapping[str, Any]],
    inputs: Sequence[Mapping[str, Any]],
) -> dict[str, Any]:
    """What the templates of the description need: joints of the URDF, and components of ros2_control.

    `measurements`, `inputs`: Each with its `interface`; measurements with `initial`, which a mock of the hardware
    begins at, inputs with `lower` and `upper`.
    """
    tree = Tree((Joint("joint", "continuous"),)) if code.robot is None else code.robot.links.tree
    components: dict[str, dict[str, Any]] = {}
    for signal in [*inputs, *measurements]:
        component, _, interface = signal["interface"].rpartition("/")
        found = components.setdefault(component, {"name": component, "commands": [], "states": []})
        if "lower" in signal:
            ends = {"min": signal["lower"], "max": signal["upper"]}
            finite = {end: value for end, value in ends.items() if np.isfinite(value)}
            found["commands"].append({"name": interface, "ends": finite})
        else:
            found["states"].append({"name": interface, "initial": signal["initial"]})
    for component in components.values():
        component["element"] = "joint" if component["name"] in tree.names else "gpio"
    return {"components": list(components.values()), "urdf_joints": _joints(code, tree, inputs)}


def initial_values(names: Sequence[str], command: Mapping[str, float]) -> list[float]:
    """Measured values at rest: those of the command; a motor without one is where its link is."""
    return [
        command.get(name, command.get(name.replace("motor_position", "link_position"), 0.0)) for name in names
    ]


def _joints(code: ControllerCode, tree: Tree, inputs: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Joints of a URDF, each with the link behind it."""
    base, *links = distinct_names(["base_link", *(f"{name}_link" for name in tree.names)])
    speeds = [None] * len(tree) if code.robot is None else code.robot.speed_limits or [None] * len(tree)
    largest = {signal["interface"]: max(abs(signal["lower"]), abs(signal["upper"])) for signal in inputs}
    rows: list[dict[str, Any]] = []
    for joint, link, parent, speed in zip(tree.joints, links, tree.parents, speeds, strict=True):
        kind = joint.kind if joint.kind == "prismatic" or joint.limits is not None else "continuous"
        lower, upper = joint.limits or (-UNLIMITED, UNLIMITED)
        limit = {"lower": lower, "upper": upper} if kind != "continuous" else {}
        limit["effort"] = min(largest.get(f"{joint.name}/effort", UNLIMITED), UNLIMITED)
        limit["velocity"] = min(UNLIMITED if speed is None else float(speed), UNLIMITED)
        rows.append(
            {
                "name": joint.name,
                "kind": kind,
                "parent": base if parent < 0 else links[parent],
                "link": link,
                "xyz": _vector(joint.placement.translation),
                "rpy": _vector(roll_pitch_yaw(joint.placement.rotation)),
                "axis": _vector(joint.axis),
                "limit": limit,
            }
        )
    return rows


def roll_pitch_yaw(rotation: Sequence[Sequence[float]]) -> tuple[float, float, float]:
    """Angles of URDF, rad, of Rz(yaw) Ry(pitch) Rx(roll); yaw is 0 where pitch is a right angle."""
    (a, _, _), (b, d, e), (c, f, g) = rotation
    level = math.hypot(a, b)
    pitch = math.atan2(-c, level)
    if level < 1e-9:
        return math.atan2(-e, d), pitch, 0.0
    return math.atan2(f, g), pitch, math.atan2(b, a)


def _vector(values: Sequence[float]) -> str:
    return " ".join(repr(float(value)) for value in values)
