"""Where the loop does not withstand the tolerances: the smallest change of the penalty with which it does.

x2, x3 and x4 get the weights s (9, 30, 9), see `judgement`. The smallest s is found by bisection on growth rates: no
plant of the population (all corners among them) may be unstable at either goal for any R^v of the forms asked for.
Runs confirm it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.analysis import (
    ALL_STATES,
    LINK_VELOCITIES,
    MOTOR_VELOCITIES,
    VELOCITIES,
    GrowthRates,
    ProcessNoise,
)
from flexhinf.errors import FlexhinfError
from flexhinf.hinf import HJISolution
from flexhinf.loop import Step
from flexhinf.paper.claims.judgement import (
    LARGEST_SCALE,
    SMALLEST_SCALE,
    damped_law,
    scaled_weights,
    smallest_change,
)
from flexhinf.paper.experiments import STEP_DURATION, TORQUE
from flexhinf.paper.loop_setup import GOALS, PaperSetup, name_goal
from flexhinf.paper.tolerance_study import (
    NO_ESTIMATOR,
    ToleranceStudy,
    growth_with,
    swept_noises,
    unstable_of,
)
from flexhinf.report import Column, Table

#: Of the worst R^v at each goal, how many are bisected on, with how many plants. All are checked after.
WORST_NOISES, WORST_PLANTS = 3, 16

#: How often what the check of all brings up is added and the bisection begun again.
ROUNDS = 4

#: s is rounded up to a multiple of this.
STEP_OF_SCALE = 0.05

#: By goal and R^v: the plants to bisect on.
Watched = dict[tuple[float, ProcessNoise | None], np.ndarray]


@dataclass(frozen=True)
class Repair:
    """A penalty with which no plant is unstable.

    Attributes
    ----------
    name : str
        For which R^v.
    scale : float
        s.
    weights : dict
        By state.
    slowest : float
        Largest growth rate over all plants, goals and R^v asked for, 1/s; negative.
    """

    name: str
    scale: float
    weights: dict[str, float]
    law: HJISolution
    slowest: float


def find_repairs(setup: PaperSetup, study: ToleranceStudy) -> list[Repair]:
    """For R^v = q I, and for q on the velocities too; for the true state fed back where nothing estimates."""
    asked = {"R^v = q I": (ALL_STATES,), "R^v = q I and q on the velocities": (ALL_STATES, VELOCITIES)}
    if not study.estimated:
        asked = {NO_ESTIMATOR: ()}
    found: list[Repair] = []
    for name, forms in asked.items():
        begin = found[-1].scale - STEP_OF_SCALE if found else SMALLEST_SCALE
        repair = smallest_repair(setup, study, name, forms, max(begin, SMALLEST_SCALE))
        if repair is not None:
            found.append(repair)
    return found


def smallest_repair(
    setup: PaperSetup, study: ToleranceStudy, name: str, forms: Sequence[str], begin: float = SMALLEST_SCALE
) -> Repair | None:
    """The smallest s above `begin` for which no plant is unstable with the settings' R^v or any of these forms;
    None without one.
    """
    noises = (None, *swept_noises(forms))
    known = {(g, r.noise): r for g in GOALS for r in (study.chosen[g], *study.swept[g]) if r.noise in noises}
    watched = _worst(known)
    for _ in range(ROUNDS):
        scale = smallest_change(lambda s: _withstands(setup, study, s, watched), begin, LARGEST_SCALE)
        if scale is None:
            return None
        scale = STEP_OF_SCALE * math.ceil(scale / STEP_OF_SCALE - 1e-9)
        law = damped_law(setup, scale)
        found = growth_with(setup, law, noises, estimated=study.estimated)
        rates = [(goal, each) for goal in GOALS for each in found[goal]]
        slowest = max(each.fastest for _, each in rates)
        if slowest < 0.0:
            return Repair(name, scale, scaled_weights(setup, scale), law, slowest)
        for goal, each in rates:
            if each.unstable:
                plants = each.plants[np.argsort(-each.rates)[:WORST_PLANTS]]
                watched[goal, each.noise] = np.union1d(watched.get((goal, each.noise), plants), plants)
        begin = scale / 1.5
    return None


def _worst(known: dict[tuple[float, ProcessNoise | None], GrowthRates]) -> Watched:
    """The worst plants with the worst R^v at each goal."""
    watched: Watched = {}
    for goal in GOALS:
        keys = sorted((key for key in known if key[0] == goal), key=lambda key: -known[key].fastest)
        for key in keys[:WORST_NOISES]:
            watched[key] = np.argsort(-known[key].rates)[:WORST_PLANTS]
    return watched


def _withstands(setup: PaperSetup, study: ToleranceStudy, scale: float, watched: Watched) -> bool:
    try:
        law = damped_law(setup, scale)
    except FlexhinfError:
        return False
    for goal in GOALS:
        noises = [noise for at, noise in watched if at == goal]
        plants = np.unique(np.concatenate([p for (at, _), p in watched.items() if at == goal]))
        found = growth_with(setup, law, noises, plants, (goal,), study.estimated)[goal]
        if any(each.unstable for each in found):
            return False
    return True


def left_unstable(setup: PaperSetup, law: HJISolution) -> dict[str, int]:
    """Corners that a repair leaves unstable, at the worst q and goal, with the two forms of R^v it is not made for."""
    others = (LINK_VELOCITIES, MOTOR_VELOCITIES)
    corners = np.flatnonzero(setup.population.kinds == "corner")
    found = growth_with(setup, law, swept_noises(others), corners)
    rates = [each for goal in GOALS for each in found[goal]]
    return {
        form: max(unstable_of(r, "corner") for r in rates if r.noise is not None and r.noise.form == form)
        for form in others
    }


# What it costs -------------------------------------------------------------------------------------------
def cost_table(setup: PaperSetup, repairs: Sequence[Repair]) -> Table:
    """What the repairs cost the nominal arm."""
    rows = [_cost(setup, "the paper's", 0.0, setup.nonlinear)]
    rows += [_cost(setup, f"repaired for {r.name}", r.scale, r.law) for r in repairs]
    columns: list[Column | str] = ["penalty", Column("s", "", 2), Column("γ* of its problem", "", 1)]
    for goal in GOALS:
        columns += [
            Column(f"{name_goal(goal)} overshoot", "%", 2),
            Column(f"{name_goal(goal)} settling", "s", 2),
            Column(f"{name_goal(goal)} peak", "V", 1),
        ]
    columns.append(Column(f"deviation under {TORQUE:g} N·m at the link", "°", 2))
    caption = (
        "What the repair costs the nominal arm: weights s (9, 30, 9) on x2, x3, x4, the others the paper's."
    )
    return Table(columns, rows, caption, "table-repair")


def _cost(setup: PaperSetup, name: str, scale: float, law: HJISolution) -> list[Any]:
    row: list[Any] = [name, scale, law.gamma_star]
    for goal in GOALS:
        m = setup.run(law, Step(goal), STEP_DURATION).metrics()
        row += [m["overshoot_percent"], m["settling_time_s"], m["peak_input"]]
    pushed = setup.run(law, Step(GOALS[0]), 14.0, disturbance={"link_torque": Step(TORQUE, at=8.0)})
    if pushed.diverged_at is not None:
        return [*row, None]
    off = np.abs(pushed.signal("state", "link_position") - GOALS[0])[pushed.time >= 8.0]
    return [*row, float(np.degrees(off.max()))]
