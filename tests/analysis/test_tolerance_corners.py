"""Corners and draws, and what they do to loops."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.analysis.conftest import dense_system, designed, filter_of, whole_jacobian
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.analysis import (
    FORMS,
    LINK_VELOCITIES,
    MOTOR_VELOCITIES,
    EquilibriumLoop,
    GrowthRates,
    Population,
    ProcessNoise,
    ToleranceBox,
    corner_population,
    corners,
    growth_rates,
    standard_noises,
    tolerance_corners,
)
from flexhinf.errors import InvalidInput
from flexhinf.hinf import HJISolution
from flexhinf.processors import limited_threads
from flexhinf.robot import Robot

PERIOD = 1e-3


def test_few_numbers_have_all_their_corners() -> None:
    found = corners(4, 16)
    assert {tuple(row) for row in found} == {
        tuple(row) for row in np.array(np.meshgrid(*[[-1, 1]] * 4)).reshape(4, -1).T
    }
    assert corners(0, 5).shape == (1, 0)


def test_many_numbers_have_random_ones_that_a_seed_repeats() -> None:
    found = corners(40, 300, seed=7)
    assert found.shape == (300, 40)
    assert set(found.ravel()) == {-1.0, 1.0}
    assert np.array_equal(found, corners(40, 300, seed=7))
    assert not np.array_equal(found, corners(40, 300, seed=8))
    assert np.abs(found.mean(axis=0)).max() < 0.3


def test_a_population_of_a_robot_with_arrays(two_link: Robot) -> None:
    plants = corner_population(two_link.corner, len(two_link.uncertain), 20, 3, two_link.draw, 5)
    p = len(two_link.uncertain)
    assert [int((plants.kinds == kind).sum()) for kind in ("draw", "corner", "single", "nominal")] == [
        5,
        20,
        2 * p,
        1,
    ]
    assert len(plants) == 26 + 2 * p == len(plants.values) == len(plants.signs)
    assert np.isnan(plants.signs[:5]).all()
    for k in (7, 25 + 3, len(plants) - 1):
        expected = two_link.corner(plants.signs[k].tolist())
        assert all(np.array_equal(plants.values[k][name], value) for name, value in expected.items())
    assert plants.describe(len(plants) - 1) == "nominal"
    stiff = next(k for k, u in enumerate(two_link.uncertain) if u.name == "stiffness_elbow")
    assert plants.describe(25 + 2 * stiff) == "stiffness 2 -12 %"


@pytest.mark.oracle
def test_shares_are_those_of_single_loops(arm: Robot, cubic: HJISolution) -> None:
    plants = corner_population(arm.corner, len(arm.uncertain), 10, 0)
    plant, filter = arm.plant(inductance=True), filter_of(arm.plant(), np.zeros(4), noise=(1e-6, 1e-6))
    loop = EquilibriumLoop(cubic, filter, plant, PERIOD, math.pi)
    noises = (None, ProcessNoise("all states", 1e-4), None, ProcessNoise("velocities only", 1e-4))
    with limited_threads(1):
        swept = growth_rates(loop, plants, noises)
    with limited_threads(2):  # which share what is behind the first
        shared = growth_rates(loop, plants, noises)
    assert np.array_equal([found.rates for found in shared], [found.rates for found in swept])
    for found in swept:
        q = found.noise.covariance(filter.plant.states) if found.noise else 1e-6
        own = EquilibriumLoop(
            cubic, filter_of(arm.plant(), np.zeros(4), noise=(q, 1e-6)), plant, PERIOD, math.pi
        )
        assert np.allclose(found.rates[:4], own.modes(plants.values[:4]).rate, rtol=1e-6, atol=1e-9)
        assert found.share() == np.mean(found.rates >= 0.0)
        assert found.share("corner") == np.mean(found.rates[:10] >= 0.0)
        assert found.rates[found.worst] == found.rates.max()
    assert math.isnan(swept[0].share("draw"))
    assert len({found.share() for found in swept}) > 1  # it does depend on R^v


def test_process_noise_by_its_form() -> None:
    states = ("link_position_a", "link_velocity_a", "motor_velocity")
    assert np.array_equal(ProcessNoise("velocities only", 2.0).covariance(states), np.diag([0.0, 2.0, 2.0]))
    assert np.array_equal(ProcessNoise("all states", 2.0).covariance(states), 2.0 * np.eye(3))
    assert np.array_equal(ProcessNoise(LINK_VELOCITIES, 1.0).covariance(states), np.diag([0.0, 1.0, 0.0]))
    assert np.array_equal(ProcessNoise(MOTOR_VELOCITIES, 1.0).covariance(states), np.diag([0.0, 0.0, 1.0]))
    with pytest.raises(InvalidInput, match="velocity"):
        ProcessNoise("velocities only", 1.0).covariance(("position",))
    for form, q in (("some", 1.0), ("all states", -1.0), ("all states", math.nan)):
        with pytest.raises(InvalidInput, match=f"noise(.|\n)*{form!r} and {q}"):
            ProcessNoise(form, q)
    with pytest.raises(InvalidInput, match="counted"):
        corners(-1, 4)


def test_the_true_state_has_no_process_noise(arm: Robot, cubic: HJISolution) -> None:
    plants = corner_population(arm.corner, len(arm.uncertain), 2)
    loop = EquilibriumLoop(cubic, None, arm.plant(), PERIOD)
    assert growth_rates(loop, plants)[0].share() == 0.0
    with refused_with(InvalidInput, "filter", "NoneType"):
        growth_rates(loop, plants, [ProcessNoise("all states", 1.0)])


def loop_of(arm: Robot, law: HJISolution, goal: float = math.pi / 2, **options: int) -> EquilibriumLoop:
    filter = filter_of(arm.plant(), np.zeros(4), "ukf", (1e-7 * np.diag([0.0, 1.0, 0.0, 1.0]), 1e-8))
    return EquilibriumLoop(law, filter, arm.plant(inductance=True), PERIOD, goal, **options)


def test_all_corners_are_computed_whatever_the_seed(arm: Robot, cubic: HJISolution) -> None:
    """400 drawn ones were 151 unstable from one route and 160 from another."""
    loop = loop_of(arm, cubic)
    first, second = (tolerance_corners(loop, arm.corner, arm.uncertain, (), seed=seed) for seed in (0, 7))
    assert first.complete
    assert first.count == 2048 == len(first.designed.rates)
    assert np.array_equal(first.designed.rates, second.designed.rates)
    assert 0 < first.unstable < 2048
    assert first.unstable == int((loop.modes(first.population.values[:-1]).rate >= 0.0).sum())
    assert first.describe().count("%") == 11
    assert first.designed.rates[first.worst] == first.designed.fastest
    assert len(repr(first)) < 100


@pytest.mark.ci("all 2048 corners, four times")
@pytest.mark.oracle
@pytest.mark.parametrize("delay", [0, 1, 6, 60])
def test_the_worst_corner_grows_as_the_traced_loop_there(arm: Robot, cubic: HJISolution, delay: int) -> None:
    """The batch against the traced step of the compiled loop; with a delay, against the linear loop of one plant."""
    loop = loop_of(arm, cubic, delay=delay, latency=0)
    found = tolerance_corners(loop, arm.corner, arm.uncertain, ())
    plain = loop_of(arm, cubic, latency=0)
    for k in (found.worst, int(np.argmin(found.designed.rates))):
        values = found.population.values[k]
        z = plain.modes([values]).equilibrium[0]
        _, one = whole_jacobian(plain, z, values)
        linear = loop.linear(values)
        expected = np.abs(dense_system(linear).multipliers).max()
        if not delay:
            expected = np.abs(np.linalg.eigvals(one)).max()
        assert found.designed.rates[k] == pytest.approx(math.log(expected) / PERIOD, abs=1e-5)


@pytest.mark.ci("sweeps 2048 corners over four dozen levels of the noise")
def test_the_estimators_noise_is_named_and_swept(arm: Robot) -> None:
    """A damped law: stable at all corners as designed, not with noise on the link's torque alone."""
    weights = {"link_position": 60.0, "link_position_integral": 300.0, "joint_torque_rate": 3e-3}
    law = designed(arm, ratio=1.5, penalty=fh.Penalty(weights, effort=10.0), pose=[math.pi / 2])
    loop = loop_of(arm, law)
    found = tolerance_corners(loop, arm.corner, arm.uncertain)
    assert found.forms == FORMS
    assert found.measurement_noise == 1e-8
    assert {swept.noise for swept in found.swept} >= set(standard_noises(loop))
    for form in FORMS:
        by_ratio = found.of_form(form)
        assert len(by_ratio) >= 9
        stable = [ratio for ratio, rates in by_ratio.items() if not rates.unstable]
        assert found.stable_ratios(form) == tuple(stable)
        assert (form in found.retunable) == (len(stable) == len(by_ratio))
    # One of the sweep's entries is the loop with that filter.
    other = found.of_form(LINK_VELOCITIES)[1e2]
    assert other.unstable > 500
    filter = filter_of(arm.plant(), np.zeros(4), "ukf", (other.noise.covariance(arm.plant().states), 1e-8))
    again = EquilibriumLoop(law, filter, arm.plant(inductance=True), PERIOD, math.pi / 2)
    assert tolerance_corners(again, arm.corner, 11, ()).unstable == other.unstable


