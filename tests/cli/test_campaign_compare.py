"""``flexhinf campaign compare``: two judged reports on the same robots, again, in shards; what it refuses."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.builders import arm_controller, report_numbers

import flexhinf as fh
from flexhinf import report
from flexhinf.cli import main

pytest.importorskip("pyarrow")

# Short runs of two controllers: compiled in half the time.
pytestmark = pytest.mark.usefixtures("unoptimised")

DESIGN = """
[design]
robot = "paper"
estimator = "{}"
process_noise = {:g}
pose = "home"
overshoot = 30.0
[result]
duration = 0.5
requirements = []
"""
WORDS = ["campaign", "compare", "ekf/design.toml", "ukf/design.toml", "--samples", "40", "--batch", "16"]
WORDS += ["--out", "both"]


@pytest.fixture
def judged(folder: Path) -> Path:
    """Reports of two designs, as far as a campaign needs them: the same linear law behind EKF and a faster UKF."""
    for name, kind, q in (("ekf", fh.ExtendedKalmanFilter, 1e-8), ("ukf", fh.UnscentedKalmanFilter, 1e-4)):
        arm_controller(kind=kind, q=q, r=1e-8, p0=1e-6, start="bumpless").save(folder / "law")
        files = {"design.toml": DESIGN.format(name, q), "design.json": report_numbers()}
        report.write(folder / name, {**files, "controller": (folder / "law").read_bytes()})
    (folder / "law").unlink()
    return folder


@pytest.mark.ci("two campaigns, their page and a replay")
def test_two_estimators_on_the_same_robots(judged: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(WORDS) == 0
    text = "".join(capsys.readouterr())
    assert "40 robots" in text
    assert "B − A" in text
    page = (judged / "both" / "index.html").read_text()
    for part in (
        "McNemar",
        "estimator",
        "Largest differences",
        "flexhinf campaign replay both/b --sample",
    ):
        assert part in page
    tables = [(judged / "both" / side / "samples.parquet").read_bytes() for side in "ab"]
    assert tables[0] != tables[1]
    assert main(["campaign", "replay", "both/b", "--sample", "7"]) == 0
    assert "same bits" in capsys.readouterr().out


@pytest.mark.ci("two campaigns with their page")
def test_samples_that_are_not_independent_have_neither_test_nor_interval(
    judged: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*WORDS, "--method", "latin-hypercube"]) == 0
    text, page = "".join(capsys.readouterr()), (judged / "both" / "index.html").read_text()
    assert "Latin hypercube" in text
    assert "no confidence" in page
    for place in (text, page):
        assert "McNemar" not in place
        assert "(95 %" not in place.replace("\N{NO-BREAK SPACE}", " ")


@pytest.mark.ci("two campaigns, three times")
def test_shards_and_half_a_folder_come_to_the_same_tables(judged: Path) -> None:
    assert main(WORDS) == 0
    whole = [(judged / "both" / side / "samples.parquet").read_bytes() for side in "ab"]
    next((judged / "both" / "b" / "shards").iterdir()).unlink()
    assert main(WORDS) == 0
    assert whole == [(judged / "both" / side / "samples.parquet").read_bytes() for side in "ab"]
    shutil.rmtree(judged / "both" / "b")
    for shard in ("1/2", "2/2"):
        assert main([*WORDS, "--shard", shard]) == 0
    assert whole == [(judged / "both" / side / "samples.parquet").read_bytes() for side in "ab"]


def test_designs_that_do_not_share_robot_sensors_and_step_are_refused(
    judged: Path, refused: Callable[..., str]
) -> None:
    file = judged / "ukf" / "design.toml"
    text = file.read_text()
    for line, what in (
        ('measured = "motor_position"', "measured: default ↔ ['motor_position']"),
        ("measurement_noise = 1e-6", "measurement_noise: default ↔ 1e-06"),
        ('pose = "30deg"', "goal: "),
        ("saturation = 12.0", "saturation: [inf] ↔ [12.0]"),
        ('extras = "inductance"', "extras: "),
        ("period = 0.002", "period: default ↔ 0.002"),
    ):
        kept = text.replace('pose = "home"\n', "") if line.startswith("pose") else text
        file.write_text(kept.replace("overshoot = 30.0", f"overshoot = 30.0\n{line}"))
        message = refused(WORDS, "↔", judged)
        assert what in message
    assert not (judged / "both").exists()


@pytest.mark.ci("runs two campaigns")
def test_other_folders_and_options_are_refused(judged: Path, refused: Callable[..., str]) -> None:
    refused([*WORDS[:-1], "ekf"], "comparison", judged)
    refused([*WORDS, "--samples", "0"], "samples", judged)
    refused([*WORDS, "--require", "overshot<=5"], "no metric 'overshot'", judged)
    assert main([*WORDS, "--shard", "1/2"]) == 0
    assert "samples: 40 → 41" in refused([*WORDS, "--samples", "41"], ("another", "settings"), judged)
    swapped = [*WORDS[:2], WORDS[3], WORDS[2], *WORDS[4:]]
    refused(swapped, ("another", "settings", "1e-08"), judged)
