"""Where a robot may be sent, from text, files and tables."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.modal.law import workspace
from flexhinf.plant.joints import joint_ranges
from flexhinf.robot import kinematics
from flexhinf.robot.waypoints import Tool
from flexhinf.robot.workspace import ranges, workspace_of

ARM = fh.load_robot("planar-two-link")


def test_the_limits_are_the_ranges_of_the_joints() -> None:
    robot = fh.load_robot("scara")
    space = workspace_of(robot)
    low, high = kinematics.position_ranges(robot)
    np.testing.assert_array_equal([space.lower, space.upper], [low, high])
    poses = space.sample(2000, 3)
    assert np.all((poses >= low) & (poses <= high))
    np.testing.assert_allclose(poses.mean(axis=0), (low + high) / 2, atol=0.05 * (high - low).max())
    assert all(map(space.contains, poses[:20]))
    assert not space.contains(high + 0.1)


def test_a_joint_that_states_no_range_turns_by_half_a_turn() -> None:
    free = fh.load_robot("paper")
    if np.isfinite(kinematics.position_ranges(free)).all():
        pytest.skip("the joint states a range")
    np.testing.assert_allclose(ranges(free), [[-np.pi], [np.pi]])


def test_a_law_is_made_for_the_same_ranges_by_its_plant_alone() -> None:
    """Of turning and sliding joints; a sliding one without a range has no workspace, here or there."""
    robot = fh.load_robot("scara")
    poses, (low, high) = workspace(robot.plant(), 4000, 1), ranges(robot)
    assert np.all((poses >= low) & (poses <= high))
    np.testing.assert_allclose(
        [poses.min(axis=0), poses.max(axis=0)], [low, high], atol=0.01 * np.max(high - low)
    )
    (quill,) = (name for name, slides in zip(robot.joint_names, robot.links.slides) if slides)
    plant = robot.plant()
    limits = {name: pair for name, pair in plant.limits.items() if name != f"link_position_{quill}"}
    with refused_with(fh.InvalidInput, f"'link_position_{quill}'", "--workspace"):
        workspace(replace(plant, limits=limits))
    slides = robot.links.slides
    with refused_with(fh.InvalidInput, f"'{quill}'", "--workspace"):
        joint_ranges(robot.joint_names, slides, np.array([[-np.inf], [np.inf]]) * np.ones(len(slides)))


def test_a_box_of_joint_positions_in_any_unit() -> None:
    space = workspace_of(ARM, "-30deg:30deg, 0:0.5")
    np.testing.assert_allclose([space.lower, space.upper], [[-np.pi / 6, 0.0], [np.pi / 6, 0.5]])
    same = workspace_of(ARM, [(-np.pi / 6, np.pi / 6), (0.0, 0.5)])
    np.testing.assert_allclose(space.sample(5, 1), same.sample(5, 1))


def test_poses_of_a_file_and_the_ways_between_them(tmp_path: Path) -> None:
    file = tmp_path / "moves.csv"
    file.write_text("time,shoulder [deg],elbow [deg]\n0,0,0\n1,30,0\n2,30,-20\n")
    names = ARM.joint_names
    file.write_text(file.read_text().replace("shoulder", names[0]).replace("elbow", names[1]))
    poses = np.degrees(workspace_of(ARM, str(file)).sample(500, 2))
    on_first, on_second = np.abs(poses[:, 1]) < 1e-9, np.abs(poses[:, 0] - 30.0) < 1e-9
    assert np.all(on_first | on_second)
    assert 0.5 < on_first.mean() < 0.7  # by length: 30 and 20 of joints of the same range


def test_poses_need_no_time(tmp_path: Path) -> None:
    """A move does; a time that is stated has to increase."""
    rows = {"shoulder [deg]": [0.0, 30.0, 30.0], "elbow [deg]": [0.0, 0.0, -20.0]}
    timed = workspace_of(ARM, {"time": [0.0, 0.2, 5.0], **rows})
    (tmp_path / "poses.csv").write_text("# poses\nelbow [deg],shoulder [deg]\n0,0\n0,30\n-20,30\n")
    for stated in (rows, str(tmp_path / "poses.csv"), fh.Specification(workspace=rows).workspace):  # type: ignore[arg-type]
        np.testing.assert_array_equal(workspace_of(ARM, stated).sample(9, 2), timed.sample(9, 2))
    with refused_with(fh.InvalidInput, "time"):
        fh.Specification(move=rows)  # type: ignore[arg-type]
    with refused_with(fh.InvalidInput, "time"):
        fh.Specification(workspace={"time": [0.0, 0.0, 1.0], **rows})  # type: ignore[arg-type]
    with refused_with(fh.InvalidInput, "waypoints", "Waypoints("):
        workspace_of(ARM, fh.Waypoints([0.0, 1.0], [[0.0, 0.0], [1.0, 1.0]]))
    with refused_with(fh.InvalidInput, "row 2", "'elbow'"):
        fh.Specification(workspace={**rows, "elbow [deg]": [0.0, "a", 1.0]})  # type: ignore[arg-type]


def test_places_in_space_are_poses_of_the_joints() -> None:
    """Of a tool, by forward kinematics; by default of the last link's origin. Two of x, y and z are no place."""
    tool, places = Tool("elbow", (0.1, 0.0, 0.0)), {"x": [0.6, 0.5], "y [mm]": [0.0, 200.0], "z": [0.0, 0.0]}
    path = workspace_of(ARM, places, tool).path
    assert path is not None
    found = [kinematics.position_of(ARM, pose, "elbow", tool.offset) for pose in path]
    np.testing.assert_allclose(found, [[0.6, 0.0, 0.0], [0.5, 0.2, 0.0]], atol=1e-6)
    with refused_with(fh.InvalidInput, "reach", 0.6):
        workspace_of(ARM, places)
    with refused_with(fh.InvalidInput, "'x'", "y and z"):
        workspace_of(ARM, {"x": [0.4, 0.3], "y": [0.0, 0.3]})


