"""The loop tracks steps of 180° and 90°, and π + sin(πt/10).

Criteria: a step is tracked if it settles within ±2 % inside the run and ends within ±2 % of the command.
The sine is tracked if the largest error after the start has died out stays below 5 % of the command's mean
value, 9°.
"""

from __future__ import annotations

import math
from typing import Any

from flexhinf.loop import Step
from flexhinf.paper.bench import Outcome, PaperBench
from flexhinf.paper.claims.damping import damped_law, repair_by_damping
from flexhinf.paper.claims.judged import Judged
from flexhinf.paper.claims.smallest import smallest_change
from flexhinf.paper.experiments import STEP_DURATION, TRACKING_FROM, Experiments
from flexhinf.paper.figures.figure_07 import tracking_numbers
from flexhinf.report import Claim, Column, Table

__all__ = ["judge_sine", "judge_steps", "step_text"]

#: Largest tracking error that still counts as tracking, rad.
TRACKING_LIMIT = math.radians(9.0)


def step_text(outcome: Outcome) -> str:
    """Overshoot, settling and final error of a step, in words."""
    if outcome.diverged_at is not None:
        return f"diverged at {outcome.diverged_at:.2f} s"
    m = outcome.metrics
    settling = m["settling_time_s"]
    settled = (
        f"settles in {settling:.2f} s" if settling is not None else f"does not settle in {STEP_DURATION:g} s"
    )
    return (
        f"overshoot {m['overshoot_percent']:.2f} %, {settled}, "
        f"at most {math.degrees(m['steady_state_error']):.2g}° off at the end, peak {m['peak_input']:.1f} V"
    )


def _settles(outcome: Outcome, goal: float) -> bool:
    m = outcome.metrics
    return m["settling_time_s"] is not None and m["steady_state_error"] <= 0.02 * goal


def judge_steps(experiments: Experiments) -> list[Judged]:
    """tracks-180 and tracks-90."""
    judged = []
    for goal, runs, figure in (
        (180, experiments.step_180, "figure-03"),
        (90, experiments.step_90, "figure-05"),
    ):
        outcome = runs["nonlinear"]
        holds = _settles(outcome, math.radians(goal))
        claim = Claim(
            f"tracks-{goal}",
            f"NL-H∞ with {experiments.bench.feedback} tracks a step of {goal}° "
            f"(settles within ±2 % in {STEP_DURATION:g} s).",
            "holds" if holds else "fails",
            f"{step_text(outcome)}.".replace("overshoot", "Overshoot", 1),
            "" if holds else _repaired_step(experiments.bench, math.radians(goal)),
            (figure,),
        )
        judged.append(Judged(claim))
    return judged


def _repaired_step(bench: PaperBench, goal: float) -> str:
    return repair_by_damping(
        bench, lambda s: _settles(bench.run(damped_law(bench, s), Step(goal), STEP_DURATION), goal)
    )


def judge_sine(experiments: Experiments) -> Judged:
    """tracks-sine, with higher degrees beside it."""
    bench = experiments.bench
    rows: list[tuple[object, ...]] = []
    numbers = {name: tracking_numbers(outcome) for name, outcome in experiments.tracking.items()}
    reference = experiments.reference_sine
    others = {
        "L-H∞ (degree 2)": numbers["linear"],
        f"NL-H∞ (degree {bench.settings.degree})": numbers["nonlinear"],
        "NL-H∞ (degree 6)": tracking_numbers(
            bench.run(bench.law(degree=6), reference, experiments.tracking_duration)
        ),
        "nonlinear LQR (γ = ∞)": tracking_numbers(
            bench.run(bench.nonlinear_lqr, reference, experiments.tracking_duration)
        ),
        "LQR + gravity compensation": tracking_numbers(
            bench.run(bench.gravity_lqr, reference, experiments.tracking_duration)
        ),
    }
    for name, found in others.items():
        largest, rmse = found.get("largest_error_rad"), found.get("tracking_rmse_rad")
        degrees = None if largest is None or rmse is None else (math.degrees(largest), math.degrees(rmse))
        rows.append((name, *(degrees or (None, None))))
    largest = numbers["nonlinear"]["largest_error_rad"]
    linear = numbers["linear"]["largest_error_rad"]
    holds = largest is not None and largest <= TRACKING_LIMIT
    if largest is None:
        evidence = "The run diverged."
    else:
        rival = "diverges" if linear is None else f"reaches {math.degrees(linear):.1f}°"
        evidence = (
            f"Largest error after {TRACKING_FROM:g} s: {math.degrees(largest):.1f}°; the linear law {rival}."
        )
        if linear is not None and linear < largest:
            evidence += " The order of the step responses is reversed: the nonlinear terms act on x1, not on the error."
    repair, numbers_of_repair = ("", {}) if holds else _repair(experiments)
    claim = Claim(
        "tracks-sine",
        "NL-H∞ tracks x_d = π + sin(πt/10) (largest error after the start at most 9°, 5 % of the mean command).",
        "holds" if holds else "fails",
        evidence,
        repair,
        ("figure-07", "table-tracking"),
    )
    table = Table(
        (
            "law",
            Column(f"largest error after {TRACKING_FROM:g} s", "°", 2),
            Column("RMS error, start included", "°", 2),
        ),
        rows,
        "Tracking π + sin(πt/10). A higher degree is not better without saying for what.",
        "table-tracking",
    )
    return Judged(claim, (table,), numbers_of_repair)


def _repair(experiments: Experiments) -> tuple[str, dict[str, float]]:
    """The smallest weight of x5 with which the sine is tracked, found by bisection, and what it costs."""
    bench = experiments.bench
    link, paper = 60.0, 300.0

    def design(weight: float) -> Any:
        return bench.law({"link_position": link, "link_position_integral": weight})

    def error(weight: float) -> float:
        outcome = bench.run(design(weight), experiments.reference_sine, experiments.tracking_duration)
        found = tracking_numbers(outcome)["largest_error_rad"]
        return math.inf if found is None else found

    weight = smallest_change(lambda w: error(w) <= TRACKING_LIMIT, paper, 32.0 * paper)
    if weight is None:
        return f"no weight of x5 up to {32 * paper:g} (x1 at {link:g}) does it.", {}
    costs = [bench.run(design(weight), Step(goal), STEP_DURATION) for goal in (math.pi / 2, math.pi)]
    text = (
        f"a weight of x5 of {weight:.0f} instead of {paper:g} (smallest, by bisection): largest error "
        f"{math.degrees(error(weight)):.2f}°. It costs, at 90°: {step_text(costs[0])}; at 180°: {step_text(costs[1])}."
    )
    return text, {"x5_weight": weight}
