"""An exported controller's robot as a description for ROS 2: URDF of its joints with interfaces of ros2_control."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from flexhinf.codegen.naming import distinct
from flexhinf.export.controller_c import ControllerCode
from flexhinf.robot.dynamics import Joint, Tree

#: A limit that URDF wants where the robot has none.
UNLIMITED = 1e9


@dataclass(frozen=True)
class Measured:
    """A measurement in ROS 2; a mock of the hardware begins at `initial`."""

    name: str
    interface: str
    unit: str
    initial: float


@dataclass(frozen=True)
class Commanded:
    """An input in ROS 2, with its limits."""

    name: str
    interface: str
    unit: str
    lower: float
    upper: float


@dataclass(frozen=True)
class CommandInterface:
    """A command interface of a component, with the limits "min" and "max" that are finite."""

    name: str
    ends: Mapping[str, float]


@dataclass(frozen=True)
class StateInterface:
    """A state interface of a component."""

    name: str
    initial: float


@dataclass(frozen=True)
class Component:
    """A component of ros2_control: a joint of the URDF, or another."""

    name: str
    element: Literal["joint", "gpio"]
    commands: list[CommandInterface] = field(default_factory=list[CommandInterface])
    states: list[StateInterface] = field(default_factory=list[StateInterface])


@dataclass(frozen=True)
class DescribedJoint:
    """A joint of a URDF with the link behind it, as the attributes of its elements."""

    name: str
    kind: str
    parent: str
    link: str
    xyz: str
    rpy: str
    axis: str
    limit: Mapping[str, float]


def description_values(
    code: ControllerCode, measurements: Sequence[Measured], inputs: Sequence[Commanded]
) -> dict[str, object]:
    """What the templates of the description need: joints of the URDF, and components of ros2_control."""
    tree = Tree((Joint("joint", "continuous"),)) if code.robot is None else code.robot.links.tree
    components: dict[str, Component] = {}
    for signal in [*inputs, *measurements]:
        name, _, interface = signal.interface.rpartition("/")
        found = components.setdefault(name, Component(name, "joint" if name in tree.names else "gpio"))
        if isinstance(signal, Commanded):
            ends = {"min": signal.lower, "max": signal.upper}
            finite = {end: value for end, value in ends.items() if np.isfinite(value)}
            found.commands.append(CommandInterface(interface, finite))
        else:
            found.states.append(StateInterface(interface, signal.initial))
    return {"components": list(components.values()), "urdf_joints": _joints(code, tree, inputs)}


def initial_values(names: Sequence[str], command: Mapping[str, float]) -> list[float]:
    """Measured values at rest: those of the command; a motor without one is where its link is."""
    return [
        command.get(name, command.get(name.replace("motor_position", "link_position"), 0.0)) for name in names
    ]


def _joints(code: ControllerCode, tree: Tree, inputs: Sequence[Commanded]) -> list[DescribedJoint]:
    """Joints of a URDF."""
    base, *links = distinct(["base_link", *(f"{name}_link" for name in tree.names)])
    speeds = [None] * len(tree) if code.robot is None else code.robot.speed_limits or [None] * len(tree)
    largest = {signal.interface: max(abs(signal.lower), abs(signal.upper)) for signal in inputs}
    rows: list[DescribedJoint] = []
    for joint, link, parent, speed in zip(tree.joints, links, tree.parents, speeds, strict=True):
        kind = joint.kind if joint.kind == "prismatic" or joint.limits is not None else "continuous"
        lower, upper = joint.limits or (-UNLIMITED, UNLIMITED)
        limit = {"lower": lower, "upper": upper} if kind != "continuous" else {}
        limit["effort"] = min(largest.get(f"{joint.name}/effort", UNLIMITED), UNLIMITED)
        limit["velocity"] = min(UNLIMITED if speed is None else float(speed), UNLIMITED)
        rows.append(
            DescribedJoint(
                joint.name,
                kind,
                base if parent < 0 else links[parent],
                link,
                xyz=_vector(joint.placement.translation),
                rpy=_vector(roll_pitch_yaw(joint.placement.rotation)),
                axis=_vector(joint.axis),
                limit=limit,
            )
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
