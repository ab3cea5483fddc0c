"""The step of robots within their tolerances: reproducible, each the robot it is told to be, none left out."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_are

import flexhinf as fh
from flexhinf.design.loop_setup import LoopSetup
from flexhinf.design.draws import Draws, drawn_steps

Benches = Callable[..., LoopSetup]
STEPS = 3


@pytest.fixture(scope="module")
def bench(setup_of: Benches) -> LoopSetup:
    return setup_of("planar-two-link", (0.4, 0.6), (0.2, 0.9), seed=3)


@pytest.fixture(scope="module")
def drawn(bench: LoopSetup) -> Draws:
    return drawn_steps(bench, 8, 2.0, STEPS)


def _rows(draws: Draws) -> np.ndarray:
    return np.array([draws.overshoot, draws.settling, draws.peak])


def test_the_same_seed_gives_the_same_and_another_seed_others(bench: LoopSetup, drawn: Draws) -> None:
    again = drawn_steps(bench, 8, 2.0, STEPS)
    assert np.array_equal(_rows(again), _rows(drawn))
    fewer = drawn_steps(bench, 3, 2.0, STEPS)
    assert np.array_equal(_rows(fewer), _rows(drawn)[:, :3])
    other = drawn_steps(replace(bench, specification=replace(bench.specification, seed=4)), 3, 2.0, STEPS)
    assert not np.any(_rows(other)[2] == _rows(drawn)[2, :3])


@pytest.mark.parametrize("threads", [1, 5])
def test_threads_do_not_matter(
    bench: LoopSetup, drawn: Draws, threads: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(importlib.import_module("flexhinf.design.draws"), "THREADS", threads)
    assert np.array_equal(_rows(drawn_steps(bench, 8, 2.0, STEPS)), _rows(drawn))


@pytest.mark.parametrize("k", [0, 5])
def test_each_is_the_robot_of_its_values_run_by_hand(bench: LoopSetup, drawn: Draws, k: int) -> None:
    """A controller and a loop of our own round the plant of these parameters, resting at the start by its own input."""
    values = drawn.values[k]
    x, u = bench.robot.operating_point(bench.start, parameters=values)
    model_rest = bench.robot.operating_point(bench.start)[0]
    noise = np.array([0.0, 1e-7, 0.0, 1e-7]).repeat(2)
    a, _, _, c = bench.robot.plant().linearise(*bench.robot.operating_point(bench.goal))
    belief = solve_discrete_are(expm(1e-3 * a).T, c.T, np.diag(noise), 1e-8 * np.eye(len(c)))
    ukf = fh.UnscentedKalmanFilter(bench.robot.plant(), 1e-3, np.diag(noise), 1e-8, model_rest, belief)
    controller = fh.Controller(bench.law, ukf, 1e-3, start="bumpless")
    plant = bench.robot.plant().with_parameters(**values)
    run = fh.Loop(plant, controller, STEPS).run(
        noise=1e-4, duration=2.0, initial_state=x, initial_input=u, seed=3 + 1 + k
    )
    assert drawn.peak[k] == pytest.approx(np.abs(run.signals["input"]).max(), rel=1e-6)
    overshoot, settled = [], []
    for joint, (begin, end) in enumerate(zip(bench.start, bench.goal)):
        q = run.signals["state"][:, joint]
        overshoot.append(max(0.0, 100.0 * ((q - end) / (end - begin)).max()))
        settled.append(run.time[np.abs(q - end) > 0.02 * abs(end - begin)].max())
    assert drawn.overshoot[k] == pytest.approx(max(overshoot), rel=1e-6, abs=1e-9)
    assert drawn.settling[k] == pytest.approx(max(settled))


def test_values_are_drawn_uniformly_within_the_tolerances(bench: LoopSetup, drawn: Draws) -> None:
    low, high = bench.robot.corner([-1.0] * len(bench.robot.uncertain)), None
    high = bench.robot.corner([1.0] * len(bench.robot.uncertain))
    seen = np.array([values["stiffness"] for values in drawn.values])
    assert np.all((low["stiffness"] <= seen) & (seen <= high["stiffness"]))
    assert len(np.unique(seen[:, 0])) == len(drawn) == 8


def test_what_diverges_or_does_not_settle_is_counted(
    robot_of: Callable[[str], Any], setup_of: Benches
) -> None:
    """Sampled so slowly, and so uncertain, that some robots bear it and some do not."""
    made = setup_of(
        "paper", (np.pi / 2,), (0.0,), degree=4, game={"bandwidth": 6.0, "damping": 0.1},
        period=0.08, estimator="none",
    )  # fmt: skip
    wide = [replace(p, tolerance=5.0 * p.tolerance) for p in robot_of("paper").parameters]
    draws = drawn_steps(replace(made, robot=replace(robot_of("paper"), parameters=tuple(wide))), 40, 40.0, 30)
    assert len(draws) == 40
    assert draws.diverged == sum(value == np.inf for value in draws.overshoot)
    assert draws.unsettled == sum(value == np.inf for value in draws.settling)
    assert 0 < draws.diverged <= draws.unsettled < 40
    assert draws.diverged == sum(value == np.inf for value in draws.peak)
    assert not np.any(np.isnan(_rows(draws)))
    ended = np.isnan(draws.positions).any(axis=(1, 2))
    assert np.array_equal(ended, draws.overshoot == np.inf)


def test_the_kept_positions_are_those_of_the_runs(bench: LoopSetup) -> None:
    kept = drawn_steps(bench, 2, 2.0, STEPS)
    assert kept.positions.shape == (2, len(kept.time), 2)
    assert len(kept.time) <= 400
    assert kept.positions[:, 0] == pytest.approx(np.array([bench.start, bench.start]))
    for k in range(2):
        q = kept.positions[k]
        over = max(((q[:, j] - bench.goal[j]) / (bench.goal[j] - bench.start[j])).max() for j in range(2))
        assert 100.0 * over <= kept.overshoot[k] + 1e-9
        assert 100.0 * over == pytest.approx(kept.overshoot[k], abs=0.05)


def test_progress_is_told_ten_times(bench: LoopSetup) -> None:
    told: list[str] = []
    drawn_steps(bench, 20, 0.05, STEPS, tell=told.append)
    assert told == [f"robots within the tolerances: {k} of 20" for k in range(2, 21, 2)]
