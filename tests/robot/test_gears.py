"""Gears as catalogues state them: the stiffness curve in the plant, at rest, in inverse dynamics and in MuJoCo."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from tests.builders import joint_text
from tests.refusals import refused_with, unnamed

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.plant import Parameters
from flexhinf.robot import MuJoCoPlant, Parameter
from flexhinf.robot.gears import curve_softness, curve_torque, curve_twist
from flexhinf.robot.layout import Layout
from flexhinf.robot.parts import RobotFileWarning

#: CSG-25-50: K₁, K₂, K₃ (N·m/rad), T₁, T₂ (N·m) of Harmonic Drive's catalogue.
CURVE = {
    "first_stiffness": 2.5e4, "second_stiffness": 3.4e4, "third_stiffness": 4.4e4, "first_torque": 14.0,
    "second_torque": 48.0,
}  # fmt: skip

ARM = """
name = "geared"
[[joint]]
name = "shoulder"
link = {{ mass = 6.0, length = 0.5, axis_inertia = 2.0 }}
spring = {{ {spring} }}
motor = {{ motor_inertia = 1.5, {motor} }}
"""


def arm(folder: Path, motor: str = "friction = 5.0", /, **spring: object) -> fh.Robot:
    text = ", ".join(f"{name} = {value}" for name, value in spring.items())
    (folder / "geared.toml").write_text(ARM.format(spring=text, motor=motor), encoding="utf-8")
    return fh.load_robot(folder / "geared.toml")


def planar(**curve: float) -> fh.Robot:
    """The planar arm with a curve in its shoulder alone: slopes of 0.7, 1 and 1.3 of its stiffness."""
    robot = fh.load_robot("planar-two-link")
    k = robot.nominal["stiffness_shoulder"]
    numbers = {
        "first_stiffness": 0.7 * k, "second_stiffness": k, "third_stiffness": 1.3 * k, "first_torque": 5.0,
        "second_torque": 20.0, **curve,
    }  # fmt: skip
    return robot.with_parameters(*(Parameter(f"{name}_shoulder", value) for name, value in numbers.items()))


@pytest.mark.oracle
def test_the_curve_is_that_of_the_catalogue():
    """Its twists at T₁ and T₂ are printed beside the slopes: 5.5e-4 rad, and for a ratio of 50 about 16e-4 rad."""
    p = Parameters(CURVE)
    torque = np.array([-60.0, -48.0, -20.0, -14.0, -1.0, 0.0, 3.0, 14.0, 30.0, 48.0, 100.0])
    slopes = np.array([*CURVE.values()][:3])
    fine = np.linspace(0.0, 100.0, 100001)  # ∫ dT/K(T), with the middle of each piece
    middle = 0.5 * (fine[1:] + fine[:-1])
    area = np.concatenate([[0.0], np.cumsum(1e-3 / slopes[(middle > 14.0).astype(int) + (middle > 48.0)])])
    np.testing.assert_allclose(
        curve_twist(torque, p), np.sign(torque) * np.interp(abs(torque), fine, area), rtol=1e-9
    )
    np.testing.assert_allclose(curve_torque(curve_twist(torque, p), p), torque, rtol=1e-14, atol=1e-12)
    assert curve_twist(np.array([14.0]), p)[0] == pytest.approx(5.5e-4, abs=0.5e-4)
    inside = np.array([-60.0, -20.0, 3.0, 30.0, 100.0])
    slope = (curve_twist(inside + 1e-4, p) - curve_twist(inside - 1e-4, p)) / 2e-4
    np.testing.assert_allclose(curve_softness(inside, p), slope, rtol=1e-9)


def test_a_file_states_the_curve_and_the_model_has_its_secant(tmp_path: Path):
    robot = arm(tmp_path, **CURVE)
    assert robot.nominal["stiffness"] == pytest.approx(48.0 / (14.0 / 2.5e4 + 34.0 / 3.4e4))
    assert robot["stiffness"].interval == (2.5e4, 4.4e4)
    robot.with_values({"stiffness": 3.1e4}).save(tmp_path / "identified.toml")
    assert fh.load_robot(tmp_path / "identified.toml").nominal == robot.nominal | {"stiffness": 3.1e4}
    assert arm(tmp_path, stiffness=3e4, **CURVE).nominal["stiffness"] == 3e4
    one = arm(tmp_path, first_stiffness=2.5e4, second_stiffness=3.4e4, first_torque=14.0)
    assert one.nominal["stiffness"] == 3.4e4
    x, u = one.operating_point([1.5], "stiffness_curve")
    assert x[2] - x[0] == pytest.approx(14.0 / 2.5e4 + (u[0] - 14.0) / 3.4e4)


@pytest.mark.parametrize(
    ("changes", "parts"),
    [
        ({"second_stiffness": None}, ("in part", "second_stiffness")),
        ({"second_torque": None}, ("in part", "second_torque")),
        ({"second_torque": 12.0}, ("in order", "12")),
        ({"first_torque": "{ value = 40.0, tolerance = 30 }"}, ("in order", "52")),
        ({"first_torque": 0.0}, ("in order",)),
        ({"spring_hardening": 5.0}, ("twice", "spring_hardening")),
        ({"third_stiffness": -1.0}, ("stiffness curve", "-1.0")),
    ],
)
def test_curves_that_are_none_are_refused(tmp_path: Path, changes, parts):
    stated = {name: value for name, value in (CURVE | changes).items() if value is not None}
    with refused_with(InvalidInput, *parts):
        arm(tmp_path, **stated)


def test_names_of_catalogues_are_known(tmp_path: Path):
    with pytest.raises(InvalidInput, match="K1") as caught:
        arm(tmp_path, **(CURVE | {"K1": 2.5e4}))
    assert "first_stiffness" in caught.value.advice


@pytest.mark.oracle
def test_the_plant_moves_as_scipy_says(tmp_path: Path):
    """A swing through both corners, against SciPy's Radau on the equations as the catalogue has them."""
    from scipy.integrate import solve_ivp

    robot = arm(tmp_path, **CURVE)
    plant = robot.plant(extras="stiffness_curve")
    start = np.array([0.0, 0.0, 3e-3, 0.0])

    def torque(twist: float) -> float:
        size, (k1, k2, k3, t1, t2) = abs(twist), CURVE.values()
        first, second = t1 / k1, t1 / k1 + (t2 - t1) / k2
        if size < first:
            return k1 * twist
        return np.sign(twist) * (t1 + k2 * (size - first) if size < second else t2 + k3 * (size - second))

    def rates(t: float, x: np.ndarray) -> list[float]:
        spring = torque(x[2] - x[0])
        return [x[1], (spring - 6.0 * 9.81 * 0.5 * np.sin(x[0])) / 2.0, x[3], (-spring - 5.0 * x[3]) / 1.5]

    solve = partial(solve_ivp, rtol=1e-7, atol=1e-10, max_step=2e-3)
    expected = solve(rates, (0.0, 0.02), start, method="Radau").y[:, -1]
    found = solve(lambda t, x: plant.derivative(x), (0.0, 0.02), start, method="DOP853").y[:, -1]
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-6)
    plain = solve(lambda t, x: robot.plant().derivative(x), (0.0, 0.02), start).y[:, -1]
    assert np.abs(plain - expected).max() > 1e-3  # the curve matters


