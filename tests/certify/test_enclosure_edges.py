"""Bounds and coverings of search and checker against exact rationals at the ends of their cells: an ulp counts."""

from __future__ import annotations

import itertools
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest
from flint import fmpq

from flexhinf.certify.cells import _following, cells_of
from flexhinf.certify.certificate import _down, _up
from flexhinf.certify.checker import subdivision
from flexhinf.certify.checker.bounds import UNIT, _interval, concave_bound
from flexhinf.certify.inequality import MeanForms

pytestmark = pytest.mark.property


def exact(polynomial: dict[tuple[int, ...], fmpq], z: list[Fraction]) -> Fraction:
    total = Fraction(0)
    for powers, value in polynomial.items():
        term = Fraction(int(value.p), int(value.q))
        for one, e in zip(z, powers, strict=True):
            term *= one**e
        total += term
    return total


@pytest.mark.oracle
@pytest.mark.parametrize("n", [2, 3])
def test_no_corner_of_a_cell_leaves_a_mean_form(n: int) -> None:
    rng, needed = np.random.default_rng(n), 0.0
    every = [e for e in itertools.product(range(4), repeat=n) if 1 <= sum(e) <= 4]
    polynomials = [
        {e: fmpq(int(rng.integers(-64, 65)), 16) for e in every if rng.random() < 0.4}
        | {every[i]: fmpq(3, 2)}
        for i in range(6)
    ]
    forms = MeanForms(n, polynomials)
    count = 20
    face = rng.integers(0, 2 * n, count)
    middle = np.vstack([rng.integers(2, 32, count) / 16.0, rng.integers(-8, 9, (n - 1, count)) / 16.0])
    half = 2.0 ** -rng.integers(2, 7, (n, count)).astype(float)
    value, slopes, rest = forms.enclose(face, middle, half)
    for i, (number, corner) in enumerate(
        itertools.product(range(count), itertools.product((-1, 0, 1), repeat=n))
    ):
        f, sign = int(face[number]) // 2, 1 - 2 * (int(face[number]) % 2)
        w = [Fraction(m) + s * Fraction(h) for m, s, h in zip(middle[:, number], corner, half[:, number])]
        if w[0] <= 0:
            continue
        t = list(w[1:])
        t.insert(f, Fraction(sign))
        z = [w[0] * one for one in t]
        q = i % len(polynomials)
        linear = Fraction(value[q, number]) + sum(
            Fraction(slope) * s for slope, s in zip(slopes[q, :, number], corner, strict=True)
        )
        missed = abs(exact(polynomials[q], z) / w[0] - linear)
        assert missed <= Fraction(rest[q, number]), (number, corner)
        needed = max(needed, float(missed / Fraction(rest[q, number])))
    assert needed > 0.5


def test_the_concave_bound_is_the_maximum_to_within_its_four_roundings() -> None:
    rng = np.random.default_rng(0)
    g = np.abs(rng.standard_normal(400)) * 10.0 ** rng.integers(-6, 7, 400)
    q = rng.standard_normal(400) * 10.0 ** rng.integers(-6, 7, 400)
    q[:50] = -g[:50] / 2  # where both branches meet
    q[50:100] = np.nextafter(q[:50], -np.inf)
    g[50:100] = g[:50]
    for slope, square, bound in zip(g.tolist(), q.tolist(), concave_bound(g, q).tolist(), strict=True):
        a, b = Fraction(slope), Fraction(square)
        largest = a * a / (-4 * b) if -2 * b > a else a + b
        assert abs(Fraction(bound) - largest) <= 4 * Fraction(UNIT) * (abs(a) + abs(b))


def test_an_interval_of_the_radius_holds_both_of_its_ends() -> None:
    rng = np.random.default_rng(1)
    begin = rng.uniform(0.0, 1.0, 1000) * 10.0 ** rng.integers(-8, 9, 1000)
    end = begin * (1 + 2.0 ** -rng.integers(0, 52, 1000).astype(float))
    begin[::10] = 0.0
    for a, b, m, r, e in zip(begin, end, *_interval(begin, end), strict=True):
        assert Fraction(m) - Fraction(r) <= Fraction(a)
        assert Fraction(m) + Fraction(r) >= Fraction(b)
        assert e == b


def test_cuts_cover_their_cells_and_intervals_adjoin_bit_for_bit() -> None:
    """Of the checker: both halves of a direction, or the inner half of ρ, which the outer part follows."""
    rng, n = np.random.default_rng(2), 4
    h = 2.0 ** -rng.integers(0, 8, (n - 1, 60)).astype(float)
    t = np.round(rng.uniform(-1, 1, (n - 1, 60)) * (1 - h) / h) * h
    begin = rng.integers(0, 2**10, 60) / 2.0**11
    end = begin + 2.0 ** -rng.integers(1, 9, 60).astype(float)
    cells, axis = np.vstack([t, h, begin, end]), rng.integers(0, n, 60)
    inner, first, second = subdivision._cut(cells, axis)
    along, across = cells[:, axis == 0], cells[:, axis > 0]
    assert (inner[:-1] == along[:-1]).all()
    assert (inner[-1] - inner[-2] == (along[-1] - along[-2]) / 2).all()
    further = subdivision._further(inner)
    assert (further[-2] == inner[-1]).all()
    assert (further[-1] >= np.minimum(1.0, along[-1])).all()
    assert (further[:-2] == inner[:-2]).all()
    for number, place in enumerate(axis[axis > 0] - 1):
        whole, low, high = across[:, number], first[:, number], second[:, number]
        j = n - 1 + place
        assert low[place] - low[j] == whole[place] - whole[j]
        assert low[place] + low[j] == high[place] - high[j]
        assert high[place] + high[j] == whole[place] + whole[j]
        others = [k for k in range(len(whole)) if k not in (place, j)]
        assert (low[others] == whole[others]).all()
        assert (high[others] == whole[others]).all()


def test_bundles_of_the_search_adjoin_bit_for_bit() -> None:
    rng = np.random.default_rng(3)
    inner = rng.integers(0, 2**10, 50) / 2.0**11
    outer = inner + 2.0 ** -rng.integers(1, 9, 50).astype(float)
    cells = cells_of(np.zeros(50, int), np.zeros((50, 3)), np.ones((50, 3)), inner, np.minimum(outer, 1.0))
    further = _following(cells)
    assert (further.inner == cells.outer).all()
    assert (further.outer <= 1.0).all()
    assert ((further.outer > further.inner) | (cells.outer == 1.0)).all()


def test_what_is_said_of_a_number_holds_for_every_digit() -> None:
    for value in (np.random.default_rng(4).standard_normal(500) * 10.0 ** np.arange(-250, 250)).tolist():
        down, up = Decimal(_down(value)), Decimal(_up(value))
        assert down <= Decimal(value) <= up
        assert up - down <= abs(Decimal(value)) * Decimal("1e-5")
