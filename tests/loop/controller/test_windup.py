"""Inputs without limits: a sensor that sticks does not wind the integrals up, and commands far away are reached."""

import math

import numpy as np
import pytest
from tests.builders import pairs

import flexhinf as fh
from flexhinf.baselines import lqr
from flexhinf.loop.controller import controller as controller_module
from flexhinf.loop.controller.options import Windup
from flexhinf.loop.simulation.program import rk4_function
from flexhinf.plant import BlackBox

# Kernels that run once each: 1 s instead of 2 s.
pytestmark = pytest.mark.usefixtures("unoptimised")

ARM = fh.paper_arm()


def ukf(mean=(0.0, 0.0, 0.0, 0.0)):
    return fh.UnscentedKalmanFilter(ARM.plant(), 1e-3, [0, 0, 1e-4, 1e-4], 1e-7, mean, 1e-4)


class Stuck(BlackBox):
    """The arm, its encoder stuck at what it first showed from `begin` to `end`, s, while a brake holds the link."""

    states = ARM.plant().states

    def __init__(self, begin, end):
        self.begin, self.end, plant = begin, end, ARM.plant()
        self.advance, self.truth = rk4_function(plant), np.concatenate([[2.5e-4], plant.parameters.vector()])
        self.none = np.zeros(3 * len(plant.disturbances))

    def reset(self, initial_state):
        self.x, self.k, self.shown = np.array(initial_state), 0, None

    def step(self, u, disturbance, period):
        self.k += 1
        if not self.begin <= 1e-3 * self.k < self.end:
            for _ in range(4):
                self.x = np.ravel(self.advance(self.x, u, self.none, self.truth).full())

    def output(self):
        if self.begin <= 1e-3 * self.k < self.end:
            self.shown = self.x[:1].copy() if self.shown is None else self.shown
            return self.shown
        return self.x[:1]

    def state(self):
        return self.x


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize(
    ("law", "pose", "limit"),
    pairs([lambda p: fh.linear_law(p, gamma=math.inf), lqr], [None, 0.8], [None, 1e9, (-np.inf, 300.0)]),
)
def test_a_sensor_that_sticks_for_a_minute(law, pose, limit):
    """One radian beside the command: the input stays bounded (a thousand volts without a bound) and comes back; a
    limit that is no limit, or one on one side, changes nothing of that."""
    problem = ARM.problem(pose=pose)
    x, u = problem.operating_point[:4], problem.operating_input
    controller = fh.Controller(law(problem), ukf(x), 1e-3, limit)
    inputs = np.array([controller.step(x[0], x[0] + 1.0)[0] for _ in range(60_000)])
    wound = controller.integrals
    assert np.abs(inputs).max() <= 60.0
    for _ in range(10_000):
        controller.step(x[0], x[0] + 1.0)
    np.testing.assert_array_equal(controller.integrals, wound)  # they stand still
    for k in range(2_000):  # and move back where the error has the other sign
        controller.step(x[0] + 1e-3 * k, x[0] + 1.0)
    assert controller.integrals[0] > wound[0] + 0.4
    assert np.isfinite(u).all()


@pytest.mark.parametrize("held", [
    pytest.param(5.0, marks=pytest.mark.ci("13,000 steps of a black box")),
    pytest.param(60.0, marks=pytest.mark.nightly("held for a minute, not for five seconds")),
])  # fmt: skip
def test_the_loop_recovers_after_a_stuck_sensor(held):
    """The arm is held half a radian before its command, and let go again."""
    controller = fh.Controller(fh.linear_law(ARM.problem(), gamma=math.inf), ukf(), 1e-3)
    run = fh.Loop(Stuck(0.2, 0.2 + held), controller).run(fh.Step(0.5), duration=held + 8.0)
    assert run.status == "completed"
    assert np.abs(run.signals["input"]).max() < 150.0
    assert np.abs(run.tracked("link_position")[-500:] - 0.5).max() < 5e-3


@pytest.mark.ci("runs of 12 s and of three times 6 s")
def test_a_command_far_away_is_reached_and_needs_no_bound():
    """Three turns: the law needs as much of its integrals as that takes, and nothing of a run in reach changes."""
    law = fh.linear_law(ARM.problem(), gamma=math.inf)
    free, huge = (fh.Controller(law, ukf(), 1e-3, limit) for limit in (None, 1e9))
    none = Windup(np.full(1, np.inf), np.zeros((1, 1)), np.zeros((1, 1)))
    unbounded = fh.Controller(law, ukf(), 1e-3, windup=none)
    assert free.mode.bounds_windup
    assert huge.mode.bounds_windup
    assert not unbounded.fresh().mode.bounds_windup
    run = fh.Loop(ARM.plant(), free).run(fh.Quintic(0.0, 6.0 * np.pi, 6.0), duration=12.0, multi_turn=True)
    assert abs(run.tracked("link_position")[-1] - 6.0 * np.pi) < 1e-2
    one, *others = (
        fh.Loop(ARM.plant(), c).run(fh.Step(np.pi), duration=6.0) for c in (free, huge, unbounded)
    )
    for other in others:
        np.testing.assert_array_equal(one.signals["input"], other.signals["input"])