def test_a_robot_rests_on_its_curve_and_other_joints_keep_their_springs():
    robot = planar()
    on = ("joint_damping", "stiffness_curve", "backlash", "coulomb_friction")
    robot = robot.with_parameters(Parameter("backlash_elbow", 1e-3), Parameter("damping_shoulder", 1.0))
    for pose in ([0.1, -0.1], [1.2, 0.4]):
        x, u = robot.operating_point(pose, on)
        assert np.abs(robot.plant(extras=on).derivative(x, u)).max() < 1e-9
        plain, _ = robot.operating_point(pose)
        assert x[5] - plain[5] == pytest.approx(5e-4 * np.sign(plain[5] - plain[1]))
        assert abs(x[4] - plain[4]) > 1e-5
    slope = robot.plant(extras="stiffness_curve").linearise(
        *robot.operating_point([0.0, 0.0], "stiffness_curve")
    )[0]
    model = robot.plant().linearise(*robot.operating_point([0.0, 0.0]))[0]
    assert slope[6, 4] / model[6, 4] in (pytest.approx(0.7), pytest.approx(1.0), pytest.approx(1.3))


@pytest.mark.oracle
def test_friction_of_the_load_holds_a_loaded_gear_and_lets_an_empty_one_go(tmp_path: Path):
    """F = F_c + μ |τ| in closed form: a motor that turns stops after ½ J v²/F, one with a load above it is pushed."""
    from flexhinf.robot.elastic import Sticking

    motor = "friction = 0.0, coulomb_friction = 2.0, load_friction = 0.1"
    robot = arm(tmp_path, motor, stiffness=1e6)
    on = ("coulomb_friction", "load_friction")
    sticking = Sticking(Layout(1), on, ())
    p = Parameters(robot.plant_parameters())
    for load in (0.0, 30.0, -50.0):
        level = 2.0 + 0.1 * abs(load)
        for speed in (1e-4, 0.3, -0.3):
            x = np.array([0.0, 0.0, load / 1e6, speed])
            lost = np.clip(speed, -1e-3 * level / 1.5, 1e-3 * level / 1.5)
            np.testing.assert_allclose(sticking(x, 1e-3, p)[3], speed - lost, atol=1e-12)
    assert robot.plant(extras=on, sticking=True).arrest == sticking
    smooth = robot.plant(extras=on).derivative([0.0, 0.0, 3e-5, 0.5]) - robot.plant().derivative(
        [0.0, 0.0, 3e-5, 0.5]
    )
    np.testing.assert_allclose(smooth, [0.0, 0.0, 0.0, -(2.0 + 3.0) / 1.5], atol=1e-9)
    with refused_with(InvalidInput, "load", "load_friction"):
        text = (tmp_path / "geared.toml").read_text(encoding="utf-8")
        (tmp_path / "rigid.toml").write_text(
            text.replace("spring = { stiffness = 1000000.0 }", "rigid = true")
        )
        fh.load_robot(tmp_path / "rigid.toml")


