"""What bounds add for remainders and rounding, each against its own formula: none is smaller, none much larger."""

from __future__ import annotations

from fractions import Fraction
from functools import cache
from importlib import import_module
from itertools import product
from math import ceil, factorial
from typing import Any

import numpy as np
import pytest
from flint import arb, arb_poly, arb_series, ctx, fmpq

from flexhinf.certify import Function, inequality as quotients
from flexhinf.certify.checker.bounds import GRID, ORDER, Quotient
from flexhinf.certify.checker.residual import as_rational, offset_of, quotient_range, series_of
from flexhinf.certify.inequality import MeanForms, QuotientTable

quadratic = import_module("flexhinf.certify.checker.residual")

pytestmark = pytest.mark.oracle

Q = Fraction
FUNCTIONS = {
    "sine": Function("sin", (1.0,), 0.3, 1),
    "sine upright": Function("sin", (1.0,), 0.0, 2),
    "exp": Function("exp", (1.0,), 0.25),
    "exp falling": Function("exp", (1.0,), -2.0),
    "tanh": Function("tanh", (1.0,), 0.4),
    "log": Function("log", (1.0,), 5.0),
}


@cache
def quotient(name: str) -> Quotient:
    with ctx.workprec(128):
        return Quotient(FUNCTIONS[name], 1.25)


def taylor(function: Function, s: Fraction) -> list[arb]:
    """The Taylor polynomial of S of degree M about s, in powers of ℓ, by a division of polynomials."""
    about = arb(fmpq(s.numerator, s.denominator))
    argument = arb_series([offset_of(function) + about, 1], prec=ORDER + 2)
    series = [series_of(function.name, argument)[k] for k in range(ORDER + 2)]
    if s == 0:
        local = series[1:]
    else:
        left = series[0] - series_of(function.name, arb_series([offset_of(function)], prec=1))[0]
        local = [left / about]
        for k in range(1, ORDER + 1):  # (s + ε) S(s + ε) = φ(o + s + ε) − φ(o)
            local.append((series[k] - local[-1]) / about)
    moved = arb_poly(local)(arb_poly([-about, 1]))
    return [moved[k] for k in range(ORDER + 1)]


@pytest.mark.parametrize("name", FUNCTIONS)
def test_rounding_of_coefficients_is_bounded_and_nothing_more(name: str) -> None:
    """Σ |a_m − its double| (|s| + 1)^m at every node: what the polynomial may miss within one of it."""
    function, known = FUNCTIONS[name], quotient(name)
    count = len(known._error) // 2
    assert len(known._error) == len(known._remainder) == len(known._coefficients) == 2 * count + 1
    assert count == ceil(1.25 * GRID) + 1
    with ctx.workprec(400):
        for i in range(-count, count + 1):
            s = Q(i, GRID)
            missed = arb(0)
            for m, exact in enumerate(taylor(function, s)):
                double = float(known._coefficients[count + i, m])
                missed += abs(exact - arb(double)) * arb(float(abs(s) + 1)) ** m
            stated = arb(float(known._error[count + i]))
            assert stated >= missed
            assert stated <= missed * (1 + arb(2) ** -30) + arb(2) ** -110
            assert stated < 1e-11


@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_remainder_s_constant_is_the_largest_derivative_so_far(name: str) -> None:
    """max |φ^(M+2)/(M+2)!| between 0 and a step of the grid beyond each node."""
    function, known = FUNCTIONS[name], quotient(name)
    count = len(known._error) // 2
    with ctx.workprec(200):
        for side in (1, -1):
            largest = 0.0
            for i in range(count + 1):
                for step in (-1, -0.5, 0, 0.5, 1):
                    at = offset_of(function) + arb(side * (i + step) / GRID)
                    derivative = abs(series_of(function.name, arb_series([at, 1], prec=ORDER + 3))[ORDER + 2])
                    largest = max(largest, float(derivative.lower()))
                stated = known._remainder[count + side * i]
                assert largest <= stated
                if function.name != "tanh":  # a quotient of balls is much wider
                    assert stated <= 1.2 * largest + 1e-3 / factorial(ORDER + 2)


