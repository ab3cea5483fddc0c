"""The loop withstands the tolerances of Tables 1 and 2.

Judged on the true plant with its coil: 100 plants drawn uniformly, 400 corners of all tolerances, and each
tolerance alone at both ends, held at 90° and at 180°. Criterion: with the R^v of the settings every one of
these loops is stable, by the eigenvalues of plant, estimator at its stationary gain, integral and law. Runs
of 30 s of the nonlinear loop without noise (the worst plants, every tolerance alone, some of the drawn ones)
must agree.

The paper gives no R^v, so the same is computed over a sweep of two forms of it, and shown beside the verdict.
Without an estimator the true state is fed back, and there is nothing to sweep.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.hinf import HJISolution
from flexhinf.loop import Step
from flexhinf.paper.bench import Outcome, PaperBench
from flexhinf.paper.claims.judged import Judged
from flexhinf.paper.claims.repair import Study, cost_table, repairs, study
from flexhinf.paper.claims.tolerance_figures import share_figure, worst_figure
from flexhinf.paper.growth import LONG, affordable, growth_rate, in_two_threads
from flexhinf.paper.tolerance_sweep import GOALS, NO_ESTIMATOR, Case, name_goal
from flexhinf.report import Claim, Column, Figure, Paragraph, Table, number

__all__ = ["judge"]

TEXT = "The loop withstands the parameter tolerances of Tables 1 and 2."

#: Plants run at each goal: the worst by eigenvalue, every tolerance alone, and every tenth of those drawn.
WORST, EVERY = 8, 10

#: Below this RMS velocity, rad/s, a run has decayed to rounding and its rate says nothing.
ROUNDING = 1e-9

#: Rates nearer to zero than this, 1/s, are not told apart by a run of 30 s.
UNDECIDED = 2e-3


@dataclass(frozen=True)
class Confirmed:
    """What runs of the nonlinear loop say of the eigenvalues.

    Attributes
    ----------
    runs, agree : int
    error : float
        Largest |rate of a run − rate by eigenvalue| where both are known, 1/s.
    """

    runs: int
    agree: int
    error: float


def judge(bench: PaperBench) -> Judged:
    """withstands-tolerances."""
    known = study(bench)
    chosen = known.sweep.chosen
    holds = all(known.rates[chosen, goal].max() < 0.0 for goal in GOALS)
    confirmed = _confirm(bench, known, bench.nonlinear)
    figures = ["table-tolerances"]
    blocks: list[Any] = [Paragraph(_reading(known)), _table(known)]
    if known.sweep.estimated:
        blocks.append(share_figure(known, bench.settings.process_noise))
        figures.append("figure-tolerances")
    repair = ""
    if not holds or not all(r.max() < 0.0 for r in known.rates.values()):
        repair = _repair(bench, known)
        blocks += [cost_table(bench), _worst_runs(bench, known)]
        figures += ["table-repair", "figure-worst-plant"]
    if holds and repair:  # with the settings' R^v, but not over the sweep
        blocks.append(Paragraph(f"No plant is unstable over the sweep of R^v with {repair}"))
        repair = ""
    evidence = f"{_evidence(known)} {_agreement(confirmed)}"
    claim = Claim(
        "withstands-tolerances", TEXT, "holds" if holds else "fails", evidence, repair, tuple(figures)
    )
    numbers: dict[str, Any] = {
        "plants": len(known.population.values),
        "unstable": {name_goal(g): int((known.rates[chosen, g] >= 0.0).sum()) for g in GOALS},
        "fastest_growth_per_s": {name_goal(g): _finite(known.rates[chosen, g].max()) for g in GOALS},
        "runs": confirmed.runs,
        "runs_that_agree": confirmed.agree,
    }
    if repair:
        numbers["repair_scale"] = {name: r and r.scale for name, r in repairs(bench).items()}
    return Judged(claim, tuple(blocks), numbers)


# Words and table -----------------------------------------------------------------------------------
def _finite(rate: float) -> float | None:
    return float(rate) if math.isfinite(rate) else None


def _share(known: Study, case: Case, goal: float, kind: str) -> float:
    """Per cent of the plants of a kind that are unstable."""
    return 100.0 * float(np.mean(known.rates[case, goal][known.population.kinds == kind] >= 0.0))


def _evidence(known: Study) -> str:
    kinds, chosen, parts = known.population.kinds, known.sweep.chosen, []
    for goal in GOALS:
        rates = known.rates[chosen, goal]
        counts = [f"{int((rates[kinds == k] >= 0.0).sum())} of {int((kinds == k).sum())}" for k in KINDS]
        growth = float(rates.max())
        pace = "no rest found" if math.isinf(growth) else f"slowest mode {growth:+.3f}/s"
        parts.append(
            f"at {name_goal(goal)} {counts[0]} drawn, {counts[1]} corners, {counts[2]} single ones ({pace})"
        )
    text = f"Unstable with {chosen.name}: {'; '.join(parts)}."
    if known.sweep.estimated:
        swept = [
            f"{name_goal(g)} up to {max(_share(known, c, g, 'corner') for c in known.sweep.swept):.0f} %"
            for g in GOALS
        ]
        text += f" Over the sweep of R^v, corners unstable: {', '.join(swept)}."
        fed = [f"{_share(known, Case(NO_ESTIMATOR), g, 'corner'):.0f} % at {name_goal(g)}" for g in GOALS]
        text += f" With the true state fed back: {', '.join(fed)}."
    return text


KINDS = ("draw", "corner", "single")


def _reading(known: Study) -> str:
    if not known.sweep.estimated:
        return "Tolerances: the true state is fed back, so there is no R^v to sweep."
    return f"Tolerances. {_pace(known)} {_fastest(known)} {REASON}"


REASON = (
    "R^v = q I lets the estimator follow the measured position; q on the velocities only, the usual choice for "
    "unknown torques, makes it infer more from its model, whose vibration is not the plant's, and the paper's "
    "penalty leaves that vibration almost undamped."
)


def _pace(known: Study) -> str:
    """Whether a run of 8 s would show what grows with the settings' R^v."""
    growth = max(float(known.rates[known.sweep.chosen, goal].max()) for goal in GOALS)
    if not 0.0 <= growth < math.inf:
        return ""
    factors = [math.exp(min(growth * seconds, 50.0)) for seconds in (8.0, LONG)]
    return (
        f"With the settings' R^v the fastest growth makes a factor of {factors[0]:.2g} in 8 s and of "
        f"{factors[1]:.2g} in 30 s."
    )


