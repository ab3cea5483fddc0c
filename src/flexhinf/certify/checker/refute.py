"""A point at which a claim about quadratic forms is false: a corner that fails is no refutation by itself, since the
functions' quotients take their extreme values far from 0 only. Nothing here can make a claim proved.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from flint import arb, arb_series, fmpq, fmpq_mat

from flexhinf.certify.checker.quadratic import Corner, corner_text, form_of, row_of
from flexhinf.certify.checker.quotient import offset_of, series_of
from flexhinf.certify.checker.residual import Residual, as_rational, rounded
from flexhinf.certify.checker.steering import Refusal
from flexhinf.certify.claim import Claim

_POINTS = 200  # along a ray at which r is looked at
_NEAREST = 1e-6  # of them, relative to where the ray ends


def refute_at_corners(claim: Claim, exact: Residual, failed: list[Corner]) -> None:
    """Raise a `Refusal` where r > 0 at a point with V ≤ c, shown in balls, for parameters at a corner of their box."""
    value = np.array(_doubles(form_of(exact.value)))
    parts: list[tuple[Any, ...]] = list(zip(exact.plain, *exact.factors, strict=True))
    rows = [row_of(one) for one in exact.arguments]
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
                    form = form_of(polynomial)
                    total += arb(weight) * quotient * arb((z.transpose() * form * z)[0, 0])
            at = (z.transpose() * form_of(exact.value) * z)[0, 0]
            if total > 0 and at <= as_rational(claim.level):
                place = np.array([rounded(z[i, 0]) for i in range(z.nrows())])
                raise Refusal(f"{corner_text(claim, corner)}: r > 0", place, rounded(at))


def _quotient(function: Any, s: fmpq) -> arb:
    """S(s), its limit at 0."""
    if s == 0:
        return series_of(function.name, arb_series([offset_of(function), 1], prec=2))[1]
    ends = [
        series_of(function.name, arb_series([offset_of(function) + arb(a)], prec=1))[0] for a in (s, fmpq(0))
    ]
    return (ends[0] - ends[1]) / arb(s)


def _doubles(matrix: fmpq_mat) -> list[list[float]]:
    return [[rounded(matrix[i, j]) for j in range(matrix.ncols())] for i in range(matrix.nrows())]
