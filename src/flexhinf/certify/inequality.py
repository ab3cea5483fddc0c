"""The dissipation inequality of a certificate as exact polynomials in coordinates z, x = T z.

    r = V_x (f + g2 k) + ½ |h|² + ½ kᵀR2 k + ½ |g1ᵀ V_xᵀ|²/γ² + α V = A(z) + Σ_j Q_j(z) S_j(ℓ_j(z))

All numbers of the certificate are rational, and so are these polynomials. A function enters by its quotient
S_j = (φ(o + ℓ) − φ(o))/ℓ with Q_j = B_j ℓ_j where B_j is its factor in r: so r/|z|² needs nothing special at 0.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import prod

from flint import fmpq, fmpq_mpoly, fmpq_mpoly_ctx

from flexhinf.certify.certificate import Certificate
from flexhinf.certify.reading import nearest_double, rational, terms_of
from flexhinf.certify.terms import Function, Polynomial, Term

#: Largest share of the terms of the wrong parity for opposite faces to be treated together.
_ASYMMETRY = 1e-9

#: A polynomial: coefficients by exponents.
Rational = dict[tuple[int, ...], fmpq]


@dataclass(frozen=True, eq=False)
class Quotient:
    """One term Q S(ℓ) of r.

    Attributes
    ----------
    factor : dict of exponents to fmpq
        Q(z).
    form : tuple of fmpq
        ℓ as a linear form of z.
    """

    factor: Rational
    form: tuple[fmpq, ...]
    function: Function


@dataclass(frozen=True, eq=False)
class Inequality:
    """V and r in coordinates z.

    Attributes
    ----------
    value, polynomial : dict of exponents to fmpq
        V(z) and A(z).
    """

    states: int
    value: Rational
    polynomial: Rational
    quotients: tuple[Quotient, ...]


def inequality_of(certificate: Certificate) -> Inequality:
    """V and r of a certificate, every parameter in the middle of its range."""
    return _Algebra(certificate).inequality()


def law_slopes(certificate: Certificate) -> list[list[Rational]]:
    """∂k_i/∂x_j as polynomials in z, a row for each input and a column for each state."""
    algebra = _Algebra(certificate)
    laws = [
        algebra.x.from_dict({powers: rational(value) for powers, value in law}) for law in certificate.law
    ]
    return [[terms_of(algebra._moved(terms_of(law.derivative(j)))) for j in range(algebra.n)] for law in laws]


class _Algebra:
    """Polynomials in z for the parts of one certificate."""

    def __init__(self, certificate: Certificate) -> None:
        self.certificate = certificate
        self.n = n = len(certificate.states)
        self.x, self.z = (fmpq_mpoly_ctx.get([f"{letter}{i}" for i in range(n)]) for letter in "xz")
        self.zero = self.z.constant(0)
        self.state = [self._linear(row) for row in certificate.coordinates]
        self.parameters = {parameter.name: rational(parameter.middle) for parameter in certificate.parameters}

    def _linear(self, row: Iterable[float]) -> fmpq_mpoly:
        return sum((self.z.constant(rational(a)) * z for a, z in zip(row, self.z.gens())), self.zero)

    def _moved(self, terms: Rational) -> fmpq_mpoly:
        """A polynomial in x in coordinates z."""
        return self.x.from_dict(terms).compose(*self.state, ctx=self.z)

    def _polynomial(self, polynomial: Polynomial) -> fmpq_mpoly:
        return self._moved({powers: rational(value) for powers, value in polynomial})

    def _terms(self, row: Iterable[Term]) -> fmpq_mpoly:
        """Terms of a field, all with the same function or none, without it."""
        total: Rational = {}
        for term in row:
            factor = prod(
                (self.parameters[name] ** power for name, power in term.parameters),
                start=rational(term.coefficient),
            )
            total[term.powers] = total.get(term.powers, fmpq(0)) + factor
        return self._moved(total)

    def inequality(self) -> Inequality:
        """V and r."""
        given = self.certificate
        in_x = self.x.from_dict({powers: rational(value) for powers, value in given.value})
        slope = [self._moved(terms_of(in_x.derivative(i))) for i in range(self.n)]
        value = self._polynomial(given.value)
        law = [self._polynomial(row) for row in given.law]
        g2, g1 = ([[self._terms(entry) for entry in row] for row in rows] for rows in (given.g2, given.g1))
        total = self.z.constant(rational(given.decay)) * value
        for i, row in enumerate(given.drift):
            total += slope[i] * self._terms(term for term in row if term.function is None)
            total += slope[i] * sum((a * b for a, b in zip(g2[i], law)), self.zero)
        for row in given.penalty:
            h = self._polynomial(row)
            total += h * h / 2
        for i, row in enumerate(given.r2):
            for j, price in enumerate(row):
                total += law[i] * law[j] * (rational(price) / 2)
        factor = 1 / (2 * rational(given.gamma) ** 2)
        for column in zip(*g1):
            along = sum((a * b for a, b in zip(slope, column)), self.zero)
            total += along * along * factor
        return Inequality(self.n, terms_of(value), terms_of(total), tuple(self._quotients(slope)))

    def _quotients(self, slope: list[fmpq_mpoly]) -> Iterable[Quotient]:
        for index, function in enumerate(self.certificate.functions):
            line = self._moved(
                {
                    tuple(int(j == i) for j in range(self.n)): rational(a)
                    for i, a in enumerate(function.slope)
                    if a
                }
            )
            factor = self.zero
            for i, row in enumerate(self.certificate.drift):
                factor += slope[i] * self._terms(term for term in row if term.function == index)
            terms = terms_of(line)
            form = tuple(terms.get(tuple(int(j == i) for j in range(self.n)), fmpq(0)) for i in range(self.n))
            if factor:
                yield Quotient(terms_of(factor * line), form, function)


def parity(function: Function) -> int:
    """1 where φ(o + ℓ) − φ(o) is exactly even in ℓ, −1 where it is exactly odd, else 0."""
    if function.offset != 0.0:
        return 0
    if function.name in ("sin", "cos"):
        odd = (function.pi_halves + (function.name == "cos")) % 2 == 0
        return -1 if odd else 1
    return -1 if function.name in ("tanh", "arctan") and function.pi_halves == 0 else 0


def is_symmetric(inequality: Inequality) -> bool:
    """Whether V(−z) = V(z) and r(−z) = r(z) but for rounding, which then is added to the allowance."""
    wanted = [(inequality.value, True), (inequality.polynomial, True)]
    for quotient in inequality.quotients:
        sign = parity(quotient.function)
        if sign == 0:
            return False
        wanted.append((quotient.factor, sign == -1))
    for terms, even in wanted:
        sizes = [sum(abs(nearest_double(v)) for v in part.values()) for part in by_parity(terms, even)]
        if sizes[1] > _ASYMMETRY * sum(sizes):
            return False
    return True


def by_parity(terms: Rational, even: bool) -> tuple[Rational, Rational]:
    """The terms of even (or odd) degree, and the others."""
    kept = {key: value for key, value in terms.items() if (sum(key) % 2 == 0) == even}
    return kept, {key: value for key, value in terms.items() if key not in kept}


def times_powers(factor: Rational, form: Sequence[fmpq], order: int) -> list[Rational]:
    """Q ℓᵐ for m = 0 … order."""
    n = len(form)
    context = fmpq_mpoly_ctx.get([f"z{i}" for i in range(n)])
    line = sum((context.constant(a) * z for a, z in zip(form, context.gens())), context.constant(0))
    product, result = context.from_dict(factor), []
    for _ in range(order + 1):
        result.append(terms_of(product))
        product = product * line
    return result
