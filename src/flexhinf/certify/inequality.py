"""The dissipation inequality of a certificate as exact polynomials in coordinates z, x = T z.

    r = V_x (f + g2 k) + ½ |h|² + ½ kᵀR2 k + ½ |g1ᵀ V_xᵀ|²/γ² + α V = A(z) + Σ_j Q_j(z) S_j(ℓ_j(z))

All numbers of the certificate are rational, and so are these polynomials. A function enters by its quotient
S_j = (φ(o + ℓ) − φ(o))/ℓ with Q_j = B_j ℓ_j where B_j is its factor in r: so r/|z|² needs nothing special at 0.

Elementary functions inside cells: polynomials with a proved bound of the remainder.

A function Φ of a linear form ℓ enters r through its quotient S(ℓ) = (Φ(ℓ) − Φ(0))/ℓ = ∫₀¹ Φ'(uℓ) du. Near a node a,

    S(ℓ) = Σ_{m ≤ M} s_m ℓᵐ + e,    |e| ≤ C |ℓ − a|^(M+1),    C = max |Φ^(M+2)|/(M+2)! between 0 and ℓ,

because S⁽ᵐ⁾/m! is the mean of uᵐ Φ⁽ᵐ⁺¹⁾(uℓ)/m! over 0 ≤ u ≤ 1, at most max |Φ⁽ᵐ⁺¹⁾|/(m+1)!. The s_m are the Taylor
polynomial about a in powers of ℓ, and C comes from power series over intervals (`arb`), which bound the derivatives of
any elementary function: sin, exp and tanh alike.

Many small polynomials are enclosed together on cells, divided by the radius (`MeanForms`).

On the face z_f = ±ρ of the cube max|z_i| ≤ ρ, with z_i = ρ t_i for the others, a polynomial q without a constant is
q/ρ = Q(w), a polynomial in w = (ρ, t). On the cell |w_i − m_i| ≤ h_i, by Taylor's formula,

    |Q(w) − Q(m)|  ≤  Σ_i |∂_i Q(m)| h_i + ½ Σ_ij H_ij h_i h_j,    H_ij = Σ |coefficients of ∂_ij Q| (|m| + h)^powers.

All values and derivatives of all polynomials at all centres are one product of matrices.

Over a box of parameters (`BoxExcess`) r is a sum of monomials of the parameters times functions of the state. In each
parameter by itself (or in its inverse, whichever occurs) it is convex: f and g2 are affine in it, |g1ᵀV_xᵀ|² is a
square. A function that is convex in each variable by itself is largest at a vertex of the box. So with p0 the middle,
over the whole box

    r(p) − r(p0)  ≤  max over vertices v of  Σ_q C_vq Q_q(x),

where the Q_q are products of two factors: an entry of V_x with a part of ẋ, or with another entry. On a cell every
factor is enclosed as its value in the middle, slopes, and a rest of second order; so is every product, and the sum at
every vertex by its own value and slopes: the middles are exact, so nothing is lost as cells shrink.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import accumulate, chain, combinations_with_replacement, product
from math import comb, prod

import numpy as np
from flint import arb, arb_series, ctx, fmpq, fmpq_mpoly, fmpq_mpoly_ctx

from flexhinf.arrays import Matrix
from flexhinf.certify.box import group_ends, parameter_groups, power_product
from flexhinf.certify.certificate import Certificate
from flexhinf.certify.claim import Function, PolynomialTerms, Term
from flexhinf.certify.problem_to_claim import nearest_double, rational, terms_of
from flexhinf.errors import InvalidInput

#: A polynomial: coefficients by exponents.
Rational = dict[tuple[int, ...], fmpq]


class ExactAlgebra:
    """Polynomials in x and in z for the parts of one certificate, every parameter in the middle of its range."""

    def __init__(self, certificate: Certificate) -> None:
        self.certificate = certificate
        self.n = n = len(certificate.states)
        self.x, self.z = (fmpq_mpoly_ctx.get([f"{letter}{i}" for i in range(n)]) for letter in "xz")
        self.zero, z = self.z.constant(0), self.z.gens()
        self._state = [
            sum((self.z.constant(rational(a)) * variable for a, variable in zip(row, z)), self.zero)
            for row in certificate.coordinates
        ]
        self._units = [tuple(int(j == i) for j in range(n)) for i in range(n)]
        self.parameters = {parameter.name: rational(parameter.middle) for parameter in certificate.parameters}

    def in_x(self, polynomial: PolynomialTerms) -> fmpq_mpoly:
        """A polynomial of the certificate in x, with exact coefficients."""
        return self.x.from_dict({powers: rational(value) for powers, value in polynomial})

    def moved(self, polynomial: fmpq_mpoly) -> fmpq_mpoly:
        """A polynomial in x, expressed in z with x = T z."""
        return polynomial.compose(*self._state, ctx=self.z)

    def line(self, slope: Sequence[float]) -> fmpq_mpoly:
        """The linear form ℓᵀx as a polynomial in x."""
        return self.x.from_dict({unit: rational(a) for unit, a in zip(self._units, slope) if a})

    def forms(self, functions: Iterable[Function]) -> np.ndarray:
        """The coefficients (functions, n) of each ℓᵀx as a linear form of z, rounded to doubles."""
        return np.array(
            [
                [nearest_double(row.get(unit, fmpq(0))) for unit in self._units]
                for row in [terms_of(self.moved(self.line(function.slope))) for function in functions]
            ]
        ).reshape(-1, self.n)


class Inequality(ExactAlgebra):
    """V(z), and r = A(z) + Σ_j Q_j(z) S_j(ℓ_j(z)): `value`, `polynomial`, and the `factors` of those `functions` that
    have one."""

    def __init__(self, certificate: Certificate) -> None:
        super().__init__(certificate)
        in_x = self.in_x(certificate.value)
        slope, value = [self.moved(in_x.derivative(i)) for i in range(self.n)], self.moved(in_x)
        law = [self.moved(self.in_x(row)) for row in certificate.law]
        g2, g1 = ([[*map(self._terms, row)] for row in rows] for rows in (certificate.g2, certificate.g1))

        def pushed(index: int | None) -> fmpq_mpoly:
            rows = zip(slope, certificate.drift)
            return sum((a * self._terms(t for t in row if t.function == index) for a, row in rows), self.zero)

        penalty = map(self.moved, map(self.in_x, certificate.penalty))
        prices = zip(product(law, law), chain(*certificate.r2))
        driven = (sum((a * b for a, b in zip(slope, column)), self.zero) for column in zip(*g1))
        total = (
            pushed(None)
            + sum((along * a * b for along, row in zip(slope, g2) for a, b in zip(row, law)), self.zero)
            + sum((h * h / 2 for h in penalty), self.zero)
            + sum((a * b * (rational(price) / 2) for (a, b), price in prices), self.zero)
            + sum((a * a for a in driven), self.zero) * (1 / (2 * rational(certificate.gamma) ** 2))
            + self.z.constant(rational(certificate.decay)) * value
        )
        self.value, self.polynomial = terms_of(value), terms_of(total)
        pairs = [(function, pushed(index)) for index, function in enumerate(certificate.functions)]
        self.functions = [function for function, factor in pairs if factor]
        self.factors = [terms_of(part * self.moved(self.line(f.slope))) for f, part in pairs if part]

    def _terms(self, row: Iterable[Term]) -> fmpq_mpoly:
        total: Rational = {}
        for term in row:
            total[term.powers] = total.get(term.powers, fmpq(0)) + prod(
                (self.parameters[name] ** power for name, power in term.parameters),
                start=rational(term.coefficient),
            )
        return self.moved(self.x.from_dict(total))


def parity(function: Function) -> int:
    """1 where φ(o + ℓ) − φ(o) is exactly even in ℓ, −1 where it is exactly odd, else 0."""
    if function.offset == 0.0 and function.name in ("sin", "cos"):
        return -1 if (function.pi_halves + (function.name == "cos")) % 2 == 0 else 1
    return -int(function.name in ("tanh", "arctan") and function.offset == function.pi_halves == 0)


def by_parity(terms: Rational, even: bool) -> tuple[Rational, Rational]:
    """The terms of even (or odd) degree, and all others."""
    kept = {key: value for key, value in terms.items() if (sum(key) % 2 == 0) == even}
    return kept, {key: value for key, value in terms.items() if key not in kept}


def _tanh(s: arb_series) -> arb_series:
    below = (2 * s).exp() + 1
    return 1 - 2 / below if below[0] > 0 else arb_series([arb("nan")] * s.prec, prec=s.prec)


QuotientSeries = Callable[[arb_series], arb_series]

#: The functions of certificates on power series over intervals, which bound their own derivatives.
SERIES: dict[str, QuotientSeries] = {
    "sin": arb_series.sin,
    "cos": arb_series.cos,
    "exp": arb_series.exp,
    "tanh": _tanh,
    "arctan": arb_series.atan,
    "log": arb_series.log,
}

#: Radius of a ball that counts as its middle: the allowance for rounding is larger, see `flexhinf.certify.cells`.
NARROW = 2.0**-160

_SPACING = 2.0**-6  # of the nodes
_FARTHEST = 100.0  # |ℓ| beyond which a function is not enclosed, so that nothing is proved there
_PIECE = 2.0**-3  # length of the intervals on which derivatives are bounded
_BITS = 320  # of the arithmetic on balls


class QuotientTable:
    """Nodes with the polynomials of S for Φ(ℓ) = φ(o + ℓ) and |ℓ| ≤ `reach`, with M = `order`, and bounds of the
    derivatives by distance from 0."""

    def __init__(self, function: Function, reach: float, order: int) -> None:
        elementary, offset, halves = SERIES[function.name], function.offset, function.pi_halves

        def series(s: arb_series) -> arb_series:
            return elementary(s + (arb(offset) + arb.pi() * halves / 2))

        farthest, cap, bits = min(reach, _FARTHEST), ctx.cap, ctx.prec
        count, pieces = int(np.ceil(farthest / _SPACING)) + 1, int(np.ceil(farthest / _PIECE)) + 2
        try:
            ctx.cap, ctx.prec = order + 3, _BITS
            # s_m (nodes, M + 1); nan where the function is not defined
            self.rows = np.array([_row(series, node, order) for node in range(-count, count + 1)])
            ctx.prec = 64
            self.above, self.below = (  # C on [0, (i + 1) pieces], and on [−(i + 1) pieces, 0]
                np.maximum.accumulate(
                    [_derivative(series, sign * (i + 0.5) * _PIECE, order + 2) for i in range(pieces)]
                )
                for sign in (1, -1)
            )
            #: A bound of |S| in the whole table.
            self.largest = max(_derivative(series, (i + 0.5) * _PIECE, 1) for i in range(-pieces, pieces))
        finally:
            ctx.cap, ctx.prec = cap, bits

    def enclose(self, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Polynomials (N, M + 1) for intervals of ℓ, and bounds (N,) of their remainders: inf beyond the table."""
        node = np.rint((low + high) / (2 * _SPACING))
        place = node.astype(np.int64) + len(self.rows) // 2  # the middle row is that of node 0
        known = (place >= 0) & (place < len(self.rows))
        rows = self.rows[np.where(known, place, 0)]
        distance = np.maximum(high - node * _SPACING, node * _SPACING - low)
        constant = np.maximum(_beyond(self.above, high), _beyond(self.below, -low))
        error = constant * distance ** self.rows.shape[1] * (1 + 1e-12)
        bad = ~known | ~np.isfinite(error) | ~np.isfinite(rows).all(axis=1)
        return np.where(bad[:, None], 0.0, rows), np.where(bad, np.inf, error)


