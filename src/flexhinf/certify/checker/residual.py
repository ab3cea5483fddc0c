"""The residual r of a claim in exact rationals: equation (3) as it stands, then in z (x = T z) and sorted.

Claims in which r is a quadratic form for each value of the functions' quotients: definite matrices decide, in exact
rationals and without cells.

With V = zᵀWz and r(z, p) = −zᵀQ(S, p)z, S_j the quotients of the functions, r is affine in each S_j and convex in each
power of a parameter (affine, but for |V_x g1|²). So Q ≻ 0 at the corners of the box of S and p gives r ≤ −ε|z|²
wherever each S_j is in its range, and with W ≻ 0 the region is all of {V ≤ c}: docs/theorem.md, section 7.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from math import ceil, isfinite, log2, prod
from typing import NamedTuple

import numpy as np
from flint import Ordering, arb, arb_series, fmpq, fmpq_mat, fmpq_mpoly, fmpq_mpoly_ctx

from flexhinf.certify.claim import Claim, Function, PolynomialTerms, Terms

#: A product of powers of parameters: (name, exponent) pairs.
Exponents = tuple[tuple[str, int], ...]


class Refusal(Exception):
    """A claim is not proved: the reason and, if it concerns one point, z and V there."""

    def __init__(self, why: str, z: np.ndarray | None = None, value: float = float("nan")) -> None:
        super().__init__(why)
        self.z, self.value = z, value


def require(condition: bool, why: str) -> None:
    """Refuse a claim for which this does not hold."""
    if not condition:
        raise Refusal(why)


def as_rational(value: float) -> fmpq:
    """A double as the rational that it is."""
    return fmpq(*float(value).as_integer_ratio())


def rounded(value: fmpq) -> float:
    """The nearest double: Python's division of integers is correctly rounded."""
    return int(value.p) / int(value.q)


def series_of(name: str, argument: arb_series) -> arb_series:
    """φ of a power series; nan where the enclosure of the divisor contains 0."""
    if name == "tanh":
        below = (2 * argument).exp() + 1
        return 1 - 2 / below if below[0] > 0 else arb_series([arb("nan")] * argument.prec, prec=argument.prec)
    return getattr(argument, "atan" if name == "arctan" else name)()


def offset_of(function: Function) -> arb:
    """Enclosure of a function's offset o, in balls."""
    return arb(function.offset) + arb.pi() * function.pi_halves / 2


def polynomial_of(polynomial: PolynomialTerms, context: fmpq_mpoly_ctx) -> fmpq_mpoly:
    """A claim's polynomial as an exact one."""
    return context.from_dict({powers: as_rational(value) for powers, value in polynomial})


def matrix_of(rows: Iterable[Iterable[float]]) -> fmpq_mat:
    """Rows of doubles as an exact matrix."""
    return fmpq_mat([[as_rational(value) for value in row] for row in rows])


def form_of(polynomial: fmpq_mpoly) -> fmpq_mat:
    """The symmetric matrix of a quadratic form."""
    n = polynomial.context().nvars()
    form = fmpq_mat(n, n)
    for powers, value in polynomial.to_dict().items():
        i, j = (k for k, e in enumerate(powers) for _ in range(int(e)))
        form[i, j] = form[j, i] = value if i == j else value / 2
    return form


def row_of(linear: fmpq_mpoly) -> fmpq_mat:
    """The coefficients of a linear form."""
    n = linear.context().nvars()
    return fmpq_mat([[linear[tuple(int(j == i) for j in range(n))] for i in range(n)]])


def positive_definite(matrix: fmpq_mat) -> bool:
    """Whether a symmetric matrix is positive definite: all leading minors are positive."""
    return all(minor > 0 for minor in leading_minors(matrix))


def leading_minors(matrix: fmpq_mat) -> Iterator[fmpq]:
    """The determinants of the first k rows and columns, k = 1 and up."""
    for k in range(1, matrix.nrows() + 1):
        yield fmpq_mat([[matrix[i, j] for j in range(k)] for i in range(k)]).det()


