"""Drives that take velocities and positions, against MuJoCo's own actuators."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tests.builders import joint_text
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.designs.plans import drive_torques, holding_shares, quintic_move, true_robot
from flexhinf.designs.responses import joint_limits
from flexhinf.errors import InvalidInput
from flexhinf.plant import Parameters
from flexhinf.plant.joints import elastic_joints, standstill_function
from flexhinf.robot import MuJoCoPlant

LOOPS = {
    "velocity": ('drive_bandwidth = "12 Hz"', "drive_damping = {k}"),
    "position": ('drive_bandwidth = "12 Hz"\ndrive_damping_ratio = 0.8', "drive_stiffness = {k}\ndrive_damping = 20.0"),
}  # fmt: skip


def text_of(*motors, rigid=False):
    """Two joints that turn in a vertical plane; the second may be rigid."""
    own = [
        f"motor_inertia = {inertia}\nfriction = 0.4\n{motor}" for inertia, motor in zip((0.3, 0.12), motors)
    ]
    first = joint_text(
        "a", axis=[0, 1, 0], mass=3.0, centre=(0.2, 0.0, 0.0), spring="stiffness = 400.0", motor=own[0]
    )
    second = joint_text(
        "b",
        axis=[0, 1, 0],
        xyz=[0.4, 0.0, 0.0],
        centre=(0.2, 0.0, 0.0),
        spring="stiffness = 200.0",
        motor=own[1],
    )
    if rigid:
        second = second.replace("[joint.spring]\nstiffness = 200.0\n", "").replace(
            'name = "b"', 'name = "b"\nrigid = true'
        )
    return first + second


@pytest.fixture
def robot_of(write):
    def load(drive, share=1.0, gains=False, rigid=False, more=""):
        loop = LOOPS[drive][gains].format(k=900.0)
        motor = f'drive = "{drive}"\n{loop}\n{more}\n'
        load_share = f"load_share = {share}\n" if share != 1.0 else ""
        return fh.load_robot(
            write(text_of(motor + load_share, motor + load_share * (not rigid), rigid=rigid))
        )

    return load


@pytest.mark.quick_cases(2)
@pytest.mark.oracle
@pytest.mark.parametrize(
    ("drive", "share", "gains", "rigid"),
    [
        ("velocity", 0.0, True, False), ("velocity", 1.0, False, False), ("position", 1.0, True, True),
        ("position", 0.4, False, False), ("position", 0.0, False, False),
    ],
)  # fmt: skip
def test_a_drive_is_that_of_mujoco_with_its_load(robot_of, drive, share, gains, rigid):
    """MuJoCo's <position> and <velocity> actuators move link and motor of a heavy arm, pushed, as our plant says."""
    pytest.importorskip("mujoco", reason="MuJoCo is not installed")
    robot = robot_of(drive, share, gains, rigid)
    plant, (x, u) = robot.plant(), robot.operating_point((0.3, -0.5))
    other, p, rng = MuJoCoPlant(robot, None, step=1e-4), plant.parameters.vector(), np.random.default_rng(1)
    other.reset(x)
    push, ours = np.array([5.0, -2.0, 3.0, 1.0]), x
    for _ in range(10):
        command = u + rng.normal(0.0, 0.1, 2)
        other.step(command, push, 5e-3)

        def rates(t, y, command=command):
            return np.array(plant.traced_flow(y, command, push, p)).ravel()

        ours = solve_ivp(rates, (0.0, 5e-3), ours, rtol=1e-9, atol=1e-11).y[:, -1]
    assert np.abs(ours - x).max() > 0.1
    assert np.abs(other.state() - ours).max() < 2e-6


@pytest.mark.parametrize(("drive", "share"), [("velocity", 1.0), ("position", 0.3), ("position", 0.0)])
def test_of_friction_that_sticks_the_drive_leaves_its_share(robot_of, drive, share):
    robot = robot_of(drive, share, more="coulomb_friction = 2.0")
    plant = robot.plant(extras="coulomb_friction", sticking=True)
    fast = np.concatenate([np.zeros(6), [1.0, -1.0]])
    left = plant.arrest(fast, 1e-3, Parameters(robot.plant_parameters()))
    assert fast[6:] - left[6:] == pytest.approx(1e-3 * share * 2.0 / np.array([0.3, -0.12]))


