"""``python -m benchmarks.drives``: a case at small size, resumed; and what the tables say."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks import drives, interfaces
from benchmarks.workspace.robots import ROBOTS


def test_a_servo_has_the_drives_that_are_stated() -> None:
    robot = drives.servo(ROBOTS["planar-two-link"].robot(), "position", drives.BANDWIDTHS["unlike"])
    p = robot.plant_parameters()
    assert np.sqrt(p["drive_stiffness"] / p["motor_inertia"]) / (2.0 * np.pi) == pytest.approx([20.0, 12.0])
    assert p["drive_damping"] == pytest.approx(2.0 * 0.9 * np.sqrt(p["drive_stiffness"] * p["motor_inertia"]))
    assert robot.drive == "position"
    assert not {"resistance_shoulder", "torque_constant_shoulder"} & {*robot.nominal}
    assert robot.effort_limits == pytest.approx(
        [1.2 * max(np.abs(pair)) for pair in robot.links.limits or () if pair]
    )


@pytest.mark.ci("designs a robot of one link")
def test_a_case_is_kept_and_not_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The damping of the drive alone is that of the open loop's poles; a second run makes nothing."""
    wanted = [drives.Case("paper", "position", "like", "both sides")]
    monkeypatch.setattr(drives, "cases", lambda robots, kinds: iter(wanted))
    words = ["--robots", "paper", "--poses", "2", "--moves", "1", "--kept", str(tmp_path / "rows.json")]
    assert drives.main(words) == 0
    rows = json.loads((tmp_path / "rows.json").read_text(encoding="utf-8"))
    record = rows["paper/position/like/both sides"]
    own, alone = (record[law]["stated"] for law in ("design", "alone"))
    assert own["damping"] > 5.0 * alone["damping"] > 0.0
    robot = drives.servo(ROBOTS["paper"].robot(), "position", (20.0,)).damped
    poles = np.concatenate(
        [
            np.linalg.eigvals(robot.plant(extras="joint_damping").linearise(*robot.operating_point(pose))[0])
            for pose in drives.workspace_of(robot).sample(2, drives.POSES_SEED)
        ]
    )
    swinging = poles[np.abs(poles.imag) > 1e-6]
    assert alone["damping"] == pytest.approx(np.min(-swinging.real / np.abs(swinging)), rel=0.02)

    def again(*arguments: Any) -> dict[str, Any]:
        raise AssertionError("it is kept")

    monkeypatch.setattr(drives, "made", again)
    assert drives.main(words) == 0
    capsys.readouterr()
    assert drives.main([*words, "--table"]) == 0
    cells = [cell.strip() for cell in capsys.readouterr().out.splitlines()[2].split("|")]
    assert cells[1:4] == ["paper", "position, 250 Hz", "both sides"]


def test_the_tables_of_the_docs_have_every_case_that_is_kept() -> None:
    kept = drives.kept_in(drives.KEPT)
    assert len(drives.table(kept).splitlines()) == 2 + len(kept)
    assert {*kept} <= {case.name for case in drives.cases(list(ROBOTS), list(drives.LOOPS))}


def test_a_pair_of_torques_vibrates_against_its_motor() -> None:
    """Free at both ends the pair vibrates √2 times as fast as with its motor held; its mean moves by the input."""
    a, b = interfaces.pair("torque", 10.0, 0.0)
    assert np.sort(np.abs(np.linalg.eigvals(a).imag))[-1] == pytest.approx(np.sqrt(2.0) * 10.0)
    assert (a @ np.array([1.0, 0.0, 1.0, 0.0]) == 0.0).all()
    assert b[3, 0] == 100.0
