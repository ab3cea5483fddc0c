"""Choosing the degree by data."""

from __future__ import annotations

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.cli import main
from flexhinf.design import DegreeChoice, shrinking, try_degrees

WEIGHTS = (70.0, 18.0, 60.0, 18.0, 320.0)
PAPER = (60.0, 0.0, 0.0, 0.0, 300.0)


def choices_at(goal: float, **options: object) -> list[DegreeChoice]:
    problem = fh.paper_arm().problem(fh.Penalty(WEIGHTS, effort=10.0), pose=(goal,))
    return list(try_degrees(problem, (2, 4), checked_penalty=PAPER, rays=800, **options))  # type: ignore[arg-type]


def test_a_higher_degree_allows_a_larger_step_at_90_degrees() -> None:
    linear, cubic = choices_at(np.pi / 2)
    assert linear.step_amplitude == pytest.approx(0.39, abs=0.05)
    assert cubic.step_amplitude == pytest.approx(2.09, abs=0.15)
    assert cubic.residual < 1e-13


def test_the_start_of_the_largest_step_lies_on_the_level() -> None:
    choice = choices_at(np.pi / 2)[1]
    from flexhinf.hinf.rest import rest_state

    shares, integral = np.array([1.0, 0, 0, 0, 0]), np.array([False] * 4 + [True])
    start = rest_state(choice.solution, -choice.step_amplitude * shares, integral)
    grid = np.repeat(start[None], 4001, axis=0)
    grid[:, 4] = np.linspace(-5.0, 5.0, 4001)
    lowest = choice.solution.value(grid).min()
    assert lowest == pytest.approx(choice.level, rel=0.02)


def test_a_region_that_shrinks_with_the_degree_is_named() -> None:
    def choice(degree: int, step: float) -> DegreeChoice:
        return DegreeChoice(degree, None, 1.0, step, "inequality", 0.0, 0.0, 0.0)  # type: ignore[arg-type]

    assert shrinking([choice(6, 1.9), choice(2, 0.3), choice(4, 2.1)]) == [(4, 6)]


def test_the_command_prints_a_table(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["design", "paper", "--degrees", "2,4", "--goal", "180deg", "--rays", "200"]) == 0
    shown = capsys.readouterr().out
    assert "linear" in shown
    assert "cubic" in shown
    assert "not proved" in shown


@pytest.mark.parametrize(
    "words",
    [
        ["nobody"],
        ["paper", "--degrees", "two"],
        ["paper", "--goal", "90grad"],
        ["paper", "--goal", "1,2"],
        ["paper", "--penalty", "1,2,3"],
        ["paper", "--gamma-ratio", "0.5"],
        ["paper", "--checked-gamma-ratio", "1.2"],
        ["paper", "--degrees", "1"],
        ["paper", "--effort", "-1"],
        ["paper", "--penalty", "0,0,0,0,300", "--checked-penalty", "0,1"],
    ],
    ids=" ".join,
)
def test_bad_input_is_told_in_three_parts(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["design", *words]) == 2
    told = capsys.readouterr().err
    assert "found:" in told
    assert "try:" in told
    assert "Traceback" not in told