@pytest.mark.parametrize(("drive", "share"), [("velocity", 1.0), ("velocity", 0.0), ("position", 0.3)])
def test_inverse_dynamics_and_rest_are_those_of_the_flow(robot_of, drive, share):
    robot = robot_of(drive, share)
    plant, p = robot.plant(), robot.plant().parameters.vector()
    q = np.random.default_rng(0).normal(size=(5, 2))
    x, u = robot.inverse_dynamics(*q)
    rates = np.array(plant.traced_flow(x, u, np.zeros(4), p)).ravel()
    step = 1e-5
    ahead = [sum(step**k / k_factorial * q[k + j] for k, k_factorial in ((0, 1), (1, 1), (2, 2)) if k + j < 5)
             for j in range(5)]  # fmt: skip
    behind = [sum((-step) ** k / k_factorial * q[k + j] for k, k_factorial in ((0, 1), (1, 1), (2, 2)) if k + j < 5)
              for j in range(5)]  # fmt: skip
    slope = (robot.inverse_dynamics(*ahead)[0] - robot.inverse_dynamics(*behind)[0]) / (2.0 * step)
    assert rates == pytest.approx(slope, rel=1e-6, abs=1e-6)
    rest = robot.operating_point((0.3, 0.5))
    held = standstill_function(plant)(np.array([0.3, 0.5]), p)
    assert np.array(held).ravel() == pytest.approx(np.concatenate(rest), abs=1e-12)
    joints = elastic_joints(plant, *rest)
    assert joints.stiffness == pytest.approx([400.0, 200.0])
    assert joints.motor_damping / joints.motor_inertia == pytest.approx(
        2.0 * np.pi * 12.0 * (1.0 if drive == "velocity" else 1.6) + share * 0.4 / joints.motor_inertia
    )


def test_the_loop_has_the_bandwidth_that_is_stated(robot_of):
    """Where the load is rejected, a motor answers its command by ω²/(s² + 2ζωs + ω²)."""
    plant = robot_of("position", 0.0).plant()
    a, b, _, _ = plant.linearise(np.zeros(8), np.zeros(2))
    omega, s = 2.0 * np.pi * 12.0, 30.0j
    response = np.linalg.solve(s * np.eye(8) - a, b)[4:6]
    wanted = omega**2 / (s**2 + 1.6 * omega * s + omega**2)
    assert response == pytest.approx(wanted * np.eye(2), abs=1e-9)


@pytest.mark.parametrize(
    ("motor", "named"),
    [
        ('drive = "voltage"', "'torque'"),
        ('drive = "position"\ndrive_bandwidth = 60.0', "drive_damping_ratio"),
        (
            'drive = "position"\ndrive_bandwidth = 60.0\ndrive_damping_ratio = 0.9\ntorque_constant = 1.0',
            "'current'",
        ),
        ("drive_bandwidth = 60.0", "drive_bandwidth"),
        ('drive = "servo"', "'position'"),
        ('drive = "velocity"\ndrive_bandwidth = 60.0\nload_share = 1.5', "load_share"),
        ('drive = "velocity"\ndrive_bandwidth = 60.0\ninductance = 1e-3', "velocity"),
        ('drive = "velocity"\ndrive_bandwidth = 60.0\ndrive_delay = -1.0', "drive_delay"),
    ],
)
def test_contradictions_are_refused_by_name(write, motor, named):
    with refused_with(InvalidInput, named):
        fh.load_robot(write(text_of(motor, motor)))


def test_unlike_drives_are_refused_and_the_advice_works(write):
    position = 'drive = "position"\n' + LOOPS["position"][0]
    velocity = 'drive = "velocity"\n' + LOOPS["velocity"][0]
    with refused_with(InvalidInput, "position", "velocity"):
        fh.load_robot(write(text_of(position, velocity)))
    assert fh.load_robot(write(text_of(velocity, velocity))).drive == "velocity"


def test_a_rigid_joint_does_not_reject_its_link(write):
    motor = 'drive = "velocity"\ndrive_bandwidth = 60.0\nload_share = 0.0'
    with refused_with(InvalidInput, "load_share"):
        fh.load_robot(write(text_of(motor, motor, rigid=True)))


