"""Every command for robots whose drives take positions or velocities."""

from __future__ import annotations

import shutil
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests import workspaces
from tests.cli.conftest import QUICK
from tests.refusals import unnamed

import flexhinf as fh
from flexhinf.cli import main

pytestmark = pytest.mark.usefixtures("unoptimised")


def kinds(first: str, second: str) -> pytest.MarkDecorator:
    """Both kinds of drives: the first in CI, the second in `make nightly`."""
    often = pytest.param(first, marks=pytest.mark.ci("designs, comparisons, campaigns, code"))
    seldom = pytest.param(second, marks=pytest.mark.nightly("the same for the other drives"))
    return pytest.mark.parametrize("servo", [often, seldom], indirect=True)


#: Lines of a drive, its largest command and its period.
DRIVES = {
    "position": (
        'drive_bandwidth = {value = "18 Hz", tolerance = 20}\ndrive_damping_ratio = 0.9\ndrive_rate_limit = 2.5\n'
        "drive_acceleration_limit = 200.0",
        2.0,
        "4ms",
    ),
    "velocity": ('drive_bandwidth = {value = "50 Hz", tolerance = 20}\nload_share = 0', 3.0, "2ms"),
}


#: Few poses and goals, one bandwidth, and a narrow range of vibrations.
FEW: dict[str, Any] = {
    "POSES": 3, "GOALS": 1, "CHOSEN_POSES": 2, "MODAL_POSES": 20, "TUNING_POSES": (4, 1), "BANDWIDTHS": (18.0,),
    "MARGIN": 1.1,
}  # fmt: skip


@pytest.fixture
def servo(request: Any, uncertain_arm: Callable[[str], str], folder: Path) -> tuple[str, str, list[str]]:
    """The kind of drive, a robot's file, and options of a loop that fits it; the arm hangs, and its drive is weak."""
    lines, most, period = DRIVES[request.param]
    name = uncertain_arm("servo.toml")
    text = (folder / name).read_text().replace("gravity = 0.0", "down = [0, 0, -1]")
    text = text.replace('name = "elbow"', 'name = "elbow"\naxis = [0, 1, 0]')
    text = text.replace("effort_limit = 20.0", f"effort_limit = {most}\nspeed_limit = 2.0")
    drive = f'drive = "{request.param}"\n{lines}\ndrive_torque_limit = 15.0\ndrive_delay = "{period}"\n'
    (folder / name).write_text(text.replace("[joint.motor]\n", f"[joint.motor]\n{drive}"))
    return request.param, name, ["--period", period, "--measured", "link_position,motor_position"]


def done(words: list[str], *codes: int) -> None:
    """Run a command, which ends with one of these codes, 0 or 1 by default."""
    assert main(words) in (codes or (0, 1)), words


@kinds("velocity", "position")
def test_a_design_of_one_pose_goes_everywhere(
    servo: tuple[str, str, list[str]], folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A proof is refused for the number of states or made, never left half."""
    drive, robot, loop = servo
    done(["design", robot, *loop, "--pose", "0.6", *QUICK, "--out", "one"])
    design = tomllib.loads((folder / "one" / "design.toml").read_text())
    assert design["design"]["robot"] == f"../{robot}"
    done(
        [
            "compare",
            "one",
            "--laws",
            f"{drive}-drive",
            "--out",
            "compared",
        ],
        0,
    )
    assert unnamed(capsys.readouterr().out, f"{drive}-drive") == []
    controller, stated = fh.load_controller(folder / "one"), fh.load_robot(folder / robot).nominal
    if drive == "position":
        assert controller.limits.rate.tolist() == [2.5]
    assert controller.protection is not None
    inertia = stated["inertia_yy"] + stated["mass"] * stated["centre_of_mass_x"] ** 2
    felt = stated["stiffness"] / stated["motor_inertia"] * (drive == "position")  # the other rejects its load
    assert np.ravel(controller.protection.winding) == pytest.approx([felt, stated["stiffness"] / inertia])
    done(["campaign", "run", "one", "--samples", "4", "--out", "many"])
    assert ("largest acceleration" in (folder / "many" / "index.html").read_text()) == (drive == "position")
    done(["campaign", "compare", "one", "one", "--samples", "4", "--out", "both"])
    assert (folder / "both" / "index.html").is_file()


@pytest.mark.ci("a design and its code")
@pytest.mark.parametrize("servo", ["velocity"], indirect=True)
def test_a_workspace_of_velocities_is_designed_moved_and_exported(
    servo: tuple[str, str, list[str]], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The other commands have that of positions below."""
    _, robot, loop = servo
    workspaces.few(monkeypatch, **FEW)
    done(["design", robot, *loop, "--draws", "0", "--out", "whole"])
    done(["campaign", "run", "whole", "--samples", "2", "--out", "many"])
    page = (folder / "many" / "index.html").read_text()
    assert "largest acceleration" not in page
    done(["export", "c", "whole", "--accept-unmet", "--out", "code"], 0)
    config = next((folder / "code" / "ros2" / "config").glob("*.yaml")).read_text()
    assert 'interface: "elbow/velocity"' in config


@kinds("position", "velocity")
def test_a_design_of_the_workspace_goes_everywhere(
    servo: tuple[str, str, list[str]],
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    drive, robot, loop = servo
    workspaces.few(monkeypatch, **FEW | {"POSES": 4, "GOALS": 2})
    done(["design", robot, *loop, "--out", "whole"])
    said = capsys.readouterr().out
    assert bool(unnamed(said, "Not met")) == bool(unnamed(said, "export c ROBOT --feedforward"))
    done(["campaign", "run", "whole", "--samples", "3", "--extra-delay", "1", "--out", "many"])
    done(["compare", "whole", "--laws", f"{drive}-drive", "--out", "compared"])
    assert unnamed(capsys.readouterr().out, f"{drive}-drive") == []
    done(["certify", "whole", "--out", "proved"])
    done(["export", "c", "whole", "--accept-unmet", "--check-measurements", "--out", "code"], 0)
    config = next((folder / "code" / "ros2" / "config").glob("*.yaml")).read_text()
    assert f'interface: "elbow/{drive}"' in config
    if shutil.which("cc"):
        done(["export", "fmu", "whole", "--plant", "--out", "plant.fmu"], 0)
        done(["export", "fmu", "whole", "--accept-unmet", "--out", "controller.fmu"], 0)
    done(["export", "web", "whole", "--out", "page.html"], 0)
    page = (folder / "page.html").read_text(encoding="utf-8")
    assert f"Motor {drive}" in page
    done(["export", "mjcf", robot, "--out", "arm.xml"], 0)
    model = (folder / "arm.xml").read_text()
    assert f"<{drive} " in model
    assert ("forcerange" in model) == (drive == "position")  # the other rejects its load