class ExactResidual:
    """r = V_x (f + g2 k) + ½ hᵀh + ½ kᵀR2 k + |V_x g1|²/(2γ²) + αV, with x = T z:
    r(z, p) = Σ over products π of parameters: π(p) · (A_π(z) + Σ_j S_j(ℓ_jᵀTz) B_{π,j}(z)).

    S_j(s) = (φ_j(o + s) − φ_j(o))/s, and B_j has the factor s = ℓ_jᵀTz. `value` is V(Tz); `plain` are A_π by product
    (`products`), `factors` for each function j the B_{π,j} by product, and `arguments` the ℓ_jᵀTz. `gradient_law`: g2
    is certain and R2 k = −g2ᵀV_xᵀ up to rounding, for the budget of the theorem.
    """

    def __init__(self, claim: Claim) -> None:
        n, free = len(claim.states), [p.name for p in claim.parameters if p.low < p.high]
        fixed = {p.name: as_rational(p.low) for p in claim.parameters if p.low == p.high}
        after, end = n + len(free), n + len(free) + len(claim.functions)
        names = (
            [f"z{i + 1}" for i in range(n)]
            + [f"p{i}" for i in range(n, after)]
            + [f"S{i}" for i in range(after, end)]
        )
        ring = fmpq_mpoly_ctx.get(names, Ordering.degrevlex)
        gens = ring.gens()

        def total(parts: Iterable[fmpq_mpoly]) -> fmpq_mpoly:
            return sum(parts, ring.constant(0))

        def linear(row: Iterable[float]) -> fmpq_mpoly:
            return total(as_rational(a) * gen for a, gen in zip(row, gens[:n], strict=True))

        def polynomial(pairs: PolynomialTerms) -> fmpq_mpoly:
            return ring.from_dict({(*powers, *(0,) * (end - n)): as_rational(a) for powers, a in pairs})

        # Eq. (2). An uncertain p^e is one variable, since p stands with no other exponent.
        def field(terms: Terms) -> fmpq_mpoly:
            result = ring.constant(0)
            for term in terms:
                product = polynomial(((term.powers, term.coefficient),))
                for name, exponent in term.parameters:
                    if exponent:
                        product *= gens[n + free.index(name)] if name in free else fixed[name] ** exponent
                if term.function is not None:
                    product *= gens[after + term.function] * s[term.function]
                result += product
            return result

        s = [linear(function.slope) for function in claim.functions]
        v, k, h = polynomial(claim.value), [*map(polynomial, claim.law)], [*map(polynomial, claim.penalty)]
        v_x = [v.derivative(i) for i in range(n)]
        f = [*map(field, claim.drift)]
        g1, g2 = ([[*map(field, row)] for row in g] for g in (claim.g1, claim.g2))
        v_g1, v_g2 = ([total(v_x[i] * g[i][j] for i in range(n)) for j in range(len(g[0]))] for g in (g1, g2))
        priced = [total(a * u for a, u in zip(row, k, strict=True)) for row in matrix_of(claim.r2).tolist()]
        half, gamma = fmpq(1, 2), as_rational(claim.gamma)
        r = (
            total(a * b for a, b in zip(v_x, f, strict=True))
            + total(a * b for a, b in zip(v_g2, k, strict=True))
            + half * (total(a * a for a in h) + total(a * b for a, b in zip(k, priced, strict=True)))
            + half / gamma**2 * total(a * a for a in v_g1)
            + as_rational(claim.decay) * v
        )

        places = [*map(linear, claim.coordinates), *gens[n:]]
        r, v, *s = (q.compose(*places, ctx=ring) for q in (r, v, *s))
        parts: dict[tuple[int, ...], list[dict[tuple[int, ...], fmpq]]] = {
            (0,) * len(free): [{} for _ in range(1 + len(s))]
        }
        for powers, coefficient in r.to_dict().items():
            e = tuple(map(int, powers))
            part = parts.setdefault(e[n:after], [{} for _ in range(1 + len(s))])
            part[e[after:].index(1) + 1 if any(e[after:]) else 0][e[:n]] = coefficient
        in_z = fmpq_mpoly_ctx.get(names[:n], Ordering.degrevlex)
        self.plain, *self.factors = map(
            list, zip(*(map(in_z.from_dict, part) for part in parts.values()), strict=True)
        )
        self.value, *self.arguments = (
            in_z.from_dict({e[:n]: a for e, a in q.to_dict().items()}) for q in (v, *s)
        )
        self.gradient_law = not any(any(powers[n:]) for q in v_g2 for powers in q.to_dict()) and all(
            _opposite(a, b) for a, b in zip(priced, v_g2, strict=True)
        )
        plant = (t for row in (claim.drift, *claim.g1, *claim.g2) for terms in row for t in terms)
        exponent = {name: e for term in plant for name, e in term.parameters if e}
        self.products = [  # of the variables θ = p^e, as powers of the parameters
            tuple((p, e * exponent[p]) for p, e in zip(free, powers, strict=True) if e) for powers in parts
        ]


