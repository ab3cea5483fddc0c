"""What laws cost, and what they look at."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.baselines import FeedbackLinearisation, GravityCompensatedLQR, MotorPD, TorqueFeedback, lqr
from flexhinf.design import evaluation
from flexhinf.design.evaluation import LawEvaluation, operations


@pytest.fixture(scope="module")
def problem() -> Any:
    return fh.load_robot("vertical-rig").problem(pose=(0.8,))


def needed_states(law: Any) -> tuple[str, ...]:
    setup: Any = SimpleNamespace(linear_law=law)
    return LawEvaluation("law", setup).needed_states


def test_a_linear_law_costs_its_products_and_sums(problem: Any) -> None:
    assert operations(lqr(problem)) == 5 + 4
    assert operations(MotorPD.tuned(problem, 5.0)) == 4 + 3


def test_a_polynomial_is_counted_alike_by_its_trace_and_by_its_coefficients(
    problem: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    law = fh.solve_hji(problem, gamma=2.0 * fh.smallest_gamma(problem), degree=4)
    traced = operations(law)
    monkeypatch.setattr(evaluation, "TRACED", 0)
    assert 0.5 < operations(law) / traced < 2.0


def test_a_law_about_a_moving_reference_is_counted_with_it(problem: Any) -> None:
    assert operations(GravityCompensatedLQR.design(problem)) > operations(lqr(problem))


def test_needs_are_the_states_in_the_formula_of_the_law(problem: Any) -> None:
    links, motors = ("link_position", "link_velocity"), ("motor_position", "motor_velocity")
    assert needed_states(MotorPD.tuned(problem, 5.0)) == motors
    integral = MotorPD.tuned(problem, 5.0, integral="link_position")
    assert needed_states(integral) == (*motors, "link_position_integral")
    assert needed_states(TorqueFeedback.tuned(problem, 5.0)) == ("link_position", *motors)
    assert needed_states(FeedbackLinearisation.tuned(problem, 5.0)) == (*links, *motors)
    assert needed_states(lqr(problem)) == (*links, *motors, "link_position_integral")


def test_needs_do_not_depend_on_the_size_of_a_gain(problem: Any) -> None:
    soft = MotorPD.tuned(problem, 1e-3 if np.any(problem.operating_input == 0.0) else 2.0)
    assert "motor_position" in needed_states(soft)
