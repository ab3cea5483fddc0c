"""The campaign of a controller for a workspace: whose moves, whose robots, and what is measured on them."""

from __future__ import annotations

import pickle
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests import workspaces
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.campaign import Campaign, Journal, drive, in_cluster, run_batch
from flexhinf.designs import DesignRequest
from flexhinf.designs.campaign_options import CampaignOptions
from flexhinf.designs.deployed_run import DesignedLaw
from flexhinf.designs.fields import resolved
from flexhinf.designs.task import Task, stated_workspace
from flexhinf.designs.workspace.campaign import FollowedPlan, WorkspaceCampaign
from flexhinf.designs.workspace.search import known_setup
from flexhinf.designs.workspace.setup import WorkspaceSetup
from flexhinf.modal.pair import PairWeights

pytestmark = pytest.mark.usefixtures("unoptimised")


@pytest.fixture(autouse=True)
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    workspaces.few(monkeypatch, GOALS=2, MODAL_POSES=20)


@cache
def law(estimator: str, exact: bool) -> WorkspaceSetup:
    robot = fh.paper_arm()
    if exact:
        robot = robot.with_parameters(*(replace(p, tolerance=0.0, range=None) for p in robot.parameters))
    s = fh.Specification(workspace=((-1.0, 1.0),), estimator=estimator)
    weights = PairWeights(bandwidth=10.0, integral=0.5, gamma=1.5)
    return known_setup(robot, s, Task(stated_workspace(robot, s.workspace)), weights, (0.0025, 0.03))


def campaign(estimator: str = "ukf", exact: bool = False, samples: int = 5, **options: Any) -> Campaign:
    setup = law(estimator, exact)
    request = DesignRequest(setup.robot, setup.specification, "paper")
    return WorkspaceCampaign.of(request, CampaignOptions(samples=samples, **options)).campaign(
        DesignedLaw(setup, 0.0)
    )


@pytest.mark.costs("compiles a loop")
def test_the_first_moves_are_those_of_the_design() -> None:
    """Without noise and tolerances, sample k is move k; later ones have goals of their own."""
    setup, one = law("none", True), campaign("none", True)
    rows, (goals, _) = run_batch(one, 0), setup.goals(3, 7)
    for k in range(2):
        (motion,) = setup.move(goals[k : k + 2]).motion
        for name in ("tracking_error", "remaining_error", "wrong_way_percent"):
            np.testing.assert_allclose(rows[name][k], motion[name], rtol=1e-9, atol=1e-15)
        assert (rows["start"][k], rows["goal"][k]) == (goals[k, 0], goals[k + 1, 0])
    assert len({*rows["goal"], *rows["start"]}) == 3 + 2 * 3
    limit = 1e-3 * np.array([5.0, 1.0])
    for name, most in zip(("tracking_error", "remaining_error"), limit):
        np.testing.assert_allclose(rows[f"{name}_use"], rows[name] / most, rtol=1e-12)


def step_setup(**fields: Any) -> WorkspaceSetup:
    """The modal law about the pose 0, with a step of 60° to it, of a robot without tolerances."""
    robot = fh.paper_arm()
    robot = robot.with_parameters(*(replace(p, tolerance=0.0, range=None) for p in robot.parameters))
    s = resolved(
        robot, fh.Specification(law="modal", pose=(0.0,), start=(-1.047,), estimator="none", **fields)
    )
    weights = PairWeights(bandwidth=10.0, integral=0.5, gamma=1.5)
    return known_setup(robot, s, Task.of(robot, s), weights, (0.0025, 0.03))


@pytest.mark.costs("compiles a loop")
def test_a_jump_is_judged_by_its_overshoot() -> None:
    """By the numbers of the design's own run; there is no command to be followed."""
    setup = step_setup()
    request = DesignRequest(setup.robot, setup.specification, "paper")
    one = WorkspaceCampaign.of(request, CampaignOptions(samples=2)).campaign(DesignedLaw(setup, 0.0))
    rows, move = run_batch(one, 0), setup.move(np.array([[-1.047], [0.0]]))
    (found,) = move.response.metrics
    assert not {name for name in rows if name.startswith("tracking_error")}
    overshoot = np.array([found["overshoot_percent"]])
    np.testing.assert_allclose(rows["overshoot_percent"], overshoot.repeat(2), rtol=1e-6)
    np.testing.assert_allclose(rows["overshoot_percent_use"], overshoot.repeat(2) / 5.0, rtol=1e-6)
    np.testing.assert_allclose(rows["wrong_way_percent"], move.motion[0]["wrong_way_percent"], rtol=1e-6)


@pytest.mark.costs("two compiled loops")
def test_a_slower_limit_is_a_longer_run_of_a_jump_and_no_error() -> None:
    """The governor brings joints back with half of its speed, 0.8 times the limit, at most."""
    errors, lengths = list[float](), list[float]()
    for speed in (1.0, 0.3):
        setup = step_setup(peak_speed=speed)
        move = setup.move(np.array([[-1.047], [0.0]]))
        errors.append(float(np.abs(move.response.positions[-300:]).max()))
        lengths.append(setup.step_length)
    assert max(errors) < 1e-3
    assert lengths[1] - lengths[0] == pytest.approx(1.047 / 0.4 * (1.0 / 0.3 - 1.0), rel=1e-9)


