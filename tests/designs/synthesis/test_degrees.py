"""Choosing the degree by data."""

from __future__ import annotations

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.designs import DegreeChoice, shrinking, try_degrees

WEIGHTS = (70.0, 18.0, 60.0, 18.0, 320.0)
PAPER = (60.0, 0.0, 0.0, 0.0, 300.0)


def choices_at(goal: float, **options: object) -> list[DegreeChoice]:
    problem = fh.paper_arm().problem(fh.Penalty(WEIGHTS, effort=10.0), pose=(goal,))
    return list(try_degrees(problem, (2, 4), checked_penalty=PAPER, rays=800, **options))  # type: ignore[arg-type]


@pytest.mark.ci("samples two regions")
def test_a_higher_degree_allows_a_larger_step_at_90_degrees() -> None:
    linear, cubic = choices_at(np.pi / 2)
    assert linear.step_amplitude == pytest.approx(0.39, abs=0.05)
    assert cubic.step_amplitude == pytest.approx(2.09, abs=0.15)
    assert cubic.residual < 1e-13


@pytest.mark.ci("samples two regions")
def test_the_start_of_the_largest_step_lies_on_the_level() -> None:
    choice = choices_at(np.pi / 2)[1]
    from flexhinf.hinf.sampled import equilibrium_state

    shares, integral = np.array([1.0, 0, 0, 0, 0]), np.array([False] * 4 + [True])
    start = equilibrium_state(choice.solution, -choice.step_amplitude * shares, integral)
    grid = np.repeat(start[None], 4001, axis=0)
    grid[:, 4] = np.linspace(-5.0, 5.0, 4001)
    lowest = choice.solution.value(grid).min()
    assert lowest == pytest.approx(choice.level, rel=0.02)


def test_a_region_that_shrinks_with_the_degree_is_named() -> None:
    def choice(degree: int, step: float) -> DegreeChoice:
        return DegreeChoice(degree, None, 0.0, 0.0, 0.0, 1.0, step, "inequality", True)  # type: ignore[arg-type]

    assert shrinking([choice(6, 1.9), choice(2, 0.3), choice(4, 2.1)]) == [(4, 6)]


def test_without_rays_no_region_is_looked_at() -> None:
    (choice,) = try_degrees(fh.paper_arm().problem(), (4,), rays=0)
    assert not choice.looked
    assert np.isnan(choice.step_amplitude)
    assert shrinking([choice, choice]) == []


def test_without_a_definite_margin_there_is_no_region_and_the_reason_is_said() -> None:
    """The paper's weights about 90°: 78.4° with seed 0 once, 9.9° with another."""
    choices = tuple(try_degrees(fh.paper_arm().problem(pose=(np.pi / 2,)), (2, 4)))
    for choice in choices:
        assert choice.looked
        assert np.isnan(choice.level)
        assert np.isnan(choice.step_amplitude)
        assert choice.limit.startswith("no region: ")
    assert "link_velocity" in choice.limit
    assert shrinking(choices) == []
