"""What the paper says of its weights: 60 x1 reduces the overshoot, 300 x5 guarantees a fast response.

Each weight is varied with the other kept; γ is the same multiple of each design's own γ*. Judged on every neighbouring
pair of the weights shown, for the step to 90° and for that to 180°.

The loop tracks steps of 180° and 90° and π + sin(πt/10), and NL-H∞ beats L-H∞ on the step of 90°; and whether it
still does where both laws are designed about the goal, which the paper does not ask.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from flexhinf.errors import FlexhinfError
from flexhinf.loop import Step, Trajectory
from flexhinf.paper.claims.judgement import Judged, damped_law, repair_by_damping, smallest_change
from flexhinf.paper.experiments import STEP_DURATION, TRACKING_FROM, Experiments, tracking_numbers
from flexhinf.paper.loop_setup import GOALS, PaperSetup, name_goal
from flexhinf.report import Claim, Column, Table

LINK_WEIGHTS = (15.0, 30.0, 60.0, 90.0, 120.0)
INTEGRAL_WEIGHTS = (100.0, 150.0, 300.0, 450.0, 600.0)
PAPER_LINK, PAPER_INTEGRAL = 60.0, 300.0

#: What is read off each step: name of the metric, head of the column, unit, digits after the point.
METRICS = (
    ("overshoot_percent", "overshoot", "%", 2),
    ("rise_time_s", "rise 10–90 %", "s", 3),
    ("settling_time_s", "settling", "s", 2),
)

#: Largest equal weight of x2 and x4 that is tried as a repair.
LARGEST_VELOCITY = 64.0

Row = dict[Any, Any]


def sweep_weights(
    experiments: Experiments, pairs: Sequence[tuple[float, float]], velocity: float = 0.0
) -> list[Row]:
    """Metrics of the steps by goal, for weights of x1 and x5; `velocity` weighs x2 and x4. None where no law exists."""
    rows = []
    for link, integral in pairs:
        row: Row = {"weights": (link, integral)}
        weights = {"link_position": link, "link_position_integral": integral}
        try:
            law = experiments.setup.law({**weights, "link_velocity": velocity, "motor_velocity": velocity})
        except FlexhinfError:
            rows.append({**row, **{goal: {key: None for key, *_ in METRICS} for goal in GOALS}})
            continue
        for goal in GOALS:
            row[goal] = experiments.setup.run(law, Step(goal), STEP_DURATION).metrics()
        rows.append(row)
    return rows


def _falls(rows: Sequence[Row], metric: str) -> bool:
    """At both goals every value is smaller than the one before; a missing one is infinite."""
    columns = [[math.inf if row[g][metric] is None else row[g][metric] for row in rows] for g in GOALS]
    return all(b < a for column in columns for a, b in pairwise(column))


def _table(rows: Sequence[Row], caption: str, anchor: str) -> Table:
    columns = [Column("weight of x1", "", 0), Column("weight of x5", "", 0)]
    columns += [
        Column(f"{name_goal(g)} {head}", unit, digits) for g in GOALS for _, head, unit, digits in METRICS
    ]
    cells = [(*row["weights"], *(row[g][key] for g in GOALS for key, *_ in METRICS)) for row in rows]
    return Table(columns, cells, caption, anchor)


def _range(rows: Sequence[Row], goal: float, metric: str, digits: int) -> str:
    """The metric with the smallest and with the largest weight: ``1.00 to 0.45``."""
    ends = [row[goal][metric] for row in (rows[0], rows[-1])]
    return " to ".join("none" if end is None else f"{end:.{digits}f}" for end in ends)


# 60 x1 -------------------------------------------------------------------------------------------------
def judge_link_weight(experiments: Experiments) -> Judged:
    """link-weight-reduces-overshoot."""
    rows = sweep_weights(experiments, [(weight, PAPER_INTEGRAL) for weight in LINK_WEIGHTS])
    holds = _falls(rows, "overshoot_percent")
    listed = ", ".join(f"{weight:g}" for weight in LINK_WEIGHTS)
    claim = Claim(
        "link-weight-reduces-overshoot",
        "60 x1 reduces the overshoot of the step response.",
        "holds" if holds else "fails",
        f"From a weight of {LINK_WEIGHTS[0]:g} to {LINK_WEIGHTS[-1]:g} the overshoot goes from "
        f"{_range(rows, GOALS[0], 'overshoot_percent', 1)} % at 90° and from "
        f"{_range(rows, GOALS[1], 'overshoot_percent', 1)} % at 180°.",
        "" if holds else _repaired_link(experiments),
        ("table-link-weight",),
        f"With 300 x5 kept, the overshoot of the steps to 90° and 180° falls with each larger weight of x1: {listed}.",
    )
    return Judged(claim, (_table(rows, "The weight of x1 varied.", "table-link-weight"),))


def _repaired_link(experiments: Experiments) -> str:
    """The smallest equal weights on the two velocities with which the overshoot falls as the weight of x1 grows."""
    pairs = [(weight, PAPER_INTEGRAL) for weight in LINK_WEIGHTS]
    return _smallest_velocity(experiments, pairs, "overshoot_percent", "overshoot")


# 300 x5 ------------------------------------------------------------------------------------------------
def judge_integral_weight(experiments: Experiments) -> Judged:
    """integral-weight-is-fast."""
    pairs = [(PAPER_LINK, weight) for weight in INTEGRAL_WEIGHTS]
    rows = sweep_weights(experiments, pairs)
    holds = _falls(rows, "rise_time_s")
    listed = ", ".join(f"{weight:g}" for weight in INTEGRAL_WEIGHTS)
    settles = (
        "The settling time (±2 %) falls too."
        if _falls(rows, "settling_time_s")
        else "The settling time (±2 %) does not fall steadily: it jumps where another swing leaves the band."
    )
    claim = Claim(
        "integral-weight-is-fast",
        "300 x5 guarantees a fast response to a step command.",
        "holds" if holds else "fails",
        f"From a weight of {INTEGRAL_WEIGHTS[0]:g} to {INTEGRAL_WEIGHTS[-1]:g} the rise time goes from "
        f"{_range(rows, GOALS[0], 'rise_time_s', 2)} s at 90° and from {_range(rows, GOALS[1], 'rise_time_s', 2)} s at "
        f"180°. {settles} The overshoot goes from {_range(rows, GOALS[0], 'overshoot_percent', 1)} % and "
        f"{_range(rows, GOALS[1], 'overshoot_percent', 1)} %.",
        "" if holds else _smallest_velocity(experiments, pairs, "rise_time_s", "rise time"),
        ("table-integral-weight",),
        "“Fast” is read as a short time of rise from 10 to 90 % of the step. With 60 x1 kept, it falls at 90° and at "
        f"180° with each larger weight of x5: {listed}.",
    )
    return Judged(claim, (_table(rows, "The weight of x5 varied.", "table-integral-weight"),))


def _smallest_velocity(
    experiments: Experiments, pairs: Sequence[tuple[float, float]], metric: str, name: str
) -> str:
    """The smallest equal weights on the two velocities with which a metric falls along the sweep."""
    velocity = smallest_change(
        lambda w: _falls(sweep_weights(experiments, pairs, w), metric), 0.25, LARGEST_VELOCITY
    )
    if velocity is None:
        return f"no equal weights of x2 and x4 up to {LARGEST_VELOCITY:g} make the {name} fall steadily."
    return f"weights of {velocity:.2g} on x2 and x4 (smallest, by bisection)."


#: Largest tracking error that still counts as tracking, rad: 5 % of the command's mean value.
TRACKING_LIMIT = math.radians(9.0)


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
#: What is compared of two steps, and the columns of its table.
STEP_METRICS = ("overshoot_percent", "settling_time_s", "rise_time_s", "peak_input")
COLUMNS = (
    "step",
    "law",
    Column("overshoot", "%", 2),
    Column("settling", "s", 2),
    Column("rise 10–90 %", "s", 2),
    Column("peak", "V", 1),
)


def judge_against_linear(experiments: Experiments) -> Judged:
    """beats-linear."""
    rows, wins = [], {}
    for goal, runs in ((math.pi / 2, experiments.step_90), (math.pi, experiments.step_180)):
        ours, linear = runs["nonlinear"].metrics(), runs["linear"].metrics()
        wins[goal] = _beats(ours, linear)
        rows += [
            (name_goal(goal), name, *(m[key] for key in STEP_METRICS))
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
    table = Table(COLUMNS, rows, "The two laws of the same γ on the two steps.", "table-linear")
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


# About the goal ----------------------------------------------------------------------------------------
#: Name of a law for a reader, and in `Experiments.about_goal`.
LAWS = (("NL-H∞", "nonlinear"), ("L-H∞", "linear"))


def judge_about_goal(experiments: Experiments) -> Judged:
    """beats-linear-about-the-goal: our own question."""
    runs = experiments.about_goal
    rows = [
        (
            name_goal(goal),
            f"{law} about {about}",
            *(runs[goal, about, name].metrics()[key] for key in STEP_METRICS),
        )
        for goal in reversed(GOALS)
        for about in ("the hanging rest", "the goal")
        for law, name in LAWS
    ]
    wins = [_beats(*(runs[goal, "the goal", name].metrics() for _, name in LAWS)) for goal in GOALS]
    same = experiments.setup.settings.degree == 2
    shown = "; ".join(f"{law}: {step_text(runs[math.pi, 'the goal', name])}" for law, name in LAWS)
    claim = Claim(
        "beats-linear-about-the-goal",
        "NL-H∞ steps better than L-H∞ where both are designed about the goal.",
        "not judged" if same else "holds" if all(wins) else "fails",
        "At this degree both are the same law." if same else f"On 180°, {shown}.",
        "",
        ("table-about-the-goal",),
        "On the steps of 180° and 90°, NL-H∞ has less overshoot and a shorter settling time (±2 %) than L-H∞, both "
        "expanded about the goal at the same γ/γ*. The paper expands both about the hanging rest; flexhinf design "
        "expands them about the goal.",
    )
    caption = (
        "The paper's laws, about the hanging rest, and those of the same penalty about the goal. Every step begins at "
        "the hanging rest without a jump of the input, and the true plant has the motor's coil."
    )
    return Judged(claim, (Table(COLUMNS, rows, caption, "table-about-the-goal"),), ours=True)


# Tracking a sine ---------------------------------------------------------------------------------------
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
