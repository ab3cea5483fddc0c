"""Sweeps of laws, and what one curve says at the cost of another."""

from __future__ import annotations

import math
import runpy
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.hinf import smallest_gamma, solve_hji

LAW: Any = SimpleNamespace()

STUDIES: dict[str, Any] = runpy.run_path(
    str(Path(__file__).resolve().parents[2] / "docs" / "paper_studies.py")
)
TradeOffCurve, TradeOffPoint = STUDIES["TradeOffCurve"], STUDIES["TradeOffPoint"]
scaled_effort, sweep_effort, sweep_gamma = (
    STUDIES[name] for name in ("scaled_effort", "sweep_effort", "sweep_gamma")
)


def curve(*pairs: tuple[float, float]) -> Any:
    points = (TradeOffPoint(float(k), LAW, {"volts": c, "sag": b}) for k, (c, b) in enumerate(pairs))
    return TradeOffCurve("test", "k", tuple(points))


def test_a_power_law_is_interpolated_exactly() -> None:
    made = curve(*((c, 3.0 * c**-0.5) for c in (40.0, 10.0, 90.0)))
    assert made.at_cost("volts", "sag", 25.0) == pytest.approx(0.6, rel=1e-12)


@pytest.mark.parametrize("volts", [9.9, 90.1])
def test_nothing_is_said_outside_a_curve(volts: float) -> None:
    assert curve((10.0, 1.0), (90.0, 0.5)).at_cost("volts", "sag", volts) is None


def test_laws_that_diverge_are_on_no_curve() -> None:
    made = curve((10.0, 1.0), (20.0, math.inf), (40.0, 0.25))
    assert made.at_cost("volts", "sag", 20.0) == pytest.approx(0.5)
    assert curve((10.0, math.inf)).at_cost("volts", "sag", 10.0) is None


def test_both_sweeps_meet_at_infinite_gamma_and_the_problem_s_own_r2() -> None:
    problem = fh.paper_arm().problem()
    measure = lambda law: {"gain": float(np.abs(law.gain).max())}  # noqa: E731
    over_gamma = sweep_gamma(problem, (1.5, math.inf), 2, measure)
    over_effort = sweep_effort(problem, (1.0, 0.1), 2, measure)
    a, b = over_gamma.points[1], over_effort.points[0]
    np.testing.assert_allclose(a.law.gain, b.law.gain, rtol=1e-12)
    assert over_gamma.points[0].figures["gain"] > a.figures["gain"]
    assert over_effort.points[1].figures["gain"] > a.figures["gain"]


def test_a_sweep_of_r2_keeps_the_ratio_to_the_gamma_of_its_own_problem() -> None:
    problem = fh.paper_arm().problem()
    made = sweep_effort(problem, (0.2,), 2, lambda law: {}, ratio=1.5).points[0]
    scaled = scaled_effort(problem, 0.2)
    assert made.law.gamma == pytest.approx(1.5 * smallest_gamma(scaled), rel=1e-12)
    np.testing.assert_allclose(made.law.gain, solve_hji(scaled, made.law.gamma, 2).gain, rtol=1e-12)
