"""Every bound of a cell again, in rationals and by the formulas of docs/theorem.md: none is smaller.

What is random points' to find is in test_random_cells.py. Here a lost term is found even where it is far smaller than
what the other terms leave: remainders, odd parts, what parameters differ by, and the allowance for rounding.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from functools import cache
from itertools import product
from math import comb
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from flint import fmpq, fmpq_mpoly_ctx
from tests.certify.a_cubic import CUBIC
from tests.certify.test_checker import V_2, V_4, uncertain, upright

from flexhinf.certify import Certificate, Function, Term
from flexhinf.certify.checker.bounds import (
    ORDER,
    CellEnclosure,
    CentredForm,
    Face,
    Proof,
    TaylorTable,
    _interval,
    _is_odd,
    _nearly_even,
    _roundings,
)
from flexhinf.certify.checker.residual import as_rational

pytestmark = pytest.mark.oracle

Q = Fraction
UNIT = Q(1, 2**53)
Rows = dict[tuple[int, tuple[int, ...]], Fraction]


def three_states() -> Certificate:
    """Every kind of pair and of tail has terms; V is nearly even, so that odd parts are bounded."""
    value = (((2, 0, 0), 1.3), ((0, 2, 0), 0.9), ((0, 0, 2), 0.7), ((1, 1, 0), 0.4), ((0, 1, 1), -0.3),
             ((1, 0, 1), 0.2), ((2, 2, 0), -0.02), ((1, 1, 2), 0.03), ((4, 0, 0), 0.01),
             ((2, 1, 0), 1e-12))  # fmt: skip
    line = [Term(-1.0, tuple(int(i == j) for j in range(3))) for i in range(3)]
    one, none = ((Term(1.0, (0, 0, 0)),),), ((),)
    return replace(
        upright(), value=value, level=2.0, states=(*upright().states, replace(upright().states[0], name="third")),
        drift=((line[0], Term(0.3, (0, 0, 0), (), 0)), (line[1], Term(-0.1, (3, 0, 0))), (line[2],)),
        g1=(none, one, none), g2=(none, none, none), law=((),), penalty=((((1, 0, 0), 0.2),),), reach=2.0,
        coordinates=((1.0, 0.1, 0.0), (0.0, 1.0, 0.2), (0.3, 0.0, 1.0)),
        functions=(Function("sin", (0.7, -0.9, 0.3)),),
    )  # fmt: skip


def _negative(width: float) -> Certificate:
    """`uncertain`, with the weight's sign in the parameter."""
    claim = uncertain(width)
    weight = claim.parameters[0]
    first, (fall,) = claim.drift
    return replace(
        claim, parameters=(replace(weight, low=-weight.high, high=-weight.low), claim.parameters[1]),
        drift=(first, (replace(fall, coefficient=-fall.coefficient),)),
    )  # fmt: skip


def _without_channels() -> Certificate:
    """r = V_x f has the degree of V, so that V decides how many powers of the radius are kept."""
    still, none = (Term(-1.0, (1, 0)),), ((), ())
    return upright(V_4, 5.0, drift=(still, (Term(-0.5, (0, 1)),)), g1=((none[:1]), (none[:1])), law=((),),
                   g2=((none[:1]), (none[:1])), penalty=(), functions=())  # fmt: skip


CASES = {
    "quadratic V": upright(V_2),
    "degree 4": upright(V_4, 9.0),
    "uncertain": uncertain(0.04),
    "negative parameters": _negative(0.04),
    "one state": CUBIC,
    "r of V's degree": _without_channels(),
    "three states": three_states(),
    "exp": upright(V_2, functions=(Function("exp", (0.1, 0.02), 0.2),)),
}


