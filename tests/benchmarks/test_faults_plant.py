"""The plant of ``make faults``: what it reads of robot files, its dynamics, its integrator, what sticks and stops."""

from __future__ import annotations

import ctypes
import hashlib
import math
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks.faults.links import read_urdf
from benchmarks.faults.robot import Interval, Robot, read_robot, source
from benchmarks.workspace.arm import Arm
from scipy.integrate import solve_ivp

import flexhinf as fh

FAULTS = Path(__file__).resolve().parents[2] / "benchmarks" / "faults"
LIMITS, CATALOGUE = FAULTS.parent / "limits", Path(fh.__file__).parent / "robot" / "catalogue"
FILES = {
    "one": FAULTS / "robots" / "one.toml",
    "two": FAULTS / "robots" / "two.toml",
    "servo": FAULTS / "robots" / "servo.toml",
    "six": FAULTS / "robots" / "six.toml",
    "scara": CATALOGUE / "scara.toml",
    "pallet": LIMITS / "robots" / "pallet.toml",
}
#: What is asked of the plant, by arrays of numbers.
PROBE = """
#include "plant.h"
static plant p;
void begin(const double *q) { plant_complete(&NOMINAL); plant_begin(&p, &NOMINAL, q); }
void move(const double *v, const double *w) { for (int i = 0; i < NOMINAL.n; ++i) { p.v[i] = v[i]; p.w[i] = w[i]; } }
void state(double *x) {
    for (int i = 0; i < NOMINAL.n; ++i) {
        x[i] = p.q[i]; x[NOMINAL.n + i] = p.v[i]; x[2 * NOMINAL.n + i] = p.theta[i]; x[3 * NOMINAL.n + i] = p.w[i];
    }
}
void accelerate(const double *q, const double *v, const double *torque, double *a)
{
    plant_accelerations(&p, q, v, torque, a);
}
void weigh(const double *q, double *torque)
{
    const double none[MOST] = {0.0};
    plant_torques(&p, q, none, none, torque);
}
double energy(void) { return plant_energy(&p); }
void go(const double *u, double period, int refined) { plant_run(&p, u, period, refined); }
void power(int on) { for (int i = 0; i < NOMINAL.n; ++i) { p.powered[i] = on; } }
void brakes(int on) { for (int i = 0; i < NOMINAL.n; ++i) { p.braked[i] = on; } }
static unsigned mixed;
static double random_share(void) { mixed = 1664525u * mixed + 1013904223u; return mixed / 4294967296.0; }
void drawn(double *numbers, int seed)
{
    plant_model one;
    mixed = (unsigned)seed;
    plant_draw(&one, &LOWEST, &HIGHEST, random_share);
    for (int i = 0; i < NOMINAL.n; ++i) { numbers[i] = one.is.stiffness[i]; numbers[NOMINAL.n + i] = one.is.mass[i]; }
    numbers[2 * NOMINAL.n] = one.is.payload;
}
double held(int i) { return NOMINAL.is.brake[i]; }
double command(int i, double torque, double theta, double w) { return plant_command(&NOMINAL, i, torque, theta, w); }
"""


class Probe:
    """The plant of a robot, as a library."""

    def __init__(self, robot: Robot, folder: Path) -> None:
        text = source(robot).replace('#include "plant.h"\n', "") + PROBE
        name = hashlib.sha256(text.encode()).hexdigest()[:10]
        (folder / f"{name}.c").write_text(f'#include "plant.h"\n#include <math.h>\n{text}', encoding="utf-8")
        command = ["gcc", "-std=c99", "-O2", "-shared", "-fPIC", f"-I{FAULTS}", str(folder / f"{name}.c")]
        command += [str(FAULTS / "plant.c"), "-lm", "-o", str(folder / f"{name}.so")]
        subprocess.run(command, check=True)
        self.library = ctypes.CDLL(str(folder / f"{name}.so"))
        for function in ("energy", "held", "command"):
            getattr(self.library, function).restype = ctypes.c_double
        self.n = len(robot.joints)

    def call(self, name: str, *arguments: Any, out: int = 0) -> np.ndarray:
        """A function with arrays, and as many numbers as it writes."""
        found = np.zeros(out)
        arrays = [
            np.ascontiguousarray(x, dtype=float) for x in arguments if isinstance(x, (np.ndarray, list))
        ]
        plain = [
            ctypes.c_double(x) if isinstance(x, float) else x
            for x in arguments
            if isinstance(x, (float, int))
        ]
        pointers = [ctypes.c_void_p(x.ctypes.data) for x in (*arrays, *([found] if out else []))]
        getattr(self.library, name)(*pointers, *plain)
        return found

    def command(self, joint: int, torque: float, theta: float) -> float:
        """What makes a drive hold a torque at rest."""
        return self.library.command(joint, *map(ctypes.c_double, (torque, theta, 0.0)))

    @property
    def state(self) -> np.ndarray:
        """q, v, θ, w, (4, n)."""
        return self.call("state", out=4 * self.n).reshape(4, self.n)


