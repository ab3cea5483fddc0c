"""Torque feedback against a PD on a robot whose rotors are as light as asked, and where it rests."""

import numpy as np
import pytest
from scipy.optimize import root
from tests.baselines.conftest import by_name, continuous, links_at
from tests.refusals import refused_with

from flexhinf.baselines import MotorPD, TorqueFeedback
from flexhinf.errors import InvalidInput
from flexhinf.loop import Controller, Loop


def solved(equations, start, left=1e-12):
    """A root, to what is left of the equations."""
    found = root(equations, start, tol=1e-14)
    assert np.abs(equations(found.x)).max() < left
    return found.x


@pytest.mark.ci("three runs of three links by SciPy")
@pytest.mark.oracle
def test_it_is_a_pd_on_lighter_rotors():
    robot = by_name("spatial-three-link")
    plant, p = robot.plant(), robot.plant_parameters()
    problem = robot.problem(pose=[0.2, 0.4, 0.8])
    law = TorqueFeedback.tuned(
        problem, 7.0, 0.7, inertia_ratio=0.3, compensation="goal", integral="link_position"
    )
    light = plant.with_parameters(motor_inertia=0.3 * p["motor_inertia"], friction=0.3 * p["friction"])
    same = MotorPD(
        plant=light, equilibrium=law.equilibrium, integrate=("link_position",),
        proportional=law.proportional, derivative=law.derivative, integral=law.integral,
    )  # fmt: skip
    start = law.equilibrium[0] + np.linspace(-0.4, 0.5, 12)
    _, felt = continuous(plant, law, start, 1.5)
    _, expected = continuous(light, same, start, 1.5)
    np.testing.assert_allclose(felt, expected, atol=1e-8)
    unchanged = continuous(plant, MotorPD(
        plant=plant, equilibrium=law.equilibrium, integrate=("link_position",),
        proportional=law.proportional, derivative=law.derivative, integral=law.integral,
    ), start, 1.5)[1]  # fmt: skip
    assert np.abs(unchanged - expected).max() > 0.05


@pytest.mark.oracle
@pytest.mark.parametrize("extras", [(), ("joint_damping",)])
def test_with_voltages_and_damped_springs_the_loops_matrix_is_that_of_lighter_rotors(extras):
    robot = by_name("planar-two-link")
    problem = robot.problem(extras=extras)
    law = TorqueFeedback.tuned(problem, 25.0, 0.8, inertia_ratio=0.2, compensation="goal")
    p = robot.plant_parameters()
    scaled = robot.plant(extras=extras).with_parameters(
        motor_inertia=0.2 * p["motor_inertia"], friction=0.2 * p["friction"],
        back_emf_constant=0.2 * p["back_emf_constant"],
    )  # fmt: skip
    same = MotorPD(
        plant=scaled, equilibrium=law.equilibrium, proportional=law.proportional, derivative=law.derivative
    )
    np.testing.assert_allclose(law.closed_loop(), same.closed_loop(), rtol=1e-9, atol=1e-8)


@pytest.mark.oracle
@pytest.mark.parametrize(
    "name", ["paper", "rig", "quanser", "planar-two-link", "spatial-three-link", "seven-link"]
)
def test_the_weight_is_that_of_the_link_that_would_rest_at_the_motors_position(name):
    robot = by_name(name)
    law = TorqueFeedback.tuned(robot.problem(), 5.0)
    p = robot.plant_parameters()
    stiffness, n = np.atleast_1d(p["stiffness"]), len(robot.joint_names)
    theta = np.array(robot.home) + np.linspace(0.3, 1.0, n)
    _, torque = links_at(robot, theta)
    q = solved(lambda s: theta - s - torque(s) / stiffness, theta)
    found = law.weight(theta, stiffness, robot.plant().parameters.vector())
    np.testing.assert_allclose(found, torque(q), atol=2e-6 * max(1.0, np.abs(torque(theta)).max()))
    assert 0.0 <= law.contraction < 0.2
    assert law.turns <= 7


