"""A law that depends on the reference is given it."""

import numpy as np
import pytest

from flexhinf.estimation import UnscentedKalmanFilter
from flexhinf.loop import Controller, Loop, Schedule
from flexhinf.loop.controller import controller
from flexhinf.plant import Law, Plant

H = 1e-2


class Cubed(Law):
    """k = −a (x³ − x_d³) − b e + u_d-dependent damping: what an absolute law is, in one state."""

    state_names, input_names = ("x", "x_integral"), ("u",)
    operating_point, operating_input = np.array([0.5, 0.0]), np.array([0.25])
    law_key = "cubed"

    def __init__(self, a=3.0, b=2.0):
        self.numbers = np.array([a, b, 0.5, 0.25])

    @property
    def law_data(self):
        return self.numbers

    def evaluate_law(self, x, data):
        return self.evaluate_about(x, data[2:3], data[3:4], data)

    def evaluate_about(self, x, state, input, data):
        now = state[0] + x[0]
        return np.array([-data[0] * (now**3 - state[0] ** 3) - data[1] * x[1] - 0.1 * input[0] * x[0]])


class Plain(Cubed):
    """A class of a user's that says the law anew: it is what it says, about the deviation alone."""

    law_key = "plain"

    def evaluate_law(self, x, data):
        return np.array([-data[0] * x[0] - data[1] * x[1]])


def plant():
    return Plant(
        lambda x, u, d, p: np.array([u[0] - 0.5 * x[0]]),
        lambda x, u, p: x[:1],
        ("x",),
        ("u",),
        outputs=("x",),
    )


def commands(t):
    wave = 1.0 + 0.4 * np.sin(2.0 * t)
    return np.stack([wave, 0.8 * np.cos(2.0 * t) + 0.5 * wave], axis=-1)


@pytest.mark.quick_cases(2)
@pytest.mark.oracle
@pytest.mark.parametrize("threshold", [controller.ONE_TRACE, 0])
@pytest.mark.parametrize("estimated", [False, True])
def test_the_reference_of_the_sample_reaches_the_law(monkeypatch, threshold, estimated):
    monkeypatch.setattr(controller, "ONE_TRACE", threshold)
    law = Cubed()
    ukf = UnscentedKalmanFilter(plant(), H, 1e-4, 1e-4, [0.5], 1e-2) if estimated else None
    run = Loop(plant(), Controller(law, ukf, H, moving=True, latency=0)).run(
        commands, duration=2.0, initial_state=[0.2]
    )
    s, integral, before = run.signals, 0.0, None
    used = s["estimate"] if estimated else s["state"]
    for x, position, r, u in zip(used[:, 0], s["state"][:, 0], s["reference"], s["input"]):
        error = position - r[0]
        integral += 0.0 if before is None else 0.5 * H * (before + error)
        k = -3.0 * (x**3 - r[0] ** 3) - 2.0 * integral - 0.1 * r[1] * (x - r[0])
        np.testing.assert_allclose(u, [r[1] + k], atol=1e-10)
        before = error
    assert np.abs(s["reference"][:, 0] - 0.5).max() > 0.3


def test_without_a_moving_reference_it_acts_about_its_own_point():
    law = Cubed()
    step = Controller(law, None, H)
    x = np.array([0.9])
    expected = 0.25 + law.evaluate_law(np.array([0.4, 0.0]), law.law_data)
    np.testing.assert_allclose(step.step(x, 0.7), expected, rtol=1e-13)
    moving = Controller(law, None, H, moving=True)
    np.testing.assert_allclose(moving.step(x), expected, rtol=1e-13)  # the operating point is the reference


def test_a_law_said_anew_is_not_taken_for_what_it_came_from():
    moving = Controller(Plain(), None, H, moving=True)
    np.testing.assert_allclose(moving.step([1.3], [1.0, 0.6]), [0.6 - 3.0 * 0.3], rtol=1e-13)
    assert not moving.law.depends_on_reference
    assert Controller(Cubed(), None, H, moving=True).law.depends_on_reference


@pytest.mark.parametrize("threshold", [controller.ONE_TRACE, 0])
def test_it_takes_over_bumplessly_about_a_moving_reference(monkeypatch, threshold):
    monkeypatch.setattr(controller, "ONE_TRACE", threshold)
    law, x, r, last = Cubed(), np.array([1.3]), np.array([1.0, 0.6]), np.array([0.35])
    step = Controller(law, None, H, moving=True, start="bumpless")
    step.reset(input=last)
    np.testing.assert_allclose(step.step(x, r), last, atol=1e-12)
    integral = (0.6 - 3.0 * (1.3**3 - 1.0) - 0.1 * 0.6 * 0.3 - 0.35) / 2.0  # k = u_last − u_d, solved for e
    error = 0.5 * H * ((1.3 - 1.0) + (1.2 - 1.0))
    expected = 0.6 - 3.0 * (1.2**3 - 1.0) - 0.1 * 0.6 * 0.2 - 2.0 * (integral + error)
    np.testing.assert_allclose(step.step([1.2], r), [expected], atol=1e-12)


@pytest.mark.parametrize("threshold", [controller.ONE_TRACE, 0])
def test_of_several_the_active_one_is_given_the_reference(monkeypatch, threshold):
    monkeypatch.setattr(controller, "ONE_TRACE", threshold)
    near, far = Cubed(), Cubed(7.0, 1.0)
    far.operating_point = np.array([2.0, 0.0])
    for x_d, law in ((0.6, near), (1.9, far)):
        step = Controller(Schedule([near, far]), None, H, moving=True)
        r, x = np.array([x_d, 0.6]), np.array([x_d + 0.3])
        k = law.evaluate_about(np.array([0.3, 0.0]), r[:1], r[1:], law.law_data)
        np.testing.assert_allclose(step.step(x, r), r[1:] + k, rtol=1e-12)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("several", [False, True])
def test_composed_or_not_a_run_that_begins_bumplessly_is_the_same(monkeypatch, several):
    near, far, runs = Cubed(), Cubed(7.0, 1.0), []
    far.operating_point = np.array([0.9, 0.0])
    law = Schedule([near, far]) if several else near
    for threshold in (controller.ONE_TRACE, 0):
        monkeypatch.setattr(controller, "ONE_TRACE", threshold)
        step = Controller(law, None, H, moving=True, start="bumpless")
        run = Loop(plant(), step).run(commands, duration=1.0, initial_state=[0.2], initial_input=[0.3])
        runs.append(run.signals["input"])
    np.testing.assert_allclose(runs[1], runs[0], atol=1e-12)
    np.testing.assert_allclose(runs[0][0], 0.3, atol=1e-12)
