"""The second route's bounds of one cell are those of docs/theorem.md, found again in rationals."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from fractions import Fraction
from math import comb
from typing import Any

import numpy as np
import pytest
from flint import arb, arb_series, ctx, fmpq

from flexhinf.certify import Certificate, Function, Term
from flexhinf.certify.checker import second_route
from flexhinf.certify.checker.bounds import Face, Proof
from flexhinf.certify.checker.residual import Refusal, offset_of, series_of
from flexhinf.certify.checker.second_route import (
    CellSample,
    ConfirmedCell,
    EveryCell,
    cell_ended,
    cell_is_proved,
    cell_of,
    confirm,
)

from .a_cubic import CUBIC
from .test_checker import V_4, uncertain, upright
from .test_exact_bounds import Exact, Rows, three_states, upper

pytestmark = pytest.mark.oracle

Q = Fraction
ONE = Q(1)
CLAIMS = {
    "degree 4": upright(V_4, 9.0),
    "uncertain": uncertain(0.04),
    "one state": CUBIC,
    "three states": three_states(),
}
#: Three states have the same code as two, and their products take half of this file's time.
SOME = [*list(CLAIMS)[:3], pytest.param("three states", marks=pytest.mark.ci("products in four variables"))]


def cells(proof: Proof, count: int, seed: int) -> list[ConfirmedCell]:
    rng, found = np.random.default_rng(seed), []
    for _ in range(count):
        h = np.exp2(-rng.integers(1, 6, proof.n - 1).astype(float))
        t = np.round(rng.uniform(-1, 1, proof.n - 1) * (1 / h - 1)) * h
        begin = float(rng.uniform(0.05, 0.5)) * proof.claim.reach
        end = begin * (1 + 2.0 ** -int(rng.integers(1, 6)))
        face = (int(rng.integers(proof.n)), int(rng.choice([-1, 1])))
        multiplier = float(rng.uniform(0.1, 4.0))
        found.append(ConfirmedCell(face, tuple(t.tolist()), tuple(h.tolist()), begin, end, multiplier))
    return found


def exact_upper(n: int, here: Exact, low: Rows) -> Fraction:
    """(8) of a polynomial whose terms are all expanded."""
    zero = (0, (0,) * (n - 1))
    return upper(n, {k: c for k, c in low.items() if k != zero}, {}, Q(0), low.get(zero, Q(0)))


def expanded(here: Exact, polynomial: Any, lift: int = 0, growth: bool = False) -> Rows:
    """All of Σ_k ρ^(k−2+lift) P_k(t) in s; each part times k for the growth."""
    found: Rows = {}
    for (k, beta), c in here.rows(polynomial).items():
        power = k - 2 + lift
        for p in range(power + 1):
            part = c * comb(power, p) * here.middle ** (power - p) * here.radius**p * (k if growth else 1)
            found[p, beta] = found.get((p, beta), Q(0)) + part
    return found


def plus(one: Rows, other: Rows, factor: Fraction = ONE) -> Rows:
    return {key: one.get(key, Q(0)) + factor * other.get(key, Q(0)) for key in {*one, *other}}


def times(one: Rows, other: Rows) -> Rows:
    found: Rows = {}
    for (p, a), x in one.items():
        for (q, b), y in other.items():
            key = (p + q, tuple(i + j for i, j in zip(a, b, strict=True)))
            found[key] = found.get(key, Q(0)) + x * y
    return found


def as_fraction(value: fmpq) -> Fraction:
    return Q(int(value.p), int(value.q))


def bound_of_r(proof: Proof, cell: ConfirmedCell, corner: int) -> tuple[Fraction, Fraction]:
    """Of r/ρ² − λV, and of −∂V/∂ρ/ρ; with the polynomials and remainders of `_taylor`, which has its own tests."""
    n, here = proof.n, Exact(cell.face, list(cell.t), list(cell.h), cell.begin, cell.end)
    zero = (0, (0,) * (n - 1))
    weights = [as_fraction(w) for w in proof.exact_corners[corner]]
    total: Rows = {}
    for w, plain in zip(weights, proof.exact.plain, strict=True):
        total = plus(total, expanded(here, plain), w)
    remainder = Q(0)
    for function, argument, row in zip(
        proof.claim.functions, proof.exact.arguments, proof.exact.factors, strict=True
    ):
        factor: Rows = {}
        for w, b in zip(weights, row, strict=True):
            factor = plus(factor, expanded(here, b), w)
        s = expanded(here, argument, lift=2)
        center = s.pop(zero, Q(0))
        radius = sum(map(abs, s.values()), Q(0))
        values, rest = second_route._taylor(
            function,
            fmpq(center.numerator, center.denominator),
            arb(fmpq(radius.numerator, radius.denominator)),
        )
        quotient: Rows = {}
        for value in reversed(values):
            quotient = plus(times(quotient, s), {zero: as_fraction(value)})
        total = plus(total, times(quotient, factor))
        size = sum(map(abs, factor.values()), Q(0))
        remainder += as_fraction(rest.upper().fmpq()) * size
    total = plus(total, expanded(here, proof.exact.value, lift=2), -Q(cell.multiplier))
    growth = expanded(here, proof.exact.value, growth=True)
    growth = {key: -c for key, c in growth.items()}
    return exact_upper(n, here, total) + remainder, exact_upper(n, here, growth)


@pytest.mark.parametrize("name", SOME)
def test_a_cell_holds_up_to_the_level_at_which_its_bound_is_zero(name: str) -> None:
    """r/ρ² + λ(c − V) is bounded by λc and what does not depend on c: cells hold below one c, and not above it."""
    proof, seen = Proof(CLAIMS[name]), 0
    with ctx.workprec(128):
        for number, cell in enumerate(cells(proof, 4 if proof.n > 2 else 7, 1)):
            corner = number % len(proof.exact_corners)
            bound, growth = bound_of_r(proof, cell, corner)
            level = float(-bound / Q(cell.multiplier))
            if level > 1e-9:
                seen += growth < 0
                assert cell_is_proved(at_level(proof, level * (1 - 1e-9)), cell, corner) == (growth < 0)
                assert not cell_is_proved(at_level(proof, level * (1 + 1e-9)), cell, corner)
    assert seen >= 2


def at_level(proof: Proof, level: float) -> Proof:
    """The same at another level, which may be negative: then r/ρ² + λ(c − V) is."""
    moved = copy(proof)
    moved.claim = copy(proof.claim)
    object.__setattr__(moved.claim, "level", level)
    return moved


@pytest.mark.parametrize(
    "name",
    [*list(CLAIMS)[:3], pytest.param("three states", marks=pytest.mark.ci("products of four variables"))],
)
def test_a_cell_holds_without_the_level_where_r_is_negative(name: str) -> None:
    proof, seen = Proof(CLAIMS[name]), [0, 0]
    with ctx.workprec(128):
        for cell in cells(proof, 3 if proof.n > 2 else 6, 2):
            cell = replace(cell, multiplier=0.0)
            bound, growth = bound_of_r(proof, cell, 0)
            assert cell_is_proved(proof, cell, 0) == (bound < 0 and growth < 0)
            seen[bound < 0 and growth < 0] += 1
    assert seen[1]


def test_a_cell_in_which_v_may_not_grow_does_not_hold() -> None:
    """V = x² − x⁴ grows up to x = 1/√2; its bound ends a little before, at one end of the interval."""
    claim = replace(CUBIC, value=(((2,), 1.0), ((4,), -1.0)), parameters=(), drift=((Term(-1.0, (1,)),),))
    proof = at_level(Proof(claim), -1e6)
    with ctx.workprec(128):
        for begin in (0.1, 0.3, 0.6):
            low, high = begin, 1.0
            for _ in range(60):
                end = (low + high) / 2
                cell = ConfirmedCell((0, 1), (), (), begin, end, 1.0)
                low, high = (end, high) if bound_of_r(proof, cell, 0)[1] < 0 else (low, end)
            assert begin < low < 0.71
            assert cell_is_proved(proof, ConfirmedCell((0, 1), (), (), begin, low * (1 - 1e-9), 1.0), 0)
            assert not cell_is_proved(proof, ConfirmedCell((0, 1), (), (), begin, high * (1 + 1e-9), 1.0), 0)


@pytest.mark.parametrize("name", CLAIMS)
def test_a_level_set_has_ended_where_v_exceeds_the_level_in_all_directions(name: str) -> None:
    proof = Proof(CLAIMS[name])
    with ctx.workprec(128):
        for cell in cells(proof, 6, 3):
            here = Exact(cell.face, list(cell.t), list(cell.h), cell.begin, cell.begin)
            least = -exact_upper(
                proof.n, here, {k: -c for k, c in expanded(here, proof.exact.value, lift=2).items()}
            )
            if least > 0:
                for share, ended in ((1 - 1e-9, True), (1 + 1e-9, False)):
                    assert cell_ended(at_level(proof, float(least) * share), cell) == ended
    exact = replace(CLAIMS["one state"], level=0.125)  # V = x²/2 at x = 0.5: not above the level
    assert not cell_ended(Proof(exact), ConfirmedCell((0, 1), (), (), 0.5, 0.6, 0.0))


def test_zero_is_not_negative() -> None:
    """r = 0 everywhere, and a V that does not depend on one state: neither is proved."""
    lazy = replace(CUBIC, value=(((2,), 1.0),), drift=((Term(-1.0, (1,)),),), g1=(((),),), g2=(((),),), law=((),),
                   penalty=((((1,), 2.0),),), parameters=())  # fmt: skip
    cell = ConfirmedCell((0, 1), (), (), 0.5, 1.0, 0.0)
    assert not cell_is_proved(Proof(lazy), cell, 0)
    assert cell_is_proved(Proof(replace(lazy, penalty=((((1,), 1.99),),))), cell, 0)
    flat = at_level(Proof(upright((((2, 0), 1.0),), coordinates=((1.0, 0.0), (0.0, 1.0)))), -1e6)
    assert not cell_is_proved(flat, ConfirmedCell((1, 1), (0.0,), (1.0,), 0.5, 1.0, 1.0), 0)
    assert cell_is_proved(flat, ConfirmedCell((0, 1), (0.0,), (1.0,), 0.5, 1.0, 1.0), 0)


# Taylor polynomials -----------------------------------------------------------------------------------------------
@pytest.mark.parametrize("center", [0.0, 2.0**-21, 2.0**-19, -0.7, 1.3])
@pytest.mark.parametrize("name", ["sin", "exp"])
def test_a_polynomial_leaves_its_rounding_and_its_remainder(name: str, center: float) -> None:
    """Σ |a_m − its double| radius^m, and max |φ^(M+2)/(M+2)!| radius^(M+1) between 0 and the interval."""
    function, order = Function(name, (1.0,), 0.4), second_route._ORDER
    with ctx.workprec(256):
        exact = fmpq(*float(center).as_integer_ratio())
        for radius in (0.0, 2.0**-10, 0.5):
            values, rest = second_route._taylor(function, exact, arb(radius))
            assert len(values) == order + 1
            low, high = min(0.0, center - radius), max(0.0, center + radius)
            largest = 0.0
            for at in np.linspace(low, high, 65):
                series = series_of(
                    name, arb_series([offset_of(function) + arb(float(at)), 1], prec=order + 3)
                )
                largest = max(largest, float(abs(series[order + 2]).upper()))
            remainder = largest * radius ** (order + 1)
            assert float(rest.upper()) >= remainder * (1 - 1e-12)
            near = abs(center) <= 2.0**-20
            rounding = 2.0**-52 * (1 + radius) ** order + (2.0**-18 if near and center else 0.0)
            assert float(rest.upper()) <= remainder * 1.1 + rounding


# What the march found -----------------------------------------------------------------------------------------------
def batch(claim: Certificate, n: int, count: int) -> tuple[Face, np.ndarray, Any]:
    rng = np.random.default_rng(4)
    h = np.exp2(-rng.integers(0, 6, (n - 1, count)).astype(float))
    t = np.round(rng.uniform(-1, 1, (n - 1, count)) * (1 / h - 1)) * h
    begin = rng.integers(0, 8, count) / 8.0
    columns = np.vstack([t, h, begin, begin + 0.125])
    face = Face(Proof(claim), (1, 1))
    reach = claim.reach
    return face, columns, face.bounds(t, h, begin * reach, (begin + 0.125) * reach)


def test_a_cell_is_read_from_its_column() -> None:
    claim = CLAIMS["three states"]
    _, columns, bounds = batch(claim, 3, 40)
    bounds = replace(bounds, largest=np.where(np.arange(40) % 2, -1.0, 1.0))
    negative = bounds.largest < 0
    for i in range(40):
        cell = cell_of((1, 1), columns, i, bounds, claim.reach)
        assert cell.t == tuple(columns[:2, i])
        assert cell.h == tuple(columns[2:4, i])
        assert (cell.begin, cell.end) == (columns[4, i] * claim.reach, columns[5, i] * claim.reach)
        assert cell.multiplier == (0.0 if negative[i] else bounds.multiplier[i])
        opposite = cell.opposite()
        assert opposite.face == (1, -1)
        assert opposite.t == tuple(-v for v in cell.t)
        assert (opposite.h, opposite.begin, opposite.end) == (cell.h, cell.begin, cell.end)


def test_a_sample_is_drawn_from_accepted_cells_alike() -> None:
    claim = CLAIMS["three states"]
    _, columns, bounds = batch(claim, 3, 40)
    good = np.arange(40) % 2 == 0
    chances = np.zeros(40)
    for seed in range(300):
        sample = CellSample((1, 1), 5, seed)
        for part in (slice(0, 3), slice(3, 25), slice(25, 40)):
            some = replace(bounds, **{n: getattr(bounds, n)[part] for n in ("largest", "multiplier")})
            sample.offer(columns[:, part], good[part], ~good[part], some, claim.reach)
        assert len(sample.cells) == 5
        assert sample.count == 0
        for cell in sample.cells:
            match = (cell.t == columns[:2].T).all(1) & (cell.h == columns[2:4].T).all(1)
            match &= columns[4] * claim.reach == cell.begin
            chances[np.flatnonzero(match)[0]] += 1
    assert not chances[~good].any()
    assert (chances[good] > 300 * 5 / 20 * 0.6).all()
    assert (chances[good] < 300 * 5 / 20 * 1.5).all()
    few = CellSample((1, 1), 100, 0)
    few.offer(columns, good, ~good, bounds, claim.reach)
    assert len(few.cells) == 20


@pytest.mark.parametrize("name", ["one state", "uncertain"])
def test_every_cell_is_shown_at_all_corners_and_where_it_ends(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[Any, ...]] = []
    monkeypatch.setattr(second_route, "cell_is_proved", lambda p, cell, i: asked.append((cell, i)) or True)
    monkeypatch.setattr(second_route, "cell_ended", lambda p, cell: asked.append((cell, "ended")) or True)
    claim = CLAIMS[name]
    n = len(claim.states)
    proof = Proof(claim)
    face = proof.faces[-1]
    h, t, begin = np.full((n - 1, 3), 0.5), np.zeros((n - 1, 3)), np.array([0.25, 0.5, 0.75])
    columns = np.vstack([t, h, begin, begin + 0.25])
    bounds = Face(proof, face).bounds(t, h, begin * claim.reach, (begin + 0.25) * claim.reach)
    ticks: list[int] = []
    every = EveryCell(proof, face, ticks.append)
    good, finished = np.array([True, False, False]), np.array([False, False, True])
    every.offer(columns, good, finished, bounds, claim.reach)
    cell, last = (cell_of(face, columns, i, bounds, claim.reach) for i in (0, 2))
    sides = (cell, cell.opposite()) if proof.even else (cell,)
    ends_ = (last, last.opposite()) if proof.even else (last,)
    expected = [(one, i) for one in sides for i in range(len(proof.exact_corners))]
    assert asked == expected + [(one, "ended") for one in ends_]
    assert every.count == len(sides) + len(ends_)
    assert ticks == [0, 0]
    assert list(every.cells) == []
    monkeypatch.setattr(second_route, "cell_is_proved", lambda p, cell, i: i == 0)
    with pytest.raises(Refusal, match="confirm"):
        confirm(proof, cell, [0, 1])
    confirm(proof, cell, [0])
    monkeypatch.setattr(second_route, "cell_ended", lambda p, cell: False)
    with pytest.raises(Refusal, match="confirm"):
        confirm(proof, cell, [0], ended=True)