@pytest.mark.oracle
def test_the_inverse_dynamics_use_the_curve():
    """Along a motion that stays off the corners, the plant with the curve has the rates of the motion."""
    robot = planar()
    t, h = 0.4, 1e-4

    def motion(time: float) -> list[np.ndarray]:
        size, rate = np.array([0.3, 0.2]), np.array([2.0, 3.0])
        at, mid = rate * time, np.array([1.0, 0.3])
        return [
            mid + size * np.sin(at), size * rate * np.cos(at), -size * rate**2 * np.sin(at),
            -size * rate**3 * np.cos(at), size * rate**4 * np.sin(at),
        ]  # fmt: skip

    def inverse(time: float) -> tuple[np.ndarray, np.ndarray]:
        q, dq, ddq, dddq, ddddq = motion(time)
        return robot.inverse_dynamics(q, dq, ddq, dddq, ddddq, extras="stiffness_curve")

    x, u = inverse(t)
    around = [inverse(t + dt)[0] for dt in (-h, h)]
    rates = (around[1] - around[0]) / (2.0 * h)
    np.testing.assert_allclose(
        robot.plant(extras="stiffness_curve").derivative(x, u), rates, rtol=1e-5, atol=1e-5
    )
    q, dq, ddq, dddq, ddddq = motion(t)
    assert np.abs(robot.inverse_dynamics(q, dq, ddq, dddq, ddddq)[0] - x).max() > 1e-4
    rows = [np.array([each, each]) for each in motion(t)]
    stacked = robot.inverse_dynamics(rows[0], rows[1], rows[2], rows[3], rows[4], extras="stiffness_curve")
    np.testing.assert_array_equal(stacked[0][1], x)


@pytest.mark.oracle
@pytest.mark.parametrize("third", [1.3, 0.8])
def test_mujoco_has_the_curve_and_the_backlash(third):
    pytest.importorskip("mujoco")
    robot = planar()
    k = robot.nominal["stiffness_shoulder"]
    robot = planar(third_stiffness=third * k).with_parameters(Parameter("backlash_shoulder", 2e-3))
    on = ("stiffness_curve", "backlash", "joint_damping")
    plant, box = robot.plant(extras=on), MuJoCoPlant(robot, None, step=1e-4, extras=on)
    rng = np.random.default_rng(3)
    for size in (0.5, 3.0, 30.0):  # N·m in the shoulder's spring: before, between and after the corners
        x, u = robot.operating_point()
        x[4] = x[0] + size / k + 1e-3 * (size > 0.5)
        x[[1, 2, 3, 6, 7]] += 0.1 * rng.normal(size=5)
        box.reset(x)
        box.step(u, (), 1e-5)
        np.testing.assert_allclose((box.state() - x) / 1e-5, plant.derivative(x, u), rtol=2e-3, atol=2e-2)


