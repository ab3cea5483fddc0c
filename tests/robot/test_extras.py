"""What a real joint adds: each alone, all together, and refused where it cannot be."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.robot import Parameter
from flexhinf.robot.elastic import EXTRAS

ARM = fh.paper_arm().with_parameters(
    Parameter("damping", 0.7),
    Parameter("spring_hardening", 5000.0),
    Parameter("first_stiffness", 80.0),
    Parameter("second_stiffness", 100.0),
    Parameter("third_stiffness", 130.0),
    Parameter("first_torque", 2.0),
    Parameter("second_torque", 5.0),
    Parameter("gear_ratio", 1.0),
    Parameter("kinematic_error", 1e-3),
    Parameter("torque_ripple", 0.1),
    Parameter("backlash", 0.02),
    Parameter("coulomb_friction", 0.5),
    Parameter("static_friction", 0.8),
    Parameter("stribeck_velocity", 0.2),
    Parameter("load_friction", 0.04),
)
X = np.array([0.1, 0.3, 0.25, -0.4])


def change(extras, x=X):
    """What the extras change in the rates of the link's and the motor's velocity; both inertias are 1."""
    plain, real = ARM.plant(), ARM.plant(extras=extras)
    rate = real.derivative(np.concatenate([x, np.zeros(len(real.states) - 4)])) - np.concatenate(
        [plain.derivative(x), np.zeros(len(real.states) - 4)]
    )
    return rate[1], rate[3]


@pytest.mark.oracle
@pytest.mark.parametrize(
    ("extras", "link", "motor"),
    [
        ("joint_damping", 0.7 * (-0.7), 0.7 * 0.7),
        ("spring_hardening", 5000.0 * 0.15**3, -5000.0 * 0.15**3),
        ("backlash", -100.0 * 0.01, 100.0 * 0.01),
        ("coulomb_friction", 0.0, 0.5),
        ("stribeck_friction", 0.0, 0.5 + 0.3 * np.exp(-4.0)),
        ("load_friction", 0.0, 0.04 * 100.0 * 0.15),
        (("stribeck_friction", "load_friction"), 0.0, 0.5 + 0.3 * np.exp(-4.0) + 0.04 * 100.0 * 0.15),
        (
            ("backlash", "coulomb_friction", "load_friction"),
            -1.0,
            1.0 + 0.5 + 0.04 * 100.0 * 0.14,
        ),
        (("spring_hardening", "backlash"), 5000.0 * 0.14**3 - 1.0, 1.0 - 5000.0 * 0.14**3),
    ],
)
def test_each_switch_adds_its_torque(extras, link, motor):
    assert change(extras) == pytest.approx((link, motor), rel=1e-9)


def test_inside_the_backlash_the_spring_is_slack():
    plant = ARM.plant(extras="backlash")
    assert plant.derivative([0.0, 0.0, 0.0099, 0.0])[1] == 0.0
    assert plant.derivative([0.0, 0.0, -0.0099, 0.0])[3] == 0.0
    assert plant.derivative([0.0, 0.0, 0.0101, 0.0])[1] == pytest.approx(100.0 * 1e-4)


@pytest.mark.costs("a law, a compiled loop and every extra")
def test_all_together_rest_where_the_robot_says_and_run_in_a_loop():
    robot, every = ARM, tuple(name for name in EXTRAS if name != "drive_torque_limit")  # of another drive
    x, u = robot.operating_point([0.8], every)
    plant = robot.plant(extras=every)
    assert plant.states[-1] == "coil_current"
    assert np.abs(plant.derivative(x, u)).max() < 1e-10
    problem = fh.paper_arm().problem()
    law = fh.linear_law(problem, gamma=2 * fh.smallest_gamma(problem))
    run = fh.Loop(plant, fh.Controller(law, None, 1e-3)).run(fh.Step(0.5), duration=3.0)
    assert abs(run.signal("state", "link_position")[-1] - 0.5) < 0.05


def test_smooth_extras_may_be_designed_with_and_backlash_is_refused_by_name():
    problem = ARM.problem(extras=("joint_damping", "spring_hardening"), pose=[0.5])
    assert np.isfinite(fh.smallest_gamma(problem))
    with pytest.raises(InvalidInput, match="clip"):
        ARM.problem(extras="backlash").expand(2)


def test_unknown_switches_and_missing_numbers():
    with pytest.raises(InvalidInput, match="stiction"):
        ARM.plant(extras=("stiction",))
    with refused_with(InvalidInput, "'paper'", "'backlash'"):
        fh.paper_arm().plant(extras="backlash")
    with refused_with(InvalidInput, "'backlash'", "negative", "-1 rad"):
        ARM.with_values({"backlash": -1.0})
    with pytest.raises(InvalidInput, match="'backlsh'"):
        ARM.with_parameters(Parameter("backlsh", 1.0))


def test_backlash_of_a_joint_that_carries_nothing_is_run_with_the_steps_of_its_spring():
    """In the middle of the gap no spring is felt, but the run leaves it: it diverged with the steps for the gap."""
    robot = fh.load_robot("quanser-rotflex").with_values({"stiffness": 3e4})
    robot = robot.with_parameters(Parameter("backlash", 1e-3))
    x, u = robot.operating_point(extras="backlash")
    assert list(x) == [0.0] * 4
    plain, real = robot.plant(), robot.plant(extras="backlash")
    assert real.fastest_mode(x, u) == pytest.approx(plain.fastest_mode(x, u), rel=1e-9)
    assert pickle.loads(pickle.dumps(real)).fastest_mode(x, u) == real.fastest_mode(x, u)
    law = fh.linear_law(robot.problem(), gamma=2 * fh.smallest_gamma(robot.problem()))
    run = fh.Loop(real, fh.Controller(law, None, 1e-3)).run(fh.Step(0.5), duration=0.2)
    assert run.status == "completed"
    plant = fh.load_robot("planar-two-link").with_parameters(
        Parameter("backlash_shoulder", 1e-3), Parameter("backlash_elbow", 1e-3)
    )
    held = plant.operating_point([1.0, -1.0], "backlash")[0] - plant.operating_point([1.0, -1.0])[0]
    np.testing.assert_allclose(held[4:6], [5e-4, 0.0], atol=1e-12)


# Sharp friction --------------------------------------------------------------------------------------
def released(robot, twist, extras="coulomb_friction", duration=4.0, sub_steps=4):
    """Motor position of an arm whose link is as good as fixed, released with a twisted spring, no input."""
    from flexhinf.loop import Controller, Loop
    from flexhinf.plant import Law

    class Nothing(Law):
        law_key = "nothing"  # pyright: ignore[reportAssignmentType]
        state_names, input_names = tuple(robot.plant().states), ("motor_voltage",)
        operating_point, operating_input = np.zeros(4), np.zeros(1)
        law_data = np.zeros(1)  # pyright: ignore[reportAssignmentType]

        def evaluate_law(self, x, data):
            return np.array([0.0 * x[0] * data[0]])

    true = robot.plant(extras=extras, sticking=True)
    loop = Loop(true, Controller(Nothing(), None, 1e-3), sub_steps=sub_steps)
    return loop.run(duration=duration, initial_state=[0.0, 0.0, twist, 0.0])


#: A heavy link in weightlessness, a motor without back-EMF and viscous friction: a mass on a spring, J = 1, K = 100.
SLIDER = ARM.with_values({"gravity": 0.0, "link_inertia": 1e9, "friction": 0.0, "back_emf_constant": 1e-12})


@pytest.mark.oracle
def test_sharp_friction_is_coulombs_closed_form():
    """x'' = −ω² x ∓ F/J: half swings of π/ω about ±F/K, each 2F/K smaller, until one ends within F/K and sticks."""
    coarse, fine = (released(SLIDER, 0.0325, sub_steps=count) for count in (4, 40))
    x, t = fine.signals["state"][:, 2], fine.time
    band, omega = 0.5 / 100.0, 10.0
    turning, signed = [], 0.0325
    while abs(signed) > band:
        turning.append(signed)
        signed = -(signed - 2.0 * band * np.sign(signed))
    expected = np.full(len(t), signed)
    for k, start in enumerate(turning):
        inside = (t >= k * np.pi / omega) & (t < (k + 1) * np.pi / omega)
        centre = band * np.sign(start)
        expected[inside] = centre + (start - centre) * np.cos(omega * (t[inside] - k * np.pi / omega))
    assert len(turning) == 3
    np.testing.assert_allclose(x, expected, rtol=0.0, atol=2e-6)  # of a reversal, time is known to a sub-step
    np.testing.assert_allclose(coarse.signals["state"][:, 2], expected, rtol=0.0, atol=2e-5)
    stuck = x[t > 1.1 * len(turning) * np.pi / omega]
    assert np.ptp(stuck) < 1e-12  # where smoothed friction creeps


@pytest.mark.oracle
def test_with_stribecks_curve_it_holds_up_to_the_static_friction():
    for twist, moves in ((0.0079, False), (0.0081, True)):  # F_s/K = 0.008
        x = released(SLIDER, twist, "stribeck_friction", 1.0).signals["state"][:, 2]
        assert (np.ptp(x) > 1e-4) == moves


def test_a_sticking_plant_is_another_code_with_the_flow_of_none():
    smooth, none = ARM.plant(extras="coulomb_friction"), ARM.plant()
    sharp = ARM.plant(extras="coulomb_friction", sticking=True)
    assert sharp.fastest_mode() == none.fastest_mode() < smooth.fastest_mode()
    assert len({plant.code_key for plant in (smooth, sharp, none)}) == 3
    assert ARM.plant(sticking=True) is none
    again = pickle.loads(pickle.dumps(sharp))
    assert again.code_key == sharp.code_key