@pytest.fixture(scope="module")
def probe(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Robot], Probe]:
    folder = tmp_path_factory.mktemp("plants")
    return lambda robot: Probe(robot, folder)


def without(robot: Robot, *fields: str) -> Robot:
    """The robot in which these numbers are zero."""
    zero = {name: [[Interval.of(0.0)] for _ in robot.joints] for name in fields}
    return replace(robot, fields={**robot.fields, **zero})


@pytest.mark.oracle
@pytest.mark.parametrize("name", FILES)
def test_the_links_accelerate_as_pinocchios(name: str, probe: Callable[[Robot], Probe]) -> None:
    """And both readers of the file find the same links, springs, motors and limits."""
    robot = read_robot(FILES[name])
    plant, rng = probe(robot), np.random.default_rng(1)
    arm = Arm.of(fh.load_robot(FILES[name]) if name != "scara" else fh.load_robot("scara"))
    plant.call("begin", arm.home)
    for _ in range(20):
        q = rng.uniform(np.maximum(arm.lower, -3.0), np.minimum(arm.upper, 3.0))
        v, torque = 3.0 * rng.standard_normal(arm.n), 20.0 * rng.standard_normal(arm.n)
        mine = plant.call("accelerate", q, v, torque, out=arm.n)
        assert mine == pytest.approx(arm.acceleration(q, v, torque), rel=1e-8, abs=1e-8)
        assert plant.call("weigh", q, out=arm.n) == pytest.approx(arm.gravity(q), rel=1e-9, abs=1e-9)
    of_motors = robot.nominal("back_emf") * robot.nominal("torque_constant")
    of_motors = of_motors / robot.nominal("resistance")
    for mine, theirs in (
        ("stiffness", arm.stiffness), ("damping", arm.spring_damping), ("motor_inertia", arm.rotor),
        ("coulomb", arm.dry), ("lower", arm.lower), ("upper", arm.upper), ("effort_limit", arm.limit),
        ("speed_limit", arm.speed),
    ):  # fmt: skip
        assert robot.nominal(mine) == pytest.approx(theirs), mine
    assert robot.nominal("friction") + of_motors == pytest.approx(arm.viscous)


@pytest.mark.parametrize("name", ["two", "six"])
def test_tolerances_are_those_of_the_robot(name: str, probe: Callable[[Robot], Probe]) -> None:
    """Lowest and highest of each number that flexhinf varies too; robots are drawn between them."""
    robot, theirs = read_robot(FILES[name]), fh.load_robot(FILES[name])
    intervals = {parameter.name: parameter.interval for parameter in theirs.parameters}
    for joint, label in enumerate(robot.joints):
        for mine, quantity in (
            ("stiffness", "stiffness"),
            ("friction", "friction"),
            ("coulomb", "coulomb_friction"),
        ):
            number = robot.fields[mine][joint][0]
            assert (number.low, number.high) == pytest.approx(intervals[f"{quantity}_{label}"]), (mine, label)
        mass = robot.fields["mass"][joint][0]
        assert (mass.low, mass.high) == pytest.approx(intervals[f"mass_{label}"])
    plant = probe(robot)
    rows = np.array([plant.call("drawn", seed, out=2 * plant.n + 1) for seed in range(0, 4000, 10)])
    fields = [robot.fields[name] for name in ("stiffness", "mass", "payload")]
    numbers = [row[0] for field in fields for row in field]
    low, high = (np.array([getattr(number, end) for number in numbers]) for end in ("low", "high"))
    share = (rows - low) / (high - low)
    assert np.all((share >= 0.0) & (share < 1.0))
    assert share.mean(axis=0) == pytest.approx(0.5, abs=0.1)  # uniform ones: 0.5 ± 0.014
    payload = robot.fields["payload"][0][0]
    assert (payload.low, payload.high) == pytest.approx(intervals[f"payload_mass_{robot.joints[-1]}"])


