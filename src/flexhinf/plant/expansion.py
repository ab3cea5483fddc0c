"""Taylor expansion of model code about a point: the code is run once on truncated polynomials.

Nothing is differenced and nothing is differentiated: the coefficients are those of the code, to rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

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


class ControlAffineExpansion(NamedTuple):
    """ẋ = f(x) + g1(x) δd + g2(x) δu in the deviations x, δu, δd from the point, as monomial coefficients.

    The last axis runs over the monomials in the n states, degree after degree (`polynomial.truncated.degree_slice`):
    f (n, C(n+D, D)) through degree D, its first column the flow at the point; g1 (n, md, C(n+D−1, D−1)) and
    g2 (n, m, C(n+D−1, D−1)), the columns of the disturbances and of the inputs, through degree D − 1.
    """

    f: np.ndarray
    g1: np.ndarray
    g2: np.ndarray


@lru_cache(8)
def _sorted_out(n: int, others: int, degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Which field each monomial in n states and some other variables belongs to, through `degree`, and its place there.

    The owner is STATES for a monomial in the states alone, j for other variable j times one of those, else REST; the
    place is its number in the basis of the n states (0 for REST).
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
    x0, u0, d0 = problem.operating_point, problem.operating_input, np.zeros(len(problem.disturbance_names))
    names = {"input_names": problem.input_names, "disturbance_names": problem.disturbance_names}
    f, g1, g2 = expand_control_affine(problem.flow, x0, u0, d0, parameters, degree, **names)
    _check_everywhere(problem.plant)
    h = expand(problem.penalty_output, np.zeros(n), parameters, degree)
    fields = {
        name: {k: coefficients[..., degree_slice(n, k)] for k in range(highest + 1)}
        for name, coefficients, highest in (
            ("f", f, degree),
            ("g1", g1, degree - 1),
            ("g2", g2, degree - 1),
            ("h", h, degree),
        )
    }
    own = ("r2", "state_names", "operating_point", "input_names", "operating_input")
    return PolynomialPlant.from_parts(n, **fields, **{name: getattr(problem, name) for name in own})


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
    """Taylor coefficients (..., C(n+degree, degree)) of `function(x, parameters)`, NumPy code, about `x0` (n,).

    Code that is not analytic at the point, branches on an element, or gives no finite coefficients is refused.
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
    """Taylor coefficients of a flow that is affine in its inputs, f(x) + g1(x) d + g2(x) u, about x0, u0, d0.

    The code `flow(x, u, d, p)` runs once, on polynomials in (x, u, d) of total degree D ≥ 1: a term gᵢ(x) uᵢ of it has
    at most degree D − 1 in the states. Terms of order two in the inputs, of total degree ≤ max(D, 2), show a flow that
    is not affine; it is refused by their names. So is one that does not return n components, is not analytic at the
    point, branches on an element, or gives no finite coefficients.
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
    # Terms of order two or more in the inputs that are more than rounding.
    scale = np.zeros(n)
    np.maximum.at(scale, rows, np.abs(values))
    beyond = (owner == REST) & (np.abs(values) > AFFINE_TOLERANCE * scale[rows])
    if beyond.any():
        names = list(input_names or [f"u[{j}]" for j in range(m)])
        names += disturbance_names or [f"d[{j}]" for j in range(md)]
        worst = np.argmax(np.where(beyond, np.abs(values), 0.0))
        number, k = monomials[worst], 2
        while number >= size(n + m + md, k):
            k += 1
        monomial = indices(n + m + md, k)[number - size(n + m + md, k - 1)]
        term = " * ".join(names[i - n] if i >= n else f"x[{i}]" for i in monomial)
        raise InvalidInput(
            "The flow is not affine in its inputs, so it has no form f(x) + g1(x) d + g2(x) u.",
            f"expected no product of inputs, got {values[worst]:.6g} * {term} in derivative {rows[worst]}",
            "the nonlinear actuator as states of its own, with the new command as input",
        )
    f, g = np.zeros((n, size(n, degree))), np.zeros((n, m + md, size(n, degree - 1)))
    kept = (owner == STATES) & (place < f.shape[-1])
    f[rows[kept], place[kept]] = values[kept]
    kept = (owner >= 0) & (place < g.shape[-1])
    g[rows[kept], owner[kept], place[kept]] = values[kept]
    return ControlAffineExpansion(f, g[:, m:], g[:, :m])
