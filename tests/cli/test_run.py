"""``flexhinf run``: what is printed, which files are there, what is refused before any work."""

from __future__ import annotations

import json
import math
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.builders import arm_controller, report_numbers
from tests.refusals import unnamed

from flexhinf import report
from flexhinf.cli import main
from flexhinf.export import ros_node
from flexhinf.loop import Stop
from flexhinf.robot import MuJoCoPlant

pytest.importorskip("mujoco")

# Short runs of one controller: compiled in half the time.
pytestmark = pytest.mark.usefixtures("unoptimised")


@pytest.fixture
def design(folder: Path) -> str:
    """The folder of a report: a design file, and the controller that it gave."""
    controller = arm_controller(at=[-0.1], q=1e-9, r=1e-8, p0=1e-6, start="bumpless")
    controller.save(folder / "controller")
    text = '[design]\nrobot = "paper"\npose = "home"\nstart = [-0.1]\nduration = 0.2\n'
    row = '{what = "%s", limit = 0.0, at_most = true, found = %d, unit = "", where = "", met = %s}'
    rows = [row % ("overshoot", 0, "true"), row % ("unstable corners", 44, "false")]
    text += f"[result]\nduration = 0.2\nrequirements = [{', '.join(rows)}]\n"
    files = {
        "design.toml": text,
        "design.json": report_numbers(("overshoot", 0.0, True), ("unstable corners", 44.0, False)),
        "controller": (folder / "controller").read_bytes(),
    }
    report.write(folder / "arm", files)
    (folder / "controller").unlink()
    return "arm"