URDF = """<robot name="arm"><link name="base"/>
<link name="upper"><inertial><origin xyz="0.1 0.02 0.2" rpy="0.3 -0.2 0.5"/><mass value="4"/>
<inertia ixx="0.05" iyy="0.04" izz="0.02" ixy="0.003" ixz="-0.002" iyz="0.001"/></inertial></link>
<link name="box"><inertial><origin xyz="0 0 0.05"/><mass value="0.7"/>
<inertia ixx="0.002" iyy="0.003" izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="lower"><inertial><origin xyz="0 0.1 0.1"/><mass value="2"/>
<inertia ixx="0.03" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="turn" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 0.3" rpy="0.1 0.2 0"/>
<axis xyz="0 1 1"/><limit lower="-2" upper="2" effort="90" velocity="2"/></joint>
<joint name="weld" type="fixed"><parent link="upper"/><child link="box"/><origin xyz="0.1 0 0.2" rpy="0 0.7 0"/></joint>
<joint name="slide" type="prismatic"><parent link="box"/><child link="lower"/><origin xyz="0 0.1 0" rpy="0.4 0 0.2"/>
<axis xyz="1 0 0"/><limit lower="-0.3" upper="0.3" effort="300" velocity="0.5"/></joint></robot>"""
SPRINGS = """urdf = "arm.urdf"
[[joint]]
name = "turn"
[joint.spring]
stiffness = 5000
[joint.motor]
motor_inertia = 0.4
friction = 1.0
[[joint]]
name = "slide"
[joint.spring]
stiffness = 50000
[joint.motor]
motor_inertia = 12.0
friction = 40.0
"""


@pytest.mark.oracle
def test_a_urdf_has_the_links_that_pinocchio_finds(tmp_path: Path, probe: Callable[[Robot], Probe]) -> None:
    """With a link that is welded to another, turned inertias, and a joint that slides."""
    (tmp_path / "arm.urdf").write_text(URDF, encoding="utf-8")
    (tmp_path / "arm.toml").write_text(SPRINGS, encoding="utf-8")
    robot, rng = read_robot(tmp_path / "arm.toml"), np.random.default_rng(2)
    arm, plant = Arm.of(fh.load_robot(tmp_path / "arm.toml")), probe(robot)
    plant.call("begin", [0.0, 0.0])
    for _ in range(10):
        q, v, torque = rng.standard_normal((3, 2))
        assert plant.call("accelerate", q, v, torque, out=2) == pytest.approx(
            arm.acceleration(q, v, torque), rel=1e-9
        )
    with pytest.raises(ValueError, match="slide"):
        read_urdf(tmp_path / "arm.urdf", ["slide", "turn"])


def test_what_the_plant_has_no_part_for_is_refused(tmp_path: Path) -> None:
    """By the name of its key."""
    text = (
        FILES["one"]
        .read_text(encoding="utf-8")
        .replace("speed_limit = 3.0", 'speed_limit = 3.0\ngear = "CSG-25-100"')
    )
    (tmp_path / "arm.toml").write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match="gear"):
        read_robot(tmp_path / "arm.toml")


# The integrator -------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", ["two", "six"])
def test_energy_is_kept_where_nothing_takes_it(name: str, probe: Callable[[Robot], Probe]) -> None:
    """A second of free fall on undamped springs, drives off."""
    robot = without(read_robot(FILES[name]), "damping", "friction", "coulomb", "stiction")
    far = {
        end: [[Interval.of(sign * math.inf)] for _ in robot.joints]
        for end, sign in (("lower", -1.0), ("upper", 1.0))
    }
    plant = probe(replace(robot, fields={**robot.fields, **far}))
    plant.call("begin", np.array(robot.home))
    plant.call("power", 0)
    begin, fastest = plant.library.energy(), 0.0
    for _ in range(1000):
        plant.call("go", np.zeros(plant.n), 1e-3, 1)
        fastest = max(fastest, float(np.abs(plant.state[1]).max()))
        assert plant.library.energy() == pytest.approx(begin, abs=2e-3 * abs(begin))
    assert fastest > 2.0  # it fell


