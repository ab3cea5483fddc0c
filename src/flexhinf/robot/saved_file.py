"""`Robot.save`: a robot file with other numbers; its comments, its order and everything else stay as they are."""

# Not checked strictly: tomlkit does not say what its tables hold.
# pyright: reportUnknownArgumentType=false, reportUnknownMemberType=false, reportUnknownVariableType=false

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.files import write_file
from flexhinf.plant.instruments import SENSORS
from flexhinf.robot.actuators import published_of
from flexhinf.robot.elastic import SPRING
from flexhinf.robot.gears import CURVE, SECANT
from flexhinf.robot.parameters import QUANTITIES, Parameter, payload_masses, per_joint
from flexhinf.validation import checked_path

#: A quantity's other key in the table of a link.
OTHER_KEY = {"link_inertia": "axis_inertia"}


def save_robot(robot: Any, path: str | os.PathLike[str], like: str | os.PathLike[str] | None) -> None:
    """See `Robot.save`."""
    target = checked_path("The robot file", path)
    text = robot_text(robot, target.parent, like)
    write_file(target, "robot file", lambda name: Path(name).write_text(text, encoding="utf-8"))


def robot_text(robot: Any, folder: Path, like: str | os.PathLike[str] | None = None) -> str:
    """The text of the robot's file (or of the file `like`) with its numbers, for a place in a folder."""
    import tomlkit  # here, as it takes long to load

    source = robot.file if like is None else checked_path("The robot file", like)
    if source is None or source.suffix.lower() != ".toml":
        raise InvalidInput(
            f"There is no robot file that {robot.name!r} could be written like.",
            f"expected a file that ends in .toml, got {source}",
            'like="arm.toml", the file with its springs and motors',
        )
    document = tomlkit.parse(source.read_text(encoding="utf-8"))
    before = {} if robot.reader is None else {each.name: each for each in robot.reader(source).parameters}
    for row in document.get("joint", ()):
        if row["name"] in robot.rigid and not row.get("rigid"):
            row.pop("spring", None)
            row.get("motor", {}).pop("load_friction", None)
            row["rigid"] = True
            for sensor in [each for each in row.get("sensor", ()) if SENSORS[each["kind"]].of_springs]:
                row["sensor"].remove(sensor)
            for quantity in (*SPRING, "load_friction"):
                before.pop(per_joint(quantity, str(row["name"]), len(robot.joint_names)), None)
    others = sorted(set(before) - set(robot.nominal))
    refuse_if(
        others,
        f"{source.name} states numbers that {robot.name!r} does not have.",
        f"expected those of {robot.name!r}, got {others[:5]} too",
        "a file of the same robot, or without these numbers",
    )
    moved = {name for name, stated in before.items() if _numbers(stated) != _numbers(robot[name])}
    for joint in robot.joint_names:  # another curve would be read with another secant
        stiffness, *curve = (per_joint(each, joint, len(robot.joint_names)) for each in ("stiffness", *CURVE))
        if moved & {*curve} and before[stiffness].source == SECANT:
            moved.add(stiffness)
    for parameter in robot.parameters:
        if parameter.name not in before or parameter.name in moved:
            _write(document, robot, parameter, source)
    for key in ("urdf", "mjcf"):
        if key in document:
            document[key] = os.path.relpath(source.parent / str(document[key]), folder)
    return tomlkit.dumps(document)


def _numbers(parameter: Parameter) -> tuple[float, tuple[float, float]]:
    return parameter.value, parameter.interval


def _places(document: Any, robot: Any) -> Iterator[tuple[str, Any, str]]:
    """Names of numbers that a file states by themselves, with the tables and keys where they stand."""
    if "gravity" in document:
        yield "gravity", document, "gravity"
    payloads = [parameter.name for parameter in payload_masses(robot.parameters)]
    if len(document.get("payload", ())) == len(payloads) == 1:
        yield payloads[0], document["payload"][0], "mass"
    for row in document.get("joint", ()):
        if row["name"] not in robot.joint_names:
            continue
        for kind in ("link", "spring", "motor"):
            table = row.get(kind, {})
            for quantity in QUANTITIES:
                for key in (quantity, OTHER_KEY.get(quantity, quantity)):
                    if key in table and not isinstance(table[key], list):
                        yield per_joint(quantity, str(row["name"]), len(robot.joint_names)), table, key


def _published(document: Any, robot: Any, name: str) -> Iterator[tuple[Any, str]]:
    """Table and key for a number that a joint has from its `actuator` or `gear`, or the stiffness from a curve."""
    for row in document.get("joint", ()):
        keys = {key for known in published_of(row) for key in known.numbers}
        keys |= {"stiffness"} if CURVE[0] in {*row.get("spring", {}), *keys} else set()
        for key in sorted(keys):
            if per_joint(key, str(row["name"]), len(robot.joint_names)) == name:
                yield row.setdefault("spring" if key in SPRING else "motor", {}), key


def _elsewhere(document: Any) -> bool:
    """Whether a number without a tolerance of its own may have one of a table."""
    return "tolerances" in document or any("tolerances" in row for row in document.get("joint", ()))


def _write(document: Any, robot: Any, parameter: Parameter, source: Path) -> None:
    from tomlkit import inline_table

    found = [(table, key) for name, table, key in _places(document, robot) if name == parameter.name]
    value: Any = found[0][0][found[0][1]] if found else None
    published = [] if found else list(_published(document, robot, parameter.name))
    refuse_if(
        not (found or published) or (isinstance(value, dict) and isinstance(value.get("value"), list)),
        f"{source.name} states {parameter.name!r} in no table of its own.",
        f"expected a number of a link, a spring or a motor, got {parameter.value:g}",
        "a file that states it, or this number by hand",
    )
    table, key = found[0] if found else published[0]
    ends = parameter.range
    entries = {"value": parameter.value, **({} if ends is None else {"range": list(ends)})}
    if parameter.tolerance or (ends is None and _elsewhere(document)):
        entries["tolerance"] = parameter.tolerance
    item = inline_table()
    item.update({**entries, "source": parameter.source})
    if trivia := getattr(value, "trivia", None):
        item.trivia.comment_ws, item.trivia.comment = trivia.comment_ws, trivia.comment
    table[key] = item
