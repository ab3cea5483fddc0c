"""The elastic robot as a MuJoCo model for other programs: rotors, springs, motors, sensors and a pose at rest.

It is the model of `MuJoCoPlant`, with what a user of it needs beside the physics: shapes to look at, actuators that are
limited as the motors are, sensors of links and motors, and the pose `home` at rest as a keyframe.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from flexhinf.plant import Parameters
from flexhinf.robot.elastic import EXTRAS, with_dry_friction
from flexhinf.robot.kinematics import link_frames, skeleton
from flexhinf.robot.mujoco import EXPRESSED, MISSING, inexpressible, mujoco_xml
from flexhinf.robot.robot import Robot
from flexhinf.robot.signals import MECHANICAL, signal_names

#: Longest step of integration, s; steps for each radian of the fastest vibration, of RK4, which errs by (1/10)⁴/120 a
#: step there.
LONGEST, STEPS = 1e-3, 10.0

#: Radius of a link that is drawn, as a part of the robot's size.
RADIUS = 0.02


class ElasticMJCF(NamedTuple):
    """The text of a model, and what it leaves out of what the robot's file states: the reason by the name."""

    text: str
    left_out: dict[str, str]


def elastic_mjcf(robot: Robot) -> ElasticMJCF:
    """A robot as MJCF, with damped springs, backlash and dry friction as its designs are judged with.

    The input of an actuator is that of the robot: V, A, or N·m (N) on the link side. Joints have the names of the
    positions of links and motors, sensors those of all mechanical signals. Limits of the
    joints are stated and do not act, as in the plants of designs.
    """
    robot = robot.damped
    packed = robot.plant_parameters()
    stated = [name for name in EXTRAS if np.any(np.asarray(packed.get(EXTRAS[name], 0.0)) != 0.0)]
    stated = list(dict.fromkeys((*stated, *with_dry_friction((), packed))))
    missing = dict.fromkeys(inexpressible(stated, packed), "its actuators know no load that is rejected")
    missing |= {name: MISSING[name] for name in stated if name in MISSING}
    on = [name for name in stated if name in EXPRESSED and name not in missing]
    if "stribeck_friction" in stated and "coulomb_friction" not in on:
        on.append("coulomb_friction")
    root = ET.fromstring(mujoco_xml(robot, packed, on))
    root.set("model", robot.name)
    option = root.find("option")
    assert option is not None  # it has the gravity
    fastest = max(abs(mode.eigenvalue) for mode in robot.modes())
    option.set("timestep", _text([min(LONGEST, 1.0 / (STEPS * fastest))]))
    _add_shapes(root, robot)
    _add_limits(root, robot)
    _add_actuators(root, robot, Parameters(packed))
    _add_sensors(root, robot)
    _add_home(root, robot, on)
    ET.indent(root)
    return ElasticMJCF(
        ET.tostring(root, encoding="unicode") + "\n",
        missing,
    )


def _add_shapes(root: ET.Element, robot: Robot) -> None:
    """Capsules from joint to joint in the frames of the links; they have no mass and touch nothing."""
    home = np.asarray(robot.home)
    lines, (turns, places) = skeleton(robot, home), link_frames(robot, home)
    size = max(float(np.ptp(np.concatenate(lines), axis=0).max()), 1e-3)
    bodies = {str(joint.get("name")): body for body in root.iter("body") for joint in body.findall("joint")}
    for name, line, turn, place in zip(
        signal_names("link_position", robot.joint_names), lines, turns, places
    ):
        for end in line[1:]:
            begin_end = np.concatenate([turn.T @ (line[0] - place), turn.T @ (end - place)])
            if np.linalg.norm(begin_end[3:] - begin_end[:3]) > 1e-9:
                ET.SubElement(
                    bodies[name],
                    "geom",
                    {
                        "type": "capsule",
                        "fromto": _text(begin_end),
                        "size": _text([RADIUS * size]),
                        "mass": "0",
                        "contype": "0",
                        "conaffinity": "0",
                        "rgba": "0 0.45 0.7 1",
                    },
                )


def _add_limits(root: ET.Element, robot: Robot) -> None:
    joints = {str(joint.get("name")): joint for joint in root.iter("joint") if joint.get("name")}
    for name, ends in zip(signal_names("link_position", robot.joint_names), robot.links.limits):
        if ends is not None and np.isfinite(ends).all():
            joints[name].set("range", _text(ends))
            joints[name].set("limited", "false")


def _add_actuators(root: ET.Element, robot: Robot, p: Parameters) -> None:
    """A motor each: of an elastic joint at its rotor, of a rigid one at its link. An inner loop is there already,
    without name and limit."""
    joints, n = robot.joint_names, len(robot.joint_names)
    loops = root.findall("actuator/*")
    actuator = None if loops else ET.SubElement(root, "actuator")
    gains = np.broadcast_to(robot.drive_kind.torque_per_input(p), n).tolist()
    quantities = ["link_position" if joint in robot.rigid else "motor_position" for joint in joints]
    rows = zip(
        signal_names(robot.drive_kind.quantity, joints),
        quantities,
        range(n),
        gains,
        robot.effort_limits or (),
    )
    for name, quantity, i, gain, limit in rows:
        limits = {}
        if limit is not None and np.isfinite(limit):
            limits = {"ctrllimited": "true", "ctrlrange": _text([-limit, limit])}
        if actuator is None:
            loops[i].attrib |= {"name": name, **limits}
        else:
            motor = {"name": name, "joint": signal_names(quantity, joints)[i], "gear": _text([gain])}
            ET.SubElement(actuator, "motor", motor | limits)


def _add_sensors(root: ET.Element, robot: Robot) -> None:
    """Positions and velocities of links and rotors, by the names of the signals."""
    sensor = ET.SubElement(root, "sensor")
    for position, velocity in (MECHANICAL[:2], MECHANICAL[2:]):
        rigid = robot.rigid if position == "motor_position" else ()
        names = [signal_names(quantity, robot.joint_names, rigid) for quantity in (position, velocity)]
        for at, speed in zip(*names):
            ET.SubElement(sensor, "jointpos", {"name": at, "joint": at})
            ET.SubElement(sensor, "jointvel", {"name": speed, "joint": at})


def _add_home(root: ET.Element, robot: Robot, extras: Sequence[str]) -> None:
    """The equilibrium at home, with the inputs that hold it."""
    x, u = robot.operating_point(extras=tuple(name for name in extras if name != "coulomb_friction"))
    q, _, theta, _ = robot.layout.split(x)
    key = {"name": "home", "qpos": _text(np.concatenate([q, theta])), "ctrl": _text(u)}
    ET.SubElement(ET.SubElement(root, "keyframe"), "key", key)


def _text(numbers: Any) -> str:
    return " ".join(repr(float(number)) for number in np.ravel(numbers))
