"""One synthesis: robot, specification and step, for which problems are chosen and loops closed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flexhinf.design.estimators import EstimatorNoise
from flexhinf.design.loop_setup import LoopSetup
from flexhinf.design.problem.presets import DesignProblem, choose
from flexhinf.design.specification import Specification
from flexhinf.hinf import solve_hji
from flexhinf.plant import GeneralisedPlant, Law
from flexhinf.robot import Robot


@dataclass(frozen=True, eq=False)
class Task:
    """The step from `start` to `goal` (n,), link positions in rad or m; `progress` is called with what comes next."""

    robot: Robot
    s: Specification
    goal: np.ndarray
    start: np.ndarray
    progress: Callable[[str], None] = lambda text: None

    def choose(self, near: DesignProblem | None = None, **changes: Any) -> DesignProblem:
        """The problem of the specification with changes, searched from the weights of another one."""
        return choose(self.robot, self.goal, self.start, replace(self.s, **changes), near=near)

    def setup(self, law: Law, levels: EstimatorNoise | None = None, **changes: Any) -> LoopSetup:
        """The loop of a law, with these noise levels and changes of the specification."""
        s = replace(self.s, **changes)
        return LoopSetup(self.robot, s, law, self.goal, self.start, estimator_noise=levels)

    def solved(
        self,
        problem: GeneralisedPlant,
        gamma: float,
        degree: int,
        levels: EstimatorNoise | None = None,
        **changes: Any,
    ) -> LoopSetup:
        """The loop of the law that solves a problem."""
        return self.setup(solve_hji(problem, gamma, degree), levels, **changes)