@pytest.mark.parametrize("only", ["as it is", "remainder", "rounding"])
def test_what_a_polynomial_leaves_is_both_terms_of_its_bound(only: str, monkeypatch: Any) -> None:
    known, rng = quotient("sine"), np.random.default_rng(3)
    count = len(known._error) // 2
    if only == "rounding":
        monkeypatch.setattr(known, "_remainder", np.zeros(2 * count + 1))
        monkeypatch.setattr(known, "_error", rng.uniform(0.5, 1.0, 2 * count + 1))
    elif only == "remainder":
        monkeypatch.setattr(known, "_error", np.zeros(2 * count + 1))
        monkeypatch.setattr(known, "_remainder", rng.uniform(0.5, 1.0, 2 * count + 1))
    half = 2.0 ** rng.uniform(-30.0, 0.0, 200)
    middle = rng.uniform(-1.0, 1.0, 200) * (1.25 - half)
    half[:20] = rng.uniform(1.0, 1.2, 20)
    middle[:20] = rng.uniform(-1.0, 1.0, 20) * (1.25 - half[:20])
    low, high = middle - half, middle + half
    coefficients, rest = known.at(low, high)
    for i, (a, b) in enumerate(zip(map(Q, low.tolist()), map(Q, high.tolist()), strict=True)):
        node = round(float((a + b) / 2 * GRID))
        np.testing.assert_array_equal(coefficients[:, i], known._coefficients[count + node])
        width = max(b - Q(node, GRID), Q(node, GRID) - a)
        far = min(ceil(max(abs(a), abs(b)) * GRID), count)
        constant = max(Q(float(known._remainder[count + far])), Q(float(known._remainder[count - far])))
        exact = constant * width ** (ORDER + 1)
        exact += Q(float(known._error[count + node])) * max(width, Q(1)) ** ORDER
        assert exact <= Q(float(rest[i])) <= exact * (1 + Q(1, 10**10))


# Ranges of quotients ----------------------------------------------------------------------------------------------
@pytest.mark.quick_cases(6)
@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize("farthest", [0.3, 1.25])
def test_a_range_holds_what_is_shown_on_each_piece(name: str, farthest: float, monkeypatch: Any) -> None:
    """|S(s) − S(m)| ≤ w max |φ″|/2 on pieces of half width w: the range holds that, and not twice as much.

    Without the piece more that is looked at beyond the end, which hides what the last one lacks.
    """
    monkeypatch.setattr(quadratic, "ceil", lambda v: ceil(v) - 1)
    function, pieces = FUNCTIONS[name], 512
    with ctx.workprec(128):
        found = quotient_range(function, as_rational(farthest) ** 2)
        assert found is not None
        offset, half = offset_of(function), Q(1, 2 * pieces)
        start = series_of(function.name, arb_series([offset], prec=1))[0]
        lowest, highest, first, last = [], [], [], []
        for side in (1, -1):
            bend = 0.0
            for i in range(ceil(farthest * pieces)):
                middle = arb(side * (2 * i + 1)) / (2 * pieces)
                for at in (middle - float(half), middle, middle + float(half)):
                    curved = series_of(function.name, arb_series([offset + at, 1], prec=3))[2]
                    bend = max(bend, float(abs(curved).lower()))
                value = (series_of(function.name, arb_series([offset + middle], prec=1))[0] - start) / middle
                lowest.append(float(value.lower()) - bend * float(half))
                highest.append(float(value.upper()) + bend * float(half))
                first.append(float(value))
                last.append(bend)
    low, high = (float(end.p) / float(end.q) for end in found)
    assert low <= min(lowest) + 1e-14
    assert high >= max(highest) - 1e-14
    room = 4.0 * float(half) * max(last) + 1e-9
    assert low >= min(first) - 1.1 * room
    assert high <= max(first) + 1.1 * room


