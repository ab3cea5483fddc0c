"""Joints declared rigid: no spring states, the rotor turns with the link; Pinocchio, MuJoCo and the stiff limit."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from tests.builders import runge_kutta
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.plant import Parameters
from flexhinf.robot import MuJoCoPlant, Robot, load_robot
from flexhinf.robot.kinematics import check_delay, check_fast


def mixed(name: str, *rigid: str) -> Robot:
    """A robot of the catalogue with some joints rigid."""
    whole = load_robot(name)
    kept = [
        p
        for p in whole.parameters
        if not any(p.name in (f"stiffness_{joint}", f"damping_{joint}") for joint in rigid)
    ]
    return Robot(
        whole.name, tuple(kept), None, whole.links, whole.drive, whole.home, "", rigid=rigid,
    )  # fmt: skip


ROBOTS = [("spatial-three-link", (1,)), ("seven-link", (0, 4, 6)), ("planar-two-link", (0,))]


def of(case):
    name, places = case
    joints = load_robot(name).joint_names
    return mixed(name, *(joints[i] for i in places)), load_robot(name), list(places)


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize("case", ROBOTS, ids=str)
def test_states_and_signals_of_a_rigid_joint(case):
    robot, _, rigid = of(case)
    plant, names = (
        robot.plant(measured=("motor_position", "link_velocity", "joint_torque")),
        robot.joint_names,
    )
    springs = [name for i, name in enumerate(names) if i not in rigid]
    assert plant.states[2 * len(names) :] == tuple(
        f"motor_{kind}_{name}" for kind in ("position", "velocity") for name in springs
    )
    assert plant.outputs[: len(names)] == tuple(f"motor_position_{name}" for name in names)
    assert plant.outputs[2 * len(names) :] == tuple(f"joint_torque_{name}" for name in springs)
    x, u = robot.operating_point()
    y = np.asarray(plant.traced_output(x, u, plant.parameters.vector()), dtype=float).ravel()
    assert [y[i] for i in rigid] == [x[i] for i in rigid]
    assert np.abs(plant.derivative(x, u)).max() < 1e-9
    with pytest.raises(InvalidInput, match=f"measure.*'joint_torque_{names[rigid[0]]}'"):
        robot.plant(measured=(f"joint_torque_{names[rigid[0]]}",))
    again = pickle.loads(pickle.dumps(robot))
    assert again.plant().states == robot.plant().states


@pytest.mark.oracle
@pytest.mark.parametrize("case", ROBOTS, ids=str)
def test_accelerations_are_pinocchios_with_the_rotors_as_armature(case, rigid, pinocchio_model):
    pin = pytest.importorskip("pinocchio")
    robot, _, places = of(case)
    model, n = pinocchio_model(*rigid(robot)), len(robot.joint_names)
    p = Parameters(robot.plant_parameters())
    model.armature = np.array([p.motor_inertia[i] if i in places else 0.0 for i in range(n)])
    rng, plant, elastic = np.random.default_rng(1), robot.plant(), robot.layout.elastic
    gain = p.torque_constant / p.resistance if robot.drive == "voltage" else np.ones(n)
    back = gain * p.back_emf_constant if robot.drive == "voltage" else np.zeros(n)
    for _ in range(10):
        x, u, d = rng.normal(size=plant.n), rng.normal(size=n), rng.normal(size=2 * n)
        q, dq, theta, dtheta = robot.layout.split(x)
        spring = np.zeros(n)
        spring[elastic] = p.stiffness * (theta - q[elastic])
        speed = robot.layout.motors(dq, dtheta)
        driven = gain * u - (p.friction + back) * speed + d[n:]
        torque = np.array([driven[i] if i in places else spring[i] for i in range(n)]) + d[:n]
        links = pin.aba(model, model.createData(), q, dq, torque)
        motors = (driven - spring)[elastic] / p.motor_inertia[elastic]
        expected = np.concatenate([dq, links, dtheta, motors])
        np.testing.assert_allclose(plant.derivative(x, u, d), expected, atol=1e-10 * np.abs(expected).max())


@pytest.mark.quick_cases(2)
@pytest.mark.oracle
@pytest.mark.parametrize("case", ROBOTS, ids=str)
def test_the_limit_of_ever_stiffer_springs(case):
    """Poles of the robot with stiff springs, the fast ones left out, come nearer as 1 / K; so does the equilibrium."""
    robot, whole, rigid = of(case)
    own = np.linalg.eigvals(robot.plant().linearise(*robot.operating_point())[0])
    away = []
    for stiffness in (1e7, 1e8):
        stiff = whole.with_values({f"stiffness_{whole.joint_names[i]}": stiffness for i in rigid})
        point = stiff.operating_point()
        poles = np.linalg.eigvals(stiff.plant().linearise(*point)[0])
        slow = poles[np.argsort(np.abs(poles))][: len(own)]
        away.append(max(np.abs(slow - pole).min() for pole in own) / np.abs(own).max())
        np.testing.assert_allclose(point[1], robot.operating_point()[1], rtol=1e-12, atol=1e-12)
    assert away[1] < 1e-4
    assert away[1] < 0.2 * away[0]


@pytest.mark.oracle
def test_mujoco_integrates_a_mixed_arm_to_the_same_motion():
    pytest.importorskip("mujoco")
    robot = mixed("spatial-three-link", load_robot("spatial-three-link").joint_names[1])
    box, plant = MuJoCoPlant(robot, None, step=1e-3), robot.plant()
    x, u = robot.operating_point()
    n = len(u)
    d = 0.5 * np.arange(2 * n)
    box.reset(x)
    for _ in range(200):
        box.step(u, d, 1e-3)

    for _ in range(200):
        x = runge_kutta(lambda x: plant.derivative(x, u, d), x, 1e-3)
    np.testing.assert_allclose(box.output(), x, atol=1e-9)


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize("case", ROBOTS, ids=str)
def test_feedforward_is_the_inverse_of_the_flow(case):
    robot, _, _ = of(case)
    rng, n, plant = np.random.default_rng(2), len(robot.joint_names), robot.plant()
    motion = rng.normal(size=(5, n))
    x, u = robot.inverse_dynamics(*motion)
    rates = plant.derivative(x, u)
    np.testing.assert_allclose(rates[:n], motion[1], rtol=1e-12)
    np.testing.assert_allclose(rates[n : 2 * n], motion[2], rtol=1e-8, atol=1e-8)
    with refused_with(InvalidInput, "flat", "rigid ["):
        robot.flat_coordinates(x, None)


def test_checks_before_a_design_count_springs_only():
    robot = mixed("planar-two-link", "shoulder")
    check_fast(robot, 1e-3)
    check_delay(robot, 5e-3)
    with refused_with(InvalidInput, "delay", "5 s"):
        check_delay(robot, 5.0)


def test_what_a_rigid_joint_cannot_have_is_refused():
    two = load_robot("planar-two-link")
    with refused_with(InvalidInput, "elastic", "['shoulder', 'elbow']"):
        mixed("planar-two-link", *two.joint_names)
    with refused_with(InvalidInput, "elastic", "['wrist']"):
        mixed("planar-two-link", "wrist")
    robot = mixed("planar-two-link", "shoulder")
    with pytest.raises(InvalidInput, match="motor_velocity_shoulder"):
        robot.problem(penalty={"motor_velocity_shoulder": 1.0})
    weights = {"link_position": [3.0, 4.0], "joint_torque_rate": 0.1, "motor_velocity": 0.5}
    problem = robot.problem(penalty=fh.Penalty(weights | {"link_position_integral": 5.0}, effort=1.0))
    assert np.isfinite(fh.smallest_gamma(problem))