def test_of_a_campaign_the_slopes_of_the_curve_vary_and_not_the_stiffness(tmp_path: Path):
    from flexhinf.robot.elastic import inactive_parameters

    stated = CURVE | {"first_stiffness": "{ value = 25000.0, tolerance = 20 }"}
    robot = arm(tmp_path, **stated)
    assert {p.name for p in robot.uncertain} == {"stiffness", "first_stiffness"}
    on, off = (
        inactive_parameters(extras, robot.joint_names, robot.nominal) for extras in (("stiffness_curve",), ())
    )
    assert "stiffness" in on
    assert "first_stiffness" not in on
    assert "first_stiffness" in off
    assert "stiffness" not in off
    rows = robot.varied({"first_stiffness": np.array([2.0e4, 3.0e4])})
    x = robot.starting_states(np.full((2, 1), 1.5), "stiffness_curve", rows)
    for row, value in zip(x, (2.0e4, 3.0e4)):
        one = robot.varied({"first_stiffness": value})
        assert row.tolist() == robot.operating_point([1.5], "stiffness_curve", one)[0].tolist()


# The teeth -------------------------------------------------------------------------------------------
TOOTHED = "friction = 0.0, gear_ratio = 100.0"


@pytest.mark.oracle
def test_the_error_of_the_teeth_takes_no_work(tmp_path: Path):
    """Energy of link, rotor, spring and weight is kept along a swing through a dozen teeth, by SciPy's integrator."""
    from scipy.integrate import solve_ivp

    robot = arm(tmp_path, TOOTHED, stiffness=4e3, kinematic_error=5e-4, kinematic_error_phase=0.3)
    plant = robot.plant(extras="kinematic_error")

    def energy(x: np.ndarray) -> float:
        twist = x[2] + 5e-4 * np.sin(200.0 * x[2] + 0.3) - x[0]
        weight = 6.0 * 9.81 * 0.5 * (1.0 - np.cos(x[0]))
        return 0.5 * (2.0 * x[1] ** 2 + 1.5 * x[3] ** 2 + 4e3 * twist**2) + weight

    start = np.array([0.0, 5.0, 0.0, 5.0])
    run = solve_ivp(
        lambda t, x: plant.derivative(x), (0.0, 0.04), start, method="DOP853", rtol=1e-9, atol=1e-12
    )
    assert 200.0 * run.y[2, -1] > 6.0 * np.pi  # three teeth of each lobe and more
    energies = [energy(x) for x in run.y.T]
    np.testing.assert_allclose(energies, energies[0], rtol=1e-7)
    assert np.ptp([energy(x) - 4e3 * 5e-4 * np.sin(200.0 * x[2] + 0.3) ** 2 for x in run.y.T]) > 1.0


@pytest.mark.oracle
def test_motors_and_links_see_what_they_are_fixed_to(tmp_path: Path):
    """At rest the link is A sin(2 N θ + φ) from the motor, but for its weight; torque sensors feel the real twist."""
    robot = arm(
        tmp_path, f"{TOOTHED}, torque_ripple = 2.0, torque_ripple_phase = 0.5", kinematic_error=2e-3, **CURVE
    )
    on = ("stiffness_curve", "kinematic_error", "torque_ripple")
    p = Parameters(CURVE)
    measured = ("motor_position", "link_position", "deflection", "joint_torque")
    plant = robot.plant(measured, extras=on)
    for pose in np.linspace(-1.5, 1.5, 13):
        x, u = robot.operating_point([pose], on)
        weight = 6.0 * 9.81 * 0.5 * np.sin(pose)
        error = 2e-3 * np.sin(200.0 * x[2])
        assert x[2] + error - pose == pytest.approx(curve_twist(np.array([weight]), p)[0], abs=1e-13)
        assert u[0] == pytest.approx(
            weight * (1.0 + 0.4 * np.cos(200.0 * x[2])) + 2.0 * np.sin(200.0 * x[2] + 0.5), abs=1e-8
        )
        assert np.abs(plant.derivative(x, u)).max() < 1e-8
        np.testing.assert_allclose(plant.output_at(x, u)[0], [x[2], pose, x[2] - pose, weight], atol=1e-8)


