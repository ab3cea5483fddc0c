"""Plants within the tolerances of Tables 1 and 2, and what the linearised loop does with each, over R^v.

The paper gives no R^v. Two forms are usual: q on every state (R^v = q I), and q on the velocities only, since
what a model misses are torques. Only the ratio to R^n matters for the gain.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.analysis import (
    ALL_STATES,
    VELOCITIES,
    EquilibriumLoop,
    Population,
    ProcessNoise,
    corner_population,
)
from flexhinf.paper.bench import PaperBench
from flexhinf.plant import Law
from flexhinf.report import number

__all__ = [
    "ALL_STATES",
    "GOALS",
    "NO_ESTIMATOR",
    "VELOCITIES",
    "Case",
    "ToleranceSweep",
    "name_goal",
    "population_of",
]

#: The paper's two commands, rad.
GOALS = (math.pi / 2, math.pi)

DRAWS, CORNERS = 100, 400
NO_ESTIMATOR = "true state fed back"
SWEPT = (1e-10, 1e-9, 1e-8, 1e-7, 1e-6, 1e-4, 1e-2, 1.0)


def name_goal(goal: float) -> str:
    """``90°``."""
    return f"{math.degrees(goal):.0f}°"


def population_of(bench: PaperBench) -> Population:
    """Plants of the paper's arm; the draws are those of Figs. 9 and 10."""
    arm = bench.arm
    return corner_population(arm.corner, len(arm.uncertain), CORNERS, bench.settings.seed, arm.draw, DRAWS)


@dataclass(frozen=True)
class Case:
    """One choice of R^v, or none where the true state is fed back."""

    form: str
    q: float | None = None

    def covariance(self, states: Sequence[str]) -> np.ndarray:
        """R^v, (n, n)."""
        assert self.q is not None
        return ProcessNoise(self.form, self.q).covariance(states)

    @property
    def name(self) -> str:
        """For a sentence."""
        return self.form if self.q is None else f"R^v = {number(self.q)} on {self.form}"


class ToleranceSweep:
    """Growth rates of a law's loop for plants, goals and R^v.

    Parameters
    ----------
    bench : PaperBench
    law : Law
    """

    def __init__(self, bench: PaperBench, law: Law) -> None:
        self.bench, self.law = bench, law
        self.estimated = bench.settings.estimator != "none"
        self._loops: dict[tuple[float, bool], EquilibriumLoop] = {}

    @property
    def chosen(self) -> Case:
        """The case of the settings."""
        return Case(ALL_STATES, self.bench.settings.process_noise) if self.estimated else Case(NO_ESTIMATOR)

    @property
    def swept(self) -> tuple[Case, ...]:
        """All cases but the settings' own: none without an estimator."""
        if not self.estimated:
            return ()
        return tuple(Case(form, q) for form in (ALL_STATES, VELOCITIES) for q in SWEPT)

    def loop(self, goal: float, estimated: bool) -> EquilibriumLoop:
        """The loop at rest at a goal, made on first use."""
        if (goal, estimated) not in self._loops:
            bench = self.bench
            filter = bench.estimator() if estimated else None
            coil = bench.arm.plant(inductance=True)
            self._loops[goal, estimated] = EquilibriumLoop(
                self.law, filter, coil, bench.settings.period, goal
            )
        return self._loops[goal, estimated]

    def growth(self, cases: Sequence[Case], population: Population) -> dict[tuple[Case, float], np.ndarray]:
        """`rates` of all plants for every case and goal."""
        return {(case, goal): self.rates(case, goal, population.values) for case in cases for goal in GOALS}

    def rates(self, case: Case, goal: float, values: Sequence[Mapping[str, float]]) -> np.ndarray:
        """Growth rates (N,) in 1/s; infinite for a loop without rest."""
        loop = self.loop(goal, case.q is not None)
        noise: Any = None if case.q is None else case.covariance(self.bench.model.states)
        return loop.modes(values, noise).rate
