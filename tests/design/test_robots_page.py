"""What docs/robots.md says works as it stands there."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

import flexhinf as fh
from flexhinf.cli import main
from flexhinf.robot.quantities import QUANTITIES
from flexhinf.robot.schema import JointTable, LinkTable, MotorTable, RobotTable, SpringTable

URDF = """<robot name="two_link">
  <link name="base"/>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  <link name="upper"><inertial><origin xyz="0 0 0.2"/><mass value="2"/>
    <inertia ixx="0.02" iyy="0.02" izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="elbow" type="revolute"><origin xyz="0 0 0.4"/><parent link="upper"/><child link="lower"/>
    <axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  <link name="lower"><inertial><origin xyz="0 0 0.15"/><mass value="1"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="gripper" type="prismatic"><parent link="lower"/><child link="hand"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="0.1" effort="1" velocity="1"/></joint>
  <link name="hand"><inertial><origin xyz="0 0 0.05"/><mass value="0.3"/>
    <inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
</robot>"""


@pytest.fixture
def page(repository: Path) -> str:
    return (repository / "docs" / "robots.md").read_text(encoding="utf-8")


@pytest.fixture
def folder(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for block in re.findall(r"```toml\n(.*?)```", page, re.DOTALL):
        name = re.match(r"# file: (\S+)", block)
        assert name, block
        (tmp_path / name.group(1)).write_text(block, encoding="utf-8")
    (tmp_path / "two_link.urdf").write_text(URDF, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_commands_of_the_page_run(page: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = [line for block in re.findall(r"```sh\n(.*?)```", page, re.DOTALL) for line in block.splitlines()]
    assert len(lines) >= 5
    for line in lines:
        program, *words = shlex.split(line)
        assert program == "flexhinf"
        quick = ["--rays", "0", "--degrees", "4"] if words[0] == "design" else []
        assert main([*words, *quick]) in (0, 1), line  # 1: made, and a line of the specification is not met
    assert "Stable" in capsys.readouterr().out
    assert (folder / "flexhinf-design" / "index.html").is_file()


def test_the_program_of_the_page_runs(page: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (program,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    exec(compile(program, "docs/robots.md", "exec"), {})
    assert "Stable" in capsys.readouterr().out
    assert fh.load_solution(folder / "pendulum-law.npz").degree == 4


def test_the_page_lists_every_key_with_its_unit(page: str) -> None:
    rows = [line for line in page.splitlines() if line.startswith("| `")]
    listed = {name: row for row in rows for name in re.findall(r"`([a-z_]+)`", row.split("|")[1])}
    keys = {
        key
        for table in (RobotTable, JointTable, LinkTable, SpringTable, MotorTable)
        for key in table.model_fields
    }
    tables = {"joint", "link", "spring", "motor", "penalty"}
    assert sorted(keys - tables - set(listed)) == []
    units = {key: QUANTITIES[key] for key in listed if key in QUANTITIES}
    wrong = [
        key
        for key, unit in units.items()
        if unit.unit not in listed[key] or unit.sliding_unit not in listed[key]
    ]
    assert len(units) > 20
    assert wrong == []
