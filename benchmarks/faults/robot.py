"""The numbers of a robot, read from the text of its file, as the source that `plant.c` is compiled with.

Nothing of flexhinf reads the file: keys and their meaning are those of docs/robots.md. What `plant.c` has no part for
is refused by name.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.faults.links import Body, RigidJoint, read_urdf, turned

__all__ = ["DRIVES", "MOST", "Interval", "Robot", "read_robot", "source"]

#: Joints that `plant.c` has room for.
MOST = 7
#: What drives take, in the order of `plant.h`.
DRIVES = ("torque", "current", "voltage", "velocity", "position")
#: What keys are to be multiplied with where a text states such a unit; rad/s of a bandwidth in Hz.
UNITS = {
    "": 1.0, "%": 1.0, "rad": 1.0, "m": 1.0, "s": 1.0, "kg": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "mrad": 1e-3,
    "mm": 1e-3, "g": 1e-3, "deg": math.pi / 180.0, "°": math.pi / 180.0, "deg/s": math.pi / 180.0, "Hz": 2.0 * math.pi,
    "mH": 1e-3, "rad/s": 1.0, "m/s": 1.0, "Nm": 1.0, "N·m": 1.0, "V": 1.0, "A": 1.0, "kN·m/rad": 1e3, "kNm/rad": 1e3,
    "N·m/rad": 1.0, "Nm/rad": 1.0,
}  # fmt: skip
#: Keys of a joint, its spring and its motor that `plant.c` has no part for.
WITHOUT = ("gear", "actuator", "rigid", "coupling", "first_stiffness", "second_stiffness", "third_stiffness",
           "kinematic_error", "torque_ripple")  # fmt: skip
#: Numbers whose tolerance in a table [tolerances] has another name.
KEYS = {"rotor_inertia": "motor_inertia", "axis_inertia": "inertia", "length": "centre_of_mass"}
#: Of the pendulum: the mass is so many times as large, and its distance from the axis as many times smaller, so that
#: its inertia about the axis is a number of its own, as the file states it.
LEVER = 100.0


@dataclass(frozen=True)
class Interval:
    """A number, with its lowest and its highest value."""

    value: float
    low: float
    high: float

    @staticmethod
    def of(value: float) -> Interval:
        """A number without a tolerance."""
        return Interval(value, value, value)

    def __mul__(self, other: Interval | float) -> Interval:
        factor = other if isinstance(other, Interval) else Interval.of(other)
        ends = [a * b for a in (self.low, self.high) for b in (factor.low, factor.high)]
        return Interval(self.value * factor.value, min(ends), max(ends))

    def __add__(self, other: Interval) -> Interval:
        return Interval(self.value + other.value, self.low + other.low, self.high + other.high)


@dataclass(frozen=True)
class Robot:
    """Names of the joints, what the drives take, the link with the payload (−1: none), each joint's parent and whether
    it slides; and the fields of ``plant_numbers``, each with one row of numbers a joint."""

    joints: tuple[str, ...]
    drive: str
    loaded: int
    parents: tuple[int, ...]
    slides: tuple[bool, ...]
    home: tuple[float, ...]
    fields: Mapping[str, Sequence[Sequence[Interval]]]

    def nominal(self, field: str) -> np.ndarray:
        """The numbers of a field, (rows, columns) or (rows,)."""
        rows = np.array([[number.value for number in row] for row in self.fields[field]])
        return rows[:, 0] if rows.shape[1] == 1 else rows


def number_in(value: Any) -> float:
    """A number, or text of one with a unit of `UNITS`; ValueError otherwise."""
    if isinstance(value, str):
        found = re.fullmatch(r"\s*([-+]?[0-9.]+(?:[eE][-+]?\d+)?)\s*(\S*)\s*", value)
        if not found or found[2] not in UNITS:
            raise ValueError(f"expected a number in SI units, or one of {sorted(UNITS)}, got {value!r}")
        return float(found[1]) * UNITS[found[2]]
    return float(value)


class _File:
    """A robot file, whose numbers take their tolerance from themselves, their joint, or the whole file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.data: dict[str, Any] = tomllib.loads(path.read_text(encoding="utf-8"))

    def interval(
        self, joint: Mapping[str, Any], table: Mapping[str, Any], key: str, usual: float
    ) -> Interval:
        """A number of a joint's table."""
        return self.interval_of(joint, table.get(key, usual), key)

    def interval_of(self, joint: Mapping[str, Any], stated: Any, key: str) -> Interval:
        """A number as it is stated: alone, or with its tolerance or range."""
        row = stated if isinstance(stated, dict) else {"value": stated}
        value = number_in(row["value"])
        if "range" in row:
            low, high = map(number_in, row["range"])
            return Interval(value, low, high)
        if math.isinf(value):
            return Interval.of(value)
        part = 0.01 * self.tolerance(joint, row, key) * abs(value)
        return Interval(value, value - part, value + part)

    def tolerance(self, joint: Mapping[str, Any], row: Mapping[str, Any], key: str) -> float:
        """Per cent."""
        name = KEYS.get(key, key)
        tables = (joint.get("tolerances", {}), self.data.get("tolerances", {}))
        return number_in(
            next((t[k] for t, k in ((row, "tolerance"), *((t, name) for t in tables)) if k in t), 0.0)
        )

    def vector(self, joint: Mapping[str, Any], stated: Any, key: str) -> list[Interval]:
        """Three numbers with one tolerance."""
        row = stated if isinstance(stated, dict) else {"value": stated}
        return [self.interval_of(joint, {**row, "value": part}, key) for part in row["value"]]


