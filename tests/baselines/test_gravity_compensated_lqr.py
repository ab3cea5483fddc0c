"""LQR with the weight compensated: the closed form of one link, LQR without gravity, and every rest."""

import numpy as np
import pytest
from tests.baselines.conftest import by_name
from tests.refusals import refused_with

from flexhinf.baselines import GravityCompensatedLQR, lqr
from flexhinf.errors import FlexhinfError
from flexhinf.loop import Controller, Loop

ROBOTS = ["paper", "rig", "planar-two-link", "spatial-three-link", "seven-link"]


@pytest.mark.oracle
def test_one_link_in_closed_form():
    """u = u_g(x1) + K (x − x_g(x1)) with x_g3 = (M g L/k) sin x1 and u_g = (R/k_m) M g L sin x1, about hanging."""
    import control

    robot = by_name("paper")
    law, v = GravityCompensatedLQR.design(robot.problem()), robot.nominal
    torque = v["mass"] * v["gravity"] * v["length"]
    wind, holding = torque / v["stiffness"], torque * v["resistance"] / v["torque_constant"]
    j, k, i = v["motor_inertia"], v["stiffness"], v["link_inertia"]
    friction = v["friction"] + v["torque_constant"] * v["back_emf_constant"] / v["resistance"]
    a = np.array([
        [0, 1, 0, 0, 0], [-k / i, 0, k / i, 0, 0], [0, 0, 0, 1, 0], [k / j, 0, -k / j, -friction / j, 0],
        [1, 0, 0, 0, 0],
    ])  # fmt: skip
    b = np.array([[0, 0, 0, v["torque_constant"] / v["resistance"] / j, 0]]).T
    gain = -control.lqr(a, b, np.diag([3600.0, 0, 0, 0, 90000.0]), [[10.0]])[0]
    for x in np.random.default_rng(0).normal(size=(20, 5)):
        s, c = np.sin(x[0]), np.cos(x[0])
        relative = np.array([x[0], x[1], x[2] - wind * s, x[3] - wind * c * x[1], x[4]])
        np.testing.assert_allclose(
            law.evaluate_law(x, law.law_data), holding * s + gain @ relative, rtol=1e-8
        )


@pytest.mark.quick_cases(3)
@pytest.mark.oracle
@pytest.mark.parametrize("name", ROBOTS)
def test_without_gravity_it_is_the_lqr_and_its_gain_is_that_with_gravity_too(name):
    robot = by_name(name)
    light = robot.with_values({"gravity": 0.0})
    law, plain = GravityCompensatedLQR.design(light.problem()), lqr(light.problem())
    np.testing.assert_allclose(law.gain, plain.gain, rtol=1e-9, atol=1e-9 * np.abs(plain.gain).max())
    x = np.sin(np.arange(len(law.state_names)))
    np.testing.assert_allclose(law.evaluate_law(x, law.law_data), plain.gain @ x, rtol=1e-8)
    heavy = GravityCompensatedLQR.design(robot.problem()).gain
    np.testing.assert_allclose(heavy, plain.gain, rtol=1e-8, atol=1e-9 * np.abs(plain.gain).max())


@pytest.mark.oracle
@pytest.mark.parametrize("name", ROBOTS)
def test_the_weight_is_exact_at_every_pose(name):
    """With K acting on what differs from the wind-up only, the input that is left at any rest is K (q − q_d, 0 …)."""
    robot = by_name(name)
    law, n = GravityCompensatedLQR.design(robot.problem()), len(robot.joint_names)
    rng = np.random.default_rng(4)
    for q in rng.uniform(-1.5, 1.5, (3, n)):
        x, u = robot.operating_point(q)
        k = law.evaluate_law(np.concatenate([x - law.equilibrium[0], np.zeros(n)]), law.law_data)
        moved = q - law.equilibrium[0][:n]
        expected = u + law.gain[:, :n] @ moved + law.gain[:, 2 * n : 3 * n] @ moved
        np.testing.assert_allclose(law.equilibrium[1] + k, expected, rtol=1e-8, atol=1e-8)
        np.testing.assert_array_equal(law.evaluate_about(np.zeros(5 * n), x, u, law.law_data), 0.0)


def test_a_far_goal_is_reached_in_the_sampled_loop():
    robot = by_name("planar-two-link")
    law = GravityCompensatedLQR.design(robot.problem())
    goal, held = robot.operating_point([2.2, -0.9])
    run = Loop(robot.plant(), Controller(law, None, moving=True)).run(
        np.concatenate([goal, held]), duration=8.0
    )
    np.testing.assert_allclose(run.signals["state"][-1], goal, atol=1e-4)
    assert 0.0 < run.metrics()["peak_input"] < 500.0


def test_what_does_not_fit_is_refused():
    robot = by_name("paper")
    with refused_with(FlexhinfError, "elastic", "'coil_current'"):
        GravityCompensatedLQR.design(robot.problem(extras="inductance"))
    with refused_with(FlexhinfError, "gain", "(1, 4)"):
        GravityCompensatedLQR(plant=robot.plant(), equilibrium=robot.operating_point(), gain=np.zeros((1, 3)))
