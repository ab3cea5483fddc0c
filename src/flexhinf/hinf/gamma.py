"""The smallest feasible attenuation level γ* of Eq. (5), for the linear part, by bisection."""

from __future__ import annotations

import numpy as np

from flexhinf.errors import NumericalFailure
from flexhinf.hinf.linear_part import LinearPart, check_problem, disturbance_reaches_output
from flexhinf.plant.problem import Problem

_RELATIVE = 1e-10  # width of the last interval; the figure promised is 1e-8
_LARGE_P = 1e3  # eigenvalue of P at γ = ∞, balanced, from which other states are sought
_SMALLEST_P = 1e-20  # eigenvalue of P, relative to the largest, up to which a state is stretched
_REACHED = 1e-13  # step of the staircase form, relative to the norm of A, below which a state is not reached
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
        that slow or unstable, costs about 1e-15/ε more: 1e-6 at ε = 1e-9. So do two such modes that are ε apart and
        share one input; below about ε = 1e-10 these count as not reached.

    Raises
    ------
    InvalidInput
        Not a problem.
    NotStabilisable, NotDetectable
        The state and the mode are named.
    NumericalFailure
        The problem is so ill-conditioned that rounding hides the solutions, which exist for every γ large enough.

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
        raise NumericalFailure(
            "The smallest attenuation level cannot be computed: the problem is too ill-conditioned.",
            "expected a stabilising solution of the Riccati equation without disturbance (gamma = inf), which exists: "
            "every lasting mode is reached and seen; rounding hides it",
            "an input that reaches each mode that does not decay more directly; weights and inputs of comparable size",
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
    if not is_feasible(linear, float("inf")):
        linear = _in_reached_states(linear)
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
        linear = _scaled_states(balanced, directions, 1.0 / np.sqrt(sizes))
    return linear


def _in_reached_states(linear: LinearPart) -> LinearPart:
    """The linear part in orthogonal states by how v reaches them (the staircase form of A and g2), each step as large.

    Two modes ε apart are reached by one input as their sum, and their difference through an entry of size ε. In the
    modes' own states P is about 1/ε², lost to rounding below ε = 1e-8; here ε is an entry by itself, which scaling
    takes away, known to 1e-16/ε.
    """
    _, balanced = linear.scaled(float("inf"))
    a, n = balanced.a, len(balanced.a)
    basis, scale = np.zeros((n, 0)), np.zeros(0)
    block, size, reach = balanced.b2, float(np.linalg.norm(balanced.b2)), np.ones(1)
    while basis.shape[1] < n:
        for _ in range(2):
            block = block - basis @ (basis.T @ block)
        left, sizes, _ = np.linalg.svd(block, full_matrices=False)
        fresh = sizes > _REACHED * size
        if not fresh.any():
            rest = np.linalg.svd(basis)[0][:, basis.shape[1] :]
            return _scaled_states(
                balanced, np.hstack([basis, rest]), np.append(scale, np.ones(rest.shape[1]))
            )
        reach = reach.min() * sizes[fresh] / size
        basis, scale = np.hstack([basis, left[:, fresh]]), np.append(scale, reach)
        block, size = a @ left[:, fresh], float(np.linalg.norm(a))
    return _scaled_states(balanced, basis, scale)


def _scaled_states(linear: LinearPart, directions: np.ndarray, sizes: np.ndarray) -> LinearPart:
    """In the states y of x = `directions` diag(`sizes`) y, sizes rounded to powers of two; directions orthogonal."""
    scale = np.exp2(np.round(np.log2(sizes)))
    return linear.in_states(directions * scale, directions.T / scale[:, None])


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
    raise NumericalFailure(
        "The smallest attenuation level cannot be computed: it is too large, or the problem too ill-conditioned.",
        f"found no stabilising solution up to gamma = {high:.3g}, although there is one without disturbance",
        "d reaches z through a mode almost out of reach of the input: look at weights, units, inputs",
    )