# Polynomials on a cell, exactly ---------------------------------------------------------------------------------
class Exact:
    """One cell, and the coefficients of polynomials on it."""

    def __init__(
        self, face: tuple[int, int], t: list[float], h: list[float], begin: float, end: float
    ) -> None:
        self.face, self.t, self.h = face, [Q(v) for v in t], [Q(v) for v in h]
        self.begin, self.end = Q(begin), Q(end)
        self.middle, self.radius = (self.begin + self.end) / 2, (self.end - self.begin) / 2

    def at_begin(self) -> Exact:
        return Exact(self.face, list(map(float, self.t)), list(map(float, self.h)), *2 * [float(self.begin)])

    def rows(self, polynomial: Any) -> Rows:
        """The coefficients of P_k(τ + h s), by (k, β)."""
        f, sign = self.face
        found: Rows = {}
        for powers, value in polynomial.to_dict().items():
            e = [*map(int, powers)]
            beta = (*e[:f], *e[f + 1 :])
            whole = Q(int(value.p), int(value.q)) * sign ** e[f]
            for lower in product(*(range(b + 1) for b in beta)):
                c = whole
                for b, p, t, h in zip(beta, lower, self.t, self.h, strict=True):
                    c *= comb(b, p) * t ** (b - p) * h**p
                found[sum(e), lower] = found.get((sum(e), lower), Q(0)) + c
        return found

    def low(self, rows: Rows, lift: int = 0) -> Rows:
        """The coefficients of s0^p s^β with |β| ≤ 2."""
        found: Rows = {}
        for (k, beta), c in rows.items():
            power = k - 2 + lift
            for p in range(power + 1 if sum(beta) <= 2 else 0):
                part = c * comb(power, p) * self.middle ** (power - p) * self.radius**p
                found[p, beta] = found.get((p, beta), Q(0)) + part
        return found

    def tails(
        self, components: list[Rows], mid: list[Fraction], rad: list[Fraction], lift: int = 0
    ) -> Fraction:
        """What all terms with |β| > 2 add: (10)."""
        at: dict[Any, Fraction] = {}
        total = Q(0)
        for k, beta in {key for rows in components for key in rows}:
            if sum(beta) <= 2:
                continue
            parts = [rows.get((k, beta), Q(0)) for rows in components]
            mean = sum((m * c for m, c in zip(mid, parts, strict=True)), Q(0))
            apart = sum((w * abs(c) for w, c in zip(rad, parts, strict=True)), Q(0))
            power = k - 2 + lift
            at[beta] = at.get(beta, Q(0)) + mean * self.middle**power
            total += apart * self.middle**power
            total += (abs(mean) + apart) * (self.end**power - self.middle**power)
        return total + sum(map(abs, at.values()))


def upper(n: int, low: Rows, spread: Rows, tails: Fraction, constant: Fraction) -> Fraction:
    """(8) and (9)."""
    size = {key: abs(low.get(key, Q(0))) + spread.get(key, Q(0)) for key in {*low, *spread}}

    def exponents(key: tuple[int, tuple[int, ...]]) -> tuple[int, ...]:
        return (key[0], *key[1])

    by = {exponents(key): v for key, v in size.items()}
    signed = {exponents(key): low.get(key, Q(0)) + spread.get(key, Q(0)) for key in size}
    total = constant + tails + sum((v for e, v in by.items() if sum(e) > 2), Q(0))
    for i in range(n):
        unit = tuple(int(i == j) for j in range(n))
        slope = by.get(unit, Q(0))
        square = signed.get(tuple(2 * one for one in unit), Q(0))
        square += sum((v for e, v in by.items() if sum(e) == 2 and e[i] == 1), Q(0)) / 2
        total += slope**2 / (-4 * square) if -2 * square > slope else slope + square
    return total


def magnitudes(polynomial: Any) -> dict[int, Fraction]:
    found: dict[int, Fraction] = {}
    for powers, value in polynomial.to_dict().items():
        k = sum(map(int, powers))
        found[k] = found.get(k, Q(0)) + abs(Q(int(value.p), int(value.q)))
    return found


def roundings(proof: Proof, degree: int) -> int:
    """K of (11)."""
    n, functions = proof.n, len(proof.exact.arguments)
    rows = sum(comb(k + n - 1, n - 1) for k in range(2, degree + 1))
    return 2 + 2 * (ORDER + 1) * functions + 2 * n * degree + 6 * degree + len(proof.mid) + rows


