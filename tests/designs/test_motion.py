"""Motion of the joints in a step or a move: against the numbers of docs/workspace.md, and how it is judged."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from benchmarks.workspace.goals import Move as Reference
from benchmarks.workspace.metrics import metrics as by_hand

from flexhinf.designs import Specification
from flexhinf.designs.judge import motion_requirements
from flexhinf.designs.plans import plan_move
from flexhinf.designs.responses import Response, joint_limits, motion_metrics

#: Keys of the rows, and attributes of the other route.
KEYS = {"wrong_way_percent": "wrong_way", "excursion_percent": "excursion", "ripple_percent": "ripple"}


def run_of(setup: Any, kind: str) -> tuple[Response, Any]:
    if kind == "step":
        return setup.step(0.6), None
    plan = plan_move(
        setup.robot, setup.specification, setup.start, setup.goal, np.full(4, 6.0), 60.0, [np.zeros(4)]
    )
    return setup.move(plan, 0.5).response, plan


@pytest.mark.ci("searches weights of the SCARA")
@pytest.mark.oracle
@pytest.mark.parametrize("kind", ["step", "move"])
def test_the_motion_of_unlike_joints_is_that_of_the_benchmark(setup_of: Any, kind: str) -> None:
    """Turning and sliding joints, one of them at rest."""
    setup = setup_of("scara", (0.3, 0.9, 0.08, 0.2), (0.2, 0.8, 0.08, 0.0), estimator="none")
    (run, plan), limits = run_of(setup, kind), setup.limits
    rows = motion_metrics(limits, run, plan)
    states = (
        np.tile(setup.goal, (len(run.run.time), 2)) if plan is None else np.tile(plan(run.run.time), (1, 2))
    )
    slides = np.array([False, False, True, False])
    other = by_hand(
        Reference(setup.start, setup.goal, states, run.inputs), run.positions, run.inputs, limits.effort, slides,
        limits.upper - limits.lower,
    )  # fmt: skip
    for key, name in KEYS.items():
        found = max(row[key] for row in rows if key in row)
        assert found == pytest.approx(getattr(other, name), rel=1e-9)
        assert key == "wrong_way_percent" or found > 0.0
    assert [("excursion_percent" in row) for row in rows] == slides.tolist()
    assert max(row["remaining_error"] for row in rows) == pytest.approx(other.remaining, rel=1e-9)
    if plan is not None:  # the nearest point is not farther than the planned one
        assert max(row["path_distance"] for row in rows) <= other.path * (1.0 + 1e-3)


@pytest.mark.ci("searches weights, runs a design")
def test_a_link_is_no_further_from_the_path_than_from_its_command(setup_of: Any) -> None:
    """Also where one joint makes a hundredth of the other's way: one error counts as much of both."""
    setup = setup_of("planar-two-link", (0.4, 0.6))
    start, goal = np.zeros(2), np.array([1.0, 0.01])
    time = np.linspace(0.0, 1.0, 101)
    command = time[:, None] * goal
    run = SimpleNamespace(
        diverged_at=None, run=SimpleNamespace(time=time), start=start, goal=goal, joints=setup.joints,
        positions=command + np.array([0, 1e-4]), inputs=np.zeros((101, 2)),
        velocities=np.tile(goal, (101, 1)),
    )  # fmt: skip
    rows = motion_metrics(setup.limits, cast("Any", run))
    assert [row["path_distance"] for row in rows] == pytest.approx([0.0, 1e-4], abs=2e-6)


def test_a_joint_that_should_rest_is_compared_with_the_largest_travel(robot_of: Any) -> None:
    """And with nothing where no joint moves."""
    limits, time = joint_limits(robot_of("planar-two-link"), Specification()), np.linspace(0.0, 1.0, 101)
    for goal, found in (((0.5, 0.3), 4.0), ((0.0, 0.3), None)):
        way = np.array(goal) - (0.0, 0.3)
        swings = (
            np.outer(np.sin(30.0 * time), (0.0, 0.02))
            + np.outer(np.minimum(2.0 * time, 1.0), way)
            + (0.0, 0.3)
        )
        run = SimpleNamespace(
            diverged_at=None, run=SimpleNamespace(time=time), start=np.array([0.0, 0.3]), goal=np.array(goal),
            joints=("shoulder", "elbow"), positions=swings, inputs=np.zeros((101, 2)), velocities=np.zeros((101, 2)),
        )  # fmt: skip
        moved = motion_metrics(limits, cast("Any", run))[1]["excursion_percent"]
        assert moved == (found and pytest.approx(found, rel=1e-2))


