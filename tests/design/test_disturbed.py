"""Torques on the links: against a linear simulation, and figures of merit again from the trajectory."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.linalg import expm

from flexhinf.design.loop_setup import LoopSetup
from flexhinf.design.disturbed import Disturbed, default_load, disturbed_response
from flexhinf.design.modes import closed_loop
from flexhinf.design.response import Response
from flexhinf.hinf import HJISolution

Benches = Callable[..., LoopSetup]


@pytest.mark.oracle
@pytest.mark.parametrize(
    ("name", "goal", "load"),
    [("paper", (np.pi / 2,), (0.02,)), ("planar-two-link", (0.4, 0.6), (0.03, -0.01))],
)
def test_a_small_torque_moves_the_links_as_the_linear_loop(
    setup_of: Benches, name: str, goal: tuple[float, ...], load: tuple[float, ...]
) -> None:
    """ẋ = (A + B K) x + G d from the torque's beginning on, by the matrix exponential."""
    bench = setup_of(name, goal, estimator="none", period=1e-4)
    assert isinstance(bench.law, HJISolution)
    found = disturbed_response(bench, np.array(load), 2.0)
    problem = bench.robot.problem(bench.law.problem.penalty, pose=goal)  # type: ignore[union-attr]
    a, n = closed_loop(problem, bench.law.gain), len(goal)
    g = bench.model.linearise(*bench.robot.operating_point(goal))[2][:, :n] @ load
    step = 1e-2
    whole = np.zeros((len(a) + 1, len(a) + 1))
    whole[: len(a), : len(a)], whole[: len(g), -1] = a, g
    one, x, wanted = expm(step * whole), np.append(np.zeros(len(a)), 1.0), []
    for _ in range(180):
        wanted.append(x[:n])
        x = one @ x
    first = int(np.searchsorted(found.response.run.time, found.at - 1e-9))
    moved = found.response.positions[first : first + 18_000 : 100] - np.array(goal)
    assert found.at == pytest.approx(0.2)
    assert np.abs(moved - np.array(wanted)).max() < 0.01 * np.abs(wanted).max()
    assert np.abs(found.response.positions[: first + 1] - np.array(goal)).max() < 1e-9


def test_figures_of_merit_are_those_of_the_trajectory(setup_of: Benches) -> None:
    bench = setup_of("cart", (0.1, 0.3))
    found = disturbed_response(bench, np.array([30.0, 0.5]), 4.0)
    time, q = found.response.run.time, found.response.run.signals["state"][:, :2]
    for joint, metrics in enumerate(found.metrics):
        away = [abs(v - bench.goal[joint]) for t, v in zip(time, q[:, joint]) if t >= found.at]
        after = [t for t in time if t >= found.at]
        back = max(t for t, v in zip(after, away) if v > 0.05 * max(away)) - found.at
        assert metrics["peak_deviation"] == max(away)
        assert metrics["recovery_time_s"] == pytest.approx(back)
        assert metrics["remaining"] == max(away[-(len(away) // 10) :])
        assert metrics["load"] == (30.0, 0.5)[joint]
        assert metrics["remaining"] < 0.05 * metrics["peak_deviation"]  # integrals: nothing remains


def test_what_does_not_come_back_is_not_said_to(setup_of: Benches) -> None:
    """Looked at before the integrals had the time."""
    found = disturbed_response(setup_of("cart", (0.1, 0.3)), np.array([30.0, 0.5]), 0.1)
    assert [metrics["recovery_time_s"] for metrics in found.metrics] == [None, None]


def test_a_run_that_diverges_has_no_figures(setup_of: Benches) -> None:
    bench = setup_of("cart", (0.1, 0.3))
    run = disturbed_response(bench, np.array([30.0, 0.5]), 0.1).response.run
    broken = Response(run, bench.goal, bench.goal, 0.1)
    assert Disturbed(broken, np.array([30.0, 0.5]), 0.01).metrics == [{}, {}]


def test_the_default_load_is_a_tenth_of_what_the_motors_gave() -> None:
    per_input, peak = np.array([0.9, -2.0, 4.0]), np.array([20.0, 5.0, 0.1])
    assert default_load(per_input, peak) == pytest.approx(
        [1.8, -1.0, 0.8]
    )  # the third: a tenth of the largest peak
