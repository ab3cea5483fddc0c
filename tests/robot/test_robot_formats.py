"""Formats of robot files that another package reads: entry points, by the file's ending."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.refusals import refused_with

import flexhinf as fh

READER = """
import flexhinf as fh

def read(path, *, elastic, joints, locked, payload):
    name, stiffness = path.read_text().split()
    assert (elastic, joints, locked) == (None, None, None)
    return fh.load_robot(name, payload=payload).with_values({"stiffness": float(stiffness)})

def wrong(path, **options):
    return path
"""


@pytest.fixture
def plug_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package as `pip install` leaves it, with readers for .arm, and for some that fail."""
    (tmp_path / "arm_format.py").write_text(READER)
    about = tmp_path / "arm_format-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: arm-format\nVersion: 1.0\n")
    points = (
        "arm = arm_format:read",
        "bad = arm_format:wrong",
        "none = arm_format:missing",
        "urdf = arm_format:wrong",
    )
    (about / "entry_points.txt").write_text("\n".join(["[flexhinf.robot_formats]", *points, ""]))
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


def test_a_package_reads_its_own_format(plug_in: Path) -> None:
    (plug_in / "my.ARM").write_text("paper 30.5")
    robot = fh.load_robot(plug_in / "my.ARM")
    assert robot.nominal["stiffness"] == 30.5
    assert robot.nominal["mass"] == fh.paper_arm().nominal["mass"]


def test_design_takes_such_a_file(plug_in: Path) -> None:
    from flexhinf.designs import read_request

    (plug_in / "my.arm").write_text("paper 30.5")
    assert read_request(plug_in / "my.arm", None, {"pose": "10deg"}).robot.nominal["stiffness"] == 30.5


@pytest.mark.parametrize(
    ("name", "what"),
    [
        ("a.bad", r"'\.bad'[\s\S]*flexhinf\.Robot"),
        ("a.none", r"'\.none'[\s\S]*arm_format:missing"),
        ("a.other", r"a\.other[\s\S]*\.toml"),
    ],
)
def test_what_a_package_does_wrong_is_told(plug_in: Path, name: str, what: str) -> None:
    (plug_in / name).write_text("paper 30.5")
    with pytest.raises(fh.InvalidInput, match=what):
        fh.load_robot(plug_in / name)


def test_our_own_formats_stay_ours(plug_in: Path) -> None:
    (plug_in / "a.urdf").write_text("<robot name='a'/>")
    with refused_with(fh.InvalidInput, "a.urdf", "elastic="):
        fh.load_robot(plug_in / "a.urdf")