def test_a_box_in_space_holds_the_tool() -> None:
    space = workspace_of(ARM, "x=0.05:0.4")
    poses = space.sample(30, 4)
    places = np.array([kinematics.position_of(ARM, pose) for pose in poses])
    assert np.all((places[:, 0] >= 0.05) & (places[:, 0] <= 0.4))


@pytest.mark.parametrize(
    "stated", ["0:1", "1:0,0:1", "a:b,0:1", "w=0:1", "x=1:0", "0:1,0:1,0:1", "0:1000,0:1"]
)
def test_what_is_no_workspace_is_refused(stated: str) -> None:
    with pytest.raises(fh.InvalidInput) as caught:
        workspace_of(ARM, stated)
    assert caught.value.found
    assert caught.value.advice


@pytest.mark.ci("searches every pose of a box in vain")
def test_a_box_out_of_reach_is_refused() -> None:
    with refused_with(fh.InvalidInput, "space"):
        workspace_of(ARM, "x=50:60").sample(3, 0)


@pytest.mark.parametrize(
    "stated", ["-500mm:500mm,0:1", "0:1 2deg,0:1", "-inf:inf,0:1", "x=0:1,x=0:2", "x=0:90deg", "z=0:inf"]
)
def test_units_are_those_of_the_joint_and_ends_are_finite(stated: str) -> None:
    with refused_with(fh.InvalidInput, "LOW:HIGH"):
        workspace_of(ARM, stated)


def test_two_numbers_without_a_colon_are_no_file() -> None:
    with refused_with(fh.InvalidInput, "2 joints", "--workspace -1:1,-1:1"):
        workspace_of(fh.load_robot("planar-two-link"), "-1:1")
    with refused_with(fh.InvalidInput, "workspace", "LOW:HIGH", "'-100,100'", "-100:100"):
        fh.Specification(workspace="-100,100")


def test_a_range_in_degrees_without_its_unit_is_recognised() -> None:
    low, high = np.floor(np.degrees(kinematics.position_ranges(ARM))).astype(int)
    stated = f"{low[0] + 1}:{high[0]},{low[1] + 1}:{high[1]}"
    with refused_with(fh.InvalidInput, "shoulder", "degrees") as caught:
        workspace_of(ARM, stated)
    advised = caught.value.advice.partition(",if")[0].removeprefix("--workspace ").partition(", if")[0]
    assert "deg" in advised
    workspace_of(ARM, advised)
