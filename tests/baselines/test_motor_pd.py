"""PD on the motor side against hand-written loops, Tomei's Lyapunov function, and simulation."""

import numpy as np
import pytest
from tests.baselines.conftest import by_name, continuous, gravity_slope, links_at
from tests.refusals import refused_with

from flexhinf.baselines import MotorPD
from flexhinf.codegen.shared import share
from flexhinf.errors import InvalidInput
from flexhinf.loop import Controller, Loop
from flexhinf.plant.joints import elastic_joints


@pytest.mark.oracle
@pytest.mark.parametrize("pose", [0.0, 1.0, np.pi])
def test_the_loop_of_one_voltage_driven_joint_by_hand(pose):
    robot = by_name("paper")
    law = MotorPD.tuned(robot.problem(pose=[pose]), 4.0, 0.7, integral="link_position")
    v = robot.nominal
    k, j, i = v["stiffness"], v["motor_inertia"], v["link_inertia"]
    weight = v["mass"] * v["gravity"] * v["length"]
    gain, emf = v["torque_constant"] / v["resistance"], v["back_emf_constant"]
    kp, kd, ki = law.proportional[0], law.derivative[0], law.integral[0]
    expected = [
        [0, 1, 0, 0, 0],
        [-(k + weight * np.cos(pose)) / i, 0, k / i, 0, 0],
        [0, 0, 0, 1, 0],
        [k / j, 0, -(k + kp) / j, -(v["friction"] + gain * emf + kd) / j, -ki / j],
        [1, 0, 0, 0, 0],
    ]
    np.testing.assert_allclose(law.closed_loop(), expected, atol=1e-11)
    np.testing.assert_allclose(law.operating_input, weight * np.sin(pose) / gain, atol=1e-12)


@pytest.mark.oracle
@pytest.mark.parametrize("name", ["planar-two-link", "spatial-three-link", "seven-link"])
def test_the_modes_of_many_joints_by_hand(name):
    robot = by_name(name)
    law = MotorPD.tuned(robot.problem(), 8.0, 0.6)
    p = robot.plant_parameters()
    n = len(robot.joint_names)
    q = np.array(robot.home)
    mass, _ = links_at(robot, q)
    volts = robot.drive == "voltage"
    damping = p["friction"] + (
        p["torque_constant"] * p["back_emf_constant"] / p["resistance"] if volts else 0.0
    )
    spring, nothing, unit = np.diag(p["stiffness"]), np.zeros((n, n)), np.eye(n)
    links = np.linalg.solve(mass, np.hstack([-spring - gravity_slope(robot, q), nothing, spring, nothing]))
    rotor = np.hstack(
        [spring, nothing, -spring - np.diag(law.proportional), -np.diag(damping + law.derivative)]
    )
    expected = np.vstack([
        np.hstack([nothing, unit, nothing, nothing]), links,
        np.hstack([nothing, nothing, nothing, unit]), rotor / p["motor_inertia"][:, None],
    ])  # fmt: skip
    np.testing.assert_allclose(law.closed_loop(), expected, rtol=1e-7, atol=1e-6)
    assert np.linalg.eigvals(expected).real.max() < 0.0


@pytest.mark.ci("runs by SciPy to 1e-11")
@pytest.mark.oracle
def test_tomeis_function_falls_by_what_is_damped_and_the_goal_is_reached():
    robot = by_name("spatial-three-link")
    plant, p = robot.plant(), robot.plant_parameters()
    law = MotorPD.tuned(robot.problem(pose=[0.4, 0.3, 0.9]), 6.0, 0.7)
    x_d, _ = law.equilibrium
    start = x_d + np.array([1.2, -0.9, 0.7, 0.5, -0.4, 0.3, 1.1, -0.8, 0.9, 0.2, 0.1, -0.3])
    times, states = continuous(plant, law, start, 12.0, times=np.linspace(0.0, 12.0, 4001))
    q_d, theta_d = x_d[:3], x_d[6:9]
    _, torque = links_at(robot, q_d)
    nodes, weights = np.polynomial.legendre.leggauss(40)

    def value(x):
        q, dq, theta, dtheta = x.reshape(4, 3)
        mass, _ = links_at(robot, q)
        along = sum(w * torque(q_d + (s + 1) / 2 * (q - q_d)) for s, w in zip(nodes, weights)) / 2
        energy = 0.5 * dq @ mass @ dq + 0.5 * p["motor_inertia"] @ dtheta**2 + along @ (q - q_d)
        error = theta_d - theta
        return (
            energy
            + 0.5 * p["stiffness"] @ (theta - q) ** 2
            + 0.5 * law.proportional @ error**2
            + error @ torque(q_d)
        )

    power = states[:, 9:12] ** 2 @ (p["friction"] + law.derivative)
    lost = np.concatenate([[0.0], np.cumsum((power[1:] + power[:-1]) / 2) * (times[1] - times[0])])
    values = np.array([value(x) for x in states[::100]]) - value(x_d)
    assert np.all(np.diff(values) <= 1e-9 * values[0])
    np.testing.assert_allclose(
        values, values[0] - lost[::100], atol=2e-4 * values[0]
    )  # the trapezoidal rule's
    assert values[-1] < 1e-5 * values[0]
    np.testing.assert_allclose(states[-1, [0, 1, 2, 6, 7, 8]], x_d[[0, 1, 2, 6, 7, 8]], atol=1e-3)


