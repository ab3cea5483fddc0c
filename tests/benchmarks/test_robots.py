"""What counts as a robot that loads, and what of each file is kept."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from benchmarks import robots

LINK = '<link name="{0}"><inertial><origin xyz="0 0 0.1"/><mass value="1"/><inertia {1}/></inertial></link>'
GOOD = 'ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"'
JOINT = '<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{3}"/><axis xyz="0 1 0"/>{4}</joint>'
LIMIT = '<limit lower="-1" upper="1" effort="{}" velocity="1"/>'


def written(folder: Path, name: str, inertia: str = GOOD, hand: str = "") -> None:
    parts = [
        '<link name="base"/>', LINK.format("upper", inertia),
        JOINT.format("a", "revolute", "base", "upper", LIMIT.format(20)), hand,
    ]  # fmt: skip
    (folder / f"{name}.urdf").write_text(f'<robot name="{name}">{"".join(parts)}</robot>', encoding="utf-8")


def test_counts_of_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("pinocchio")
    written(tmp_path, "good")
    written(tmp_path, "impossible", GOOD.replace('izz="0.01"', 'izz="0.1"'))
    # a motor that moves nothing of mass: its joint stands still, so the file does not count
    hand = '<link name="hand"/>' + JOINT.format("b", "revolute", "upper", "hand", LIMIT.format(5))
    written(tmp_path, "light", hand=hand)
    # a gripper whose joints are coupled
    finger = '<limit lower="0" upper="1" effort="3" velocity="1"/>'
    hand = "".join(LINK.format(name, GOOD) for name in "lr")
    hand += JOINT.format("left", "prismatic", "upper", "l", finger)
    hand += JOINT.format("right", "prismatic", "upper", "r", f'{finger}<mimic joint="left"/>')
    written(tmp_path, "gripper", hand=hand)
    (tmp_path / "drawing.urdf").write_text('<robot name="a"><link name="base"/></robot>', encoding="utf-8")
    (tmp_path / "broken.urdf").write_text("<robot", encoding="utf-8")
    kept = tmp_path / "kept.json"
    assert robots.main(["--source", f"own@1=two={tmp_path}", "--kept", str(kept)]) == 0
    rows = {row["file"]: row for row in json.loads(kept.read_text())}
    loads = {name.removesuffix(".urdf"): (row["at_once"], row["after_init"]) for name, row in rows.items()}
    assert loads == {
        "good": (True, True), "impossible": (False, True), "light": (False, False), "gripper": (False, True),
        "drawing": (False, False), "broken": (False, False),
    }  # fmt: skip
    assert rows["light.urdf"]["still"] == ["b"]
    assert "nearest" in rows["impossible.urdf"]["changes"][0]
    assert all(row["mass_matrix"] <= 1e-12 for row in rows.values() if "mass_matrix" in row)
    assert len(rows["good.urdf"]["sha256"]) == 16
    capsys.readouterr()
    assert robots.main(["--table", "--kept", str(kept)]) == 0
    assert "| own@1=two | 6 | 4 | 1 (25 %) | 3 (75 %) |" in capsys.readouterr().out
