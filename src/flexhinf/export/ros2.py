"""An exported controller as a package for ROS 2: a plugin of ros2_control with its parameters."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

import numpy as np
from markupsafe import Markup

from flexhinf import __version__
from flexhinf.codegen.c import constant
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.export.controller_c import ControllerCode
from flexhinf.export.follow import REASONS, TEXTS, follower_of
from flexhinf.export.ros2_description import Commanded, Measured, description_values, initial_values
from flexhinf.export.ros_state import HEALTH, health_names, identifiers
from flexhinf.loop import Status
from flexhinf.plant import Plant
from flexhinf.plant.instruments import SENSORS
from flexhinf.plant.joints import coupling_of, joint_places
from flexhinf.robot.drives import DRIVES
from flexhinf.robot.parameters import per_joint
from flexhinf.stops import STOPS, Stop


def package_name(code: ControllerCode) -> str:
    """Name of the package: ROS 2 wants small letters."""
    return f"{code.name.lower()}_controller"


def ros2_values(code: ControllerCode, home: np.ndarray) -> dict[str, object]:
    """What the templates of the package need.

    `home`: The command where the controller has no better one, (k,) or shorter.

    Raises InvalidInput: if two measurements, or two inputs, would have one interface.
    """
    limits = code.controller.limits
    command = dict(zip(code.controller.commanded, map(float, home), strict=False))
    rests = initial_values(code.signals["Y"], command)
    measurements = [
        Measured(*signal, initial) for signal, initial in zip(_described(code, "Y"), rests, strict=True)
    ]
    ends = np.ravel(limits.lower).tolist(), np.ravel(limits.upper).tolist()
    inputs = [Commanded(*signal, *pair) for signal, *pair in zip(_described(code, "U"), *ends, strict=True)]
    return {
        "package": package_name(code),
        "PACKAGE": package_name(code).upper(),
        "package_version": ".".join([*re.findall(r"\d+", __version__), "0", "0"][:3]),
        "measurements": measurements,
        "inputs": inputs,
        "states": identifiers(code.signals["X"]),
        "joint_names": [] if code.robot is None else list(code.robot.joint_names),
        **description_values(code, measurements, inputs),
        "paths": _paths(code),
        "texts": [(code.name, text) for code, text in TEXTS.items()],
        "reasons": [(reason.name, text) for reason, text in REASONS.items()],
        "health": _health(code),
        **_stop_values(code),
        "references": _references(code),
        **_start_values(code, _StandstillModel.of(code), home),
    }


def _stop_values(code: ControllerCode) -> dict[str, object]:
    """What stops the robot by default, and what else of that an export can be told."""
    _, bits, category = code.whole_numbers
    names = {stop: str(stop.name).lower() for stop in Stop}
    return {
        "stop_reasons": [
            (code.upper(f"STOP_{stop.name}"), name, STOPS[name].says) for stop, name in names.items()
        ],
        "stop_names": [*names.values()],
        "stop_on": [name for stop, name in names.items() if stop & bits] or [""],
        "category": category,
        "protected": code.controller.protection is not None,
        "stamped": code.controller.mode.checks_measurements,
    }


def _paths(code: ControllerCode) -> list[tuple[str, float]]:
    """Joints with their path tolerances, rad or m; 0 is any."""
    follower = follower_of(code)
    return [] if follower is None else list(zip(follower.robot.joint_names, follower.usual[0, 0].tolist()))


def _references(code: ControllerCode) -> list[str]:
    """Interfaces that another controller may command: positions and velocities of the joints along a trajectory, or
    each number of the command."""
    if follower_of(code) is not None and code.robot is not None:
        return [f"{joint}/{kind}" for kind in ("position", "velocity") for joint in code.robot.joint_names]
    names = code.controller.commanded
    usual = _usual_interfaces(code, names)
    return [one if usual.count(one) == 1 else f"{name}/value" for name, one in zip(names, usual, strict=True)]


def _health(code: ControllerCode) -> list[dict[str, str]]:
    """Names of the published numbers, and in C++ the values of those behind `HEALTH`."""
    bits = {int(bit): code.upper(str(bit.name)) for bit in Status}
    stops = {int(stop): code.upper(f"STOP_{stop.name}") for stop in Stop}

    def value(kind: str, place: int) -> str:
        if kind == "status_bit":
            return f"static_cast<double>((output_.status & {bits[place]}) != 0)"
        if kind == "stop_bit":
            return f"static_cast<double>((output_.stop & {stops[place]}) != 0)"
        if kind == "doubtful":
            return "static_cast<double>(output_.doubtful)"
        return "" if kind in HEALTH else f"static_cast<double>(output_.{kind}[{place}])"

    return [{"name": name, "value": Markup(value(kind, place))} for name, kind, place in health_names(code)]


def _usual_interfaces(code: ControllerCode, signals: Sequence[str]) -> list[str]:
    """Usual interfaces of signals, with the names of the joints as the robot has them: ``elbow/position`` of
    link_position_elbow. The only joint of no known robot is called joint."""
    joints: Sequence[str] = () if code.robot is None else code.robot.joint_names
    usual = {name: kind.interface for name, kind in SENSORS.items()}
    usual |= {kind.quantity: kind.interface for kind in DRIVES.values()}
    known = {per_joint(q, joint, len(joints)): f"{joint}/{usual[q]}" for q in usual for joint in joints}
    found: list[str] = []
    for name in signals:
        quantity = next((q for q in usual if name == q or name.startswith(f"{q}_")), None)
        joint = name.removeprefix(quantity or "").removeprefix("_") or "joint"
        found.append(known.get(name, f"{name}/value" if quantity is None else f"{joint}/{usual[quantity]}"))
    return found


def _described(code: ControllerCode, kind: str) -> Iterator[tuple[str, str, str]]:
    """Name, interface and unit of each signal of a kind."""
    signals = code.signals[kind]
    units = [code.unit_text(signal) for signal in signals]
    return zip(identifiers(signals), _interfaces(code, kind), units, strict=True)


def _interfaces(code: ControllerCode, kind: str) -> list[str]:
    """Those of measurements or inputs, each of which must have one of its own."""
    signals = code.signals[kind]
    found = _usual_interfaces(code, signals)
    for k, interface in enumerate(found):
        refuse_if(
            interface in found[:k],
            f"Two signals would have the interface {interface!r} in ROS 2.",
            f"expected an interface for each, got {signals[found.index(interface)]!r} and {signals[k]!r}",
            "other names of the joints, or one of the two signals",
        )
    return found


class _StandstillModel:
    """What tells the robot's state at rest: places of links and motors among states and measurements.

    `links`, `motors`: (n,), places among the states.
    """

    def __init__(self, plant: Plant, links: Sequence[int], motors: Sequence[int]) -> None:
        self.plant, self.links, self.motors = plant, links, motors

    @classmethod
    def of(cls, code: ControllerCode) -> _StandstillModel | None:
        """None where no model tells it, the estimate cannot be set, or a joint's position is not measured."""
        estimator = code.controller.estimator
        if estimator is None or not code.starts_anywhere or not estimator.plant.parameters.size:
            return None
        plant = estimator.plant
        try:
            links, _, motors, _ = (row.tolist() for row in joint_places(plant))
        except InvalidInput:
            return None
        measured = set(code.signals["Y"])
        observed = all(
            {plant.states[k], plant.states[j]} & measured for k, j in zip(links, motors, strict=True)
        )
        return cls(plant, links, motors) if code.standstill is not None and observed else None


