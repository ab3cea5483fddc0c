"""Where the loop does not withstand the tolerances: the smallest change of the penalty with which it does.

The paper's penalty (11) leaves x2, x3 and x4 free, and with them the joint's vibration. They get the weights
s (9, 30, 9), under which motions at 3.3 rad/s, about the pace of the loop, count alike as position and as
velocity; 60 x1 and 300 x5 stay. The smallest s is found by bisection on eigenvalues: no plant of the
population may be unstable at either goal for any R^v of the cases asked for. Runs confirm it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from flexhinf.analysis import Population
from flexhinf.errors import FlexhinfError
from flexhinf.hinf import HJISolution
from flexhinf.loop import Step
from flexhinf.paper.bench import PaperBench
from flexhinf.paper.claims.smallest import smallest_change
from flexhinf.paper.tolerance_sweep import ALL_STATES, GOALS, Case, ToleranceSweep, name_goal, population_of
from flexhinf.report import Column, Table

__all__ = ["Repair", "cost_table", "repaired_penalty", "scaled_weights", "smallest_repair", "study"]

DIRECTION = {"link_velocity": 9.0, "motor_position": 30.0, "motor_velocity": 9.0}

#: Where the search begins and ends.
SMALLEST, LARGEST = 0.05, 12.8

#: Of the worst cases at each goal, how many are bisected on, with how many plants. All are checked after.
WORST_CASES, WORST_PLANTS = 3, 16

#: How often what the check of all brings up is added and the bisection begun again.
ROUNDS = 4

Rates = dict[tuple[Case, float], np.ndarray]


@dataclass(frozen=True)
class Study:
    """The population and its growth rates under the paper's penalty."""

    population: Population
    sweep: ToleranceSweep
    rates: Rates


@lru_cache(maxsize=2)
def study(bench: PaperBench) -> Study:
    """Growth rates for the settings' R^v, the swept ones, and the true state fed back."""
    population, sweep = population_of(bench), ToleranceSweep(bench, bench.nonlinear)
    cases = dict.fromkeys((Case("true state fed back"), sweep.chosen, *sweep.swept))
    return Study(population, sweep, sweep.growth(tuple(cases), population))


@dataclass(frozen=True)
class Repair:
    """A penalty that withstands the tolerances.

    Attributes
    ----------
    scale : float
        s.
    weights : dict
        By state.
    law : HJISolution
    slowest : float
        Largest growth rate over all plants, goals and cases, 1/s; negative.
    """

    scale: float
    weights: dict[str, float]
    law: HJISolution
    slowest: float


def scaled_weights(bench: PaperBench, scale: float) -> dict[str, float]:
    """The paper's weights with s (9, 30, 9) on x2, x3, x4."""
    names = bench.problem.state_names
    penalty = bench.arm.penalty
    assert penalty is not None  # the paper's arm has its own
    own = dict(zip(names, penalty.weights(names), strict=True))
    return {name: float(own[name] + scale * DIRECTION.get(name, 0.0)) for name in names}


def smallest_repair(bench: PaperBench, cases: Sequence[Case]) -> Repair | None:
    """The smallest s for which no plant is unstable in any of the cases; None if none is found."""
    known = study(bench)
    watched = _worst({key: rates for key, rates in known.rates.items() if key[0] in cases})
    values, begin = known.population.values, SMALLEST
    for _ in range(ROUNDS):
        scale = smallest_change(lambda s: _withstands(bench, s, watched, values), begin, LARGEST)
        if scale is None:
            return None
        scale = np.ceil(scale * 20.0) / 20.0
        weights = scaled_weights(bench, scale)
        law = bench.law(weights)
        rates = ToleranceSweep(bench, law).growth(cases, known.population)
        slowest = max(float(r.max()) for r in rates.values())
        if slowest < 0.0:
            return Repair(float(scale), weights, law, slowest)
        for key, found in rates.items():
            if found.max() >= 0.0:
                plants = np.argsort(-found)[:WORST_PLANTS]
                watched[key] = np.union1d(watched.get(key, plants), plants)
        begin = scale / 1.5
    return None


def _worst(rates: Rates) -> dict[tuple[Case, float], np.ndarray]:
    """The plants to bisect on: the worst of the worst cases at each goal."""
    watched = {}
    for goal in GOALS:
        keys = sorted((k for k in rates if k[1] == goal), key=lambda k: -float(rates[k].max()))
        for key in keys[:WORST_CASES]:
            watched[key] = np.argsort(-rates[key])[:WORST_PLANTS]
    return watched


def _withstands(bench: PaperBench, scale: float, watched: dict, values: Sequence[Any]) -> bool:
    try:
        sweep = ToleranceSweep(bench, bench.law(scaled_weights(bench, scale)))
    except FlexhinfError:
        return False
    for (case, goal), plants in watched.items():
        if sweep.rates(case, goal, [values[k] for k in plants]).max() >= 0.0:
            return False
    return True


@lru_cache(maxsize=2)
def repairs(bench: PaperBench) -> dict[str, Repair | None]:
    """For R^v on all states, and for both forms; for the true state fed back where nothing estimates."""
    sweep = study(bench).sweep
    if not sweep.estimated:
        return {"the true state fed back": smallest_repair(bench, (sweep.chosen,))}
    own = tuple(dict.fromkeys((sweep.chosen, *(c for c in sweep.swept if c.form == ALL_STATES))))
    every = tuple(dict.fromkeys((*own, *sweep.swept)))
    return {"R^v = q I": smallest_repair(bench, own), "both forms of R^v": smallest_repair(bench, every)}


def repaired_penalty(bench: PaperBench) -> dict[str, float] | None:
    """Weights by state that withstand the tolerances for every R^v of the sweep; None if none were found."""
    found = list(repairs(bench).values())[-1]
    return None if found is None else dict(found.weights)


def cost_table(bench: PaperBench) -> Table:
    """What the repairs cost the nominal arm."""
    rows = [_cost(bench, "the paper's", 0.0, bench.nonlinear)]
    rows += [_cost(bench, f"repaired for {name}", r.scale, r.law) for name, r in repairs(bench).items() if r]
    columns = ["penalty", Column("s", "", 2), Column("γ*", "", 1)]
    for goal in GOALS:
        columns += [
            Column(f"{name_goal(goal)} overshoot", "%", 2),
            Column(f"{name_goal(goal)} settling", "s", 2),
            Column(f"{name_goal(goal)} peak", "V", 1),
        ]
    columns.append(Column("deviation under 2 N·m at the link", "°", 2))
    caption = (
        "What the repair costs the nominal arm: weights s (9, 30, 9) on x2, x3, x4, the others the paper's."
    )
    return Table(columns, rows, caption, "table-repair")


def _cost(bench: PaperBench, name: str, scale: float, law: HJISolution) -> list[Any]:
    row: list[Any] = [name, scale, law.gamma_star]
    for goal in GOALS:
        m = bench.run(law, Step(goal), 8.0).metrics
        row += [m["overshoot_percent"], m["settling_time_s"], m["peak_input"]]
    pushed = bench.run(law, Step(GOALS[0]), 14.0, disturbance={"link_torque": Step(2.0, at=8.0)})
    if pushed.diverged_at is not None:
        return [*row, None]
    run = pushed.run
    off = np.abs(run.signal("state", "link_position") - GOALS[0])[run.time >= 8.0]
    return [*row, float(np.degrees(off.max()))]
