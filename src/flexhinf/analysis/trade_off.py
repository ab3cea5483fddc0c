"""What a law costs against what it holds: one point per law, one curve per parameter that is swept.

Two families of laws are compared at equal cost, never at equal weights: a smaller γ and a smaller R2 both buy a stiffer
loop with more input, so a single pair of laws says nothing about which family is better.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flexhinf.hinf import HJISolution, smallest_gamma, solve_hji
from flexhinf.plant import GeneralisedPlant, Law

#: Figures of one law by name, SI units; infinite where its run diverged.
Measure = Callable[[HJISolution], Mapping[str, float]]


@dataclass(frozen=True, eq=False)
class TradeOffPoint:
    """One law of a sweep.

    Attributes
    ----------
    value : float
        Of the parameter that is swept: R2 over the problem's own, or γ over γ*.
    figures : mapping of str to float
        What the caller measured, SI units.
    """

    value: float
    law: Law
    figures: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class TradeOffCurve:
    """The laws of one sweep, in its order.

    Attributes
    ----------
    parameter : str
        What is swept.
    """

    name: str
    parameter: str
    points: tuple[TradeOffPoint, ...]

    def at_cost(self, cost: str, benefit: str, value: float) -> float | None:
        """`benefit` where the curve has this `cost`, interpolated in logarithms; None outside the curve.

        Parameters
        ----------
        cost, benefit : str
            Names of two positive figures.
        value : float
            Of the cost.
        """
        pairs = sorted((p.figures[cost], p.figures[benefit]) for p in self.points)
        pairs = [(c, b) for c, b in pairs if math.isfinite(c) and math.isfinite(b) and c > 0.0 and b > 0.0]
        if not pairs or not pairs[0][0] <= value <= pairs[-1][0]:
            return None
        costs, benefits = np.log(np.array(pairs)).T
        return float(np.exp(np.interp(math.log(value), costs, benefits)))


def scaled_effort(problem: GeneralisedPlant, factor: float) -> GeneralisedPlant:
    """The problem with R2 times a factor."""
    effort = factor * np.asarray(problem.penalty.effort, dtype=float)
    return replace(problem, penalty=replace(problem.penalty, effort=effort))


def sweep_effort(
    problem: GeneralisedPlant,
    factors: Sequence[float],
    degree: int,
    measure: Measure,
    ratio: float = math.inf,
) -> TradeOffCurve:
    """Laws of one problem over R2: nonlinear LQR for γ = ∞, nonlinear H∞ for a finite γ/γ*.

    Parameters
    ----------
    factors : sequence of float
        R2 over the problem's own.
    degree : int
        Of V.
    measure : callable
        law → figures by name.
    ratio : float
        γ/γ*, of each problem's own γ*.

    Raises
    ------
    InfeasibleGamma, NotStabilisable, NotDetectable, NumericalFailure
        As `flexhinf.hinf.solve_hji`.
    """
    points = []
    for factor in factors:
        scaled = scaled_effort(problem, factor)
        gamma = math.inf if math.isinf(ratio) else ratio * smallest_gamma(scaled)
        law = solve_hji(scaled, gamma, degree)
        points.append(TradeOffPoint(float(factor), law, dict(measure(law))))
    name = "nonlinear LQR" if math.isinf(ratio) else f"nonlinear H∞, γ = {ratio:g} γ*"
    return TradeOffCurve(name, "R2 over the problem's own", tuple(points))


def sweep_gamma(
    problem: GeneralisedPlant, ratios: Sequence[float], degree: int, measure: Measure
) -> TradeOffCurve:
    """Nonlinear H∞ laws of one problem over γ/γ*; ∞ is the nonlinear LQR of the same weights.

    Raises
    ------
    InfeasibleGamma, NotStabilisable, NotDetectable, NumericalFailure
        As `flexhinf.hinf.solve_hji`.
    """
    star, points = smallest_gamma(problem), []
    for ratio in ratios:
        law = solve_hji(problem, math.inf if math.isinf(ratio) else ratio * star, degree)
        points.append(TradeOffPoint(float(ratio), law, dict(measure(law))))
    return TradeOffCurve("nonlinear H∞", "γ over γ*", tuple(points))