def test_the_bound_is_that_of_the_line_of_equilibria():
    """w and G from equilibria that Newton's method finds a millirad from the operating point."""
    problem = ARM.problem(pose=0.8)
    law, h = fh.linear_law(problem, gamma=math.inf), 1e-4
    windup = fh.Controller(law, ukf(), 1e-3).windup
    (xa, ua), (xb, ub) = (ARM.operating_point(0.8 + side) for side in (-h, h))
    along, held = (xb - xa) / (2.0 * h), (ub - ua) / (2.0 * h)
    slope = np.array([(law.law(d) - law.law(-d)) / 2e-6 for d in 1e-6 * np.eye(5)]).T
    reaction = slope[:, :4] @ along
    np.testing.assert_allclose(windup.line[:, 0], held - reaction, rtol=1e-5)
    travel = np.pi + 0.8
    np.testing.assert_allclose(windup.limit, (np.abs(held) + 0.5 * np.abs(reaction)) * travel, rtol=1e-5)
    assert fh.Controller(law, ukf(), 1e-3, 48.0).mode.bounds_windup is False


def test_a_limit_in_proportion_is_the_bound_itself():
    """From which on it is none: one that lies further from the operating input than w, by either side."""
    problem = ARM.problem(pose=0.8)
    law, rest = fh.linear_law(problem, gamma=math.inf), problem.operating_input[0]
    w = fh.Controller(law, ukf(), 1e-3).windup.limit[0]
    for limit, bounded in (
        (24.0, False), (0.99 * (w - rest), False), (1.01 * (w + rest), True),
        ((-1.0, 0.99 * (w + rest)), False), ((-1.0, 1.01 * (w + rest)), True),
    ):  # fmt: skip
        controller = fh.Controller(law, ukf(), 1e-3, limit)
        assert controller.mode.bounds_windup is bounded
        assert controller.windup.limit[0] == (w if bounded else np.inf)
        assert ("windup_limit" in controller.data.places) is bounded


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("composed", [False, True])
@pytest.mark.parametrize("laws", [1, 2])
def test_it_is_saved_and_the_same_in_pieces(laws, composed, tmp_path, monkeypatch):
    if composed:
        monkeypatch.setattr(controller_module, "ONE_TRACE", -1)
    made = [fh.linear_law(ARM.problem(pose=at), gamma=math.inf) for at in (0.0, 0.8)[:laws]]
    controller = fh.Controller(fh.Schedule(made) if laws > 1 else made[0], ukf(), 1e-3, moving=False)
    controller.save(tmp_path / "controller")
    loaded = fh.load_controller(tmp_path / "controller")
    assert loaded.summary() == controller.summary()
    assert "voltage" in controller.summary()["integral action"]
    for _ in range(3_000):
        np.testing.assert_array_equal(controller.step(0.01, 0.9), loaded.step(0.01, 0.9))
    assert abs(controller.integrals[0]) < 2.5  # of 2.67 without a bound


def test_an_input_with_one_limit_alone_has_the_bound_of_the_line():
    law = fh.linear_law(ARM.problem(pose=0.8), gamma=math.inf)
    free = fh.Controller(law, ukf(), 1e-3).windup
    half = fh.Controller(law, ukf(), 1e-3, (-np.inf, 48.0))
    np.testing.assert_array_equal(half.windup.limit, free.limit)
    assert np.isfinite(free.limit).all()
    assert half.mode.bounds_windup is True


@pytest.mark.parametrize(("limits", "held"), [(None, "rest"), ((-0.25, 1e3), "rest"), ((-1e3, 0.25), 0.25)])
def test_before_the_first_measurement_stands_zero_or_what_holds_the_robot(limits, held):
    """Within the limits, and never a zero with a sign."""
    law = fh.linear_law(ARM.problem(pose=0.8), gamma=math.inf)
    rest = law.operating_input
    assert rest[0] > 0.25
    first = fh.Controller(law, None, 1e-3, limits).first_input
    np.testing.assert_array_equal(first.at(), rest if held == "rest" else [held])
    zero = fh.Controller(law, None, 1e-3, limits, before_first="zero").first_input.at()
    np.testing.assert_array_equal(zero, [0.0])
    assert not np.signbit(zero).any()