# Enclosures of many polynomials -----------------------------------------------------------------------------------
def derived(polynomial: dict[tuple[int, ...], Fraction], axis: int) -> dict[tuple[int, ...], Fraction]:
    moved = {}
    for e, c in polynomial.items():
        if e[axis]:
            moved[tuple(v - (i == axis) for i, v in enumerate(e))] = c * e[axis]
    return moved


def valued(polynomial: dict[tuple[int, ...], Fraction], at: list[Fraction]) -> Fraction:
    total = Q(0)
    for e, c in polynomial.items():
        for w, power in zip(at, e, strict=True):
            c *= w**power
        total += c
    return total


@pytest.mark.parametrize("n", [1, 2, 3])
def test_mean_value_forms_are_taylor_s_formula(n: int) -> None:
    """Value, slopes and ½ Σ H_ij h_i h_j of q/ρ on cells of every face, in rationals."""
    rng = np.random.default_rng(n)
    polynomials = []
    for highest in (1, 3, 4):
        powers = [e for e in product(range(highest + 1), repeat=n) if 1 <= sum(e) <= highest]
        polynomials.append({e: fmpq(int(rng.integers(-30, 31)), 8) for e in powers if rng.uniform() < 0.8})
    polynomials.append({tuple(int(i == 0) for i in range(n)): fmpq(3, 2)})
    forms = MeanForms(n, polynomials)
    count = 24
    face = rng.integers(0, 2 * n, count)
    face[: 2 * n] = np.arange(2 * n)
    middle = np.vstack([rng.uniform(0.1, 2.0, count), rng.uniform(-1.0, 1.0, (n - 1, count))])
    half = 2.0 ** rng.uniform(-8.0, -1.0, (n, count))
    value, slopes, rest = forms.enclose(face, middle, half)
    assert value.shape == rest.shape == (4, count)
    assert slopes.shape == (4, n, count)
    for k in range(count):
        f, sign = int(face[k]) // 2, 1 - 2 * (int(face[k]) % 2)
        at, h = [Q(v) for v in middle[:, k]], [Q(v) for v in half[:, k]]
        beyond = [abs(m) + w for m, w in zip(at, h, strict=True)]
        for j, q in enumerate(polynomials):
            on_face: dict[tuple[int, ...], Fraction] = {}
            for e, c in q.items():
                row = (sum(e) - 1, *e[:f], *e[f + 1 :])
                on_face[row] = on_face.get(row, Q(0)) + Q(int(c.p), int(c.q)) * sign ** e[f]
            sizes = {e: abs(c) for e, c in on_face.items()}
            size = valued(sizes, beyond) + Q(1, 10**30)
            assert abs(Q(value[j, k]) - valued(on_face, at)) <= size * Q(1, 10**13)
            bend = Q(0)
            for i in range(n):
                slope = derived(on_face, i)
                expected = valued(slope, at) * h[i]
                assert abs(Q(slopes[j, i, k]) - expected) <= size * Q(1, 10**12) * 16
                for l in range(n):
                    again = {e: abs(c) for e, c in derived(slope, l).items()}
                    bend += valued(again, beyond) * h[i] * h[l] / 2
            allowance = Q(1, 10**12) * (size + sum(abs(Q(slopes[j, i, k])) for i in range(n)) + bend)
            assert bend + allowance * Q(99, 100) <= Q(rest[j, k]) <= bend + allowance * Q(101, 100)


