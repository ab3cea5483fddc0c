"""The controller for a workspace of an arm that is pushed: it returns where its law returns, as far and nearly as soon.

The arms are integrated here by their equations of motion, and by MuJoCo.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.designs.test_workspace_controller import BOTH, arm, deployed, made
from tests.robot.test_coupling import belt

import flexhinf as fh
from flexhinf.designs.workspace.setup import WorkspaceSetup
from flexhinf.modal import ModalLaw
from flexhinf.modal.pair import PairWeights
from flexhinf.robot import MuJoCoPlant, Parameter
from flexhinf.robot.workspace import workspace_of

#: An arm is back where all its joints stay within this of their command, rad.
BACK = 5e-3


def saved(setup: WorkspaceSetup, pose: Any, folder: Path) -> tuple[fh.Controller, fh.Controller]:
    """The controller of a file, and its law and estimator alone, within the same limits."""
    deployed(setup, pose).save(folder / "controller")
    own = fh.load_controller(folder / "controller")
    return own, own.fresh(governor=None, supervision=None, protection=None, measurement_limits=None)


def returned(away: np.ndarray) -> tuple[float, float]:
    """Furthest distance (N, n) from the command, and when the last joint comes back for good, s; infinite if never."""
    outside = np.flatnonzero((np.abs(away) > BACK).any(axis=1))
    back = 1e-3 * (outside[-1] + 1) if len(outside) else 0.0
    return float(np.abs(away).max()), np.inf if back >= 1e-3 * len(away) else back


def comes_back(own: np.ndarray, bare: np.ndarray, speed: Any) -> None:
    """The bare law returns, the controller within 1.1 of its peak, in its time, the way back at half the governor's
    speed, and a second."""
    (far, late), (most, soon) = returned(own), returned(bare)
    assert np.isfinite(soon)
    assert far <= 1.1 * most
    assert late <= soon + most / (0.5 * np.min(speed)) + 1.0


def pushed_pendulum(controller: fh.Controller, q: float, push: float, seconds: float) -> np.ndarray:
    """Distances (N, 1) of the paper's arm from its command, whose link has the speed `push` after a second at rest:
    I = J = 1 kg·m², m g l = 9.8 N·m, K = 100 N·m/rad, B + kt kb/R = 1 N·m·s/rad, kt/R = 0.9 N·m/V."""

    def rates(x: np.ndarray, u: float) -> np.ndarray:
        spring = 100.0 * (x[2] - x[0])
        return np.array([x[1], spring - 9.8 * np.sin(x[0]), x[3], 0.9 * u - x[3] - spring])

    weight, h, away = 9.8 * np.sin(q), 1e-3, list[float]()
    x, u = np.array([q, 0.0, q + weight / 100.0, 0.0]), weight / 0.9
    reference = np.append(x, u)
    controller.reset(pose=[q])
    for k in range(round((1.0 + seconds) / h)):
        x[1] += push * (k == 1000)
        later = float(controller.step(x[[0]], reference)[0])
        a = rates(x, u)
        b = rates(x + 0.5 * h * a, u)
        c = rates(x + 0.5 * h * b, u)
        x = x + h / 6.0 * (a + 2.0 * b + 2.0 * c + rates(x + h * c, u))
        u = later
        away.append(x[0] - q)
    return np.array(away[1000:])[:, None]


@pytest.mark.ci("a raised arm is pushed four times, in Python")
@pytest.mark.parametrize("effort", [None, 48.0])
def test_a_raised_arm_that_is_pushed_does_not_cycle(effort: float | None, tmp_path: Path) -> None:
    """With the weight at its command in the place of that where it was, it cycled for ever, 3 rad from its command."""
    setup = made("paper", bandwidth=7.0, measured=("link_position",), peak_speed=1.2, saturation=effort)
    for q, push in ((2.0, 6.0), (1.57, 10.0)):
        runs = [pushed_pendulum(one, q, push, 8.0) for one in saved(setup, [q], tmp_path)]
        comes_back(*runs, setup.governor.speed)


def runs_of(
    setup: WorkspaceSetup, plant: Any, pose: Any, speeds: Any, folder: Path, at_rest: np.ndarray | None = None
) -> list[np.ndarray]:
    """Distances (N, n) of the arm from its command, of both controllers, whose links begin with these speeds."""
    n, found = len(setup.joints), list[np.ndarray]()
    state = np.array(setup.robot.operating_point(pose)[0] if at_rest is None else at_rest)
    state[n : 2 * n] = speeds
    for one in saved(setup, pose, folder):
        run = fh.Loop(plant, one).run(duration=4.0, initial_state=state)
        found.append(run.signals["state"][:, :n] - np.asarray(pose))
    return found


@pytest.mark.ci("four controllers of two links, in MuJoCo")
def test_two_links_that_are_pushed_come_back(tmp_path: Path) -> None:
    """Raised and hanging, one of them and both, up to 20 rad/s."""
    setup = made(saturation=24.0, peak_speed=4.0)
    for pose, speeds in (((2.6, 0.4), (9.0, -6.0)), ((2.4, -0.8), (0.0, 20.0)), ((0.1, 0.2), (15.0, 0.0))):
        runs = runs_of(setup, MuJoCoPlant(arm(), measured=setup.model.outputs), pose, speeds, tmp_path)
        comes_back(*runs, setup.governor.speed)


def setup_of(robot: fh.Robot, bandwidth: float, **fields: Any) -> WorkspaceSetup:
    """As `made`, of a robot that is no name."""
    s = fh.Specification(workspace="limits", measured=BOTH, **fields)
    space = workspace_of(robot, s.workspace)
    weights, problem = (
        PairWeights(bandwidth=bandwidth, share=0.7),
        robot.problem(fh.Penalty({"link_position": 1.0})),
    )
    return WorkspaceSetup(robot, s, space, ModalLaw.tuned(problem, s.period, weights, space.sample(100, 3)))


def progressive(robot: fh.Robot) -> fh.Robot:
    """With springs of 0.6, 1 and 1.4 of their stiffness, whose corners the weight passes."""
    numbers = {"first_stiffness": 60.0, "second_stiffness": 100.0, "third_stiffness": 140.0}
    numbers |= {"first_torque": 3.0, "second_torque": 7.0}
    return robot.with_parameters(*(Parameter(name, value) for name, value in numbers.items()))


@pytest.mark.ci("two controllers each of three arms")
@pytest.mark.parametrize("kind", ["coupled", "progressive", "loaded"])
def test_other_arms_that_are_pushed_come_back(kind: str, tmp_path: Path) -> None:
    """Motors that move two joints, springs with a curve that the model has straight, a payload of the model."""
    if kind == "coupled":
        robot, pose, speeds = belt(tmp_path, down="[-1, 0, 0]"), (1.2, 0.9), (-18.0, 20.0)
        setup = setup_of(robot, 12.0, peak_speed=1.0, saturation=40.0)
    elif kind == "progressive":
        robot, pose, speeds = progressive(arm("paper")), (2.2,), (-5.0,)
        setup = setup_of(robot, 6.0, peak_speed=1.2, saturation=48.0)
    else:
        robot, pose, speeds = fh.load_robot("planar-two-link", payload="1kg"), (2.6, 0.4), (9.0, -6.0)
        setup = setup_of(robot, 12.0, peak_speed=4.0, saturation=24.0)
    extras = "stiffness_curve" if kind == "progressive" else ()
    runs = runs_of(setup, setup.true_plant, pose, speeds, tmp_path, robot.operating_point(pose, extras)[0])
    comes_back(*runs, setup.governor.speed)
