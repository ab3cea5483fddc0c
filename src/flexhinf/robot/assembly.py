"""From parts to a robot: every number becomes a parameter with its joint's name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from flexhinf.errors import InvalidInput
from flexhinf.plant import Penalty
from flexhinf.robot.arm import Arm
from flexhinf.robot.dynamics import Joint, Tree
from flexhinf.robot.parameter import Parameter
from flexhinf.robot.parts import ElasticJoint, Link, Number, SingleLink
from flexhinf.robot.quantities import INERTIA, VECTOR, per_joint, unit_of
from flexhinf.robot.robot import Robot
from flexhinf.robot.single_link import Pendulum


def assembled(
    name: str,
    joints: Sequence[Joint],
    links: Sequence[Link],
    elastic: Sequence[ElasticJoint],
    *,
    gravity: Number = 9.81,
    down: Sequence[float] = (0.0, 0.0, -1.0),
    penalty: Penalty | None = None,
    home: Sequence[float] | None = None,
    description: str = "",
    effort_limits: Sequence[float | None] | None = None,
    speed_limits: Sequence[float | None] | None = None,
) -> Robot:
    """A robot of one link and one elastic joint per joint.

    Parameters
    ----------
    joints, links, elastic : sequence
        One each, in the same order.
    gravity : number
        m/s².
    down : (3,)
        Direction of free fall in the world's frame.
    penalty, home, description, effort_limits, speed_limits
        As for `Robot`.

    Raises
    ------
    InvalidInput
        If the numbers of parts differ, some joints are driven by voltage, others by current or torque, or the parts do
        not make a robot.
    """
    if not len(joints) == len(links) == len(elastic):
        raise InvalidInput(
            f"The parts of the robot {name!r} do not fit each other.",
            f"expected one link and one elastic joint per joint, got {len(joints)} joints, {len(links)} links and "
            f"{len(elastic)} elastic joints",
            "one of each",
        )
    tree = Tree(tuple(joints))
    parameters = [_parameter("gravity", gravity, "gravity")]
    for joint, link, spring in zip(joints, links, elastic):
        numbers: dict[str, Any] = {"mass": link.mass}
        numbers |= {f"centre_of_mass_{axis}": value for axis, value in zip(VECTOR, link.centre_of_mass)}
        numbers |= {f"inertia_{axes}": value for axes, value in zip(INERTIA, link.inertia)}
        numbers |= spring.stated
        for quantity, number in numbers.items():
            label = per_joint(quantity, joint.name, len(joints))
            parameters.append(_parameter(label, number, quantity, joint.slides))
    direction: Any = tuple(down)
    drive = _common_drive(name, [joint.name for joint in joints], elastic)
    rigid = tuple(joint.name for joint, spring in zip(joints, elastic) if spring.rigid)
    limits = effort_limits, speed_limits
    return Robot(
        name, tuple(parameters), penalty, Arm(tree, direction), drive, home, description, *limits, rigid
    )


def single_link_robot(
    name: str,
    joint: Joint,
    link: SingleLink,
    elastic: ElasticJoint,
    *,
    gravity: Number = 9.81,
    penalty: Penalty | None = None,
    home: Sequence[float] | None = None,
    description: str = "",
    effort_limits: Sequence[float | None] | None = None,
    speed_limits: Sequence[float | None] | None = None,
) -> Robot:
    """A robot of a single link about a horizontal axis, in closed form; position zero hangs.

    Raises
    ------
    InvalidInput
        For a prismatic joint, or parts that do not make a robot.
    """
    if joint.slides:
        raise InvalidInput(
            f"The joint {joint.name!r} slides, so its link has no inertia about an axis.",
            "expected a revolute joint, got a prismatic one",
            "mass, centre_of_mass and inertia of the link",
        )
    if elastic.rigid:
        raise InvalidInput(
            f"The only joint of the robot {name!r} is rigid.",
            "expected an elastic joint, got none",
            "[joint.spring] with stiffness = … (N·m/rad)",
        )
    numbers = {"mass": link.mass, "length": link.length, "gravity": gravity, "link_inertia": link.inertia}
    numbers |= elastic.stated
    parameters = tuple(_parameter(quantity, number, quantity) for quantity, number in numbers.items())
    links = Pendulum(joint.name, joint.limits)
    limits = effort_limits, speed_limits
    return Robot(name, parameters, penalty, links, elastic.drive, home, description, *limits)


def _common_drive(robot: str, joints: Sequence[str], elastic: Sequence[ElasticJoint]) -> str:
    drives = {joint: spring.drive for joint, spring in zip(joints, elastic)}
    if len(set(drives.values())) > 1:
        found = " and by ".join(f"{drive}s" for drive in sorted(set(drives.values())))
        raise InvalidInput(
            f"The robot {robot!r} is driven by {found}.",
            f"expected the same motor constants for all joints, got {drives}",
            "resistance, torque_constant and back_emf_constant of every motor (voltages), torque_constant alone "
            "(currents), or none (torques)",
        )
    return next(iter(drives.values()))


def _parameter(label: str, number: Number, quantity: str, slides: bool = False) -> Parameter:
    unit = unit_of(quantity, slides)
    if isinstance(number, Parameter):
        return replace(number, name=label, unit=number.unit or unit)
    return Parameter(label, float(number), unit=unit)
