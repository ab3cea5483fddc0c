"""A folder of its own for every command, a small robot, and the look of an error."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from tests.builders import joint_text

from flexhinf.cli import main

ARM = joint_text(
    "elbow", limits=[-1.0, 1.0], centre=(0.2, 0.0, 0.0), inertia=(0.01, 0.02, 0.02),
    motor="motor_inertia = 0.1\nfriction = 0.1",
)  # fmt: skip

#: The same with a tolerance and a limit of its motor.
UNCERTAIN_ARM = "gravity = 0.0\n" + ARM.replace(
    "stiffness = 100.0", "stiffness = {value = 100.0, tolerance = 10}"
).replace("limits = [-1.0, 1.0]", "limits = [-1.0, 1.0]\neffort_limit = 20.0")

#: A design of the paper's arm as far as a campaign needs it.
DESIGN = """
[design]
robot = "paper"
estimator = "ekf"
measurement_noise = 1e-8
pose = "home"
overshoot = 30.0
[result]
duration = 0.5
requirements = []
"""

#: Options of a design of one pose that is made soon: without a region and other robots.
QUICK = ["--degrees", "2", "--set", "rays=0", "--draws", "0"]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def arm() -> str:
    """The robot file of one joint, driven by a torque, without tolerances."""
    return ARM


@pytest.fixture
def uncertain_arm(folder: Path) -> Callable[[str], str]:
    """``uncertain_arm(name)`` writes the arm's file with a tolerance and a limit of its motor; the name."""

    def write(name: str) -> str:
        (folder / name).write_text(UNCERTAIN_ARM)
        return name

    return write


@pytest.fixture
def refused(capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """``refused(words, what, before)``: code 2, three parts with (every one of) `what`, no new file; the message."""

    def check(words: list[str], what: str | tuple[str, ...], folder: Path) -> str:
        before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
        assert main(words) == 2
        told = capsys.readouterr().err
        assert "Traceback" not in told
        error = told[told.index("error:") :]
        lines = [line.strip() for line in error.splitlines() if line.strip()]
        assert [one for one in ((what,) if isinstance(what, str) else what) if one not in error] == []
        assert lines[1].startswith("found:")
        assert lines[2].startswith("try:")
        assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before
        return error

    return check