def test_a_loop_is_not_faster_than_its_drives(robot_of):
    robot = robot_of("position", more='drive_delay = "16 ms"\ndrive_period = "8 ms"')
    with refused_with(InvalidInput, "0.008"):
        joint_limits(robot, fh.Specification(period=1e-3))
    with refused_with(InvalidInput, "latency 2"):
        joint_limits(robot, fh.Specification(period=8e-3))
    assert joint_limits(robot, fh.Specification(period=8e-3, latency=2)).joints == ("a", "b")


def test_a_slower_drive_is_a_tolerance(write):
    motor = 'drive = "velocity"\ndrive_bandwidth = { value = 60.0, tolerance = 30 }'
    robot = fh.load_robot(write(text_of(motor, motor)))
    slow = robot.corner({"drive_bandwidth_a": -1.0})
    assert slow["drive_damping"] == pytest.approx([0.3 * 42.0, 0.12 * 60.0])
    with pytest.raises(InvalidInput):
        robot.corner({"drive_bandwidth_a": -2.0})


@pytest.mark.quick_cases(2)
@pytest.mark.oracle
@pytest.mark.parametrize(("drive", "rigid"), [("velocity", False), ("position", True), ("position", False)])
def test_a_drives_torque_limit_is_that_of_mujoco(robot_of, drive, rigid):
    """Commands far away: MuJoCo's actuators with a range of forces move the arm as our plant with the extra."""
    pytest.importorskip("mujoco", reason="MuJoCo is not installed")
    robot = robot_of(drive, rigid=rigid, more="drive_torque_limit = 15.0")
    plant, (x, u) = robot.plant(extras="drive_torque_limit"), robot.operating_point((0.3, -0.5))
    free, p = robot.plant(), plant.parameters.vector()
    other = MuJoCoPlant(robot, None, step=1e-4, extras="drive_torque_limit")
    other.reset(x)
    ours, unlimited, still = x, x, np.zeros(4)
    for command in (u + 1.0, u - 1.5, u):

        def rates(t, y, model=plant, command=command):
            return np.array(model.traced_flow(y, command, still, p)).ravel()

        other.step(command, still, 0.03)
        ours = solve_ivp(rates, (0.0, 0.03), ours, rtol=1e-9, atol=1e-11, max_step=1e-3).y[:, -1]
        unlimited = solve_ivp(rates, (0.0, 0.03), unlimited, rtol=1e-9, atol=1e-11, args=(free, command)).y[
            :, -1
        ]
    assert np.abs(other.state() - ours).max() < 1e-4
    assert np.abs(unlimited - ours).max() > 0.1


@pytest.mark.parametrize("share", [0.0, 0.4])
def test_a_limited_drive_rejects_its_load_as_far_as_its_torque_goes(robot_of, share):
    """|J θ̈ + K (θ − q) + B θ̇| ≤ τ_max, the motor's own torque, whatever the command; and exact below."""
    robot = robot_of("position", share, more="drive_torque_limit = 15.0")
    limited, free = robot.plant(extras="drive_torque_limit"), robot.plant()
    p, rng = robot.plant_parameters(), np.random.default_rng(3)
    reached = set()
    for _ in range(30):
        x, c = rng.normal(0.0, 0.03, 8), rng.normal(0.0, 0.03, 2)
        torques = [
            p["motor_inertia"] * plant.derivative(x, c)[6:]
            + p["stiffness"] * (x[4:6] - x[:2])
            + p["friction"] * x[6:]
            for plant in (limited, free)
        ]
        assert torques[0] == pytest.approx(np.clip(torques[1], -15.0, 15.0), abs=1e-9)
        reached |= set((np.abs(torques[1]) > 15.0).tolist())
    assert reached == {True, False}
    with refused_with(InvalidInput, "drive_torque_limit", "load_share"):
        MuJoCoPlant(robot, extras="drive_torque_limit")