def _start_values(
    code: ControllerCode, standstill: _StandstillModel | None, home: np.ndarray
) -> dict[str, object]:
    """What the start needs: what the command is there, and how the state is found."""
    c, measured = code.controller, list(code.signals["Y"])
    at = [*home, *np.zeros(code.sizes["r"])][: code.sizes["r"]]
    command = [constant(float(value), code.real) for value in at]
    if standstill is not None and not c.mode.moving:
        states = standstill.plant.states
        command = [
            f"rest[{states.index(name)}]" if name in states else text
            for name, text in zip(c.commanded, command, strict=False)
        ]
    elif c.estimator is None and not c.mode.moving:
        command = [
            f"input_.y[{measured.index(name)}]" if name in measured else text
            for name, text in zip(c.commanded, command, strict=False)
        ]
    joints: list[dict[str, int]] = []
    if standstill is not None:
        place = {name: measured.index(name) if name in measured else -1 for name in standstill.plant.states}
        for link, motor in zip(standstill.links, standstill.motors, strict=True):
            at_link, at_motor = (place[standstill.plant.states[k]] for k in (link, motor))
            joints.append({"link_measured": at_link, "motor_measured": at_motor, "motor_state": motor})
    turned = None if standstill is None else coupling_of(standstill.plant)
    back = [] if turned is None else [constant(x, code.real) for x in np.linalg.inv(turned).ravel().tolist()]
    return {
        "from_pose": standstill is not None,
        "command": [*map(Markup, command)],
        "joints": joints,
        "back": [*map(Markup, back)],
    }
