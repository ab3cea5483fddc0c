"""The paper's bench: arm, problem, laws and estimators, and one way to run them against each other."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.baselines import GravityCompensatedLQR
from flexhinf.errors import InfeasibleGamma
from flexhinf.estimation import ExtendedKalmanFilter, UnscentedKalmanFilter
from flexhinf.hinf import HJISolution, smallest_gamma, solve_hji
from flexhinf.loop import Controller, Loop, Trajectory
from flexhinf.paper.settings import PaperSettings
from flexhinf.plant import GeneralisedPlant, Law, Penalty, Plant
from flexhinf.robot import Robot, paper_arm

__all__ = ["INITIAL_VARIANCE", "Outcome", "PaperBench"]

#: R2 of Eq. (11).
EFFORT = 10.0
#: P0 = 1e-4 I: the arm starts at rest, known to about half a degree.
INITIAL_VARIANCE = 1e-4


@dataclass(frozen=True)
class Outcome:
    """One run, whole or up to where it diverged."""

    run: Trajectory

    @property
    def diverged_at(self) -> float | None:
        """When the run diverged, s; None if it did not."""
        return self.run.diverged_at

    @property
    def metrics(self) -> dict[str, Any]:
        """`Trajectory.metrics`: all None for a run that diverged."""
        return self.run.metrics()


class PaperBench:
    """What all figures and claims share; everything is computed once, on first use.

    Parameters
    ----------
    settings : PaperSettings

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

    # Laws -------------------------------------------------------------------------------------------------------
    @cached_property
    def nonlinear(self) -> HJISolution:
        """NL-H∞, the paper's law (degree as set)."""
        return solve_hji(self.problem, gamma=self.gamma, degree=self.settings.degree)

    @cached_property
    def linear(self) -> HJISolution:
        """L-H∞: the same problem, degree 2."""
        return solve_hji(self.problem, gamma=self.gamma, degree=2)

    @cached_property
    def nonlinear_lqr(self) -> HJISolution:
        """γ = ∞, of the same degree: the law without H∞."""
        return solve_hji(self.problem, gamma=math.inf, degree=self.settings.degree)

    @cached_property
    def gravity_lqr(self) -> GravityCompensatedLQR:
        """LQR of the arm without gravity, with gravity compensation: what a practitioner would try first."""
        return GravityCompensatedLQR.design(self.problem)

    def law(
        self,
        weights: Mapping[str, float] | None = None,
        *,
        gamma_ratio: float | None = None,
        degree: int | None = None,
    ):
        """NL-H∞ for another penalty (weights by state, R2 kept) at the same ratio of its own γ*."""
        problem = self.problem if weights is None else self.arm.problem(Penalty(weights, effort=EFFORT))
        star = smallest_gamma(problem)
        ratio = self.settings.gamma_ratio if gamma_ratio is None else gamma_ratio
        return solve_hji(
            problem, gamma=ratio * star, degree=self.settings.degree if degree is None else degree
        )

    # Estimators ---------------------------------------------------------------------------------------------------
    @cached_property
    def model(self) -> Plant:
        """The plant the estimators believe in: nominal, coil neglected."""
        return self.arm.plant()

    def estimator(self, kind: str | None = None, process_noise: float | None = None, **options: Any) -> Any:
        """An estimator of this kind (the settings' by default); None for "none"."""
        s = self.settings
        kind = s.estimator if kind is None else kind
        if kind == "none":
            return None
        q = s.process_noise if process_noise is None else process_noise
        start = options.pop("mean", np.zeros(self.model.n))
        p0 = options.pop("covariance", INITIAL_VARIANCE)
        build = UnscentedKalmanFilter if kind == "ukf" else ExtendedKalmanFilter
        return build(self.model, s.period, q, s.measurement_noise, start, p0, **options)

    @property
    def feedback(self) -> str:
        """What the law is fed with, in words."""
        kind = self.settings.estimator
        return "the true state" if kind == "none" else f"the {kind.upper()}"

    def seed(self, k: int) -> int:
        """Seed of the k-th of several runs (k < 1000): no two settings share one."""
        return 1000 * self.settings.seed + k

    # Runs -------------------------------------------------------------------------------------------------------
    def run(
        self,
        law: Law,
        reference: Any,
        duration: float,
        *,
        true_values: Mapping[str, float] | None = None,
        inductance: bool = False,
        disturbance: Any = None,
        estimator: Any = "settings",
        noise: bool = True,
        seed: int | None = None,
        initial_state: Any = None,
    ) -> Outcome:
        """Simulate one closed loop; a loop that diverges is an outcome, not an error."""
        s = self.settings
        chosen = self.estimator() if isinstance(estimator, str) and estimator == "settings" else estimator
        loop = self.loop(law, chosen, inductance, true_values)
        deviation = math.sqrt(s.measurement_noise) if noise and chosen is not None else None
        run = loop.run(
            reference, disturbance, deviation, duration, initial_state, s.seed if seed is None else seed
        )
        return Outcome(run)

    def loop(
        self, law: Law, estimator: Any, inductance: bool = False, values: Mapping[str, float] | None = None
    ) -> Loop:
        """A loop around the true plant."""
        plant = self._true_plants[inductance]
        if values is not None:
            plant = plant.with_parameters(**values)
        return Loop(plant, Controller(law, estimator, self.settings.period))

    @cached_property
    def _true_plants(self) -> dict[bool, Plant]:
        return {coil: self.arm.plant(inductance=coil) for coil in (False, True)}