@pytest.mark.costs("compiles a loop with MuJoCo's robot")
def test_a_run_with_its_log(design: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = [
        "run",
        design,
        "--mujoco",
        "--log",
        "run.csv",
        "--log",
        "again.csv",
        "--perturb",
        "stiffness=-10%",
        "--verbose",
    ]
    assert main(words) in (0, 1)
    told = capsys.readouterr()
    kept = ("201 samples at 1000 Hz", "of 201 deadlines", "not kept: 0.2 s")
    assert any(text in told.out for text in kept), "as busy as the machine is"
    assert "lateness" in told.out
    assert "run.csv" in told.out
    assert len((folder / "run.csv").read_text().splitlines()) == 202
    assert (folder / "run.csv").read_bytes() == (folder / "again.csv").read_bytes()
    assert {path.name for path in folder.iterdir()} == {"arm", "run.csv", "again.csv"}


@pytest.mark.ci("runs with other options")
def test_options_change_the_run(design: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["run", f"{design}/design.toml", "--mujoco", "--no-realtime", "--no-noise", "--duration", "50ms"]
    assert main([*words, "--load", "0.2", "--load-at", "20ms", "--pose", "5deg", "--log", "run.csv"]) in (
        0,
        1,
    )
    rows = [line.split(",") for line in (folder / "run.csv").read_text().splitlines()]
    assert len(rows) == 52
    torque, goal = (
        rows[0].index(name) for name in ("disturbance/link_torque[N·m]", "reference/link_position[rad]")
    )
    assert [float(row[torque]) for row in (rows[20], rows[21])] == [0.0, 0.2]
    assert float(rows[1][goal]) == pytest.approx(math.radians(5.0))
    out = capsys.readouterr().out
    assert unnamed(out, "not", "real time", "51 samples", "not judged", "remaining error", "--duration") == []
    # the design's own verdict, and how much of it the run judges again
    assert unnamed(out, "0 of", "2 kinds", "1 of 2", "unstable corners: 44") == []


@pytest.mark.ci("a run that is stopped, with its page")
def test_a_run_whose_sensor_falls_silent_is_stopped(
    design: str, folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It says when and why, and what to look at; what was recorded until then is written."""
    output, samples = MuJoCoPlant.output, iter(range(10_000))
    monkeypatch.setattr(
        MuJoCoPlant, "output", lambda box: output(box) * (1.0 if next(samples) < 50 else math.nan)
    )
    words = ["run", design, "--mujoco", "--no-realtime", "--log", "run.csv", "--out", "made"]
    assert main(words) == 1
    told = " ".join(capsys.readouterr().out.split())
    assert unnamed(told, "protective stop", "missing", "SENSOR_LOST", "cables") == []
    assert "not judged" not in told
    rows = [line.split(",") for line in (folder / "run.csv").read_text().splitlines()]
    assert 56 + 50 < len(rows) < 180  # ten more samples, a controlled stop, and rest
    assert int(float(rows[-1][rows[0].index("flags/stop")])) == Stop.SENSOR_LOST
    numbers = json.loads((folder / "made" / "run.json").read_text())
    assert (numbers["protective_stop"], numbers["met"]) == (["sensor_lost"], False)
    assert "stop began" in (folder / "made" / "index.html").read_text()


@pytest.mark.ci("a run with its page")
def test_a_page_of_the_run(design: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["run", design, "--mujoco", "--no-realtime", "--perturb", "stiffness=-10%", "--out", "made"]
    assert main(words) in (0, 1)
    assert "report: " in capsys.readouterr().out
    assert {path.name for path in (folder / "made").iterdir()} == {
        "index.html", "run.json", "run.csv", "flexhinf-report.json",
    }  # fmt: skip
    html = (folder / "made" / "index.html").read_text()
    for part in ("specification", "timing", "tracking", "effort", "status", "figure-result", "figure-times"):
        assert f'id="{part}"' in html
    assert unnamed(html, "stiffness=-10%", "limit", "workspace", "overshoot") == []
    assert unnamed(html, "1 of 2 requirements", "unstable corners: 44", "not met", "not judged") == []
    assert 'class="badge holds"' not in html
    numbers = json.loads((folder / "made" / "run.json").read_text())
    assert unnamed(" ".join(numbers["design"]["not_met"]), "unstable corners", "44") == []
    assert numbers["met"] is False
    assert numbers["timing"]["samples"] == 201
    assert numbers["status"]["saturation"] == 0
    assert [row["what"] for row in numbers["requirements"]]
    assert len((folder / "made" / "run.csv").read_text().splitlines()) == 202


def test_a_folder_of_others_is_not_overwritten(design: str, folder: Path) -> None:
    (folder / "mine").mkdir()
    (folder / "mine" / "thesis.tex").write_text("mine")
    assert main(["run", design, "--mujoco", "--no-realtime", "--out", "mine"]) == 2
    assert [path.name for path in (folder / "mine").iterdir()] == ["thesis.tex"]


@pytest.mark.ci("draws a film")
def test_a_film(
    design: str, folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from flexhinf.pages import film

    monkeypatch.setattr(film, "SHORTEST", 0.2)
    assert main(["run", design, "--mujoco", "--no-realtime", "--record", "arm.gif"]) in (0, 1)
    assert (folder / "arm.gif").read_bytes().startswith(b"GIF89a")
    assert "arm.gif" in capsys.readouterr().out


@pytest.mark.ci("starts a process, and ends it")
@pytest.mark.usefixtures("folder")
def test_control_c_keeps_a_whole_log(
    design: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from flexhinf.robot import MuJoCoPlant

    steps, whole = [], MuJoCoPlant.step

    def step(self: MuJoCoPlant, *arguments: object) -> None:
        steps.append(0)
        if len(steps) == 40:
            os.kill(os.getpid(), signal.SIGINT)
        whole(self, *arguments)

    monkeypatch.setattr(MuJoCoPlant, "step", step)
    assert main(["run", design, "--mujoco", "--duration", "60s", "--log", "run.csv"]) == 130
    told = capsys.readouterr()
    rows = Path("run.csv").read_text().splitlines()
    assert 30 < len(rows) < 45
    assert len({row.count(",") for row in rows}) == 1
    assert "Stopped at 0.03" in told.out
    assert "error: Interrupted" in told.err
    assert "run.csv" in told.err
    assert "nothing" not in told.err


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (["DESIGN"], ("--mujoco", "none")),
        (["nothing-here", "--mujoco"], ("'nothing-here'", "design.toml")),
        (["DESIGN", "--mujoco", "--log", "run.txt"], ("log", ".csv, .parquet, .mcap", "'run.txt'")),
        (["DESIGN", "--mujoco", "--log", "missing/run.csv"], ("log", "missing/run.csv")),
        (["DESIGN", "--mujoco", "--log", "."], ("log", ".csv, .parquet, .mcap", "'.'")),
        (["DESIGN", "--mujoco", "--log", "/"], ("log", ".csv, .parquet, .mcap", "'/'")),
        (["DESIGN", "--mujoco", "--record", ".."], ("film", ".mp4 or .gif", "'..'")),
        (["DESIGN", "--mujoco", "--log", "run.csv", "--log", ""], ("--log", "pathlib.Path")),
        (["DESIGN", "--mujoco", "--record", "arm.avi"], ("film", ".mp4 or .gif", "'arm.avi'")),
        (["DESIGN", "--mujoco", "--view"], "DISPLAY"),
        (["DESIGN", "--mujoco", "--library", "missing.so"], ("library", "missing.so")),
        (["DESIGN", "--mujoco", "--perturb", "stifness=1"], ("'paper'", "parameter", "'stifness=1'")),
        (["DESIGN", "--mujoco", "--set", "load=1m"], "load"),
        (["DESIGN", "--mujoco", "--priority", "0"], "real-time priority"),
        (["DESIGN", "--mujoco", "--extras", "inductance"], ("MuJoCo", "'inductance'")),
        (["DESIGN", "--mujoco", "--pose", "400deg"], "turn"),
        (["DESIGN", "--mujoco", "--duration", "0.1ms"], ("period", "0.0001 s")),
    ],
)
def test_a_mistake_is_told_before_any_work(
    words: list[str],
    what: str,
    design: str,
    folder: Path,
    refused: Callable[..., str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("sys.platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    refused(["run", *(design if word == "DESIGN" else word for word in words)], what, folder)


@pytest.mark.parametrize(
    ("stated", "told"),
    [
        (["--log", "run.csv"], ("--log", "ros2 bag", "without --ros")),
        (["--pose", "5deg"], ("--pose", "without --ros")),
        ([], ("rclpy", "ros-jazzy-rclpy")),
    ],
)
def test_a_node_needs_ros_and_no_options_of_a_move(
    stated: list[str], told: tuple[str, ...], design: str, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setitem(sys.modules, "rclpy", None)
    assert main(["run", design, "--ros", *stated]) == 2
    assert unnamed(capsys.readouterr().err, *told) == []
    assert not Path("run.csv").exists()


def test_arguments_of_ros_are_those_of_a_node_alone(
    design: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As `ros2 run` and launch files give them: parameters, other names."""
    monkeypatch.setitem(sys.modules, "rclpy", None)
    words = ["--ros-args", "-p", "stop_time:=0.1", "-r", "__node:=arm"]
    assert main(["run", design, "--ros", *words]) == 2
    assert unnamed(capsys.readouterr().err, "ros-jazzy-rclpy") == []
    assert main(["run", design, "--ros", *words, "--", "--log", "run.csv"]) == 2
    assert unnamed(capsys.readouterr().err, "--log") == []
    assert main(["run", design, *words]) == 2
    assert unnamed(capsys.readouterr().err, "--ros-args") == []


@pytest.mark.ci("codes a controller")
def test_a_node_needs_a_controller_of_a_workspace(
    design: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ros_node, "ros_packages", dict)
    assert main(["run", design, "--ros"]) == 2
    assert unnamed(capsys.readouterr().err, "trajectories", "workspace", "--pose") == []
