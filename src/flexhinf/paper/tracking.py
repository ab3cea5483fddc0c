"""Claims on steps, on tracking, on the linear law and on the weights of the penalty."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

from flexhinf.baselines import GravityCompensatedLQR
from flexhinf.errors import FlexhinfError
from flexhinf.hinf import solve_hji
from flexhinf.loop import Controller, Loop, Step, Trajectory
from flexhinf.paper.claim import Finding, PaperClaim
from flexhinf.paper.loop_setup import (
    GOALS,
    SINE,
    STEP_DURATION,
    TRACKING_DURATION,
    TRACKING_FROM,
    PaperSetup,
    name_goal,
    tracking_numbers,
)
from flexhinf.report import Column, Table

#: Weights of x1 and of x5, each varied with the other kept at the paper's 60 or 300.
LINK_WEIGHTS = (15.0, 30.0, 60.0, 90.0, 120.0)
INTEGRAL_WEIGHTS = (100.0, 150.0, 300.0, 450.0, 600.0)

#: Largest tracking error that still counts as tracking, rad: 5 % of the command's mean value.
TRACKING_LIMIT = math.radians(9.0)

#: What is read off a step: name of the metric and its column.
OVERSHOOT = ("overshoot_percent", Column("overshoot", "%", 2))
SETTLING = ("settling_time_s", Column("settling", "s", 2))
RISE = ("rise_time_s", Column("rise 10–90 %", "s", 2))
PEAK = ("peak_input", Column("peak", "V", 1))

LAWS = {"nonlinear": "NL-H∞", "linear": "L-H∞"}
SAME_LAW = "At this degree both are the same law."


# Steps ---------------------------------------------------------------------------------------------------
def step_text(run: Trajectory) -> str:
    """Overshoot, settling and final error of a step, for a sentence."""
    if run.diverged_at is not None:
        return f"diverged at {run.diverged_at:.2f} s"
    m = run.metrics()
    settling = m["settling_time_s"]
    settled = (
        f"does not settle in {STEP_DURATION:g} s" if settling is None else f"settles in {settling:.2f} s"
    )
    return (
        f"overshoot {m['overshoot_percent']:.2f} %, {settled}, "
        f"at most {math.degrees(m['steady_state_error']):.2g}° off at the end, peak {m['peak_input']:.1f} V"
    )


def _tracks_step(run: Trajectory, goal: float) -> Finding:
    m = run.metrics()
    holds = m["settling_time_s"] is not None and m["steady_state_error"] <= 0.02 * goal
    return Finding(holds, f"{step_text(run)}.".replace("overshoot", "Overshoot", 1))


def beats(ours: Trajectory, rival: Trajectory) -> bool:
    """Whether a step has less overshoot and settles sooner; what is missing (diverged, never settled) is infinite."""
    metrics = ours.metrics(), rival.metrics()
    pairs = [[math.inf if m[key] is None else m[key] for m in metrics] for key, _ in (OVERSHOOT, SETTLING)]
    return all(own < other for own, other in pairs)


def _steps_table(runs: dict[tuple[str, str], Trajectory], caption: str, anchor: str) -> Table:
    """A row for each step and law."""
    read = (OVERSHOOT, SETTLING, RISE, PEAK)
    rows = [(*names, *(run.metrics()[key] for key, _ in read)) for names, run in runs.items()]
    return Table(("step", "law", *(column for _, column in read)), rows, caption, anchor)


def _beats_linear(setup: PaperSetup) -> Finding:
    steps = {"90°": setup.runs("05"), "180°": setup.runs("03")}
    rows = {(goal, name): runs[law] for goal, runs in steps.items() for law, name in LAWS.items()}
    table = _steps_table(rows, "The two laws of the same γ on the two steps.", "table-linear")
    if setup.settings.degree < 4:  # V of the odd arm has no cubic terms: both laws are one
        return Finding("not judged", SAME_LAW, (table,))
    ours, linear = rows["90°", "NL-H∞"], rows["90°", "L-H∞"]
    evidence = f"On 90°, NL-H∞: {step_text(ours)}; L-H∞: {step_text(linear)}."
    return Finding(beats(ours, linear), evidence, (table,))


def _beats_linear_about_the_goal(setup: PaperSetup) -> Finding:
    rows: dict[tuple[str, str], Trajectory] = {}
    wins, (rest, held) = [], setup.arm.operating_point(0.0, ("inductance",))
    for goal in reversed(GOALS):
        for about, pose in (("the hanging rest", 0.0), ("the goal", goal)):
            runs = []
            for law, name in LAWS.items():
                degree = 2 if law == "linear" else setup.settings.degree
                solution, period = setup.law(degree=degree, pose=pose), setup.settings.period
                loop = setup.loop(solution, inductance=True)
                controller = Controller(solution, loop.controller.estimator, period, start="bumpless")
                noise, seed = setup.deviation(loop), setup.settings.seed
                bumpless = Loop(loop.true_plant, controller)
                run = bumpless.run(Step(goal), None, noise, STEP_DURATION, rest, seed, held)
                runs.append(run)
                rows[name_goal(goal), f"{name} about {about}"] = run
        wins.append(beats(*runs))  # of the laws about the goal
    caption = (
        "The paper's laws, about the hanging rest, and those of the same penalty about the goal; without a jump of the "
        "input, coil in the true plant."
    )
    table = _steps_table(rows, caption, "table-about-the-goal")
    if setup.settings.degree == 2:
        return Finding("not judged", SAME_LAW, (table,))
    shown = "; ".join(
        f"{name}: {step_text(rows['180°', f'{name} about the goal'])}" for name in LAWS.values()
    )
    return Finding(all(wins), f"On 180°, {shown}.", (table,))


# Tracking ------------------------------------------------------------------------------------------------
def _tracks_sine(setup: PaperSetup) -> Finding:
    found = {name: tracking_numbers(run) for name, run in setup.runs("07").items()}
    degree, weights = setup.settings.degree, {"link_position": 60.0, "link_position_integral": 300.0}
    others = {
        "NL-H∞ (degree 6)": setup.law(weights, degree=6),
        "nonlinear LQR (γ = ∞)": solve_hji(setup.problem, gamma=math.inf, degree=degree),
        "LQR + gravity compensation": GravityCompensatedLQR.design(setup.problem),
    }
    shown = {"L-H∞ (degree 2)": found["linear"], f"NL-H∞ (degree {degree})": found["nonlinear"]}
    shown |= {name: tracking_numbers(setup.run(law, SINE, TRACKING_DURATION)) for name, law in others.items()}
    keys = ("largest_error_rad", "tracking_rmse_rad")
    rows = [
        (name, *(None if m[key] is None else math.degrees(m[key]) for key in keys))
        for name, m in shown.items()
    ]
    worst = Column(f"largest error after {TRACKING_FROM:g} s", "°", 2)
    columns = ("law", worst, Column("RMS error, start included", "°", 2))
    table = Table(columns, rows, "Tracking π + sin(πt/10) by laws of the same weights.", "table-tracking")
    largest, linear = (found[name]["largest_error_rad"] for name in ("nonlinear", "linear"))
    if largest is None:
        return Finding(False, "The run diverged in 40 s.", (table,))
    rival = "diverges" if linear is None else f"reaches {math.degrees(linear):.1f}°"
    text = f"Largest error after {TRACKING_FROM:g} s: {math.degrees(largest):.1f}°; the linear law {rival}."
    if linear is not None and linear < largest:
        text += " The nonlinear terms act on x1, not on the error: the order of the steps is reversed."
    return Finding(largest <= TRACKING_LIMIT, text, (table,))


# Weights -------------------------------------------------------------------------------------------------
def judge_weight(setup: PaperSetup, varied: str) -> Finding:
    """Steps to both goals while the weight of x1 or of x5 is varied: overshoot or rise time falls with each."""
    weights = LINK_WEIGHTS if varied == "x1" else INTEGRAL_WEIGHTS
    pairs = [(weight, 300.0) if varied == "x1" else (60.0, weight) for weight in weights]
    read = (OVERSHOOT, (RISE[0], Column(RISE[1].name, "s", 3)), SETTLING)
    runs: list[dict[float, dict[str, Any]]] = []  # metrics by goal; None where no law exists
    for link, integral in pairs:
        own = {"link_position": link, "link_position_integral": integral}
        try:
            law = setup.law({**own, "link_velocity": 0.0, "motor_velocity": 0.0})
        except FlexhinfError:
            runs.append({goal: {key: None for key, _ in read} for goal in GOALS})
        else:
            runs.append({goal: setup.run(law, Step(goal), STEP_DURATION).metrics() for goal in GOALS})

    def falls(metric: str) -> bool:  # a missing value is infinite
        values = [[math.inf if run[g][metric] is None else run[g][metric] for run in runs] for g in GOALS]
        return all(b < a for column in values for a, b in pairwise(column))

    def ends(metric: str, digits: int) -> list[str]:  # with the smallest and with the largest weight
        pairs = [[run[goal][metric] for run in (runs[0], runs[-1])] for goal in GOALS]
        return [" to ".join("none" if x is None else f"{x:.{digits}f}" for x in pair) for pair in pairs]

    rows = [
        (*pair, *(run[goal][key] for goal in GOALS for key, _ in read))
        for pair, run in zip(pairs, runs, strict=True)
    ]
    columns = [Column("weight of x1", "", 0), Column("weight of x5", "", 0)]
    columns += [Column(f"{name_goal(g)} {c.name}", c.unit, c.decimals) for g in GOALS for _, c in read]
    anchor = "table-link-weight" if varied == "x1" else "table-integral-weight"
    table = Table(columns, rows, f"The weight of {varied} varied.", anchor)
    over, lead = ends("overshoot_percent", 1), f"From a weight of {weights[0]:g} to {weights[-1]:g} the"
    if varied == "x1":
        text = f"{lead} overshoot goes from {over[0]} % at 90° and from {over[1]} % at 180°."
        return Finding(falls("overshoot_percent"), text, (table,))
    settles = "falls too" if falls("settling_time_s") else "does not fall steadily"
    rise = ends("rise_time_s", 2)
    text = (
        f"{lead} rise time goes from {rise[0]} s at 90° and from {rise[1]} s at 180°. The settling time (±2 %) "
        f"{settles}. The overshoot goes from {over[0]} % and {over[1]} %."
    )
    return Finding(falls("rise_time_s"), text, (table,))


STEPS_AND_TRACKING = (
    *(
        PaperClaim(
            f"tracks-{degrees}",
            f"NL-H∞ with {{feedback}} tracks a step of {degrees}°.",
            f"The link settles within ±2 % of the step in {STEP_DURATION:g} s and ends within ±2 % of the command.",
            judge,
            (figure,),
        )
        for degrees, figure, judge in (
            (180, "figure-03", lambda e: _tracks_step(e.runs("03")["nonlinear"], math.pi)),
            (90, "figure-05", lambda e: _tracks_step(e.runs("05")["nonlinear"], math.pi / 2)),
        )
    ),
    PaperClaim(
        "beats-linear",
        "NL-H∞ steps better than L-H∞.",
        "On the 90° step, the paper's comparison, NL-H∞ has less overshoot and a shorter settling time (±2 %) than "
        "L-H∞ of the same γ; 180° is shown too.",
        _beats_linear,
        ("figure-05", "figure-03"),
    ),
    PaperClaim(
        "tracks-sine",
        "NL-H∞ tracks the command π + sin(πt/10).",
        f"The largest error after {TRACKING_FROM:g} s is at most 9°, 5 % of the command's mean value.",
        _tracks_sine,
        ("figure-07",),
    ),
    PaperClaim(
        "link-weight-reduces-overshoot",
        "60 x1 reduces the overshoot of the step response.",
        "With 300 x5 kept, the overshoot of the steps to 90° and 180° falls with each larger weight of x1: "
        f"{', '.join(f'{weight:g}' for weight in LINK_WEIGHTS)}.",
        lambda setup: judge_weight(setup, "x1"),
    ),
    PaperClaim(
        "integral-weight-is-fast",
        "300 x5 guarantees a fast response to a step command.",
        "“Fast” is read as a short time of rise from 10 to 90 % of the step. With 60 x1 kept, it falls at 90° and at "
        f"180° with each larger weight of x5: {', '.join(f'{weight:g}' for weight in INTEGRAL_WEIGHTS)}.",
        lambda setup: judge_weight(setup, "x5"),
    ),
)

ABOUT_THE_GOAL = PaperClaim(
    "beats-linear-about-the-goal",
    "NL-H∞ steps better than L-H∞ where both are designed about the goal.",
    "On the steps of 180° and 90°, NL-H∞ has less overshoot and a shorter settling time (±2 %) than L-H∞, both "
    "expanded about the goal at the same γ/γ*. The paper expands both about the hanging rest; flexhinf design "
    "expands them about the goal.",
    _beats_linear_about_the_goal,
    ours=True,
)
