"""Corners of Tables 1 and 2 with the coil and the UKF in the loop, over R^v: what each preset withstands."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.analysis import ALL_STATES, VELOCITIES, ProcessNoise, growth_rates
from flexhinf.design import Specification
from flexhinf.design.loop_setup import LoopSetup
from flexhinf.design.weights.choose import DAMPING, choose
from flexhinf.design.resting import resting_loop
from flexhinf.design.tolerances import tolerance_corners
from flexhinf.design.withstand import choose_withstanding
from flexhinf.hinf import solve_hji

START = np.array([0.0])
GOALS = (np.pi / 2, np.pi)


@lru_cache
def setup_of(preset: str, goal: float, measurement_noise: float = 1e-8, **asked: object) -> LoopSetup:
    arm = fh.paper_arm()
    s = Specification(preset=preset, extras=("inductance",), measurement_noise=measurement_noise, **asked)  # type: ignore[arg-type]
    game = choose_withstanding(choose, arm, np.array([goal]), START, s)
    law = solve_hji(game.problem, game.gamma, 4)
    return LoopSetup(arm, s, game.nominal.plant, law, np.array([goal]), START)


@pytest.mark.paper
@pytest.mark.parametrize("goal", GOALS)
@pytest.mark.parametrize("preset", ["damped", "robust"])
def test_no_corner_is_unstable_for_any_process_noise(preset: str, goal: float) -> None:
    bench = setup_of(preset, goal)
    found = tolerance_corners(bench, bench.law)
    assert found is not None
    assert len(found.population) == 400 + 2 * 11 + 1
    assert (found.ratios[0], max(found.ratios)) == (1e-4, 1e12)
    assert found.unstable == found.unstable_anywhere == 0
    assert max(swept.rates.max() for swept in found.swept) < -0.005  # 1/s, not by a hair
    for variance in (1e-6, 1.0):  # R^n, rad²
        other = replace(bench, specification=replace(bench.specification, measurement_noise=variance))
        noises = [ProcessNoise(form, 10.0**k) for form in (ALL_STATES, VELOCITIES) for k in range(-4, 5, 2)]
        for swept in growth_rates(resting_loop(other, bench.law), found.population, noises):
            assert swept.fraction() == 0.0


@pytest.mark.paper
@pytest.mark.parametrize("goal", GOALS)
def test_the_papers_own_weights_do_not_withstand_its_tolerances(goal: float) -> None:
    bench = setup_of("paper", goal)
    found = tolerance_corners(bench, bench.law)
    assert found is not None
    assert found.unstable > 40
    assert found.unstable_anywhere >= found.unstable
    assert found.with_state.fraction() < 0.01


def test_the_loop_as_it_is_has_the_noise_of_the_specification() -> None:
    bench = setup_of("damped", np.pi / 2, torque_noise=1e-5)
    found = tolerance_corners(bench, bench.law)
    assert found is not None
    same = growth_rates(resting_loop(bench, bench.law), found.population, (ProcessNoise(VELOCITIES, 1e-5),))
    np.testing.assert_allclose(found.own.rates, same[0].rates, rtol=1e-9)


def test_what_has_no_tolerances_or_no_estimator_has_nothing_to_sweep() -> None:
    bench = setup_of("damped", np.pi / 2)
    certain = replace(
        bench.robot, parameters=tuple(replace(p, tolerance=0.0) for p in bench.robot.parameters)
    )
    assert tolerance_corners(replace(bench, robot=certain), bench.law) is None
    alone = replace(bench, specification=replace(bench.specification, estimator="none"))
    found = tolerance_corners(alone, bench.law)
    assert found is not None
    assert found.swept == ()
    assert found.own is found.with_state


def test_robust_is_damped_more_until_it_withstands() -> None:
    robust = setup_of("robust", np.pi)
    s = robust.specification
    first = choose(robust.robot, robust.goal, START, s)
    assert first.target is not None
    assert first.target.damping == DAMPING
    plain = replace(robust, law=solve_hji(first.problem, first.gamma, 4))
    found = tolerance_corners(plain, plain.law)
    assert found is not None
    assert found.unstable_anywhere > 0
    told: list[str] = []
    raised = choose_withstanding(choose, robust.robot, robust.goal, START, s, told.append)
    assert raised.target is not None
    assert raised.target.damping > DAMPING
    assert all("unstable over R^v" in text for text in told)


def test_only_robust_is_changed() -> None:
    arm, s = fh.paper_arm(), Specification(preset="damped", damping=0.12, bandwidth=5.0)
    goal = np.array([np.pi])
    once = choose(arm, goal, START, s)
    again = choose_withstanding(choose, arm, goal, START, s)
    assert once.gamma == again.gamma
