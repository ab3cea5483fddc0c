"""What a certificate may state besides its region: starts, the largest input of their runs, and output feedback.

Starts stand on paths, in ball arithmetic. A path x(a), 0 ≤ a ≤ amplitude, begins at 0. Where V(x(a)) ≤ c for all of its
a, it stays in the component of {V ≤ c} that contains 0, because it is continuous: no ray has to be followed. With
uncertain parameters there is a path for each of their values. A V of degree two is convex (positive definite, where a
region is proved), so where x(a) is affine in a power of each parameter, V is largest at a corner of their box.
Otherwise parameters are balls.

V does not grow along a run without disturbances: from a start with V ≤ c₀ it stays so, and with V = xᵀWx, u = Kx,

    |u_i|² = |K_i x|² ≤ (K_i W⁻¹ K_iᵀ) V(x) ≤ (K_i W⁻¹ K_iᵀ) c₀    for every value of the parameters in the box.

Output feedback: u = k̂(x̂) with an output-injection observer, in exact rationals; docs/theorem.md, section 10.

With e = x − x̂ in the states that are estimated, where all that is nonlinear in them is a function of what is measured
or known, ė = (A − L C) e + G d exactly. Then ½ eᵀXe pays for v = k̂(x̂) − k̂(x), and for what d does to e, if

    (A − L C)ᵀX + X (A − L C) + M + X G Gᵀ X/γ_e² ≺ 0,        JᵀR2 J ≺ M for J = ∂k̂/∂e on the hull of S and S − E.
"""

from __future__ import annotations

import functools
import itertools
import operator
from collections.abc import Callable
from math import prod, sqrt

from flint import Ordering, arb, arb_series, ctx, fmpq, fmpq_mat, fmpq_mpoly, fmpq_mpoly_ctx

from flexhinf.certify.checker.residual import (
    as_rational,
    form_of,
    matrix_of,
    offset_of,
    polynomial_of,
    positive_definite,
    require,
    rounded,
    row_of,
    series_of,
)
from flexhinf.certify.claim import Claim, Observer, Start, Term, Terms

BITS = 128
_FIRST, _HALVINGS = 16, 40  # pieces, and how often one is halved before it is refused


def check_start(claim: Claim, start: Start) -> int:
    """Number of intervals of a on which V ≤ c was proved; a `Refusal` where that fails."""
    number = claim.starts.index(start) + 1 if start in claim.starts else 1

    def inside(center: arb, whole: arb, middle: fmpq, depth: int) -> bool:
        require(
            bool(whole <= level) or not (center > level or depth >= _HALVINGS),
            f"the start of amplitude {float(middle.p) / float(middle.q):.6g} on path {number} is not inside",
        )
        return bool(whole <= level)

    with ctx.workprec(BITS):
        level = arb(claim.level) - (arb(claim.observer.energy) if claim.observer else 0)
        return _pieces_done(claim, start, inside)


def _pieces_done(claim: Claim, start: Start, done: Callable[[arb, arb, fmpq, int], bool]) -> int:
    """Number of intervals of a, each halved until `done(V in its middle, V on it, its middle, halvings)` is true, with
    all parameters in the box."""
    count = 0
    knots = [as_rational(a) for a in start.amplitudes] or [fmpq(0), as_rational(start.amplitude)]
    for values in parameter_values(claim, start):
        todo = [  # intervals that cover the path, the piece of the table that they lie in, and halvings
            (left + (right - left) * i / _FIRST, left + (right - left) * (i + 1) / _FIRST, piece, 0)
            for piece, (left, right) in enumerate(itertools.pairwise(knots))
            for i in range(_FIRST)
        ]
        while todo:
            left, right, piece, depth = todo.pop()
            middle = (left + right) / 2
            if done(*enclosed_value(claim, start, piece, left, right, values), middle, depth):
                count += 1
            else:
                todo += [(left, middle, piece, depth + 1), (middle, right, piece, depth + 1)]
    return count


def parameter_values(claim: Claim, start: Start) -> list[dict[str, arb]]:
    """Values of the parameters for which the path is looked at: corners of their box, or the box as balls."""
    pairs = {pair for row in start.path for term in row for pair in term.parameters if pair[1]}
    used = [p for p in claim.parameters if p.name in {name for name, _ in pairs}]
    if not (len(pairs) == len(used) and all(sum(powers) == 2 for powers, _ in claim.value)) or any(
        p.low <= 0 <= p.high for p in used
    ):
        return [{p.name: arb(p.low).union(arb(p.high)) for p in used}]
    return [
        {p.name: arb(v) for p, v in zip(used, corner, strict=True)}
        for corner in itertools.product(*(sorted({p.low, p.high}) for p in used))
    ]


def enclosed_value(
    claim: Claim, start: Start, piece: int, left: fmpq, right: fmpq, values: dict[str, arb]
) -> tuple[arb, arb]:
    """V in the middle of an interval of a between two knots of the table, and on all of it."""
    middle = (left + right) / 2
    center = _value(claim, _path(start, piece, arb(middle), values, 1))[0]
    slope = _value(claim, _path(start, piece, arb(left).union(arb(right)), values, 2))[1]
    return center, center + slope * arb(0, 1) * arb(right - middle)


