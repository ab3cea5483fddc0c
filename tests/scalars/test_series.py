import mpmath
import numpy as np
import pytest
from tests.refusals import refused_with

from flexhinf.errors import InvalidInput
from flexhinf.scalars import clip, derivative, jets, series, trace


def formula(a, b):
    """Arithmetic and trigonometry in all orders of operands."""
    return (2.0 - a) * np.sin(a * b) / (3.0 + np.cos(b)) - 1.5 / (2.0 + b * b) + (a + 1.0) / 4.0 - b


A, B = [0.3, -0.7, 1.1, 0.4], [0.9, 0.2, -0.5, 2.0]


@pytest.mark.oracle
def test_derivatives_of_a_composition_against_mpmath():
    def path(values):
        return lambda s: sum(mpmath.mpf(v) * s**k / mpmath.factorial(k) for k, v in enumerate(values))

    a, b = path(A), path(B)

    def value(s):
        return (2 - a(s)) * mpmath.sin(a(s) * b(s)) / (3 + mpmath.cos(b(s))) \
            - mpmath.mpf("1.5") / (2 + b(s) ** 2) + (a(s) + 1) / 4 - b(s)  # fmt: skip

    with mpmath.workdps(40):
        expected = [float(mpmath.diff(value, 0, k)) for k in range(4)]
    found = formula(series(*([v] for v in A)), series(*([v] for v in B)))
    np.testing.assert_allclose([derivative(found, k)[0] for k in range(4)], expected, rtol=1e-13)


def test_series_of_symbols_trace():
    numbers = formula(series(*([v] for v in A)), series(*([v] for v in B)))
    function = trace(
        lambda a, b: derivative(formula(series(*a.reshape(4, 1)), series(*b.reshape(4, 1))), 3), 4, 4
    )
    assert float(function(A, B)) == pytest.approx(derivative(numbers, 3)[0], rel=1e-14)


def test_series_of_truncated_polynomials():
    x = jets(np.array([0.3]), 2)
    found = np.sin(series(x, np.array([2.0]))[0])
    expected = 2.0 * np.cos(x[0])
    np.testing.assert_allclose(found.coefficients[1].coefficients, expected.coefficients, atol=1e-15)


def test_numbers_and_numpy_numbers_on_both_sides():
    (s,) = series([2.0], [3.0])
    for two in (2, 2.0, np.float64(2.0)):
        np.testing.assert_allclose((two * s).coefficients, (4.0, 6.0))
        np.testing.assert_allclose((two - s).coefficients, (0.0, -3.0))
        np.testing.assert_allclose((s - two).coefficients, (0.0, 3.0))
        np.testing.assert_allclose((two / s).coefficients, (1.0, -1.5))
        np.testing.assert_allclose((s / two).coefficients, (1.0, 1.5))
    np.testing.assert_allclose((-s).coefficients, (-2.0, -3.0))
    assert "Series(2.0, 3.0)" in repr(s)


def test_what_is_constant_has_no_derivative():
    np.testing.assert_array_equal(derivative(np.array([5.0, 2.0]), 0), [5.0, 2.0])
    np.testing.assert_array_equal(derivative(np.array([5.0, 2.0]), 1), [0.0, 0.0])


def test_what_is_not_listed_is_refused():
    (s,), (short,) = series([2.0], [3.0], [1.0]), series([2.0], [3.0])
    with pytest.raises(InvalidInput, match="lengths"):
        s + short
    with refused_with(InvalidInput, "clip", "smooth", "Series"):
        clip(s, 0.0, 1.0)
    with pytest.raises(TypeError):
        np.tanh(s)
    with pytest.raises(TypeError):
        hash(s)
