"""The command line: options, exit codes, three-part messages, nothing half-written."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import flexhinf as fh
from flexhinf.cli import main


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (["--nope"], "No such option: --nope"),
        (["--perio", "1"], "No such option: --perio"),
        (["--period", "fast"], "--period"),
        (["--period", "-0.001"], "sampling period"),
        (["--period", "inf"], "sampling period"),
        (["--gamma-ratio", "0"], "γ/γ*"),
        (["--gamma-ratio", "-2"], "γ/γ*"),
        (["--gamma-ratio", "nan"], "γ/γ*"),
        (["--gamma-ratio", "0.9"], "No stabilising solution"),
        (["--degree", "1"], "degree of V"),
        (["--degree", "4.5"], "--degree"),
        (["--degree", "99"], "degree of V"),
        (["--seed", "-1"], "seed"),
        (["--estimator", "kalman"], "estimator"),
        (["--process-noise", "-1"], "process noise"),
        (["--measurement-noise", "0"], "measurement noise"),
    ],
)
def test_a_users_mistake_is_told_in_three_parts(
    words: list[str],
    what: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["paper", *words]) == 2
    told = capsys.readouterr().err
    assert "Traceback" not in told
    lines = [line.strip() for line in told.splitlines() if line.strip()]
    assert what in lines[0]
    assert lines[1].startswith("found:")
    assert lines[2].startswith("try:")
    assert list(tmp_path.iterdir()) == []


def test_an_output_that_cannot_be_written_is_refused_before_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "notes.txt"
    file.write_text("mine")
    other = tmp_path / "mine"
    other.mkdir()
    (other / "thesis.tex").write_text("mine")
    for place in (file, other, file / "below"):
        assert main(["paper", "--out", str(place)]) == 2
        assert "try:" in capsys.readouterr().err
    assert file.read_text() == "mine"
    assert [f.name for f in other.iterdir()] == ["thesis.tex"]


def test_help_lists_commands_and_defaults(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    assert "paper" in capsys.readouterr().out
    assert main(["paper", "--help"]) == 0
    shown = capsys.readouterr().out
    for default in ("flexhinf-paper", "0.001", "ukf", "4"):
        assert f"[default: {default}]" in shown
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("flexhinf ")


def test_an_unknown_command_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["papers"]) == 2
    assert "papers" in capsys.readouterr().err


def test_it_runs_as_a_module() -> None:
    outcome = subprocess.run(
        [sys.executable, "-m", "flexhinf", "paper", "--nope"], capture_output=True, text=True, check=False
    )
    assert outcome.returncode == 2
    assert "try:" in outcome.stderr


# flexhinf robots ----------------------------------------------------------------------------------
def test_the_catalogue_is_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["robots"]) == 0
    shown = capsys.readouterr().out
    for name in fh.catalogue():
        assert name in shown
    assert "84 assumed" in shown


# flexhinf design ----------------------------------------------------------------------------------
QUICK = ["--degrees", "2", "--rays", "0"]


def test_a_design_is_told_and_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    words = ["paper", "--degrees", "2,4", "--goal", "180deg", "--rays", "200", "--no-compare-rigid"]
    assert main(["design", *words]) == 0
    shown = capsys.readouterr()
    for text in ("linear", "cubic *", "not proved", "vibration", "Stable", "index.html"):
        assert text in shown.out, text
    assert "looked at along" not in shown.err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["flexhinf-design"]
    page = (tmp_path / "flexhinf-design" / "index.html").read_text(encoding="utf-8")
    assert "flexhinf design paper --pose 180deg --degrees 2,4 --rays 200 --no-compare-rigid" in page
    assert main(["design", "vertical-rig", *QUICK, "--no-compare-rigid"]) == 0
    page = (tmp_path / "flexhinf-design" / "index.html").read_text(encoding="utf-8")
    assert "vertical-rig" in page
    assert sorted(p.name for p in tmp_path.iterdir()) == ["flexhinf-design"]


def test_a_folder_that_is_no_report_is_left_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "thesis.tex").write_text("mine")
    assert main(["design", "paper", *QUICK, "--out", str(tmp_path)]) == 2
    assert "left alone" in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["thesis.tex"]


ARM = """
[[joint]]
name = "elbow"
limits = [-1.0, 1.0]
[joint.link]
mass = 1.0
centre_of_mass = [0.2, 0.0, 0.0]
inertia = {xx = 0.01, yy = 0.02, zz = 0.02}
[joint.spring]
stiffness = 100.0
[joint.motor]
motor_inertia = 0.1
friction = 0.1
"""
URDF = """<robot name="r"><link name="base"/><link name="a"><inertial><mass value="1"/>
<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="elbow" type="continuous"><parent link="base"/><child link="a"/></joint></robot>"""


@pytest.mark.parametrize(
    ("replaced", "by", "words", "what"),
    [
        ("stiffness = 100.0", "", [], "stiffness"),
        ("stiffness = 100.0", "stifness = 100.0", [], "stiffness"),
        ("stiffness = 100.0", "stiffness = -1.0", [], "must be positive"),
        ("stiffness = 100.0", "stiffness = 'soft'", [], "stiffness"),
        ("motor_inertia = 0.1", "motor_inertia = 0.0", [], "must be positive"),
        ("motor_inertia = 0.1", "", [], "once"),
        ("xx = 0.01", "xx = -0.01", [], "positive"),
        ("xx = 0.01", "xx = 0.1", [], "triangle"),
        ("[[joint]]", "[[joint", [], "no TOML"),
        ("", "", ["--pose", "2.0"], "outside the limits"),
        ("", "", ["--from-pose", "2.0"], "outside the limits"),
        ("", "", ["--pose", "0.1,0.2"], "does not fit"),
        ("", "", ["--pose", "90grad"], "cannot be read"),
        ("", "", ["--degrees", "two"], "cannot be read"),
        ("", "", ["--degrees", "1"], "degrees"),
        ("", "", ["--penalty", "1,2,3"], "penalty"),
        ("", "", ["--penalty", "link_positon=1"], "link_positon"),
        ("", "", ["--penalty", "link_position=a"], "cannot be read"),
        ("", "", ["--penalty", "link_position=1,link_position_integral=1", "--bandwidth", "1"], "contradict"),
        ("", "", ["--gamma-ratio", "0.5"], "No stabilising solution"),
        ("", "", ["--rays", "10", "--degrees", "2", "--checked-gamma-ratio", "1.2"], "check cannot be made"),
        ("", "", ["--effort", "-1"], "effort"),
        ("", "", ["--measured", "colour"], "colour"),
        ("", "", ["--disturbances", "wind"], "wind"),
        ("", "", ["--extras", "rust"], "rust"),
        ("", "", ["--extras", "backlash"], "backlash"),
        ("", "", ["--estimator", "kalman"], "estimator"),
        ("", "", ["--saturation", "-3"], "saturation"),
        ("", "", ["--period", "0"], "period"),
        ("", "", ["--elastic", "arm.toml"], "elastic"),
        ("", "", ["--colour", "red"], "--colour"),
    ],
)
def test_what_is_wrong_with_a_robot_or_an_option_is_told_in_three_parts(
    replaced: str,
    by: str,
    words: list[str],
    what: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.toml").write_text(ARM.replace(replaced, by) if replaced else ARM, encoding="utf-8")
    assert main(["design", "arm.toml", *words]) == 2
    _three_parts(capsys.readouterr().err, what)
    assert [p.name for p in tmp_path.iterdir()] == ["arm.toml"]


@pytest.mark.parametrize(
    ("urdf", "elastic", "what"),
    [
        ("solid arm; endsolid", ARM, "no XML"),
        ("<solid/>", ARM, "no URDF"),
        (URDF, "", "elastic"),
        (URDF, ARM.replace("elbow", "elbov"), "'elbow'"),
        (URDF.replace("<inertial>", "<!--").replace("</inertial>", "-->"), ARM, "inertia"),
    ],
    ids=["no XML", "no URDF", "no elastic data", "unknown joint", "no inertials"],
)
def test_what_is_wrong_with_a_urdf_is_told_in_three_parts(
    urdf: str,
    elastic: str,
    what: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.urdf").write_text(urdf, encoding="utf-8")
    kept = [line for line in elastic.splitlines() if "mass" not in line and "inertia = {" not in line]
    (tmp_path / "joints.toml").write_text(
        "\n".join(k for k in kept if k not in ("[joint.link]", "limits = [-1.0, 1.0]"))
    )
    beside = ["--elastic", "joints.toml"] if elastic else []
    assert main(["design", "arm.urdf", *beside, *QUICK]) == 2
    _three_parts(capsys.readouterr().err, what)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["arm.urdf", "joints.toml"]


def test_a_robot_that_is_nowhere_is_told_with_the_nearest(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["design", "seven-links", *QUICK]) == 2
    _three_parts(capsys.readouterr().err, "'seven-link'")


def test_a_tolerance_that_looks_like_a_fraction_is_warned_of_in_terminal_and_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    told = ARM.replace("stiffness = 100.0", "stiffness = {value = 100.0, tolerance = 0.05}")
    (tmp_path / "arm.toml").write_text(told, encoding="utf-8")
    assert main(["design", "arm.toml", *QUICK, "--no-compare-rigid", "--estimator", "none"]) == 0
    assert "looks like a fraction" in capsys.readouterr().err
    page = (tmp_path / "flexhinf-design" / "index.html").read_text(encoding="utf-8")
    assert "looks like a fraction" in page
    assert "ours: scaled for" in page


def _three_parts(told: str, what: str) -> None:
    assert "Traceback" not in told
    error = told[told.index("error:") :]
    lines = [line.strip() for line in error.splitlines() if line.strip()]
    assert what in error
    assert lines[1].startswith("found:")
    assert lines[2].startswith("try:")