def _path(start: Start, piece: int, about: arb, values: dict[str, arb], terms: int) -> list[arb_series]:
    """x(a + ε) as power series in ε, between two knots of the table."""
    a = arb_series([about, 1], prec=terms)
    states = list[arb_series]()
    for i, row in enumerate(start.path):
        x = arb_series([0], prec=terms)
        for term in row:
            factor = prod(
                (values[name] ** exponent for name, exponent in term.parameters),
                start=arb(term.coefficient) * a ** term.powers[0],
            )
            if term.function is not None:
                function = start.functions[term.function]
                offset = offset_of(function)
                factor *= (
                    series_of(function.name, arb_series([offset], prec=terms) + arb(function.slope[0]) * a)
                    - series_of(function.name, arb_series([offset], prec=1))[0]
                )
            x += factor
        table = start.table[i] if start.table else ()
        if table:
            (a0, a1), (y0, y1) = (
                [as_rational(v) for v in row[piece : piece + 2]] for row in (start.amplitudes, table)
            )
            x += arb(y0) + (a - arb(a0)) * arb((y1 - y0) / (a1 - a0))
        states.append(x)
    return states


def _value(claim: Claim, x: list[arb_series]) -> arb_series:
    tables = [
        list(itertools.accumulate([y] * most, operator.mul, initial=y * 0 + 1))
        for y, most in zip(
            x, [max(powers[i] for powers, _ in claim.value) for i in range(len(x))], strict=True
        )
    ]
    total = x[0] * 0
    for exponents, coefficient in claim.value:
        product = arb(coefficient)
        for table, exponent in zip(tables, exponents, strict=True):
            if exponent:
                product = table[exponent] * product
        total += product
    return total


_CLOSE, _PEAK_HALVINGS = 1.002, 30  # the bound of V over a value that V has on the path


def proved_peaks(claim: Claim) -> tuple[float, ...]:
    """Bounds of |u_i|, deviations from the input at the goal, along each run without disturbances from a stated start;
    empty where none is proved: without starts, for a law that is not linear and for a V of another degree than two."""
    n, quadratic = len(claim.states), all(sum(powers) == 2 for powers, _ in claim.value)
    if not (claim.starts and quadratic and all(sum(powers) == 1 for law in claim.law for powers, _ in law)):
        return ()
    ring = fmpq_mpoly_ctx.get([f"x{i}" for i in range(n)], Ordering.degrevlex)
    w = form_of(polynomial_of(claim.value, ring))
    if not positive_definite(w):
        return ()
    with ctx.workprec(BITS):
        level = functools.reduce(arb.max, (_largest_value(claim, start) for start in claim.starts), arb(0))
        gains = [row_of(polynomial_of(law, ring)) for law in claim.law]
        squares = (arb((k * w.inv() * k.transpose())[0, 0]) * level for k in gains)
        peaks = tuple(float(square.sqrt().upper()) * (1 + 1e-12) for square in squares)
    return peaks if all(bound < float("inf") for bound in peaks) else ()


def _largest_value(claim: Claim, start: Start) -> arb:
    seen, bound = arb(0), arb(0)

    def close(center: arb, whole: arb, middle: fmpq, depth: int) -> bool:
        nonlocal seen, bound
        seen = seen.max(center.lower())
        done = depth >= _PEAK_HALVINGS or bool(whole <= seen * _CLOSE)
        bound = bound.max(whole.upper()) if done else bound
        return done

    _pieces_done(claim, start, close)
    return bound


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
    # G (n_e, w), constant; disturbances of known states move no error, since those are computed
    noise = fmpq_mat([[_constant(claim, entry, "disturbance") for entry in claim.g1[i]] for i in estimated])
    gain, weight, storage = map(matrix_of, (observer.gain, observer.weight, observer.storage))
    require(
        weight == weight.transpose() and storage == storage.transpose(),
        "the observer's matrices M and X are not symmetric",
    )
    require(positive_definite(storage), "the observer's X is not positive definite")
    closed = drift - gain * fmpq_mat([[sensors[p, j] for j in estimated] for p in range(sensors.nrows())])
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
def _error_drift(claim: Claim, estimated: list[int], sensors: fmpq_mat) -> fmpq_mat:
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
def _check_slopes(
    claim: Claim, observer: Observer, estimated: list[int], weight: fmpq_mat, storage: fmpq_mat
) -> None:
    """JᵀR2 J ≺ M at every corner of a box that holds J at all points of the hull.

    eᵀJᵀR2Je is convex in J: corners suffice. The hull is max|z_i| ≤ reach plus the largest |z_i| of an error.
    """
    widest = _hull(claim, observer, estimated, storage)
    polynomials = [
        {tuple(map(int, e)): v for e, v in jac.to_dict().items()}
        for row in _law_slopes(claim, estimated)
        for jac in row
    ]
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


def _law_slopes(claim: Claim, estimated: list[int]) -> list[list[fmpq_mpoly]]:
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


def _hull(claim: Claim, observer: Observer, estimated: list[int], storage: fmpq_mat) -> list[fmpq]:
    """Bounds of |z_i| for x in S plus any error e with ½ eᵀXe ≤ ε: |aᵀe|² ≤ 2ε aᵀX⁻¹a."""
    backwards, within = matrix_of(claim.coordinates).inv(), storage.inv()
    result = list[fmpq]()
    for i in range(backwards.nrows()):
        a = fmpq_mat([[backwards[i, j] for j in estimated]])
        square = 2 * as_rational(observer.energy) * (a * within * a.transpose())[0, 0]
        size = as_rational(sqrt(rounded(square)) * (1 + 1e-9))
        require(not size * size < square, "the errors of the estimates have no bound in doubles")
        result.append(as_rational(claim.reach) + size)
    return result
