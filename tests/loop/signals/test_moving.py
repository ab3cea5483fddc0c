"""Moving references: what they command, and loops that follow them."""

import numpy as np
import pytest

from flexhinf.errors import InvalidInput
from flexhinf.estimation import UnscentedKalmanFilter
from flexhinf.hinf import smallest_gamma, solve_hji
from flexhinf.loop import Controller, JerkLimited, Loop, Moving, Samples, Sine, Spline, Step
from flexhinf.loop.simulation.inputs import sample_signal
from flexhinf.robot import load_robot, paper_arm

# Kernels that run once each: half of the time.
pytestmark = pytest.mark.usefixtures("unoptimised")

T = np.linspace(0.0, 3.0, 301)
PAPER = Sine(1.0, 0.05, offset=np.pi)


def chains(q, dq, ddq, dddq, ddddq):
    """Of integrators: the state is (q, q̇, q̈, q⃛) and the input q⁗."""
    return np.concatenate([q, dq, ddq, dddq], axis=1), ddddq


def law(robot, pose, **weights):
    problem = robot.problem(pose=pose, **weights)
    return solve_hji(problem, 1.2 * smallest_gamma(problem), 2)


def test_the_same_times_are_computed_once_and_others_anew():
    calls = []

    def counted(*motion):
        calls.append(len(motion[0]))
        return chains(*motion)

    moving = Moving([Sine(1.0, 0.5), Sine(0.3, 1.0)], counted)
    first = moving(T)
    first[:] = 0.0  # what a caller does with it changes nothing
    assert np.any(moving(T))
    assert np.array_equal(moving.state(T), moving(T)[:, :8])
    assert calls == [1, len(T)]
    assert moving(T[:5]).shape == (5, 10)
    assert np.array_equal(moving(0.5), moving(np.array([0.5]))[0])
    assert calls == [1, len(T), 5, 1]


def test_it_is_the_motion_and_its_input():
    a, b = Sine(1.0, 0.5), Sine(0.3, 1.0, phase=0.2)
    moving = Moving([a, b], chains)
    da, db = a.derivatives(T), b.derivatives(T)
    expected = np.stack([row for k in range(4) for row in (da[k], db[k])] + [da[4], db[4]], axis=-1)
    np.testing.assert_array_equal(moving(T), expected)
    np.testing.assert_allclose(moving(0.7), moving(np.array([0.7]))[0])
    np.testing.assert_array_equal(moving.state(T), expected[:, :8])
    np.testing.assert_array_equal(moving.input(0.0), expected[0, 8:])
    assert moving.name.endswith(f" {a.name}; {b.name}")


def test_joints_by_name():
    moving = Moving({"b": 2.0, "a": 1.0}, chains, names=("a", "b"))
    np.testing.assert_array_equal(moving.state(0.0)[:2], [1.0, 2.0])
    np.testing.assert_array_equal(Moving({"a": 1.0}, chains, names="a").state(0.0), [1.0, 0.0, 0.0, 0.0])


def test_a_step_is_the_pose_before_and_the_pose_after():
    arm = paper_arm()
    moving = Moving(Step(1.0, at=1.0, initial=-0.5), arm.inverse_dynamics)
    for t, pose in ((0.0, -0.5), (0.999, -0.5), (1.0, 1.0), (2.0, 1.0)):
        np.testing.assert_allclose(moving(t), np.concatenate(arm.operating_point([pose])), rtol=1e-13)


def test_loops_ask_for_all_samples_at_once():
    asked = []

    def inverse(*motion):
        asked.append(len(motion[0]))
        return chains(*motion)

    moving = Moving(Sine(1.0, 0.5), inverse)
    values = sample_signal(moving, T, ["q", "dq", "ddq", "dddq", "u"], "reference")
    assert values.shape == (301, 5)
    assert asked == [1, 301]


@pytest.mark.parametrize(
    ("signals", "inverse"),
    [
        (JerkLimited(0.0, 1.0, 1.0, 1.0, 10.0), chains), (Samples([0.0, 1.0], [0.0, 1.0]), chains),
        ([lambda t: t], chains), ({"a": 1.0}, chains),
        (1.0, lambda *motion: (motion[0][0], motion[1][0])), (1.0, lambda *motion: (motion[0],)),
    ],
)  # fmt: skip
def test_what_cannot_move_is_refused_when_it_is_made(signals, inverse):
    with pytest.raises(InvalidInput) as caught:
        Moving(signals, inverse)
    assert caught.value.advice


def test_the_wrong_number_of_joints_is_refused():
    with pytest.raises(InvalidInput):
        Moving([Sine(1.0, 0.5)], load_robot("planar-two-link").inverse_dynamics)


# In loops -----------------------------------------------------------------------------------------
@pytest.mark.ci("a loop of its own")
@pytest.mark.paper
def test_the_papers_tracking_command():
    """π + sin(πt/10) about 180°: with the true state what is left is the input held for a period."""
    arm = paper_arm()
    moving, feedback = Moving(PAPER, arm.inverse_dynamics), law(arm, [np.pi])
    start = moving.state(0.0)

    def error(estimator, noise=None):
        loop = Loop(arm.plant(), Controller(feedback, estimator, 1e-3, moving=True))
        run = loop.run(moving, duration=20.0, initial_state=start, noise=noise)
        np.testing.assert_allclose(run.signals["reference"][:, 0], np.pi + np.sin(np.pi * run.time / 10))
        return np.degrees(np.abs(run.signals["state"][:, 0] - PAPER(run.time)).max())

    assert error(None) < 0.005
    ukf = UnscentedKalmanFilter(arm.plant(), 1e-3, 1e-8, 1e-6, start, 1e-4)
    assert error(ukf) < 0.005
    assert error(ukf, 1e-3) < 0.1


@pytest.mark.ci("moves of two links, twice each")
@pytest.mark.parametrize("kind", ["jerk-limited", "spline"])
def test_a_two_link_arm_follows_a_smooth_move(kind):
    """To a twentieth of a degree; with the same law about a still pose at each time it is far off."""
    arm = load_robot("planar-two-link")
    start, goal = (0.3, -0.4), (1.2, 0.6)
    if kind == "jerk-limited":
        signal = JerkLimited(start, goal, 2.0, 6.0, 60.0, at=0.1, smoothing=0.1)
    else:
        signal = Spline([0.1, 0.6, 1.2], [start, (0.9, 0.0), goal])
    moving = Moving(signal, arm.inverse_dynamics)
    feedback = law(arm, start)
    loop = Loop(arm.plant(), Controller(feedback, None, 1e-3, moving=True))
    run = loop.run(moving, duration=2.0, initial_state=moving.state(0.0))
    error = np.abs(run.signals["state"][:, :2] - signal(run.time))
    assert np.degrees(error.max()) < 0.05

    def still(t):
        x, u = arm.inverse_dynamics(signal(t)[None])
        return np.concatenate([x[0], u[0]])

    lame = loop.run(still, duration=2.0, initial_state=moving.state(0.0))
    assert np.abs(lame.signals["state"][:, :2] - signal(run.time)).max() > 20.0 * error.max()
