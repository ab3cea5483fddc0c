"""A, B1, B2, C at the operating point, in any units."""

from __future__ import annotations

import numpy as np
import pytest
from tests.refusals import refused_with

from flexhinf.errors import NotStabilisable
from flexhinf.hinf.linear_part import LinearPart


def test_input_is_counted_in_its_own_penalty(random_plant):
    plant = random_plant(np.random.default_rng(0), 3)
    linear = LinearPart.of(plant)
    g2 = plant.g2_parts[0][..., 0]
    assert linear.b2 @ linear.b2.T == pytest.approx(g2 @ np.linalg.solve(plant.r2, g2.T), rel=1e-12)
    assert np.array_equal(linear.a, plant.f_parts[1])
    assert np.array_equal(linear.c, plant.h_parts[1])


def test_scaled_solution_is_the_solution(random_plant):
    linear = LinearPart.of(random_plant(np.random.default_rng(1), 4))
    units = np.array([1e-3, 1.0, 50.0, 1e4])
    other = LinearPart(
        linear.a * units / units[:, None], linear.b1 / units[:, None], linear.b2 / units[:, None],
        linear.c * units, linear.state_names,
    )  # fmt: skip
    hessians = []
    for part in (linear, other):
        solved = part.solved(50.0)
        assert solved is not None
        scaling, _, found = solved
        hessians.append(found.p * scaling.value**2 / np.outer(scaling.state, scaling.state))
    assert hessians[1] == pytest.approx(hessians[0] * np.outer(units, units), rel=1e-9)


def test_unreachable_mode_is_named_in_the_plants_own_terms():
    linear = LinearPart(
        np.diag([-1.0, 2.0]), np.ones((2, 1)), np.array([[1.0], [0.0]]), np.eye(2), ("speed", "heat")
    )
    with refused_with(NotStabilisable, "eigenvalue 2", "'heat'"):
        linear.check()
