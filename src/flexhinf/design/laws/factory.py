"""Laws about the goal of a design, made of its model and its weights."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

from flexhinf.design.laws.kinds import (
    CHANNELS,
    DEGREE,
    DESIGN,
    ESTIMATOR,
    NO_CHANNELS,
    NO_VELOCITY,
    PARAMETERS,
    QUADRATIC,
    ROUNDING,
    LawKind,
)
from flexhinf.validation import late_package

if TYPE_CHECKING:
    import numpy as np

    from flexhinf.design.synthesis.steps import Synthesis
    from flexhinf.plant import GeneralisedPlant, Law
else:
    np = late_package("numpy")


@dataclass(frozen=True, eq=False)
class LawFactory:
    """Makes laws about the goal of a design, from its model."""

    synthesis: Synthesis  # of the design: problem, weights, γ and degree
    bandwidth: float  # where searches over bandwidths begin, rad/s

    @cached_property
    def gamma_ratio(self) -> float:
        """γ of the design over the smallest γ of the solved problem (with channels of the tolerances)."""
        from flexhinf.hinf import smallest_gamma

        solved = self.synthesis.design_problem
        return float(solved.gamma / smallest_gamma(solved.problem))

    def start(self, kind: LawKind) -> dict[str, float]:
        """Initial values of a law's parameters in a search: for H∞ those of the design."""
        from flexhinf.baselines.equilibrium_law import INTEGRAL_RATE

        limits, degree = PARAMETERS["gamma_ratio"], float(self.synthesis.chosen.degree)
        ratio = float(np.clip(self.gamma_ratio, limits.lower, limits.upper))
        own = {
            "bandwidth": self.bandwidth,
            "integral_rate": INTEGRAL_RATE,
            "gamma_ratio": ratio,
            DEGREE: degree,
        }
        fixed = {DEGREE: self.largest_degree <= 2, CHANNELS: self.synthesis.design_problem.robustness is None}
        free = (p for p in kind.parameters if not fixed.get(p.name, False))
        return {p.name: own[p.name] if p.start is None else p.start for p in free}

    def own(self, kind: LawKind) -> dict[str, float] | None:
        """Values of a law's parameters that reproduce the design's own law; None for a law that cannot."""
        at_goal = self.synthesis.law is self.synthesis.solution  # not a schedule of several poses
        same = kind.degree == 0 or (kind.degree == self.synthesis.chosen.degree and at_goal)
        return (
            {**self.start(kind), "velocity_weight": NO_VELOCITY}
            if same and "gamma_ratio" in kind.tuned
            else None
        )

    def bounds(self, kind: LawKind) -> dict[str, tuple[float, float]]:
        """Lower and upper bounds of a law's parameters."""
        start, largest = self.start(kind), {DEGREE: (2.0, float(self.largest_degree))}
        free = [(p, start[p.name] if p.relative else 1.0) for p in kind.parameters if p.name in start]
        return {p.name: largest.get(p.name, (p.lower * scale, p.upper * scale)) for p, scale in free}

    @property
    def states(self) -> int:
        """Number of states of the problem, with the integrals."""
        return len(self.synthesis.problem.state_names)

    @property
    def largest_degree(self) -> int:
        """Largest degree of V that the design tried."""
        return max(choice.degree for choice in self.synthesis.choices)

    def degree(self, kind: LawKind) -> int:
        """Degree of V of a law; 2 for laws that have none."""
        return self.synthesis.chosen.degree if kind.degree == 0 else kind.degree or 2

    def make(self, kind: LawKind, values: Mapping[str, float], degree: int | None = None) -> Law:
        """The law with these values of its parameters, see `start`, and V of another `degree` than its own.

        Values of R^v are ignored here, and a degree among the values is rounded. Raises `FlexhinfError` if the law does
        not exist, because a Riccati equation has no solution, or it cannot hold the goal.
        """
        own = self.own(kind) if degree in (None, self.synthesis.chosen.degree) else None
        if kind.name == DESIGN or (
            own is not None and all(values.get(n, x) == x for n, x in own.items() if n not in ESTIMATOR)
        ):
            return self.synthesis.law
        problem, fixed = self.synthesis.problem, (CHANNELS, *QUADRATIC)
        numbers = {name: values[name] for name in kind.tuned if name in values and name not in fixed}
        if kind.degree is not None:
            numbers[DEGREE] = degree or numbers.get(DEGREE) or self.degree(kind)
        if CHANNELS in kind.tuned:
            from flexhinf.design.problem.presets import sized_channels

            size = values.get(CHANNELS, 1.0)
            size = 0.0 if size <= NO_CHANNELS * (1.0 + ROUNDING) else size
            problem = sized_channels(self.synthesis.design_problem.problem, problem, size)
        if "effort" in kind.tuned:
            problem = weighted(
                problem, values["effort"], values["integral_weight"], values["velocity_weight"]
            )
        return kind.make(problem, **numbers)


def weighted(problem: GeneralisedPlant, effort: float, integral: float, velocity: float) -> GeneralisedPlant:
    """A problem with the weights that a linear-quadratic designer tunes. Its penalty is the matrix ∂h/∂x.

    `effort` and `integral` are factors of R2 and of the columns of h(x) that belong to integrals. `velocity`, s, adds a
    row for each joint, this times the weight of its link position times its link velocity; none up to `NO_VELOCITY`.
    """
    from flexhinf.plant import Penalty

    names = problem.state_names
    factors = [integral if name.endswith("_integral") else 1.0 for name in names]
    rows = np.array(problem.expand(1).h_parts[1], dtype=float) * factors
    pairs = [
        (k, names.index(name.replace("velocity", "position")))
        for k, name in enumerate(names)
        if name.startswith("link_velocity") and velocity > NO_VELOCITY * (1.0 + ROUNDING)
    ]
    extra = [velocity * float(np.linalg.norm(rows[:, at])) * np.eye(len(names))[k] for k, at in pairs]
    r2 = effort * np.asarray(problem.penalty.effort, dtype=float)
    return replace(problem, penalty=Penalty(np.vstack([rows, *extra]), effort=r2))
