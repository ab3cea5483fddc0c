"""The smallest feasible attenuation level γ* of Eq. (5), for the linear part, by bisection."""

from __future__ import annotations

import numpy as np

from flexhinf.errors import NoFeasibleGamma
from flexhinf.hinf.linear_part import LinearPart, check_problem, disturbance_reaches_output
from flexhinf.plant.problem import Problem

__all__ = ["is_feasible", "linear_smallest_gamma", "smallest_gamma"]

_RELATIVE = 1e-10  # width of the last interval; the figure promised is 1e-8
_LARGE_P = 1e3  # eigenvalue of P at γ = ∞, balanced, from which other states are sought
_SMALLEST_P = 1e-20  # eigenvalue of P, relative to the largest, up to which a state is stretched
_PASSES = 3
_FACTOR = 4.0
_WIDEST = 60  # factors of four tried on either side of the first guess


def smallest_gamma(problem: Problem) -> float:
    """Smallest γ for which the Riccati equation of Eq. (8) has a stabilising solution P ≥ 0.

    Parameters
    ----------
    problem : Problem
        A generalised plant or a `PolynomialPlant`.

    Returns
    -------
    float
        γ*, 0.0 when the disturbance cannot reach z. To a relative 1e-8 where coefficients differ by up to eight orders
        of magnitude, as 40-digit arithmetic says; a mode that the input reaches only to ε relative to others, and
        that slow or unstable, costs about 1e-15/ε more: 1e-6 at ε = 1e-9.

    Raises
    ------
    InvalidInput
        Not a problem.
    NotStabilisable, NotDetectable
        The state and the mode are named.
    NoFeasibleGamma
        Not even γ = ∞ (no disturbance) has a stabilising solution.

    Notes
    -----
    At γ* either the Hamiltonian matrix has eigenvalues on the imaginary axis, or P has grown without bound
    while they stay off it. So existence itself is bisected, in coordinates balanced anew for every level.
    """
    check_problem(problem)
    return linear_smallest_gamma(LinearPart.of(problem.expand(1)))


def linear_smallest_gamma(linear: LinearPart, relative: float = _RELATIVE) -> float:
    """The same for a linear part at hand, to another relative width where many are tried."""
    linear.check()
    linear, given = _in_value_states(linear), linear
    if not is_feasible(linear, float("inf")):
        raise NoFeasibleGamma(
            "No attenuation level works for this problem.",
            "even without disturbance (gamma = inf) the Riccati equation has no stabilising solution",
            "weights and inputs of comparable size; check the units of the model",
        )
    _, balanced = given.scaled(float("inf"))
    if not disturbance_reaches_output(balanced.a, balanced.b1, balanced.c):
        return 0.0
    low, high = _bracket(linear)
    while high - low > relative * high:
        middle = (low + high) / 2
        if not low < middle < high:
            break
        low, high = (low, middle) if is_feasible(linear, middle) else (middle, high)
    return high


def is_feasible(linear: LinearPart, gamma: float) -> bool:
    """Whether the Riccati equation of this level has a stabilising solution P ≥ 0."""
    if not linear.bounds(gamma):
        return False
    _, balanced = linear.scaled(gamma)
    return balanced.riccati(gamma) is not None


def _in_value_states(linear: LinearPart) -> LinearPart:
    """The linear part in states in which P of γ = ∞ is about the identity, where it is far from that when balanced.

    A mode almost out of reach of the input has a P of one over the square of that reach: balancing, which looks at the
    sizes of numbers, cannot see it, and the Hamiltonian matrix loses as many digits. P is rough at first, so that its
    states are sought up to `_PASSES` times.
    """
    for _ in range(_PASSES):
        _, balanced = linear.scaled(float("inf"))
        riccati = balanced.riccati(float("inf"))
        if riccati is None:
            break
        eigenvalues, directions = np.linalg.eigh(riccati.p)
        largest = float(eigenvalues[-1])
        if largest <= _LARGE_P:
            break
        sizes = np.maximum(np.abs(eigenvalues), _SMALLEST_P * largest)
        scale = np.exp2(-np.round(np.log2(sizes) / 2))
        linear = balanced.in_states(directions * scale, directions.T / scale[:, None])
    return linear


def _bracket(linear: LinearPart) -> tuple[float, float]:
    """An infeasible and a feasible level, a factor of four apart."""
    high = 1.0
    if is_feasible(linear, high):
        for _ in range(_WIDEST):
            if not is_feasible(linear, high / _FACTOR):
                return high / _FACTOR, high
            high /= _FACTOR
        return 0.0, high
    for _ in range(_WIDEST):
        high *= _FACTOR
        if is_feasible(linear, high):
            return high / _FACTOR, high
    raise NoFeasibleGamma(
        "No attenuation level works for this problem.",
        f"no stabilising solution up to gamma = {high:.3g}, although there is one without disturbance",
        "d reaches z through a mode almost out of reach of the input: look at weights, units, inputs",
    )
