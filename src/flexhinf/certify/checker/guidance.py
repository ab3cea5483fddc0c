"""Choice of the next cut of a cell, and refusals: nothing here can make a claim proved.

Every cut of a cell is sound, and so is every refusal. If r is a quadratic form, a failing corner is not yet a
refutation, as the functions' quotients reach their extreme values far from 0 only. So the search looks for a point at
which the claim is false.
"""

from __future__ import annotations

import numpy as np
from flint import arb, arb_series, fmpq, fmpq_mat, fmpq_mpoly

from flexhinf.certify.checker.bounds import CellEnclosure, CentredForm, TaylorTable
from flexhinf.certify.checker.residual import (
    Corner,
    ExactResidual,
    Refusal,
    as_rational,
    corner_text,
    form_of,
    offset_of,
    rounded,
    row_of,
    series_of,
)
from flexhinf.certify.claim import Claim, Function

_NARROWEST = 2.0**-15  # half width of the widest t_i: a direction that is not decided there is refused
_EXACT = 2.0**-40  # half width of any t_i, so that t ± h are doubles
_SHORTEST = 2.0**-24  # of an interval of ρ, in units of the reach
_FLAT = 0.02  # an interval of ρ shorter than this times the widest t_i is not cut further


def refuse(
    face: tuple[int, int], cells: np.ndarray, undecided: np.ndarray, bounds: CellEnclosure, reach: float
) -> None:
    """Raise where a cell that is neither finished nor proved is wrong at its centre, or too small to go on.

    The columns of `cells` are t, h, and the ends of the interval of ρ in units of the reach.
    """
    n = len(cells) // 2
    h, begin, end = cells[n - 1 : -2], cells[-2], cells[-1]
    edge, short = begin >= 1.0, end - begin < _SHORTEST
    narrow = (h.max(0) < _NARROWEST) | (h.min(0) < _EXACT) if n > 1 else np.ones(len(end), bool)
    inside, allowance = bounds.value < bounds.level, bounds.remainder + bounds.rounding
    positive = np.isfinite(allowance) & (bounds.constant > 1e3 * allowance) & (bounds.least_growth > 0)
    for refused, why in (
        (edge & undecided & (inside | narrow), "the level set reaches beyond the stated reach"),
        (undecided & inside & positive, "r > 0"),
        (undecided & ~edge & (short if n == 1 else narrow | short), "a cell cannot be decided"),
    ):
        if refused.any():
            i = int(np.flatnonzero(refused)[0])
            z = np.insert(cells[: n - 1, i], face[0], face[1]) * (begin[i] + end[i]) / 2 * reach
            raise Refusal(why, z, float(bounds.value[i]))


def axis_to_cut(table: TaylorTable, form: CentredForm, cells: np.ndarray) -> np.ndarray:
    """The variable of each cell that adds most to its bound, beyond the constant: 0 for ρ, i for t_i."""
    h, length, edge = cells[table.n - 1 : -2], cells[-1] - cells[-2], cells[-2] >= 1.0
    size = np.abs(form.low) + form.radius
    spread = np.c_[np.zeros(len(table.tail_powers)), table.tail_powers > 0].T.astype(float)
    score = (
        np.abs(form.low[table.square])
        + size[table.linear] / 4
        + table.in_pair @ size[table.pairs]
        + (table.terms[table.others] > 0).T.astype(float) @ size[table.others]
        + spread @ form.tail[:-1]
    )
    score[0] += form.tail[-1]
    axis: np.ndarray = np.where(np.isfinite(score), score, 0.0).argmax(0)
    if table.n > 1:
        axis = np.where((axis == 0) & (length < _FLAT * h.max(0)) | edge, 1 + h.argmax(0), axis)
    return axis


_POINTS, _NEAREST = 200, 1e-6  # along a ray at which r is looked at, and the first, relative to the last


def refute_at_corners(claim: Claim, exact: ExactResidual, failed: list[Corner]) -> None:
    """Raise a `Refusal` if r > 0 at a point with V ≤ c, for parameters at a corner of their box.

    The points lie on a ray for each corner, along which its quadratic form of r is largest; r > 0 is shown in balls.
    """
    value = np.array(_doubles(form_of(exact.value)))
    parts: list[tuple[fmpq_mpoly, ...]] = list(zip(exact.plain, *exact.factors, strict=True))
    rows = [row_of(argument) for argument in exact.arguments]
    for corner in failed:
        _, vectors = np.linalg.eigh(_doubles(corner.form))
        v = vectors[:, 0]
        end = np.sqrt(claim.level / (v @ value @ v))
        for share in np.r_[1.0, np.linspace(_NEAREST, 1.0, _POINTS, endpoint=False)] * (1 - 1e-9):
            z = fmpq_mat([[as_rational(float(a * share * end))] for a in v])
            quotients = [
                _quotient(function, (row * z)[0, 0])
                for function, row in zip(claim.functions, rows, strict=True)
            ]
            total = arb(0)
            for weight, part in zip(corner.weights, parts, strict=True):
                for quotient, polynomial in zip((arb(1), *quotients), part, strict=True):
                    total += arb(weight) * quotient * arb((z.transpose() * form_of(polynomial) * z)[0, 0])
            at = (z.transpose() * form_of(exact.value) * z)[0, 0]
            if total > 0 and at <= as_rational(claim.level):
                raise Refusal(
                    f"{corner_text(claim, corner)}: r > 0", np.array(_doubles(z))[:, 0], rounded(at)
                )


def _quotient(function: Function, s: fmpq) -> arb:
    if s == 0:
        return series_of(function.name, arb_series([offset_of(function), 1], prec=2))[1]
    ends = [
        series_of(function.name, arb_series([offset_of(function) + arb(a)], prec=1))[0] for a in (s, fmpq(0))
    ]
    return (ends[0] - ends[1]) / arb(s)


def _doubles(matrix: fmpq_mat) -> list[list[float]]:
    return [[rounded(matrix[i, j]) for j in range(matrix.ncols())] for i in range(matrix.nrows())]