def _fastest(known: Study) -> str:
    """The fastest growth of the sweep, and of a tolerance alone."""
    parts = []
    for who, chosen in (("any plant", known.population.kinds != ""), ("one tolerance alone", _single(known))):
        rates = {key: np.where(chosen & np.isfinite(r), r, -np.inf) for key, r in known.rates.items()}
        case, goal = max(rates, key=lambda key: float(rates[key].max()))
        k = int(np.argmax(rates[case, goal]))
        growth = float(rates[case, goal][k])
        where = f"{case.name} at {name_goal(goal)} ({known.population.describe(k)})"
        parts.append(f"for {who} {growth:+.3f}/s, {where}")
    return f"Over the sweep the fastest growth is {'; '.join(parts)}."


def _single(known: Study) -> np.ndarray:
    return known.population.kinds == "single"


def _table(known: Study) -> Table:
    rows = []
    cases = dict.fromkeys((Case(NO_ESTIMATOR), known.sweep.chosen, *known.sweep.swept))
    for case in cases:
        row = [case.form, None if case.q is None else number(case.q)]
        for goal in GOALS:
            row += [_share(known, case, goal, "draw"), _share(known, case, goal, "corner")]
            row.append(_finite(known.rates[case, goal].max()))
        rows.append(row)
    columns = ["R^v on", "q"]
    for goal in GOALS:
        name = name_goal(goal)
        columns += [Column(f"{name}: drawn unstable", "%", 0), Column(f"{name}: corners unstable", "%", 0)]
        columns.append(Column(f"{name}: fastest growth", "1/s", 3))
    caption = (
        "Share of unstable loops with the paper's penalty, by eigenvalues, coil included. A negative growth is the "
        "decay of the slowest loop; – where some loop has no rest at all."
    )
    return Table(columns, rows, caption, "table-tolerances")


