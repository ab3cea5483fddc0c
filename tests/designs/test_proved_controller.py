"""What is proved, of the controllers that are saved: they run on the nonlinear plant, from inside each claim."""

from __future__ import annotations

import json
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.designs.test_workspace_controller import arm, deployed, made
from tests.refusals import unnamed

import flexhinf as fh
from flexhinf.certify.certificate import path_start, quadratic_part, theorem_text
from flexhinf.certify.claim import LAW_ALONE
from flexhinf.designs.workspace.proof import (
    ENTRIES,
    PairVerdict,
    of_controller,
    pair_verdict,
    prove_workspace,
)
from flexhinf.designs.workspace.setup import WorkspaceSetup
from flexhinf.pages.certificate import check_text
from flexhinf.pages.workspace_check import pair_text
from flexhinf.pages.workspace_proof import hypotheses, workspace_proof_numbers
from flexhinf.scalars import apply

PERIOD, PARTS = 1e-3, 2


def moved(plant: Any, x: np.ndarray, u: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """A period of the nonlinear plant with a held input, by Runge and Kutta's fourth order."""
    still, h = np.zeros(len(plant.disturbances)), PERIOD / PARTS

    def rate(state: np.ndarray) -> np.ndarray:
        return np.asarray(apply(plant.traced_flow, state, u, still, numbers)[0], dtype=float)

    for _ in range(PARTS):
        a = rate(x)
        b = rate(x + 0.5 * h * a)
        c = rate(x + 0.5 * h * b)
        x = x + h / 6.0 * (a + 2.0 * b + 2.0 * c + rate(x + h * c))
    return x


def run(
    controller: fh.Controller,
    plant: Any,
    start: np.ndarray,
    u: np.ndarray,
    command: np.ndarray,
    seconds: float,
) -> tuple[np.ndarray, int]:
    """States (N, n) from a start with an input that acts, and all bits of the status."""
    numbers, seen, x, bits, rows = (
        plant.parameters.vector(),
        [plant.index(name) for name in controller.measured],
        start,
        0,
        [],
    )
    for _ in range(round(seconds / PERIOD)):
        later = controller.step(x[seen], command)
        bits |= int(controller.status)
        rows.append(x)
        x, u = moved(plant, x, u, numbers), later
    return np.array(rows), bits


# A workspace ------------------------------------------------------------------------------------------
def proved(setup: WorkspaceSetup) -> tuple[dict[str, Any], PairVerdict]:
    """The proof.json of a setup as it is read, and what the checker says of it."""
    proof = prove_workspace(setup)
    numbers = json.loads(json.dumps(workspace_proof_numbers(proof)))
    verdict = pair_verdict(numbers)
    assert verdict.is_proved
    assert set(numbers) == set(ENTRIES)
    said = of_controller(True)
    assert numbers["controller"] == said
    assert said in hypotheses(proof)[-1]
    assert said in pair_text(verdict)
    assert unnamed(numbers["text"], "as saved", "while no", "bit of", "its status") == []
    for forged in ({"controller": "any controller"}, {"controller": None}, {"note": "at any speed"}):
        assert not pair_verdict(numbers | forged).is_proved
    return numbers, verdict


def robots(name: str, numbers: dict[str, Any]) -> list[fh.Robot]:
    """Robots at the corners of what is proved: inertias, of the same weight, and stiffnesses; of two joints one spring
    is soft where the other is stiff."""
    errors, found, nominal = numbers["proved"], list[fh.Robot](), arm(name).nominal
    springs = 1.0 - errors["softer"], 1.0 + errors["stiffer"]
    for inertia, softer in product((1.0 / (1.0 - errors["lower"]), 1.0 / (1.0 + errors["upper"])), (0, 1)):
        heavy = [key for key in nominal if key.startswith(("mass", "inertia_", "link_inertia"))]
        stiff = [key for key in nominal if key.startswith("stiffness")]
        values = {key: inertia * nominal[key] for key in heavy} | {"gravity": nominal["gravity"] / inertia}
        values |= {key: springs[(k + softer) % 2] * nominal[key] for k, key in enumerate(stiff)}
        found.append(arm(name).with_values(values))
    return found


def from_rest(
    setup: WorkspaceSetup, robot: fh.Robot, pose: Any, speeds: Any, folder: Path, seconds: float
) -> tuple[np.ndarray, int]:
    """Distances (N, n) from a pose of a robot that begins there with speeds of its links (n,), and the status."""
    deployed(setup, pose).save(folder / "controller")
    controller, n = fh.load_controller(folder / "controller"), len(setup.joints)
    start, u = robot.operating_point(pose)
    start[n : 2 * n] = speeds
    command = np.concatenate(setup.robot.operating_point(pose))
    states, bits = run(controller, robot.plant(setup.model.outputs), start, u, command, seconds)
    return states[:, :n] - np.asarray(pose), bits


@pytest.mark.parametrize(
    ("name", "poses"),
    [
        pytest.param(
            "paper", [(2.0,), (0.1,)], marks=pytest.mark.ci("proves one joint, and runs it in Python")
        ),
        pytest.param(
            "planar-two-link", [(2.4, 0.5), (0.3, -0.6)], marks=pytest.mark.nightly("proves two joints")
        ),
    ],
)
def test_a_saved_controller_of_a_workspace_comes_back_inside_its_claim(
    name: str, poses: list[tuple[float, ...]], tmp_path: Path
) -> None:
    """Small motions of all robots at the corners; of one joint also one for which the governor and a bit come in."""
    setup = made(name, bandwidth=7.0 if name == "paper" else 12.0, peak_speed=2.0, saturation=48.0)
    numbers, _ = proved(setup)
    assert numbers["proved"]["lower"] > 0.03
    speeds = 0.05 * np.ones(len(setup.joints))
    for robot, pose in product(robots(name, numbers), poses):
        away, bits = from_rest(setup, robot, pose, speeds, tmp_path, 4.0)
        assert bits == 0
        assert np.abs(away).max() > 2e-3
        assert np.abs(away[-500:]).max() < 2e-4
    away, bits = from_rest(setup, robots(name, numbers)[0], poses[0], 60.0 * speeds, tmp_path, 4.0)
    assert bits & fh.Status.REACTING
    assert np.abs(away[-500:]).max() < 5e-3


# One pose ---------------------------------------------------------------------------------------------
#: Weights of a law about upright, and those of the penalty whose gain is proved.
WEIGHTS, CHECKED = (75.0, 27.0, 90.0, 27.0, 330.0), np.array([60.0, 0.0, 0.0, 0.0, 300.0])


@pytest.mark.ci("proves a region, and runs its controller in Python")
def test_a_saved_controller_of_a_pose_comes_back_from_its_region(tmp_path: Path) -> None:
    """From the ends of the steps that are proved, and from points on the edge of the region in other directions, where
    the estimate is right at first. What the law needs there is beyond 24 V, which the status says, and it returns."""
    robot = fh.paper_arm()
    problem = robot.problem(fh.Penalty(WEIGHTS, effort=10.0), pose=(np.pi,))
    star = fh.smallest_gamma(problem)
    solution = fh.solve_hji(problem, gamma=1.5 * star, degree=2)
    claim = solution.certify(1.6 * star, CHECKED, level=1.0e4)
    verification = claim.check()
    assert verification.proved
    assert claim.controller == LAW_ALONE
    assert f"Controller: {LAW_ALONE}." in theorem_text(claim, verification)
    assert LAW_ALONE in " ".join(check_text(claim, verification).split())

    plant, noise = robot.plant(("link_position", "motor_position")), np.diag([0.0, 1e-6, 0.0, 1e-6])
    kalman = fh.ExtendedKalmanFilter(plant, PERIOD, noise, 1e-10, np.zeros(4), noise, form="covariance")
    goal, held = robot.operating_point((np.pi,))
    rng, p = np.random.default_rng(1), quadratic_part(claim.value, 5)
    starts = [path_start(claim, start, start.amplitude) for start in claim.starts]
    for direction in rng.normal(size=(2, 4)) * [1.0, 5.0, 1.0, 5.0]:
        x = np.append(direction, 0.0)
        starts.append(x * np.sqrt(0.9 * 2.0 * claim.level / (x @ p @ x)))
    for limit, some in ((None, starts), (24.0, starts[:2])):
        watch = fh.Supervision(saturation_time=0.01)
        one = fh.Controller(
            solution, kalman, PERIOD, limit, latency=0 if limit is None else 1, supervision=watch
        )
        one.save(tmp_path / "controller")
        for start in some:
            assert 0.5 * start @ p @ start <= claim.level * (1.0 + 1e-9)
            controller = fh.load_controller(tmp_path / "controller")
            controller.reset(goal + start[:4])
            states, bits = run(controller, plant, goal + start[:4], held, goal[:1], 5.0)
            assert bits == (0 if limit is None else fh.Status.SATURATION)
            assert np.abs(states[-1] - goal).max() < 1e-3