def allowance(proof: Proof, degree: int, pair: tuple[Any, Any], end: Fraction) -> Fraction:
    """(11), and the odd part."""
    kept, left = map(magnitudes, pair)
    rounding = sum((m * end ** (k - 2) for k, m in kept.items()), Q(0)) * 2 * roundings(proof, degree) * UNIT
    return rounding + sum((m * end ** (k - 2) for k, m in left.items()), Q(0))


# Cells ------------------------------------------------------------------------------------------------------------
def cells_of(proof: Proof, count: int, rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    """Dyadic cells of all sizes: face, t, h, and the ends of ρ."""
    for _ in range(count):
        h = np.exp2(-rng.integers(0, 9, proof.n - 1).astype(float))
        t = np.round(rng.uniform(-1, 1, proof.n - 1) * (1 / h - 1)) * h
        length = 2.0 ** -rng.integers(0, 9)
        inner = np.floor(rng.uniform(0, 1) * (1 / length - 1)) * length * (rng.uniform() > 0.2)
        face = proof.faces[rng.integers(len(proof.faces))]
        reach = proof.claim.reach
        yield face, t, h, inner * reach, (inner + length) * reach


def spied(face: Face, cell: tuple[Any, ...], monkeypatch: pytest.MonkeyPatch) -> tuple[Any, list[Any]]:
    """The bounds of a cell, and what the quotients were asked and said."""
    heard: list[Any] = []
    for quotient in face.proof.quotients:
        real = type(quotient).at

        def at(low: Any, high: Any, quotient: Any = quotient, real: Any = real) -> Any:
            heard.append((low[0], high[0], *real(quotient, low, high)))
            return heard[-1][2:]

        monkeypatch.setattr(quotient, "at", at)
    _, t, h, begin, end = cell
    return face.bounds(t[:, None], h[:, None], np.array([begin]), np.array([end])), heard


@cache
def proof_of(name: str) -> Proof:
    return Proof(CASES[name])


@pytest.mark.quick_cases(3)
@pytest.mark.parametrize("name", CASES)
def test_no_bound_is_below_its_formula_and_none_is_idle(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    proof = proof_of(name)
    n, exact, level = proof.n, proof.exact, Q(proof.claim.level)
    mid, rad = [Q(v) for v in proof.mid], [Q(v) for v in proof.rad]
    weight = [abs(m) + w for m, w in zip(mid, rad, strict=True)]
    faces = {face: Face(proof, face) for face in proof.faces}
    degree, small = proof.table.degree, proof.small.degree
    for cell in cells_of(proof, 6 if n > 2 else 20, np.random.default_rng(3)):
        found, heard = spied(faces[cell[0]], cell, monkeypatch)
        here = Exact(cell[0], *map(list, cell[1:3]), *cell[3:])

        # r
        kept = [proof.parts(p)[0] for p in exact.plain]
        rounding = sum(
            (w * allowance(proof, degree, proof.parts(p), here.end) for w, p in zip(weight, exact.plain)),
            Q(0),
        )
        remainder = Q(0)
        for argument, row, (low, high, a, rest) in zip(exact.arguments, exact.factors, heard, strict=True):
            lowest, highest = ends(here, argument)
            assert Q(low) <= lowest
            assert Q(high) >= highest
            assert Q(high) - Q(low) <= (highest - lowest) * (1 + Q(1, 10**9)) + Q(1, 10**9)
            pairs = [proof.parts(p) for p in row]
            factors = [here.rows(one) for one, _ in pairs]
            size = here.tails(factors, mid, rad)
            size += sum(absolute(here, factors, mid, rad).values(), Q(0))
            size += sum((w * allowance(proof, small, pair, here.end) for w, pair in zip(weight, pairs)), Q(0))
            remainder += Q(rest[0]) * size
            for m in range(ORDER + 1):
                lifted = [(one * argument**m, odd * argument**m) for one, odd in pairs]
                more = [w * allowance(proof, degree, pair, here.end) for w, pair in zip(weight, lifted)]
                rounding += abs(Q(a[m, 0])) * sum(more, Q(0))
                kept = [p + one * as_rational(a[m, 0]) for p, (one, _) in zip(kept, lifted, strict=True)]
        rows = [here.rows(p) for p in kept]
        low, spread = combined(here, rows, mid, rad)
        zero = (0, (0,) * (n - 1))
        centre = [here.low(one).get(zero, Q(0)) for one in rows]
        constant = max(sum((Q(w) * c for w, c in zip(corner, centre)), Q(0)) for corner in proof.corners)
        low.pop(zero, None), spread.pop(zero, None)
        expected = upper(n, low, spread, here.tails(rows, mid, rad), constant)
        assert remainder <= Q(found.remainder[0]) <= remainder * (1 + Q(1, 10**8))
        remainder = Q(found.remainder[0])
        assert Q(found.rounding[0]) >= rounding
        assert Q(found.rounding[0]) <= rounding * 6 + Q(1, 10**170)
        close(found.largest, expected + remainder + Q(found.rounding[0]), Q(found.rounding[0]) / 5)

        # r where V ≤ c
        factor, pair = Q(found.multiplier[0]), proof.parts(exact.value)
        value = here.rows(pair[0])
        lift = here.low(value, lift=2)
        inside = {key: low.get(key, Q(0)) - factor * lift.get(key, Q(0)) for key in {*low, *lift} - {zero}}
        error = allowance(proof, small, pair, here.end)
        constant += factor * (level - lift.get(zero, Q(0)))
        tails = here.tails(rows, mid, rad) + factor * here.tails([value], [Q(1)], [Q(0)], lift=2)
        expected = upper(n, inside, spread, tails, constant)
        beyond = factor * (error * here.end**2 + 4 * UNIT * level)
        slack = Q(found.largest_inside[0]) - expected - remainder - Q(found.rounding[0])
        assert slack >= beyond - (rounding + beyond) / 5
        assert slack <= 6 * beyond + rounding / 5

        # V and its growth
        first = here.at_begin()
        minus = {key: -c for key, c in value.items()}
        expected = (-bound(n, first, minus) - error) * here.begin**2
        span = error * here.begin**2
        assert -6 * float(span) <= float(Q(found.least_value[0]) - expected) <= float(span / 5)
        assert Q(found.least_value[0]) <= -bound(n, first, minus) * here.begin**2 - span * Q(4, 5)
        grown = {key: -c * key[0] for key, c in value.items()}
        expected = -bound(n, here, grown)
        assert -6 * small * error <= Q(found.least_growth[0]) - expected <= -small * error * Q(4, 5)


def ends(here: Exact, argument: Any) -> tuple[Fraction, Fraction]:
    """The range of a linear form on the cell."""
    rows = here.rows(argument)
    zero = (0,) * len(here.t)
    ray = rows.get((1, zero), Q(0))
    half = sum((abs(c) for (_, beta), c in rows.items() if beta != zero), Q(0))
    around = abs(ray) * here.radius + half * here.end
    return ray * here.middle - around, ray * here.middle + around


def combined(here: Exact, rows: list[Rows], mid: Any, rad: Any) -> tuple[Rows, Rows]:
    parts = [here.low(one) for one in rows]
    keys = {key for one in parts for key in one}
    low = {key: sum((m * one.get(key, Q(0)) for m, one in zip(mid, parts)), Q(0)) for key in keys}
    spread = {key: sum((w * abs(one.get(key, Q(0))) for w, one in zip(rad, parts)), Q(0)) for key in keys}
    return low, spread


def absolute(here: Exact, rows: list[Rows], mid: Any, rad: Any) -> Rows:
    low, spread = combined(here, rows, mid, rad)
    return {key: abs(low[key]) + spread[key] for key in low}


def bound(n: int, here: Exact, rows: Rows) -> Fraction:
    low, zero = here.low(rows), (0, (0,) * (n - 1))
    return upper(n, {k: c for k, c in low.items() if k != zero}, {}, here.tails([rows], [Q(1)], [Q(0)]),
                 low.get(zero, Q(0)))  # fmt: skip


def close(found: np.ndarray, expected: Fraction, within: Fraction) -> None:
    assert abs(float(Q(found[0]) - expected)) <= float(within) + 1e-170


def test_an_interval_of_the_radius_is_never_too_short() -> None:
    rng = np.random.default_rng(5)
    begin = rng.uniform(0.0, 3.0, 500)
    end = begin + 2.0 ** rng.uniform(-30, 1, 500)
    middle, radius, last = _interval(begin, end)
    for b, e, m, r, z in zip(begin, end, middle, radius, last, strict=True):
        assert Q(m) - Q(r) <= Q(b)
        assert Q(e) <= Q(m) + Q(r)
        assert Q(r) <= (Q(e) - Q(b)) / 2 * (1 + 10 * UNIT) + 10 * UNIT * Q(e)
        assert z == e


def test_parameters_middles_and_radii_hold_every_corner() -> None:
    rng = np.random.default_rng(6)
    for _ in range(6):
        proof = Proof((uncertain, _negative)[int(rng.integers(2))](float(rng.uniform(0.001, 0.3))))
        for j, (mid, rad) in enumerate(zip(proof.mid, proof.rad, strict=True)):
            exact = [Q(int(row[j].p), int(row[j].q)) for row in proof.exact_corners]
            assert Q(mid) - Q(rad) <= min(exact)
            assert max(exact) <= Q(mid) + Q(rad)
            assert Q(rad) <= (max(exact) - min(exact)) / 2 + abs(Q(mid)) * 20 * UNIT


@pytest.mark.parametrize("name", ["uncertain", "three states"])
def test_each_allowance_is_added_where_it_belongs(name: str) -> None:
    """One table's rounding made a billion times larger: the bounds change by that, and the others do not."""
    proof = proof_of(name)
    face = Face(proof, proof.faces[-1])
    rng = np.random.default_rng(8)
    _, t, h, begin, end = map(np.array, zip(*cells_of(proof, 12, rng)))
    t, h, end = t.T, h.T, np.maximum(end, begin)

    def bounds() -> Any:
        return face.bounds(t, h, begin, end)

    def enlarged(columns: Any) -> tuple[Any, np.ndarray]:
        more = columns._replace(errors=columns.errors * 1e9)
        return more, sum(
            (more.errors[k] - columns.errors[k]) * end**k for k in range(len(columns.errors))
        )  # fmt: skip

    before, zero = bounds(), np.zeros(len(end))
    for which in ("_value", "_plain", "_factors", "_lifted"):
        old = getattr(face, which)
        one = old[0][2] if which == "_lifted" else old[0] if which == "_factors" else old
        more, added = enlarged(one)
        listed = {
            "_factors": [more],
            "_lifted": [[*old[0][:2], more, *old[0][3:]]] if which == "_lifted" else more,
        }
        setattr(face, which, listed.get(which, more))
        after = bounds()
        setattr(face, which, old)
        in_r = after.largest - before.largest
        expected = {"rounding": zero, "remainder": zero}
        if which == "_plain":
            expected["rounding"] = added
        elif which == "_lifted":
            slopes = proof.slopes[0]
            others = [i for i in range(proof.n) if i != face.face[0]]
            ray = face.face[1] * slopes[face.face[0]] + slopes[others] @ t
            spread = np.abs(ray) * (end - begin) / 2 + np.abs(slopes[others]) @ h * end
            middle = ray * (begin + end) / 2
            expected["rounding"] = added * np.abs(
                proof.quotients[0].at(middle - spread, middle + spread)[0][2]
            )
        elif which == "_factors":
            expected["remainder"] = added * (before.remainder / sizes(face, t, h, begin, end))
        for part, change in expected.items():
            np.testing.assert_allclose(
                getattr(after, part) - getattr(before, part), change, rtol=1e-3, atol=1e-10
            )
        np.testing.assert_allclose(in_r, sum(expected.values()), rtol=1e-3, atol=1e-9)
        inside = sum(expected.values()) + (before.multiplier * added * end**2 if which == "_value" else 0.0)
        np.testing.assert_allclose(after.largest_inside - before.largest_inside, inside, rtol=1e-3, atol=1e-7)
        value = added if which == "_value" else zero
        np.testing.assert_allclose(
            before.least_value - after.least_value, value * begin**2, rtol=1e-3, atol=1e-9
        )
        growth = before.least_growth - after.least_growth
        np.testing.assert_allclose(growth, value * proof.small.degree, rtol=1e-3, atol=1e-9)


def sizes(face: Face, t: np.ndarray, h: np.ndarray, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    """What multiplies a function's remainder."""
    proof = face.proof
    mid, rad = [Q(v) for v in proof.mid], [Q(v) for v in proof.rad]
    found = []
    for i in range(len(end)):
        here = Exact(face.face, t[:, i].tolist(), h[:, i].tolist(), float(begin[i]), float(end[i]))
        factors = [here.rows(proof.parts(p)[0]) for p in proof.exact.factors[0]]
        found.append(here.tails(factors, mid, rad) + sum(absolute(here, factors, mid, rad).values(), Q(0)))
    return np.array([float(v) for v in found])


# The smallest parts ---------------------------------------------------------------------------------------------------
def test_a_cell_is_proved_by_growth_and_one_of_two_bounds_and_finished_beyond_the_level() -> None:
    rows = np.array(list(product((-1.0, 0.0, 1.0), repeat=4))).T
    growth, largest, inside, value = rows
    nothing, form = np.zeros_like(value), CentredForm(*np.zeros((3, 1, 81)))
    bounds = CellEnclosure(
        value, growth, largest, inside, nothing, 0.0, nothing, nothing, nothing, nothing, form
    )
    expected = [
        g > 0 and (one < 0 or other < 0) for g, one, other in zip(growth, largest, inside, strict=True)
    ]
    assert bounds.proved.tolist() == expected
    assert bounds.finished.tolist() == [v > 0 for v in value]
    unknown = np.full_like(value, np.nan)
    for field in ("least_growth", "least_value"):
        assert not (
            replace(bounds, **{field: unknown}).proved & replace(bounds, **{field: unknown}).finished
        ).any()


def test_which_functions_are_odd_about_their_offset() -> None:
    for halves in range(-4, 5):
        assert _is_odd(Function("sin", (1.0,), 0.0, halves)) == (halves % 2 == 0)
        assert _is_odd(Function("cos", (1.0,), 0.0, halves)) == (halves % 2 == 1)
        for name in ("tanh", "arctan"):
            assert _is_odd(Function(name, (1.0,), 0.0, halves)) == (halves == 0)
        for name in ("exp", "log"):
            assert not _is_odd(Function(name, (1.0,), 0.0, halves))
        assert not _is_odd(Function("sin", (1.0,), 1e-9, halves))


def test_every_direction_is_on_a_face_that_is_looked_at() -> None:
    """Half of the faces, where V, r and all functions are odd or even alike; else both sides of each."""
    sine, exponential = upright().functions[0], Function("exp", (0.1, 0.0))
    fall = upright().drift[1]
    half, whole = [(0, 1), (1, 1)], [(0, 1), (0, -1), (1, 1), (1, -1)]
    assert Proof(upright()).faces == half
    assert sorted(Proof(upright(functions=(exponential,))).faces) == sorted(whole)
    both = upright(
        functions=(sine, exponential), drift=(upright().drift[0], (*fall, Term(1e-13, (0, 0), (), 1)))
    )
    assert sorted(Proof(both).faces) == sorted(whole)
    assert sorted(Proof(upright((*V_2, ((3, 0), 1.0)))).faces) == sorted(whole)
    assert sorted(Proof(three_states()).faces) == [(0, 1), (1, 1), (2, 1)]


def test_what_is_nearly_even() -> None:
    context = fmpq_mpoly_ctx.get(["a", "b"])
    for reach in (0.5, 2.0):
        for share in (0.99e-9, 1.01e-9):
            even = context.from_dict({(2, 0): fmpq(3), (1, 3): fmpq(-2)})
            size = 3 * reach**2 + 2 * reach**4
            odd = context.from_dict({(2, 1): as_rational(-share * size / reach**3)})
            assert _nearly_even(even + odd, reach) == (share < 1e-9)
    assert _nearly_even(even, 1.0)
    assert not _nearly_even(odd, 1.0)
    assert _nearly_even(context.constant(0), 1.0)


@pytest.mark.parametrize(
    ("n", "degree", "components", "functions"), [(1, 2, 1, 0), (5, 4, 300, 0), (2, 30, 1, 0), (5, 12, 1, 8)]
)
def test_k_counts_every_rounding_of_section_6(n: int, degree: int, components: int, functions: int) -> None:
    """2 + 2(M + 1) per function, 2nd, 6d, one per component and one per row; twice, and a little more."""
    rows = sum(comb(k + n - 1, n - 1) for k in range(2, degree + 1))
    table: Any = SimpleNamespace(n=n, degree=degree, k=range(rows))
    counted = 2 + 2 * (ORDER + 1) * functions + 2 * n * degree + 6 * degree + components + rows
    assert 2 * counted <= _roundings(table, components, functions) <= 2 * counted + 200


def test_a_table_has_a_row_for_each_degree_and_monomial() -> None:
    for n, degree in ((1, 4), (2, 5), (3, 4)):
        table = TaylorTable(n, degree, 4)
        assert len(table.k) == sum(comb(k + n - 1, n - 1) for k in range(2, degree + 1))


def test_nothing_is_known_beyond_the_reach_and_everything_within(monkeypatch: pytest.MonkeyPatch) -> None:
    """The quotients' tables hold every ℓᵀTz with |z_i| ≤ reach."""
    for name in ("degree 4", "three states", "exp"):
        proof = proof_of(name)
        for slopes, quotient in zip(proof.slopes, proof.quotients, strict=True):
            most = proof.claim.reach * np.abs(slopes).sum()
            _, rest = quotient.at(np.array([-most, most]), np.array([-most, most]))
            assert np.isfinite(rest).all()


@pytest.mark.parametrize(("n", "degree"), [(1, 5), (2, 6), (3, 5), (4, 4), (5, 3)])
def test_a_table_bounds_a_polynomial_of_any_number_of_states(n: int, degree: int) -> None:
    """(7) to (10), for two components of the parameters, against rationals."""
    rng = np.random.default_rng(n)
    context = fmpq_mpoly_ctx.get([f"z{i}" for i in range(n)])
    every = [e for e in product(range(degree + 1), repeat=n) if 2 <= sum(e) <= degree]
    polynomials = [
        context.from_dict({e: fmpq(int(rng.integers(-9, 10)), 4) for e in every if rng.uniform() < 0.5})
        for _ in range(2)
    ]
    table, face = TaylorTable(n, degree, max(degree - 1, 3)), (int(rng.integers(n)), -1)
    h = np.exp2(-rng.integers(0, 4, (n - 1, 4)).astype(float))
    t = np.round(rng.uniform(-1, 1, (n - 1, 4)) * (1 / h - 1)) * h
    begin, end = np.array([0.0, 0.25, 0.5, 0.75]), np.array([0.5, 0.375, 1.0, 1.25])
    columns = np.stack([table.fill(p, *face) for p in polynomials], 1)[..., None].repeat(4, 2)
    mid, rad = np.array([1.5, -0.5]), np.array([0.25, 0.5])
    form, centre = table.on_interval(table.shifted(columns, t, h), _interval(begin, end), (mid, rad))
    for i in range(4):
        here = Exact(face, t[:, i].tolist(), h[:, i].tolist(), float(begin[i]), float(end[i]))
        rows = [here.rows(p) for p in polynomials]
        low, spread = combined(here, rows, [Q(v) for v in mid], [Q(v) for v in rad])
        zero = (0, (0,) * (n - 1))
        about = [float(here.low(one).get(zero, Q(0))) for one in rows]
        assert centre[:, i] == pytest.approx(about, abs=1e-12)
        constant = low.pop(zero, Q(0)) + spread.pop(zero, Q(0))
        tails = here.tails(rows, [Q(v) for v in mid], [Q(v) for v in rad])
        expected = upper(n, low, spread, tails, constant)
        one = CentredForm(*(part[:, [i]] for part in form))
        assert float(table.upper(one)[0]) == pytest.approx(float(expected), rel=1e-11)
        without = float(table.upper(one, np.zeros(1))[0])
        assert without == pytest.approx(float(expected - constant), rel=1e-11)