# The search's tables of quotients ---------------------------------------------------------------------------------
@pytest.mark.parametrize("order", [0, 3])
@pytest.mark.parametrize("name", FUNCTIONS)
def test_rows_of_the_search_are_taylor_polynomials_and_its_constants_bound_derivatives(
    name: str, order: int
) -> None:
    function, reach = FUNCTIONS[name], 1.25
    table = QuotientTable(function, reach, order)
    count = ceil(reach * 64) + 1
    assert table.rows.shape == (2 * count + 1, order + 1)
    with ctx.workprec(400):
        for i in (-count, -40, -1, 0, 1, 17, count):
            about = arb(i) / 64
            argument = arb_series([offset_of(function) + about, 1], prec=order + 2)
            series = [series_of(function.name, argument)[k] for k in range(order + 2)]
            local = series[1:]
            if i:
                start = series_of(function.name, arb_series([offset_of(function)], prec=1))[0]
                local = [(series[0] - start) / about]
                for k in range(1, order + 1):
                    local.append((series[k] - local[-1]) / about)
            moved = arb_poly(local)(arb_poly([-about, 1]))
            for m in range(order + 1):
                exact = float(moved[m])
                assert table.rows[count + i, m] == pytest.approx(exact, rel=2.0**-52, abs=2.0**-150)
        for side, stated in ((1, table.above), (-1, table.below)):
            assert len(stated) >= reach * 8 + 1
            largest = 0.0
            for i, bound in enumerate(stated.tolist()):
                for step in (0.0, 0.5, 1.0):
                    at = offset_of(function) + arb(side * (i + step) / 8)
                    derivative = series_of(function.name, arb_series([at, 1], prec=order + 3))[order + 2]
                    largest = max(largest, float(abs(derivative)))
                assert largest * (1 + 1e-13) <= bound
                if function.name != "tanh":
                    assert bound <= 1.6 * largest + 1e-3
        slopes = [
            float(series_of(function.name, arb_series([offset_of(function) + arb(s), 1], prec=2))[1])
            for s in np.linspace(-reach, reach, 101)
        ]
        assert max(map(abs, slopes)) <= table.largest


def test_an_enclosure_is_its_row_and_its_remainder_or_nothing() -> None:
    """|e| ≤ C |ℓ − a|^(M+1), C of both sides; unknown beyond the table, and where a row or a bound is not finite."""
    rng = np.random.default_rng(9)
    rows = rng.uniform(-1.0, 1.0, (2 * 81 + 1, 3))
    above, below = np.cumsum(rng.uniform(0.1, 1.0, (2, 12)), axis=1)
    rows[20, 1], above[9], below[8] = np.nan, np.inf, np.nan
    table = QuotientTable(FUNCTIONS["sine"], 0.0, 2)
    table.rows, table.above, table.below = rows, above, below
    half = np.r_[0.0, 2.0 ** rng.uniform(-20.0, -1.0, 299)]
    middle = rng.uniform(-1.6, 1.6, 300)
    middle[1:30] = rng.integers(-100, 101, 29) / 64
    half[30:70] = rng.uniform(0.2, 0.5, 40)  # from nodes of the table to beyond its bounds
    middle[30:70] = rng.choice([-1.0, 1.0], 40) * rng.uniform(0.9, 1.26, 40)
    low, high = middle - half, middle + half
    found, error = table.enclose(low, high)
    seen = 0
    for i, (a, b) in enumerate(zip(map(Q, low.tolist()), map(Q, high.tolist()), strict=True)):
        node = round(float((a + b) * 32))
        sides = [max(ceil(b * 8) - 1, 0), max(ceil(-a * 8) - 1, 0)]
        constants = [t[s] if s < len(t) else np.inf for t, s in zip((above, below), sides, strict=True)]
        if abs(node) > 81 or not np.isfinite(constants).all() or node == 20 - 81:
            assert error[i] == np.inf
            assert not found[i].any()
            continue
        seen += 1
        np.testing.assert_array_equal(found[i], rows[node + 81])
        exact = Q(max(constants)) * max(b - Q(node, 64), Q(node, 64) - a) ** 3
        assert exact <= Q(error[i]) <= exact * (1 + Q(1, 10**10))
    assert seen > 150


def test_a_row_that_is_not_known_to_sixty_bits_is_not_used(monkeypatch: Any) -> None:
    monkeypatch.setattr(quotients, "_BITS", 24)
    table = QuotientTable(FUNCTIONS["sine"], 1.25, 3)
    assert np.isnan(table.rows).any(axis=1).all()
    assert np.isinf(table.enclose(np.array([0.1]), np.array([0.2]))[1]).all()