def _opposite(first: fmpq_mpoly, other: fmpq_mpoly) -> bool:
    """Whether the sum of two polynomials is rounding: below 1e-12 of the largest coefficient of their degree."""
    largest: dict[int, fmpq] = {}
    for powers, value in other.to_dict().items():
        degree = sum(map(int, powers))
        largest[degree] = max(largest.get(degree, fmpq(0)), abs(value))
    return all(
        abs(v) <= largest.get(sum(map(int, p)), fmpq(0)) * fmpq(1, 10**12)
        for p, v in (first + other).to_dict().items()
    )


def box_corners(claim: Claim, products: list[Exponents]) -> list[tuple[dict[str, fmpq], list[fmpq]]]:
    """The corners of the box of the parameters in these products, and each product there.

    Between them each product stays between its values there, because no parameter of another exponent than 1 vanishes;
    for the squares that |V_x g1|² brings, a parameter that may vanish has 0 as a third end.
    """
    used = {name for product in products for name, _ in product}
    box = {
        p.name: (p.low, p.high, *([0.0] if p.low < 0 < p.high else []))
        for p in claim.parameters
        if p.name in used
    }
    corners = (
        dict(zip(box, map(as_rational, corner), strict=True))
        for corner in itertools.product(*(sorted(set(ends)) for ends in box.values()))
    )
    return [
        (at, [prod((at[p] ** e for p, e in product), start=fmpq(1)) for product in products])
        for at in corners
    ]


_MOST_CORNERS, _MOST_FAILED = 2**15, 64  # that are looked at, and kept
_GRID = 512  # pieces of an interval of length one
_NEAR, _FARTHEST = 64, 10**6  # |ℓᵀx| of a function: in short pieces, and in ones that double


class Corner(NamedTuple):
    """Parameters and their products at which r is not negative definite, for some quotients: −r = zᵀ`form`z."""

    parameters: dict[str, fmpq]
    weights: list[fmpq]
    form: fmpq_mat


def look_at_corners(claim: Claim, exact: ExactResidual) -> tuple[int, list[Corner]]:
    """Number of corners (0 if r is no quadratic form, or the region leaves the reach), and the first few failing
    corners, the one with the smallest minor first."""
    # One part for each product of parameters.
    parts: list[tuple[fmpq_mpoly, ...]] = list(zip(exact.plain, *exact.factors, strict=True))
    if any(sum(map(int, e)) != 2 for form in (exact.value, *itertools.chain(*parts)) for e in form.to_dict()):
        return 0, []
    value = form_of(exact.value)
    if not positive_definite(value):
        return 0, []
    widest = value.inv() * as_rational(claim.level)  # wᵀ(widest)w is the largest |wᵀz|² where V ≤ c
    known = [
        quotient_range(function, (row * widest * row.transpose())[0, 0])
        for function, row in zip(claim.functions, map(row_of, exact.arguments), strict=True)
    ]
    ranges, corners = [ends for ends in known if ends], box_corners(claim, exact.products)
    if len(ranges) < len(known) or len(corners) * 2 ** len(ranges) > _MOST_CORNERS:
        return 0, []
    count, failed, forms = 0, list[tuple[fmpq, Corner]](), [list(map(form_of, row)) for row in parts]
    for (parameters, products), ends in itertools.product(corners, itertools.product(*ranges)):
        terms = (
            form * (weight * quotient)
            for weight, row in zip(products, forms, strict=True)
            for quotient, form in zip((fmpq(1), *ends), row, strict=True)
        )
        total = value * 0 - sum(terms, value * 0)
        count += 1
        smallest = min(leading_minors(total))
        if not smallest > 0:
            failed.append((smallest, Corner(parameters, products, total)))
            if len(failed) == _MOST_FAILED:
                break
    worst_first = [corner for _, corner in sorted(failed, key=lambda pair: pair[0])]
    return 0 if _farther(claim, widest) else count, worst_first


