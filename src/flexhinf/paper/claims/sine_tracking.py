"""The loop tracks π + sin(πt/10)."""

from __future__ import annotations

import math
from typing import Any

from flexhinf.loop import Step
from flexhinf.paper.claims.judgement import Judged, smallest_change
from flexhinf.paper.claims.steps import step_text
from flexhinf.paper.experiments import STEP_DURATION, TRACKING_FROM, Experiments, tracking_numbers
from flexhinf.paper.loop_setup import GOALS
from flexhinf.report import Claim, Column, Table

__all__ = ["judge_sine"]

#: Largest tracking error that still counts as tracking, rad: 5 % of the command's mean value.
TRACKING_LIMIT = math.radians(9.0)


def judge_sine(experiments: Experiments) -> Judged:
    """tracks-sine, with other laws beside it."""
    setup = experiments.setup
    found = {name: tracking_numbers(run) for name, run in experiments.tracking.items()}
    weights = {"link_position": 60.0, "link_position_integral": 300.0}
    others = {
        "NL-H∞ (degree 6)": setup.law(weights, degree=6),
        "nonlinear LQR (γ = ∞)": setup.nonlinear_lqr,
        "LQR + gravity compensation": setup.gravity_lqr,
    }
    shown = {
        "L-H∞ (degree 2)": found["linear"],
        f"NL-H∞ (degree {setup.settings.degree})": found["nonlinear"],
        **{name: tracking_numbers(experiments.track(law)) for name, law in others.items()},
    }
    rows = [
        (name, _degrees(numbers["largest_error_rad"]), _degrees(numbers["tracking_rmse_rad"]))
        for name, numbers in shown.items()
    ]
    largest, linear = (found[name]["largest_error_rad"] for name in ("nonlinear", "linear"))
    holds = largest is not None and largest <= TRACKING_LIMIT
    repair, numbers_of_repair = ("", {}) if holds else _repair(experiments)
    claim = Claim(
        "tracks-sine",
        "NL-H∞ tracks the command π + sin(πt/10).",
        "holds" if holds else "fails",
        _evidence(largest, linear),
        repair,
        ("figure-07", "table-tracking"),
        f"The largest error after {TRACKING_FROM:g} s is at most 9°, 5 % of the command's mean value.",
    )
    columns = (
        "law",
        Column(f"largest error after {TRACKING_FROM:g} s", "°", 2),
        Column("RMS error, start included", "°", 2),
    )
    caption = "Tracking π + sin(πt/10) by laws of the same weights."
    return Judged(claim, (Table(columns, rows, caption, "table-tracking"),), numbers_of_repair)


def _degrees(angle: float | None) -> float | None:
    return None if angle is None else math.degrees(angle)


def _evidence(largest: float | None, linear: float | None) -> str:
    if largest is None:
        return "The run diverged."
    rival = "diverges" if linear is None else f"reaches {math.degrees(linear):.1f}°"
    text = f"Largest error after {TRACKING_FROM:g} s: {math.degrees(largest):.1f}°; the linear law {rival}."
    if linear is not None and linear < largest:
        text += (
            " The order of the step responses is reversed: the nonlinear terms act on x1, not on the error."
        )
    return text


def _repair(experiments: Experiments) -> tuple[str, dict[str, float]]:
    """The smallest weight of x5 with which the sine is tracked, found by bisection, and what it costs."""
    setup, paper = experiments.setup, 300.0

    def design(weight: float) -> Any:
        return setup.law({"link_position": 60.0, "link_position_integral": weight})

    def error(weight: float) -> float:
        found = tracking_numbers(experiments.track(design(weight)))["largest_error_rad"]
        return math.inf if found is None else found

    weight = smallest_change(lambda w: error(w) <= TRACKING_LIMIT, paper, 32.0 * paper)
    if weight is None:
        return f"no weight of x5 up to {32 * paper:g} (x1 at 60) does it.", {}
    costs = [setup.run(design(weight), Step(goal), STEP_DURATION) for goal in GOALS]
    text = (
        f"a weight of x5 of {weight:.0f} instead of {paper:g} (smallest, by bisection): largest error "
        f"{math.degrees(error(weight)):.2f}°. It costs, at 90°: {step_text(costs[0])}; at 180°: {step_text(costs[1])}."
    )
    return text, {"x5_weight": weight}