@pytest.mark.oracle
@pytest.mark.parametrize("compensation", ["motor", "goal"])
@pytest.mark.ci("6 s of three links by SciPy")
def test_every_rest_is_an_equilibrium_and_is_reached(compensation):
    robot = by_name("spatial-three-link")
    law = TorqueFeedback.tuned(robot.problem(), 8.0, 0.8, compensation=compensation)
    goal, held = robot.operating_point([-0.5, 0.9, -0.4])
    np.testing.assert_array_equal(law.evaluate_about(np.zeros(12), goal, held, law.law_data), 0.0)
    _, states = continuous(
        robot.plant(), law, goal + 0.2 * np.cos(np.arange(12.0)), 6.0, lambda t: (goal, held), rtol=1e-8
    )
    np.testing.assert_allclose(states[-1], goal, atol=1e-5)


@pytest.mark.ci("6 s of two links by SciPy")
@pytest.mark.oracle
def test_the_weight_is_compensated_away_from_the_goal():
    """With ḡ(θ) the static error under a torque at the links is that of the springs and K_θ alone."""
    robot = by_name("planar-two-link")
    plant, law = robot.plant(), TorqueFeedback.tuned(robot.problem(pose=[1.2, 0.3]), 30.0, 0.8)
    push = np.array([8.0, -3.0])
    x_d, _ = law.equilibrium
    _, torque = links_at(robot, x_d[:2])
    stiffness, ratio = robot.plant_parameters()["stiffness"], 4.0

    def balance(z):  # the links hold push by the springs, the motors hold the springs
        q, theta = z[:2], z[2:]
        spring = stiffness * (theta - q)
        bar = solved(lambda s: theta - s - torque(s) / stiffness, theta)
        wish = -law.proportional * (theta - x_d[4:6]) + torque(bar)
        return np.concatenate([spring + push - torque(q), ratio * wish + (1.0 - ratio) * spring - spring])

    expected = solved(balance, np.concatenate([x_d[:2], x_d[4:6]]), 1e-9)
    _, states = continuous(plant, law, x_d, 6.0, disturbance=np.concatenate([push, np.zeros(2)]), rtol=1e-8)
    np.testing.assert_allclose(states[-1, [0, 1, 4, 5]], expected, atol=1e-5)
    assert np.abs(expected[:2] - x_d[:2]).max() > 0.02


def test_a_lighter_rotor_damps_the_vibration_that_pd_leaves():
    problem = by_name("planar-two-link").problem()

    def smallest_damping(law):
        modes = np.linalg.eigvals(law.closed_loop())
        assert modes.real.max() < 0.0
        return float((-modes.real / np.abs(modes)).min())

    plain = smallest_damping(MotorPD.tuned(problem, 6.0))
    assert smallest_damping(TorqueFeedback.tuned(problem, 6.0, inertia_ratio=0.25)) > 3.0 * plain


@pytest.mark.ci("compiles a loop of its own")
def test_in_the_sampled_loop_the_goal_is_reached():
    robot = by_name("spatial-three-link")
    goal, held = robot.operating_point([0.5, 0.8, 0.2])
    law = TorqueFeedback.tuned(robot.problem(), 8.0)
    loop = Loop(robot.plant(), Controller(law, None, moving=True))
    run = loop.run(np.concatenate([goal, held]), duration=6.0)
    np.testing.assert_allclose(run.signals["state"][-1], goal, atol=1e-5)


def test_a_joint_too_soft_for_its_weight_is_refused():
    soft = by_name("paper").with_values({"stiffness": 9.0})
    with refused_with(InvalidInput, "iteration", 30, 1.09):
        TorqueFeedback.tuned(soft.problem(), 4.0)
    TorqueFeedback.tuned(soft.problem(), 4.0, compensation="goal")


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"rotor_inertia": 0.0}, r"rotor[\s\S]* \[0\.0\], 'motor'"),
        ({"compensation": "link"}, r"compensation[\s\S]* \[0\.5\], 'link'"),
        ({"proportional": -1.0}, r"proportional[\s\S]* -1\.0"),
        ({"compensation": "goal", "proportional": 1.0}, r"minimum[\s\S]* -4\.55"),
    ],
)
def test_what_does_not_fit_is_refused(changes, complaint):
    robot = by_name("paper")
    settings = {"rotor_inertia": 0.5, "proportional": 20.0, "derivative": 3.0}
    TorqueFeedback(plant=robot.plant(), equilibrium=robot.operating_point([np.pi]), **settings)
    with pytest.raises(InvalidInput, match=complaint):
        TorqueFeedback(
            plant=robot.plant(), equilibrium=robot.operating_point([np.pi]), **{**settings, **changes}
        )
