"""Corners and draws, and what they do to loops."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from flexhinf.analysis import EquilibriumLoop, ProcessNoise, corner_population, corners, unstable_share
from flexhinf.errors import InvalidInput
from flexhinf.hinf import HJISolution
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
def test_shares_are_those_of_single_loops(made: SimpleNamespace, arm: Robot, cubic: HJISolution) -> None:
    plants = corner_population(arm.corner, len(arm.uncertain), 10, 0)
    plant, filter = arm.plant(inductance=True), made.filter(arm.plant(), np.zeros(4), noise=(1e-6, 1e-6))
    loop = EquilibriumLoop(cubic, filter, plant, PERIOD, math.pi)
    noises = (None, ProcessNoise("all states", 1e-4), ProcessNoise("velocities only", 1e-4))
    swept = unstable_share(loop, plants, noises)
    for found in swept:
        q = found.noise.covariance(filter.plant.states) if found.noise else 1e-6
        own = EquilibriumLoop(
            cubic, made.filter(arm.plant(), np.zeros(4), noise=(q, 1e-6)), plant, PERIOD, math.pi
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
    with pytest.raises(InvalidInput, match="velocity"):
        ProcessNoise("velocities only", 1.0).covariance(("position",))
    for form, q in (("some", 1.0), ("all states", -1.0), ("all states", math.nan)):
        with pytest.raises(InvalidInput, match="not known"):
            ProcessNoise(form, q)
    with pytest.raises(InvalidInput, match="counted"):
        corners(-1, 4)


def test_the_true_state_has_no_process_noise(arm: Robot, cubic: HJISolution) -> None:
    plants = corner_population(arm.corner, len(arm.uncertain), 2)
    loop = EquilibriumLoop(cubic, None, arm.plant(), PERIOD)
    assert unstable_share(loop, plants)[0].share() == 0.0
    with pytest.raises(InvalidInput, match="no filter"):
        unstable_share(loop, plants, [ProcessNoise("all states", 1.0)])
