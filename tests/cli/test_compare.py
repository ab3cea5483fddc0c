"""``flexhinf compare``: files, exit codes, and mistakes before any work."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tests.refusals import unnamed

from flexhinf.cli import main
from flexhinf.designs import compare
from flexhinf.report import is_report

# Laws that are compiled for some short runs: compiled in half the time.
pytestmark = pytest.mark.usefixtures("unoptimised")

WORDS = [
    "compare", "vertical-rig", "--pose", "0.8", "--start", "0.3", "--degrees", "2", "--set", "rays=0",
    "--estimator", "ekf", "--torque-noise", "1e-6", "--draws", "2", "--duration", "4",
]  # fmt: skip


def laws_of(folder: Path) -> list[dict[str, Any]]:
    return json.loads((folder / "comparison.json").read_text(encoding="utf-8"))["laws"]


@pytest.mark.ci("designs of three laws")
def test_one_table_one_page_and_the_numbers(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "mine.toml").write_text("[pd]\nkp = 0.4\nkd = 0.1\n", encoding="utf-8")
    assert main([*WORDS, "--laws", "pd, lqg", "--gains", "mine.toml"]) == 0
    told = capsys.readouterr()
    out = folder / "flexhinf-compare"
    assert is_report(out)
    laws = {law["name"]: law for law in laws_of(out)}
    assert [*laws] == ["design", "pd", "lqg"]
    assert (laws["design"]["law"], laws["pd"]["stated"], laws["lqg"]["stated"]) == ("nl-hinf", True, False)
    assert (laws["pd"]["measured"], laws["lqg"]["measured"]) == (
        ["motor_position"],
        laws["design"]["measured"],
    )
    assert laws["pd"]["numbers"] == {"kp": [0.4], "kd": [0.1]}
    assert unnamed(" ".join(told.out.split()), "Criterion:", *laws) == []
    page = (out / "index.html").read_text(encoding="utf-8")
    assert "Criterion:" in page.split('class="verdict"')[1].partition("</p>")[0]
    assert "flexhinf compare vertical-rig" in page
    assert "--laws &#x27;pd, lqg&#x27;" in page


@pytest.mark.ci("designs of two laws")
def test_one_set_of_sensors_for_all(folder: Path) -> None:
    assert main([*WORDS, "--laws", "pd", "--same-sensors"]) == 0
    laws = laws_of(folder / "flexhinf-compare")
    assert [law.get("measured") for law in laws] == len(laws) * [["link_position"]]


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (["--laws", "pd,lqg-gravty"], "lqg"),
        (["--laws", "nl-hinf-2"], "nl-hinf"),
        (["--tune", "peak"], "--tune"),
        (["--candidates", "4,2"], "--candidates"),
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
    module: Any = sys.modules[compare.__module__]
    own = module.evidence_of

    def stopped(robot: Any, s: Any, progress: Callable[[str], None], **more: Any) -> Any:
        progress("loops")
        raise KeyboardInterrupt

    def first(*arguments: Any) -> Any:
        monkeypatch.setattr(module, "evidence_of", stopped)
        return own(*arguments)

    monkeypatch.setattr(module, "evidence_of", first)
    assert main([*WORDS, "--laws", "pd"]) == 130
    told = capsys.readouterr().err
    assert "Interrupted" in told
    assert "step 1 of" in told  # a line for each step, as this is no terminal
    assert "pd: loops" in told
    assert not list(folder.iterdir())
