"""The examples run, and say something true."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.design.workspace.setup import WorkspaceSetup
from flexhinf.modal import ModalLaw
from flexhinf.modal.pair import PairWeights
from flexhinf.robot.workspace import workspace_of


def test_every_example_is_tested(repository: Path) -> None:
    found = {file.stem for file in (repository / "examples").glob("*.py")}
    tested = {name.removeprefix("test_example_") for name in globals() if name.startswith("test_example_")}
    assert found == tested


def test_example_step_response(repository: Path, tmp_path: Path) -> None:
    metrics = runpy.run_path(str(repository / "examples" / "step_response.py"))["main"](tmp_path)
    overshoot = {name: found["overshoot_percent"] for name, found in metrics.items()}
    assert overshoot["linear about the goal"] < 2.0 < 10.0 < overshoot["cubic about the goal"]
    assert overshoot["cubic about the hanging rest"] < 2.0 < 20.0 < overshoot["linear about the hanging rest"]
    assert (tmp_path / "step_180.svg").read_text().count("<svg") == 1


def test_example_stirred_tank(repository: Path, capsys: pytest.CaptureFixture[str]) -> None:
    figures = runpy.run_path(str(repository / "examples" / "stirred_tank.py"))["main"]()
    assert figures["final_deviation_K"] < 0.5 < figures["largest_deviation_K"] < 10.0
    assert "γ*" in capsys.readouterr().out


def test_example_certified_reactor(repository: Path) -> None:
    figures = runpy.run_path(str(repository / "examples" / "certified_reactor.py"))["main"]()
    assert figures["proved"] == 1.0
    assert figures["hotter_K"] > 10.0


def test_example_two_link_arm(repository: Path) -> None:
    errors = runpy.run_path(str(repository / "examples" / "two_link_arm.py"))["main"]()
    assert errors["final_error_rad"] < 0.002 < errors["largest_error_rad"] < 0.4


@pytest.mark.slow
def test_a_row_of_the_regions_page_is_computed_again(repository: Path) -> None:
    example = runpy.run_path(str(repository / "examples" / "region_of_validity.py"))
    page = (repository / "docs" / "regions.md").read_text(encoding="utf-8").splitlines()
    assert example["largest_steps"](example["ROWS"][0], "command", 90).row in page
    assert example["largest_steps"](example["ROWS"][1], "command", 90, seed=7).row in page


@pytest.mark.slow
def test_example_region_of_validity(repository: Path, tmp_path: Path) -> None:
    cases = runpy.run_path(str(repository / "examples" / "region_of_validity.py"))["main"](tmp_path)
    for case in cases:
        linear, cubic, quintic = case.steps.values()
        assert linear < 0.5 < 1.4 < cubic < quintic
    assert cases[1].steps[6] > cases[0].steps[6]
    assert (tmp_path / "regions.svg").read_text().count("<svg") == 1


@pytest.mark.slow
def test_the_whole_table_of_the_regions_page_is_computed_again(repository: Path) -> None:
    example = runpy.run_path(str(repository / "examples" / "region_of_validity.py"))
    page = (repository / "docs" / "regions.md").read_text(encoding="utf-8").splitlines()
    rows = [example["largest_steps"](*wanted).row for wanted in example["wanted_rows"]()]
    assert [row for row in rows if row not in page] == []
    assert len([line for line in page if line.startswith("| (")]) == len(rows)


@pytest.mark.slow
def test_example_specified_design(repository: Path) -> None:
    design = runpy.run_path(str(repository / "examples" / "specified_design.py"))["main"](20)
    assert design.met
    assert design.evaluation.corners.unstable == 0
    found = design.synthesis.robust  # compared with the preset damped, estimator in the loop
    assert found.better
    assert found.chosen.scale > 1.1 * found.damped.scale > 1.1


def test_example_moving_reference(repository: Path) -> None:
    errors = runpy.run_path(str(repository / "examples" / "moving_reference.py"))["main"]()
    assert errors["sine"] < 0.2
    assert errors["move"] < 2.0


def test_example_several_poses(repository: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With a law that no search has chosen, for the sake of time; the encoder's offset is what remains."""
    pytest.importorskip("mujoco")
    example = runpy.run_path(str(repository / "examples" / "several_poses.py"))
    robot, sensors = fh.load_robot("planar-two-link"), ("link_position", "motor_position")
    law = ModalLaw.tuned(
        robot.problem(fh.Penalty({"link_position": 1.0})), weights=PairWeights(bandwidth=20.0)
    )
    s = fh.Specification(workspace="limits", measured=sensors, saturation=24.0)
    setup = WorkspaceSetup(robot, s, workspace_of(robot, "limits"), law)
    errors = example["main"](setup.controller(np.array(robot.home), supervision=setup.supervision))
    assert max(errors) < 0.6
    assert "OUTSIDE_WORKSPACE" in capsys.readouterr().out