def _farther(claim: Claim, widest: fmpq_mat) -> list[int]:
    return [i for i in range(widest.nrows()) if widest[i, i] > as_rational(claim.reach) ** 2]


def check_reach(claim: Claim, exact: ExactResidual) -> None:
    """Raise a `Refusal` where V is a quadratic form and {V ≤ c} leaves the reach: no cell ends there."""
    if any(sum(map(int, e)) != 2 for e in exact.value.to_dict()):
        return
    value = form_of(exact.value)
    if positive_definite(value):
        widest = value.inv() * as_rational(claim.level)
        for i in _farther(claim, widest):
            row = np.array([rounded(widest[j, i]) for j in range(widest.nrows())])
            raise Refusal(  # where z_i is largest on {V = c}
                "the level set reaches beyond the stated reach", row / np.sqrt(row[i]), claim.level
            )


def corner_text(claim: Claim, corner: Corner) -> str:
    """The text "a corner fails" with the values of its parameters."""
    units = {p.name: p.unit for p in claim.parameters}
    values = (f"{n} = {rounded(v):.6g} {units[n]}".rstrip() for n, v in corner.parameters.items())
    return "a corner fails" + (f" ({', '.join(values)})" if corner.parameters else "")


def quotient_range(function: Function, square: fmpq) -> tuple[fmpq, fmpq] | None:
    """Rational bounds of S(s) = (φ(o + s) − φ(o))/s for s² ≤ `square`; None where φ is not analytic there.

    On a piece about m of half width w, |S(s) − S(m)| ≤ w max |S′| ≤ w max |φ″|/2 between o and o + s, as in (5). Beyond
    `_NEAR` the quotient itself is enclosed.
    """
    farthest = arb(square).sqrt().upper()
    if not farthest <= _FARTHEST:
        return None
    offset, ends = offset_of(function), list[fmpq]()
    start = series_of(function.name, arb_series([offset], prec=1))[0]
    for side in (1, -1):
        bend, pieces = arb(0), list[arb]()
        for i in range(ceil(min(float(farthest), _NEAR) * _GRID) + 1):
            middle, half = arb(side * (2 * i + 1)) / (2 * _GRID), arb(1) / (2 * _GRID)
            bend = bend.max(
                abs(series_of(function.name, arb_series([offset + middle + half * arb(0, 1), 1], prec=3))[2])
            )
            pieces.append(
                (series_of(function.name, arb_series([offset + middle], prec=1))[0] - start) / middle
                + bend * half * arb(0, 1)
            )
        for k in range(ceil(log2(max(float(farthest) / _NEAR, 1.0)))):
            piece = arb(side * _NEAR * 2**k).union(arb(side * _NEAR * 2 ** (k + 1)))
            pieces.append((series_of(function.name, arb_series([offset + piece], prec=1))[0] - start) / piece)
        for enclosed in pieces:
            if not isfinite(float(enclosed.rad())) or not enclosed.is_finite():
                return None
            ends += [enclosed.lower().fmpq(), enclosed.upper().fmpq()]
    return min(ends), max(ends)
