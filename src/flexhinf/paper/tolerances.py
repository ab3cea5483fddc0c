"""Claims on the plant that differs from the design's: its tolerances of Tables 1 and 2, and its coil.

The tolerances are computed on the true plant with its coil, in equilibrium at both goals. The paper gives no R^v, so
the verdict is for that of the settings. Four forms are shown beside it: q on every state (R^v = q I), on both
velocities (what a model misses are torques), on the link's velocity alone, and on the motor's alone. Only the ratio of
R^v to R^n matters for the gain. Runs of 30 s of the nonlinear loop without noise must agree with the growth rates of
the linear one.

The design takes the current as (V − k_b θ̇)/R at once; the true coil of Table 2 has its pole at R/L = 100 rad/s.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from flexhinf.analysis import FORMS, EquilibriumLoop, GrowthRates, ProcessNoise, growth_rates
from flexhinf.arrays import Matrix, Vector
from flexhinf.loop import Step
from flexhinf.numerals import number
from flexhinf.paper.loop_setup import (
    GOALS,
    LONG,
    STEP_DURATION,
    ClaimFinding,
    PaperSetup,
    StatedClaim,
    affordable,
    known,
    name_goal,
)
from flexhinf.plant import Law
from flexhinf.report import Column, Table

#: q that are swept over, variance per sample.
SWEPT = (1e-10, 1e-8, 1e-7, 1e-6, 1e-4, 1e-2)

#: Rates nearer to zero than this, 1/s, cannot be distinguished by a run of 30 s.
UNDECIDED = 2e-3
#: Early and late part of a run, as fractions of it.
EARLY, LATE = (0.4, 0.6), (0.8, 1.0)

#: Changes by the coil that still count as negligible: overshoot in per cent of the step, settling as a fraction.
OVERSHOOT, SETTLING = 1.0, 0.10


# Growth rates --------------------------------------------------------------------------------------------
def growth_with(
    setup: PaperSetup,
    law: Law,
    noises: Sequence[ProcessNoise | None] = (None,),
    plants: np.ndarray | None = None,
    goals: Sequence[float] = GOALS,
    estimated: bool = True,
) -> dict[float, tuple[GrowthRates, ...]]:
    """Growth rates of a law's loop by goal (rad), for every R^v (None: that of the settings).

    `plants` (N,) are those of `PaperSetup.population`, all by default; `estimated`: with the estimator of the
    settings in the loop, otherwise the true state is fed back.
    """
    coil, period = setup.arm.plant(inductance=True), setup.settings.period
    filter = setup.estimator() if estimated else None
    return {
        goal: growth_rates(
            EquilibriumLoop(law, filter, coil, period, goal, latency=0),
            setup.population,
            noises,
            plants,
            setup.population_vectors,
        )
        for goal in goals
    }


class ToleranceStudy:
    """Growth rates of one law's loop with all plants of `PaperSetup.population`, by goal.

    `chosen`: with the R^v of the settings, or with the true state fed back where they have no estimator;
    `true_state`: fed back; `swept`: over all forms and q, empty unless the loop is `estimated`.
    """

    def __init__(self, setup: PaperSetup, law: Law) -> None:
        self.population, self.process_noise = setup.population, setup.settings.process_noise
        self.true_state = {g: r[0] for g, r in growth_with(setup, law, estimated=False).items()}
        self.chosen = self.true_state
        self.swept: dict[float, tuple[GrowthRates, ...]] = dict.fromkeys(GOALS, ())
        self.estimated = setup.settings.estimator != "none"
        if self.estimated:
            swept = [ProcessNoise(form, q) for form in FORMS for q in SWEPT]
            rates = growth_with(setup, law, (None, *swept))
            self.chosen = {g: r[0] for g, r in rates.items()}
            self.swept = {g: r[1:] for g, r in rates.items()}

    def of_form(self, form: str, goal: float) -> list[GrowthRates]:
        """Growth rates with one form of R^v, in the order of q."""
        return [rates for rates in self.swept[goal] if rates.noise is not None and rates.noise.form == form]

    def count(self, kind: str) -> int:
        """Number of plants of a kind: "draw" (sampled), "corner", "single" or "nominal"."""
        return int((self.population.kinds == kind).sum())

    def sufficient_alone(self, rates: Sequence[GrowthRates]) -> list[str]:
        """Single tolerances that make the loop unstable by one of these rates, by their changes."""
        singles = np.flatnonzero(self.population.kinds == "single")
        worst = np.max([each.rates[singles] for each in rates], axis=0)
        return [
            self.population.describe(int(k)) for k in singles[np.argsort(-worst)][: int((worst >= 0.0).sum())]
        ]


def unstable_of(rates: GrowthRates, kind: str) -> int:
    """Number of plants of a kind that make the loop unstable."""
    return int((rates.rates[rates.kinds == kind] >= 0.0).sum())


# Runs ------------------------------------------------------------------------------------------------
def _agreement(setup: PaperSetup, study: ToleranceStudy) -> tuple[int, int, float]:
    """(runs of 30 s, number that agree with the growth rates of the linear loop, largest difference of rates in 1/s).

    The rate of a run without noise is that of the RMS of the link's velocity between two parts of it.
    """
    jobs, kinds = list[tuple[float, int, float]](), setup.population.kinds
    for goal in GOALS:
        rates, sampled = study.chosen[goal].rates, np.flatnonzero(kinds == "draw")[::10]
        # the worst by growth rate, every tolerance alone, and every tenth of those sampled
        jobs += [
            (goal, int(k), float(rates[k]))
            for k in dict.fromkeys([*np.argsort(-rates)[:8], *np.flatnonzero(kinds == "single"), *sampled])
        ]
    jobs = jobs[:: max(1, len(jobs) // affordable(len(jobs), setup.settings.period))]
    agree, error, times = 0, 0.0, np.arange(round(LONG / setup.settings.period) + 1)
    part, loop = times / times[-1], setup.loop(setup.nonlinear, inductance=True)
    for goal in GOALS:
        own = [(k, expected) for at, k, expected in jobs if at == goal]
        ensemble = loop.ensemble(Step(goal), None, None, LONG, kept=["state.link_velocity"], instants=times)
        velocities: Matrix = ensemble.run([setup.population.values[k] for k, _ in own]).kept[:, :, 0]
        for (_, expected), velocity in zip(own, velocities, strict=True):
            measured = late = np.inf  # of a run that diverged
            if not np.isnan(velocity).any():
                windows: list[Vector] = [
                    velocity[(part >= first) & (part <= last)] for first, last in (EARLY, LATE)
                ]
                early, late = (max(float(np.sqrt(np.mean(window**2))), 1e-300) for window in windows)
                measured = float(np.log(late / early) / (LONG * (LATE[0] - EARLY[0])))
            decayed = late < 1e-9 and expected < 0.0  # to rounding: its rate says nothing
            undecided = abs(expected) < UNDECIDED and abs(measured - expected) < UNDECIDED
            agree += bool(decayed or undecided or (measured >= 0.0) == (expected >= 0.0))
            if not decayed and math.isfinite(measured) and math.isfinite(expected):
                error = max(error, abs(measured - expected))
    return len(jobs), agree, error


# Tolerances ----------------------------------------------------------------------------------------------
def _robust_to_tolerances(setup: PaperSetup) -> ClaimFinding:
    study = ToleranceStudy(setup, setup.nonlinear)
    chosen, (runs, agree, error) = study.chosen, _agreement(setup, study)
    parts: list[str] = []
    for goal, rates in chosen.items():
        slowest = f"slowest mode {number(rates.fastest, decimals=3)}/s"
        parts.append(
            f"at {name_goal(goal)} {unstable_of(rates, 'corner')} of {study.count('corner')} corners and "
            f"{unstable_of(rates, 'draw')} of {study.count('draw')} sampled plants "
            f"({'some plant has no equilibrium' if math.isinf(rates.fastest) else slowest})"
        )
    which = (
        f"R^v = {number(setup.settings.process_noise)} I" if study.estimated else "the true state fed back"
    )
    growth, grows = max(rates.fastest for rates in chosen.values()), ""
    if 0.0 <= growth < math.inf:
        factors = [f"{math.exp(min(growth * t, 50.0)):.2g} in {t:g} s" for t in (STEP_DURATION, LONG)]
        grows = f" The fastest growth makes a factor of {' and of '.join(factors)}."
    return ClaimFinding(
        all(rates.unstable == 0 for rates in chosen.values()),
        f"Unstable with {which}: {'; '.join(parts)}.{grows} {agree} of {runs} runs of {LONG:g} s agree with the growth "
        f"rates of the linear loop (within {number(error, 2)}/s).",
        _tolerance_table(study),
        {
            "plants": len(setup.population),
            "corners": study.count("corner"),
            "unstable": {name_goal(g): chosen[g].unstable for g in GOALS},
            "unstable_corners": {name_goal(g): unstable_of(chosen[g], "corner") for g in GOALS},
            "fastest_growth_per_s": {name_goal(g): known(chosen[g].fastest) for g in GOALS},
            "swept_unstable_corners": {
                name_goal(g): [
                    [r.noise.form, r.noise.q, unstable_of(r, "corner")] for r in study.swept[g] if r.noise
                ]
                for g in GOALS
            },
            "runs": runs,
            "runs_that_agree": agree,
        },
        study,
        {name_goal(goal): rates.unstable == 0 for goal, rates in chosen.items()},
    )


def _tolerance_table(study: ToleranceStudy) -> Table:
    rows: list[tuple[object, ...]] = []
    for goal in GOALS:
        groups = {"true state fed back": [study.true_state[goal]]}
        if study.estimated:
            groups[f"R^v = {number(study.process_noise)} I (settings)"] = [study.chosen[goal]]
            groups |= {f"q on {form}": study.of_form(form, goal) for form in FORMS}
        for which, group in groups.items():
            corners, alone = [unstable_of(rates, "corner") for rates in group], study.sufficient_alone(group)
            rows.append(
                (
                    name_goal(goal),
                    which,
                    min(corners),
                    max(corners),
                    max(unstable_of(rates, "draw") for rates in group),
                    known(max(rates.fastest for rates in group)),
                    ("; ".join(alone[:3]) + (f" and {len(alone) - 3} more" if len(alone) > 3 else ""))
                    or "none",
                )
            )
    return Table(
        (
            "goal",
            "R^v",
            Column("corners unstable, fewest over q"),
            Column("corners unstable, most over q"),
            Column("sampled plants unstable, most over q"),
            Column("fastest growth", "1/s", 3),
            "one tolerance alone suffices",
        ),
        rows,
        f"Plants with which the loop is unstable, of {study.count('corner')} corners and {study.count('draw')} sampled "
        f"ones, with the paper's penalty and the coil; q from {number(SWEPT[0])} to {number(SWEPT[-1])}. A negative "
        "growth is the decay of the slowest loop; – where some plant has no equilibrium.",
        "table-tolerances",
    )


# Coil ----------------------------------------------------------------------------------------------------
def _coil_is_negligible(setup: PaperSetup) -> ClaimFinding:
    law, growth, slowest = setup.nonlinear, -math.inf, np.zeros(1, dtype=complex)
    rows: list[tuple[object, ...]] = []
    changes: list[tuple[float, float]] = []
    for kind in dict.fromkeys(("none", setup.settings.estimator)):
        for goal in GOALS:
            metrics: list[Vector] = []
            for coil, plant in setup.true_plants.items():
                filter = setup.estimator(kind)
                run = setup.run(
                    law, Step(goal), STEP_DURATION, estimator=filter, noise=False, inductance=coil
                )
                loop = EquilibriumLoop(law, filter, plant, setup.settings.period, goal, latency=0)
                slowest = loop.modes([setup.arm.nominal]).slowest(5)[0]
                values = [
                    run.metrics()[key] for key in ("overshoot_percent", "settling_time_s", "peak_input")
                ]
                rows.append(
                    (
                        "true state" if kind == "none" else kind.upper(),
                        name_goal(goal),
                        "yes" if coil else "no",
                        *values,
                        ", ".join(
                            [
                                f"{m.real:.3f}" + (f" ± {m.imag:.2f}i" if m.imag > 1e-9 else "")
                                for m in map(complex, slowest)
                                if math.isfinite(m.real) and m.imag >= 0.0
                            ]
                        )
                        or "no equilibrium",
                    )
                )
                metrics.append(np.array(values, dtype=float))
            growth = max(growth, float(slowest[0].real))  # with the coil
            without, with_coil = metrics  # NaN where a run diverges or does not settle
            changes.append((abs(with_coil[0] - without[0]), abs(with_coil[1] / without[1] - 1.0)))
    worst, slower = np.nan_to_num(changes).max(axis=0).tolist()
    lost = int(np.isnan(changes).any(axis=1).sum())
    rate = f"the slowest mode of any loop has a rate of {number(growth, decimals=3)}/s"
    unknown = f" In {lost} of {len(changes)} cases a run diverges or does not settle, so no change is known."
    return ClaimFinding(
        not lost and worst <= OVERSHOOT and slower <= SETTLING and growth < 0.0,
        f"The coil changes the overshoot by at most {worst:.2f} % of the step and the settling time by at most "
        f"{100 * slower:.1f} %; with it {rate if math.isfinite(growth) else 'some loop has no equilibrium'}."
        f"{unknown if lost else ''}",
        Table(
            (
                "feedback",
                "step",
                "coil",
                Column("overshoot", "%", 3),
                Column("settling", "s", 3),
                Column("peak", "V", 2),
                Column("slowest modes", "1/s"),
            ),
            rows,
            "Steps and slowest modes in equilibrium, without and with the coil; nominal arm, no noise.",
            "table-electrical-pole",
            stacks=True,
        ),
        {"largest_overshoot_change_percent": worst},
    )


COIL = StatedClaim(
    "electrical-pole-negligible",
    "The motor's electrical pole is negligible in the design.",
    f"With the true state fed back and with the estimator, the coil changes the overshoot of a step to 90° or 180° by "
    f"at most {OVERSHOOT:g} % of the step and the settling time by at most {100 * SETTLING:g} %, and leaves the loop "
    "stable in equilibrium there.",
    _coil_is_negligible,
)

TOLERANCES = StatedClaim(
    "withstands-tolerances",
    "The loop withstands the parameter tolerances of Tables 1 and 2.",
    "With the R^v of the settings, coil in the plant, the loop in equilibrium at 90° and at 180° is stable with "
    "every plant tried: all 2048 corners of the tolerances, each tolerance alone, and the 100 sampled plants of "
    "Figure 9. The paper gives no R^v; other forms of it are shown and not judged.",
    _robust_to_tolerances,
)
