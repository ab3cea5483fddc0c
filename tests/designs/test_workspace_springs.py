"""Springs with which a controller of a workspace is judged: damped as stated, or as no real spring is without."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

import flexhinf as fh
from flexhinf.designs.deployed_run import prepare_run
from flexhinf.designs.live_page import live_arm
from flexhinf.designs.workspace.setup import WorkspaceSetup
from flexhinf.modal import ModalLaw
from flexhinf.modal.pair import PairWeights
from flexhinf.robot import Parameter
from flexhinf.robot.workspace import workspace_of

ARM = fh.load_robot("planar-two-link")


def without(*names: str) -> fh.Robot:
    """The arm, in whose file the damping of these joints is not stated."""
    return replace(
        ARM, parameters=[p for p in ARM.parameters if p.name not in {f"damping_{n}" for n in names}]
    )


def setup_of(robot: fh.Robot) -> WorkspaceSetup:
    law = ModalLaw.tuned(
        robot.problem(fh.Penalty({"link_position": 1.0})), weights=PairWeights(bandwidth=20.0)
    )
    s = fh.Specification(workspace="limits", measured=("link_position", "motor_position"), latency=0)
    return WorkspaceSetup(robot, s, workspace_of(robot, "limits"), law)


@pytest.fixture(scope="module")
def setup() -> WorkspaceSetup:
    return setup_of(without("shoulder", "elbow"))


@pytest.mark.oracle
@pytest.mark.parametrize("damped", [True, False])
def test_poles_are_those_of_springs_that_are_damped_by_hand(setup: WorkspaceSetup, damped: bool) -> None:
    """D = 2 ζ K / ω at home, in matrices of masses and springs, sampled by SciPy with the same controller."""
    robot, pose = setup.robot, setup.workspace.sample(1, 3)[0]
    numbers = robot.plant_parameters()
    stiffness, motors = numbers["stiffness"], numbers["motor_inertia"]

    def flexible(at: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        a, b, _, c = setup.model.linearise(*robot.operating_point(at))
        return a, b, c

    inverse = flexible(np.array(robot.home))[0][2:4, 4:6] / stiffness
    frequency = np.sqrt(stiffness * (np.diag(inverse) + 1.0 / motors))
    damping = np.diag(2.0 * 0.005 * stiffness / frequency) * damped
    a, b, c = flexible(pose)
    for rows, mobility in ((slice(2, 4), a[2:4, 4:6] / stiffness), (slice(6, 8), -np.diag(1.0 / motors))):
        a[rows, 6:8] += mobility @ damping
        a[rows, 2:4] -= mobility @ damping
    sampled = expm(setup.specification.period * np.block([[a, b], [np.zeros((2, 10))]]))
    memory, law = setup._step(pose)
    size, seen = (
        len(memory),
        np.vstack([np.eye(len(memory), len(memory) + 8), np.eye(8, 8 + len(memory), len(memory))]),
    )
    measured = np.vstack([seen[:size], c @ seen[size:]])
    whole = np.vstack([memory @ measured, sampled[:8, :8] @ seen[size:] + sampled[:8, 8:] @ law @ measured])
    loop = setup.at_corner(pose, None, damped=damped)
    expected = np.linalg.eigvals(whole)
    assert loop.growth == pytest.approx(np.abs(expected).max(), rel=1e-9)
    found = setup.linear(pose, damped=damped).closed_loop.multipliers
    np.testing.assert_allclose(
        np.sort(np.abs(found))[::-1][:8], np.sort(np.abs(expected))[::-1][:8], rtol=1e-6
    )


def test_what_the_file_states_is_what_the_true_robot_has(setup: WorkspaceSetup) -> None:
    """Without --extras; zero is stated too. Corners of a robot that states some keep what is assumed of others."""
    assert ARM.damped == ARM
    known = {"extras": ("joint_damping", "coulomb_friction"), "sticking": True}
    assert setup_of(ARM).true_plant is ARM.damped.plant(setup.specification.measured, **known)
    still = ARM.with_values({"damping_shoulder": 0.0, "damping_elbow": 0.0})
    assert still.damped.nominal["damping_elbow"] == 0.0
    some = without("elbow")
    assumed = some.damped.nominal["damping_elbow"]
    assert assumed == pytest.approx(setup.robot.damped.nominal["damping_elbow"])
    assert {corner["damping"][1] for corner in some.damped.random_corners(8, 1)} == {assumed}


def test_every_plant_is_of_the_true_robot(setup: WorkspaceSetup) -> None:
    """Three were made anew for a workspace, and the one in MuJoCo was left with springs that nothing damps."""
    assert setup.smooth_plant is setup.robot.damped.plant(
        setup.specification.measured, extras="joint_damping"
    )
    assert setup.extras == ("joint_damping", "coulomb_friction")
    pytest.importorskip("mujoco")
    springs = setup.mujoco_plant(np.array(ARM.home)).model.tendon_damping
    np.testing.assert_array_equal(springs, setup.true.robot.plant_parameters()["damping"])


def test_runs_outside_of_a_design_have_the_friction_that_its_controller_overcomes(
    setup: WorkspaceSetup,
) -> None:
    """The arms of `flexhinf run` and of the web page had none, and were pushed by what the controller adds."""
    home, s = np.array(ARM.home), setup.specification
    friction = setup.controller(home).dry_friction
    assert friction is not None
    arm = live_arm(setup.controller(home), setup.robot, s)
    assert "coulomb_friction" in arm.extras
    np.testing.assert_array_equal(arm._dry[[0, 2]], [friction.level] * 2)
    pytest.importorskip("mujoco")
    static = setup.robot.with_parameters(
        Parameter("static_friction_shoulder", 1.5)
    )  # MuJoCo has no such curve
    run = prepare_run(setup.controller(home), (static, s), static, s)
    level = setup.robot.plant_parameters()["coulomb_friction"]
    np.testing.assert_array_equal(run.box.model.dof_frictionloss[2:], level)


def test_law_estimator_and_feedforward_know_no_damping(setup: WorkspaceSetup) -> None:
    assert setup.true_plant.parameters.values["damping"].shape == (2,)
    assert "damping" not in setup.model.parameters.values
    ends = setup.workspace.sample(2, 4)
    assert setup.knows_friction is False
    assert np.isfinite(
        setup.move(ends, setup.true.robot.random_corners(1, 2)[0]).motion[0]["remaining_error"]
    )
