"""Output feedback: u = k̂(x̂) with an output-injection observer, in exact rationals; docs/certificate.md, section 14.

With e = x − x̂ in the states that are estimated, where all that is nonlinear in them is a function of what is measured
or known, ė = (A − L C) e + G d exactly. Then ½ eᵀXe pays for v = k̂(x̂) − k̂(x), and for what d does to e, if

    (A − L C)ᵀX + X (A − L C) + M + X G Gᵀ X/γ_e² ≺ 0,        JᵀR2 J ≺ M for J = ∂k̂/∂e on the hull of S and S − E.
"""

from __future__ import annotations

import itertools
from math import prod, sqrt
from typing import Any

from flint import Ordering, fmpq, fmpq_mat, fmpq_mpoly_ctx

from flexhinf.certify.checker.residual import (
    as_rational,
    matrix_of,
    polynomial_of,
    positive_definite,
    require,
    rounded,
)
from flexhinf.certify.claim import Claim, Observer, Term, Terms

_MOST_CORNERS = 12  # binary logarithm of the corners of a box of slopes


def check_observer(claim: Claim, observer: Observer, gradient_law: bool) -> None:
    """Check the two matrix inequalities, and the form of the plant that they need; a `Refusal` where one fails."""
    require(gradient_law, "the budget for estimates needs the law -R2^-1 g2'V_x' and a known input matrix")
    used = {
        name for row in (claim.drift, *claim.g1) for terms in row for t in terms for name, _ in t.parameters
    }
    require(
        not any(p.low < p.high and p.name in used for p in claim.parameters),
        "an observer with exact error dynamics needs parameters that are known",
    )
    estimated = [i for i, name in enumerate([s.name for s in claim.states]) if name not in observer.known]
    sensors = matrix_of(observer.measured)
    drift = _error_drift(claim, estimated, sensors)
    noise = _disturbance(claim, estimated)
    measured = fmpq_mat([[sensors[p, j] for j in estimated] for p in range(sensors.nrows())])
    gain, weight, storage = map(matrix_of, (observer.gain, observer.weight, observer.storage))
    require(
        weight == weight.transpose() and storage == storage.transpose(),
        "the observer's matrices M and X are not symmetric",
    )
    require(positive_definite(storage), "the observer's X is not positive definite")
    closed = drift - gain * measured
    rate = closed.transpose() * storage + storage * closed + weight
    if any(entry != 0 for entry in noise.entries()):
        require(
            observer.gain_error != 0,
            "disturbances reach the estimates' errors, and the observer states no gain for them",
        )
        pushed = storage * noise
        rate += pushed * pushed.transpose() * (1 / as_rational(observer.gain_error) ** 2)
    require(
        positive_definite(rate * fmpq(-1)),
        "(A - LC)'X + X(A - LC) + M + XGG'X/gamma_e^2 is not negative definite",
    )
    _check_slopes(claim, observer, estimated, weight, storage)


# The form of the plant --------------------------------------------------------------------------------
def _error_drift(claim: Claim, estimated: list[int], sensors: Any) -> Any:
    """A of the estimated states. Refuses plants that are nonlinear in what is neither measured nor known."""
    n = len(claim.states)
    known = [i for i in range(n) if i not in estimated]
    seen = [[sensors[p, j] for j in range(n)] for p in range(sensors.nrows())] + [
        [fmpq(int(i == j)) for j in range(n)] for i in known
    ]
    rank = fmpq_mat(seen).rank()

    def spans(row: list[fmpq]) -> bool:
        return fmpq_mat([*seen, row]).rank() == rank

    linear = [[fmpq(0)] * n for _ in range(n)]
    for i, terms in enumerate(claim.drift):
        for term in terms:
            if term.function is None and sum(term.powers) == 1:
                linear[i][term.powers.index(1)] += _number(claim, term)
                continue
            inside = [[fmpq(int(j == k)) for j in range(n)] for k, power in enumerate(term.powers) if power]
            if term.function is not None:
                inside.append([as_rational(v) for v in claim.functions[term.function].slope])
            require(
                all(map(spans, inside)),
                f"the rate of {claim.states[i].name} is nonlinear in what is not measured",
            )
        require(
            i not in known or spans(linear[i]),
            f"{claim.states[i].name} is not computed from what is measured",
        )
    return fmpq_mat([[linear[i][j] for j in estimated] for i in estimated])


