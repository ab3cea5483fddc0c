"""Robots from files: TOML of our own, or a URDF or an MJCF file with the elastic data beside it.

The paper's robot: Tables 1 and 2.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from flexhinf.errors import InvalidInput
from flexhinf.plant import Penalty
from flexhinf.robot.dynamics import Joint, Placement
from flexhinf.robot.file_parts import PartsReader, assembled, own_frames, single_link_robot
from flexhinf.robot.mjcf import read_mjcf
from flexhinf.robot.parameters import Parameter
from flexhinf.robot.parts import SingleLink
from flexhinf.robot.payload import Frame, Payload
from flexhinf.robot.plausibility import check_angles, check_plausible
from flexhinf.robot.robot import Robot
from flexhinf.robot.schema import JointTable, RobotTable, check_nesting, file_error, nesting_advice
from flexhinf.robot.units import check_units, read_units
from flexhinf.robot.urdf import MOST_JOINTS, RigidArm, check_selection, read_urdf
from flexhinf.validation import checked_path, distinct, read_toml, read_xml, value_text

GRAVITY = 9.81

#: How names of MJCF files end; a URDF may end so too, its root element decides.
MJCF = (".xml", ".mjcf")


def load_robot(
    source: str | Path,
    elastic: str | Path | None = None,
    *,
    joints: Sequence[str] | None = None,
    locked: Mapping[str, float] | None = None,
    payload: str | Payload | Sequence[str | Payload] | None = None,
) -> Robot:
    """A robot from a file, or from the catalogue by name.

    Parameters
    ----------
    source : path or str
        A robot file (``arm.toml``), a URDF (``arm.urdf``), an MJCF file (``arm.xml``), or a name of `catalogue`.
    elastic : path, optional
        For a URDF or MJCF: the robot file with the spring and the motor of each joint.
    joints : sequence of str, optional
        For a URDF or MJCF: the joints that move; the others are locked. By default all that are not fixed.
    locked : mapping of str to float, optional
        For a URDF or MJCF: joints that do not move, and where they stand, rad or m.
    payload : str, Payload or sequence of these, optional
        What the robot carries, instead of the file's own payload: ``"0..3kg@hand"``, see `payload_from_text`.

    Raises
    ------
    InvalidInput
        With the file, the key, the value and what is allowed there.
    """
    check_selection(joints, locked)
    path = _found(source)
    if path.suffix.lower() == ".toml":
        if elastic is not None:
            raise InvalidInput(
                "A robot file holds the elastic data itself.",
                f"expected elastic=... beside a URDF, got it beside {path.name!r}",
                "load_robot('arm.toml'), or urdf = '…' in that file",
            )
        table, file, check = _read(path)
        if table.urdf is not None and table.mjcf is not None:
            raise InvalidInput(f"{file}: two files state the links.", "got urdf and mjcf", "one of them")
        rigid = table.urdf or table.mjcf
        if rigid is None:
            return check(_own(table, file, joints, locked, payload))
        return check(_with_urdf(table, file, _found(path.parent / rigid), joints, locked, payload))
    if elastic is None:
        raise InvalidInput(
            f"{path.name}: a URDF or an MJCF file says nothing about elastic joints.",
            "expected elastic='joints.toml', got none",
            "a TOML file with, for each joint: [[joint]] name, [joint.spring] stiffness, [joint.motor] motor_inertia",
        )
    table, file, check = _read(_found(elastic), path.suffix.lower() in MJCF)
    return check(_with_urdf(table, file, path, joints, locked, payload))


def _found(source: str | Path) -> Path:
    shipped, path = catalogue(), checked_path("The robot file", source)
    if str(source) in shipped:
        return shipped[str(source)]
    try:
        if path.is_file():
            return path
    except (OSError, ValueError):  # a name that no file can have
        pass
    close = difflib.get_close_matches(str(source), shipped, n=1)
    raise InvalidInput(
        f"There is no robot file {value_text(str(source), 120)}.",
        f"expected a file, or a name of the catalogue: {list(shipped)}",
        f"{close[0]!r}"
        if close
        else "the path of a file (.toml, .urdf, .xml), or of a report's folder where a design "
        "is meant, beginning at the working folder or at the root",
    )


def _read(path: Path, with_motors: bool = False) -> tuple[RobotTable, str, Callable[[Robot], Robot]]:
    """The tables of a file, its name, and a check of stated units; with MJCF motors, [joint.motor] may be left out."""
    from pydantic import ValidationError

    try:
        data = read_toml(path)
    except InvalidInput as error:
        if "joint" not in error.found and "overwrite" not in error.found:
            raise
        advice = f"correct that line; each joint begins with {nesting_advice()}"
        raise InvalidInput(error.what, error.found, advice) from error
    check_nesting(data, path.name)
    rows = data.get("joint")
    for row in rows if isinstance(rows, list) and (with_motors or "mjcf" in data) else ():
        if isinstance(row, dict):
            row.setdefault("motor", {})
    if isinstance(rows, list) and len(rows) > MOST_JOINTS:
        raise InvalidInput(
            f"{path.name}: there are too many joints.",
            f"expected at most {MOST_JOINTS}, got {len(rows)}",
            "one robot",
        )
    stated = read_units(data, path.name)
    try:
        table = RobotTable.model_validate(data)
    except ValidationError as error:
        raise file_error(error, path.name, data) from error
    if not table.name:
        table.name = path.stem
    return table, path.name, partial(check_units, stated, data, path.name)


# A robot file on its own --------------------------------------------------------------------------
def _own(
    table: RobotTable,
    file: str,
    chosen: Sequence[str] | None,
    locked: Mapping[str, float] | None,
    payload: Any,
) -> Robot:
    if chosen is not None or locked or table.joints is not None or table.locked:
        raise InvalidInput(
            f"{file}: joints are chosen or locked in a URDF only.",
            "expected neither joints nor locked without urdf",
            "leave the joint out of the file",
        )
    parts = PartsReader(table, file)
    joints = []
    for row in table.joint:
        check_angles(f"{file}: joint {row.name!r}", tuple(row.rpy or ()))
        placement = Placement.of(row.xyz or (0.0, 0.0, 0.0), row.rpy or (0.0, 0.0, 0.0))
        limits: Any = None if row.limits is None else tuple(row.limits)
        axis = row.axis or (0.0, 0.0, 1.0)
        joints.append(Joint(row.name, row.kind or "revolute", axis, placement, limits, row.parent))
    links: list[Any] = [parts.link(row) for row in table.joint]
    springs = [parts.elastic(row) for row in table.joint]
    common = _common(table, parts) | _limits(table.joint)
    if any(isinstance(link, SingleLink) for link in links):
        if len(joints) > 1 or table.down is not None:
            raise InvalidInput(
                f"{file}: axis_inertia is for a single link about a horizontal axis.",
                f"expected one joint and no 'down', got {len(joints)} joints",
                "mass, centre_of_mass and inertia of each link",
            )
        robot = single_link_robot(table.name, joints[0], links[0], springs[0], **common)
    else:
        down = {} if table.down is None else {"down": table.down}
        robot = assembled(table.name, joints, links, springs, **down, **common)
    robot = parts.loaded(robot, *own_frames(joints, links), payload)
    parts.check_tolerances()
    return check_plausible(robot, file)


# With a URDF --------------------------------------------------------------------------------------
def _with_urdf(
    table: RobotTable,
    file: str,
    urdf: Path,
    joints: Sequence[str] | None,
    locked: Mapping[str, float] | None,
    payload: Any,
) -> Robot:
    for row in table.joint:
        twice = [
            key for key in ("kind", "axis", "xyz", "rpy", "parent", "link") if getattr(row, key) is not None
        ]
        if twice:
            raise InvalidInput(
                f"{file}: the joint {row.name!r} states {twice[0]!r}, which the URDF states too.",
                f"expected name, spring, motor (and limits) only, got {twice}",
                f"leave it out; {urdf.name} decides",
            )
    chosen = joints if joints is not None else table.joints
    arm = _rigid(urdf, chosen, {**table.locked, **(locked or {})})
    distinct(f"{file}: the joint", [row.name for row in table.joint])
    rows = {row.name: row for row in table.joint}
    names = [joint.name for joint in arm.joints]
    unknown = [name for name in rows if name not in arm.movable]
    if unknown:
        close = difflib.get_close_matches(unknown[0], arm.movable, n=1)
        raise InvalidInput(
            f"{file}: there is no joint {unknown[0]!r} in {urdf.name}.",
            f"expected one of {list(arm.movable)}",
            f"{close[0]!r}" if close else "one of these",
        )
    missing = [name for name in names if name not in rows]
    if missing:
        raise InvalidInput(
            f"{file}: the joint {missing[0]!r} of {urdf.name} has no stiffness.",
            f"expected a [[joint]] for each of {names}, missing: {missing}",
            "add it, or lock the joint: locked = {" + f"{missing[0]} = 0.0" + "}",
        )
    kept = [rows[name] for name in names]
    placed = [
        Joint(j.name, j.kind, j.axis, j.placement, tuple(r.limits) if r.limits else j.limits, j.parent)  # type: ignore[arg-type]
        for j, r in zip(arm.joints, kept)
    ]
    parts = PartsReader(table, file)
    springs = [parts.elastic(row, arm.motors.get(row.name, {}), urdf.name) for row in kept]
    links = [parts.tolerated(link, name, urdf.name) for link, name in zip(arm.links, names)]
    direction = arm.down if table.down is None else table.down
    down: dict[str, Any] = {} if direction is None else {"down": direction}
    # <limit effort> is a torque: it says nothing about a motor whose input is a voltage or a current.
    torque_driven = springs[0].drive == "torque"
    stated = _limits(kept, arm.efforts if torque_driven else None, arm.speeds)
    robot = assembled(
        table.name, placed, links, springs, **down, **stated, **_common(table, parts, arm.gravity)
    )
    frames = {name: Frame(joint, place) for name, (joint, place) in arm.frames.items()}
    robot = parts.loaded(robot, frames, arm.tips, payload)
    parts.check_tolerances()
    return check_plausible(robot, file)


def _rigid(path: Path, joints: Sequence[str] | None, locked: Mapping[str, float]) -> RigidArm:
    """The links of a URDF or an MJCF file."""
    if path.suffix.lower() in MJCF:
        root = read_xml(path)
        if root.tag == "mujoco":
            return read_mjcf(root, path.name, joints, locked)
    return read_urdf(path, joints, locked)


# Parts --------------------------------------------------------------------------------------------
def _common(table: RobotTable, parts: PartsReader, fall: float | None = None) -> dict[str, Any]:
    penalty = None
    if table.penalty is not None:
        penalty = Penalty(table.penalty.weights, effort=table.penalty.effort)  # type: ignore[arg-type]
    usual = GRAVITY if fall is None else fall
    gravity = usual if table.gravity is None else parts.number(table.gravity, "gravity")
    return {"gravity": gravity, "penalty": penalty, "home": table.home, "description": table.description}


def _limits(
    rows: Sequence[JointTable],
    efforts: Sequence[float] | None = None,
    speeds: Sequence[float] | None = None,
) -> dict[str, Any]:
    """Limits of efforts and speeds that the rows state, over those of the URDF."""
    nothing = [None] * len(rows)
    return {
        "effort_limits": [row.effort_limit or other for row, other in zip(rows, efforts or nothing)],
        "speed_limits": [row.speed_limit or other for row, other in zip(rows, speeds or nothing)],
    }


def catalogue() -> dict[str, Path]:
    """Path of each shipped robot file by name, for `load_robot`."""
    folder = Path(__file__).parent / "catalogue"
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


TABLE_1, TABLE_2 = "Elsa & Akbari 2014, Table 1", "Elsa & Akbari 2014, Table 2"


def paper_arm() -> Robot:
    """The single-link arm of Elsa & Akbari (2014): Tables 1 and 2 with tolerances, penalty (11)."""
    return Robot(
        "paper",
        (
            Parameter("mass", 1.0, 5.0, "kg", TABLE_1),
            Parameter("stiffness", 100.0, 12.0, "N·m/rad", TABLE_1),
            Parameter("length", 1.0, 3.0, "m", TABLE_1),
            Parameter("gravity", 9.8, 1.0, "m/s²", TABLE_1),
            Parameter("link_inertia", 1.0, 4.0, "kg·m²", TABLE_1),
            Parameter("motor_inertia", 1.0, 3.0, "kg·m²", TABLE_1),
            Parameter("resistance", 10.0, 4.0, "Ω", TABLE_2),
            Parameter("inductance", 0.1, 5.0, "H", TABLE_2),
            Parameter("torque_constant", 9.0, 3.0, "N·m/A", TABLE_2),
            Parameter("back_emf_constant", 1.0, 3.0, "V·s/rad", TABLE_2),
            Parameter("friction", 0.1, 15.0, "N·m·s/rad", TABLE_2),
        ),
        Penalty({"link_position": 60.0, "link_position_integral": 300.0}, effort=10.0),
    )
