"""LQG, an LQR with a stationary Kalman filter on the linear plant, against python-control."""

import numpy as np
import pytest
from tests.baselines.conftest import by_name

from flexhinf.baselines import lqr
from flexhinf.estimation import ExtendedKalmanFilter
from flexhinf.estimation.stationary import ConstantGainFilter, linear_model, stationary_gain
from flexhinf.loop import Controller, Loop
from flexhinf.plant import linear_plant

H = 1e-3


def parts(name, pose):
    """Problem, linear plant, filter on it, its sampled model, noises and stationary gain."""
    robot = by_name(name)
    problem = robot.problem(pose=pose)
    n = problem.plant.n
    x, u = problem.operating_point[:n], problem.operating_input
    linear = linear_plant(problem.plant, x, u)
    q = np.diag(10.0 ** np.linspace(-6.0, -4.0, n))
    r = 1e-6 * np.diag(1.0 + np.arange(len(linear.outputs)))
    ekf = ExtendedKalmanFilter(linear, H, q, r, x, 1e-4)
    model = linear_model(ekf, x, u)
    return problem, linear, ekf, model, (q, r), stationary_gain(model, q, r)


# Three loops that run once: 0.6 s instead of 1.0 s.
pytestmark = pytest.mark.usefixtures("unoptimised")

CASES = [("paper", [1.0]), ("planar-two-link", [0.4, 0.6]), ("spatial-three-link", [0.0, 0.5, 1.0])]


@pytest.mark.oracle
@pytest.mark.parametrize(("name", "pose"), CASES)
def test_the_filters_gain_is_python_controls(name, pose):
    import control
    from scipy.signal import cont2discrete

    _, linear, _, (f, c), (q, r), gain = parts(name, pose)
    expected, _, poles = control.dlqe(f, np.eye(len(f)), c, q, r)
    # python-control corrects and predicts at once: its gain is F times ours.
    np.testing.assert_allclose(f @ gain, expected, atol=1e-10 * np.abs(expected).max())
    found = np.abs(np.linalg.eigvals(f @ (np.eye(len(f)) - gain @ c)))
    np.testing.assert_allclose(np.sort(found), np.sort(np.abs(poles)), rtol=1e-6)
    exact = cont2discrete((*linear.linearise()[:2], c, np.zeros((len(c), len(linear.inputs)))), H)[0]
    np.testing.assert_allclose(f, exact, atol=3e-6 * np.abs(exact).max())  # Runge–Kutta steps of MODEL_STEP


@pytest.mark.ci("4,000 steps of a filter in Python")
@pytest.mark.oracle
def test_the_extended_filter_on_the_linear_plant_is_the_linear_filter():
    """Its covariance comes to the gain that python-control computes, wherever the estimate is."""
    _, linear, ekf, (_, c), (_, r), gain = parts("paper", [1.0])
    rng = np.random.default_rng(0)
    for _ in range(4000):
        ekf.correct(rng.normal(size=1))
        ekf.predict(rng.normal(size=1))
    p = ekf.covariance
    np.testing.assert_allclose(np.linalg.solve(c @ p @ c.T + r, c @ p).T, gain, rtol=1e-6)
    assert np.abs(ekf.mean - linear.parameters.values["state"]).max() > 1.0  # far away


@pytest.mark.oracle
@pytest.mark.parametrize(
    ("name", "pose"),
    [*CASES[:2], pytest.param(*CASES[2], marks=pytest.mark.ci("compiles a loop of three links"))],
)
def test_the_sampled_loop_is_a_forced_response_of_python_control(name, pose):
    import control
    from scipy.signal import cont2discrete

    problem, linear, ekf, (f, c), _, gain = parts(name, pose)
    law = lqr(problem)
    control_ = Controller(law, ConstantGainFilter(ekf, gain), H, latency=0)
    n, m, k = linear.n, len(linear.inputs), len(law.integrate)
    x0, u0 = law.equilibrium
    places = [linear.index(tracked) for tracked in law.integrate]
    push = np.zeros(len(linear.disturbances))
    push[0] = 0.5
    goal = x0[places] + 0.2
    run = Loop(linear, control_).run(
        list(goal), dict(zip(linear.disturbances, push)), duration=1.5, initial_state=x0
    )
    # Sampled: plant x, prior estimate z, integrals before the sample e, last position s; all as deviations.
    a, b, g, _ = linear.linearise()
    sampled = cont2discrete((a, np.hstack([b, g]), np.eye(n), np.zeros((n, m + len(push)))), H)
    a_d, b_d, g_d = sampled[0], sampled[1][:, :m], sampled[1][:, m:]
    model_b = held_input(ekf, x0, u0)
    kx, ke, track = (
        law.gain[:, :n],
        law.gain[:, n:],
        c[[list(linear.outputs).index(t) for t in law.integrate]],
    )
    fix = np.eye(n) - gain @ c
    # û = kx (fix z + gain c x) + ke (e + H (½ (s + t x) − r)), t the measured tracked positions.
    ux, uz, ue, us = kx @ gain @ c + 0.5 * H * ke @ track, kx @ fix, ke, 0.5 * H * ke
    ur = -H * ke
    zero = np.zeros
    step = np.block([
        [a_d + b_d @ ux, b_d @ uz, b_d @ ue, b_d @ us],
        [f @ gain @ c + model_b @ ux, f @ fix + model_b @ uz, model_b @ ue, model_b @ us],
        [0.5 * H * track, zero((k, n)), np.eye(k), 0.5 * H * np.eye(k)],
        [track, zero((k, n)), zero((k, k)), zero((k, k))],
    ])  # fmt: skip
    drive = np.block([
        [b_d @ ur, g_d], [model_b @ ur, zero((n, len(push)))], [-H * np.eye(k), zero((k, len(push)))],
        [zero((k, k)), zero((k, len(push)))],
    ])  # fmt: skip
    system = control.ss(step, drive, np.eye(len(step)), zero((len(step), k + len(push))), H)
    # The first sample integrates nothing: it is made by hand, and the response starts from the second.
    first = np.concatenate([g_d @ push, zero(n), zero(k), zero(k)])
    forced = np.tile(np.concatenate([0.2 * np.ones(k), push])[:, None], len(run.time) - 1)
    response = control.forced_response(system, np.arange(len(run.time) - 1) * H, forced, first)
    np.testing.assert_allclose(run.signals["state"][1:] - x0, response.states[:n].T, atol=2e-6)
    assert np.abs(response.states[:n]).max() > 0.05


def held_input(ekf, x, u):
    """∂F/∂u of the filter's own sampled model, (n, m)."""
    p = ekf.plant.parameters.named(ekf.plant.parameters.vector())
    base = ekf.transition(x, u, p)
    return np.column_stack([ekf.transition(x, u + unit, p) - base for unit in np.eye(len(u))])