def _agreement(confirmed: Confirmed) -> str:
    text = f"{confirmed.agree} of {confirmed.runs} runs of 30 s agree with the eigenvalues"
    return text + (f" (rates within {confirmed.error:.1e}/s)." if math.isfinite(confirmed.error) else ".")


# Runs ------------------------------------------------------------------------------------------------
def _run(bench: PaperBench, known: Study, law: HJISolution, goal: float, k: int) -> Outcome:
    estimator = bench.estimator() if known.sweep.estimated else None
    values = known.population.values[k]
    return bench.run(
        law, Step(goal), LONG, true_values=values, inductance=True, estimator=estimator, noise=False
    )


def _confirm(bench: PaperBench, known: Study, law: HJISolution) -> Confirmed:
    """30 s runs of a stated subset against the rates by eigenvalue."""
    jobs = []
    for goal in GOALS:
        rates = known.rates[known.sweep.chosen, goal]
        drawn = np.flatnonzero(known.population.kinds == "draw")[::EVERY]
        single = np.flatnonzero(known.population.kinds == "single")
        plants = dict.fromkeys([*np.argsort(-rates)[:WORST], *single, *drawn])
        jobs += [(goal, int(k), float(rates[k])) for k in plants]
    jobs = jobs[:: max(1, len(jobs) // affordable(len(jobs), bench.settings.period))]
    found = in_two_threads(lambda job: growth_rate(_run(bench, known, law, job[0], job[1])), jobs)
    agree, errors = 0, [0.0]
    for (_, _, expected), (measured, size) in zip(jobs, found, strict=True):
        decayed = size < ROUNDING and expected < 0.0
        undecided = abs(expected) < UNDECIDED and abs(measured - expected) < UNDECIDED
        agree += bool(decayed or undecided or (measured >= 0.0) == (expected >= 0.0))
        if not decayed and math.isfinite(measured) and math.isfinite(expected):
            errors.append(abs(measured - expected))
    return Confirmed(len(jobs), agree, max(errors))


def _worst_plant(known: Study) -> tuple[int, float]:
    """The plant that grows fastest with the settings' R^v, and the goal where it does."""
    goal = max(GOALS, key=lambda g: float(known.rates[known.sweep.chosen, g].max()))
    return int(np.argmax(known.rates[known.sweep.chosen, goal])), goal


def _worst_runs(bench: PaperBench, known: Study) -> Figure:
    k, goal = _worst_plant(known)
    laws = {"the paper's penalty": bench.nonlinear}
    laws |= {f"repaired, s = {r.scale:g}": r.law for r in repairs(bench).values() if r is not None}
    runs = {name: _run(bench, known, law, goal, k) for name, law in laws.items()}
    return worst_figure(runs, goal, known.population.describe(k), known.sweep.chosen.name)


def _repair(bench: PaperBench, known: Study) -> str:
    parts = []
    for name, found in repairs(bench).items():
        if found is None:
            parts.append(f"for {name}, no s up to 12.8 was found")
            continue
        weights = ", ".join(f"{w:.4g}" for w in found.weights.values())
        grown = 0
        for goal in GOALS:
            worst = np.argsort(-known.rates[known.sweep.chosen, goal])[:WORST]
            worst = worst[: affordable(WORST, bench.settings.period)]
            runs = in_two_threads(
                lambda k, goal=goal, law=found.law: growth_rate(_run(bench, known, law, goal, int(k))),
                list(worst),
            )
            grown += sum(rate >= 0.0 and size > ROUNDING for rate, size in runs)
        confirmed = (
            "the worst plants' runs decay" if not grown else f"{grown} of the worst plants' runs still grow"
        )
        parts.append(
            f"for {name}, s = {found.scale:g}, weights ({weights}): "
            f"slowest mode {found.slowest:+.3f}/s, {confirmed}"
        )
    return "weights s (9, 30, 9) on x2, x3, x4, smallest s by bisection: " + "; ".join(parts) + "."
