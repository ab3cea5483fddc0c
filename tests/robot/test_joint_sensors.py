"""Sensors of a robot file: their steps and noise seen from the link, and the designs that have them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.designs.loop_setup import LoopPlants
from flexhinf.designs.own_sensors import measuring, with_own_sensors
from flexhinf.designs.request import read_request
from flexhinf.designs.responses import joint_limits
from flexhinf.designs.specification import SpecificationError
from flexhinf.errors import InvalidInput
from flexhinf.robot.joint_sensors import JointSensor

ARM = """
name = "two"
down = [1.0, 0.0, 0.0]
[[joint]]
name = "shoulder"
axis = [0.0, 0.0, 1.0]
link = {{ mass = 3.0, centre_of_mass = [0.25, 0.0, 0.0], inertia = {{ xx = 2.4e-3, yy = 0.06, zz = 0.06 }} }}
spring = {{ stiffness = 4000.0 }}
motor = {{ rotor_inertia = 3.0e-5, gear_ratio = 100.0 }}
{shoulder}
[[joint]]
name = "elbow"
axis = [0.0, 0.0, 1.0]
xyz = [0.5, 0.0, 0.0]
link = {{ mass = 2.0, centre_of_mass = [0.2, 0.0, 0.0], inertia = {{ xx = 1.6e-3, yy = 0.03, zz = 0.03 }} }}
spring = {{ stiffness = 2000.0 }}
motor = {{ motor_inertia = 0.12 }}
{elbow}
"""

SHOULDER = """
[[joint.sensor]]
kind = "motor_position"
counts = 4096
[[joint.sensor]]
kind = "link_position"
counts = 1048576
noise = "0.02 mrad"
"""
ELBOW = """
[[joint.sensor]]
kind = "motor_position"
step = 1e-5
[[joint.sensor]]
kind = "deflection"
noise = 1e-5
[[joint.sensor]]
kind = "joint_torque"
step = "0.01 N·m"
"""


def arm(folder: Path, shoulder: str = SHOULDER, elbow: str = ELBOW) -> Path:
    path = folder / "two.toml"
    path.write_text(ARM.format(shoulder=shoulder, elbow=elbow), encoding="utf-8")
    return path


def test_sensors_are_seen_from_the_link_and_a_design_has_them(tmp_path: Path) -> None:
    robot = fh.load_robot(path := arm(tmp_path))
    turn = 2.0 * math.pi
    assert robot.sensors == (
        JointSensor("motor_position_shoulder", turn / 4096 / 100.0),
        JointSensor("link_position_shoulder", turn / 2**20, 2e-5),
        JointSensor("motor_position_elbow", 1e-5), JointSensor("deflection_elbow", 0.0, 1e-5),
        JointSensor("joint_torque_elbow", 0.01),
    )  # fmt: skip
    s = read_request(path).specification
    assert s.measured == (
        "link_position_shoulder",
        "motor_position",
        "joint_torque_elbow",
        "deflection_elbow",
    )
    own = {sensor.signal: sensor for sensor in robot.sensors}
    plants = LoopPlants(robot, s)
    steps = plants.quantisation
    assert steps is not None
    for name, variance, step in zip(plants.model.outputs, plants.noise_variances, steps):
        noise = own[name].noise or own[name].step / math.sqrt(12.0)
        assert (math.sqrt(variance), step) == (pytest.approx(noise), own[name].step)
    assert with_own_sensors(robot, s) == s
    # A file of this design says the same, and what is stated wins.
    path.with_name("design.toml").write_text(
        '[design]\nrobot = "two.toml"\nmeasured = "motor_position"\nmeasurement_noise = "1 mrad"\n',
        encoding="utf-8",
    )
    stated = read_request(path.with_name("design.toml")).specification
    assert LoopPlants(robot, stated).noise_variances == pytest.approx([1e-6, 1e-6])
    assert LoopPlants(robot, stated).quantisation == pytest.approx([turn / 4096 / 100, 1e-5])
    # A rival that measures what the robot has not gets the noise of a robot without sensors.
    rival = measuring(robot, s, ("link_position",))
    assert LoopPlants(robot, rival).noise_variances == pytest.approx([4e-10, 1e-8])
    assert LoopPlants(robot, measuring(robot, stated, ("link_position",))).noise_variances[
        0
    ] == pytest.approx(1e-6)


def test_a_latency_covers_the_sensors_that_are_measured(tmp_path: Path) -> None:
    late = '[[joint.sensor]]\nkind = "motor_position"\nstep = 1e-5\ndelay = "3 ms"\n'
    late += '[[joint.sensor]]\nkind = "joint_torque"\nnoise = 0.1\ndelay = 0.012'
    robot = fh.load_robot(arm(tmp_path, elbow=late))
    assert [sensor.delay for sensor in robot.sensors] == [0.0, 0.0, 0.003, 0.012]
    both = ("motor_position", "joint_torque_elbow")
    with refused_with(InvalidInput, "sensors", "latency 3"):
        joint_limits(robot, fh.Specification(period=1e-3, measured=("motor_position",), latency=2))
    joint_limits(robot, fh.Specification(period=1e-3, measured=("motor_position",), latency=3))
    joint_limits(robot, fh.Specification(period=1e-3, measured=("link_position_shoulder",), latency=0))
    with refused_with(InvalidInput, "sensors", "latency 6"):
        joint_limits(robot, fh.Specification(period=2e-3, measured=both, latency=5))
    joint_limits(robot, fh.Specification(period=2e-3, measured=both, latency=6))
    joint_limits(robot, fh.Specification(period=2e-3, measured=both, estimator="none"))


def test_what_a_robot_has_not_is_not_measured(tmp_path: Path) -> None:
    path = arm(tmp_path)
    with refused_with(SpecificationError, "link_position_elbow", "joint.sensor") as refusal:
        read_request(path, settings={"measured": "link_position,motor_position"})
    read_request(
        path, settings={"measured": str(refusal.value).split("try:")[1].strip().split("; or")[0].split()[-1]}
    )
    robot = fh.load_robot(path).with_rigid("elbow")
    assert "deflection_elbow" not in [sensor.signal for sensor in robot.sensors]
    robot.save(tmp_path / "rigid.toml")
    assert fh.load_robot(tmp_path / "rigid.toml").sensors == robot.sensors


def test_deflection_is_motor_minus_link(tmp_path: Path) -> None:
    robot = fh.load_robot("scara")
    plant = robot.plant(("deflection", "joint_torque"))
    x, u = robot.operating_point((0.3, -0.4, 0.1, 0.2))
    x = x + np.linspace(1e-3, 2e-3, len(x))
    y = np.asarray(plant.traced_output(x, u, plant.parameters.vector()), dtype=float).ravel()
    assert y[:4] == pytest.approx(x[8:12] - x[:4])
    assert y[4:] == pytest.approx(robot.plant_parameters()["stiffness"] * y[:4])
    assert [plant.unit(name) for name in plant.outputs[:4]] == ["rad", "rad", "m", "rad"]


MOTOR = 'kind = "motor_position"\n'


@pytest.mark.parametrize(
    ("wrong", "anchors", "right"),
    [
        (
            f"{MOTOR}counts = 4096\nbefore_gear = true",
            ("gear_ratio",),
            f"{MOTOR}counts = 4096\nbefore_gear = false",
        ),
        (
            'kind = "link_position"\ncounts = 8\nbefore_gear = true',
            ("link_position",),
            'kind = "link_position"\ncounts = 8',
        ),
        ('kind = "joint_torque"\ncounts = 4096', ("counts",), 'kind = "joint_torque"\nstep = 0.1'),
        (f"{MOTOR}counts = 4096\nstep = 1e-3", ("counts", "step"), f"{MOTOR}step = 1e-3"),
        (MOTOR, ("step", "noise"), f"{MOTOR}noise = 1e-4"),
        (f'{MOTOR}noise = "0.1 N·m"', ("rad", "0.1 N·m"), f'{MOTOR}noise = "0.1 mrad"'),
        (f"{MOTOR}noise = 1\ndelay = -1", ("delay", "greater than 0"), f'{MOTOR}noise = 1\ndelay = "1 ms"'),
        (f"{MOTOR}noise = -1", ("noise", "greater than 0"), f"{MOTOR}noise = 1"),
        ('kind = "encoder"\nnoise = 1e-4', ("encoder", "link_position"), f"{MOTOR}noise = 1e-4"),
        (f"{MOTOR}bits = 12", ("bits", "counts"), f"{MOTOR}counts = 4096"),
        (
            f"{MOTOR}step = 1\n[[joint.sensor]]\n{MOTOR}step = 1",
            ("motor_position_elbow",),
            f"{MOTOR}step = 1",
        ),
    ],
)
def test_a_wrong_sensor_is_refused_and_the_advice_helps(
    wrong: str, anchors: tuple[str, ...], right: str, tmp_path: Path
) -> None:
    with refused_with(InvalidInput, *anchors):
        fh.load_robot(arm(tmp_path, elbow=f"[[joint.sensor]]\n{wrong}"))
    assert fh.load_robot(arm(tmp_path, elbow=f"[[joint.sensor]]\n{right}")).sensors
