"""Taylor expansion of model code about a point: the code is run once on truncated polynomials.

Nothing is differenced and nothing is differentiated: the coefficients are those of the code, to rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.plant.polynomial_plant import PolynomialPlant
from flexhinf.polynomial.basis import indices
from flexhinf.polynomial.truncated import degree_slice, size
from flexhinf.scalars.jet import jets, terms
from flexhinf.scalars.trace import linear, nonzero, sizes_of_rows, switches
from flexhinf.validation import value_text

STATES, REST = -1, -2  # whose a monomial is; an input's or disturbance's number otherwise

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


@lru_cache(8)
def _sorted_out(n: int, others: int, degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Which field each monomial in n states and some other variables belongs to, through `degree`.

    Returns
    -------
    owner : ndarray of int
        STATES for a monomial in the states alone, j for other variable j times one of those, else REST.
    place : ndarray of int
        Number of the monomial in the states, in the basis of n variables (0 for REST).
    """
    owner, place = [np.full(1, STATES)], [np.zeros(1, np.intp)]
    for k in range(1, degree + 1):
        tuples = indices(n + others, k)
        last = tuples[:, -1].astype(np.intp)
        once = tuples[:, -2] < n if k > 1 else np.ones(len(tuples), bool)
        owner.append(np.where(last < n, STATES, np.where(once, last - n, REST)))
        place.append(np.zeros(len(tuples), np.intp))
        for field, lowest in [(STATES, size(n, k - 1)), *((j, size(n, k - 2)) for j in range(others))]:
            found = np.flatnonzero(owner[-1] == field)  # in the order of the basis, which is lexicographic
            place[-1][found] = lowest + np.arange(len(found))
    return np.concatenate(owner), np.concatenate(place)


def _names(names: Sequence[str] | None, letter: str, count: int) -> list[str]:
    return list(names) if names is not None else [f"{letter}[{j}]" for j in range(count)]


def _check_finite(rows: np.ndarray, values: np.ndarray, shape: tuple[int, ...], what: str) -> None:
    bad = ~np.isfinite(values)
    if bad.any():
        component = [int(i) for i in np.unravel_index(rows[bad][0], shape)]
        raise InvalidInput(
            f"The Taylor expansion of the {what} is not finite.",
            f"expected finite coefficients, got NaN or infinity in component {component}",
            "finite parameters, and a point where no term overflows",
        )


def expand_problem(problem: Any, degree: int) -> PolynomialPlant:
    """A `GeneralisedPlant` about its operating point, at the nominal parameters; see its `expand`."""
    n, table = len(problem.state_names), problem.plant.parameters
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
    _check_everywhere(problem.plant)
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


def _check_everywhere(plant: Any) -> None:
    """Refuse a flow that is affine in its inputs near a point only: its slope jumps, or bends beyond the expansion."""
    import casadi as ca

    x, names = ca.SX.sym("x", plant.n), (*plant.inputs, *plant.disturbances)
    inputs = ca.SX.sym("w", len(names))
    u, d = inputs[: len(plant.inputs)], inputs[len(plant.inputs) :]
    flow = plant.traced_flow(x, u, d, plant.parameters.vector())
    if linear(ca.Function("flow", [inputs, x], [flow])):
        return
    z, slope = ca.vertcat(inputs, x), ca.jacobian(flow, inputs)
    decides = switches(flow, z)
    terms_of = ca.vertcat(ca.vec(sizes_of_rows(slope)), ca.SX.ones(decides.numel(), 1))
    bad = []
    for j in range(len(names)):
        change = ca.jacobian(ca.vertcat(ca.vec(ca.densify(slope)), decides), inputs[j])
        bad.append(bool(nonzero(change, z, terms_of).any()))
    if any(bad):
        raise InvalidInput(
            "The flow is not affine in its inputs, so it has no form f(x) + g1(x) d + g2(x) u.",
            f"expected slopes that no input changes anywhere, got a function of "
            f"{', '.join(name for name, wrong in zip(names, bad) if wrong)} that bends or jumps away from the point",
            "the nonlinear actuator as states of its own, with the new command as input",
        )


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
        result = np.asarray(function(x, parameters), dtype=object)
    rows, monomials, values = terms(result, len(x), degree)
    _check_finite(rows, values, result.shape, "function")
    table = np.zeros((result.size, size(len(x), degree)))
    table[rows, monomials] = values
    return table.reshape(*result.shape, table.shape[1])


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
            "The degree of the expansion cannot be used.",
            f"expected >= 1, got {value_text(degree)}",
            "for example 3",
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
    rows, monomials, values = terms(result, n + m + md, inner)
    _check_finite(rows, values, result.shape, "flow")
    owner, place = (part[monomials] for part in _sorted_out(n, m + md, inner))
    names = _names(input_names, "u", m) + _names(disturbance_names, "d", md)
    if REST in owner:
        _check_affine(rows, monomials, values, owner == REST, n, names)
    f, g = np.zeros((n, size(n, degree))), np.zeros((n, m + md, size(n, degree - 1)))
    kept = (owner == STATES) & (place < f.shape[-1])
    f[rows[kept], place[kept]] = values[kept]
    kept = (owner >= 0) & (place < g.shape[-1])
    g[rows[kept], owner[kept], place[kept]] = values[kept]
    return ControlAffineExpansion(f=f, g1=g[:, m:], g2=g[:, :m], degree=degree)


def _check_affine(
    rows: np.ndarray, monomials: np.ndarray, values: np.ndarray, excess: np.ndarray, n: int, names: list[str]
) -> None:
    """Refuse terms of order two or more in the inputs (the marked ones) that are more than rounding."""
    scale = np.zeros(rows[-1] + 1)
    np.maximum.at(scale, rows, np.abs(values))
    beyond = excess & (np.abs(values) > AFFINE_TOLERANCE * scale[rows])
    if not beyond.any():
        return
    worst = np.argmax(np.where(beyond, np.abs(values), 0.0))
    variables, number, k = n + len(names), monomials[worst], 2
    while number >= size(variables, k):
        k += 1
    monomial = indices(variables, k)[number - size(variables, k - 1)]
    term = " * ".join(names[i - n] if i >= n else f"x[{i}]" for i in monomial)
    raise InvalidInput(
        "The flow is not affine in its inputs, so it has no form f(x) + g1(x) d + g2(x) u.",
        f"expected no product of inputs, got {values[worst]:.6g} * {term} in derivative {rows[worst]}",
        "the nonlinear actuator as states of its own, with the new command as input",
    )
