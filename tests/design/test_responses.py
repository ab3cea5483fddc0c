"""Runs from rest to rest: figures of merit again from the trajectory, and runs that end early."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from flexhinf.design.loop_setup import LoopSetup
from flexhinf.design.response import LONGEST, SHORTEST, SLIDE, TURN, default_start, run_length

Benches = Callable[..., LoopSetup]


def by_hand(time: np.ndarray, q: np.ndarray, u: np.ndarray, begin: float, end: float) -> dict[str, float]:
    """The figures of one joint, sample by sample."""
    height, most, last = end - begin, 0.0, None
    for t, value in zip(time, q):
        most = max(most, (value - end) / height)
        if abs(value - end) > 0.02 * abs(height):
            last = t
    way = (q - begin) / height
    rise = [np.interp(level, way[k - 1 : k + 1], time[k - 1 : k + 1])
            for level in (0.1, 0.9) for k in [int(np.argmax(way >= level))]]  # fmt: skip
    tail = [k for k in range(len(q)) if k >= len(q) - int(np.ceil(0.1 * len(q)))]
    return {
        "overshoot_percent": 100.0 * most,
        "settling_time_s": 0.0 if last is None else last,
        "rise_time_s": rise[1] - rise[0],
        "steady_state_error": max(abs(q[k] - end) for k in tail),
        "peak_input": max(abs(v) for v in u),
        "input_noise": float(np.std([u[k] for k in tail])),
    }


@pytest.mark.parametrize(
    ("name", "goal", "start"), [("paper", (np.pi / 2,), (0.0,)), ("cart", (0.1, 0.3), (0.15, -0.1))]
)
def test_figures_of_merit_are_those_of_the_trajectory(
    setup_of: Benches, name: str, goal: tuple[float, ...], start: tuple[float, ...]
) -> None:
    bench = setup_of(name, goal, start)
    response = bench.step(4.0)
    assert response.diverged_at is None
    run = response.run
    for joint, metrics in enumerate(response.metrics):
        wanted = by_hand(
            run.time,
            run.signals["state"][:, joint],
            run.signals["input"][:, joint],
            start[joint],
            goal[joint],
        )
        assert metrics == pytest.approx(wanted, rel=1e-9)
        assert metrics["settling_time_s"] < 4.0
    assert response.positions[0] == pytest.approx(start)
    assert response.positions[-1] == pytest.approx(goal, abs=0.02)


def test_the_step_begins_without_a_jump_of_the_input(setup_of: Benches) -> None:
    """The first input is what holds the robot at the start, whatever the estimator."""
    for estimator in ("ukf", "ekf", "none"):
        bench = setup_of("paper", (np.pi / 2,), (0.4,), estimator=estimator)
        held = bench.robot.operating_point([0.4])[1]
        assert bench.step(0.5).run.signals["input"][0] == pytest.approx(held, rel=2e-3)


def test_a_run_that_leaves_the_numbers_says_when_and_has_no_figures(setup_of: Benches) -> None:
    bench = setup_of(
        "paper", (np.pi / 2,), (0.0,), degree=4, game={"bandwidth": 6.0, "damping": 0.1}, period=0.2
    )
    response = bench.step(20.0)
    assert response.diverged is not None
    assert 0.0 < response.diverged < 20.0
    assert response.diverged == response.run.time[-1]
    assert response.metrics == [{}]


def test_a_default_step_is_small_and_towards_the_middle(robot_of: Callable[[str], Any]) -> None:
    cart = robot_of("cart")
    assert default_start(cart, np.array([0.2, 0.3])) == pytest.approx([0.2 - SLIDE, 0.3 - TURN])
    assert default_start(cart, np.array([-0.2, -0.3])) == pytest.approx([-0.2 + SLIDE, -0.3 + TURN])
    assert default_start(cart, np.array([0.5, -2.5])) == pytest.approx([0.5 - SLIDE, -2.5 + TURN])
    assert default_start(robot_of("paper"), np.array([-1.0])) == pytest.approx([-1.0 - TURN])  # no limits


def test_runs_last_as_long_as_the_slowest_mode_needs() -> None:
    assert run_length(2.0) == 4.0  # eight time constants
    assert run_length(1e3) == SHORTEST
    assert run_length(1e-3) == LONGEST
    assert run_length(0.0) == run_length(-1.0) == LONGEST
