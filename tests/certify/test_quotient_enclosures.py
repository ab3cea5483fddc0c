"""Enclosures of S(s) = (φ(o + s) − φ(o))/s against mpmath with 60 digits: both tables, the second route, the ranges.

Each polynomial is evaluated in rationals of its doubles, so an order too few, a remainder too small or a bound of the
wrong interval is not hidden by rounding.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import mpmath
import numpy as np
import pytest
from flint import arb, arb_series, ctx, fmpq

from flexhinf.certify.checker import second_route
from flexhinf.certify.checker.bounds import ORDER, Quotient
from flexhinf.certify.checker.residual import as_rational, quotient_range, series_of
from flexhinf.certify.claim import Function
from flexhinf.certify.inequality import QuotientTable

REACH = 3.0
PHI = {"sin": mpmath.sin, "cos": mpmath.cos, "exp": mpmath.exp, "tanh": mpmath.tanh, "arctan": mpmath.atan}
PHI["log"] = mpmath.log
FUNCTIONS = {
    "sine": Function("sin", (1.0,)),
    "sine upright": Function("sin", (1.0,), 0.0, 2),
    "sine elsewhere": Function("sin", (1.0,), 0.3, 1),
    "cosine": Function("cos", (1.0,), -0.7, 0),
    "exp": Function("exp", (1.0,), -0.5),
    "tanh": Function("tanh", (1.0,)),
    "tanh elsewhere": Function("tanh", (1.0,), 0.4),
    "arctan": Function("arctan", (1.0,), 1.0),
    "log": Function("log", (1.0,), 7.0),
    "log near its pole": Function("log", (1.0,), 3.5),
}
ORDERS = (0, 1, 2, 3, 5, 8)
pytestmark = [pytest.mark.oracle, pytest.mark.property]


@pytest.fixture(autouse=True)
def digits() -> Any:
    with mpmath.workdps(60), ctx.workprec(256):
        yield


def _offset(function: Function) -> Any:
    return mpmath.mpf(function.offset) + function.pi_halves * mpmath.pi / 2


def _exact(function: Function, s: float) -> Any:
    """S(s); by its limit at 0."""
    phi, o = PHI[function.name], _offset(function)
    if s == 0.0:
        return mpmath.diff(phi, o)
    return (phi(o + mpmath.mpf(s)) - phi(o)) / mpmath.mpf(s)


def _derivative(function: Function, at: float, order: int) -> Any:
    """|Φ^(order)(at)|/order!, from a power series about this one point."""
    about = arb(function.offset) + arb.pi() * function.pi_halves / 2 + arb(at)
    series = series_of(function.name, arb_series([about, 1], prec=order + 1))
    return mpmath.mpf(abs(series[order]).mid().str(50, radius=False))


def _missed(function: Function, coefficients: Any, s: float) -> tuple[Any, Any]:
    """|S(s) − Σ a_m s^m|, and what one rounding of each a_m may have changed."""
    powers = [mpmath.mpf(s) ** m for m in range(len(coefficients))]
    terms = [mpmath.mpf(float(a)) * power for a, power in zip(coefficients, powers, strict=True)]
    rounding = (
        mpmath.mpf(2) ** -53 * sum(map(abs, terms)) * (1 + mpmath.mpf(10) ** -9) + mpmath.mpf(2) ** -159
    )
    return abs(_exact(function, s) - sum(terms)), rounding


@cache
def intervals() -> np.ndarray:
    """Pairs (low, high): of all widths, wherever the reach allows; about 0, about nodes and from piece to piece."""
    rng = np.random.default_rng(11)
    half = 2.0 ** rng.uniform(-9.0, 0.5, 60)
    half[:6] = 0.5, 0.25, 1.4, 1 / 128, 1e-4, 1e-9
    middle = rng.uniform(-1.0, 1.0, 60) * (REACH - half)
    middle[6:16] = rng.integers(-150, 151, 10) / 64.0 * (1 - half[6:16] / REACH)
    middle[:3] = 0.0
    middle[16:24] = 2.0 ** rng.uniform(-30.0, -3.0, 8) * rng.choice([-1.0, 1.0], 8)
    pairs = np.stack([middle - half, middle + half], axis=1)
    pairs[24:30] = np.array([k / 8.0 + np.array([-0.01, 0.0]) for k in (1, 2, 5, 11, 16, 23)])
    pairs[30:36] = -pairs[24:30, ::-1]
    pairs[36:42, 1] = np.nextafter(pairs[24:30, 1], np.inf)
    pairs[36:42, 0] = pairs[24:30, 0]
    return np.clip(pairs, -REACH, REACH)


def points(low: float, high: float) -> list[float]:
    inside = np.random.default_rng(0).uniform(low, high, 3).tolist()
    return [low, high, (low + high) / 2, *inside, *([0.0] if low <= 0.0 <= high else [])]


@cache
def table(name: str, order: int) -> QuotientTable:
    return QuotientTable(FUNCTIONS[name], REACH, order)


@pytest.mark.quick_cases(3)
@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("name", FUNCTIONS)
def test_no_point_leaves_an_enclosure_of_the_search(name: str, order: int) -> None:
    function, needed = FUNCTIONS[name], 0.0
    low, high = intervals().T
    rows, error = table(name, order).enclose(low, high)
    assert np.isfinite(error).all()
    for a, b, row, bound in zip(low.tolist(), high.tolist(), rows, error.tolist(), strict=True):
        for s in points(a, b):
            missed, rounding = _missed(function, row, s)
            assert missed <= bound + rounding, (a, b, s)
            if bound > 1e6 * rounding:
                needed = max(needed, float(missed / bound))
    assert needed > (0.01 if order < 3 else 1e-5)  # the bound is not idle


@pytest.mark.quick_cases(10)
@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_remainder_of_the_search_bounds_the_derivative_as_far_as_the_interval(
    name: str, order: int
) -> None:
    """error ≥ |Φ^(M+2)/(M+2)!| |s − node|^(M+1) at each point between 0 and the interval, which proves what holds for
    all functions with these derivatives, and not only for these six."""
    function = FUNCTIONS[name]
    low, high = intervals().T
    _, error = table(name, order).enclose(low, high)
    for a, b, bound in zip(low.tolist(), high.tolist(), error.tolist(), strict=True):
        node = mpmath.mpf(round((a + b) / 2 * 64)) / 64
        farthest = max(abs(mpmath.mpf(a) - node), abs(mpmath.mpf(b) - node)) ** (order + 1)
        for at in {0.0, a, b, a / 2, b / 2}:
            derivative = _derivative(function, at, order + 2)
            assert bound >= derivative * farthest, (a, b, at)


@pytest.mark.quick_cases(5)
@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_search_knows_nothing_beyond_its_table_and_bounds_s_within(name: str) -> None:
    function, known = FUNCTIONS[name], table(name, 3)
    far = np.linspace(0.0, 2.0 * REACH, 60)
    for side in (1.0, -1.0):
        low, high = np.sort(np.stack([side * far, side * (far + 0.02)]), axis=0)
        rows, error = known.enclose(low, high)
        assert np.isinf(error[np.abs(low + high) / 2 > REACH + 0.3]).all()
        for a, b, row, bound in zip(low.tolist(), high.tolist(), rows, error.tolist(), strict=True):
            if np.isfinite(bound):
                missed, rounding = _missed(function, row, a)
                assert missed <= bound + rounding
                assert max(abs(_exact(function, a)), abs(_exact(function, b))) <= known.largest


@pytest.mark.quick_cases(3)
@pytest.mark.parametrize("name", FUNCTIONS)
def test_no_point_leaves_an_enclosure_of_the_checker(name: str) -> None:
    """Its bounds hold the rounding of the coefficients too."""
    function, needed = FUNCTIONS[name], 0.0
    low, high = intervals().T
    coefficients, rest = Quotient(function, REACH).at(low, high)
    assert np.isfinite(rest).all()
    for a, b, row, bound in zip(low.tolist(), high.tolist(), coefficients.T, rest.tolist(), strict=True):
        node = mpmath.mpf(round((a + b) / 2 * 64)) / 64
        farthest = max(abs(mpmath.mpf(a) - node), abs(mpmath.mpf(b) - node)) ** (ORDER + 1)
        for s in points(a, b):
            missed, rounding = _missed(function, row, s)
            assert missed <= bound, (a, b, s)
            if bound > 1e6 * rounding:
                needed = max(needed, float(missed / bound))
        for at in {0.0, a, b, a / 2, b / 2}:
            derivative = _derivative(function, at, ORDER + 2)
            assert bound >= derivative * farthest, (a, b, at)
    assert needed > 0.01


@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_checker_knows_nothing_beyond_its_table(name: str) -> None:
    function, known = FUNCTIONS[name], Quotient(FUNCTIONS[name], 1.0)
    far = np.linspace(0.5, 2.0 * REACH, 40)
    for side in (1.0, -1.0):
        low, high = np.sort(np.stack([side * far, side * (far + 0.02)]), axis=0)
        coefficients, rest = known.at(low, high)
        assert np.isinf(rest[far > 1.05]).all()
        assert np.isfinite(rest[far < 0.95]).all()
        for a, row, bound in zip(low.tolist(), coefficients.T, rest.tolist(), strict=True):
            assert bound == np.inf or _missed(function, row, a)[0] <= bound


@pytest.mark.parametrize("order", [0, 4])
def test_near_a_pole_bounds_hold_and_from_there_on_nothing_is_known(order: int) -> None:
    """log(2 + s): up to s = −2, and beyond."""
    function = Function("log", (1.0,), 2.0)
    low = np.linspace(-2.6, -1.0, 161)
    high = low + 0.04
    tables = (
        QuotientTable(function, REACH, order).enclose(low, high),
        Quotient(function, REACH).at(low, high),
    )
    for rows, error in ((tables[0]), (tables[1][0].T, tables[1][1])):
        assert np.isinf(error[low <= -2.0]).all()
        assert np.isfinite(error[low >= -1.7]).all()
        for a, row, bound in zip(low.tolist(), rows, error.tolist(), strict=True):
            if bound < np.inf:
                missed, rounding = _missed(function, row, a)
                assert missed <= bound + rounding


@pytest.mark.quick_cases(5)
@pytest.mark.parametrize("name", FUNCTIONS)
def test_no_point_leaves_an_enclosure_of_the_second_route(name: str) -> None:
    """About centres of both branches: near 0, where a series over the whole of u stands, and elsewhere."""
    function, rng, needed = FUNCTIONS[name], np.random.default_rng(2), 0.0
    centres = [0.0, 2.0**-20, -(2.0**-20), 2.0**-19, 3e-7, *rng.uniform(-2.0, 2.0, 12).tolist()]
    radii = (2.0 ** rng.uniform(-8.0, 0.0, len(centres))).tolist()
    order = second_route._ORDER
    for center, radius in zip(centres, radii, strict=True):
        values, rest = second_route._taylor(function, as_rational(center), arb(radius))
        bound = mpmath.mpf(float(rest.upper()) * (1 + 1e-15))
        for s in points(center - radius, center + radius):
            total = sum(
                mpmath.mpf(int(q.p)) / int(q.q) * (mpmath.mpf(s) - mpmath.mpf(center)) ** m
                for m, q in enumerate(values)
            )
            missed = abs(_exact(function, s) - total)
            assert missed <= bound, (center, radius, s)
            needed = max(needed, float(missed / bound))
        for at in (0.0, center, center - radius, center + radius):
            derivative = _derivative(function, at, order + 2)
            assert bound >= derivative * mpmath.mpf(radius) ** (order + 1) * (1 - mpmath.mpf(10) ** -15)
    assert needed > 0.01


@pytest.mark.quick_cases(3)
@pytest.mark.parametrize("name", FUNCTIONS)
def test_no_value_of_a_quotient_leaves_its_range(name: str) -> None:
    function = FUNCTIONS[name]
    for farthest in (0.01, 1.0, REACH):
        found = quotient_range(function, as_rational(farthest) ** 2)
        assert found is not None
        low, high = (mpmath.mpf(int(end.p)) / int(end.q) for end in found)
        exact = [_exact(function, s) for s in np.linspace(-farthest, farthest, 41).tolist()]
        assert low <= min(exact)
        assert max(exact) <= high
    assert quotient_range(function, fmpq(10**14)) is None  # farther than is looked