@pytest.mark.ci("looks for the edge of 2048 corners")
def test_the_tolerances_may_grow_by_a_factor(arm: Robot, cubic: HJISolution) -> None:
    """At 0.99 of it no corner is unstable, at 1.01 some are; the paper's law stands less than its tolerances."""
    loop = loop_of(arm, cubic)
    scale, corner = ToleranceBox.of(loop, arm.corner, arm.uncertain).edge(loop)
    assert 0.0 < scale < 1.0
    signs = corners(11, 2048)
    for factor, some in ((0.99, False), (1.01, True)):
        rates = loop.modes([arm.corner((factor * scale * row).tolist()) for row in signs]).rate
        assert bool((rates >= 0.0).any()) == some
        assert not some or rates[corner] >= 0.0
    fed = EquilibriumLoop(cubic, None, arm.plant(), PERIOD)
    assert ToleranceBox.of(fed, arm.corner, arm.uncertain).edge(fed)[0] > 1.0
    assert ToleranceBox.of(fed, arm.corner, arm.uncertain).edge(fed, most=1.0) == (math.inf, -1)


def test_three_tolerances_may_grow_by_a_factor(
    arm: Robot, cubic: HJISolution, only_uncertain: Callable[..., Robot]
) -> None:
    """As above: up to it no corner is unstable, beyond it the one that is named."""
    few, loop = only_uncertain(arm, "stiffness", "mass", "friction"), loop_of(arm, cubic)
    scale, corner = ToleranceBox.of(loop, few.corner, few.uncertain).edge(loop)
    signs = corners(3, 8)
    below, above = (
        loop.modes([few.corner((factor * scale * row).tolist()) for row in signs]).rate
        for factor in (0.99, 1.01)
    )
    assert 0.0 < scale < math.inf
    assert below.max() < 0.0 <= above[corner]