def read_robot(path: Path, brakes: bool = True) -> Robot:
    """The robot of a TOML file, with the links of the URDF that it names; `brakes` of joints that do not say so."""
    file = _File(path)
    rows: list[dict[str, Any]] = file.data["joint"]
    if len(rows) > MOST:
        raise ValueError(f"{path.name}: expected at most {MOST} joints, got {len(rows)}")
    for row in rows:
        for table in (row, row.get("spring", {}), row.get("motor", {})):
            for key in (key for key in WITHOUT if table.get(key)):
                raise ValueError(
                    f"{path.name}: joint {row['name']!r} states {key!r}, which plant.c has no part for"
                )
    if "urdf" in file.data:
        order = file.data.get("joints") or [row["name"] for row in rows]
        rigid = read_urdf(path.parent / file.data["urdf"], list(order))
        rows = sorted(rows, key=lambda row: list(order).index(row["name"]))
    else:
        rigid = [_joint(file, rows, k) for k in range(len(rows))]
    fields = _geometry(file, rows, rigid) | _springs(file, rows) | _limits(rows, rigid, brakes)
    drive, motors = _motors(file, rows)
    loaded, payload = _payload(file, rigid)
    home = file.data.get("home") or [0.0] * len(rows)
    return Robot(
        tuple(row["name"] for row in rows), drive, loaded, tuple(joint.parent for joint in rigid),
        tuple(joint.slides for joint in rigid), tuple(map(number_in, home)), fields | motors | payload,
    )  # fmt: skip


# Links ----------------------------------------------------------------------------------------------
def _joint(file: _File, rows: list[dict[str, Any]], k: int) -> RigidJoint:
    row, names = rows[k], [other["name"] for other in rows]
    parent = row.get("parent")
    axis = np.array(row.get("axis", [0.0, 0.0, 1.0]), dtype=float)
    limits = row.get("limits")
    return RigidJoint(
        row["name"], k - 1 if parent is None else -1 if parent == "world" else names.index(parent),
        row.get("kind") == "prismatic", axis / np.linalg.norm(axis),
        turned([number_in(angle) for angle in row.get("rpy", [0.0] * 3)]),
        np.array([number_in(x) for x in row.get("xyz", [0.0] * 3)]),
        None if limits is None else (number_in(limits[0]), number_in(limits[1])), body=_body(file, row),
    )  # fmt: skip


def _body(file: _File, row: dict[str, Any]) -> Body:
    """The link of a TOML file; one that states its inertia about the axis becomes a heavy point near the axis."""
    link = row["link"]
    if "axis_inertia" in link:
        about, mass, length = (
            file.interval(row, link, key, 0.0).value for key in ("axis_inertia", "mass", "length")
        )
        heavy, near = LEVER * mass, length / LEVER
        return Body(heavy, np.array([near, 0.0, 0.0]), np.diag([1.0, 1.0, about - heavy * near**2]))
    moments = link["inertia"]
    xx, xy, xz, yy, yz, zz = (number_in(moments.get(k, 0.0)) for k in ("xx", "xy", "xz", "yy", "yz", "zz"))
    mass = file.interval(row, link, "mass", 0.0).value
    centre = [number.value for number in file.vector(row, link["centre_of_mass"], "centre_of_mass")]
    return Body(mass, np.array(centre), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))


