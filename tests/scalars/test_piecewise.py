from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from tests.refusals import refused_with

from flexhinf import scalars
from flexhinf.errors import InvalidInput
from flexhinf.scalars import absolute, clip, maximum, minimum, sign, symbols, trace, where

VALUES = np.array([-2.0, -1.0, -0.25, 0.0, 0.25, 1.0, 2.0])
OTHERS = np.array([0.5, -1.0, -0.5, 0.0, 0.5, -2.0, 2.0])
CASES = {
    "where": lambda s: s.where(VALUES > OTHERS, VALUES, OTHERS),
    "maximum": lambda s: s.maximum(VALUES, OTHERS),
    "minimum": lambda s: s.minimum(VALUES, OTHERS),
    "sign": lambda s: s.sign(VALUES),
    "absolute": lambda s: s.absolute(VALUES),
    "clip": lambda s: s.clip(VALUES, -0.5, 1.5),
}


def on_symbols(code, *arrays) -> np.ndarray:
    return np.asarray(trace(code, *map(len, arrays))(*arrays), dtype=float).ravel()


@pytest.mark.parametrize("name", CASES)
def test_on_numbers_they_are_numpys(name):
    result = CASES[name](scalars)
    assert result.dtype == float
    np.testing.assert_array_equal(result, CASES[name](np))


@pytest.mark.oracle
def test_on_symbols_they_equal_numpy():
    pairs = [
        (
            lambda x, y: where(np.greater(x, y, dtype=object), x * 2, y),
            np.where(VALUES > OTHERS, VALUES * 2, OTHERS),
        ),
        (lambda x, y: where(np.greater(x, y, dtype=object), 1.0, y), np.where(VALUES > OTHERS, 1.0, OTHERS)),
        (maximum, np.maximum(VALUES, OTHERS)),
        (minimum, np.minimum(VALUES, OTHERS)),
        (lambda x, y: maximum(0.0, x), np.maximum(VALUES, 0.0)),
        (lambda x, y: sign(x), np.sign(VALUES)),
        (lambda x, y: absolute(x), np.abs(VALUES)),
        (lambda x, y: clip(x, -0.5, 1.5), np.clip(VALUES, -0.5, 1.5)),
        (lambda x, y: clip(x, -1.0, absolute(y)), np.clip(VALUES, -1.0, np.abs(OTHERS))),
    ]
    for code, expected in pairs:
        np.testing.assert_array_equal(on_symbols(code, VALUES, OTHERS), expected)


#: What comparisons treat apart.
APART = (np.nan, -np.inf, -1.0, 0.0, 2.0, np.inf)


@pytest.mark.oracle
@pytest.mark.parametrize(("function", "of"), [(maximum, 2), (minimum, 2), (clip, 3)])
def test_on_symbols_they_treat_nan_and_infinity_as_numpy(function, of):
    on_arrays = np.array(list(product(APART, repeat=of))).T
    np.testing.assert_array_equal(
        on_symbols(function, *on_arrays), getattr(np, function.__name__)(*on_arrays)
    )


def test_limits_that_are_numbers_clip_as_numpy():
    for low, high in [(-1.0, 2.0), (2.0, -1.0), (-np.inf, np.inf)]:
        found = on_symbols(lambda x, ends=(low, high): clip(x, *ends), APART)
        np.testing.assert_array_equal(found, np.clip(APART, low, high))


def test_scalars_and_mixed_arrays():
    assert maximum(1.0, 2.0) == 2.0
    [x] = symbols("x", 1)
    mixed = np.array([x, -3.0], dtype=object)
    result = absolute(mixed)
    assert result[1] == 3.0
    np.testing.assert_array_equal(on_symbols(lambda v: clip(np.array([v[0], -3.0]), -1, 1), [0.5]), [0.5, -1])
    np.testing.assert_array_equal(on_symbols(lambda v: absolute(v[0]), [-0.5]), [0.5])


def test_they_broadcast_over_symbols():
    result = on_symbols(lambda x: where(np.array([True, False]), x, np.zeros(2)), [3.0, 4.0])
    np.testing.assert_array_equal(result, [3.0, 0.0])


class Interval:
    """An element with an answer of its own to one of the functions."""

    def __init__(self, low: float, high: float) -> None:
        self.low, self.high = low, high

    @staticmethod
    def piecewise_maximum(a, b):
        low, high = (b, b) if isinstance(b, float) else (b.low, b.high)
        return Interval(max(a.low, low), max(a.high, high))


def test_an_element_may_bring_its_own_answer():
    result = maximum(Interval(-1.0, 2.0), 0.5)
    assert (result.low, result.high) == (0.5, 2.0)


@pytest.mark.parametrize(
    ("function", "arguments"),
    [(where, (1,)), (minimum, ()), (sign, None), (absolute, None), (clip, (0.0,))],
)
def test_an_element_without_an_answer_is_refused_by_name(function, arguments):
    interval = Interval(0.0, 1.0)
    arguments = (interval,) if arguments is None else (*arguments, interval, interval)
    if function is clip:
        arguments = (interval, 0.0, 1.0)
    with pytest.raises(InvalidInput) as caught:
        function(*arguments)
    assert function.__name__ in caught.value.what
    assert "Interval" in caught.value.found
    assert caught.value.advice


def test_a_symbol_beside_a_stranger_is_refused():
    with refused_with(InvalidInput, "minimum", "smooth", "Interval"):
        minimum(symbols("x", 1)[0], Interval(0.0, 1.0))


def test_they_know_their_names():
    for name in CASES:
        assert getattr(scalars, name).__name__ == name
        assert getattr(scalars, name).__doc__
