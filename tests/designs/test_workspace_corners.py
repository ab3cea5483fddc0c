"""Loops of a workspace's controller on robots at corners of their tolerances and payloads."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache, partial
from itertools import pairwise
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.optimize import brentq
from tests.refusals import unnamed

import flexhinf as fh
from flexhinf.designs.judge import (
    corner_requirements,
    pose_requirements,
    standstill_requirement as run_standstill,
    worst_move_requirements,
)
from flexhinf.designs.plans import quintic_move, settled, shortest_time
from flexhinf.designs.requirements import REQUIREMENTS, Requirement
from flexhinf.designs.resting import CornerLoop, PoseLoop
from flexhinf.designs.task import Task
from flexhinf.designs.workspace import search, standstill
from flexhinf.designs.workspace.resting_loops import DAMPING, GAIN, corner_damping
from flexhinf.designs.workspace.setup import WorkspaceSetup
from flexhinf.designs.workspace.standstill import standstill_requirement
from flexhinf.loop import Loop
from flexhinf.modal import ModalLaw
from flexhinf.modal.pair import PairWeights
from flexhinf.robot.parameters import random_signs
from flexhinf.robot.workspace import workspace_of

BOTH = ("link_position", "motor_position")
GOOD = PoseLoop(
    growth=0.98, damping=0.3, fast_damping=0.1, late=0.99, later=0.995, louder=0.985,
    softer=0.985, ripple=0.8,
)  # fmt: skip


@cache
def setup_of(payload: str) -> WorkspaceSetup:
    robot = fh.load_robot("planar-two-link", payload=payload)
    law = ModalLaw.tuned(
        robot.problem(fh.Penalty({"link_position": 1.0})), weights=PairWeights(bandwidth=20.0)
    )
    s = fh.Specification(workspace="limits", measured=BOTH)
    return WorkspaceSetup(robot, s, workspace_of(robot, "limits"), law)


def test_every_number_is_at_an_end_of_its_interval() -> None:
    robot = fh.load_robot("planar-two-link", payload="0..0.5..1kg")
    corners = robot.random_corners(40, 3)
    between = {p.name: p.interval for p in robot.uncertain}
    for k, joint in enumerate(robot.joint_names):
        assert {corner["stiffness"][k] for corner in corners} == set(between[f"stiffness_{joint}"])
    carried = {round(corner["mass"][1], 9) for corner in corners}
    assert carried == {link + load for link in between["mass_elbow"] for load in (0.0, 1.0)}
    assert len({tuple(corner["mass"]) for corner in corners}) == 8  # links and payload apart
    exact = tuple(replace(p, tolerance=0.0, range=None) for p in robot.parameters)
    assert replace(robot, parameters=exact).random_corners(4, 3) == robot.random_corners(0, 3) == []


@pytest.mark.oracle
def test_moves_are_those_that_the_heaviest_robot_can_make() -> None:
    """By the weight M g l sin q of the paper's arm in closed form: straight up is too much, also on the way, and what
    acceleration needs beside the weight makes a move slower."""
    robot = fh.load_robot("paper")
    heaviest = {"mass": robot["mass"].interval[1]}
    volts = robot["resistance"].value / robot["torque_constant"].value
    limit = 15.0
    s = fh.Specification(workspace=((-2.5, 2.5),), saturation=limit, peak_speed=6.0)
    law = ModalLaw.tuned(robot.problem(fh.Penalty({"link_position": 1.0})))
    setup = WorkspaceSetup(robot, s, workspace_of(robot, s.workspace), law)
    goals, left_out = setup.goals(12, 7)

    def weight(q: np.ndarray) -> np.ndarray:
        return volts * heaviest["mass"] * 9.8 * np.abs(np.sin(q))

    ways = [np.linspace(*ends, 200) for ends in pairwise(goals[:, 0])]
    assert max(weight(way).max() for way in ways) <= 0.7 * limit < weight(np.array(0.5 * np.pi))
    # From −0.7 to 0.7 rad nothing is left out, and nothing beyond 2.3 rad is reached.
    every = setup.workspace.sample(12 + left_out, 7)
    assert len(every) - len(goals) == left_out >= np.sum(weight(every) > 0.7 * limit) > 0

    start, goal = np.array([-0.7]), np.array([0.7])
    plan, least = quintic_move(robot, setup.limits, start, goal), shortest_time(setup.limits, start, goal)
    slower = plan.duration / least
    assert slower > 1.1

    def spare(faster: float) -> float:
        """Least share of what the weight leaves that the elastic arm does not need on the way [spong1987]."""
        time, pull = np.linspace(0.0, plan.duration, 200), heaviest["mass"] * 9.8
        q, v, a, jerk, snap = plan.derivatives(time, 4)[:, :, 0] * faster ** np.arange(5.0)[:, None]
        torque, rate = a + pull * np.sin(q), jerk + pull * np.cos(q) * v
        motor_rate = v + rate / 100.0
        acceleration = a + (snap + pull * (np.cos(q) * a - np.sin(q) * v**2)) / 100.0
        needed = volts * (torque + acceleration + 0.1 * motor_rate) + motor_rate
        return float(np.min(1.0 - (np.abs(needed) - weight(q)) / (limit - weight(q))))

    assert spare(slower) < 0.3 < spare(1.0) + 1e-3  # at finer instants than those of the check


@pytest.mark.ci("searches the gain at the margin")
def test_a_pose_that_lacks_less_than_the_tolerance_of_a_margin_is_not_counted() -> None:
    """A margin is met within 2 %: asked for are 1 % and 3 % more than the last stable gain of a pose."""
    setup, pose = setup_of("1kg"), np.array([0.3, 0.4])

    def growth(gain: float, tolerance: float = 0.0) -> float:
        stated = replace(setup, specification=replace(setup.specification, gain_margin=gain))
        return stated.at_pose(pose, tolerance).louder

    last = brentq(lambda gain: growth(gain) - 1.0, 1.01, 20.0)
    counted = [growth(more * last, tolerance) > 1.0 for more in (1.01, 1.03) for tolerance in (0.0, 0.02)]
    assert counted == [True, False, True, True]


@pytest.mark.oracle
def test_links_at_random_corners_are_rigid_bodies() -> None:
    """No principal moment exceeds the sum of the others; with a sign for each moment it may."""
    robot = fh.load_robot("planar-two-link")

    def excess(corner: Mapping[str, Any]) -> float:
        """Largest moment less the others, relative, of links whose products of inertia are zero."""
        moments = np.asarray(corner["inertia"])[:, [0, 3, 5]]
        return float(np.max(2.0 * moments.max(axis=1) / moments.sum(axis=1) - 1.0))

    corners = robot.random_corners(40, 3)
    assert max(map(excess, corners)) <= 1e-12
    assert {float(corner["inertia"][1, 5]) for corner in corners} == set(robot["inertia_zz_elbow"].interval)
    alone = random_signs(len(robot.uncertain), 40, 3)
    assert max(excess(robot.corner(row)) for row in alone.tolist()) > 0.01


def test_products_of_inertia_grow_with_the_moments() -> None:
    """A negative one is at its lower end where the moments are at their upper ends."""
    robot = fh.load_robot("planar-two-link")
    skew = replace(robot["inertia_xy_elbow"], value=-1e-3, tolerance=robot["inertia_zz_elbow"].tolerance)
    parameters = tuple(skew if p.name == skew.name else p for p in robot.parameters)
    found = [corner["inertia"][1] for corner in replace(robot, parameters=parameters).random_corners(20, 3)]
    ratios = np.array([inertia[1] / inertia[5] for inertia in found])
    np.testing.assert_allclose(ratios, skew.value / robot["inertia_zz_elbow"].value, rtol=1e-12)
    assert len({float(inertia[1]) for inertia in found}) == 2


def test_a_fast_vibration_that_grows_is_a_requirement_that_is_not_met() -> None:
    s, growing = fh.Specification(), {"fast_damping": -0.00027}
    at_poses = partial(pose_requirements, damping=DAMPING, gain=GAIN)
    at_corners = partial(corner_requirements, least=corner_damping(s))
    for judge, loop in ((at_poses, GOOD), (at_corners, CornerLoop(0.98, 0.3, 0.1))):
        missed = [line for line in judge(s, [loop, loop._replace(**growing)]) if line.missed]
        assert [line.what for line in missed] == [REQUIREMENTS["fast_damping"].what]
        assert missed[0].found == -0.00027
        assert not any(line.missed for line in judge(s, [loop]))


# Where moves begin, and how they end ---------------------------------------------------------------------
@pytest.mark.ci("a loop of each kind of sensors")
@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.parametrize("measured", [BOTH, ("motor_position",)])
def test_a_settled_start_stays_where_it_is(measured: tuple[str, ...]) -> None:
    """The run of the loop itself, without noise and friction, on a robot with twice the payload of the model: from the
    settled start its links stay, from the start of a controller that does not know the payload they sag."""
    setup = setup_of("0..0.5..1kg")
    setup = replace(setup, specification=replace(setup.specification, measured=measured))
    heavy = setup.robot.corner([1.0 if "payload" in p.name else 0.0 for p in setup.robot.uncertain])
    q = np.array([0.4, -0.9])
    controller, drifts = setup.controller(q), []
    point, loop = setup.robot.operating_point(q), setup.linear(q, heavy)
    state, held, memory = settled(setup.robot, point, setup.limits, controller, loop, q, (), heavy)
    loop = Loop(setup.true_plant.with_parameters(**setup.true_plant.parameters.known(heavy)), controller)
    for own in ({"initial_memory": memory}, {}):
        run = loop.run(duration=0.3, initial_state=state, initial_input=held, **own)
        drifts.append(np.ptp(run.signals["state"][:, :2], axis=0).max())
    assert drifts[0] < 1e-5  # of second order in the twist that 0.5 kg makes
    assert drifts[1] > 1e-3
    beside = np.abs(state[:2] - q).max()
    assert beside == 0.0 if measured == BOTH else 1e-6 < beside < 0.02  # the twist of springs by 0.5 kg


@pytest.mark.ci("many moves")
def test_a_law_that_is_faster_than_a_soft_arm_swings_at_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    """Dry friction nearly holds the motors; the requirement sees the cycle of links and integrals, and the share of the
    bandwidth for a robot with dry friction ends it."""
    robot, found = fh.load_robot("planar-two-link"), []
    robot = robot.with_values(
        {"damping_shoulder": 0.0, "damping_elbow": 0.0}
    )  # what it states ends the cycle
    s = fh.Specification(workspace="limits", measured=BOTH, measurement_noise=1e-8)
    for shares in ((2.0, 2.0), search.SHARE):
        monkeypatch.setattr(search, "SHARE", shares)
        setup = search.tuned_setup(robot, s, Task(workspace_of(robot, "limits")))
        goals, _ = setup.goals(5, 7)
        made = [(goals[k : k + 2], None, k) for k in range(4)]
        found.append(standstill_requirement(setup, made, [setup.move(*one) for one in made]))
    assert [line.met for line in found] == [False, True]
    assert found[0].found > 1.3 * found[1].found
    assert found[0].limit == pytest.approx(3e-4)


def test_the_rest_is_judged_by_the_remaining_error_or_the_sensors() -> None:
    setup = setup_of("1kg")
    swings = np.array([2e-4, 2.4e-4])
    s = setup.specification
    cases = [(s, 0.0, 2.5e-4), (s, 3e-4, 3e-4), (replace(s, remaining_error=4e-4), 0.0, 1e-4)]
    for stated, resolution, limit in cases:
        line = run_standstill(stated, setup.limits, swings, resolution, "")
        assert (line.limit, line.found, line.joint) == (pytest.approx(limit), 2.4e-4, "elbow")
    assert run_standstill(s, setup.limits, np.array([np.inf, 0.0]), 0.0, "").met is False


@pytest.mark.oracle
def test_the_loop_at_a_corner_has_the_plant_of_a_robot_that_is_so() -> None:
    """A robot with half a kilogram in its model that carries one, against the robot whose model has one."""
    unknown, known = setup_of("0..0.5..1kg"), setup_of("1kg")
    ends = [1.0 if "payload" in p.name else 0.0 for p in unknown.robot.uncertain]
    assert sum(ends) == 1.0
    heavy, q = unknown.robot.corner(ends), np.array([0.4, -0.9])
    found, light, expected = unknown.linear(q, heavy), unknown.linear(q), known.linear(q)
    np.testing.assert_allclose(found.a, expected.a, rtol=1e-9, atol=1e-7)
    np.testing.assert_allclose(found.memory, light.memory)  # the controller does not know it
    assert np.abs(found.a - light.a).max() > 1.0


@pytest.mark.parametrize(
    ("changes", "missed"),
    [
        ({}, []),
        ({"growth": 1.01}, [0]),
        ({"damping": 0.15}, []),
        ({"damping": 0.09}, [1]),
        ({"late": 1.01}, []),
    ],
)
def test_they_are_stable_and_do_not_ring(changes: dict[str, float], missed: list[int]) -> None:
    s = fh.Specification(workspace="limits", measured=BOTH)
    lines = corner_requirements(s, [GOOD, GOOD._replace(**changes), GOOD], corner_damping(s))
    assert [k for k, line in enumerate(lines) if not line.met] == missed
    assert corner_requirements(s, [], corner_damping(s)) == []


@pytest.mark.ci("a long run")
def test_noise_moves_links_and_motors_as_the_linear_loop_says() -> None:
    setup = setup_of("1kg")
    q = setup.workspace.sample(1, 3)[0]
    run = Loop(setup.smooth_plant, setup.controller(q)).run(
        noise=setup.noise, duration=12.0, seed=5, initial_state=setup.robot.operating_point(q, ())[0]
    )
    found = [np.asarray(run.signals[name])[2000:, :2].std(axis=0) for name in ("input", "state")]
    assert setup.noise_spread(setup.linear(q)) == pytest.approx(np.array(found), rel=0.15)


def test_the_move_that_is_made_again_swings_most_by_its_own_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    """A smaller swing of a joint with a smaller limit; lengths and angles do not compare."""
    setup = setup_of("1kg")
    s = replace(setup.specification, remaining_error=(1e-3, 2e-5), measurement_noise=1e-14)
    setup, again = replace(setup, specification=s), []
    ends, _ = setup.goals(3, 7)
    moves = [SimpleNamespace(swing=np.array(each)) for each in ([2e-4, 0.0], [0.0, 2e-5])]

    def move(self: WorkspaceSetup, ends: np.ndarray, *_: Any, dwell: float) -> Any:
        again.append(ends)
        return moves[1]

    monkeypatch.setattr(WorkspaceSetup, "move", move)
    line = standstill_requirement(setup, [(ends[:2], None, 0), (ends[1:], None, 1)], cast("Any", moves))
    np.testing.assert_array_equal(again, [ends[1:]])
    assert (line.found, line.limit, line.joint) == (2e-5, pytest.approx(5e-6), "elbow")


@pytest.mark.ci("many moves")
def test_moves_are_judged_by_the_limits_of_the_joints() -> None:
    """Peak input, speed and range, by the arrays of the runs themselves, the worst of all moves."""
    setup = setup_of("1kg")
    goals, _ = setup.goals(4, 7)
    moves = [setup.move(goals[k : k + 2], None, k) for k in range(3)]
    states, inputs = (np.vstack([m.response.run.signals[name] for m in moves]) for name in ("state", "input"))
    top, fast = np.abs(inputs).max(axis=0), np.abs(states[:, 2:4]).max(axis=0)
    low, high = states[:, :2].min(axis=0), states[:, :2].max(axis=0)

    def judged(peak: Any, speed: Any, ends: Any, of: Any = moves) -> dict[str, Requirement]:
        limits = replace(setup.limits, peak=peak, speed=speed, lower=ends[0], upper=ends[1])
        lines = worst_move_requirements(setup.specification, limits, of, "these")
        return {line.what: line for line in lines}

    kept = judged(top, fast, (low, high))
    names = "peak input", "link speed", "distance beyond a joint's range"
    assert [kept[name].met for name in names[:2]] == [True, True]
    assert names[2] not in kept
    assert all(line.met for line in kept.values())
    beyond = judged(top / (1.0, 1.5), fast / (1.5, 1.0), (low, high - (0.0, 0.01)))
    found = [beyond[name] for name in names]
    assert [line.met for line in found] == [False] * 3
    assert [line.joint for line in found] == ["elbow", "shoulder", "elbow"]
    assert [line.found for line in found] == pytest.approx([top[1], fast[0], 0.01])
    assert names[2] not in judged(top, fast, (low + 1e-11, high))  # rounding
    gone = replace(moves[0].response, run=replace(moves[0].response.run, diverged_at=0.1))
    lost = judged(top, fast, (low, high), [*moves[1:], replace(moves[0], response=gone)])
    assert [lost[name].found for name in names[:2]] == [np.inf, np.inf]


def test_an_input_that_stays_at_its_limit_in_a_move_is_missed() -> None:
    """Counted sample by sample: 200 of them are allowed, 201 not, whatever the sign; and nothing without limits."""
    setup = setup_of("1kg")
    move, limits = setup.move(setup.goals(2, 7)[0]), replace(setup.limits, saturation=np.array([20.0, 10.0]))

    def judged(runs: list[np.ndarray], limits: Any = limits) -> dict[str, Requirement]:
        made = [replace(move, response=with_inputs(move.response, inputs)) for inputs in runs]
        lines = worst_move_requirements(setup.specification, limits, made, "these")
        return {line.what: line for line in lines}

    what, inputs = "time at an input's limit", np.zeros_like(move.response.inputs)
    assert judged([inputs])[what].found == 0.0
    inputs[100:250, 1], inputs[250:300, 1] = 9.995, -9.995
    line = judged([0.0 * inputs, inputs])[what]
    assert (line.met, line.joint, line.limit) == (True, "elbow", 0.2)
    assert (line.found, line.at) == pytest.approx((0.2, 0.1))
    inputs[300, 1] = -10.0
    assert not judged([inputs])[what].met
    assert judged([inputs], replace(limits, peak=limits.saturation))["peak input"].met
    assert judged([0.998 * inputs])[what].found == 0.0
    assert what not in judged(
        [inputs], replace(limits, saturation=np.full(2, np.inf), peak=np.full(2, np.inf))
    )


def with_inputs(response: Any, inputs: np.ndarray) -> Any:
    run = response.run
    return replace(response, run=replace(run, signals=run.signals | {"input": inputs}))


def test_noise_excuses_no_unstable_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its noise is infinite, which is not the limit of the line about rest."""
    setup = setup_of("1kg")
    ends, _ = setup.goals(2, 7)
    monkeypatch.setattr(WorkspaceSetup, "noise_spread", lambda *_: np.full((2, 2), np.inf))
    monkeypatch.setattr(standstill, "LONG", 0.1)
    line = standstill_requirement(setup, [(ends, None, 0)], [setup.move(ends)])
    assert line.limit == pytest.approx(3e-4)
    assert unnamed(line.criterion, "move of 1", "seed", "0.7 mrad") == []


def test_a_joint_may_rest_in_all_waypoints() -> None:
    setup = setup_of("1kg")
    path = np.array([[0.1, 0.3], [0.6, 0.3]])
    space = replace(setup.workspace, lower=path.min(axis=0), upper=path.max(axis=0), path=path)
    controller = replace(setup, workspace=space).controller(
        path[0], supervision=replace(setup, workspace=space).supervision
    )
    controller.step(np.tile(path[0], 2), np.concatenate(setup.robot.operating_point(path[0])))
    assert controller.status == fh.Status(0)
