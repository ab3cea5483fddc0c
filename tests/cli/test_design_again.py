"""A design file makes the same design again, through the command."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

import pytest
from tests.cli.conftest import QUICK
from tests.refusals import unnamed

import flexhinf as fh
from flexhinf import report
from flexhinf.cli import main

# Every design compiles its loops for a few runs: compiled in half the time.
pytestmark = pytest.mark.usefixtures("unoptimised")

#: With the true state fed back.
FED = [*QUICK, "--estimator", "none"]


def numbers(folder: Path) -> dict:
    return json.loads((folder / "design.json").read_text(encoding="utf-8"))


def file_of(folder: Path) -> dict:
    return tomllib.loads((folder / "design.toml").read_text(encoding="utf-8"))


@pytest.mark.nightly("the same robust design, three times; below are others that are made twice")
def test_the_same_design_is_made_again(arm: str, folder: Path) -> None:
    (folder / "arm.toml").write_text(
        arm.replace("100.0", "{value = 100.0, tolerance = 10}"), encoding="utf-8"
    )
    words = ["--bandwidth", "4", "--pose", "10deg", "--preset", "robust", "--seed=3", *FED, "--draws=2"]
    code = main(["design", "arm.toml", *words])
    assert main(["design", "flexhinf-design/design.toml", "--out", "below/again"]) == code
    first, again = folder / "flexhinf-design", folder / "below" / "again"
    assert numbers(again) == numbers(first)
    stated = file_of(first)["design"]
    assert stated["robot"] == "../arm.toml"
    assert file_of(again)["design"] == {**stated, "robot": "../../arm.toml"}
    assert file_of(again)["result"] == file_of(first)["result"]
    found = file_of(first)["result"]
    assert found["preset"] == "robust"
    whole = numbers(first)["facts"]["weights"]["whole_loop"]
    factor = next(row for row in whole["figures"] if "tolerances" in row["what"])
    assert factor["robust"] >= factor["damped"] > 1.0
    assert ("robust" in found) == (whole["better"] and whole["fraction"] > 0.0)
    assert main(["design", "flexhinf-design/design.toml"]) == code  # the file lies in what is replaced
    assert file_of(first)["design"] == stated
    assert numbers(first) == numbers(again)


@pytest.mark.ci("two designs")
def test_the_weights_that_were_found_make_the_same_law(folder: Path) -> None:
    main(["design", "vertical-rig", "--pose", "home", "--bandwidth", "4", "--damping", "0.4", *FED])
    first, found = numbers(folder / "flexhinf-design")["facts"], file_of(folder / "flexhinf-design")["result"]
    assert (found["preset"], found["R2"]) == ("damped", 1.0)
    weights = ",".join(f"{name}={weight!r}" for name, weight in found["weights"].items())
    main(
        ["design", "vertical-rig", "--pose", "home", "--set", f"penalty={weights}", "--set", "effort=1", *FED]
    )
    again = numbers(folder / "flexhinf-design")["facts"]
    assert again["gamma"] == pytest.approx(first["gamma"], rel=1e-6)
    assert again["closed_modes"][0]["real"] == pytest.approx(first["closed_modes"][0]["real"], rel=1e-6)


@pytest.mark.ci("two designs")
def test_options_win_over_the_file_and_what_came_of_it_is_not_read(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "mine.toml").write_text(
        "[design]\nrobot = 'vertical-rig'\npose = 'home'\nbandwidth = 4.0\ndegrees = [2]\nrays = 0\ndraws = 0\n"
        "duration = 3.0\nestimator = 'none'\nfeedforward = false\nsaturation = 50.0\n"
        "[found]\ngamma = 'nonsense'\nmet = 3\n",
        encoding="utf-8",
    )  # fmt: skip
    main(
        [
            "design",
            "mine.toml",
            "--bandwidth",
            "5rad/s",
            "--duration",
            "0",
            "--saturation",
            "0",
            "--set",
            "feedforward=yes",
        ]
    )
    design = file_of(folder / "flexhinf-design")["design"]
    assert design == {
        "robot": "vertical-rig", "pose": [0.0], "law": "nl-hinf",
        "bandwidth": 5.0, "degrees": [2], "rays": 0, "draws": 0, "estimator": "none",
    }  # fmt: skip
    page = (folder / "flexhinf-design" / "index.html").read_text(encoding="utf-8")
    again = "design mine.toml --bandwidth 5rad/s --saturation 0 --duration 0 --set feedforward=yes"
    assert again in page
    capsys.readouterr()
    main(["design", "mine.toml", "--set", "penalty=link_position=40,link_position_integral=80"])
    note = capsys.readouterr().err
    assert "note: mine.toml: bandwidth " in note
    assert "--set penalty" in note
    design = file_of(folder / "flexhinf-design")["design"]
    assert "bandwidth" not in design
    assert design["penalty"] == {"link_position": 40.0, "link_position_integral": 80.0}


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("[design]\nrobot = 'paper'\ndampng = 0.3", "'damping'"),
        ("[design]\nrobot = 'paper'\ndamping = 2", "from 0 to 1"),
        ("[design]\nrobot = 'nowhere.toml'", "nowhere.toml"),
        ("[design]\nbandwidth = 4", "no 'robot'"),
        ("[desing]\nrobot = 'paper'", "[design] for 'desing'"),
        ("[design]\nrobot = 'paper'\npose = 'home'\nbandwidth = 4\npenalty = [1, 0, 0, 0, 3]", "contradict"),
        ("[design]\nrobot = 'paper'\npose = 'home'\nbandwidth = [4, 5]", ("bandwidth", "[4.0, 5.0]")),
        ("[design]\nrobot = 'paper'\npose = 'home'\nvia = [[9.0, 1.0]]", ("['joint']", "(9.0, 1.0)")),
        ("[design]\nrobot = 'paper'\nextras = ['rust']", "rust"),
        ("[design", "no TOML"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_design_file_is_told(
    text: str, what: str | tuple[str, ...], folder: Path, refused: Callable[..., str]
) -> None:
    (folder / "design.toml").write_text(text, encoding="utf-8")
    refused(["design", "design.toml"], what, folder)


def test_volts_do_not_fit_the_robot_of_a_design_file(folder: Path, refused: Callable[..., str]) -> None:
    (folder / "design.toml").write_text("[design]\nrobot = 'vertical-rig'", encoding="utf-8")
    refused(["design", "design.toml", "--peak-effort", "60V"], "--peak-effort in N·m", folder)


@pytest.mark.parametrize("command", ["design", "compare"])
@pytest.mark.parametrize("earlier", ["belt", "paper"])
def test_the_report_of_another_robot_is_not_replaced_in_silence(
    command: str,
    earlier: str,
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def stop(*given: object) -> None:
        raise fh.InvalidInput("A design begins.")

    if command == "design":
        monkeypatch.setattr(import_module("flexhinf.designs"), "design_with", stop)
    else:
        monkeypatch.setattr(fh, command, stop)
    report.write(folder / "made", {"design.json": json.dumps({"robot": earlier})})
    assert main([command, "paper", "--pose", "10deg", "--out", "made"]) == 2
    assert ("'belt'" in capsys.readouterr().err) is (earlier == "belt")


@pytest.mark.ci("two designs and their code")
def test_the_report_knows_the_files_of_its_robot(
    arm: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Code of a robot that was edited is that of a new design, and says so."""
    (folder / "arm.toml").write_text(arm := f"gravity = 0.0\n{arm}", encoding="utf-8")
    main(["design", "arm.toml", "--pose", "10deg", *FED])
    assert main(["export", "c", "flexhinf-design", "--no-limits", "--accept-unmet", "--out", "first"]) == 0
    assert "anew" not in capsys.readouterr().err
    (folder / "arm.toml").write_text(arm.replace("100.0", "130.0"), encoding="utf-8")
    assert main(["export", "c", "flexhinf-design", "--no-limits", "--accept-unmet", "--out", "second"]) == 0
    assert unnamed(capsys.readouterr().err, "arm.toml", "anew") == []
    digest = [
        (folder / name / "README.md").read_text().split("| digest |")[1][:70] for name in ("first", "second")
    ]
    assert digest[0] != digest[1]
