"""The plant of a robust synthesis: the robot's own, with torques L w beside its disturbances."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from flexhinf.designs.problem.presets import with_channels


@pytest.mark.parametrize("name", ["paper", "cart", "planar-two-link"])
def test_without_w_it_is_the_robot_and_w_enters_as_torques(robot_of: Callable[[str], Any], name: str) -> None:
    rng, plant = np.random.default_rng(0), robot_of(name).plant()
    two, k = len(plant.disturbances), 3
    enter = rng.normal(size=(two, k))
    uncertain = with_channels(plant, enter)
    assert uncertain.states == plant.states
    assert uncertain.inputs == plant.inputs
    assert uncertain.disturbances == (*plant.disturbances, "tolerance_1", "tolerance_2", "tolerance_3")
    for _ in range(5):
        x, u = rng.normal(size=plant.n), rng.normal(size=len(plant.inputs))
        d, w = rng.normal(size=two), rng.normal(size=k)
        still = uncertain.derivative(x, u, np.concatenate([d, np.zeros(k)]))
        assert still == pytest.approx(plant.derivative(x, u, d), rel=1e-12, abs=1e-12)
        moved = uncertain.derivative(x, u, np.concatenate([d, w]))
        assert moved == pytest.approx(plant.derivative(x, u, d + enter @ w), rel=1e-12, abs=1e-12)


def test_where_w_enters_is_a_number_of_the_plant_and_no_code(robot_of: Callable[[str], Any]) -> None:
    """Other scalings compile nothing: L is among the parameters."""
    plant = robot_of("paper").plant()
    one, two = (with_channels(plant, factor * np.eye(2)) for factor in (1.0, 3.0))
    x, u, d = np.array([0.1, 0.2, 0.3, 0.4]), np.array([5.0]), np.array([0.0, 0.0, 0.7, -0.2])
    moved = one.with_parameters(tolerance_channels=3.0 * np.eye(2))
    assert moved.derivative(x, u, d) == pytest.approx(two.derivative(x, u, d), rel=1e-14)
    assert moved.derivative(x, u, d) != pytest.approx(one.derivative(x, u, d), rel=1e-3)
    heavier = one.with_parameters(mass=2.0)
    assert heavier.derivative(x, u, 0 * d) == pytest.approx(
        plant.with_parameters(mass=2.0).derivative(x, u, np.zeros(2)), rel=1e-12
    )