def _beyond(table: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Bounds of the derivative out to `reach` on one side of 0; the first one where `reach` is on the other side."""
    place = np.maximum(np.ceil(reach / _PIECE).astype(np.int64) - 1, 0)
    return np.where(place < len(table), table[np.minimum(place, len(table) - 1)], np.inf)


def _row(function: QuotientSeries, node: int, order: int) -> list[float]:
    """The Taylor polynomial of the quotient about a node, in powers of ℓ, rounded to doubles."""
    a = arb(node) * _SPACING
    series = function(arb_series([a, 1], prec=order + 3))
    first, *taylor = (series[k] for k in range(order + 2))
    if node:  # S_0 = (Φ(a) − Φ(0))/a, S_m = (Φ_m − S_{m−1})/a
        start = (first - function(arb_series([0, 1], prec=1))[0]) / a
        taylor = list(accumulate(taylor[:-1], lambda before, part: (part - before) / a, initial=start))
    totals = [
        sum((taylor[k] * comb(k, m) * (-a) ** (k - m) for k in range(m, order + 1)), arb(0))
        for m in range(order + 1)
    ]
    return [
        float(total.mid())
        if total.is_finite() and total.rad() <= max(abs(float(total.mid())) * 2.0**-60, NARROW)
        else float("nan")
        for total in totals
    ]


def _derivative(function: QuotientSeries, centre: float, order: int) -> float:
    """An upper bound of |Φ^(order)|/order! on the piece about `centre`."""
    bound = function(arb_series([arb(centre, _PIECE * 0.5), 1], prec=order + 1))[order].abs_upper()
    return float(bound) * (1 + 1e-12) if bound.is_finite() else float("inf")


_SUM_ROUNDING = 1e-12  # relative to the sum of all terms' magnitudes: some hundred operations in doubles


class MeanForms:
    """Polynomials in z without constants, on the 2n faces: enclosed as value + Σ slope_i s_i ± rest, |s_i| ≤ 1."""

    def __init__(self, n: int, polynomials: Sequence[Rational]) -> None:
        self.n, self.count = n, len(polynomials)
        degree = max((sum(powers) for q in polynomials for powers in q), default=1)
        exponents = product(range(degree), *[range(degree + 1)] * (n - 1))
        rows = sorted((row for row in exponents if sum(row[1:]) <= min(degree, row[0] + 3)), key=sum)
        self._index = {row: i for i, row in enumerate(rows)}
        # Of each monomial but 1: one that is a degree less, and the variable between them.
        self._parents = list[tuple[int, int]]()
        self._derivatives = np.zeros((n, len(rows), len(rows)))
        for place, row in enumerate(rows):
            less = [(self._index.get(tuple(e - (i == j) for i, e in enumerate(row))), j) for j in range(n)]
            below = [(lower, j) for lower, j in less if lower is not None]
            self._parents += below[-1:]
            for parent, j in below:
                self._derivatives[j, place, parent] = row[j]
        self._pairs = [(i, j) for i in range(n) for j in range(i, n)]
        # Of each face: values and gradients, magnitudes of values and second derivatives.
        self._tables = list[tuple[Matrix, Matrix]]()
        for face, sign in product(range(n), (1, -1)):
            values, size = np.zeros((self.count, len(rows))), len(rows)
            for column, polynomial in zip(values, polynomials):
                for powers, value in polynomial.items():
                    place = self._index[(sum(powers) - 1, *powers[:face], *powers[face + 1 :])]
                    column[place] += nearest_double(value) * sign ** powers[face]
            slopes = np.stack([values @ derivative for derivative in self._derivatives], axis=1)
            seconds = [
                np.abs(slopes[:, i] @ self._derivatives[j]) * (0.5 if i == j else 1.0) for i, j in self._pairs
            ]
            self._tables.append(
                (
                    np.vstack([values, slopes.reshape(-1, size)]),
                    np.vstack([np.abs(values), np.stack(seconds, axis=1).reshape(-1, size)]),
                )
            )

    def _monomials(self, w: np.ndarray) -> np.ndarray:
        values = np.ones((len(self._index), w.shape[1]))
        for i, (parent, axis) in enumerate(self._parents, 1):
            np.multiply(values[parent], w[axis], out=values[i])
        return values

    def enclose(
        self, face: np.ndarray, middle: np.ndarray, half: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The value in the middle (polynomials, N), slopes h_i ∂_i Q (polynomials, n, N), and a bound of the remainder.

        `face` is 2 f for z_f = ρ and 2 f + 1 for z_f = −ρ, (N,); `middle` and `half` are of the cell in (ρ, t), (n, N).
        """
        at, beyond = self._monomials(middle), self._monomials(np.abs(middle) + half)
        k, pairs, size = self.count, len(self._pairs), len(face)
        spread = np.array([half[i] * half[j] for i, j in self._pairs])
        value_at, remainder, slopes = np.zeros((k, size)), np.zeros((k, size)), np.zeros((k, self.n, size))
        for number in map(int, np.unique(face)):
            cells = np.flatnonzero(face == number)
            table, magnitudes = self._tables[number]
            value, size_of = table @ at[:, cells], magnitudes @ beyond[:, cells]
            value_at[:, cells] = value[:k]
            slopes[:, :, cells] = value[k:].reshape(k, self.n, -1) * half[:, cells]
            remainder[:, cells] = (
                np.einsum("kic,ic->kc", size_of[k:].reshape(k, pairs, -1), spread[:, cells])
                + _SUM_ROUNDING * size_of[:k]
            )
        remainder += _SUM_ROUNDING * (np.abs(slopes).sum(axis=1) + remainder)
        return value_at, slopes, remainder


_BOX_ORDER = 3  # of the polynomials that stand for quotients of elementary functions
_MOST_VERTICES = 4096


class BoxExcess(ExactAlgebra):
    """An upper bound of [r(p) − r(p0)]/ρ² on cells in max|z_i| ≤ reach, over the box of parameters.

    The difference is a sum of (an entry of V_x) · (a form) · (a quotient S_j or 1), with weights at each vertex.

    Raises
    ------
    InvalidInput
        Too many parameters, or a parameter that enters otherwise than the search can take.
    """

    def __init__(self, certificate: Certificate, reach: float) -> None:
        super().__init__(certificate)
        self._enclosed, self._known = list[Rational](), dict[object, int]()
        self._value, self._laws = self.in_x(certificate.value), [*map(self.in_x, certificate.law)]
        groups = parameter_groups(certificate)
        if 2 ** len(groups) > _MOST_VERTICES:
            raise InvalidInput(
                "The box of parameters has too many vertices.",
                f"expected at most {_MOST_VERTICES}, got 2^{len(groups)} of {groups}",
                "fewer parameters with tolerances",
            )
        #: Of each parameter that varies: its product counts once, by the first.
        self._group = {
            name: number if name == next(iter(group)) else None
            for number, group in enumerate(groups)
            for name in group
        }
        self._ends = [  # and in the middle
            [power_product(group, at, fmpq(1)) for at in (*ends, self.parameters)]
            for group, ends in zip(groups, group_ends(certificate, rational))
        ]
        self._corners = list(product((0, 1), repeat=len(groups)))
        products = self._products()
        self._changes = (
            np.array(  # (vertices, products)
                [[nearest_double(c) for c in change] for change in products.values()]
            )
            .reshape(-1, len(self._corners))
            .T
        )
        self._largest = np.abs(self._changes).max(axis=0, initial=0.0)
        self._factors = np.array(list(products), dtype=int).reshape(-1, 3).T.copy()  # no function: −1
        self._mean = MeanForms(self.n, self._enclosed)
        self._lines = self.forms(certificate.functions)
        self._tables = [
            QuotientTable(f, reach * float(np.abs(line).sum()) * (1.0 + _SUM_ROUNDING) + 0.25, _BOX_ORDER)
            for f, line in zip(certificate.functions, self._lines)
        ]

    def __call__(
        self, face: np.ndarray, t: np.ndarray, half: np.ndarray, low: np.ndarray, high: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The bound, (N,), and the contributions of the radius and of each t_j to it, (n, N).

        `face` is 2 f for the face z_f = ρ of the cube and 2 f + 1 for z_f = −ρ, (N,); `t` and `half` are centre and
        half width in the other z_i/ρ, (n − 1, N); `low` and `high` the interval of ρ, (N,).
        """
        middle = np.vstack([0.5 * (low + high), t])
        halves = np.vstack([0.5 * (high - low), half])
        value, slopes, remainder = self._mean.enclose(face, middle, halves)
        quotient, spread = self._quotients(face, middle, halves)
        first, second, function = self._factors
        a, a_slope, a_remainder = value[first], slopes[first], remainder[first]
        c, c_spread = quotient[function], spread[function]
        b, b_slope, b_remainder = (
            c * value[second],
            c[:, None] * slopes[second],
            np.abs(c) * remainder[second],
        )
        b_remainder += c_spread * (
            np.abs(value[second]) + np.abs(slopes[second]).sum(axis=1) + remainder[second]
        )
        a_size, b_size = (np.abs(each).sum(axis=1) for each in (a_slope, b_slope))
        centre, linear = a * b, a[:, None] * b_slope + b[:, None] * a_slope
        left = (
            np.abs(a) * b_remainder
            + np.abs(b) * a_remainder
            + (a_size + a_remainder) * (b_size + b_remainder)
        )
        left += _SUM_ROUNDING * (np.abs(centre) + np.abs(linear).sum(axis=1) + left)
        at_vertices = np.abs(np.tensordot(self._changes, linear, axes=1)).sum(axis=1)
        bound = self._changes @ centre + at_vertices * (1.0 + _SUM_ROUNDING) + np.abs(self._changes) @ left
        return bound.max(axis=0), np.tensordot(self._largest, np.abs(linear), axes=1)

    def _quotients(
        self, face: np.ndarray, middle: np.ndarray, halves: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Middles and radii of the quotients S_j, and of 1 in the last row, (functions + 1, N)."""
        values, radii = (make((len(self._tables) + 1, len(face))) for make in (np.ones, np.zeros))
        others = np.array([[*range(f), *range(f + 1, self.n)] for f in range(self.n)], dtype=int)[face // 2].T
        z, columns = np.empty((self.n, len(face))), np.arange(len(face))
        z[face // 2, columns], z[others, columns] = 1.0 - 2.0 * (face % 2), middle[1:]
        for j, (line, table) in enumerate(zip(self._lines, self._tables)):
            along, width = line @ z, (np.abs(line)[others] * halves[1:]).sum(axis=0)
            centre = along * middle[0]
            wide = (np.abs(along) * halves[0] + width * (middle[0] + halves[0])) * (
                1.0 + _SUM_ROUNDING
            ) + 1e-13
            rows, error = table.enclose(centre - wide, centre + wide)
            values[j], *parts = (  # the polynomial about the cell's centre
                sum(comb(i, k) * rows[:, i] * centre ** (i - k) for i in range(k, _BOX_ORDER + 1))
                for k in range(_BOX_ORDER + 1)
            )
            spread = sum(np.abs(part) * wide**k for k, part in enumerate(parts, 1))
            radii[j] = (spread + error) * (1.0 + _SUM_ROUNDING) + 1e-13 * (1.0 + np.abs(values[j]))
        return values, radii

    def _at_ends(self, term: Term) -> list[fmpq]:
        """Values of coefficient · Π p^e of a term at all vertices, and at last in the middle."""
        known = {name: power for name, power in term.parameters if name not in self._group}
        constant = power_product(known, self.parameters, rational(term.coefficient))
        used = [k for name, _ in term.parameters if (k := self._group.get(name)) is not None]
        return [
            constant * prod((self._ends[k][at[k]] for k in used), start=fmpq(1))
            for at in [*self._corners, (2,) * len(self._ends)]
        ]

    def _number(self, key: object, polynomial: fmpq_mpoly) -> int:
        if key not in self._known:
            self._known[key] = len(self._enclosed)
            self._enclosed.append(terms_of(self.moved(polynomial)))
        return self._known[key]

    def _slope(self, i: int) -> int:
        return self._number(("slope", i), self._value.derivative(i))

    def _products(self) -> dict[tuple[int, int, int], list[fmpq]]:
        """Changes of V_x (f + g2 k) and of ½ |g1ᵀV_xᵀ|²/γ² at all vertices, by two forms and a function or −1."""
        products, claim = dict[tuple[int, int, int], list[fmpq]](), self.certificate

        def add(key: tuple[int, int, int], changes: list[fmpq]) -> None:
            products[key] = [a + b for a, b in zip(products[key], changes)] if key in products else changes

        rows = [
            *((i, term, None) for i, row in enumerate(claim.drift) for term in row),
            *((i, t, j) for i, row in enumerate(claim.g2) for j, entry in enumerate(row) for t in entry),
        ]
        for i, term, driven in rows:
            *ends, middle = self._at_ends(term)
            if all(end == middle for end in ends):
                continue
            slope, number = self._slope(i), -1 if term.function is None else term.function
            if driven is not None:
                _refuse_powers(term)
                form = self._number(("law", driven), self._laws[driven])
            else:
                part = self.x.from_dict({term.powers: fmpq(1)})
                if term.function is not None:  # x^a ℓ, which S(ℓ) multiplies
                    part *= self.line(claim.functions[term.function].slope)
                form = self._number((term.powers, term.function), part)
            add((slope, form, number), [end - middle for end in ends])
        for column in zip(*claim.g1):
            entries = [[self._at_ends(term) for term in entry] for entry in column]
            if all(end == ends[-1] for entry in entries for ends in entry for end in ends):
                continue
            _refuse_powers(*chain(*column))
            sums = [
                [sum((ends[v] for ends in entry), fmpq(0)) for v in range(len(self._corners) + 1)]
                for entry in entries
            ]
            for i, j in combinations_with_replacement(range(len(column)), 2):
                *squares, middle = (a * b for a, b in zip(sums[i], sums[j]))
                weight = (1 if i == j else 2) / (2 * rational(claim.gamma) ** 2)
                changes = [weight * (square - middle) for square in squares]
                if any(changes):
                    add((self._slope(i), self._slope(j), -1), changes)
        return products


def _refuse_powers(*terms: Term) -> None:
    for term in terms:
        if any(term.powers):
            raise InvalidInput(
                "The box of parameters cannot be searched for this plant.",
                f"expected channels that do not depend on the state, got the term {term}",
                "nominal parameters, or sampled_region",
            )
