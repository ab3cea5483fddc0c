"""Solve the Hamilton–Jacobi–Isaacs equation, Eq. (8), to any degree about an operating point.

    V_x f + ½ hᵀh + ½ V_x (g1 g1ᵀ/γ² − g2 R2⁻¹ g2ᵀ) V_xᵀ = 0,     u = −R2⁻¹ g2ᵀ V_xᵀ

Degree 2 is a Riccati equation (`riccati.py`), each higher degree one linear equation (`recursion.py`,
`polynomial/homological.py`); Al'brekht 1961, Lukes 1969, for the H∞ form Huang and Lin 1995.
"""

from __future__ import annotations

import math
from numbers import Integral, Real
from time import perf_counter

import numpy as np

from flexhinf.errors import InfeasibleGamma, InvalidInput, NumericalFailure
from flexhinf.hinf.game import ScaledGame
from flexhinf.hinf.gamma import linear_smallest_gamma
from flexhinf.hinf.linear_part import LinearPart
from flexhinf.hinf.memory import check_memory
from flexhinf.hinf.progress import degree_progress
from flexhinf.hinf.recursion import solve_degrees
from flexhinf.hinf.solution import HJISolution
from flexhinf.plant.polynomial_plant import PolynomialPlant
from flexhinf.plant.problem import Problem
from flexhinf.polynomial import basis
from flexhinf.polynomial.algebra import monomials

__all__ = ["linear_law", "solve_hji"]


def solve_hji(problem: Problem, gamma: float, degree: int) -> HJISolution:
    """Value function and law of the game to the given degree.

    Parameters
    ----------
    problem : Problem
        A generalised plant or a `PolynomialPlant`; g1, g2 and h may depend on the state.
    gamma : float
        Attenuation level, above γ*; `math.inf` gives the Hamilton–Jacobi–Bellman equation.
    degree : int
        Degree of V, at least 2. The law has degree − 1.

    Returns
    -------
    HJISolution

    Raises
    ------
    InvalidInput
        γ not positive, degree not an integer ≥ 2, a problem that is not one, or more memory than there is.
    NotStabilisable, NotDetectable
        The state and the mode are named.
    InfeasibleGamma
        γ ≤ γ*, which is in the message and in `.gamma_star`.
    NumericalFailure
        The coefficients left the finite numbers.
    """
    gamma, degree = _checked_gamma(gamma), _checked_degree(degree)
    plant = _expansion(problem, degree)
    memory = check_memory(plant.size, degree)
    begin = perf_counter()
    linear = LinearPart.of(plant)
    linear.check()
    scaling, balanced = linear.scaled(gamma)
    riccati = balanced.riccati(gamma)
    if riccati is None:
        raise _infeasible(linear, gamma)
    riccati_seconds = perf_counter() - begin
    game = ScaledGame.of(plant, gamma, degree, scaling)
    with degree_progress(len(plant.state_names), degree) as advance:
        scaled, records, condition = solve_degrees(game, riccati, riccati_seconds, advance)
    parts = _unscaled(scaled, scaling.state, scaling.value)
    if not all(np.isfinite(part).all() for part in parts.values()):
        raise NumericalFailure(
            "The solution left the finite numbers.",
            f"expected finite coefficients through degree {degree}, got infinite ones at gamma = {gamma:.6g}",
            "a gamma further above gamma*, or a lower degree",
        )
    p = scaling.unscale_hessian(riccati.p)
    return HJISolution(gamma, degree, p, plant, problem, parts, records, condition, memory)


def linear_law(problem: Problem, gamma: float) -> HJISolution:
    """The linear H∞ law: `solve_hji` at degree 2."""
    return solve_hji(problem, gamma, 2)


def _checked_gamma(gamma: float) -> float:
    if not isinstance(gamma, Real) or isinstance(gamma, bool) or not gamma > 0:
        raise InvalidInput(
            "The attenuation level gamma is not a positive number.",
            f"expected gamma > 0 (math.inf for no disturbance), got {gamma!r}",
            "a multiple of smallest_gamma(problem), for example 2",
        )
    return float(gamma)


def _checked_degree(degree: int) -> int:
    if not isinstance(degree, Integral) or isinstance(degree, bool) or degree < 2:
        raise InvalidInput(
            "The degree of V is not an integer of at least 2.",
            f"expected 2, 3, 4, …, got {degree!r}",
            "4 gives a cubic law; 2 gives the linear one",
        )
    return int(degree)


def _expansion(problem: Problem, degree: int) -> PolynomialPlant:
    if not isinstance(problem, Problem):
        raise InvalidInput(
            "This is not a problem that can be solved.",
            f"expected a generalised plant or a PolynomialPlant, got {type(problem).__name__}",
            "plant.with_objective(penalty) makes a problem of a plant",
        )
    n, m = len(problem.state_names), len(problem.r2)
    check_memory((n, 0, m, 0), degree)  # the expansion itself would already not fit
    return problem.expand(degree - 1)


def _infeasible(linear: LinearPart, gamma: float) -> Exception:
    gamma_star = linear_smallest_gamma(linear)
    if math.isfinite(gamma) and gamma <= gamma_star * (1 + 1e-8):
        return InfeasibleGamma(gamma, gamma_star)
    return NumericalFailure(
        "The Riccati equation was not solved.",
        f"gamma = {gamma:.10g} is above gamma* = {gamma_star:.10g}, but no stabilising solution was found",
        "a gamma further above gamma*, or better scaled weights",
    )


def _unscaled(parts: dict[int, np.ndarray], d: np.ndarray, s: float) -> dict[int, np.ndarray]:
    """Monomial coefficients in the plant's own units, from tensor entries in scaled ones."""
    powers = monomials(1.0 / d[None, :], parts)
    n = len(d)
    return {k: entries * basis.multiplicity(n, k) * powers[k][0] * s**2 for k, entries in parts.items()}
