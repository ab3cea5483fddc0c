"""NL-H∞ beats L-H∞ on steps: smaller overshoot *and* smaller settling time on the 90° step."""

from __future__ import annotations

import math
from typing import Any

from flexhinf.loop import Step
from flexhinf.paper.claims.damping import damped_law, repair_by_damping
from flexhinf.paper.claims.judged import Judged
from flexhinf.paper.claims.tracking import step_text
from flexhinf.paper.experiments import STEP_DURATION, Experiments
from flexhinf.report import Claim

__all__ = ["judge_against_linear"]


def _better(a: dict[str, Any], b: dict[str, Any], key: str) -> bool:
    """a is smaller than b; what is missing (diverged, never settled) is infinite."""
    left, right = (math.inf if m[key] is None else m[key] for m in (a, b))
    return left < right


def judge_against_linear(experiments: Experiments) -> Judged:
    """beats-linear."""
    parts, wins = [], {}
    for goal, runs in ((90, experiments.step_90), (180, experiments.step_180)):
        a, b = runs["nonlinear"].metrics, runs["linear"].metrics
        wins[goal] = all(_better(a, b, key) for key in ("overshoot_percent", "settling_time_s"))
        parts.append(f"{goal}°: NL-H∞ {step_text(runs['nonlinear'])}; L-H∞ {step_text(runs['linear'])}.")
    same = experiments.bench.settings.degree < 4  # V of the odd arm has no cubic terms: both laws are one
    if same:
        parts.insert(0, "At this degree both are the same law.")
    claim = Claim(
        "beats-linear",
        "NL-H∞ has less overshoot and a shorter settling time than L-H∞ on the 90° step (180° shown too).",
        "not judged" if same else "holds" if wins[90] else "fails",
        " ".join(parts),
        "" if wins[90] or same else _repaired(experiments),
        ("figure-05", "figure-03"),
    )
    return Judged(claim)


def _repaired(experiments: Experiments) -> str:
    """Both laws get the weights, the linear one of the same γ."""
    bench = experiments.bench

    def holds(scale: float) -> bool:
        laws = (damped_law(bench, scale), damped_law(bench, scale, degree=2))
        ours, linear = (bench.run(law, Step(math.pi / 2), STEP_DURATION).metrics for law in laws)
        return all(_better(ours, linear, key) for key in ("overshoot_percent", "settling_time_s"))

    return repair_by_damping(bench, holds)
