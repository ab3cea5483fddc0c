"""An exported controller as a package for ROS 2: a plugin of ros2_control with its parameters."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from flexhinf import __version__
from flexhinf.codegen.c import constant
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.export.controller_c import MISSING_LIMIT, ControllerCode
from flexhinf.export.filling import fill, template
from flexhinf.export.names import distinct_names
from flexhinf.loop import Status
from flexhinf.plant import Plant
from flexhinf.plant.joints import joint_places
from flexhinf.robot.parameters import per_joint

#: Interfaces of a joint by the quantity of a signal: on the link's side those that ros2_control knows, on the motor's
#: side names of our own.
INTERFACES = {
    "link_position": "position", "link_velocity": "velocity", "motor_position": "motor_position",
    "motor_velocity": "motor_velocity", "joint_torque": "effort", "deflection": "deflection", "drive_torque": "effort",
    "motor_voltage": "voltage", "motor_current": "current", "velocity_command": "velocity",
    "position_command": "position",
}  # fmt: skip

#: Numbers of the published health before the bits of the status.
HEALTH = ("code", "status", "path_rate", "late_samples", "missed_writes", "stopped")

#: Files of the package, of which NAME is the controller's name and PACKAGE the package's, and their templates.
FILES = {
    "package.xml": "package.xml", "PACKAGE.xml": "plugin.xml", "CMakeLists.txt": "CMakeLists.txt",
    "config/PACKAGE.yaml": "controller.yaml", "include/PACKAGE/controller.hpp": "controller.hpp",
    "src/controller.cpp": "controller.cpp",
}  # fmt: skip

#: The start of a controller whose model tells what rests.
FROM_POSE = """  std::array<@NAME@_real, JOINTS> q{};
  std::array<@NAME@_real, @BIG@_STATES + @BIG@_INPUTS> rest{};
  std::array<bool, JOINTS> by_motor{};
  for (std::size_t i = 0; i < JOINTS; ++i) {
    const int link = LINK_MEASURED[i], motor = MOTOR_MEASURED[i];
    by_motor[i] = link < 0 || !std::isfinite(input_.y[link]);
    const int place = by_motor[i] ? motor : link;
    if (place < 0 || !std::isfinite(input_.y[place])) {
      return false;
    }
    q[i] = input_.y[place];
  }
  // The weight twists the spring between a motor and its link: the link's angle is found in some passes.
  const int passes = std::find(by_motor.begin(), by_motor.end(), true) == by_motor.end() ? 1 : 50;
  for (int pass = 0; pass < passes; ++pass) {
    @NAME@_rest(&param_, q.data(), rest.data());
    for (std::size_t i = 0; i < JOINTS; ++i) {
      q[i] += by_motor[i] ? input_.y[MOTOR_MEASURED[i]] - rest[MOTOR_STATE[i]] : 0;
    }
  }
  if (!std::all_of(rest.begin(), rest.end(), [](double value) { return std::isfinite(value); })) {
    return false;
  }
