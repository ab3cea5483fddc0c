"""The paper's arm, problem, laws and estimators, and one way to run them in a closed loop.

What the paper leaves open or misprints, and what was taken instead; the report states all of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.analysis import Population, corner_population
from flexhinf.errors import InfeasibleGamma
from flexhinf.estimation import ExtendedKalmanFilter, UnscentedKalmanFilter
from flexhinf.hinf import HJISolution, smallest_gamma, solve_hji
from flexhinf.loop import Controller, Ensemble, Loop, Step, Trajectory
from flexhinf.paper.settings import PaperSettings
from flexhinf.plant import GeneralisedPlant, Law, Penalty, Plant
from flexhinf.robot import Robot, paper_arm

#: R2 of Eq. (11).
EFFORT = 10.0
#: P0 = 1e-4 I: the arm starts at rest, known to about half a degree.
INITIAL_VARIANCE = 1e-4
#: The paper's two commands, rad.
GOALS = (math.pi / 2, math.pi)
#: Plants sampled uniformly within the tolerances: those of Figs. 9 and 10.
SAMPLED_PLANTS = 100
#: Length of a long run, s: a growth of 0.07/s makes a factor of 8 in it, and 1.7 in the 8 s of a step response.
LONG = 30.0
#: Samples that may be spent on a set of runs: 130 runs of 30 s at 1 kHz.
SAMPLES = 4_000_000


class PaperSetup:
    """What all figures and claims share; everything is computed once, on first use.

    Raises
    ------
    InfeasibleGamma
        If γ is not above γ*.
    """

    def __init__(self, settings: PaperSettings) -> None:
        self.settings = settings
        self.arm: Robot = paper_arm()
        self.problem: GeneralisedPlant = self.arm.problem()
        self.gamma_star: float = smallest_gamma(self.problem)
        self.gamma: float = settings.gamma_ratio * self.gamma_star
        if self.gamma <= self.gamma_star:
            raise InfeasibleGamma(self.gamma, self.gamma_star)
        self._laws: dict[tuple[Any, ...], HJISolution] = {}

    # Laws -------------------------------------------------------------------------------------------------------
    @cached_property
    def nonlinear(self) -> HJISolution:
        """NL-H∞, the paper's law (degree as set)."""
        return solve_hji(self.problem, gamma=self.gamma, degree=self.settings.degree)

    @cached_property
    def linear(self) -> HJISolution:
        """L-H∞: the same problem, degree 2."""
        return solve_hji(self.problem, gamma=self.gamma, degree=2)

    def law(
        self,
        weights: Mapping[str, float] | None = None,
        *,
        degree: int | None = None,
        pose: float | None = None,
    ) -> HJISolution:
        """NL-H∞ at the settings' ratio of its own γ*; solved once each.

        Parameters
        ----------
        weights : mapping of state to float, optional
            Instead of the paper's; R2 is kept.
        degree : int, optional
            Of V; the settings' by default.
        pose : float, optional
            Link position to expand about, rad; the hanging rest by default.
        """
        degree = self.settings.degree if degree is None else degree
        key = (None if weights is None else tuple(sorted(weights.items())), degree, pose)
        if key not in self._laws:
            problem = self.arm.problem(None if weights is None else Penalty(weights, effort=EFFORT), pose)
            gamma = self.settings.gamma_ratio * smallest_gamma(problem)
            self._laws[key] = solve_hji(problem, gamma=gamma, degree=degree)
        return self._laws[key]

    # Estimators -------------------------------------------------------------------------------------------------
    @cached_property
    def model(self) -> Plant:
        """The plant the estimators believe in: nominal, coil neglected."""
        return self.arm.plant()

    def estimator(
        self, kind: str | None = None, mean: Any = None, covariance: Any = INITIAL_VARIANCE, **options: Any
    ) -> Any:
        """An estimator of this kind (the settings' by default) from rest or another mean; None for "none"."""
        s, kind = self.settings, self.settings.estimator if kind is None else kind
        if kind == "none":
            return None
        start = np.zeros(self.model.n) if mean is None else mean
        build = UnscentedKalmanFilter if kind == "ukf" else ExtendedKalmanFilter
        return build(self.model, s.period, s.process_noise, s.measurement_noise, start, covariance, **options)

    @property
    def feedback(self) -> str:
        """What is fed back to the law, for a sentence."""
        kind = self.settings.estimator
        return "the true state" if kind == "none" else f"the {kind.upper()}"

    def seed(self, k: int) -> int:
        """Seed of the k-th of several runs (k < 1000): no two settings share one."""
        return 1000 * self.settings.seed + k

    # Plants ----------------------------------------------------------------------------------------------------
    @cached_property
    def population(self) -> Population:
        """Plants within Tables 1 and 2: sampled ones, all 2048 corners, each tolerance alone, and the nominal one."""
        arm, count = self.arm, len(self.arm.uncertain)
        return corner_population(arm.corner, count, 2**count, self.settings.seed, arm.draw, SAMPLED_PLANTS)

    # Runs -------------------------------------------------------------------------------------------------------
    def run(
        self,
        law: Law,
        reference: Any,
        duration: float,
        *,
        inductance: bool = False,
        disturbance: Any = None,
        estimator: Any = "settings",
        noise: bool = True,
        seed: int | None = None,
    ) -> Trajectory:
        """Simulate one closed loop from the hanging rest; a run that diverges says so in its status."""
        loop, deviation = self._loop(law, estimator, inductance, noise)
        seed = self.settings.seed if seed is None else seed
        return loop.run(reference, disturbance, deviation, duration, None, seed)

    def deployed_step(self, law: Law, goal: float, duration: float) -> Trajectory:
        """The step from the hanging rest as `flexhinf design` runs it, without a jump of the input; coil included."""
        loop, deviation = self._loop(law, "settings", inductance=True, noise=True)
        controller = Controller(law, loop.controller.estimator, self.settings.period, start="bumpless")
        rest, held = self.arm.operating_point(0.0, ("inductance",))
        deployed = Loop(loop.true_plant, controller)
        return deployed.run(Step(goal), None, deviation, duration, rest, self.settings.seed, held)

    def ensemble(
        self,
        law: Law,
        reference: Any,
        duration: float,
        *,
        inductance: bool = False,
        disturbance: Any = None,
        estimator: Any = "settings",
        noise: bool = True,
        **wanted: Any,
    ) -> Ensemble:
        """The same of many plants; `wanted` is what `Loop.ensemble` keeps of them."""
        loop, deviation = self._loop(law, estimator, inductance, noise)
        return loop.ensemble(reference, disturbance, deviation, duration, **wanted)

    def _loop(self, law: Law, estimator: Any, inductance: bool, noise: bool) -> tuple[Loop, float | None]:
        """With the deviation of the measurement noise; "settings" is the estimator of the settings."""
        chosen = self.estimator() if isinstance(estimator, str) else estimator
        deviation = math.sqrt(self.settings.measurement_noise) if noise and chosen is not None else None
        return self.loop(law, chosen, inductance), deviation

    def loop(self, law: Law, estimator: Any, inductance: bool = False) -> Loop:
        """A loop around the true plant."""
        return Loop(self._true_plants[inductance], Controller(law, estimator, self.settings.period))

    @cached_property
    def _true_plants(self) -> dict[bool, Plant]:
        return {coil: self.arm.plant(inductance=coil) for coil in (False, True)}


# Many runs -----------------------------------------------------------------------------------------------
def name_goal(goal: float) -> str:
    """``90°``."""
    return f"{math.degrees(goal):.0f}°"


def affordable(wanted: int, period: float, duration: float = LONG) -> int:
    """How many runs to make of those wanted: all of them unless the period is far below 1 ms."""
    return max(1, min(wanted, int(SAMPLES * period / duration)))


def in_two_threads(function: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
    """The first alone, which compiles what the others share; compiled runs let the other thread go on."""
    if not items:
        return []
    first = function(items[0])
    with ThreadPoolExecutor(2) as pool:
        return [first, *pool.map(function, items[1:])]
