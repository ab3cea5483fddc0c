import numpy as np
import pytest

from flexhinf.errors import InvalidInput
from flexhinf.loop import Constant, Quintic, Samples, Sine, Spline, Step
from flexhinf.scalars import trace

T = np.linspace(-1.0, 4.0, 501)
SIGNALS = [
    Constant(2.0), Step(3.0, at=1.0, initial=-1.0), Sine(2.0, 0.5, offset=1.0, phase=0.3, at=0.5),
    Quintic(1.0, -2.0, 1.5, at=0.25),
]  # fmt: skip


def test_step_and_constant():
    np.testing.assert_array_equal(Step(3.0, at=1.0, initial=-1.0)(T), np.where(T >= 1.0, 3.0, -1.0))
    np.testing.assert_array_equal(Constant(2.0)(T), np.full(501, 2.0))


def test_the_papers_sine():
    """Fig. 7: x_d = π + sin(πt/10)."""
    np.testing.assert_allclose(
        Sine(1.0, 0.05, offset=np.pi)(T[T >= 0]), np.pi + np.sin(np.pi * T[T >= 0] / 10)
    )
    assert Sine(1.0, 0.05, offset=np.pi, at=2.0)(1.0) == np.pi


def test_quintic_starts_and_ends_at_rest():
    q, h = Quintic(1.0, -2.0, 1.5, at=0.25), 1e-4
    assert q(0.0) == 1.0
    assert q(3.0) == pytest.approx(-2.0)
    assert q(1.0) == pytest.approx(-0.5)
    for t in (0.25, 1.75):
        assert abs(q(t + h) - q(t - h)) / (2 * h) < 1e-6
        assert abs(q(t + h) - 2 * q(t) + q(t - h)) / h**2 < 1e-2


def test_samples_are_interpolated_and_held():
    s = Samples([0.0, 1.0, 3.0], [0.0, 2.0, 0.0])
    np.testing.assert_allclose(s([-1.0, 0.5, 2.0, 9.0]), [0.0, 1.0, 1.0, 0.0])
    two = Samples([0.0, 1.0], [[0.0, 4.0], [2.0, 0.0]])
    np.testing.assert_allclose(two([0.5, 1.0]), [[1.0, 2.0], [2.0, 0.0]])
    np.testing.assert_allclose(two(0.5), [1.0, 2.0])


def test_samples_are_copies():
    values = np.array([0.0, 2.0])
    s = Samples([0.0, 1.0], values)
    values[1] = 9.0
    assert s(1.0) == 2.0


@pytest.mark.parametrize("signal", SIGNALS, ids=lambda s: type(s).__name__)
def test_scalars_arrays_and_symbols_agree(signal):
    traced = trace(lambda t: signal(t[0]), 1)
    expected = signal(T)
    np.testing.assert_array_equal([signal(float(t)) for t in T], expected)
    np.testing.assert_allclose([float(traced(t)) for t in T], expected, atol=1e-14)


@pytest.mark.parametrize("signal", [*SIGNALS, Samples([0.0], [1.0])], ids=lambda s: type(s).__name__)
def test_every_signal_has_a_name(signal):
    assert len(signal.name) > 3


@pytest.mark.parametrize(
    "make",
    [
        lambda: Constant(np.nan), lambda: Step(np.inf), lambda: Step("up"), lambda: Step([1.0, 2.0]),
        lambda: Step(1.0, at=None), lambda: Sine(1.0, np.nan), lambda: Quintic(0.0, 1.0, 0.0),
        lambda: Quintic(0.0, 1.0, -1.0), lambda: Quintic(0.0, 1.0, 1e-300),
        lambda: Spline([0.0, 1e-300, 1.0], [1.0, 2.0, 3.0]), lambda: Samples([0.0, 0.0], [1.0, 2.0]),
        lambda: Samples([1.0, 0.0], [1.0, 2.0]),
        lambda: Samples([0.0], [1.0, 2.0]), lambda: Samples([], []), lambda: Samples([0.0, 1.0], [1.0, np.nan]),
        lambda: Samples(0.0, 1.0), lambda: Samples([0.0, 1.0], "ab"),
    ],
)  # fmt: skip
def test_bad_signals_are_refused(make):
    with pytest.raises(InvalidInput) as caught:
        make()
    assert caught.value.advice
