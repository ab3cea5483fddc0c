"""The derivatives of the signals, against mpmath and exact polynomials."""

import mpmath
import numpy as np
import pytest
from numpy.polynomial import Polynomial
from tests.refusals import refused_with

from flexhinf.errors import InvalidInput
from flexhinf.loop import Constant, Quintic, Samples, Sine, Spline, Step
from flexhinf.scalars import trace

T = np.linspace(-1.0, 4.0, 101)
SIGNALS = [
    Constant(2.0), Step(3.0, at=1.0, initial=-1.0), Sine(2.0, 0.5, offset=1.0, phase=0.3, at=0.5),
    Quintic(1.0, -2.0, 1.5, at=0.25),
]  # fmt: skip
SAMPLES = np.random.default_rng(2).normal(size=(9, 2))
TIMES = np.cumsum(np.random.default_rng(3).uniform(0.2, 0.6, 9))


@pytest.mark.parametrize("signal", [*SIGNALS, Spline(TIMES, SAMPLES[:, 0])], ids=lambda s: type(s).__name__)
def test_the_value_comes_first_and_shapes_follow(signal):
    found = signal.derivatives(T)
    assert found.shape == (5, 101)
    np.testing.assert_array_equal(found[0], signal(T))
    np.testing.assert_array_equal(signal.derivatives(T, 2), found[:3])
    np.testing.assert_allclose(
        signal.derivatives(0.7)[:, None], signal.derivatives(np.array([0.7])), rtol=1e-14
    )
    assert signal.derivatives(0.7, 0).shape == (1,)


@pytest.mark.parametrize("signal", SIGNALS, ids=lambda s: type(s).__name__)
def test_they_can_be_traced(signal):
    traced = trace(lambda t: signal.derivatives(t[0]), 1)
    for t in (-0.5, 0.3, 0.9, 3.0):
        np.testing.assert_allclose(traced(t).full().ravel(), signal.derivatives(t), rtol=1e-13, atol=1e-13)


@pytest.mark.oracle
def test_a_sine_against_mpmath():
    sine, t = Sine(2.0, 0.35, offset=1.0, phase=0.3, at=0.5), 1.7
    with mpmath.workdps(40):
        pulsation, phase = 2 * mpmath.pi * mpmath.mpf(0.35), mpmath.mpf(0.3)
        wave = [
            mpmath.diff(lambda s: 1 + 2 * mpmath.sin(pulsation * (s - 0.5) + phase), t, k) for k in range(7)
        ]
    np.testing.assert_allclose(sine.derivatives(t, 6), [float(w) for w in wave], rtol=1e-13)
    np.testing.assert_array_equal(sine.derivatives(0.49, 3), [1.0, 0.0, 0.0, 0.0])


@pytest.mark.oracle
def test_a_quintic_is_the_polynomial_with_six_conditions():
    """From the conditions at both ends, not from the formula."""
    at, length = 0.25, 1.5
    rows = [np.polyder(np.eye(6)[j][::-1], k) for j in range(6) for k in range(3)]
    matrix = np.array(
        [[np.polyval(rows[3 * j + k], end) for j in range(6)] for end in (0.0, length) for k in range(3)]
    )
    path = Polynomial(np.linalg.solve(matrix, [1.0, 0.0, 0.0, -2.0, 0.0, 0.0]))
    t = np.linspace(at, at + length - 1e-9, 50)
    found = Quintic(1.0, -2.0, length, at).derivatives(t, 6)
    for k in range(7):
        expected = (path.deriv(k) if k else path)(t - at)
        np.testing.assert_allclose(
            found[k], expected, rtol=1e-10, atol=1e-10 * max(1.0, np.abs(expected).max())
        )
    np.testing.assert_array_equal(
        Quintic(1.0, -2.0, length, at).derivatives(np.array([0.2, 1.75, 9.0]))[1:], 0.0
    )


def test_a_step_is_at_rest_on_both_sides():
    found = Step(3.0, at=1.0, initial=-1.0).derivatives(np.array([0.9, 1.0]), 2)
    np.testing.assert_array_equal(found, [[-1.0, 3.0], [0.0, 0.0], [0.0, 0.0]])