def test_designs_are_judged_with_the_limit_of_the_drive(robot_of, write):
    robot = robot_of("position", more="drive_torque_limit = 15.0")
    s = fh.Specification()
    assert "drive_torque_limit" in true_robot(robot, s)[1].extras
    assert "drive_torque_limit" not in true_robot(robot_of("position"), s)[1].extras
    motor = "torque_constant = 1.0\ndrive_torque_limit = 15.0"
    with refused_with(InvalidInput, "drive_torque_limit", "'position'"):
        fh.load_robot(write(text_of(motor, motor)))


@pytest.mark.oracle
@pytest.mark.parametrize(
    ("drive", "share", "rigid"), [("velocity", 0.0, False), ("position", 0.4, False), ("position", 1.0, True)]
)
def test_the_torque_of_a_planned_motion_is_that_of_newton(robot_of, drive, share, rigid):
    """J θ̈ + B θ̇ + the spring's torque by the accelerations of the motion, whatever the drive rejects."""
    robot = robot_of(drive, share, rigid=rigid, more="drive_torque_limit = 60.0")
    plan = fh.Waypoints([0.0, 0.4], [[-0.5, 0.2], [0.6, -0.4]], "quintic")
    times = np.linspace(0.05, 0.35, 7)
    motion = plan.derivatives(times, 4)
    p, h = robot.plant_parameters(), 1e-6
    state, later, before = (
        robot.inverse_dynamics(*plan.derivatives(times + step, 4))[0] for step in (0.0, h, -h)
    )
    q, _, angle, speed = robot.layout.split(state.T)
    rates = ((later - before) / (2.0 * h)).T
    elastic = robot.layout.elastic
    load = p["stiffness"][:, None] * (angle - q[elastic])
    acceleration = robot.layout.split(rates)[3]
    wanted = p["motor_inertia"][elastic][:, None] * acceleration + load
    wanted += p["friction"][elastic][:, None] * speed
    found = drive_torques(robot, motion)
    assert pytest.approx(wanted, rel=1e-5, abs=1e-5) == found[:, elastic].T
    if rigid:  # the whole arm's equation without a motor of its own
        twin = robot_of("position", rigid=True).inverse_dynamics(*motion)[1][:, 1]
        ahead = p["drive_stiffness"][1] * (twin - motion[0][:, 1]) - p["drive_damping"][1] * motion[1][:, 1]
        assert found[:, 1] == pytest.approx(ahead, rel=1e-9)
    assert holding_shares(robot, motion[0]) == pytest.approx(
        np.abs(drive_torques(robot, motion[:1])).max(axis=1) / 60.0
    )


def test_a_move_is_slowed_down_until_the_drives_have_the_torque(robot_of):
    """Without the limit the same move takes 1.5 times the torque that is left beside the weight."""
    free = robot_of("position")
    start, goal = np.array([-0.5, 0.2]), np.array([0.6, -0.4])
    limits = joint_limits(free, fh.Specification(period=8e-3, latency=1))
    limits = replace(limits, speed=np.array([20.0, 20.0]))
    quick = quintic_move(free, limits, start, goal)
    motion = quick.derivatives(np.linspace(0.0, quick.duration, 50), 4)
    weight, most = (np.abs(drive_torques(free, rows)).max() for rows in (motion[:1], motion))
    stated = weight + 0.5 * (most - weight)
    robot = robot_of("position", more=f"drive_torque_limit = {stated}")
    slow = quintic_move(robot, limits, start, goal)
    again = slow.derivatives(np.linspace(0.0, slow.duration, 50), 4)
    assert slow.duration > 1.1 * quick.duration
    assert np.abs(drive_torques(robot, again)).max() < stated < most


def test_motors_that_do_not_feel_the_links_are_no_sensors_of_them(robot_of):
    """The refusal says what to measure instead, and that is taken; so is a drive that feels a part of its load."""
    s = fh.Specification(measured="motor_position", period=8e-3)
    with refused_with(InvalidInput, "a, b", "--measured link_position,motor_position"):
        joint_limits(robot_of("velocity", 0.0), s)
    joint_limits(robot_of("velocity", 0.0), replace(s, measured=("link_position", "motor_position")))
    joint_limits(robot_of("velocity", 0.1), s)
    with refused_with(InvalidInput, "at b:"):
        joint_limits(robot_of("velocity", 0.0), replace(s, measured=("motor_position", "deflection_a")))
