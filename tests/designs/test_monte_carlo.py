"""The step of robots within their tolerances: reproducible, each the robot it is told to be, none left out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_are

import flexhinf as fh
from flexhinf.designs.loop_setup import LoopSetup
from flexhinf.designs.monte_carlo import MonteCarlo, judged_runs, sampled_runs
from flexhinf.designs.responses import sample_robots
from flexhinf.processors import limited_threads

pytestmark = pytest.mark.ci("weights are searched, kernels compiled, which its tests share")

Benches = Callable[..., LoopSetup]
STEPS = 3


def sampled_steps(
    setup: LoopSetup, count: int, duration: float, sub_steps: int, **options: Any
) -> MonteCarlo:
    """The step of robots sampled with the seed of the specification."""
    robots = sample_robots(setup.robot, count, setup.specification.seed)
    return sampled_runs(setup, robots, duration, sub_steps, **options)


@pytest.fixture(scope="module")
def setup(setup_of: Benches) -> LoopSetup:
    return setup_of("planar-two-link", (0.4, 0.6), (0.2, 0.9), seed=3)


@pytest.fixture(scope="module")
def drawn(setup: LoopSetup) -> MonteCarlo:
    return sampled_steps(setup, 8, 2.0, STEPS)


def _rows(draws: MonteCarlo) -> np.ndarray:
    return np.array([draws.overshoot, draws.settling, draws.peak])


def test_the_same_seed_gives_the_same_and_another_seed_others(setup: LoopSetup, drawn: MonteCarlo) -> None:
    again = sampled_steps(setup, 8, 2.0, STEPS)
    assert np.array_equal(_rows(again), _rows(drawn))
    fewer = sampled_steps(setup, 3, 2.0, STEPS)
    assert np.array_equal(_rows(fewer), _rows(drawn)[:, :3])
    other = sampled_steps(replace(setup, specification=replace(setup.specification, seed=4)), 3, 2.0, STEPS)
    assert not np.any(_rows(other)[2] == _rows(drawn)[2, :3])


def test_threads_do_not_matter(setup: LoopSetup, drawn: MonteCarlo) -> None:
    with limited_threads(5):
        assert np.array_equal(_rows(sampled_steps(setup, 8, 2.0, STEPS)), _rows(drawn))


def test_many_robots_are_the_same_robots_alone(setup: LoopSetup, drawn: MonteCarlo) -> None:
    for k in (0, 7):
        alone = setup.step(2.0, values=drawn.values[k], seed=1 + k, sub_steps=STEPS)
        assert alone.overshoot.value == drawn.overshoot[k]
        assert alone.settling.value == drawn.settling[k]
        assert alone.peak.value == drawn.peak[k]


def test_a_robot_that_settles_after_the_step_is_judged_by_a_longer_run(
    setup: LoopSetup, drawn: MonteCarlo
) -> None:
    """A step that ends before all robots have settled, and before some have: the longer run has their own noise."""
    short = 0.5 * float(drawn.settling.min() + drawn.settling.max())
    for length in (0.9 * float(drawn.settling.min()), short):
        runs = judged_runs(setup, drawn.values, length, STEPS)
        assert runs.unsettled == 0
        late = drawn.settling > length
        assert np.array_equal(runs.settling[late], drawn.settling[late])
        assert len(runs.positions) == 8


@pytest.mark.ci("a kernel for each robot")
@pytest.mark.parametrize("k", [0, 5])
def test_each_is_the_robot_of_its_values_run_by_hand(setup: LoopSetup, drawn: MonteCarlo, k: int) -> None:
    """A controller and a loop of our own round the plant of these parameters, in its equilibrium at the start; the
    controller begins with the input that holds the model there."""
    values = drawn.values[k]
    x, _ = setup.robot.operating_point(setup.start, parameters=values)
    model_rest, u = setup.robot.operating_point(setup.start)
    noise = np.array([0.0, 1e-7, 0.0, 1e-7]).repeat(2)
    a, _, _, c = setup.robot.plant().linearise(*setup.robot.operating_point(setup.goal))
    belief = solve_discrete_are(expm(1e-3 * a).T, c.T, np.diag(noise), 1e-8 * np.eye(len(c)))
    ukf = fh.UnscentedKalmanFilter(setup.robot.plant(), 1e-3, np.diag(noise), 1e-8, model_rest, belief)
    controller = fh.Controller(setup.law, ukf, 1e-3, start="bumpless")
    plant = setup.robot.plant(extras=("joint_damping", "coulomb_friction"), sticking=True).with_parameters(
        **values
    )
    run = fh.Loop(plant, controller, STEPS).run(
        noise=1e-4, duration=2.0, initial_state=x, initial_input=u, seed=3 + 1 + k
    )
    assert drawn.peak[k] == pytest.approx(np.abs(run.signals["input"]).max(), rel=1e-6)
    overshoot, settled = [], []
    for joint, (begin, end) in enumerate(zip(setup.start, setup.goal)):
        q = run.signals["state"][:, joint]
        overshoot.append(max(0.0, 100.0 * ((q - end) / (end - begin)).max()))
        settled.append(run.time[np.abs(q - end) > 0.02 * abs(end - begin)].max())
    assert drawn.overshoot[k] == pytest.approx(max(overshoot), rel=1e-6, abs=1e-9)
    assert drawn.settling[k] == pytest.approx(max(settled))


def test_values_are_drawn_uniformly_within_the_tolerances(setup: LoopSetup, drawn: MonteCarlo) -> None:
    low, high = setup.robot.corner([-1.0] * len(setup.robot.uncertain)), None
    high = setup.robot.corner([1.0] * len(setup.robot.uncertain))
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
    draws = sampled_steps(
        replace(made, robot=replace(robot_of("paper"), parameters=tuple(wide))), 40, 40.0, 30
    )
    assert len(draws) == 40
    assert draws.diverged == sum(value == np.inf for value in draws.overshoot)
    assert draws.unsettled == sum(value == np.inf for value in draws.settling)
    assert 0 < draws.diverged <= draws.unsettled < 40
    assert draws.diverged == sum(value == np.inf for value in draws.peak)
    assert not np.any(np.isnan(_rows(draws)))
    ended = np.isnan(draws.positions).any(axis=(1, 2))
    assert np.array_equal(ended, draws.overshoot == np.inf)


def test_the_kept_positions_are_those_of_the_runs(setup: LoopSetup) -> None:
    kept = sampled_steps(setup, 2, 2.0, STEPS)
    assert kept.positions.shape == (2, len(kept.time), 2)
    assert len(kept.time) <= 400
    assert kept.positions[:, 0] == pytest.approx(np.array([setup.start, setup.start]))
    for k in range(2):
        q = kept.positions[k]
        over = max(((q[:, j] - setup.goal[j]) / (setup.goal[j] - setup.start[j])).max() for j in range(2))
        assert 100.0 * over <= kept.overshoot[k] + 1e-9
        assert 100.0 * over == pytest.approx(kept.overshoot[k], abs=0.05)
