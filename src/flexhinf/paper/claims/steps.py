"""The loop tracks steps of 180° and 90°, and NL-H∞ beats L-H∞ on the step of 90°."""

from __future__ import annotations

import math
from typing import Any

from flexhinf.loop import Step, Trajectory
from flexhinf.paper.claims.judgement import Judged, damped_law, repair_by_damping
from flexhinf.paper.experiments import STEP_DURATION, Experiments
from flexhinf.paper.loop_setup import PaperSetup, name_goal
from flexhinf.report import Claim, Column, Table

__all__ = ["judge_against_linear", "judge_steps", "step_text"]


def step_text(run: Trajectory) -> str:
    """Overshoot, settling and final error of a step, for a sentence."""
    if run.diverged_at is not None:
        return f"diverged at {run.diverged_at:.2f} s"
    m = run.metrics()
    settling = m["settling_time_s"]
    settled = (
        f"settles in {settling:.2f} s" if settling is not None else f"does not settle in {STEP_DURATION:g} s"
    )
    return (
        f"overshoot {m['overshoot_percent']:.2f} %, {settled}, "
        f"at most {math.degrees(m['steady_state_error']):.2g}° off at the end, peak {m['peak_input']:.1f} V"
    )


# Tracking a step ---------------------------------------------------------------------------------------
def judge_steps(experiments: Experiments) -> list[Judged]:
    """tracks-180 and tracks-90."""
    judged = []
    for goal, runs, figure in (
        (180, experiments.step_180, "figure-03"),
        (90, experiments.step_90, "figure-05"),
    ):
        run = runs["nonlinear"]
        holds = _settles(run, math.radians(goal))
        claim = Claim(
            f"tracks-{goal}",
            f"NL-H∞ with {experiments.setup.feedback} tracks a step of {goal}°.",
            "holds" if holds else "fails",
            f"{step_text(run)}.".replace("overshoot", "Overshoot", 1),
            "" if holds else _repaired_step(experiments.setup, math.radians(goal)),
            (figure,),
            f"The link settles within ±2 % of the step in {STEP_DURATION:g} s and ends within ±2 % of the command.",
        )
        judged.append(Judged(claim))
    return judged


def _settles(run: Trajectory, goal: float) -> bool:
    m = run.metrics()
    return m["settling_time_s"] is not None and m["steady_state_error"] <= 0.02 * goal


def _repaired_step(setup: PaperSetup, goal: float) -> str:
    return repair_by_damping(
        setup, lambda s: _settles(setup.run(damped_law(setup, s), Step(goal), STEP_DURATION), goal)
    )


# Against the linear law --------------------------------------------------------------------------------
def judge_against_linear(experiments: Experiments) -> Judged:
    """beats-linear."""
    rows, wins = [], {}
    for goal, runs in ((math.pi / 2, experiments.step_90), (math.pi, experiments.step_180)):
        ours, linear = runs["nonlinear"].metrics(), runs["linear"].metrics()
        wins[goal] = _beats(ours, linear)
        keys = ("overshoot_percent", "settling_time_s", "rise_time_s", "peak_input")
        rows += [
            (name_goal(goal), name, *(m[key] for key in keys))
            for name, m in (("NL-H∞", ours), ("L-H∞", linear))
        ]
    same = experiments.setup.settings.degree < 4  # V of the odd arm has no cubic terms: both laws are one
    holds = wins[math.pi / 2]
    evidence = "At this degree both are the same law." if same else _better_text(experiments.step_90)
    claim = Claim(
        "beats-linear",
        "NL-H∞ steps better than L-H∞.",
        "not judged" if same else "holds" if holds else "fails",
        evidence,
        "" if holds or same else _repaired(experiments),
        ("figure-05", "figure-03", "table-linear"),
        "On the 90° step, the paper's comparison, NL-H∞ has less overshoot and a shorter settling time (±2 %) than "
        "L-H∞ of the same γ; 180° is shown too.",
    )
    columns = (
        "step",
        "law",
        Column("overshoot", "%", 2),
        Column("settling", "s", 2),
        Column("rise 10–90 %", "s", 2),
        Column("peak", "V", 1),
    )
    table = Table(columns, rows, "The two laws of the same γ on the two steps.", "table-linear")
    return Judged(claim, (table,))


def _beats(ours: dict[str, Any], linear: dict[str, Any]) -> bool:
    """Less overshoot and shorter settling; what is missing (diverged, never settled) is infinite."""

    def known(m: dict[str, Any], key: str) -> float:
        return math.inf if m[key] is None else m[key]

    return all(known(ours, key) < known(linear, key) for key in ("overshoot_percent", "settling_time_s"))


def _better_text(runs: dict[str, Trajectory]) -> str:
    return f"On 90°, NL-H∞: {step_text(runs['nonlinear'])}; L-H∞: {step_text(runs['linear'])}."


def _repaired(experiments: Experiments) -> str:
    """Both laws get the weights, the linear one of the same γ."""
    setup = experiments.setup

    def holds(scale: float) -> bool:
        laws = (damped_law(setup, scale), damped_law(setup, scale, degree=2))
        ours, linear = (setup.run(law, Step(math.pi / 2), STEP_DURATION).metrics() for law in laws)
        return _beats(ours, linear)

    return repair_by_damping(setup, holds)
