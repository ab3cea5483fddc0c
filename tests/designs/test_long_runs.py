"""Thirty seconds of the nonlinear loop at corners of the tolerances say what the eigenvalues say."""

from __future__ import annotations

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.analysis import corner_population
from flexhinf.designs import Specification
from flexhinf.designs.loop_setup import LoopSetup
from flexhinf.designs.problem.presets import choose
from flexhinf.hinf import solve_hji

ARM = fh.paper_arm()
START = np.array([0.0])


def setup_of(preset: str, goal: float, **asked: object) -> LoopSetup:
    s = Specification(preset=preset, extras=("inductance",), **asked)  # type: ignore[arg-type]
    game = choose(ARM, np.array([goal]), START, s)
    law = solve_hji(game.problem, game.gamma, 4)
    return LoopSetup(ARM, s, law, np.array([goal]), START)


def away_from_rest(
    setup: LoopSetup, values: dict[str, object], rest: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Times and distances of the link from the goal in a run of 30 s without noise that begins near the rest."""
    plant = setup.true_plant.with_parameters(**values)
    start = rest[: plant.n].copy()
    start[0] += 1e-5
    run = setup.loop(setup.controller(setup.goal), plant).run(
        duration=30.0, initial_state=start, initial_input=setup.equilibrium(setup.goal)[1]
    )
    return run.time, np.abs(run.signals["state"][:, 0] - setup.goal[0])


def largest(time: np.ndarray, away: np.ndarray, begin: float) -> float:
    return float(away[(time > begin) & (time <= begin + 5.0)].max())


@pytest.mark.ci("runs of thirty seconds")
@pytest.mark.parametrize(
    ("preset", "goal"),
    [
        ("paper", np.pi / 2),
        ("damped", np.pi),
        *(
            pytest.param(*case, marks=pytest.mark.nightly("other presets and goals"))
            for case in (("paper", np.pi), ("damped", np.pi / 2), ("robust", np.pi / 2), ("robust", np.pi))
        ),
    ],
)
def test_growth_in_the_run_is_that_of_the_eigenvalues(preset: str, goal: float) -> None:
    setup = setup_of(preset, goal)
    population = corner_population(ARM.corner, len(ARM.uncertain), 60)
    modes = setup.equilibrium_loop().modes(population.values)
    order = np.argsort(modes.rate)
    for k in (order[0], order[len(order) // 2], order[-2], order[-1]):
        rate = modes.rate[k]
        time, away = away_from_rest(setup, population.values[k], modes.equilibrium[k])
        if rate < -0.7:  # at rest long before the end
            assert largest(time, away, 25.0) < 1e-6 * largest(time, away, 0.0)
            continue
        later = 10.0 + min(15.0, 8.0 / abs(rate))
        found = np.log(largest(time, away, later) / largest(time, away, 10.0)) / (later - 10.0)
        assert found == pytest.approx(rate, abs=0.03 + 0.1 * abs(rate)), population.describe(int(k))
    assert bool(np.all(modes.stable)) == (preset != "paper")
