"""MuJoCo's plant against ours: the same physics by other people, integrated by their Runge-Kutta method."""

from __future__ import annotations

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.plant import rk4_step
from flexhinf.robot import MuJoCoPlant, load_robot

pytest.importorskip("mujoco")


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


@pytest.mark.oracle
@pytest.mark.parametrize(
    ("name", "step", "extras"),
    [
        ("paper", 1e-3, ()),
        ("quanser-rotflex", 1e-3, ()),
        ("planar-two-link", 1e-3, ("joint_damping",)),
        ("spatial-three-link", 1e-3, ()),
        ("seven-link", 2e-4, ()),
    ],
)
def test_one_second_of_mujocos_own_integration(name, step, extras):
    robot = load_robot(name)
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


def test_perturbed_parameters_reach_mujoco():
    robot = load_robot("planar-two-link")
    box = MuJoCoPlant(robot, None, parameters=robot.corner({"mass_elbow": 1.0}))
    assert box.model.body_mass.max() == pytest.approx(3.0)
    assert 2.0 * 1.05 in box.model.body_mass


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"extras": ("coulomb_friction",)}, "does not express"),
        ({"step": 0.0}, "not positive"),
        ({"measured": ("speed",)}, "speed"),
    ],
)
def test_what_mujoco_cannot_do_is_refused(arguments, words):
    with pytest.raises(InvalidInput, match=words):
        MuJoCoPlant(load_robot("planar-two-link"), **arguments)


def test_a_state_that_does_not_fit_is_refused():
    with pytest.raises(InvalidInput, match="8 numbers"):
        MuJoCoPlant(load_robot("planar-two-link")).reset(np.zeros(4))
