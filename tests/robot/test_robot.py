import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest
from tests.refusals import refused_with

from flexhinf.designs.deployed_run import RobotSamples
from flexhinf.errors import InvalidInput
from flexhinf.plant import Penalty
from flexhinf.plant.instruments import SENSORS
from flexhinf.robot import Parameter, Robot, load_robot, paper_arm
from flexhinf.robot.elastic import DRY
from flexhinf.robot.parameters import parameter_units
from flexhinf.robot.signals import expanded


def test_draws_stay_in_their_intervals_and_fill_them():
    arm = paper_arm()
    rng = np.random.default_rng(3)
    draws = [arm.draw(rng) for _ in range(2000)]
    for p in arm.parameters:
        values = np.array([draw[p.name] for draw in draws])
        low, high = p.interval
        assert np.all((low <= values) & (values <= high))
        assert values.std() == pytest.approx((high - low) / np.sqrt(12.0), rel=0.05)


def test_the_same_generator_draws_the_same():
    assert paper_arm().draw(np.random.default_rng(5)) == paper_arm().draw(np.random.default_rng(5))


def test_corners_by_name_and_in_order():
    arm = paper_arm()
    assert arm.corner({"stiffness": 1.0})["stiffness"] == pytest.approx(112.0)
    assert arm.corner({"stiffness": 1.0})["mass"] == 1.0
    low = arm.corner([-1.0] * len(arm.uncertain))
    assert low == pytest.approx({p.name: p.interval[0] for p in arm.parameters})


def test_dry_friction_without_a_tolerance_varies_with_the_viscous_one():
    """In corners, in draws and in samples of a campaign; with one of its own it goes its own way."""
    arm = load_robot("planar-two-link").with_parameters(
        Parameter("coulomb_friction_shoulder", 2.0), Parameter("static_friction_shoulder", 3.0)
    )
    assert arm.dry_by_viscous == {
        "coulomb_friction_shoulder": "friction_shoulder", "static_friction_shoulder": "friction_shoulder",
    }  # fmt: skip
    nominal, upper = arm.plant_parameters(), arm.corner({"friction_shoulder": 1.0, "friction_elbow": 1.0})
    sampled = RobotSamples(arm, np.array(arm.home), DRY[:2])({"friction_shoulder": 1.05}).parameters
    drawn = arm.draw(np.random.default_rng(1))
    for kind in ("coulomb_friction", "static_friction"):
        assert upper[kind] == pytest.approx(nominal[kind] * [1.15, 1.0])
        for values in (sampled, drawn):
            scale = np.divide(values["friction"], nominal["friction"])[0]
            assert values[kind][0] == pytest.approx(nominal[kind][0] * scale)
            assert scale != 1.0


@pytest.mark.parametrize("signs", [[1.0], {"stifness": 1.0}, {"stiffness": 1.5}, {"stiffness": np.nan}])
def test_bad_corners_are_refused(signs):
    with pytest.raises(InvalidInput):
        paper_arm().corner(signs)


def test_with_values_makes_another_robot():
    arm = paper_arm()
    stiff = arm.with_values({"stiffness": 200.0})
    assert stiff.nominal["stiffness"] == 200.0
    assert stiff["stiffness"].tolerance == 12.0
    assert arm.nominal["stiffness"] == 100.0
    with refused_with(InvalidInput, "'paper'", "'stifness'"):
        arm.with_values({"stifness": 1.0})
    with refused_with(InvalidInput, "'stiffness'", "finite", "nan"):
        arm.with_values({"stiffness": np.nan})


def test_a_robot_has_the_parameters_of_its_model_once():
    arm = paper_arm()
    with pytest.raises(InvalidInput, match="friction"):
        Robot("short", [p for p in arm.parameters if p.name != "friction"], arm.penalty)
    with refused_with(InvalidInput, "'paper'", "once", "'damping', 'mass']"):
        replace(arm, parameters=(*arm.parameters, Parameter("mass", 2.0)))


def test_the_problem_passes_its_choices_on():
    arm = paper_arm()
    problem = arm.problem(penalty=[1.0] * 5, pose=[0.5], measured=("motor_position", "joint_torque"))
    assert problem.plant.outputs == ("motor_position", "joint_torque")
    assert problem.operating_point[0] == 0.5
    np.testing.assert_array_equal(problem.r2, arm.problem().r2)
    np.testing.assert_array_equal(arm.problem().r2, [[10.0]])


def test_weights_without_effort_keep_the_robots_own_r2() -> None:
    robot = paper_arm()
    own = robot.problem().r2
    assert own.tolist() == [[10.0]]
    for weights in ([60, 0, 0, 0, 300], {"link_position": 60, "link_position_integral": 300}):
        assert np.array_equal(robot.problem(penalty=weights).r2, own)
    assert robot.problem(penalty=Penalty([60, 0, 0, 0, 300])).r2.tolist() == [[1.0]]
    assert replace(robot, penalty=None).problem(penalty=[60, 0, 0, 0, 300]).r2.tolist() == [[1.0]]


def test_a_plant_is_built_once_for_its_sensors_and_extras():
    """Tracing the flow of seven links takes a tenth of a second, and a design asks for a plant again and again."""
    robot = paper_arm()
    assert robot.plant() is robot.plant("link_position", extras=())
    assert robot.plant(inductance=True) is robot.plant(extras=("inductance",))
    assert robot.plant() is not robot.plant("motor_position")
    softer = robot.with_values({"stiffness": 50.0})
    assert softer.plant().parameters.values["stiffness"] == 50.0
    assert robot.plant().parameters.values["stiffness"] == robot.nominal["stiffness"]
    for other in (copy.copy(robot), copy.deepcopy(robot), pickle.loads(pickle.dumps(robot))):
        assert "_plants" not in vars(other)
        assert other.plant().code_key == robot.plant().code_key


def test_parameters_of_a_plant_have_units() -> None:
    """Of single numbers and of arrays, row by row; a joint that slides has others."""
    units = load_robot("planar-two-link").plant().units
    assert (units["gravity"], units["mass[2]"], units["inertia[12]"]) == ("m/s²", "kg", "kg·m²")
    values = {"stiffness": np.ones(2), "centre_of_mass": np.ones((2, 3)), "unknown": np.ones(2)}
    assert parameter_units(values, (False, True)) == {
        "stiffness[1]": "N·m/rad", "stiffness[2]": "N/m", **{f"centre_of_mass[{k}]": "m" for k in range(1, 7)},
    }  # fmt: skip


@pytest.mark.parametrize(
    ("named", "meant"),
    [
        (("link_position_elbow",), "measured=('link_position_elbow_pitch',)"),
        (
            ("motor_position", "link_velocity_shoulder"),
            "measured=('motor_position', 'link_velocity_shoulder_pitch')",
        ),
        (("link_position_hand",), "measured=('link_position',)"),
    ],
)
def test_a_sensor_of_a_joint_that_is_nearly_named_is_that_joints(named: tuple[str, ...], meant: str) -> None:
    with pytest.raises(InvalidInput) as caught:
        expanded(named, SENSORS, ("base_yaw", "shoulder_pitch", "elbow_pitch"))
    assert caught.value.advice == meant
