"""The robots that are measured, also for older versions of flexhinf, without limits of joints and tables of tolerances.

Four are ours and stand in this folder; the Panda and the UR5 are those of the package example-robot-data, with the
elastic joints of this folder.
"""

from __future__ import annotations

import tomllib
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any

__all__ = ["ROBOTS", "files_of", "without_new_keys"]

HERE = Path(__file__).resolve().parent

#: URDF of each robot, from this folder, or from the folder of example-robot-data where it begins with a colon; none for
#: robots that their own file describes.
ROBOTS = {
    "planar": "",
    "spatial": "",
    "branching": "branching.urdf",
    "arm": "",
    "panda": ":panda_description/urdf/panda.urdf",
    "ur5": ":ur_description/urdf/ur5_robot.urdf",
}


def files_of(name: str) -> tuple[Path, Path | None]:
    """The file of a robot, and that of its elastic joints where the first is a URDF.

    Raises
    ------
    FileNotFoundError
        Where example-robot-data is not installed.
    """
    urdf, own = ROBOTS[name], HERE / f"{name}.toml"
    if not urdf:
        return own, None
    if not urdf.startswith(":"):
        return HERE / urdf, own
    try:
        package = distribution("example-robot-data")
    except PackageNotFoundError:
        raise FileNotFoundError(
            f"{name}: example-robot-data is not installed (pip install --no-deps example-robot-data)"
        ) from None
    robots = Path(str(package.locate_file("cmeel.prefix/share/example-robot-data/robots")))
    return robots / urdf[1:], own


def without_new_keys(file: Path) -> str:
    """A robot's file for an older version: no limits of effort and speed, and tolerances beside the numbers."""
    table = tomllib.loads(file.read_text(encoding="utf-8"))
    tolerances = table.pop("tolerances", {})
    for joint in table["joint"]:
        for key in ("effort_limit", "speed_limit"):
            joint.pop(key, None)
        for part in ("link", "spring", "motor"):
            for key, value in joint.get(part, {}).items():
                if key not in tolerances:
                    continue
                if key == "inertia":
                    value["tolerance"] = tolerances[key]
                else:
                    joint[part][key] = {"value": value, "tolerance": tolerances[key]}
    joints = table.pop("joint")
    lines = [f"{key} = {_toml(value)}" for key, value in table.items()]
    for joint in joints:
        lines += ["", "[[joint]]", *(f"{key} = {_toml(value)}" for key, value in joint.items())]
    return "\n".join(lines) + "\n"


def _toml(value: Any) -> str:
    """A value of the few kinds that these files have."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_toml(one)}" for key, one in value.items()) + " }"
    if isinstance(value, list):
        return f"[{', '.join(map(_toml, value))}]"
    return f'"{value}"' if isinstance(value, str) else repr(value)