def _disturbance(claim: Claim, estimated: list[int]) -> Any:
    """G (n_e, w) of the errors, constant. Disturbances of known states move no error, since those are computed."""
    return fmpq_mat([[_constant(claim, entry, "disturbance") for entry in claim.g1[i]] for i in estimated])


def _constant(claim: Claim, terms: Terms, what: str) -> fmpq:
    require(
        not any(any(term.powers) for term in terms),
        f"the {what} matrix depends on the state, which an observer is not proved for",
    )
    return sum((_number(claim, term) for term in terms), fmpq(0))


def _number(claim: Claim, term: Term) -> fmpq:
    values = {p.name: as_rational(p.low) for p in claim.parameters}
    return prod(
        (values[name] ** exponent for name, exponent in term.parameters), start=as_rational(term.coefficient)
    )


# The slopes of the law --------------------------------------------------------------------------------
def _check_slopes(claim: Claim, observer: Observer, estimated: list[int], weight: Any, storage: Any) -> None:
    """JᵀR2 J ≺ M at every corner of a box that holds J at all points of the hull.

    eᵀJᵀR2Je is convex in J: corners suffice. The hull is max|z_i| ≤ reach plus the largest |z_i| of an error.
    """
    slopes = _law_slopes(claim, estimated)
    widest = _hull(claim, observer, estimated, storage)
    polynomials = [{tuple(map(int, e)): v for e, v in jac.to_dict().items()} for row in slopes for jac in row]
    middle = [jac.pop((0,) * len(widest), fmpq(0)) for jac in polynomials]
    radius = [
        sum((abs(v) * prod(map(pow, widest, e)) for e, v in jac.items()), fmpq(0)) for jac in polynomials
    ]
    uncertain = [i for i, r in enumerate(radius) if r != 0]
    require(len(uncertain) <= _MOST_CORNERS, "the law has too many slopes for an observer's proof")
    r2, count = matrix_of(claim.r2), len(estimated)
    for signs in itertools.product((-1, 1), repeat=len(uncertain)):
        at = list(middle)
        for i, sign in zip(uncertain, signs, strict=True):
            at[i] += sign * radius[i]
        j = fmpq_mat([at[k : k + count] for k in range(0, len(at), count)])
        require(
            positive_definite(weight - j.transpose() * r2 * j),
            "M does not bound the slopes of the law where the states and their estimates are",
        )


def _law_slopes(claim: Claim, estimated: list[int]) -> list[list[Any]]:
    """∂k̂/∂x_j by z, for each input and estimated state: k̂ = −R2⁻¹ g2ᵀ V_xᵀ, exactly."""
    n = len(claim.states)
    context = fmpq_mpoly_ctx.get([f"z{i + 1}" for i in range(n)], Ordering.degrevlex)
    value = polynomial_of(claim.value, context)
    onto = (
        matrix_of(claim.r2).inv()
        * fmpq_mat([[_constant(claim, entry, "input") for entry in row] for row in claim.g2]).transpose()
    )
    x = [
        sum((as_rational(a) * z for a, z in zip(row, context.gens(), strict=True)), context.constant(0))
        for row in claim.coordinates
    ]
    gradient = [value.derivative(i) for i in range(n)]
    laws = [
        sum((-onto[row, i] * gradient[i] for i in range(n)), context.constant(0))
        for row in range(onto.nrows())
    ]
    return [[law.derivative(j).compose(*x, ctx=context) for j in estimated] for law in laws]


def _hull(claim: Claim, observer: Observer, estimated: list[int], storage: Any) -> list[fmpq]:
    """Bounds of |z_i| for x in S plus any error e with ½ eᵀXe ≤ ε: |aᵀe|² ≤ 2ε aᵀX⁻¹a."""
    backwards, within = matrix_of(claim.coordinates).inv(), storage.inv()
    result = []
    for i in range(backwards.nrows()):
        a = fmpq_mat([[backwards[i, j] for j in estimated]])
        square = 2 * as_rational(observer.energy) * (a * within * a.transpose())[0, 0]
        size = as_rational(sqrt(rounded(square)) * (1 + 1e-9))
        require(not size * size < square, "the errors of the estimates have no bound in doubles")
        result.append(as_rational(claim.reach) + size)
    return result
