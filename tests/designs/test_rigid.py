"""The rigid model and what its law does to springs."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.builders import driven_robot

import flexhinf as fh
from flexhinf.analysis.modes import closed_loop
from flexhinf.designs.loop_setup import LoopSetup
from flexhinf.designs.rigid import FEEDBACK_SIDES, RigidLaw, compare_rigid, rigid_problem
from flexhinf.hinf import smallest_gamma, solve_hji
from flexhinf.robot.arm import Arm
from flexhinf.robot.modes import modes_of, stiffness_and_inertia


@pytest.mark.oracle
@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("name", ["spatial-three-link", "seven-link"])
def test_the_rigid_model_satisfies_newton_and_euler(name: str) -> None:
    rng = np.random.default_rng(3)
    robot = fh.load_robot(name)
    problem = robot.problem(command=None, disturbances=("link_torque", "motor_torque"))
    rigid = rigid_problem(problem)
    assert rigid is not None
    n = len(robot.joint_names)
    p = rigid.plant.parameters.named(rigid.plant.parameters.vector())
    assert isinstance(robot.links, Arm)
    for _ in range(5):
        q, dq, u = rng.normal(size=(3, n))
        d = rng.normal(size=2 * n)
        rate = rigid.plant.derivative(np.concatenate([q, dq]), u, d)
        ddq = rate[n:]
        needed = robot.links.torques(q, dq, ddq, p) + p.motor_inertia * ddq + p.friction * dq
        given = u + d[:n] + d[n:]
        assert np.allclose(rate[:n], dq)
        assert np.abs(needed - given).max() < 1e-10 * max(1.0, np.abs(ddq).max())


@pytest.mark.oracle
@pytest.mark.parametrize(
    ("drive", "share"), [("velocity", 0.0), ("velocity", 1.0), ("position", 0.0), ("position", 0.4)]
)
def test_the_rigid_model_of_a_drive_with_an_inner_loop(drive: str, share: float) -> None:
    """A force f holds link and motor together: M q̈ + … = f, J q̈ = τ − σ (B q̇ + f) + d; at rest the link is held."""
    rng, robot = np.random.default_rng(4), driven_robot("planar-two-link", drive, (8.0, 15.0), share)
    problem = robot.problem(command=None, disturbances=("link_torque", "motor_torque"), pose=(0.4, -0.9))
    rigid = rigid_problem(problem)
    assert rigid is not None
    assert isinstance(robot.links, Arm)
    p = rigid.plant.parameters.named(rigid.plant.parameters.vector())
    place = drive == "position"
    for _ in range(5):
        q, dq, c, d_link, d_motor = rng.normal(size=(5, 2))
        ddq = rigid.plant.derivative(np.concatenate([q, dq]), c, np.concatenate([d_link, d_motor]))[2:]
        force = robot.links.torques(q, dq, ddq, p) - d_link
        torque = (p.drive_stiffness * (c - q) if place else p.drive_damping * c) - p.drive_damping * dq
        left = torque - share * (p.friction * dq + force) + d_motor
        assert p.motor_inertia * ddq == pytest.approx(left, abs=1e-9)
    held = robot.links.torques(np.array([0.4, -0.9]), *np.zeros((2, 2)), p)
    gain = p.drive_stiffness if place else p.drive_damping
    assert rigid.operating_input == pytest.approx(place * np.array([0.4, -0.9]) + share * held / gain)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("side", FEEDBACK_SIDES)
def test_with_stiff_springs_the_rigid_law_does_what_it_was_made_for(side: str) -> None:
    robot = fh.load_robot("planar-two-link")
    stiff = robot.with_values({f"stiffness_{joint}": 1e8 for joint in robot.joint_names})
    # A spring that stiff is damped by nothing in the model: damping of its own, or the vibration never decays.
    problem = stiff.problem()
    rigid = rigid_problem(problem)
    assert rigid is not None
    solution = solve_hji(rigid, gamma=1.5 * smallest_gamma(rigid), degree=2)
    e = solution.expansion
    wanted = np.linalg.eigvals(
        closed_loop(rigid, -np.linalg.solve(e.r2, e.g2_parts[0][:, :, 0].T @ solution.P))
    )
    found = np.linalg.eigvals(RigidLaw(solution, problem, side).closed_loop())
    slow = found[np.abs(found) < 10 * np.abs(wanted).max()]
    assert len(slow) == len(wanted)
    assert np.allclose(np.sort_complex(slow), np.sort_complex(wanted), rtol=1e-4)


@pytest.mark.parametrize(
    ("name", "rings"),
    [
        pytest.param("spatial-three-link", 0.05, marks=pytest.mark.ci("a rigid design and its loops")),
        pytest.param("seven-link", 0.01, marks=pytest.mark.nightly("seven links")),
    ],
)
def test_on_elastic_joints_it_is_unstable_from_the_links_and_rings_from_the_motors(
    name: str, rings: float
) -> None:
    robot = fh.load_robot(name)
    problem = robot.problem()
    rigid = rigid_problem(problem)
    assert rigid is not None
    solution = solve_hji(rigid, gamma=1.5 * smallest_gamma(rigid), degree=2)
    energy = stiffness_and_inertia(problem.plant, robot.operating_point())
    link, motor = (
        modes_of(RigidLaw(solution, problem, side).closed_loop(), robot.joint_names, *energy)
        for side in FEEDBACK_SIDES
    )
    assert not all(mode.stable for mode in link)
    assert all(mode.stable for mode in motor)
    assert min(mode.damping for mode in motor if mode.vibration) < rings


def test_the_law_on_the_elastic_robot_is_the_rigid_law_of_one_side() -> None:
    robot = fh.paper_arm()
    problem = robot.problem()
    rigid = rigid_problem(problem)
    assert rigid is not None
    solution = solve_hji(rigid, gamma=1.5 * smallest_gamma(rigid), degree=4)
    x = np.array([0.3, -0.2, 0.5, 0.1, 0.05])
    for side, part in (("link", [0, 1, 4]), ("motor", [2, 3, 4])):
        law = RigidLaw(solution, problem, side)
        assert law.evaluate_law(x, law.law_data) == pytest.approx(solution.law(x[part]), rel=1e-12)
        slope = [(law.evaluate_law(1e-6 * e, law.law_data) / 1e-6)[0] for e in np.eye(5)]
        assert law.gain[0] == pytest.approx(slope, rel=1e-5, abs=1e-6)
    assert RigidLaw(solution, problem, "motor").state_names[-1] == "motor_position_integral"


def test_a_penalty_on_spring_torques_falls_away_and_code_of_the_users_is_not_guessed() -> None:
    robot = fh.load_robot("planar-two-link")
    torques = fh.Penalty(
        {"link_position": 60.0, "motor_position": 80.0, "joint_torque": 1.0, "link_position_integral": 1.0}
    )
    rigid = rigid_problem(robot.problem(torques))
    assert rigid is not None
    assert rigid.penalty.weights(rigid.state_names) == pytest.approx([100, 100, 0, 0, 1, 1])
    assert rigid_problem(robot.problem(fh.Penalty(lambda x, p: np.array([x[0], x[1], x[8], x[9]])))) is None


@pytest.mark.ci("a rigid design and its loops")
def test_its_input_is_as_late_as_that_of_the_design(setup_of: Callable[..., LoopSetup]) -> None:
    """The latency is the loop's, though nothing predicts over it; an unknown delay is on top."""
    setup: Any = setup_of("paper", (1.0,), unknown_delay=2e-3)
    energy = stiffness_and_inertia(setup.model, setup.goal_equilibrium)
    evaluation: Any = SimpleNamespace(
        setup=setup, scenario=SimpleNamespace(step_duration=0.05), energy=energy
    )
    found = compare_rigid(evaluation, setup.law.problem, 2)
    assert found is not None
    assert [loop.response.run.settings["input_delay_samples"] for loop in found.loops] == [3, 3]
