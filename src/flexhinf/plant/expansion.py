"""Taylor expansion of a problem about its operating point."""

# Not checked strictly: parts of SciPy, CasADi and NumPy have no types.
# pyright: reportUnknownArgumentType=false

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Protocol

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from flexhinf.arrays import Elements
from flexhinf.codegen.dependence import linear, nonzero, sizes_of_rows, switches
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.plant.model import Model
from flexhinf.plant.parameters import Parameters
from flexhinf.plant.polynomial_plant import OWN, PolynomialPlant
from flexhinf.polynomial import basis
from flexhinf.polynomial.truncated import degree_slice, size
from flexhinf.scalars.jet import coefficients, jets, terms
from flexhinf.validation import value_text

STATES, OTHER = -1, -2  # whose a monomial is; an input's or disturbance's number otherwise

#: A coefficient of order two in the inputs, relative to the largest one of its row, that is rounding.
AFFINE_TOLERANCE = 1e-12


@lru_cache(8)
def _sorted_out(n: int, others: int, degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Which field each monomial in n states and some other variables belongs to, through `degree`, and its place there.

    The owner is STATES for a monomial in the states alone, j for other variable j times one of those, else REST; the
    place is its number in the basis of the n states (0 for REST).
    """
    owner, place = [np.full(1, STATES)], [np.zeros(1, np.intp)]
    for k in range(1, degree + 1):
        tuples = basis.indices(n + others, k)
        last = tuples[:, -1].astype(np.intp)
        once = tuples[:, -2] < n if k > 1 else np.ones(len(tuples), bool)
        owner.append(np.where(last < n, STATES, np.where(once, last - n, OTHER)))
        place.append(np.zeros(len(tuples), np.intp))
        for field, lowest in [(STATES, size(n, k - 1)), *((j, size(n, k - 2)) for j in range(others))]:
            members = np.flatnonzero(owner[-1] == field)  # in the order of the basis, which is lexicographic
            place[-1][members] = lowest + np.arange(len(members))
    return np.concatenate(owner), np.concatenate(place)


def _check_finite(rows: np.ndarray, values: np.ndarray, shape: tuple[int, ...], what: str) -> None:
    bad = ~np.isfinite(values)
    if bad.any():
        component = [int(i) for i in np.unravel_index(int(rows[bad][0]), shape)]
        raise InvalidInput(
            f"The Taylor expansion of the {what} is not finite.",
            f"expected finite coefficients, got NaN or infinity in component {component}",
            "finite parameters, and a point where no term overflows",
        )


class NamedProblem(Protocol):
    """What the expansion needs of a `flexhinf.plant.GeneralisedPlant`."""

    @property
    def plant(self) -> Model:
        """The physics."""
        ...

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states, integrals last."""
        ...

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the inputs."""
        ...

    @property
    def disturbance_names(self) -> tuple[str, ...]:
        """Names of the disturbances."""
        ...

    @property
    def operating_point(self) -> np.ndarray:
        """x* (n,)."""
        ...

    @property
    def operating_input(self) -> np.ndarray:
        """u* (m,)."""
        ...

    def flow(self, x: Elements, u: Elements, d: Elements, p: Parameters) -> Elements:
        """ẋ (n,), of absolute x and u."""
        ...

    def penalty_output(self, x: Elements, p: Parameters) -> Elements:
        """h(x) of a deviation x (n,)."""
        ...


def expand_problem(problem: NamedProblem, degree: int) -> PolynomialPlant:
    """A `GeneralisedPlant` about its operating point, at the nominal parameters; see its `expand`."""
    n, table = len(problem.state_names), problem.plant.parameters
    parameters = table.named(table.vector())
    f, g1, g2 = expand_control_affine(
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
    fields = {
        name: {k: coefficients[..., degree_slice(n, k)] for k in range(highest + 1)}
        for name, coefficients, highest in (
            ("f", f, degree),
            ("g1", g1, degree - 1),
            ("g2", g2, degree - 1),
            ("h", h, degree),
        )
    }
    return PolynomialPlant.from_parts(n, **fields, **{name: getattr(problem, name) for name in OWN})


def _check_everywhere(plant: Model) -> None:
    """Refuse a flow that is affine in its inputs near a point only: its slope jumps, or bends beyond the expansion."""
    names, m = (*plant.inputs, *plant.disturbances), len(plant.inputs)
    x, inputs = ca.SX.sym("x", plant.n), ca.SX.sym("w", len(names))
    flow = plant.traced_flow(x, inputs[:m], inputs[m:], plant.parameters.vector())
    if linear(ca.Function("flow", [inputs, x], [flow])):
        return
    z, slope = ca.vertcat(inputs, x), ca.jacobian(flow, inputs)
    decides = switches(flow, z)
    terms_of = ca.vertcat(ca.vec(sizes_of_rows(slope)), ca.SX.ones(decides.numel(), 1))
    bent = ca.vertcat(ca.vec(ca.densify(slope)), decides)
    bad = [name for j, name in enumerate(names) if nonzero(ca.jacobian(bent, inputs[j]), z, terms_of).any()]
    if bad:
        raise InvalidInput(
            "The flow is not affine in its inputs, so it has no form f(x) + g1(x) d + g2(x) u.",
            f"expected slopes that no input changes anywhere, got a function of {', '.join(bad)} that bends or jumps "
            "away from the point",
            "the nonlinear actuator as states of its own, with the new command as input",
        )


def expand(
    function: Callable[[Elements, Parameters], Elements], x0: ArrayLike, parameters: Parameters, degree: int
) -> np.ndarray:
    """Taylor coefficients (..., C(n+degree, degree)) of `function(x, parameters)`, NumPy code, about `x0` (n,).

    Code that is not analytic at the point, branches on an element, or gives no finite coefficients is refused.
    """
    x = jets(x0, degree)
    with np.errstate(all="ignore"):
        table = coefficients(function(x, parameters), len(x), degree)
    *shape, count = table.shape
    _check_finite(np.arange(table.size) // count, table.ravel(), tuple(shape), "function")
    return table


def expand_control_affine(
    flow: Callable[[Elements, Elements, Elements, Parameters], Elements],
    x0: ArrayLike,
    u0: ArrayLike,
    d0: ArrayLike,
    parameters: Parameters,
    degree: int,
    *,
    input_names: Sequence[str] | None = None,
    disturbance_names: Sequence[str] | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Taylor coefficients f, g1, g2 of a flow that is affine in its inputs, ẋ = f(x) + g1(x) δd + g2(x) δu.

    The deviations x, δu, δd are those from x0, u0, d0. The last axes run over the monomials in the n states, degree
    after degree (`polynomial.truncated.degree_slice`): f (n, C(n+D, D)) through degree D, its first column the flow at
    the point; g1 (n, md, C(n+D−1, D−1)) and g2 (n, m, C(n+D−1, D−1)) through degree D − 1.

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
    refuse_if(
        result.shape != (n,),
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
    beyond = (owner == OTHER) & (np.abs(values) > AFFINE_TOLERANCE * scale[rows])
    if beyond.any():
        names = [
            *(input_names or [f"u[{j}]" for j in range(m)]),
            *(disturbance_names or [f"d[{j}]" for j in range(md)]),
        ]
        worst = np.argmax(np.where(beyond, np.abs(values), 0.0))
        number, k = monomials[worst], 2
        while number >= size(n + m + md, k):
            k += 1
        monomial = basis.indices(n + m + md, k)[number - size(n + m + md, k - 1)]
        term = " * ".join(names[i - n] if i >= n else f"x[{i}]" for i in monomial.tolist())
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
    return f, g[:, m:], g[:, :m]
