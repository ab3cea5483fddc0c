"""MuJoCo's plant against ours: the same physics by other people, integrated by their Runge-Kutta method."""

from __future__ import annotations

import numpy as np
import pytest
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.plant import rk4_step
from flexhinf.robot import MuJoCoPlant, Parameter, load_robot

pytest.importorskip("mujoco")

# Two loops, compiled for a few seconds of simulation: compiled in half the time.
pytestmark = pytest.mark.usefixtures("unoptimised")


def ours(plant, x, u, d, step, steps):
    """Our plant under our Runge–Kutta step."""
    import casadi as ca

    state = ca.SX.sym("x", len(x))
    parameters = plant.parameters.vector()

    def flow(at, _):
        return np.array(
            [plant.traced_flow(ca.vertcat(*at.tolist()), u, d, parameters)[i] for i in range(len(x))]
        )

    elements = np.array([state[i] for i in range(len(x))], dtype=object)
    advance = ca.Function("step", [state], [ca.vertcat(*rk4_step(flow, elements, (0, 0, 0), step).tolist())])
    run = advance.mapaccum(steps)
    return np.asarray(run(x)).T


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.parametrize(
    ("name", "step", "extras"),
    [
        ("paper", 1e-3, ()),
        ("quanser-rotflex", 1e-3, ()),
        ("planar-two-link", 1e-3, ("joint_damping",)),
        ("planar-two-link", 1e-3, ("backlash",)),
        ("spatial-three-link", 1e-3, ()),
        ("seven-link", 2e-4, ()),
    ],
)
def test_one_second_of_mujocos_own_integration(name, step, extras):
    robot = load_robot(name)
    if "backlash" in extras:
        robot = robot.with_parameters(*(Parameter(f"backlash_{joint}", 0.02) for joint in robot.joint_names))
    rng, n = np.random.default_rng(2), len(robot.joint_names)
    x, u = robot.operating_point()
    x = x + np.concatenate(
        [0.2 * rng.normal(size=n), 0.3 * rng.normal(size=n), np.zeros(n), 0.1 * rng.normal(size=n)]
    )
    x[2 * n : 3 * n] += x[:n] - robot.operating_point()[0][:n]
    u, d = u + rng.normal(size=n), rng.normal(size=2 * n)
    box = MuJoCoPlant(robot, measured=None, step=step, extras=extras)
    box.reset(x)
    steps = round(1.0 / step)
    found = []
    for _ in range(steps):
        box.step(u, d, step)
        found.append(box.output())
    expected = ours(robot.plant(extras=extras), x, u, d, step, steps)
    assert np.abs(expected[-1] - x).max() > 0.1  # it moved
    assert np.abs(np.array(found) - expected).max() < 1e-9


@pytest.mark.ci("compiles a loop with MuJoCo's robot")
def test_a_closed_loop_on_mujocos_plant_agrees_with_ours():
    robot = load_robot("planar-two-link")
    problem = robot.problem(measured=("motor_position",))
    law = fh.solve_hji(problem, gamma=2 * fh.smallest_gamma(problem), degree=4)
    model = robot.plant(measured=("motor_position",))
    start = problem.operating_point[:8]
    ukf = fh.UnscentedKalmanFilter(model, 1e-3, 1e-6, 1e-6, mean=start, covariance=1e-6)
    controller = fh.Controller(law, ukf, 1e-3, saturation=24.0)
    goal = {"link_position_shoulder": 0.6, "link_position_elbow": 0.3}
    runs = [
        fh.Loop(plant, controller).run(goal, duration=3.0, initial_state=start)
        for plant in (model, MuJoCoPlant(robot, ("motor_position",)))
    ]
    ends = [run.data["state"].values[-1] for run in runs]
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-4)
    np.testing.assert_allclose(ends[1][:2], [0.6, 0.3], atol=0.02)


@pytest.mark.oracle
def test_a_rotor_is_stopped_by_dry_friction_in_the_time_that_newton_says_and_stays_there():
    """J θ̈ = τ − F sign θ̇ of a rotor whose spring is too soft to matter: τ below F never moves it."""
    robot = load_robot("quanser-rotflex").with_values({"stiffness": 1e-9, "friction": 0.0})
    robot = robot.with_values({"back_emf_constant": 0.0}).with_parameters(Parameter("coulomb_friction", 0.02))
    inertia = robot.plant_parameters()["motor_inertia"]
    box = MuJoCoPlant(robot, None, step=1e-4, extras=("coulomb_friction",))
    box.reset([0.0, 0.0, 0.0, 5.0])
    stops = 5.0 * inertia / 0.02
    for _ in range(round(0.5 * stops / 1e-3)):
        box.step([0.0], (), 1e-3)
    assert box.state()[3] == pytest.approx(2.5, rel=2e-3)
    for _ in range(round(2.5 * stops / 1e-3)):  # 2.5 rad/s with a quarter of the friction left
        box.step([0.0], [0.0, 0.015], 1e-3)
    place = box.state()[2]
    for _ in range(1000):
        box.step([0.0], [0.0, 0.015], 1e-3)
    assert abs(box.state()[2] - place) < 1e-4


def test_a_closed_loop_with_dry_friction_ends_like_ours():
    robot = load_robot("planar-two-link").with_values(
        {"coulomb_friction_shoulder": 10.0, "coulomb_friction_elbow": 5.0}
    )
    problem = robot.problem()
    law = fh.linear_law(problem, gamma=2 * fh.smallest_gamma(problem))
    start, goal = problem.operating_point[:8], {"link_position_shoulder": 0.6, "link_position_elbow": 0.3}
    on = ("coulomb_friction",)
    runs = [
        fh.Loop(plant, fh.Controller(law, None, 1e-3)).run(goal, duration=0.5, initial_state=start)
        for plant in (robot.plant(extras=on), MuJoCoPlant(robot, None, extras=on), robot.plant())
    ]
    ours, theirs, without = (run.data["state"].values[:, :2] for run in runs)
    assert np.abs(ours - without).max() > 1e-2
    assert np.abs(ours - theirs).max() < 0.05 * np.abs(ours - without).max()


def test_perturbed_parameters_reach_mujoco():
    robot = load_robot("planar-two-link")
    box = MuJoCoPlant(robot, None, parameters=robot.corner({"mass_elbow": 1.0}))
    assert box.model.body_mass.max() == pytest.approx(3.0)
    assert 2.0 * 1.05 in box.model.body_mass


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"extras": ("inductance",)}, "MuJoCo.*'inductance'.*coil"),
        ({"step": 0.0}, r"step[\s\S]* 0\.0"),
        ({"measured": ("speed",)}, "speed"),
    ],
)
def test_what_mujoco_cannot_do_is_refused(arguments, words):
    with pytest.raises(InvalidInput, match=words):
        MuJoCoPlant(load_robot("planar-two-link"), **arguments)


def test_a_design_with_what_mujoco_cannot_do_is_refused_before_any_work():
    def work(text: str) -> None:
        raise AssertionError(text)

    for extras in (("inductance",), ("coulomb_friction", "stribeck_friction")):
        with pytest.raises(InvalidInput, match=f"MuJoCo.*'{extras[-1]}':"):
            fh.design(
                load_robot("seven-link"), fh.Specification(pose="home", mujoco=True, extras=extras), work
            )


def test_a_state_that_does_not_fit_is_refused():
    with refused_with(InvalidInput, "8 finite", "array([0., 0., 0., 0.])"):
        MuJoCoPlant(load_robot("planar-two-link")).reset(np.zeros(4))
