"""Robots by the path of a file, or by a name of the catalogue."""

from __future__ import annotations

import shlex
import warnings
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from importlib.metadata import EntryPoint, entry_points
from itertools import islice
from pathlib import Path
from typing import Any

from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.plant import Penalty
from flexhinf.robot.arm import Payload
from flexhinf.robot.parameters import Parameter
from flexhinf.robot.parts import RobotFileWarning
from flexhinf.robot.rigid_arm import check_selection
from flexhinf.robot.robot import Robot
from flexhinf.robot.toml_file import MJCF, RobotFile
from flexhinf.validation import checked_path, is_file, nearest, value_text

#: Entry points by which other packages read further formats: the name is a file's ending without its dot, and the
#: reader is called as `load_robot` and returns a robot.
FORMATS = "flexhinf.robot_formats"


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
        A robot file (``arm.toml``), a URDF (``arm.urdf``), an MJCF file (``arm.xml``), a name of `catalogue`, or a file
        of a format that an installed package reads (entry points `FORMATS`, by the file's ending).
    elastic : path, optional
        For a URDF or MJCF: the robot file with the spring and the motor of each joint.
    joints : sequence of str, optional
        For a URDF or MJCF: the joints that move; the others are locked. By default all that are not fixed.
    locked : mapping of str to float, optional
        For a URDF or MJCF: joints that do not move, and where they stand, rad or m.
    payload : str, Payload or sequence of these, optional
        What the robot carries, instead of the file's own payload: ``"0..3kg@hand"``, see `payload_from_text`.

    Raises InvalidInput: with the file, the key, the value and what is allowed there.

    >>> from flexhinf import load_robot
    >>> load_robot("planar-two-link", payload="0..1kg@elbow").uncertain[-1].interval
    (0.0, 1.0)
    """
    check_selection(joints, locked)
    path = _existing(source)
    if path.suffix.lower() == ".toml":
        refuse_if(
            elastic is not None,
            "A robot file holds the elastic data itself.",
            f"expected elastic=... beside a URDF, got it beside {path.name!r}",
            "load_robot('arm.toml'), or urdf = '…' in that file",
        )
        parts = RobotFile(path)
        rigid = [parts.root[key] for key in ("urdf", "mjcf") if key in parts.root]
        refuse_if(len(rigid) > 1, f"{path.name}: two files state links.", "got urdf and mjcf", "one of them")
        robot = (
            parts.robot_with(file_beside(path, rigid[0]), joints, locked, payload)
            if rigid
            else parts.whole_robot(joints, locked, payload)
        )
        again = partial(_again, rigid=None, joints=joints, locked=locked, payload=payload)
        return replace(robot, file=path, reader=again)
    ending = path.suffix.lower()
    points = format_readers(path)
    refuse_if(
        len(points) > 1,
        f"Several packages read {path.suffix!r} files.",
        f"expected one entry point of {FORMATS!r}, got {sorted(point.value for point in points)}",
        "one of these packages uninstalled",
    )
    for point in points:
        try:
            reader = point.load()
        except (ImportError, AttributeError) as error:
            raise InvalidInput(
                f"The reader of {path.suffix!r} files cannot be imported.",
                f"expected {point.value}, got {type(error).__name__}: {error}",
                "the package that states this reader, installed again",
            ) from error
        robot = reader(path, elastic=elastic, joints=joints, locked=locked, payload=payload)
        refuse_if(
            not isinstance(robot, Robot),
            f"The reader of {path.suffix!r} files makes no robot.",
            f"expected a flexhinf.Robot, got {type(robot).__name__}",
            "the package that states this reader, corrected",
        )
        return robot
    refuse_if(
        ending not in (".urdf", *MJCF),
        f"{path.name}: a name with this ending is no robot's.",
        f"expected .toml, .urdf, .xml, or that of an installed reader, got {value_text(ending)}",
        "a robot's file, with its usual ending",
    )
    if elastic is None:
        raise InvalidInput(
            f"{path.name}: a URDF or an MJCF file says nothing about elastic joints.",
            "expected elastic='joints.toml', got none",
            f"flexhinf init {shlex.quote(str(path))}, which estimates them; or a TOML file with, for "
            "each joint: [[joint]] name, [joint.spring] stiffness, [joint.motor] motor_inertia",
        )
    springs = _existing(elastic)
    robot = RobotFile(springs).robot_with(path, joints, locked, payload)
    again = partial(_again, rigid=path, joints=joints, locked=locked, payload=payload)
    return replace(robot, file=springs, reader=again)


def format_readers(path: Path) -> Sequence[EntryPoint]:
    """Readers of other packages for files with this ending; none for a URDF or an MJCF file."""
    ending = path.suffix.lower()
    return () if ending in (".urdf", *MJCF) else [*entry_points(group=FORMATS, name=ending.removeprefix("."))]


def _again(file: Path, rigid: Path | None, **others: Any) -> Robot:
    """The robot of another file that is read as one was; warnings were for that one."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RobotFileWarning)
        return load_robot(file, **others) if rigid is None else load_robot(rigid, file, **others)


def _existing(source: str | Path) -> Path:
    shipped, path = catalogue(), checked_path("The robot file", source)
    if str(source) in shipped:
        return shipped[str(source)]
    if is_file(path):
        return path
    if below := usable_below(path):
        raise InvalidInput(
            f"The folder {value_text(str(source), 120)} is neither a robot nor a design.",
            f"expected a file, or a folder with design.toml, got a folder with {', '.join(below)}",
            below[0],
        )
    raise InvalidInput(
        f"There is no robot file {value_text(str(source), 120)}.",
        f"expected a file, or a name of the catalogue: {list(shipped)}",
        nearest(
            source,
            [*shipped, *robot_files(path.parent)],
            "the path of a file (.toml, .urdf, .xml), or of a report's folder where a design is meant, beginning at "
            "the working folder or at the root",
        ),
    )


def usable_below(folder: Path) -> list[str]:
    """Paths in a folder that stand for a robot or a design, at most ten: folders of designs, as a campaign's setup,
    and files of robots."""
    with suppress(OSError, ValueError):
        designs = sorted(str(path.parent) for path in islice(folder.glob("*/design.toml"), 100))
        return [*designs, *robot_files(folder)][:10]
    return []


def robot_files(folder: Path) -> list[str]:
    """Paths of the robot files in a folder, at most a hundred."""
    try:
        found = (entry for entry in folder.iterdir() if entry.suffix.lower() in (".toml", ".urdf", ".xml"))
        return sorted(map(str, islice(found, 100)))
    except (OSError, ValueError):  # no such folder, or none that this user may read
        return []


def file_beside(file: Path, name: str) -> Path:
    """The file of the links that a robot's file names, relative to it; InvalidInput if there is none."""
    path = file.parent / checked_path(f"The URDF of {file.name}", name)
    if is_file(path):
        return path
    names = [Path(other).name for other in robot_files(path.parent) if Path(other) != file]
    raise InvalidInput(
        f"{file.name}: there is no file {value_text(name, 120)} beside it.",
        f"expected a URDF or an MJCF file, got {value_text(name, 120)}; beside it are {names[:10]}",
        f"urdf = {nearest(path.name, names, '…, its path as seen from this file')}",
    )


def catalogue() -> dict[str, Path]:
    """Path of each shipped robot file by name, for `load_robot`.

    >>> "paper" in catalogue()
    True
    """
    return {path.stem: path for path in sorted((Path(__file__).parent / "catalogue").glob("*.toml"))}


TABLE_1, TABLE_2 = "Elsa & Akbari 2014, Table 1", "Elsa & Akbari 2014, Table 2"


def paper_arm() -> Robot:
    """The single-link arm of Elsa & Akbari (2014): Tables 1 and 2 with tolerances, penalty (11).

    >>> paper_arm().nominal["stiffness"]
    100.0
    """
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
            Parameter("damping", 0.0, 0.0, "N·m·s/rad", "Elsa & Akbari 2014, Eq. (2): the spring has none"),
        ),
        Penalty({"link_position": 60.0, "link_position_integral": 300.0}, effort=10.0),
    )
