"""Enclosures of S(s) = (φ(o + s) − φ(o))/s by Taylor polynomials on a grid, all in ball arithmetic.

S(s) = ∫₀¹ φ′(o + u s) du, so |S^(m)(s)| ≤ max |φ^(m+1)|/(m + 1) between o and o + s, and a Taylor polynomial of order M
about s_i leaves at most max |φ^(M+2)/(M+2)!| |s − s_i|^(M+1): (5).
"""

from __future__ import annotations

from math import ceil, comb, inf, isfinite
from typing import Any

import numpy as np
from flint import arb, arb_series

from flexhinf.certify.terms import Function

ORDER = 4  # of the Taylor polynomials
GRID = 64  # their centres on an interval of length one: a power of two, so that the centres are doubles
_UP = 1.0 + 1e-12  # more than a few roundings


def series_of(name: str, argument: arb_series) -> arb_series:
    """φ of a power series; nan where the enclosure of what is divided by holds 0."""
    if name == "tanh":
        below = (2 * argument).exp() + 1
        undefined = arb_series([arb("nan")] * argument.prec, prec=argument.prec)
        return 1 - 2 / below if below[0] > 0 else undefined
    if name == "arctan":
        return argument.atan()
    return {"sin": argument.sin, "cos": argument.cos, "exp": argument.exp, "log": argument.log}[name]()


def offset_of(function: Function) -> arb:
    """Enclosure of o."""
    return arb(function.offset) + arb.pi() * function.pi_halves / 2


class Quotient:
    """Polynomials Σ_m a_m s^m with |S − Σ| bounded, for cells whose s lies in [low, high]."""

    def __init__(self, function: Function, largest: float) -> None:
        count = self._count = ceil(largest * GRID) + 1
        self._offset, self._name = offset_of(function), function.name
        self._coefficients = np.zeros((2 * count + 1, ORDER + 1))
        self._error, self._remainder = np.zeros(2 * count + 1), np.zeros(2 * count + 1)
        for side in (1, -1):
            worst = 0.0
            for i in range(count + 1):
                place = count + side * i
                worst = max(worst, self._highest(arb(side * i) / GRID))
                self._remainder[place] = worst if isfinite(worst) else inf
                self._coefficients[place], self._error[place] = self._about(arb(side * i) / GRID)

    def _series(self, about: arb, terms: int) -> arb_series:
        return series_of(self._name, arb_series([self._offset + about, 1], prec=terms))

    def _highest(self, about: arb) -> float:
        """max |φ^(M+2)/(M+2)!| within one step of the grid."""
        bound = float(abs(self._series(about + arb(0, 1 / GRID), ORDER + 3)[ORDER + 2]).upper()) * _UP
        return bound if isfinite(bound) else inf

    def _about(self, s: arb) -> tuple[list[float], float]:
        """Doubles a_m of the Taylor polynomial about s, in powers of s, and their error where |s − s_i| ≤ 1."""
        series: Any = self._series(s, ORDER + 2)
        if s == 0:
            local = [series[m + 1] for m in range(ORDER + 1)]
        else:
            quotient = (series - self._series(arb(0), 1)[0]) / arb_series([s, 1], prec=ORDER + 2)
            local = [quotient[m] for m in range(ORDER + 1)]
        values, error = [], arb(0)
        for m in range(ORDER + 1):
            exact = sum((local[j] * comb(j, m) * (-s) ** (j - m) for j in range(m, ORDER + 1)), arb(0))
            values.append(float(exact.mid()))
            error += abs(exact - arb(values[-1])) * (abs(s) + 1) ** m
        bound = float(error.upper()) * _UP
        return values, bound if isfinite(bound) else inf

    def at(self, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients (ORDER + 1, cells) of powers of s, and the bound (cells,) of what they leave."""
        index = np.clip(np.rint((low + high) / 2 * GRID), -self._count, self._count).astype(int)
        width = np.maximum(high - index / GRID, index / GRID - low) * _UP
        edge = np.ceil(np.maximum(np.abs(low), np.abs(high)) * GRID)
        inside = np.minimum(edge, self._count).astype(int)
        remainder = np.maximum(self._remainder[self._count + inside], self._remainder[self._count - inside])
        error = self._error[self._count + index] * np.maximum(width, 1.0) ** ORDER
        rest = (remainder * width ** (ORDER + 1) + error) * _UP
        return self._coefficients[self._count + index].T, np.where(edge > self._count, inf, rest)
