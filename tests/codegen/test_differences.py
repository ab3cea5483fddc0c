"""Differences of traced functions against numbers of 60 digits."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest

from flexhinf.codegen.differences import difference
from flexhinf.scalars import apply, clip, sign, trace, where

#: A function of a library of functions and (x, p), and where it is evaluated.
SMOOTH = {
    "arithmetic": (lambda m, x, p: x[0] * x[1] / (p[0] + x[0]) - 3.0 * x[1] ** 2 + 2.0 / x[1], (1e3, 2.0)),
    "sin": (lambda m, x, p: m.sin(x[0]) * p[0] + m.cos(x[0] * x[1]), (0.7, 1e2)),
    "sqrt": (lambda m, x, p: m.sqrt(x[0] * x[0] + x[1]), (1.0, 5.0)),
    "exp": (lambda m, x, p: m.exp(-p[0] * x[0]) + m.exp(x[1]), (2.0, -0.5)),
    "tanh": (lambda m, x, p: m.tanh(x[0] / p[0]) * x[1], (0.3, 1e4)),
    "arctan": (lambda m, x, p: m.arctan(x[0]) + x[1], (4.0, 0.0)),
    "arctan2": (lambda m, x, p: m.arctan2(x[0], x[1]), (2.0, -1.0)),
    "tan": (lambda m, x, p: m.tan(x[0]) * x[1], (1.0, 1.0)),
}  # fmt: skip


class Digits:
    """mpmath's functions under NumPy's names."""

    sin, cos, tan, tanh = mpmath.sin, mpmath.cos, mpmath.tan, mpmath.tanh
    sqrt, exp, arctan, arctan2 = mpmath.sqrt, mpmath.exp, mpmath.atan, mpmath.atan2


@pytest.mark.oracle
@pytest.mark.parametrize("size", [1e-14, 1e-9, 1e-3])
@pytest.mark.parametrize("name", SMOOTH)
def test_a_small_difference_keeps_its_digits(name, size):
    function, x = SMOOTH[name]
    x, d, p = np.array(x), size * np.array([1.0, -0.7]), np.array([1.5])
    apart = difference(trace(lambda x, p: np.array([function(np, x, p)]), 2, 1))
    found = apply(apart, x, d, p)[0][0]
    with mpmath.workdps(60):
        ends = [
            [mpmath.mpf(a) + step * mpmath.mpf(b) for a, b in zip(x.tolist(), d.tolist())] for step in (0, 1)
        ]
        first, second = (function(Digits, end, [mpmath.mpf(1.5)]) for end in ends)
        expected = float(second - first)
    bound = 1e-13 if name != "tan" else 1e-15 / size + 1e-13  # without a rule of its own
    assert abs(found - expected) <= bound * abs(expected) * 10.0


@pytest.mark.oracle
@pytest.mark.parametrize(
    "function",
    [
        lambda x: np.abs(x), lambda x: np.floor(x), sign, lambda x: clip(x, -0.2, 0.2),
        lambda x: where(x > 0.1, x * x, -3.0 * x), lambda x: np.sqrt(np.abs(x)),
    ],
)  # fmt: skip
def test_over_a_corner_it_is_the_difference_of_the_values(function):
    traced, rng = trace(lambda x: np.array([function(x[0])]), 1), np.random.default_rng(1)
    apart = difference(traced)
    for x, d in [*rng.normal(size=(50, 2)), (0.0, 0.0), (0.1, 0.0)]:
        expected = float(function(np.float64(x + d))) - float(function(np.float64(x)))
        assert apply(apart, [x], [d])[0][0] == pytest.approx(expected, abs=1e-14)


def test_an_angle_does_not_jump():
    """From 179 to 181 degrees arctan2 jumps back by a turn, the difference goes on by two degrees."""
    apart = difference(trace(lambda x: np.array([np.arctan2(x[1], x[0])]), 2))
    ends = np.deg2rad([179.0, 181.0])
    first, second = np.array([np.cos(ends), np.sin(ends)]).T
    assert apply(apart, first, second - first)[0][0] == pytest.approx(np.deg2rad(2.0), rel=1e-12)


def test_what_does_not_move_has_no_difference():
    apart = difference(trace(lambda x, p: np.array([np.sin(p[0]) * p[1], x[0]]), 1, 2))
    np.testing.assert_array_equal(apply(apart, [1.0], [0.5], [2.0, 3.0])[0], [0.0, 0.5])


def test_where_a_function_is_nan_its_difference_is():
    """sqrt of a negative number: a sigma point at which a model has no value must not count as a finite one."""
    apart = difference(trace(lambda x: np.array([np.sqrt(x[0])]), 1))
    for x, d, finite in ((1.0, -2.0, False), (-1.0, 2.0, False), (-1.0, 0.5, False), (0.0, 0.0, True)):
        found = apply(apart, np.array([x]), np.array([d]))[0][0]
        assert np.isfinite(found) == finite, (x, d)
