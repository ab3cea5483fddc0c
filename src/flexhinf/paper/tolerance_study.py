"""The paper's loop with every plant of the tolerances of Tables 1 and 2, in equilibrium at both goals, over R^v.

The paper gives no R^v. Four forms are computed: q on every state (R^v = q I), on both velocities (what a model misses
are torques), on the link's velocity alone, and on the motor's alone. Only the ratio of R^v to R^n matters for the gain.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.analysis import FORMS, VELOCITIES, EquilibriumLoop, GrowthRates, ProcessNoise, growth_rates
from flexhinf.estimation import ExtendedKalmanFilter
from flexhinf.hinf import smallest_gamma, solve_hji
from flexhinf.paper.loop_setup import GOALS, INITIAL_VARIANCE, PaperSetup
from flexhinf.plant import Law

NO_ESTIMATOR = "true state fed back"

#: q that are swept over, variance per sample.
SWEPT = (1e-10, 1e-8, 1e-7, 1e-6, 1e-4, 1e-2)


def swept_noises(forms: Sequence[str] = FORMS) -> tuple[ProcessNoise, ...]:
    """Every form with every q."""
    return tuple(ProcessNoise(form, q) for form in forms for q in SWEPT)


def growth_with(
    setup: PaperSetup,
    law: Law,
    noises: Sequence[ProcessNoise | None] = (None,),
    plants: np.ndarray | None = None,
    goals: Sequence[float] = GOALS,
    estimated: bool = True,
) -> dict[float, tuple[GrowthRates, ...]]:
    """Growth rates of a law's loop by goal, for every R^v (None: that of the settings).

    Parameters
    ----------
    plants : (N,) array of int, optional
        Only these of `PaperSetup.population`.
    goals : sequence of float
        rad.
    estimated : bool
        Whether the estimator of the settings is in the loop; otherwise the true state is fed back.
    """
    coil, period, population = setup.arm.plant(inductance=True), setup.settings.period, setup.population

    interrupted = threading.Event()

    def going_on() -> None:
        if interrupted.is_set():
            raise CancelledError

    def at(goal: float) -> tuple[GrowthRates, ...]:
        return growth_rates(loops[goal], population, noises, plants, going_on)

    filter = setup.estimator() if estimated else None
    loops = {goal: EquilibriumLoop(law, filter, coil, period, goal) for goal in goals}
    with ThreadPoolExecutor(2) as pool:  # eigenvalues of many plants at once let the other thread go on
        try:
            return dict(zip(goals, pool.map(at, goals), strict=True))
        except BaseException:  # Ctrl-C reaches this thread only, and the pool waits for the others
            interrupted.set()
            raise


@dataclass(frozen=True, eq=False)
class ToleranceStudy:
    """Growth rates of one law's loop with all plants of `PaperSetup.population`.

    Attributes
    ----------
    chosen : dict of float to GrowthRates
        By goal, with the R^v of the settings, or with the true state fed back where the settings have no estimator.
    true_state : dict of float to GrowthRates
        By goal, with the true state fed back.
    swept : dict of float to tuple of GrowthRates
        By goal, over all forms and q; empty without an estimator.
    """

    setup: PaperSetup
    chosen: dict[float, GrowthRates]
    true_state: dict[float, GrowthRates]
    swept: dict[float, tuple[GrowthRates, ...]]

    @staticmethod
    def of(setup: PaperSetup, law: Law) -> ToleranceStudy:
        """Every plant, at both goals, with every R^v."""
        true_state = {g: r[0] for g, r in growth_with(setup, law, estimated=False).items()}
        if setup.settings.estimator == "none":
            return ToleranceStudy(setup, true_state, true_state, dict.fromkeys(GOALS, ()))
        found = growth_with(setup, law, (None, *swept_noises()))
        chosen, swept = {g: r[0] for g, r in found.items()}, {g: r[1:] for g, r in found.items()}
        return ToleranceStudy(setup, chosen, true_state, swept)

    @property
    def estimated(self) -> bool:
        """Whether an estimator is in the loop, and R^v can be swept over."""
        return any(self.swept.values())

    @property
    def holds(self) -> bool:
        """The criterion: with the R^v of the settings the loop is stable with every plant at both goals."""
        return all(rates.unstable == 0 for rates in self.chosen.values())

    def of_form(self, form: str, goal: float) -> list[GrowthRates]:
        """Over q, in its order."""
        return [rates for rates in self.swept[goal] if rates.noise is not None and rates.noise.form == form]

    def count(self, kind: str) -> int:
        """How many plants of a kind there are: "draw" (sampled), "corner", "single" or "nominal"."""
        return int((self.setup.population.kinds == kind).sum())

    def sufficient_alone(self, rates: Sequence[GrowthRates]) -> list[str]:
        """The single tolerances that make the loop unstable in any of these, by their changes."""
        singles = np.flatnonzero(self.setup.population.kinds == "single")
        worst = np.max([each.rates[singles] for each in rates], axis=0)
        chosen = singles[np.argsort(-worst)][: int((worst >= 0.0).sum())]
        return [self.setup.population.describe(int(k)) for k in chosen]


def unstable_of(rates: GrowthRates, kind: str) -> int:
    """How many plants of a kind make the loop unstable."""
    return int((rates.rates[rates.kinds == kind] >= 0.0).sum())


# Another design of the same weights -----------------------------------------------------------------------
#: γ/γ*, q of the velocities, R^n and the goal (rad) that ``flexhinf design paper --pose 90deg`` had by default.
OTHER_RATIO, OTHER_NOISE, OTHER_MEASUREMENT, OTHER_GOAL = 1.5, 1e-7, 1e-8, math.pi / 2


def other_design(setup: PaperSetup) -> GrowthRates:
    """The loop that `flexhinf design` makes of the paper's weights: law about 90°, γ = 1.5 γ*, R^v on the velocities.

    None of this is in the paper; it is shown because its count of unstable corners is quoted beside this report's.
    """
    problem: Any = setup.arm.problem(pose=OTHER_GOAL)
    law = solve_hji(problem, gamma=OTHER_RATIO * smallest_gamma(problem), degree=4)
    noise = ProcessNoise(VELOCITIES, OTHER_NOISE).covariance(setup.model.states)
    start = law.operating_point[: setup.model.n]
    filter = ExtendedKalmanFilter(
        setup.model, 1e-3, np.diag(noise), OTHER_MEASUREMENT, start, INITIAL_VARIANCE
    )
    coil = setup.arm.plant(inductance=True)
    loop = EquilibriumLoop(law, filter, coil, 1e-3, OTHER_GOAL, moving=True)
    return growth_rates(loop, setup.population)[0]