def test_many_numbers_are_sampled_and_said_to_be(two_link: Robot, two_link_law: HJISolution) -> None:
    loop = EquilibriumLoop(two_link_law, None, two_link.plant(), PERIOD)
    found = tolerance_corners(loop, two_link.corner, two_link.uncertain)
    assert not found.complete
    assert found.count == 400
    assert found.swept == () == found.forms
    again = tolerance_corners(loop, two_link.corner, two_link.uncertain, seed=0)
    assert np.array_equal(found.designed.rates, again.designed.rates)


@pytest.mark.parametrize(("nominal", "factor"), [(-0.5, (0.5, 1)), (-30.0, (math.inf, -1)), (0.0, (0.0, -1)),
                                                 (0.5, (0.0, -1))])  # fmt: skip
def test_a_loop_that_grows_slowly_has_no_room_for_tolerances(
    nominal: float, factor: tuple[float, int]
) -> None:
    """A loop whose rate of growth is its only number less 40: the second corner is at its edge first."""
    loop: Any = SimpleNamespace(modes=lambda numbers, noise: SimpleNamespace(rate=numbers[:, 0] - 40.0))
    box = ToleranceBox(None, np.array([40.0 + nominal]), np.array([[-1.0], [1.0], [0.3]]))  # type: ignore[arg-type]
    assert box.edge(loop) == pytest.approx(factor, rel=1e-3)


def test_a_noise_between_two_of_the_grid_with_which_the_loop_grows_faster_is_taken_too(
    arm: Robot, cubic: HJISolution, only_uncertain: Callable[..., Robot], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Growth by the noise's level alone, with one peak for one form, between two levels of the grid."""
    few, loop, form = only_uncertain(arm, "mass"), loop_of(arm, cubic), FORMS[-1]
    levels = sorted(noise.q for noise in standard_noises(loop) if noise.form == form)
    peak = math.sqrt(levels[2] * levels[3])

    def growth(noise: ProcessNoise | None) -> float:
        at = math.inf if noise is None or noise.form != form else abs(math.log10(noise.q / peak))
        return -1.0 + 0.5 * math.exp(-50.0 * at**2)

    def rates(
        _: object, population: Population, noises: Any = (None,), plants: Any = None, **__: object
    ) -> tuple[GrowthRates, ...]:
        chosen = np.arange(len(population)) if plants is None else plants
        kinds = population.kinds[chosen]
        return tuple(GrowthRates(n, np.full(len(chosen), growth(n)), kinds, chosen) for n in noises)

    monkeypatch.setattr(importlib.import_module("flexhinf.analysis.corners"), "growth_rates", rates)
    found = tolerance_corners(loop, few.corner, few.uncertain)
    grid = set(standard_noises(loop))
    (between,) = (swept.noise for swept in found.swept if swept.noise not in grid)
    assert between is not None
    assert between.form == form
    assert between.q == pytest.approx(peak, rel=0.4)
