"""Motors that move more than their own joints, θ = T q: against absolute angles by hand, MuJoCo, and the pairs' law."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.baselines import GravityCompensatedLQR
from flexhinf.errors import InvalidInput
from flexhinf.loop import Controller
from flexhinf.plant.joints import elastic_joints, standstill_function
from flexhinf.robot import MuJoCoPlant
from flexhinf.robot.elastic import Sticking
from flexhinf.robot.shaper import vibration_frequencies

#: A SCARA whose elbow's motor stands in the base: the belt turns the forearm by φ₂ = q₁ + q₂.
BELT = """
name = "belt"
down = {down}
gravity = {gravity}
home = [0.4, 0.6]
[[joint]]
name = "shoulder"
limits = [-1.5, 1.5]
link = {{ mass = 3.0, centre_of_mass = [0.15, 0, 0], inertia = {{ xx = 0.005, yy = 0.03, zz = 0.03 }} }}
spring = {{ stiffness = 2500.0{spring} }}
motor = {{ motor_inertia = 0.25, friction = 1.0{motor} }}
[[joint]]
name = "elbow"
xyz = [0.3, 0, 0]
limits = [-1.5, 1.5]
coupling = {coupling}
link = {{ mass = 1.5, centre_of_mass = [0.12, 0, 0], inertia = {{ xx = 0.002, yy = 0.012, zz = 0.012 }} }}
spring = {{ stiffness = 900.0{spring} }}
motor = {{ motor_inertia = 0.08, friction = 0.4{motor} }}
"""
T = np.array([[1.0, 0.0], [1.0, 1.0]])
K, J, B = np.diag([2500.0, 900.0]), np.diag([0.25, 0.08]), np.diag([1.0, 0.4])

#: A wrist whose two motors tilt together and turn against each other.
WRIST = np.array([[1.0, 1.0], [0.8, -1.2]])


def belt(folder: Path, spring: str = "", motor: str = "", **values: str) -> fh.Robot:
    stated = {"coupling": "{ shoulder = 1, elbow = 1.0 }", "down": "[0, -1, 0]", "gravity": "9.81", **values}
    (folder / "belt.toml").write_text(BELT.format(spring=spring, motor=motor, **stated), encoding="utf-8")
    return fh.load_robot(folder / "belt.toml")


def masses(q: np.ndarray) -> np.ndarray:
    """M of the absolute angles φ₁ = q₁, φ₂ = q₁ + q₂: their arms turn alone, but for the cosine between them."""
    across = 1.5 * 0.3 * 0.12 * np.cos(q[1])
    return np.array([[0.03 + 3.0 * 0.15**2 + 1.5 * 0.3**2, across], [across, 0.012 + 1.5 * 0.12**2]])


def weights(q: np.ndarray) -> np.ndarray:
    """Torques of the weight about the absolute angles, which fall along −y."""
    turned = np.array([q[0], q[0] + q[1]])
    return 9.81 * np.array([3.0 * 0.15 + 1.5 * 0.3, 1.5 * 0.12]) * np.cos(turned)


@pytest.mark.oracle
def test_a_belt_is_a_spring_of_absolute_angles(tmp_path: Path) -> None:
    robot, rng = belt(tmp_path), np.random.default_rng(0)
    plant = robot.plant(("link_position", "motor_position", "deflection", "joint_torque"))
    assert robot.coupling == ((1.0, 0.0), (1.0, 1.0))
    for _ in range(5):
        x, u, d = rng.normal(size=8), rng.normal(size=2), rng.normal(size=4)
        q, dq, theta, dtheta = np.split(x, 4)
        at, rate = T @ q, T @ dq
        whirl = 1.5 * 0.3 * 0.12 * np.sin(q[1]) * np.array([-(rate[1] ** 2), rate[0] ** 2])
        twist = theta - at
        pushed = K @ twist + np.linalg.inv(T).T @ d[:2] - whirl - weights(q)
        links = np.linalg.solve(T, np.linalg.solve(masses(q), pushed))
        motors = np.linalg.solve(J, u + d[2:] - B @ dtheta - K @ twist)
        expected = np.concatenate([dq, links, dtheta, motors])
        np.testing.assert_allclose(plant.derivative(x, u, d), expected, rtol=1e-10, atol=1e-9)
        seen = np.concatenate([q, theta, twist, K @ twist])
        np.testing.assert_allclose(plant.evaluate_output(x, u, plant.parameters.vector()), seen, rtol=1e-12)


def test_it_rests_moves_and_goes_back(tmp_path: Path) -> None:
    robot, rng = belt(tmp_path), np.random.default_rng(1)
    x, u = robot.operating_point((0.3, -0.7))
    held = weights(x[:2])
    np.testing.assert_allclose(x[4:6], T @ x[:2] + held / np.diag(K), rtol=1e-12)
    np.testing.assert_allclose(u, held, rtol=1e-12)
    plant = robot.plant()
    rest = standstill_function(plant)
    assert rest is not None
    found = np.ravel(rest(x[:2], plant.parameters.vector()).full())
    np.testing.assert_allclose(found, np.concatenate([x, u]), atol=1e-11)
    motion = rng.normal(size=(5, 2))
    state, command = robot.inverse_dynamics(*motion)
    ahead, step = [robot.inverse_dynamics(*_later(motion, t))[0] for t in (-1e-4, 1e-4)], 2e-4
    slope = (ahead[1] - ahead[0]) / step
    np.testing.assert_allclose(plant.derivative(state, command), slope, rtol=1e-5, atol=1e-4)
    flat = robot.flat_coordinates(state, plant.parameters.named(plant.parameters.vector()))
    np.testing.assert_allclose(np.array(flat), motion[:4], rtol=1e-9, atol=1e-9)


def _later(motion: np.ndarray, t: float) -> np.ndarray:
    powers = np.array([1.0, t, t**2 / 2, t**3 / 6, t**4 / 24])
    return np.array([powers[: 5 - k] @ motion[k:] for k in range(5)])


@pytest.mark.oracle
@pytest.mark.parametrize("coupling", [T, WRIST], ids=["belt", "wrist"])
def test_it_moves_as_in_mujoco(tmp_path: Path, coupling: np.ndarray) -> None:
    robot = replace(belt(tmp_path, ", damping = 0.5", down="[0.2, -1, 0.1]"), coupling=coupling.tolist())
    extras = ("joint_damping",)
    x, u = robot.operating_point((0.3, -0.7))
    start = x + 0.05 * np.random.default_rng(2).normal(size=8)
    end = []
    for true in (robot.plant(extras=extras), MuJoCoPlant(robot, None, step=1e-4, extras=extras)):
        if isinstance(true, MuJoCoPlant):
            true.reset(start)
            for _ in range(50):
                true.step(u + np.array([1.0, 2.0]), np.array([0.3, 0.1, 0.2, 0.4]), 1e-3)
            end.append(true.state())
        else:
            y, h = start, 1e-4
            flow = _flow(true, u + np.array([1.0, 2.0]), np.array([0.3, 0.1, 0.2, 0.4]))
            for _ in range(500):
                a = flow(y)
                b = flow(y + h / 2 * a)
                c = flow(y + h / 2 * b)
                y = y + h / 6 * (a + 2 * b + 2 * c + flow(y + h * c))
            end.append(y)
    np.testing.assert_allclose(end[0], end[1], rtol=0, atol=1e-8)


def _flow(plant: fh.Plant, u: np.ndarray, d: np.ndarray) -> Any:
    return lambda x: plant.derivative(x, u, d)


@pytest.mark.oracle
def test_its_vibrations_are_those_of_the_absolute_angles(tmp_path: Path) -> None:
    robot = belt(tmp_path, gravity="0", motor=", coulomb_friction = 0.3, load_friction = 0.1")
    q = np.array([0.3, -0.7])
    loose = robot.with_values({name: 0.0 for name in robot.nominal if name.startswith("friction")})
    block = np.block([[K, -K], [-K, K]])
    inertia = np.block([[masses(q), np.zeros((2, 2))], [np.zeros((2, 2)), J]])
    squares = np.sort(np.linalg.eigvals(np.linalg.solve(inertia, block)).real)
    found = [mode.frequency for mode in loose.modes(q) if mode.name == "vibration"]
    np.testing.assert_allclose(found, np.sqrt(squares[2:]) / (2 * np.pi), rtol=1e-9)
    held = np.sort(np.linalg.eigvals(np.linalg.solve(masses(q), K)).real)
    np.testing.assert_allclose(
        vibration_frequencies(robot, q[None])[0], np.sqrt(held) / (2 * np.pi), rtol=1e-6
    )
    x = np.concatenate([q, np.zeros(2), T @ q + [1e-3, 1e-3], [0.5, 0.5]])
    stuck = Sticking(robot.layout, ("coulomb_friction", "load_friction"))
    p = robot.plant().parameters
    lost = x[6:] - stuck(x, 1e-3, p.named(p.vector()))[6:]
    np.testing.assert_allclose(lost, 1e-3 * (0.3 + 0.1 * np.diag(K) * 1e-3) / np.diag(J), rtol=1e-9)


@pytest.mark.ci("compiles the law and the filter of pairs")
@pytest.mark.oracle
def test_the_law_and_the_filter_of_pairs_see_the_absolute_angles(tmp_path: Path) -> None:
    robot, q = belt(tmp_path), np.array([0.3, -0.7])
    plant = robot.plant(("link_position", "motor_position"))
    joints = elastic_joints(plant, *robot.operating_point(q), coupled=True)
    np.testing.assert_allclose(joints.link_inertia, masses(q), rtol=1e-9)
    np.testing.assert_allclose(joints.stiffness, np.diag(K), rtol=1e-9)
    slope = -np.diag(9.81 * np.array([3.0 * 0.15 + 1.5 * 0.3, 1.5 * 0.12]) * np.sin(T @ q))
    np.testing.assert_allclose(joints.gravity_slope, slope, atol=1e-7)
    law = fh.ModalLaw.tuned(robot.problem(fh.Penalty({"link_position": 1.0})))
    a, b, _, c = plant.linearise(*robot.operating_point(q))
    gain = law.slope_at(q)
    at, reference = robot.operating_point(q), robot.operating_point(robot.home)
    moved = np.array([1e-6, -2e-6, 1e-4, 2e-4, 3e-6, 1e-6, -1e-4, 1e-4, 1e-6, 2e-6])
    state = np.concatenate([at[0], np.zeros(2)])[:8]
    np.testing.assert_allclose(law.evaluate_about(moved, state, at[1], law.law_data), gain @ moved, rtol=1e-9)
    whole = np.pad(a, ((0, 0), (0, 2))) + b @ gain
    loop = np.vstack([whole, np.eye(2, 10)])
    assert np.linalg.eigvals(loop).real.max() < -1.0
    noise = np.diag([0.0, 0.0, 1e-4, 1e-4, 0.0, 0.0, 1e-2, 1e-2])
    ekf = fh.ExtendedKalmanFilter(
        plant, 1e-3, noise, 1e-8, reference[0], noise, form="covariance", gate=0.999
    )
    filter = fh.ModalFilter(ekf)
    error = (np.eye(8) - filter.gain(at[0]) @ c) @ (np.eye(8) + 1e-3 * a + 5e-7 * a @ a)
    assert np.abs(np.linalg.eigvals(error)).max() < 1.0
    assert np.all(filter.variances(at[0]) > 0.9e-8)
    controller = Controller(law, filter, moving=True)
    controller.save(tmp_path / "controller")
    again = fh.load_controller(tmp_path / "controller")
    y, r = np.array([0.41, 0.59, 0.42, 1.0]), np.concatenate(reference)
    np.testing.assert_array_equal(again.step(y, r), controller.step(y, r))
    with refused_with(InvalidInput, "law", "coupling", "workspace"):
        GravityCompensatedLQR.design(robot.problem(fh.Penalty({"link_position": 1.0})))


def test_what_couples_nothing_or_too_little_is_refused(tmp_path: Path) -> None:
    assert belt(tmp_path, coupling="{ elbow = 1.0 }").coupling == ()
    with refused_with(InvalidInput, "inverse", "coupling = { shoulder = 1, elbow = 1 }"):
        belt(tmp_path, coupling="{ shoulder = 2.0 }")
    assert belt(tmp_path, coupling="{ shoulder = 1, elbow = 1 }").coupling
    with refused_with(InvalidInput, "coupling", "sholder", "shoulder"):
        belt(tmp_path, coupling="{ sholder = 1.0, elbow = 1.0 }")
    with refused_with(InvalidInput, "coupling", "{ shoulder = 1.0, elbow = 1.0 }"):
        belt(tmp_path, coupling="[1.0, 1.0]")
    with refused_with(InvalidInput, "rigid", "'elbow'", "coupled"):
        belt(tmp_path).with_rigid("elbow")
    assert belt(tmp_path, coupling="{ elbow = 1.0 }").with_rigid("elbow").rigid == ("elbow",)
