"""Robots of several joints: names, equations, operating points, tolerances."""

from __future__ import annotations

import numpy as np
import pytest
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.plant import Parameters
from flexhinf.robot import load_robot

PLANAR = load_robot("planar-two-link")


def test_names_of_states_inputs_and_disturbances():
    plant = PLANAR.plant(measured=("motor_position", "joint_torque_elbow"), inductance=True)
    assert plant.states == tuple(
        f"{quantity}_{joint}"
        for quantity in ("link_position", "link_velocity", "motor_position", "motor_velocity", "coil_current")
        for joint in ("shoulder", "elbow")
    )
    assert plant.inputs == ("motor_voltage_shoulder", "motor_voltage_elbow")
    assert plant.outputs == ("motor_position_shoulder", "motor_position_elbow", "joint_torque_elbow")
    assert plant.disturbances[1:3] == ("link_torque_elbow", "motor_torque_shoulder")
    assert plant.unit("joint_torque_elbow") == "N·m"
    assert plant.unit("link_position_elbow_integral") == "rad·s"
    assert load_robot("seven-link").plant().inputs[0] == "drive_torque_a1"


def test_what_a_sensor_sees():
    plant = PLANAR.plant(measured=("joint_torque", "link_velocity_elbow"))
    x = np.arange(1.0, 9.0) / 10
    y = np.asarray(plant.traced_output(x, [0.0, 0.0], plant.parameters.vector()), dtype=float).ravel()
    np.testing.assert_allclose(y, [400.0 * 0.4, 200.0 * 0.4, 0.4], rtol=1e-14)


@pytest.mark.oracle
def test_spongs_model_of_a_geared_arm():
    """ẋ against the model written out with the mass matrix and the raw motor constants."""
    rng, n = np.random.default_rng(4), 2
    plant = PLANAR.plant(inductance=True)
    v, p = PLANAR.nominal, Parameters(PLANAR.plant_parameters())
    x, u, d = rng.normal(size=10), rng.normal(size=2), rng.normal(size=4)
    q, dq, theta, dtheta, current = x.reshape(5, n)
    spring = np.array([v["stiffness_shoulder"], v["stiffness_elbow"]]) * (theta - q)
    rate = np.asarray(plant.derivative(x, u, d)).reshape(5, n)
    held = PLANAR.links.torques(q, dq, rate[1], p)
    np.testing.assert_allclose(np.array(held, dtype=float), spring + d[:2], atol=1e-10)
    for i, joint in enumerate(("shoulder", "elbow")):
        ratio, rotor = v[f"gear_ratio_{joint}"], v[f"rotor_inertia_{joint}"]
        torque = ratio * v[f"torque_constant_{joint}"] * current[i]
        left = torque - v[f"friction_{joint}"] * dtheta[i] - spring[i] + d[2 + i]
        assert rate[3, i] == pytest.approx(left / (ratio**2 * rotor), rel=1e-12)
        back = ratio * v[f"back_emf_constant_{joint}"] * dtheta[i]
        coil = (u[i] - v[f"resistance_{joint}"] * current[i] - back) / v[f"inductance_{joint}"]
        assert rate[4, i] == pytest.approx(coil, rel=1e-12)


@pytest.mark.parametrize("extras", [(), ("inductance",), ("inductance", "joint_damping", "coulomb_friction")])
def test_the_operating_point_rests(extras):
    x, u = PLANAR.operating_point([0.3, -0.8], extras)
    plant = PLANAR.plant(extras=extras)
    assert np.abs(plant.derivative(x, u)).max() < 1e-11
    assert x[:2].tolist() == [0.3, -0.8]


@pytest.mark.quick_cases(4)
def test_every_robot_rests_at_home_and_can_be_designed_for(shipped):
    x, u = shipped.operating_point()
    assert np.abs(shipped.plant().derivative(x, u)).max() < 1e-10
    problem = shipped.problem()
    n = len(shipped.joint_names)
    assert len(problem.state_names) == 5 * n
    assert len(problem.disturbance_names) == n
    assert np.isfinite(fh.smallest_gamma(problem))


def test_every_number_of_the_catalogue_has_a_source(shipped):
    assert all(parameter.source and parameter.unit for parameter in shipped.parameters)


def test_poses_by_name_and_outside_limits():
    x, _ = PLANAR.operating_point({"elbow": 1.0})
    assert x[:2].tolist() == [0.4, 1.0]  # the shoulder stays at home
    with refused_with(InvalidInput, "limits", "'elbow'", "2.7 rad"):
        PLANAR.problem(pose=[0.0, 2.7])
    with pytest.raises(InvalidInput, match="wrist"):
        PLANAR.problem(pose={"wrist": 0.0})
    with refused_with(InvalidInput, "finite", "['shoulder', 'elbow']", "[0.0]"):
        PLANAR.problem(pose=[0.0])


def test_penalties_on_torques_and_by_group():
    weights = {"link_position": 3.0, "joint_torque": [0.5, 0.0], "motor_velocity_elbow": 2.0}
    problem = PLANAR.problem(
        weights, integrate=(), command=None, disturbances=("link_torque", "motor_torque_elbow")
    )
    assert problem.disturbance_names == ("link_torque_shoulder", "link_torque_elbow", "motor_torque_elbow")
    x = np.linspace(0.1, 0.8, 8)[None]
    h = problem.fields(x)[3][0]
    torque = 400.0 * (x[0, 4] - x[0, 0])
    np.testing.assert_allclose(h, [3.0 * x[0, 0], 3.0 * x[0, 1], 2.0 * x[0, 7], 0.5 * torque], rtol=1e-14)
    with pytest.raises(InvalidInput, match="motor_speed"):
        PLANAR.problem({"joint_torque": 1.0, "motor_speed": 1.0})


def test_tolerances_perturb_the_same_code():
    plant = PLANAR.plant(inductance=True)
    drawn = plant.with_parameters(**PLANAR.draw(np.random.default_rng(1)))
    assert drawn.code_key == plant.code_key
    assert drawn.parameters.vector().tolist() != plant.parameters.vector().tolist()
    corner = PLANAR.corner({"rotor_inertia_elbow": 1.0})
    np.testing.assert_allclose(corner["motor_inertia"], [0.3, 0.12 * 1.03])
    np.testing.assert_allclose(PLANAR.corner({"inertia_zz_elbow": -1.0})["inertia"][1, 5], 0.0275 * 0.96)
    for parameter in PLANAR.uncertain:
        assert any(
            not np.array_equal(PLANAR.corner({parameter.name: 1.0})[k], v)
            for k, v in PLANAR.plant_parameters().items()
        ), parameter.name


def test_a_robot_without_a_penalty_asks_for_one():
    from dataclasses import replace

    with pytest.raises(InvalidInput, match="penalty"):
        replace(PLANAR, penalty=None).problem()


@pytest.mark.ci("solves for 28 states")
def test_seven_links_from_the_file_to_a_law_that_holds_the_arm():
    robot = load_robot("seven-link")
    problem = robot.problem()
    solution = fh.solve_hji(problem, gamma=2 * fh.smallest_gamma(problem), degree=4)
    assert len(problem.state_names) == 35
    x, steps = np.zeros(35), np.eye(35) * 1e-7
    points = np.vstack([x + steps, x - steps])
    f, _, g, _ = problem.fields(points)
    rate = f + np.einsum("pij,pj->pi", g, np.atleast_2d(solution.law(points)))
    jacobian = (rate[:35] - rate[35:]).T / 2e-7
    assert np.linalg.eigvals(jacobian).real.max() < -0.1
