"""A design for a workspace: when one is made, what it reads, what is judged, and what comes back from its files."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests import workspaces
from tests.refusals import refused_with, unnamed

import flexhinf as fh
from flexhinf.designs import PoseEvidence, WorkspaceEvidence, design_workspace, stages
from flexhinf.designs.fields import readers, resolved
from flexhinf.designs.laws import LAWS, MODAL
from flexhinf.designs.responses import motion_metrics
from flexhinf.designs.specification import FIELDS, SpecificationError
from flexhinf.designs.task import Task
from flexhinf.designs.workspace.design import check_loop
from flexhinf.designs.workspace.resting_loops import DAMPING, GAIN
from flexhinf.designs.workspace.samples import corner_moves
from flexhinf.designs.workspace.search import ChosenPoses, tuned_setup
from flexhinf.pages import design_files
from flexhinf.pages.page import design_page
from flexhinf.pages.workspace_summary import workspace_verdict
from flexhinf.processors import limited_threads
from flexhinf.report import Figure
from flexhinf.robot.workspace import workspace_of

Named = Callable[[str], Any]


#: Few poses and goals, and one bandwidth.
FEW: dict[str, Any] = {
    "POSES": 4, "GOALS": 2, "CHOSEN_POSES": 2, "MODAL_POSES": 30, "BANDWIDTHS": (28.0,),
}  # fmt: skip


@pytest.fixture(autouse=True)
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    workspaces.few(monkeypatch, **FEW)


@pytest.fixture(scope="module")
def by_default(robot_of: Named) -> fh.Design:
    """A design of two links, of which nothing is stated, made by two processes."""
    with pytest.MonkeyPatch.context() as patch, limited_threads(2):
        workspaces.few(patch, **FEW)
        return fh.design(robot_of("planar-two-link"))


# When one is made ----------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "fields",
    [{}, {"workspace": "limits"}, {"estimator": "none", "damping": 0.3, "seed": 2}, {"law": "pd"}],
)
def test_without_a_pose_a_design_is_for_the_workspace(robot_of: Named, fields: dict[str, Any]) -> None:
    s = resolved(robot_of("planar-two-link"), fh.Specification(**fields))
    assert (s.pose, s.workspace, s.law) == (None, "limits", fields.get("law", MODAL))


@pytest.mark.ci("designs for a workspace")
def test_by_default_it_is_for_the_joint_ranges(robot_of: Named, by_default: fh.Design) -> None:
    design, told = by_default, list[str]()
    evidence = design.evidence
    assert isinstance(evidence, WorkspaceEvidence)
    assert design.specification.workspace == "limits"
    low, high = np.array(robot_of("planar-two-link").links.limits).T
    assert np.all((evidence.poses >= low) & (evidence.poses <= high))
    other = fh.design(robot_of("planar-two-link"), fh.Specification(workspace="limits"), told.append)
    assert design_files(other, ())["design.json"] == design_files(design, ())["design.json"]
    assert len(told) == len(stages(other.robot, other.specification))


@pytest.mark.ci("designs for a workspace")
def test_a_rigid_joint_is_served_too(robot_of: Named) -> None:
    whole, s = (
        robot_of("planar-two-link"),
        fh.Specification(measured=("link_position", "motor_position"), workspace="limits"),
    )
    kept = tuple(p for p in whole.parameters if p.name not in ("stiffness_elbow", "damping_elbow"))
    rigid = fh.Robot(whole.name, kept, whole.penalty, whole.links, whole.drive, whole.home, rigid=("elbow",))
    setup = tuned_setup(rigid, s, Task(workspace_of(rigid)))
    loops = [setup.at_pose(pose) for pose in setup.workspace.sample(10, 3)]
    assert max(loop.late for loop in loops) < 1.0
    assert min(loop.damping for loop in loops) > 0.2
    move = setup.move(setup.goals(2, 5)[0])
    for row in motion_metrics(setup.limits, move.response, move.plan):
        assert row["remaining_error"] < 1e-3


# What it reads -------------------------------------------------------------------------------------------
@pytest.mark.ci("designs for a workspace")
def test_it_reads_its_own_fields_and_no_other(
    robot_of: Named, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """As `tests/cli/test_options.py` records it of a design of one pose."""
    from tests.cli.test_options import BEHIND, WRITERS

    read: set[str] = set()

    def recorded(s: fh.Specification, name: str) -> Any:
        file = Path(sys._getframe(1).f_code.co_filename).name
        if name in BEHIND or (name in FIELDS and file not in (*WRITERS, "specification.py", "fields.py")):
            read.add(BEHIND.get(name, name))
        return object.__getattribute__(s, name)

    monkeypatch.setattr(fh.Specification, "__getattribute__", recorded)
    design = fh.design(robot_of("planar-two-link"))
    own = {*FIELDS} - ({*readers()} - {*LAWS[MODAL].fields})
    assert own - read <= {"angle_unit", "law"}
    design.save(tmp_path / "report")
    assert own - read <= {"law"}


@pytest.mark.ci("five designs")
def test_seed_draws_speeds_and_gains_change_what_is_looked_at(robot_of: Named) -> None:
    robot = robot_of("planar-two-link")
    plain = design_workspace(robot, fh.Specification())
    other = design_workspace(robot, fh.Specification(seed=1, draws=3, peak_speed=0.2, gamma_ratio=1.5))
    assert not np.any(plain.poses == other.poses)
    assert (len(plain.sampled), len(other.sampled)) == (2, 3)
    assert not design_workspace(robot, fh.Specification(draws=0)).sampled
    slowest = [max(move.plan.duration for move in design.moves) for design in (plain, other)]
    assert slowest[1] > slowest[0]
    stays, leaves = (
        design_workspace(robot, fh.Specification(draws=0, gain_margin=gain)) for gain in (1.01, 50.0)
    )
    missed = [next(line.found for line in d.requirements if "gain" in line.what) for d in (stays, leaves)]
    assert missed == [0.0, 4.0]
    assert all(max(loop.louder, loop.softer) < 1.0 for loop in stays.loops)


@pytest.mark.ci("designs for a workspace twice")
def test_any_number_of_processes_makes_the_same_design(robot_of: Named, by_default: fh.Design) -> None:
    robot, found = robot_of("planar-two-link"), []
    for count in (1, 2):
        with limited_threads(count):
            evidence = (by_default if count == 2 else fh.design(robot)).evidence
            assert isinstance(evidence, WorkspaceEvidence)
            poses = ChosenPoses(robot, evidence.specification, evidence.setup.workspace, 4)
            setup = replace(evidence.setup, specification=poses.wanted)
            excess = poses.excess(setup)
            assert excess is not None
            assert poses.excess(setup, excess.tolist()) is None
            assert np.array_equal(poses.excess(setup, [np.inf]), excess)
            moves = [move.response.run.signals for move in (*evidence.moves, *evidence.sampled)]
            loops = evidence.loops, evidence.corner_loops, evidence.undamped
            found.append((excess, loops, moves, evidence.requirements, evidence.look_beyond()))
    np.testing.assert_equal(*found)


@pytest.mark.nightly(
    "designs for a pose twice; tests/designs/synthesis/test_noise.py searches its noise twice"
)
def test_any_number_of_processes_makes_the_same_design_of_a_pose(robot_of: Named) -> None:
    wanted, found = fh.Specification(pose=np.pi / 2, start=0.0, measured=("motor_position",), draws=2), []
    for count in (1, 2):
        with limited_threads(count):
            evidence = fh.design(robot_of("paper"), wanted).evidence
            assert isinstance(evidence, PoseEvidence)
            noise, corners = evidence.synthesis.noise_search, evidence.evaluation.corners
            assert noise is not None
            assert corners is not None
            levels = noise.chosen.levels.link_velocities, noise.chosen.levels.motor_velocities
            figures = [
                block
                for part in design_page(evidence, ["flexhinf"]).sections
                for block in part.blocks
                if isinstance(block, Figure)
            ]
            found.append((levels, noise.count, [each.rates for each in corners.swept], figures))
    np.testing.assert_equal(*found)


@pytest.mark.ci("designs the arm three times")
def test_where_the_worst_move_is_near_a_limit_further_robots_move(robot_of: Named) -> None:
    """Between goals of their own, after the first ones, which stay the same; stated draws are kept."""
    arm, s = (
        robot_of("paper"),
        fh.Specification(workspace=((0.0, 0.3),), tracking_error=1.0, remaining_error=1.0),
    )
    far = fh.design(arm, s).evidence
    worst = max(joint["tracking_error"] for move in far.sampled for joint in move.motion)
    limits = {"tracking_error": worst / 0.9, "remaining_error": 1.0}
    near = fh.design(arm, replace(s, **limits)).evidence
    assert (len(far.sampled), len(near.sampled)) == (2, 4)
    first, further = near.sampled[:2], near.sampled[2:]
    assert [move.motion for move in first] == [move.motion for move in far.sampled]
    goals = {float(move.response.goal[0]) for move in (*first, *further)}
    assert len(goals) == 4
    ways = np.stack([near.goals[:-1], near.goals[1:]], axis=1)
    others = [one for after in (0, 1) for one in corner_moves(near.setup, after, ways)]
    made = [near.setup.move(*one).motion for one in others]
    assert made == [move.motion for move in near.sampled]  # by which the cause of an error is found
    assert unnamed(workspace_verdict(near), "2 further ones") == []
    assert len(fh.design(arm, replace(s, **limits, draws=2)).evidence.sampled) == 2


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"quantisation": (1e-3, 1e-3, 1e-3)}, ("quantisation",)),
        ({"extras": ("rust",)}, ("rust",)),
        ({"saturation": (1.0, 2.0, 3.0)}, ("saturation",)),
        ({"workspace": "-9:9,0:1"}, ("'shoulder'",)),
        ({"workspace": {"time": [0, 1], "wrist": [0, 1]}}, ("'wrist'",)),
    ],
)
def test_what_does_not_fit_the_robot_is_refused_before_any_work(
    robot_of: Named, fields: dict[str, Any], words: tuple[str, ...]
) -> None:
    told: list[str] = []
    with refused_with(fh.InvalidInput, *words):
        fh.design(robot_of("planar-two-link"), fh.Specification(**fields), told.append)
    assert told == []


@pytest.mark.parametrize(
    "measured",
    [
        "link_position_elbow", "joint_torque", "motor_velocity", "torque", "LINK_POSITION",
        "link_position motor_position", "link_position,link_position_elbow",
        "link_position,motor_positon", "current", "link_position_wrist,motor_position_elbow",
    ],
)  # fmt: skip
def test_the_advice_for_sensors_works_as_it_is_typed(robot_of: Named, measured: str) -> None:
    """On the command line, before any work."""
    from flexhinf.cli.messages import error_text

    robot, told = robot_of("planar-two-link"), list[str]()
    with refused_with(fh.InvalidInput, "link_position") as refusal:
        fh.design(robot, fh.Specification(measured=tuple(measured.split(","))), told.append)
    assert told == []
    what, found, advice = error_text(refusal.value).splitlines()
    assert len(what) < 80
    assert len(found) < 300
    option, typed = advice.split()[-2:]
    if option == "--measured":
        check_loop(robot, fh.Specification(workspace="limits", measured=tuple(typed.split(","))))
        return
    assert "--pose" in advice  # a design with these sensors: they tell the whole state at the pose
    plant, (x, u) = robot.plant(tuple(measured.split(","))), robot.operating_point()
    a, *_, c = plant.linearise(x, u)
    seen = np.vstack([c @ np.linalg.matrix_power(a, k) for k in range(len(x))])
    assert np.linalg.matrix_rank(seen / np.linalg.norm(seen, axis=1)[:, None]) == len(x)


# Workspaces as people state them -------------------------------------------------------------------------
def test_a_workspace_is_text_pairs_or_waypoints(robot_of: Named, tmp_path: Path) -> None:
    pd = pytest.importorskip("pandas")
    columns = {"time": [0.0, 1.0], "shoulder": [0.0, 0.5], "elbow": [0.1, 0.2]}
    pd.DataFrame(columns).to_csv(tmp_path / "way.csv", index=False)
    tables = [
        fh.Specification(workspace=stated).workspace  # type: ignore[arg-type]
        for stated in (columns, pd.DataFrame(columns), tmp_path / "way.csv", str(tmp_path / "way.csv"))
    ]
    assert all(table == tables[0] for table in tables)
    pairs = fh.Specification(workspace=[(-0.5, "30deg"), np.array([0.0, 0.25])]).workspace  # type: ignore[arg-type]
    assert pairs == "-0.5:30deg,0.0:0.25"
    for bad in ("", 3.0, [1.0, 2.0], [(1.0, 2.0, 3.0)], [], lambda t: t):
        with refused_with(SpecificationError, "workspace"):
            fh.Specification(workspace=bad)  # type: ignore[arg-type]


# Files ---------------------------------------------------------------------------------------------------
@pytest.mark.ci("designs for a workspace")
def test_its_folder_gives_back_controller_and_specification(robot_of: Named, tmp_path: Path) -> None:
    """The controller of the file makes the same steps."""
    robot, s = robot_of("planar-two-link"), fh.Specification(draws=0, workspace=[(-0.5, 0.5), (0.0, 0.5)])  # type: ignore[arg-type]
    design = fh.design(robot, s)
    folder = design.save(tmp_path / "report")
    own, stored = design.controller(), fh.load_controller(folder)
    assert isinstance(own.law, fh.ModalLaw)
    assert isinstance(stored.estimator, fh.ModalFilter)
    reference = np.zeros(len(own.commanded))
    for y in (np.zeros(2), np.full(2, 1e-3), np.full(2, -1e-3)):
        np.testing.assert_array_equal(own.step(y, reference), stored.step(y, reference))


@pytest.mark.ci("designs for a workspace")
def test_a_box_in_space_is_for_its_tool(robot_of: Named) -> None:
    """The hand of the planar arm, 0.1 m beyond its last link; poses by forward kinematics of the robot."""
    from flexhinf.cli.arguments import read_source
    from flexhinf.robot.kinematics import position_of

    request = read_source("planar-two-link", "", {"workspace": "x=0.1:0.5"}, tool="elbow:0.1,0,0")
    design = fh.design(request.robot, replace(request.specification, draws=0))
    assert design.specification.workspace == "x=0.1:0.5@elbow:0.1,0,0"
    reached = [
        position_of(request.robot, pose, "elbow", (0.1, 0.0, 0.0))[0] for pose in design.evidence.poses
    ]
    assert 0.1 <= min(reached) <= max(reached) <= 0.5


def test_the_help_states_the_limits_of_a_workspace() -> None:
    assert f"{GAIN:g} for a workspace" in FIELDS["gain_margin"].about.text
    assert f"{DAMPING:g} for a workspace" in FIELDS["damping"].about.text