@pytest.mark.oracle
def test_the_ripple_is_a_torque_on_the_motor_alone(tmp_path: Path):
    robot = arm(tmp_path, f"{TOOTHED}, torque_ripple = 3.0", stiffness=1e4)
    x = np.array([0.2, 0.5, 0.203, -0.4])
    change = robot.plant(extras="torque_ripple").derivative(x) - robot.plant().derivative(x)
    np.testing.assert_allclose(change, [0.0, 0.0, 0.0, -3.0 * np.sin(200.0 * 0.203) / 1.5], atol=1e-10)


@pytest.mark.parametrize(
    ("motor", "spring", "parts"),
    [
        ("friction = 0.0", {"kinematic_error": 1e-4}, ("ratio", "gear_ratio")),
        ("torque_ripple = 1.0", {}, ("ratio", "torque_ripple")),
        (TOOTHED, {"kinematic_error": 6e-3}, ("back", "0.005")),
        (TOOTHED, {"kinematic_error": "{ value = 4e-3, tolerance = 50 }"}, ("back", 0.005, 0.006)),
        (TOOTHED, {"kinematic_error_phase": 1.0}, ("phase", "kinematic_error")),
    ],
)
def test_teeth_that_are_none_are_refused(tmp_path: Path, motor: str, spring: dict[str, object], parts):
    with refused_with(InvalidInput, *parts):
        arm(tmp_path, motor, stiffness=1e4, **spring)


def test_rigid_joints_ripple_and_other_joints_have_no_error():
    robot = fh.load_robot("planar-two-link")
    robot = robot.with_rigid("elbow").with_parameters(
        Parameter("torque_ripple_elbow", 1.0), Parameter("kinematic_error_shoulder", 1e-4)
    )
    on = ("kinematic_error", "torque_ripple")
    x, u = robot.operating_point([0.7, 0.4], on)
    assert np.abs(robot.plant(extras=on).derivative(x, u)).max() < 1e-8
    assert np.abs(robot.plant().derivative(x, u)).max() > 1e-2
    with refused_with(InvalidInput, "kinematic_error", "inverse dynamics"):
        robot.inverse_dynamics([0.7, 0.4], extras="kinematic_error")


def test_a_file_that_is_saved_has_the_robots_numbers_whatever_its_curve(tmp_path: Path):
    for spring in (CURVE, {"damping": 2.0}):
        robot = two_joints(tmp_path, **spring)
        softer = robot.with_values({"first_stiffness_a": 2.4e4})
        softer.save(tmp_path / "softer.toml")
        assert fh.load_robot(tmp_path / "softer.toml").nominal == softer.nominal
        rigid = robot.with_rigid("a")
        rigid.save(tmp_path / "rigid.toml")
        read = fh.load_robot(tmp_path / "rigid.toml")
        assert (read.rigid, read.nominal) == (("a",), rigid.nominal)


def test_values_do_not_put_the_corners_of_a_curve_in_another_order():
    with refused_with(InvalidInput, "order", "first_torque", 21.0, 20.0):
        planar().with_values({"first_torque_shoulder": 21.0})


def test_a_published_gear_does_not_slide(tmp_path: Path):
    with refused_with(InvalidInput, "slides", "gear", "N/m"):
        two_joints(tmp_path, 'kind = "prismatic"')


def test_doubtful_gears_are_asked_about(tmp_path: Path):
    with pytest.warns(RobotFileWarning, match="gear ratio") as caught:
        two_joints(tmp_path, "", "gear_ratio = 100.0")
    assert unnamed(str(caught[0].message), 50.0, 100.0) == []
    with pytest.warns(RobotFileWarning, match="stiffness") as caught:
        two_joints(tmp_path, stiffness=1e4)
    assert unnamed(str(caught[0].message), 2.5e4, 4.4e4, 1e4) == []


def two_joints(
    folder: Path, more: str = "", motor: str = "load_friction = 0.1", /, **spring: float
) -> fh.Robot:
    """Two joints, of which the first has a published gear and no other number of a spring unless stated."""
    gear = f'gear = "CSG-25-50"\n{more}'
    own = "\n".join(f"{name} = {value}" for name, value in spring.items())
    first = joint_text("a", axis=[0, 1, 0], spring=own, motor=f"rotor_inertia = 1e-4\n{motor}")
    second = joint_text("b", axis=[0, 1, 0], xyz=[0.4, 0.0, 0.0])
    text = first.replace('name = "a"', f'name = "a"\n{gear}') + second
    (folder / "two.toml").write_text(text, encoding="utf-8")
    return fh.load_robot(folder / "two.toml")