def _geometry(file: _File, rows: list[dict[str, Any]], rigid: list[RigidJoint]) -> dict[str, Any]:
    single = "axis_inertia" in rows[0].get("link", {})
    down = np.array(file.data.get("down", [1.0, 0.0, 0.0] if single else [0.0, 0.0, -1.0]), dtype=float)
    size = file.interval({}, file.data, "gravity", 9.81)
    fields: dict[str, list[list[Interval]]] = {
        "gravity": [[size * float(part)] for part in down / np.linalg.norm(down)],
        "rotation": [[Interval.of(x) for x in joint.rotation.ravel()] for joint in rigid],
        "offset": [[Interval.of(x) for x in joint.offset] for joint in rigid],
        "axis": [[Interval.of(x) for x in joint.axis] for joint in rigid],
        "mass": [], "centre": [], "inertia": [], "inertia_scale": [],
    }  # fmt: skip
    for row, joint in zip(rows, rigid):
        link, body = row.get("link", {}), joint.body
        mass, centre = link.get("mass", body.mass), link.get("length", link.get("centre_of_mass"))
        about = link.get("axis_inertia", link.get("inertia", {}))
        parts = [
            0.01 * file.tolerance(row, stated if isinstance(stated, dict) else {}, key)
            for stated, key in ((mass, "mass"), (centre, "centre_of_mass"), (about, "inertia"))
        ]
        own = [Interval(1.0, 1.0 - part, 1.0 + part) for part in parts]
        fields["mass"].append([own[0] * body.mass])
        fields["centre"].append([own[1] * float(x) for x in body.centre])
        fields["inertia"].append(
            [Interval.of(body.inertia[i, j]) for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))]
        )
        fields["inertia_scale"].append([own[2]])
    return fields


def _payload(file: _File, rigid: list[RigidJoint]) -> tuple[int, dict[str, Any]]:
    """What the arm carries, at the last link where the file names none; twice as far as that link's centre of mass."""
    stated = file.data.get("payload", [])
    if len(stated) > 1:
        raise ValueError(f"{file.path.name}: expected one payload, got {len(stated)}")
    row: dict[str, Any] = stated[0] if stated else {"mass": 0.0}
    carriers = {name: k for k, joint in enumerate(rigid) for name in (joint.name, *joint.carries)}
    k = carriers.get(row.get("at", ""), len(rigid) - 1)
    place = rigid[k].carries.get(row.get("at", ""), (np.eye(3), np.zeros(3)))
    own = row.get("centre_of_mass")
    centre = 2.0 * rigid[k].body.centre if own is None else place[0] @ [number_in(x) for x in own] + place[1]
    if own is None and rigid[k].body.mass and "axis_inertia" in file.data["joint"][k].get("link", {}):
        centre = centre * LEVER
    mass = file.interval({}, row, "mass", 0.0)
    x = np.zeros(3)
    if "sphere" in row:
        x = np.full(3, 0.4 * number_in(row["sphere"]) ** 2)
    elif "box" in row:
        a, b, c = (number_in(size) ** 2 / 12.0 for size in row["box"])
        x = np.array([b + c, a + c, a + b])
    elif "cylinder" in row:
        radius, height = map(number_in, row["cylinder"])
        side = radius**2 / 4.0 + height**2 / 12.0
        x = np.array([side, side, radius**2 / 2.0])
    elif "inertia" in row:
        x = np.array([number_in(row["inertia"][key]) for key in ("xx", "yy", "zz")]) / max(mass.value, 1e-9)
    moments = place[0] @ np.diag(x) @ place[0].T
    places = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    return k, {
        "payload": [[mass]], "payload_centre": [[Interval.of(x)] for x in centre],
        "payload_inertia": [[Interval.of(moments[i, j])] for i, j in places],
    }  # fmt: skip


# Joints ---------------------------------------------------------------------------------------------
def _springs(file: _File, rows: list[dict[str, Any]]) -> dict[str, Any]:
    keys = {
        "stiffness": "stiffness",
        "damping": "damping",
        "hardening": "spring_hardening",
        "backlash": "backlash",
    }
    return {
        field: [[file.interval(row, row["spring"], key, 0.0)] for row in rows] for field, key in keys.items()
    }


def _motors(file: _File, rows: list[dict[str, Any]]) -> tuple[str, dict[str, Any]]:
    """What the drives take, and the motors' numbers at the joints."""
    fields = {
        name: list[list[Interval]]()
        for name in (
            "motor_inertia", "friction", "coulomb", "stiction", "stribeck", "load_friction", "resistance", "inductance",
            "torque_constant", "back_emf", "drive_stiffness", "drive_damping", "load_share", "drive_limit",
        )
    }  # fmt: skip
    drives = set[str]()
    for row in rows:
        motor = row.get("motor", {})
        drive = motor.get("drive") or (
            "voltage" if "resistance" in motor else "current" if "torque_constant" in motor else "torque"
        )
        drives.add(drive)
        for name, number in _motor(file, row, motor, drive).items():
            fields[name].append([number])
    if len(drives) > 1:
        raise ValueError(f"{file.path.name}: expected drives of one kind, got {sorted(drives)}")
    return drives.pop(), fields