def row(**changes: float) -> dict[str, Any]:
    return {
        "travel": 0.1,
        "wrong_way_percent": 1.0,
        "path_distance": 0.02,
        "remaining_error": 5e-4,
        "ripple_percent": 0.5,
    } | changes


@pytest.mark.ci("weights are searched")
def test_each_number_is_judged_for_the_joint_that_is_nearest_to_its_limit(setup_of: Any) -> None:
    limits = setup_of("planar-two-link", (0.4, 0.6)).limits
    rows = [row(), row(wrong_way_percent=6.0, remaining_error=2e-3, ripple_percent=5.2)]
    lines = motion_requirements(Specification(), limits, [rows], 3e-4, "here")
    assert [(line.found, line.limit, line.met, line.joint) for line in lines] == [
        (6.0, 5.0, False, "elbow"), (2e-3, 1e-3, False, "elbow"), (5.2, 5.0, False, "elbow"),
    ]  # fmt: skip
    stated = Specification(undershoot=7, path_distance=(0.01, 0.1), remaining_error=2e-3, ripple=6)
    lines = motion_requirements(stated, limits, [rows], 3e-4, "here")
    assert [line.met for line in lines] == [True, False, True, True]
    assert (lines[1].joint, lines[1].limit, lines[1].stated_by) == (
        "shoulder",
        0.01,
        "--set path_distance",
    )
    (path,) = motion_requirements(stated, limits, [rows], 3e-4, "here", always=False)
    assert path == lines[1]


@pytest.mark.ci("two designs of a loop")
def test_a_sensor_that_resolves_less_allows_more_to_remain(setup_of: Any) -> None:
    limits = setup_of("planar-two-link", (0.4, 0.6)).limits
    (line,) = [
        line
        for line in motion_requirements(Specification(), limits, [[row()] * 2], 4e-3, "here")
        if line.unit == "rad"
    ]
    assert line.limit == 4e-3
    elsewhere = motion_requirements(
        Specification(), limits, [[row()] * 2], 0.0, "here", (np.array([1e-4, 3e-3]), "there")
    )[1]
    assert (elsewhere.found, elsewhere.where, elsewhere.joint) == (3e-3, "there", "elbow")


@pytest.mark.ci("the first setup of all tests here")
def test_a_long_way_leaves_more_at_the_end_of_a_run(setup_of: Any) -> None:
    """A step of 1.6 rad may leave 8 mrad after eight time constants; the long run at rest has no such excuse."""
    limits, rows = (
        setup_of("planar-two-link", (0.4, 0.6)).limits,
        [row(travel=1.6, remaining_error=6e-3), row()],
    )
    own = motion_requirements(Specification(), limits, [rows], 0.0, "here")[1]
    assert (own.limit, own.met) == (pytest.approx(8e-3), True)
    long = motion_requirements(
        Specification(), limits, [rows], 0.0, "here", (np.array([6e-3, 0.0]), "there")
    )[1]
    assert (long.limit, long.met) == (1e-3, False)


@pytest.mark.ci("a setup, which other tests share")
def test_a_run_that_diverges_meets_nothing(setup_of: Any) -> None:
    limits = setup_of("planar-two-link", (0.4, 0.6)).limits
    lines = motion_requirements(Specification(path_distance=0.1), limits, [[]], 0.0, "here")
    assert [line.found for line in lines] == [np.inf] * 4


@pytest.mark.ci("a setup, which other tests share")
def test_a_run_that_ends_with_its_move_has_no_numbers_of_rest(setup_of: Any) -> None:
    setup = setup_of("planar-two-link", (0.4, 0.6), estimator="none")
    plan = plan_move(
        setup.robot, setup.specification, setup.start, setup.goal, np.full(2, 6.0), 60.0, [np.zeros(2)]
    )
    early, late = (
        motion_metrics(setup.limits, setup.move(plan, dwell).response, plan)[0] for dwell in (0.2, 0.4)
    )
    assert set(late) - set(early) == {"remaining_error"}
