"""``flexhinf compare``: files, exit codes, and mistakes before any work."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.refusals import unnamed

from flexhinf.cli import main
from flexhinf.design import tuning
from flexhinf.report import is_report

# Laws that are compiled for some short runs: compiled in half the time.
pytestmark = pytest.mark.usefixtures("unoptimised")

WORDS = [
    "compare", "vertical-rig", "--pose", "0.8", "--start", "0.3", "--degrees", "2",
    "--estimator", "ekf", "--draws", "2", "--duration", "4", "--candidates", "0,0",
]  # fmt: skip


@pytest.mark.ci("tunes three laws")
def test_one_table_one_page_and_the_numbers(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*WORDS, "--laws", "pd, lqr"]) == 0
    told = capsys.readouterr()
    assert "nl-hinf" in told.out
    out = folder / "flexhinf-compare"
    assert is_report(out)
    found = json.loads((out / "comparison.json").read_text(encoding="utf-8"))
    assert [law["name"] for law in found["laws"]] == ["design", "nl-hinf", "pd", "lqr"]
    sensors = {law["name"]: law["tuned"]["sensors"] for law in found["laws"] if law["compared"]}
    assert sensors["pd"] == ["motor_position"]
    assert all(law["tuned"] is None and law["failure"] for law in found["laws"] if not law["compared"])
    assert "Criterion: " in told.out.partition("\n")[0]
    page = (out / "index.html").read_text(encoding="utf-8")
    verdict = page.split('class="verdict"')[1].partition("</p>")[0]
    assert unnamed(verdict, found["best_rival"] or "no") == []
    assert "flexhinf compare vertical-rig" in page
    assert "--laws &#x27;pd, lqr&#x27;" in page


@pytest.mark.ci("tunes two laws")
def test_one_set_of_sensors_for_all(folder: Path) -> None:
    assert main([*WORDS, "--laws", "pd", "--same-sensors"]) == 0
    found = json.loads((folder / "flexhinf-compare" / "comparison.json").read_text(encoding="utf-8"))
    sensors = [law["tuned"]["sensors"] for law in found["laws"] if law["compared"]]
    assert sensors == len(sensors) * [["link_position"]]
    assert len(sensors) >= 1


@pytest.mark.ci("designs a robot, and runs two laws")
def test_a_design_file_is_what_the_others_are_compared_with(
    folder: Path, arm: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "arm.toml").write_text(arm, encoding="utf-8")
    design = [
        "design",
        "arm.toml",
        "--pose",
        "0.3",
        "--degrees",
        "2",
        "--set",
        "rays=0",
        "--bandwidth",
        "4",
    ]
    stated = [
        "--set",
        "compare_rigid=no",
        "--torque-noise",
        "1e-6",
        "--duration",
        "1",
    ]  # no search of noise
    assert main([*design, *stated]) in (0, 1)
    against = ["compare", "flexhinf-design/design.toml", "--out", "against", "--candidates", "0,0"]
    assert main([*against, "--laws", "pd", "--tune", "none"]) == 0
    found = json.loads((folder / "against" / "comparison.json").read_text(encoding="utf-8"))
    assert found["design"]["preset"] == "damped"
    assert len(found["design"]["verdict"]["requirements"]) > 5  # the design's own verdict stands beside
    assert found["goal"] == [0.3]
    assert found["tune"]["mode"] == "none"
    assert found["drawn"] == 0


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (["--laws", "pd,lqr-gravty"], "lqr-gravity"),
        (["--laws", "nl-hinf-1"], "nl-hinf-2"),
        (["--tune", "volts"], "bandwidth"),
        (["--candidates", "4"], "--candidates 4,2"),
        (["--candidates", "4,x"], "--candidates 4,2"),
    ],
)
def test_mistakes_come_before_the_work(
    folder: Path, refused: Callable[..., str], words: list[str], what: str
) -> None:
    assert what in refused([*WORDS, *words], what, folder)
    assert not (folder / "flexhinf-compare").exists()


@pytest.mark.ci("a design before what is interrupted")
def test_interrupted_nothing_is_written(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def stopped(*arguments: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(tuning.Tuner, "tune", stopped)
    assert main([*WORDS, "--laws", "pd"]) == 130
    told = capsys.readouterr().err
    assert "Interrupted" in told
    assert "step 1 of" in told  # a line for each step, as this is no terminal
    assert "design: tune" in told
    assert not list(folder.iterdir())