# Splines ------------------------------------------------------------------------------------------
@pytest.mark.parametrize("count", [1, 2, 3, 9])
def test_a_spline_goes_through_its_samples_from_rest_to_rest(count):
    spline = Spline(TIMES[:count], SAMPLES[:count])
    np.testing.assert_allclose(spline(TIMES[:count]), SAMPLES[:count], rtol=1e-10, atol=1e-10)
    outside = spline.derivatives([TIMES[0] - 1.0, TIMES[0], TIMES[count - 1], TIMES[count - 1] + 1.0])
    assert outside.shape == (5, 4, 2)
    np.testing.assert_allclose(outside[0], SAMPLES[[0, 0, count - 1, count - 1]], rtol=1e-12)
    np.testing.assert_array_equal(outside[1:], 0.0)


@pytest.mark.oracle
def test_two_samples_give_the_polynomial_of_degree_nine():
    """70 s⁹ − 315 s⁸ + 540 s⁷ − 420 s⁶ + 126 s⁵."""
    spline = Spline([1.0, 3.0], [-1.0, 4.0])
    path = Polynomial([-1.0, 0, 0, 0, 0, *(5.0 * np.array([126, -420, 540, -315, 70]))])
    t = np.linspace(1.01, 2.99, 40)
    for k, row in enumerate(spline.derivatives(t)):
        expected = (path.deriv(k) if k else path)((t - 1.0) / 2.0) / 2.0**k
        np.testing.assert_allclose(row, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.oracle
def test_the_derivatives_of_a_spline_are_continuous_and_those_of_its_values():
    spline = Spline(TIMES, SAMPLES)
    d = 1e-7
    for t in TIMES:
        before, after = spline.derivatives([t - d, t + d]).swapaxes(0, 1)
        scale = np.abs(spline.derivatives(np.linspace(TIMES[0], TIMES[-1], 400))).max(axis=1)
        assert np.all(np.abs(after - before) <= 1e-4 * scale)
    t, h = np.linspace(TIMES[0] + 0.05, TIMES[-1] - 0.05, 37), 1e-3
    weights = np.array([1, -8, 0, 8, -1]) / (12 * h)
    near = np.array([spline.derivatives(t + k * h) for k in range(-2, 3)])
    slopes = np.tensordot(weights, near, axes=1)
    for k in range(4):
        expected = spline.derivatives(t)[k + 1]
        np.testing.assert_allclose(slopes[k], expected, atol=1e-5 * np.abs(expected).max())


def test_a_spline_of_many_dense_samples_keeps_a_smooth_signal():
    t = np.linspace(0.0, 10.0, 2001)
    wave = np.where((t > 1) & (t < 9), np.sin(np.pi * (t - 1.0) / 8.0), 0.0) ** 12
    spline, between = Spline(t, wave), np.linspace(1.0, 9.0, 777)
    np.testing.assert_allclose(spline(between), np.sin(np.pi * (between - 1.0) / 8.0) ** 12, atol=1e-10)


def test_interpolated_samples_have_no_derivatives():
    with refused_with(InvalidInput, "interpolation", 4) as caught:
        Samples([0.0, 1.0], [0.0, 1.0]).derivatives(0.5)
    assert "Spline" in caught.value.advice
    assert Samples([0.0, 1.0], [0.0, 1.0]).derivatives(0.5, 0) == [0.5]


@pytest.mark.parametrize("order", [-1, 1.5, True, None])
def test_orders_are_numbers(order):
    for signal in (*SIGNALS, Spline([0.0, 1.0], [0.0, 1.0])):
        with pytest.raises(InvalidInput):
            signal.derivatives(0.0, order)


def test_a_spline_has_four_derivatives_and_needs_samples():
    with pytest.raises(InvalidInput, match="order 5"):
        Spline([0.0, 1.0], [0.0, 1.0]).derivatives(0.0, 5)
    with pytest.raises(InvalidInput, match=r"times \(2,\)"):
        Spline([0.0, 0.0], [0.0, 1.0])
    assert "9 samples" in Spline(TIMES, SAMPLES).name
