"""Single cells proved on another route: exact rational substitution, ball arithmetic, no table and no rounding.

A random sample of the accepted cells, or every one of them, is proved again here. With every cell, the bounds in
doubles need not be trusted. The variables of the polynomials are reused: the first becomes ρ and then s_0, the others
t_i and
then s_i.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
from flint import arb, arb_series, fmpq, fmpq_mpoly, fmpq_mpoly_ctx

from flexhinf.certify.checker.bounds import CellEnclosure, Proof
from flexhinf.certify.checker.residual import as_rational, offset_of, require, series_of
from flexhinf.certify.claim import Function

_ORDER = 5  # of the Taylor polynomials of S: not that of the first route
_PIECES = 32  # number of pieces on which a derivative is bounded


@dataclass(frozen=True)
class ConfirmedCell:
    """An accepted cell: face z_f = sign · ρ, t ± h, begin ≤ ρ ≤ end, and λ."""

    face: tuple[int, int]
    t: tuple[float, ...]
    h: tuple[float, ...]
    begin: float
    end: float
    multiplier: float

    def opposite(self) -> ConfirmedCell:
        """The cell at −z."""
        return replace(self, face=(self.face[0], -self.face[1]), t=tuple(-t for t in self.t))


def cell_of(
    face: tuple[int, int], cells: np.ndarray, i: int, bounds: CellEnclosure, reach: float
) -> ConfirmedCell:
    """One cell of a batch. Its λ is 0 where r < 0 was shown without it."""
    n = len(cells) // 2
    t, h, (begin, end) = (part.tolist() for part in np.split(cells[:, i], [n - 1, 2 * n - 2]))
    multiplier = 0.0 if bounds.largest[i] < 0 else float(bounds.multiplier[i])
    return ConfirmedCell(face, tuple(t), tuple(h), begin * reach, end * reach, multiplier)


def cell_is_proved(proof: Proof, cell: ConfirmedCell, corner: int) -> bool:
    """Whether V grows and r < 0 (or r/ρ² + λ(c − V) < 0) on a cell, at one corner of the box of parameters."""
    exact, n, context = proof.exact, proof.n, proof.exact.value.context()
    begin, end = as_rational(cell.begin), as_rational(cell.end)
    places = _places(context, cell, (begin + end) / 2, (end - begin) / 2)
    if not _upper(_on_face(-exact.value, cell, places, 0, growth=True), n) < 0:
        return False
    zero, weights = context.constant(0), proof.exact_corners[corner]
    total = _on_face(sum((w * a for w, a in zip(weights, exact.plain, strict=True)), zero), cell, places, 0)
    remainder = arb(0)
    for function, argument, row in zip(proof.claim.functions, exact.arguments, exact.factors, strict=True):
        factor = _on_face(sum((w * b for w, b in zip(weights, row, strict=True)), zero), cell, places, 0)
        s = _on_face(argument, cell, places, 2)
        center = s.to_dict().get((0,) * n, fmpq(0))
        polynomial, error = _taylor(function, center, _magnitude(s - context.constant(center)))
        quotient = zero
        for coefficient in reversed(polynomial):
            quotient = quotient * (s - context.constant(center)) + coefficient
        total += quotient * factor
        remainder += error * _magnitude(factor)
    if cell.multiplier:
        total += as_rational(cell.multiplier) * (
            context.constant(as_rational(proof.claim.level)) - _on_face(exact.value, cell, places, 2)
        )
    bound = _upper(total, n) + remainder
    return bool(bound.is_finite() and bound < 0)


def cell_ended(proof: Proof, cell: ConfirmedCell) -> bool:
    """Whether V > c at the inner end of a cell, in all its directions."""
    context = proof.exact.value.context()
    value = _on_face(proof.exact.value, cell, _places(context, cell, as_rational(cell.begin), fmpq(0)), 2)
    return bool(_upper(context.constant(as_rational(proof.claim.level)) - value, proof.n) < 0)


def _places(context: fmpq_mpoly_ctx, cell: ConfirmedCell, middle: fmpq, half: fmpq) -> list[fmpq_mpoly]:
    boxes = [(middle, half), *zip(map(as_rational, cell.t), map(as_rational, cell.h), strict=True)]
    return [context.constant(m) + r * s for (m, r), s in zip(boxes, context.gens(), strict=True)]


def _on_face(
    polynomial: fmpq_mpoly, cell: ConfirmedCell, places: list[fmpq_mpoly], lift: int, growth: bool = False
) -> fmpq_mpoly:
    """Σ_k ρ^(k−2+lift) P_k(t) in the variables s; each part times k for the growth along rays."""
    f, sign = cell.face
    terms: dict[tuple[int, ...], fmpq] = {}
    for powers, value in polynomial.to_dict().items():
        e = [*map(int, powers)]
        row = (sum(e) - 2 + lift, *e[:f], *e[f + 1 :])
        terms[row] = terms.get(row, fmpq(0)) + value * sign ** e[f] * (sum(e) if growth else 1)
    context = polynomial.context()
    return context.from_dict(terms).compose(*places, ctx=context)


def _taylor(function: Function, center: fmpq, radius: arb) -> tuple[list[fmpq], arb]:
    """Rational coefficients about a centre, and a bound of the remainder within the radius: nan where φ is not
    analytic between o and there, for a pole has no bound."""
    offset, about = offset_of(function), arb(center)
    series = series_of(function.name, arb_series([offset + about, 1], prec=_ORDER + 2))
    if abs(about) > 2.0**-20:
        quotient = (series - series_of(function.name, arb_series([offset], prec=1))[0]) / arb_series(
            [about, 1], prec=_ORDER + 1
        )
        local = [quotient[m] for m in range(_ORDER + 1)]
    else:  # S^(m)/m! = ∫ u^m φ^(m+1)(o + u s)/m! du, enclosed over all u at once
        series = series_of(function.name, arb_series([offset + about.union(arb(0)), 1], prec=_ORDER + 2))
        local = [series[m + 1] for m in range(_ORDER + 1)]
    if not all(value.is_finite() for value in local):
        return [fmpq(0)], arb("nan")
    values = [as_rational(float(value.mid())) for value in local]
    rounding = sum(
        (abs(v - arb(q)) * radius**m for m, (v, q) in enumerate(zip(local, values, strict=True))), arb(0)
    )
    low, high = (about - radius).union(arb(0)).lower(), (about + radius).union(arb(0)).upper()
    worst = arb(0)
    for i in range(_PIECES):
        piece = (low + (high - low) * i / _PIECES).union(low + (high - low) * (i + 1) / _PIECES)
        # nan if one of them is nan.
        worst = worst.max(
            abs(series_of(function.name, arb_series([offset + piece, 1], prec=_ORDER + 3))[_ORDER + 2])
        )
    return values, rounding + worst * radius ** (_ORDER + 1)


def _magnitude(polynomial: fmpq_mpoly) -> arb:
    return sum((abs(arb(value)) for value in polynomial.coeffs()), arb(0))


def _upper(polynomial: fmpq_mpoly, n: int) -> arb:
    """Bound (8): constant, slopes with their squares, pairs shared between squares, and the rest."""
    low = {e: v for e, v in polynomial.to_dict().items() if sum(e) <= 2}
    total = low.get((0,) * n, fmpq(0)) + _magnitude(polynomial)
    total -= sum((abs(arb(value)) for value in low.values()), arb(0))
    for i, e in enumerate([tuple(int(i == j) for j in range(n)) for i in range(n)]):
        slope, square = abs(arb(low.get(e, fmpq(0)))), arb(low.get(tuple(2 * power for power in e), fmpq(0)))
        square += sum((abs(arb(v)) / 2 for f, v in low.items() if f[i] == 1 and sum(f) == 2), arb(0))
        if -2 * square > slope:
            total += slope * slope / (-4 * square)
        else:  # at s = 1; where the balls do not tell, what holds in any case
            total += slope + square if -2 * square < slope else slope + abs(square)
    return total


# Cells that are accepted or finished ------------------------------------------------------------------
def confirm(proof: Proof, cell: ConfirmedCell, corners: Iterable[int], ended: bool = False) -> None:
    """Raise a `Refusal` unless a cell is proved at these corners of the parameters, or V > c at its inner end."""
    require(
        cell_ended(proof, cell) if ended else all(cell_is_proved(proof, cell, i) for i in corners),
        f"rationals and balls do not confirm {cell}",
    )


class CellSample:
    """A random sample of the accepted cells of a face (reservoir sampling, equal chances)."""

    def __init__(self, face: tuple[int, int], size: int, seed: int) -> None:
        self.face, self.size, self.cells, self.count = face, size, list[ConfirmedCell](), 0
        self._rng, self._seen = np.random.default_rng([seed, face[0], face[1] + 1]), 0

    def offer(
        self, cells: np.ndarray, good: np.ndarray, finished: np.ndarray, bounds: CellEnclosure, reach: float
    ) -> None:
        """Cells of one batch, as columns of t, h and ends of ρ, and which of them are accepted and finished."""
        for i in np.flatnonzero(good):
            self._seen += 1
            place = len(self.cells) if len(self.cells) < self.size else int(self._rng.integers(self._seen))
            if place < self.size:
                self.cells[place : place + 1] = [cell_of(self.face, cells, int(i), bounds, reach)]


class EveryCell:
    """Every accepted or finished cell of a face, and its opposite where that has no face of its own, at all corners."""

    def __init__(self, proof: Proof, face: tuple[int, int], tick: Callable[[int], None]) -> None:
        self.proof, self.face, self.cells, self.count, self.tick = proof, face, list[ConfirmedCell](), 0, tick

    def offer(
        self, cells: np.ndarray, good: np.ndarray, finished: np.ndarray, bounds: CellEnclosure, reach: float
    ) -> None:
        """Cells of one batch, as columns of t, h and ends of ρ, and which of them are accepted and finished."""
        for chosen in (good, finished):
            for i in np.flatnonzero(chosen):
                cell = cell_of(self.face, cells, int(i), bounds, reach)
                self.tick(0)
                for image in (cell, cell.opposite()) if self.proof.even else (cell,):
                    confirm(self.proof, image, range(len(self.proof.exact_corners)), ended=chosen is finished)
                    self.count += 1