def _motor(file: _File, row: dict[str, Any], motor: dict[str, Any], drive: str) -> dict[str, Interval]:
    def of(key: str, usual: float) -> Interval:
        return file.interval(row, motor, key, usual)

    ratio = of("gear_ratio", 1.0)
    inertia = (
        of("motor_inertia", 0.0)
        if "motor_inertia" in motor
        else ratio * ratio * of("rotor_inertia", 0.0) + of("hub_inertia", 0.0)
    )
    coulomb = of("coulomb_friction", 0.0)
    given = drive in ("voltage", "current")
    found = {
        "motor_inertia": inertia, "friction": of("friction", 0.0), "coulomb": coulomb,
        "stiction": of("static_friction", 0.0) if "static_friction" in motor else coulomb,
        "stribeck": of("stribeck_velocity", 0.1), "load_friction": of("load_friction", 0.0),
        "resistance": of("resistance", 1.0), "inductance": of("inductance", 0.0),
        "torque_constant": of("torque_constant", 1.0) * ratio * of("gear_efficiency", 1.0) * of("motor_efficiency", 1.0)
        if given else Interval.of(1.0),
        "back_emf": of("back_emf_constant", 0.0) * ratio if drive == "voltage" else Interval.of(0.0),
        "drive_limit": of("drive_torque_limit", math.inf), "load_share": of("load_share", 1.0),
    }  # fmt: skip
    rate, own = of("drive_bandwidth", 0.0), Interval.of(inertia.value)  # a drive is set for the nominal rotor
    half = Interval.of(0.5) if drive == "velocity" else of("drive_damping_ratio", 1.0)
    gains = {"drive_stiffness": own * rate * rate, "drive_damping": own * rate * half * 2.0}
    return found | {name: of(name, 0.0) if name in motor else gain for name, gain in gains.items()}


def _limits(rows: list[dict[str, Any]], rigid: list[RigidJoint], brakes: bool) -> dict[str, Any]:
    """Ends of the range, largest speed and command; 0 where none is stated, and for `largest` and `brake`, which the
    runner computes: a brake of −1 is none."""
    fields = {
        name: list[list[Interval]]()
        for name in ("lower", "upper", "speed_limit", "effort_limit", "largest", "brake")
    }
    for row, joint in zip(rows, rigid):
        ends = row.get("limits", joint.limits) or (-math.inf, math.inf)
        numbers = {
            "lower": number_in(ends[0]), "upper": number_in(ends[1]),
            "speed_limit": number_in(row.get("speed_limit", joint.speed or 0.0)),
            "effort_limit": number_in(row.get("effort_limit", joint.effort or 0.0)),
            "largest": 0.0, "brake": 0.0 if row.get("brakes", brakes) else -1.0,
        }  # fmt: skip
        for name, number in numbers.items():
            fields[name].append([Interval.of(number)])
    return fields


# Source ---------------------------------------------------------------------------------------------
#: Fields in which numbers stand one behind the other instead of in rows of joints.
FLAT = ("gravity", "payload", "payload_centre", "payload_inertia")


def _row(numbers: Sequence[float]) -> str:
    return ", ".join(
        ("-" if number < 0.0 else "") + "HUGE_VAL" if math.isinf(number) else repr(float(number))
        for number in numbers
    )


def _model(robot: Robot, end: str) -> str:
    lines = [
        f"    .n = {len(robot.joints)}, .drive = {robot.drive.upper()}, .loaded = {robot.loaded},",
        f"    .parent = {{{', '.join(map(str, robot.parents))}}},",
        f"    .slides = {{{', '.join(str(int(slides)) for slides in robot.slides)}}},",
    ]
    for name, rows in robot.fields.items():
        numbers = [[getattr(number, end) for number in row] for row in rows]
        if name == "payload":
            lines.append(f"    .is.payload = {_row(numbers[0])},")
        elif name in FLAT or len(numbers[0]) == 1:
            lines.append(f"    .is.{name} = {{{_row([row[0] for row in numbers])}}},")
        else:
            lines.append(f"    .is.{name} = {{{', '.join(f'{{{_row(row)}}}' for row in numbers)}}},")
    return "\n".join(lines)


def source(robot: Robot) -> str:
    """C of three models: NOMINAL, LOWEST and HIGHEST, and of HOME."""
    models = "\n".join(
        f"plant_model {name} = {{\n{_model(robot, end)}\n}};"
        for name, end in (("NOMINAL", "value"), ("LOWEST", "low"), ("HIGHEST", "high"))
    )
    return f'#include "plant.h"\n\n#include <math.h>\n\n{models}\nconst double HOME[] = {{{_row(robot.home)}}};\n'
