"""Margins along a move: at its ends those of the loops there, and laws are added only where they help."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.analysis import margins
from flexhinf.designs import Specification, checks
from flexhinf.designs.checks import AlongMove, MarginLimits, along_requirements, margins_along, scheduled
from flexhinf.designs.loop_setup import LoopSetup
from flexhinf.designs.requirements import REQUIREMENTS
from flexhinf.loop import Schedule, Waypoints
from flexhinf.plant import Law

pytestmark = pytest.mark.ci("margins at poses along a move")

Benches = Callable[..., LoopSetup]
START, GOAL = (0.0, -2.2), (0.4, -0.3)
LEAST = MarginLimits(2.5, 1.8, 0.05, 350.0)


@pytest.fixture(scope="module", autouse=True)
def few_poses() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(checks, "POSES", ((10_000, 3),))
        yield


@pytest.fixture(scope="module")
def setup(setup_of: Benches) -> LoopSetup:
    return setup_of("planar-two-link", GOAL, estimator="none")


@pytest.fixture(scope="module")
def plan() -> Waypoints:
    return Waypoints([0.0, 2.0], [START, GOAL], "quintic")


@pytest.fixture(scope="module")
def along(setup: LoopSetup, plan: Waypoints) -> AlongMove:
    return margins_along(setup, plan, LEAST)


def test_poses_are_evenly_apart_from_start_to_goal(along: AlongMove) -> None:
    np.testing.assert_allclose(along.poses[[0, -1]], [START, GOAL], atol=1e-6)
    apart = np.linalg.norm(np.diff(along.poses, axis=0), axis=1)
    assert apart.max() < 1.05 * apart.min()


def test_at_the_goal_the_margins_are_those_of_the_loop_there(setup: LoopSetup, along: AlongMove) -> None:
    at_goal, known = along.margins[-1], margins(setup.equilibrium_loop())
    assert at_goal.peak_sensitivity == pytest.approx(known.peak_sensitivity, rel=0.05)
    assert at_goal.stable


def test_the_requirement_is_that_of_the_worst_pose(along: AlongMove) -> None:
    peaks = [one.peak_sensitivity for one in along.margins]
    lines = {line.what: line for line in along_requirements(Specification(peak_sensitivity=1.01), along)}
    line = lines["peak sensitivity"]
    assert (line.found, line.at) == (max(peaks), along.times[int(np.argmax(peaks))])
    assert (line.met, line.stated_by) == (False, "--set peak_sensitivity")
    assert lines["gain margin"].found == min(one.gain_margin for one in along.margins)
    assert lines.keys() >= {REQUIREMENTS[key].what for key in ("damping", "gain_margin")}


def test_laws_are_added_at_the_worst_poses_only_where_they_help(
    setup: LoopSetup, plan: Waypoints, along: AlongMove, setup_of: Benches
) -> None:
    asked: list[np.ndarray] = []

    def another(pose: np.ndarray) -> Law:
        asked.append(pose)
        return setup_of("planar-two-link", tuple(pose), estimator="none").law

    kept = scheduled(setup, plan, LEAST, another)
    assert (kept[0], asked) == (setup.law, []) if along.share <= 1.0 else asked
    peaks = [one.peak_sensitivity for one in along.margins]
    strict = MarginLimits(0.5 * (peaks[-1] + max(peaks)), 1.01, 0.0, 350.0)
    law, better = scheduled(setup, plan, strict, another)
    assert isinstance(law, Schedule)
    assert better.share < margins_along(setup, plan, strict).share
    assert better.count == len(law.laws) == 1 + better.added
    np.testing.assert_allclose(asked[0], along.poses[int(np.argmax(peaks))], atol=1e-9)
    assert {better.laws[-1], better.laws[int(np.argmax(peaks))]} == {0, 1}
    useless = setup_of("planar-two-link", (0.5, 0.3), estimator="none").law  # beyond the goal
    same, unhelped = scheduled(setup, plan, strict, lambda pose: useless)
    assert (same, unhelped.count, unhelped.added) == (setup.law, 1, 0)
    assert scheduled(setup, plan, strict, None)[0] is setup.law


def test_the_law_that_acts_is_chosen_by_the_joints_that_are_tracked(setup: LoopSetup) -> None:
    """With one joint out of two tracked, its own place in the pose counts."""
    robot = setup.robot

    def law(pose: tuple[float, float]) -> Law:
        weights = {"link_position": 60.0, "link_position_elbow_integral": 100.0}
        problem = robot.problem(weights, pose, integrate=["link_position_elbow"])
        return fh.linear_law(problem, gamma=2.0 * fh.smallest_gamma(problem))

    laws = [law((0.0, 0.0)), law((0.0, 1.0))]
    assert Schedule(laws).acting(np.array([1.0, 0.1])) == 0
    assert Schedule(laws).acting(np.array([0.1, 0.9])) == 1
