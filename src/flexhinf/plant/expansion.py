"""Taylor expansion of model code about a point: the code is run once on truncated polynomials.

Nothing is differenced and nothing is differentiated: the coefficients are those of the code, to rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.plant.polynomial_plant import PolynomialPlant
from flexhinf.polynomial.basis import indices
from flexhinf.polynomial.truncated import degree_slice, size
from flexhinf.scalars.jet import coefficients, jets

if TYPE_CHECKING:
    from flexhinf.plant.generalised import GeneralisedPlant

__all__ = ["ControlAffineExpansion", "expand", "expand_control_affine", "expand_problem"]

#: A coefficient of order two in the inputs, relative to the largest one of its row, that is rounding.
AFFINE_TOLERANCE = 1e-12


@dataclass(frozen=True)
class ControlAffineExpansion:
    """ẋ = f(x) + g1(x) δd + g2(x) δu in the deviations x, δu, δd from the point, as monomial coefficients.

    The last axis runs over the monomials in the n states, degree after degree
    (`polynomial.truncated.degree_slice`).

    Attributes
    ----------
    f : ndarray, shape (n, C(n+D, D))
        Through degree D; the first column is the flow at the point itself.
    g1 : ndarray, shape (n, md, C(n+D−1, D−1))
        Columns of the disturbances, through degree D − 1.
    g2 : ndarray, shape (n, m, C(n+D−1, D−1))
        Columns of the inputs, through degree D − 1.
    degree : int
        D.
    """

    f: np.ndarray
    g1: np.ndarray
    g2: np.ndarray
    degree: int


@lru_cache(32)
def _rows(n: int, others: int, degree: int) -> tuple[np.ndarray, list[np.ndarray], np.ndarray]:
    """Sort the monomials in n states and some other variables, through `degree`.

    Returns
    -------
    states : ndarray of int
        Numbers of those in the states alone, in the order of the basis of n variables.
    linear : list of ndarray of int
        For each other variable, the numbers of it times a monomial in the states, in the order of that one.
    rest : ndarray of int
        Numbers of those of order two or more in the other variables.
    """
    states, linear, rest = [np.zeros(1, int)], [[] for _ in range(others)], [np.zeros(0, int)]
    for k in range(1, degree + 1):
        tuples, start = indices(n + others, k), size(n + others, k - 1)
        last = tuples[:, -1]
        once = tuples[:, -2] < n if k > 1 else np.ones(len(tuples), bool)
        states.append(start + np.flatnonzero(last < n))
        rest.append(start + np.flatnonzero(~once))
        for j in range(others):
            linear[j].append(start + np.flatnonzero((last == n + j) & once))
    return np.concatenate(states), [np.concatenate(part) for part in linear], np.concatenate(rest)


def _names(names: Sequence[str] | None, letter: str, count: int) -> list[str]:
    return list(names) if names is not None else [f"{letter}[{j}]" for j in range(count)]


def _polynomial(result: Any, n: int, degree: int, what: str) -> np.ndarray:
    """Coefficients of what the code returned, checked to be finite."""
    table = coefficients(result, n, degree)
    bad = np.argwhere(~np.isfinite(table).all(axis=-1))
    if len(bad):
        raise InvalidInput(
            f"The Taylor expansion of the {what} is not finite.",
            f"expected finite coefficients, got NaN or infinity in component {bad[0].tolist()}",
            "finite parameters, and a point where no term overflows",
        )
    return table


def expand(function: Callable[[np.ndarray, Any], Any], x0: Any, parameters: Any, degree: int) -> np.ndarray:
    """Taylor coefficients of `function(x, parameters)` about `x0`.

    Parameters
    ----------
    function : callable
        Ordinary NumPy code, for example a penalty or an output.
    x0 : array_like, shape (n,)
        Point of the expansion.
    parameters : object
        Handed to `function`.
    degree : int
        Highest degree, ≥ 0.

    Returns
    -------
    ndarray, shape (..., C(n+degree, degree))
        Monomial coefficients of each component of the result.

    Raises
    ------
    InvalidInput
        If the code is not analytic at the point, branches on an element, or gives no finite coefficients.
    """
    x = jets(x0, degree)
    with np.errstate(all="ignore"):
        result = function(x, parameters)
    return _polynomial(result, len(x), degree, "function")


def expand_control_affine(
    flow: Callable[[np.ndarray, np.ndarray, np.ndarray, Any], Any],
    x0: Any,
    u0: Any,
    d0: Any,
    parameters: Any,
    degree: int,
    *,
    input_names: Sequence[str] | None = None,
    disturbance_names: Sequence[str] | None = None,
) -> ControlAffineExpansion:
    """Taylor coefficients of a flow that is affine in its inputs, f(x) + g1(x) d + g2(x) u.

    The code runs once, on polynomials in (x, u, d) of total degree D: a term gᵢ(x) uᵢ of it has at most
    degree D − 1 in the states. Terms of order two in the inputs, of total degree ≤ max(D, 2), show a flow
    that is not affine.

    Parameters
    ----------
    flow : callable
        `flow(x, u, d, p)`, ordinary NumPy code; returns n derivatives.
    x0, u0, d0 : array_like, shapes (n,), (m,), (md,)
        Point of the expansion; the result is in the deviations from it.
    parameters : object
        Handed to `flow`.
    degree : int
        Highest degree D ≥ 1 of f; that of g1 and g2 is D − 1.
    input_names, disturbance_names : sequence of str, optional
        For the messages.

    Raises
    ------
    InvalidInput
        If the flow is not affine in its inputs (which, and by how much), does not return n components, is not
        analytic at the point, branches on an element, or gives no finite coefficients.
    """
    point = [np.atleast_1d(np.asarray(a, dtype=float)) for a in (x0, u0, d0)]
    n, m, md = map(len, point)
    if degree < 1:
        raise InvalidInput(
            "The degree of the expansion cannot be used.", f"expected >= 1, got {degree!r}", "for example 3"
        )
    inner = max(degree, 2)
    x, u, d = np.split(jets(np.concatenate(point), inner), [n, n + m])
    with np.errstate(all="ignore"):
        result = np.asarray(flow(x, u, d, parameters), dtype=object)
    if result.shape != (n,):
        raise InvalidInput(
            "The flow does not return one derivative per state.",
            f"expected shape ({n},), got {result.shape}",
            "np.array([...]) of the n derivatives, in the order of the states",
        )
    table = _polynomial(result, n + m + md, inner, "flow")
    states, linear, rest = _rows(n, m + md, inner)
    _check_affine(table, rest, n, inner, _names(input_names, "u", m) + _names(disturbance_names, "d", md))
    lower = size(n, degree - 1)
    columns = [table[:, numbers[:lower]] for numbers in linear]
    g = np.stack(columns, axis=1) if columns else np.zeros((n, 0, lower))
    f = table[:, states[: size(n, degree)]]
    return ControlAffineExpansion(f=f, g1=g[:, m:], g2=g[:, :m], degree=degree)


def expand_problem(problem: GeneralisedPlant, degree: int) -> PolynomialPlant:
    """Expansion of a generalised plant about its operating point, at its nominal parameters.

    Parameters
    ----------
    problem : GeneralisedPlant
    degree : int
        Highest degree ≥ 1 of f and h; that of g1 and g2 is one less.

    Raises
    ------
    InvalidInput
        As `expand_control_affine`.
    """
    n = len(problem.state_names)
    table = problem.plant.parameters
    parameters = table.named(table.vector())
    flow = expand_control_affine(
        problem.flow,
        problem.operating_point,
        problem.operating_input,
        np.zeros(len(problem.disturbance_names)),
        parameters,
        degree,
        input_names=problem.input_names,
        disturbance_names=problem.disturbance_names,
    )
    h = expand(problem.penalty_output, np.zeros(n), parameters, degree)

    def parts(coefficients: np.ndarray, highest: int) -> dict[int, np.ndarray]:
        return {k: coefficients[..., degree_slice(n, k)] for k in range(highest + 1)}

    return PolynomialPlant.from_parts(
        n,
        parts(flow.f, degree),
        parts(flow.g1, degree - 1),
        parts(flow.g2, degree - 1),
        parts(h, degree),
        problem.r2,
        state_names=problem.state_names,
        operating_point=problem.operating_point,
        input_names=problem.input_names,
        operating_input=problem.operating_input,
    )


def _check_affine(table: np.ndarray, rest: np.ndarray, n: int, degree: int, names: list[str]) -> None:
    excess = np.abs(table[:, rest])
    if not excess.any():
        return
    row, place = np.unravel_index(np.argmax(excess), excess.shape)
    scale = np.abs(table).max(axis=1)[row]
    if excess[row, place] <= AFFINE_TOLERANCE * scale:
        return
    variables = n + len(names)
    number = rest[place]
    k = next(k for k in range(degree + 1) if number < size(variables, k))
    monomial = indices(variables, k)[number - size(variables, k - 1)]
    term = " * ".join(names[i - n] if i >= n else f"x[{i}]" for i in monomial)
    raise InvalidInput(
        "The flow is not affine in its inputs, so it has no form f(x) + g1(x) d + g2(x) u.",
        f"expected no product of inputs, got {table[row, number]:.6g} * {term} in derivative {row}",
        "the nonlinear actuator as states of its own, with the new command as input",
    )