@pytest.mark.oracle
@pytest.mark.parametrize("integral", [None, "motor_position", "link_position"])
def test_gains_put_the_poles_of_a_stiff_joint_where_asked(integral):
    stiff = by_name("paper").with_values({"stiffness": 1e9, "gravity": 0.0})
    law = MotorPD.tuned(stiff.problem(), 5.0, 0.6, integral=integral, integral_rate=0.3)
    poles = np.sort_complex(np.linalg.eigvals(law.closed_loop()))
    slow = poles[np.argsort(np.abs(poles))[: 3 if integral else 2]]
    expected = np.roots([1.0, 2 * 0.6 * 5.0, 25.0])
    expected = np.append(expected, -1.5) if integral else expected
    np.testing.assert_allclose(np.sort_complex(slow), np.sort_complex(expected), rtol=1e-4)


def test_a_motor_that_damps_itself_by_more_than_was_asked_keeps_doing_so():
    problem = by_name("quanser").problem()
    law = MotorPD.tuned(problem, 1.0, 0.1)
    assert elastic_joints(problem.plant, *law.equilibrium).motor_damping[0] > 0.01
    assert law.derivative[0] == 0.0


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("integral", ["link_position", "motor_position"])
def test_in_the_sampled_loop_the_goal_is_reached_and_the_integral_takes_what_is_wrong(integral):
    robot = by_name("planar-two-link")
    wrong = robot.plant().with_parameters(mass=1.1 * robot.plant_parameters()["mass"])
    goal, held = robot.operating_point([0.9, 0.2])
    reference = np.concatenate([goal, held])
    problem = robot.problem()
    plain = MotorPD.tuned(problem, 20.0, 0.8)
    run = Loop(robot.plant(), Controller(plain, None, moving=True)).run(reference, duration=6.0)
    np.testing.assert_allclose(run.signals["state"][-1], goal, atol=1e-5)
    run = Loop(wrong, Controller(plain, None, moving=True)).run(reference, duration=6.0)
    assert np.abs(run.signals["state"][-1] - goal)[:2].max() > 1e-3
    law = MotorPD.tuned(problem, 20.0, 0.8, integral=integral)
    run = Loop(wrong, Controller(law, None, moving=True)).run(reference, duration=12.0)
    place = 0 if integral == "link_position" else 4
    np.testing.assert_allclose(
        run.signals["state"][-1, place : place + 2], goal[place : place + 2], atol=1e-4
    )


def test_other_gains_compile_nothing(monkeypatch):
    problem = by_name("paper").problem()
    first = Controller(MotorPD.tuned(problem, 4.0), None)
    first.step(np.zeros(4))
    other = Controller(MotorPD.tuned(problem, 5.0, 0.9), None)

    def none(key, build):
        return share(key, lambda: pytest.fail("compiled again"))

    monkeypatch.setattr("flexhinf.loop.controller.controller.share", none)
    x = np.array([0.1, 0.0, 0.2, 0.3])
    np.testing.assert_allclose(other.step(x), other.law.gain @ x, rtol=1e-13)
    assert not np.allclose(first.law.gain, other.law.gain)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"proportional": 2.0}, r"minimum[\s\S]* -4\.07"),
        ({"proportional": [1.0, 2.0]}, r"proportional[\s\S]*\[1\.0, 2\.0\]"),
        ({"derivative": -1.0}, r"derivative[\s\S]* -1\.0"),
        ({"integral": 1.0}, r"integral[\s\S]* \[\] and \[1\.0\]"),
        ({"integrate": ("link_position",)}, r"integral[\s\S]* \['link_position'\] and \[0\.0\]"),
        ({"integrate": ("elbow",), "integral": 1.0}, "state 'elbow'"),
        ({"equilibrium": (np.zeros(3), np.zeros(1))}, r"equilibrium[\s\S]* \(3,\)"),
    ],
)
def test_what_does_not_fit_is_refused(changes, complaint):
    robot = by_name("paper")
    settings = {"equilibrium": robot.operating_point([np.pi]), "proportional": 50.0, "derivative": 1.0}
    MotorPD(plant=robot.plant(), **settings)
    with pytest.raises(InvalidInput, match=complaint):
        MotorPD(plant=robot.plant(), **{**settings, **changes})


@pytest.mark.parametrize("settings", [{"bandwidth": 0.0}, {"bandwidth": 4.0, "damping": np.nan}])
def test_a_bandwidth_and_a_damping_are_needed(settings):
    with pytest.raises(InvalidInput, match=r"bandwidth|damping"):
        MotorPD.tuned(by_name("paper").problem(), **settings)


def test_a_negative_rate_of_the_integral_is_refused():
    with refused_with(InvalidInput, "rate", "integral", -1.0):
        MotorPD.tuned(by_name("paper").problem(), 4.0, integral="link_position", integral_rate=-1.0)
