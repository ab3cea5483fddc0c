"""The robots that are measured.

Three are ours and stand in this folder; the Panda and the UR5 are those of the package example-robot-data, with the
elastic joints of this folder.
"""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

__all__ = ["ROBOTS", "files_of"]

HERE = Path(__file__).resolve().parent

#: URDF of each robot, from this folder, or from the folder of example-robot-data where it begins with a colon; none for
#: robots that their own file describes.
ROBOTS = {
    "planar": "",
    "spatial": "",
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
