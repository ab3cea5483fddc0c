"""``flexhinf design``: what it tells and writes, and its exit codes."""

from __future__ import annotations

import re
import tomllib
from importlib import import_module
from pathlib import Path

import pytest
from tests import store
from tests.cli.conftest import QUICK
from tests.refusals import unnamed
from tests.tiers import ci_and_night

from flexhinf import report
from flexhinf.cli import main
from flexhinf.cli.designs import keep, other_robot

# Every design compiles its loops for a few runs: compiled in half the time.
pytestmark = pytest.mark.usefixtures("unoptimised")


def text_of(folder: Path, file: str = "index.html") -> str:
    return (folder / "flexhinf-design" / file).read_text(encoding="utf-8")


@pytest.mark.ci("designs two robots")
def test_a_design_is_told_and_written(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = [
        "--degrees",
        "2,4",
        "--pose",
        "180deg",
        "--set",
        "rays=40",
        "--draws",
        "0",
        "--verbose",
    ]
    assert main(["design", "paper", *words]) in (0, 1)
    shown = capsys.readouterr()
    for text in ("cubic", "not proved", "vibration", "index.html", "overshoot", "≤ 5 %*"):
        assert text in shown.out, text
    assert re.search(r"linear +used", shown.out)
    assert "--set rays" not in shown.err  # no note: what is sampled was stated
    assert sorted(p.name for p in folder.iterdir()) == ["flexhinf-design"]
    again = "flexhinf design paper --pose 180deg --draws 0 --degrees 2,4 --set rays=40"
    assert again in text_of(folder)
    main(["design", "vertical-rig", "--pose", "home", "--preset", "paper", "--estimator", "none", *QUICK])
    assert "vertical-rig" in text_of(folder)
    assert sorted(p.name for p in folder.iterdir()) == ["flexhinf-design", "flexhinf-design-paper"]
    assert again in (folder / "flexhinf-design-paper" / "index.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "words",
    ci_and_night(
        "a whole design",
        ["paper --pose 90deg"],
        [
            "planar-two-link --pose 0.6,0.4 --degrees 2 --draws 2",
            "vertical-rig",
            "planar-two-link --damping 0.6 --draws 2",
        ],
    ),
)
def test_all_that_a_design_prints_is_one_screen(words: str, folder: Path) -> None:
    """Of which tests/pages/test_screens.py looks at the page."""
    done = store.command(["design", *words.split()], folder)
    assert done.code in (0, 1)
    lines = done.output.splitlines()
    assert len(lines) <= 25
    assert max(map(len, lines[:-2])) <= 80
    assert "report:" in lines[-2]


def test_the_report_of_another_robot_keeps_a_place(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It was replaced, with only a note."""
    place = folder / "flexhinf-design"
    for robot in ("a b", "c", "a b"):
        other = other_robot(place, robot)
        keep(place, other)
        report.write(place, {"index.html": "", "design.json": f'{{"robot": "{robot}"}}'})
        assert other_robot(place, robot) is None
    names = [path.name for path in sorted(folder.iterdir()) if not path.name.startswith(".")]
    assert len(names) == 3
    told = capsys.readouterr().err
    assert [name for name in names if name not in told] == []


@pytest.mark.ci("two designs")
def test_the_exit_code_says_whether_the_specification_is_met(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["design", "paper", "--pose", "home", "--preset", "damped", "--estimator", "none", *QUICK]
    assert main([*words, "--overshoot", "50", "--verbose"]) == 0
    shown = capsys.readouterr().out
    assert "≤ 50 " in shown
    assert "NOT MET" not in shown
    assert "next: flexhinf export web flexhinf-design" in shown
    assert tomllib.loads(text_of(folder, "design.toml"))["result"]["met"] is True
    assert main([*words, "--overshoot", "0.1"]) == 1
    shown = capsys.readouterr().out
    assert "NOT MET" in shown
    assert "next: flexhinf export web flexhinf-design  #" in shown
    found = tomllib.loads(text_of(folder, "design.toml"))["result"]
    assert found["met"] is False
    missed = [line for line in found["requirements"] if not line["met"]]
    assert [(line["what"], line["limit"], line["stated_by"]) for line in missed] == [
        ("overshoot", 0.1, "--overshoot")
    ]
    assert missed[0]["found"] > 0.1


@pytest.mark.ci("designs two links")
def test_a_behaviour_is_asked_for_and_every_line_of_it_is_told(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--bandwidth", "0.5Hz,3", "--damping", "0.25", "--peak-effort", "24", "--via", "0.35,0.55"]
    true = [
        "--estimator",
        "none",
        "--set",
        "load=0.1",
        "--unknown-delay",
        "1e-3",
        "--quantisation",
        "1e-5",
        "--verbose",
    ]
    code = main(["design", "planar-two-link", "--pose", "home", *words, *true, *QUICK])
    shown = capsys.readouterr().out
    assert code == ("NOT MET" in shown)
    for text in ("bandwidth", "damping", "≥ 0.25", "overshoot", "peak input", "≤ 24"):
        assert text in shown, text
    design = tomllib.loads(text_of(folder, "design.toml"))["design"]
    assert design == {
        "robot": "planar-two-link", "pose": [0.4, 0.6], "law": "nl-hinf",
        "bandwidth": [3.141592653589793, 3.0], "damping": 0.25, "peak_effort": 24.0,
        "via": [[0.35, 0.55]], "load": 0.1, "unknown_delay": 1e-3, "quantisation": 1e-5,
        "estimator": "none", "degrees": [2], "rays": 0, "draws": 0,
    }  # fmt: skip
    for again in ("--via 0.35,0.55", "--bandwidth 0.5Hz,3 --damping 0.25 --peak-effort 24"):
        assert again in text_of(folder)


@pytest.mark.ci("a design")
def test_the_observer_and_a_move_can_be_asked_for(folder: Path) -> None:
    (folder / "way.csv").write_text("time,link [deg]\n0,0\n1,10\n2,20\n")
    words = [
        "--estimator",
        "observer",
        "--process-noise",
        "1e-9",
        "--move",
        "way.csv",
        "--tracking-error",
        "2deg",
    ]
    assert main(["design", "vertical-rig", "--pose", "home", *words, *QUICK]) == 0
    written = tomllib.loads(text_of(folder, "design.toml"))
    assert written["design"]["estimator"] == "observer"
    tracked = [line for line in written["result"]["requirements"] if line["what"] == "tracking error"]
    assert [line["stated_by"] for line in tracked] == ["--tracking-error"]
    assert "observer" in text_of(folder)


@pytest.mark.ci("searches weights")
def test_what_cannot_be_met_is_refused_with_the_best_found(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--bandwidth", "6", "--pose", "20deg", "--start", "-20deg", "--peak-effort", "5"]
    assert main(["design", "paper", *words, *QUICK]) == 2
    told = capsys.readouterr().err
    assert unnamed(told, "peak", "input", "--peak-effort") == []  # the option that was typed
    assert "try:" in told
    assert list(folder.iterdir()) == []


@pytest.mark.ci("two designs")
def test_an_interrupted_design_leaves_what_was_there(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["design", "vertical-rig", "--pose", "home", "--preset", "paper", "--estimator", "none", *QUICK]
    main(words)
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}

    def stop(*arguments: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(import_module("flexhinf.pages"), "design_text", stop)
    assert main([*words, "--pose", "10deg"]) == 130
    assert "Interrupted" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


@pytest.mark.ci("a design")
def test_a_tolerance_that_looks_like_a_fraction_is_warned_of_in_terminal_and_report(
    arm: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told = arm.replace("stiffness = 100.0", "stiffness = {value = 100.0, tolerance = 0.05}")
    (folder / "arm.toml").write_text(told, encoding="utf-8")
    assert main(["design", "arm.toml", "--pose", "home", *QUICK, "--estimator", "none"]) == 0
    assert "fraction" in capsys.readouterr().err
    page = text_of(folder)
    assert unnamed(page, "fraction", "damping ratio", 0.2) == []


def test_help_lists_every_option_with_its_default(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["design", "--help-all"]) == 0
    shown = capsys.readouterr().out
    for text in (
        "--preset",
        "--via",
        "--peak-effort",
        "4 (rad/s)",
        "[mujoco]",
        "Examples",
        "observer",
        "Exit code",
    ):
        assert text in " ".join(shown.replace("│", " ").split()), text
    for default in ("flexhinf-design", "0.001", "auto", "1.5", "20.0", "link_position"):
        assert f"[default: {default}]" in shown