@COMMAND@
  return @NAME@_start(&state_, &param_, rest.data(), rest.data() + @BIG@_STATES) == @BIG@_OK;"""

#: The start of another one, which feeds back what is measured, or begins where its header says.
AS_DESIGNED = """@COMMAND@
  return @NAME@_init(&state_) == @BIG@_OK;"""

#: How a motion becomes a slower one: at rate 0 it rests.
SLOWER = "  (void)@NAME@_slowed(&param_, output_.path_rate, input_.r);"


def package_name(code: ControllerCode) -> str:
    """Name of the package: ROS 2 wants small letters."""
    return f"{code.name.lower()}_controller"


def ros2_files(code: ControllerCode, home: np.ndarray) -> dict[str, str]:
    """The files of the package, relative path to text.

    `home`: The command where the controller has no better one, (k,) or shorter.

    Raises InvalidInput: if two measurements, or two inputs, would have one interface.
    """
    c, package = code.controller, package_name(code)
    names = {kind: _identifiers(signals) for kind, signals in code.signals.items()}
    interfaces = {kind: _interfaces(code, kind) for kind in "YU"}
    standstill = _StandstillModel.of(code)
    health = [*HEALTH, *(str(bit.name).lower() for bit in Status)]
    values = [f"static_cast<double>((output_.status & {code.upper(str(bit.name))}) != 0)" for bit in Status]
    health += [f"unseen.{name}" for name in names["Y"]]
    values += [f"static_cast<double>(output_.unseen[{k}])" for k in range(len(names["Y"]))]
    if code.doubt is not None:
        health, values = [*health, "doubtful"], [*values, "static_cast<double>(output_.doubtful)"]
    if code.rejected is not None:
        health += [f"rejected.{name}" for name in names["Y"]]
        values += [f"static_cast<double>(output_.rejected[{k}])" for k in range(len(names["Y"]))]
    sources = ["src/controller.cpp", f"src/{code.name}.c"]
    files = {f"src/{path}": text for path, text in code.files.items()}
    marks = {
        "LONGEST_UNSEEN": MISSING_LIMIT, "PACKAGE": package, "PACKAGE_BIG": package.upper(), "VERSION": __version__,
        "PACKAGE_VERSION": ".".join([*re.findall(r"\d+", __version__), "0", "0"][:3]),
        "PERIOD_TEXT": f"{c.period:g}", "PERIOD_YAML": _yaml(c.period), "RATE": round(1.0 / c.period),
        "SOURCES": "\n".join(f"  {file}" for file in sources), "R": code.sizes["r"],
        "MEASURED": _quoted(names["Y"]), "INPUTS": _quoted(names["U"]), "STATES": _quoted(names["X"]),
        "HEALTH": _quoted(health), "HEALTH_COUNT": len(health),
        "HEALTH_VALUES": "".join(f",\n    {value}" for value in values),
        **_start_marks(code, standstill, home),
    }  # fmt: skip
    for path, file in FILES.items():
        listed = path.endswith("yaml")
        own = {name: value for name, value in marks.items() if name != "INPUTS" or not listed}
        users = {
            "STATE_INTERFACES": _quoted(interfaces["Y"]), "COMMAND_INTERFACES": _quoted(interfaces["U"]),
            "MEASUREMENTS": _parameters(code, "Y", names["Y"], interfaces["Y"]),
            "INPUTS": _limited(code, names["U"], interfaces["U"]),
        }  # fmt: skip
        text = template(f"ros2/{file}")
        for _ in range(2):  # parts that have marks of their own come first
            text = fill(text, code.name, code.real, **own)
        files[path.replace("PACKAGE", package)] = fill(text, code.name, code.real, users)
    return {f"ros2/{path}": text for path, text in files.items()}


def _identifiers(signals: Sequence[str]) -> list[str]:
    """Names of signals for parameters, each once."""
    return distinct_names([re.sub(r"[^A-Za-z0-9_]+", "_", name) for name in signals])


def _interfaces(code: ControllerCode, kind: str) -> list[str]:
    """Usual interfaces of signals, with the names of the joints as the robot has them: ``elbow/position`` of
    link_position_elbow. The only joint of no known robot is called joint."""
    signals, joints = code.signals[kind], () if code.robot is None else code.robot.joint_names
    known = {
        per_joint(q, joint, len(joints)): f"{joint}/{INTERFACES[q]}" for q in INTERFACES for joint in joints
    }
    found = []
    for name in signals:
        quantity = next((q for q in INTERFACES if name == q or name.startswith(f"{q}_")), None)
        joint = name.removeprefix(quantity or "").removeprefix("_") or "joint"
        found.append(
            known.get(name, f"{name}/value" if quantity is None else f"{joint}/{INTERFACES[quantity]}")
        )
    for k, interface in enumerate(found):
        refuse_if(
            interface in found[:k], f"Two signals would have the interface {interface!r} in ROS 2.",
            f"expected an interface for each, got {signals[found.index(interface)]!r} and {signals[k]!r}",
            "other names of the joints, or one of the two signals",
        )  # fmt: skip
    return found


def _quoted(texts: Sequence[str]) -> str:
    """Texts between quotes, for C++ and YAML."""
    return ", ".join(json.dumps(text, ensure_ascii=False) for text in texts)


def _yaml(value: float) -> str:
    """A number that every reader of YAML takes for one that is not whole."""
    if not np.isfinite(value):
        return "-.inf" if value < 0 else ".inf"
    text = repr(float(value))
    return text if "." in text else text.replace("e", ".0e")


def _parameters(code: ControllerCode, kind: str, names: Sequence[str], interfaces: Sequence[str]) -> str:
    lines = []
    for signal, name, interface in zip(code.signals[kind], names, interfaces, strict=True):
        unit = code.unit_text(signal)
        lines += [
            f"      {name}:" + (f"  # {unit}" if unit else ""), f"        interface: {_quoted([interface])}",
            "        factor: 1.0",
        ]  # fmt: skip
    return "\n".join(lines)


def _limited(code: ControllerCode, names: Sequence[str], interfaces: Sequence[str]) -> str:
    text = _parameters(code, "U", names, interfaces).split("        factor: 1.0")
    limits = code.controller.limits
    ends = [
        f"        factor: 1.0\n        lower: {_yaml(low)}\n        upper: {_yaml(high)}"
        for low, high in zip(np.ravel(limits.lower), np.ravel(limits.upper), strict=True)
    ]
    return "".join(part + end for part, end in zip(text, [*ends, ""], strict=True))


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


def _start_marks(
    code: ControllerCode, standstill: _StandstillModel | None, home: np.ndarray
) -> dict[str, Any]:
    """Marks of the start: what the command is there, and how the state is found."""
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
    lines = [f"  input_.r[{k}] = {text};" for k, text in enumerate(command)]
    if standstill is not None and c.mode.moving:
        lines = ["  std::copy(rest.begin(), rest.end(), input_.r);"]
    elif code.rests:
        lines.append("  @NAME@_rest(&param_, input_.r, input_.r);")
    places = [] if standstill is None else list(zip(standstill.links, standstill.motors, strict=True))

    def among(names: Sequence[str]) -> str:
        return ", ".join(str(measured.index(name) if name in measured else -1) for name in names)

    states = () if standstill is None else standstill.plant.states
    return {
        "START": AS_DESIGNED if standstill is None else FROM_POSE, "COMMAND": "\n".join(lines),
        "SLOWER": SLOWER if code.slows else "", "JOINTS": len(places),
        "LINK_MEASURED": among([states[link] for link, _ in places]),
        "MOTOR_MEASURED": among([states[motor] for _, motor in places]),
        "MOTOR_STATE": ", ".join(str(motor) for _, motor in places),
    }  # fmt: skip
