"""V, ẋ and r of a certificate by their definitions, from its terms, in numbers of any kind: arrays, balls, symbols."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import flint
import numpy as np

from flexhinf.certify import Certificate

#: φ(o + ℓᵀx) − φ(o) of the certificate's function with this number, at states x.
Bracket = Callable[[Certificate, int, list[Any]], Any]


@dataclass(frozen=True)
class Definition:
    """At states x and parameters by name; `number` makes one of this kind from a double."""

    claim: Certificate
    x: list[Any]
    parameters: dict[str, Any]
    number: Callable[[float], Any]
    bracket: Bracket
    _powers: dict[tuple[int, int], Any] = field(default_factory=dict)

    def polynomial(self, terms: Any) -> Any:
        """Of pairs of exponents and coefficient."""
        return sum((self.number(c) * self._monomial(e) for e, c in terms), self.number(0.0))

    def terms(self, row: Any) -> Any:
        """Of an entry of a field."""
        result = self.number(0.0)
        for term in row:
            factor = self.number(term.coefficient) * self._monomial(term.powers)
            for name, exponent in term.parameters:
                factor = factor * self.parameters[name] ** exponent
            if term.function is not None:
                factor = factor * self.bracket(self.claim, term.function, self.x)
            result = result + factor
        return result

    def _monomial(self, exponents: tuple[int, ...]) -> Any:
        result = self.number(1.0)
        for i, exponent in enumerate(exponents):
            if exponent:
                result = result * self._power(i, exponent)
        return result

    def _power(self, i: int, exponent: int) -> Any:
        if (i, exponent) not in self._powers:
            lower = self.x[i] if exponent == 1 else self._power(i, exponent - 1) * self.x[i]
            self._powers[i, exponent] = lower
        return self._powers[i, exponent]

    def value(self) -> Any:
        """V."""
        return self.polynomial(self.claim.value)

    def slope(self) -> list[Any]:
        """V_x; exponents are exact, so that factors are multiplied and not rounded into coefficients."""
        result = []
        for i in range(len(self.x)):
            total = self.number(0.0)
            for e, c in self.claim.value:
                if e[i]:
                    lowered = tuple(k - (i == j) for j, k in enumerate(e))
                    total = total + self.number(c) * self.number(float(e[i])) * self._monomial(lowered)
            result.append(total)
        return result

    def law(self) -> list[Any]:
        """u = k(x)."""
        return [self.polynomial(row) for row in self.claim.law]

    def rates(self, u: list[Any]) -> list[Any]:
        """f + g2 u, without disturbance."""
        zero = self.number(0.0)
        return [
            self.terms(drift) + sum((self.terms(e) * v for e, v in zip(inputs, u, strict=True)), zero)
            for drift, inputs in zip(self.claim.drift, self.claim.g2, strict=True)
        ]

    def disturbance_matrix(self) -> list[list[Any]]:
        """g1, (n, w)."""
        return [[self.terms(entry) for entry in row] for row in self.claim.g1]

    def squared_output(self, u: list[Any]) -> Any:
        """|z|² = |h|² + uᵀR2u."""
        total = self.number(0.0)
        for row in self.claim.penalty:
            total = total + self.polynomial(row) ** 2
        for i, row in enumerate(self.claim.r2):
            for j, price in enumerate(row):
                total = total + self.number(price) * u[i] * u[j]
        return total

    def residual(self, slope: list[Any]) -> Any:
        """r of (3) in docs/theorem.md, for V_x at the same states, without the decay."""
        u, zero = self.law(), self.number(0.0)
        r = sum((v * f for v, f in zip(slope, self.rates(u), strict=True)), self.squared_output(u) / 2)
        for column in zip(*self.disturbance_matrix(), strict=True):
            pushed = sum((v * g for v, g in zip(slope, column, strict=True)), zero)
            r = r + pushed**2 / (2 * self.number(self.claim.gamma) ** 2)
        return r


def in_doubles(claim: Certificate, x: np.ndarray, parameters: np.ndarray) -> Definition:
    """At states (N, n) and parameters (N, p)."""

    def bracket(claim: Certificate, index: int, x: list[Any]) -> Any:
        function = claim.functions[index]
        assert function.name == "sin"
        s = sum(a * state for a, state in zip(function.slope, x, strict=True))
        o = function.offset + function.pi_halves * np.pi / 2
        return 2 * np.sin(s / 2) * np.cos(o + s / 2)

    return Definition(claim, list(x.T), _named(claim, parameters.T), float, bracket)


def in_balls(claim: Certificate, x: list[Any], parameters: np.ndarray) -> Definition:
    """At one state and parameters (p,)."""

    def bracket(claim: Certificate, index: int, x: list[Any]) -> Any:
        function = claim.functions[index]
        assert function.name == "sin"
        s = sum(flint.arb(a) * state for a, state in zip(function.slope, x, strict=True))
        o = flint.arb(function.offset) + flint.arb(function.pi_halves) * flint.arb.pi() / 2
        return (o + s).sin() - o.sin()

    return Definition(claim, x, _named(claim, list(map(flint.arb, parameters))), flint.arb, bracket)


def in_symbols(claim: Certificate, x: Any, parameters: Any) -> Definition:
    """At vectors of CasADi's symbols."""
    import casadi

    def bracket(claim: Certificate, index: int, x: list[Any]) -> Any:
        function = claim.functions[index]
        s = sum(a * state for a, state in zip(function.slope, x, strict=True) if a)
        o = function.offset + function.pi_halves * np.pi / 2
        return casadi.sin(o + s) - casadi.sin(o)

    states, numbers = casadi.vertsplit(x), casadi.vertsplit(parameters)
    return Definition(claim, states, _named(claim, numbers), casadi.SX, bracket)


def _named(claim: Certificate, values: Any) -> dict[str, Any]:
    return dict(zip((p.name for p in claim.parameters), values, strict=True))