def test_a_sample_does_not_depend_on_the_others() -> None:
    """Other batches, a campaign from a pickle, and a replay alone give the same bits; another seed other moves."""
    one, other = campaign(samples=4), campaign(samples=4, batch=3)
    rows = run_batch(one, 0)
    again = pickle.loads(pickle.dumps(other))
    parts = [run_batch(again, k) for k in (1, 0)]
    for name in ("tracking_error", "mass", "goal", "remaining_error"):
        np.testing.assert_array_equal(np.concatenate([parts[1][name], parts[0][name]]), rows[name])
    assert one.metrics[-1](one.replay(3))["tracking_error"] == rows["tracking_error"][3]
    assert (rows["status"] == "completed").all()
    far = one.draw.samples([1_000_001, 3], 4, 0)
    assert far[1].row() == one.sample(3).row()
    moved = campaign(samples=4, seed=1).draw.samples([1, 3], 4, 1)
    assert moved[0].row()["goal"] == rows["goal"][1]
    assert moved[1].row()["goal"] != rows["goal"][3]


def test_encoders_are_off_and_inputs_late() -> None:
    """A link rests beside its goal by what its encoder is off, for it is settled there from the start."""
    one = campaign(
        exact=True, samples=3, encoder_offset=2e-3, extra_delay=2, method="latin-hypercube", disturbance=1e-3
    )
    rows = run_batch(one, 0)
    off = rows["encoder_offset_link_position"]
    assert np.all(np.abs(np.abs(off) - rows["remaining_error"]) < 3e-4)
    assert set(rows["unknown_delay_samples"]) == {0.0, 1.0, 2.0}
    for k in range(3):
        run = one.replay(k)
        assert run.settings["input_delay_samples"] == 1 + rows["unknown_delay_samples"][k]
        beside = run.tracked("link_position") + off[k] - run.signal("reference", "link_position")
        assert np.abs(beside[:50]).max() < 2e-4
        assert run.signal("disturbance", "link_torque")[-1] == rows["link_torque"][k] != 0.0


@pytest.mark.ci("starts a cluster")
@pytest.mark.filterwarnings("default")
def test_a_cluster_makes_the_same_moves(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed", reason="missing: distributed")
    one = campaign(samples=6, batch=2)
    with distributed.LocalCluster(
        1, threads_per_worker=1, processes=False, dashboard_address=None
    ) as cluster:  # its worker is a thread, which has the few goals of these tests
        journal = Journal.opened(tmp_path / "far", one)
        far = drive(one, journal, executor=in_cluster(cluster.scheduler_address))
    assert far is not None
    near = [run_batch(one, batch) for batch in range(3)]
    for name in ("tracking_error", "mass", "goal", "remaining_error"):
        np.testing.assert_array_equal(far.columns[name], np.concatenate([rows[name] for rows in near]))


def test_robots_carry_a_payload_that_the_model_does_not_know() -> None:
    one = campaign(samples=9, payload="0..1kg")
    first = one.sample(0)
    assert len({one.sample(k).row()["payload_mass"] for k in range(3)}) == 3
    nominal = law("ukf", False).move_arguments(one.draw.ends(0))[1]
    twisted = first.options["initial_state"] - nominal["initial_state"]
    assert twisted[0] == 0.0 < abs(twisted[2])  # the link is where it should be, the motor holds the weight


@pytest.mark.ci("compiles a run with dry friction")
def test_dry_friction_varies_with_the_viscous_one() -> None:
    """Where the file states no tolerance of its own for it."""
    arm, s = fh.load_robot("planar-two-link"), fh.Specification(workspace="limits", estimator="none")
    robot = arm.with_parameters(*(replace(p, tolerance=0.0) for p in arm.parameters if "coulomb" in p.name))
    weights = PairWeights(bandwidth=10.0, integral=0.5, gamma=1.5)
    setup = known_setup(robot, s, Task(stated_workspace(robot, s.workspace)), weights, (0.0025, 0.03))
    options = CampaignOptions(
        samples=2, tolerances=tuple((f"friction_{joint}", "20%") for joint in robot.joint_names)
    )
    one = WorkspaceCampaign.of(DesignRequest(robot, s, robot.name), options).campaign(DesignedLaw(setup, 0.0))
    drawn, nominal = one.sample(0).parameters, robot.plant_parameters()
    viscous, dry = (np.divide(drawn[name], nominal[name]) for name in ("friction", "coulomb_friction"))
    np.testing.assert_allclose(dry, viscous, rtol=1e-12)
    assert np.all(viscous != 1.0)


def test_what_a_workspace_has_not_is_refused() -> None:
    with refused_with(fh.InvalidInput, "duration"):
        campaign(duration=2.0)
    with refused_with(fh.InvalidInput, "Encoders", "estimator"):
        campaign("none", encoder_offset=1e-3)


def test_a_plan_is_followed_by_its_samples() -> None:
    time = np.linspace(0.0, 1.0, 11)
    plan = FollowedPlan(time, np.column_stack([np.minimum(time, 0.5), np.zeros(11)]))
    assert plan.duration == 0.5
    np.testing.assert_allclose(plan([0.25, 0.7]), [[0.25, 0.0], [0.5, 0.0]])
    assert FollowedPlan(time, np.ones((11, 1))).duration == 0.0