@pytest.mark.oracle
@pytest.mark.parametrize("name", ["one", "two", "servo", "six"])
def test_motion_is_scipys_solution(name: str, probe: Callable[[Robot], Probe]) -> None:
    """A tenth of a second with drives on, without dry friction; links by Pinocchio, the coil's current as a state."""
    robot = without(read_robot(FILES[name]), "coulomb", "stiction")
    arm, plant, zero = Arm.of(fh.load_robot(FILES[name])), probe(robot), np.zeros(len(robot.joints))
    plant.call("begin", arm.home)
    held = arm.gravity(arm.home)
    rng = np.random.default_rng(3)
    w0 = 0.1 * rng.standard_normal(arm.n)
    plant.call("move", zero, w0)
    u = np.array([plant.command(i, float(held[i]), float(plant.state[2][i])) for i in range(arm.n)])
    u = u + 0.2 * arm.limit if robot.drive != "position" else u + 0.004
    number = robot.nominal
    coil = number("inductance") / number("resistance")

    def rate(_: float, x: np.ndarray) -> np.ndarray:
        q, v, theta, w, current = x.reshape(5, arm.n)
        spring = number("stiffness") * (theta - q) + number("damping") * (w - v)
        torque, change = number("torque_constant") * u, zero
        if robot.drive == "voltage":
            torque = number("torque_constant") * current
            change = ((u - number("back_emf") * w) / number("resistance") - current) / coil
        if robot.drive == "position":
            torque = number("drive_stiffness") * (u - theta) - number("drive_damping") * w
        motor = (torque - number("friction") * w - spring) / number("motor_inertia")
        return np.concatenate([v, arm.acceleration(q, v, spring), w, motor, change])

    start = np.concatenate([arm.home, zero, plant.state[2], w0, held / number("torque_constant")])
    for _ in range(100):
        plant.call("go", u, 1e-3, 1)
    true = solve_ivp(rate, (0.0, 0.1), start, rtol=1e-9, atol=1e-11).y.reshape(5, arm.n, -1)[:4]
    moved = np.abs(true - true[:, :, :1]).max(axis=(1, 2))
    assert moved[0] > 1e-3
    assert np.all(np.abs(plant.state - true[:, :, -1]).max(axis=1) < 0.01 * moved)


@pytest.mark.parametrize("name", ["one", "two", "servo", "six"])
def test_smaller_steps_change_little(name: str, probe: Callable[[Robot], Probe]) -> None:
    """An arm that falls into its end stops with everything that is not smooth: half the steps, half the error."""
    robot = read_robot(FILES[name])
    raised = np.array(robot.home) + 1.0
    near = {end: [[Interval.of(x + room)] for x in raised] for end, room in (("lower", -0.4), ("upper", 0.4))}
    plant = probe(replace(robot, fields={**robot.fields, **near}))
    found = list[np.ndarray]()
    for refined in (1, 2, 16):
        plant.call("begin", raised)
        plant.call("power", 0)
        path = list[np.ndarray]()
        for _ in range(500):
            plant.call("go", np.zeros(plant.n), 1e-3, refined)
            path.append(plant.state[0])
        found.append(np.array(path))
    coarse, fine = (float(np.abs(path - found[2]).max()) for path in found[:2])
    assert float(np.abs(found[2] - raised).max()) > 0.3  # it fell, most of them into a stop
    assert coarse < 2e-3
    assert fine < max(0.75 * coarse, 5e-4)


def test_dry_friction_sticks(probe: Callable[[Robot], Probe]) -> None:
    """A motor that its drive pushes by less than the friction does not move at all; brakes hold the weight."""
    plant = probe(read_robot(FILES["two"]))
    plant.call("begin", [0.0, 0.0])  # hanging: no weight
    for _ in range(200):
        plant.call("go", [0.19, 0.19], 1e-3, 1)  # 0.2 V are 1 N·m at the shoulder, 0.5 N·m at the elbow
    assert np.all(plant.state[2:] == 0.0)
    plant.call("go", [0.3, 0.3], 0.1, 1)
    assert np.all(plant.state[3] > 1e-3)
    plant.call("begin", [1.5, 0.0])
    plant.call("power", 0)
    plant.call("brakes", 1)
    for _ in range(300):
        plant.call("go", [0.0, 0.0], 1e-3, 1)
    assert np.all(plant.state[3] == 0.0)
    weight = plant.call("weigh", [1.5708, 0.0], out=2)
    assert plant.library.held(0) == pytest.approx(
        2.0 * abs(weight[0]), rel=0.02
    )  # a grid of poses finds the largest
