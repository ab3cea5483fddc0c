"""Runs from rest to rest: figures of merit again from the trajectory, and runs that end early."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from flexhinf.analysis.modes import closed_loop
from flexhinf.designs.loop_setup import LoopSetup
from flexhinf.designs.responses import LoadResponse, Response, Worst, worst_of
from flexhinf.hinf import HJISolution

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


@pytest.mark.ci("searches weights, runs a design")
@pytest.mark.parametrize(
    ("name", "goal", "start"), [("paper", (np.pi / 2,), (0.0,)), ("cart", (0.1, 0.3), (0.15, -0.1))]
)
def test_figures_of_merit_are_those_of_the_trajectory(
    setup_of: Benches, name: str, goal: tuple[float, ...], start: tuple[float, ...]
) -> None:
    setup = setup_of(name, goal, start)
    response = setup.step(4.0)
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
        assert metrics.pop("joint") == setup.joints[joint]
        rate = run.signals["state"][:, len(goal) + joint]
        assert metrics.pop("peak_speed") == np.abs(rate).max()
        assert metrics == pytest.approx(wanted, rel=1e-9)
        assert metrics["settling_time_s"] < 4.0
        assert response.peak_inputs[joint] == metrics["peak_input"]
    assert response.positions[0] == pytest.approx(start)
    assert response.positions[-1] == pytest.approx(goal, abs=0.02)


@pytest.mark.ci("searches weights, runs a design")
def test_the_step_begins_without_a_jump_of_the_input(setup_of: Benches) -> None:
    """The first input is what holds the robot at the start, whatever the estimator."""
    for estimator in ("ukf", "ekf", "none"):
        setup = setup_of("paper", (np.pi / 2,), (0.4,), estimator=estimator)
        held = setup.robot.operating_point([0.4])[1]
        assert setup.step(0.5).run.signals["input"][0] == pytest.approx(held, rel=2e-3)


@pytest.mark.ci("a loop of its own")
def test_a_run_that_leaves_the_numbers_says_when_and_has_no_figures(setup_of: Benches) -> None:
    setup = setup_of(
        "paper", (np.pi / 2,), (0.0,), degree=4, game={"bandwidth": 9.0, "damping": 0.1}, period=0.1
    )
    response = setup.step(20.0)
    assert response.diverged_at is not None
    assert 0.0 < response.diverged_at < 20.0
    assert response.diverged_at == response.run.time[-1]
    assert response.metrics == []
    assert response.overshoot == Worst(np.inf, "")


@pytest.mark.ci("searches weights, runs a design")
@pytest.mark.oracle
@pytest.mark.parametrize(
    ("name", "goal", "load"),
    [("paper", (np.pi / 2,), (0.02,)), ("planar-two-link", (0.4, 0.6), (0.03, -0.01))],
)
def test_a_small_torque_moves_the_links_as_the_linear_loop(
    setup_of: Benches, name: str, goal: tuple[float, ...], load: tuple[float, ...]
) -> None:
    """ẋ = (A + B K) x + G d from the torque's beginning on, by the matrix exponential."""
    setup = setup_of(name, goal, estimator="none", period=1e-4)
    assert isinstance(setup.law, HJISolution)
    smooth = {name: 0.0 for name in setup.robot.nominal if name.startswith(("coulomb_friction", "damping"))}
    setup = replace(setup, robot=setup.robot.with_values(smooth))  # the model of the law has neither
    found = setup.load_response(np.array(load), 2.0)
    problem = setup.robot.problem(setup.law.problem.penalty, pose=goal)  # type: ignore[union-attr]
    a, n = closed_loop(problem, setup.law.gain), len(goal)
    g = setup.model.linearise(*setup.robot.operating_point(goal))[2][:, :n] @ load
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


@pytest.mark.ci("searches weights, runs a design")
def test_figures_of_a_load_are_those_of_the_trajectory(setup_of: Benches) -> None:
    setup = setup_of("cart", (0.1, 0.3))
    found = setup.load_response(np.array([30.0, 0.5]), 4.0)
    time, q = found.response.run.time, found.response.run.signals["state"][:, :2]
    for joint, metrics in enumerate(found.metrics):
        away = [abs(v - setup.goal[joint]) for t, v in zip(time, q[:, joint]) if t >= found.at]
        after = [t for t in time if t >= found.at]
        band = 0.02 * abs(setup.goal[joint] - setup.start[joint])  # of the step from start to goal
        back = max(t for t, v in zip(after, away) if v > band) - found.at
        assert metrics["peak_deviation"] == max(away)
        assert metrics["recovery_time_s"] == pytest.approx(back)
        assert metrics["remaining_error"] == pytest.approx(
            max(abs(v - setup.goal[joint]) for v in q[-(len(q) // 10) :, joint])
        )
        assert metrics["load"] == (30.0, 0.5)[joint]
        assert metrics["remaining_error"] < 0.05 * metrics["peak_deviation"]  # integrals: nothing remains


@pytest.mark.ci("searches weights, runs a design")
def test_what_does_not_come_back_is_not_said_to(setup_of: Benches) -> None:
    """Looked at before the integrals had the time."""
    found = setup_of("cart", (0.1, 0.3)).load_response(np.array([30.0, 0.5]), 0.1)
    assert [metrics["recovery_time_s"] for metrics in found.metrics] == [None, None]


@pytest.mark.costs("a run of the arm with its estimator, compiled")
def test_a_loaded_run_that_diverges_has_no_figures(setup_of: Benches) -> None:
    setup = setup_of("paper", (np.pi / 2,), (0.0,))
    run = setup.load_response(np.array([0.5]), 0.1).response.run
    broken = Response(replace(run, diverged_at=0.1), setup.goal, setup.goal, setup.joints)
    assert LoadResponse(broken, np.array([0.5]), 0.01, np.ones(1)).metrics == []


def test_the_worst_of_all_joints_is_named() -> None:
    rows = [{"joint": "a", "x": 1.0}, {"joint": "b", "x": 3.0}, {"joint": "c"}]
    assert worst_of(rows, "x") == Worst(3.0, "b")
    rows[0]["x"] = None  # such as a settling time that is not reached
    assert worst_of(rows, "x") == Worst(np.inf, "a")
    assert worst_of([{"joint": "c"}], "x") == Worst(0.0, "")
    assert worst_of([], "x") == Worst(np.inf, "")
