import re
from fractions import Fraction

import numpy as np
import pytest
from tests.refusals import refused_with

from flexhinf.codegen.noise import normal_numbers
from flexhinf.errors import InvalidInput
from flexhinf.loop import Constant, Samples, Sine, Step
from flexhinf.loop.signals.references import signal_name
from flexhinf.loop.simulation.inputs import sample_disturbance, sample_noise, sample_signal

T = np.arange(6) * 0.1
TWO = ("a", "b")


@pytest.mark.parametrize(
    ("signal", "expected"),
    [
        (None, np.zeros((6, 2))),
        ([1.0, 2.0], np.tile([1.0, 2.0], (6, 1))),
        (np.array([1.0, 2.0]), np.tile([1.0, 2.0], (6, 1))),
        ({"b": 3.0}, np.tile([0.0, 3.0], (6, 1))),
        ({"a": Constant(1.0), "b": lambda t: 2 * t}, np.column_stack([np.ones(6), 2 * T])),
        ((Step(1.0, at=0.2), 4.0), np.column_stack([T > 0.15, np.full(6, 4.0)])),
        (lambda t: [t, -t], np.column_stack([T, -T])),
        (Samples([0.0, 1.0], [[0.0, 1.0], [1.0, 0.0]]), np.column_stack([T, 1 - T])),
    ],
)
def test_every_form_for_two_channels(signal, expected):
    np.testing.assert_allclose(sample_signal(signal, T, TWO, "disturbance"), expected, atol=1e-14)


@pytest.mark.parametrize(
    "signal", [3.0, [3.0], np.array([3.0]), lambda t: 3.0, lambda t: [3.0], Constant(3.0), {"a": 3}]
)
def test_every_form_for_one_channel(signal):
    np.testing.assert_array_equal(sample_signal(signal, T, ("a",), "reference"), np.full((6, 1), 3.0))


@pytest.mark.parametrize(
    "signal",
    [
        3.0, [1.0], [1.0, 2.0, 3.0], {"c": 1.0}, lambda t: t, lambda t: [t] * 3, lambda t: "up", "up",
        Constant(1.0), lambda t: [np.nan, 0.0], [np.inf, 0.0], np.zeros((6, 2)), [[1.0, 2.0], 3.0],
    ],
)  # fmt: skip
def test_what_does_not_fit_two_channels_is_refused(signal):
    with pytest.raises(InvalidInput):
        sample_signal(signal, T, TWO, "disturbance")


def test_as_many_numbers_as_samples_are_no_signal():
    with pytest.raises(InvalidInput):
        sample_signal(np.zeros(6), T, ("a",), "reference")
    with pytest.raises(InvalidInput):
        sample_signal(lambda t: t, T[:2], TWO, "reference")


def test_signals_for_no_channel():
    assert sample_signal(None, T, (), "reference").shape == (6, 0)
    assert sample_signal({}, T, (), "reference").shape == (6, 0)
    with pytest.raises(InvalidInput):
        sample_signal(1.0, T, (), "reference")


@pytest.mark.parametrize("period", [1e-3, 1e-2, 3e-3, 1 / 3])
def test_a_step_at_a_sample_acts_from_that_sample_on(period):
    """k·period is rounded, the time a user writes is rounded otherwise."""
    times = np.arange(3000) * period
    for k in range(1, 3000, 7):
        at = float(k * Fraction(period).limit_denominator(1000))
        values = sample_signal(Step(1.0, at=at), times, ("a",), "reference")[:, 0]
        assert np.flatnonzero(values)[0] == k
        values = sample_signal(lambda t, at=at: float(t >= at), times[k - 1 : k + 1], ("a",), "reference")
        assert values.ravel().tolist() == [0.0, 1.0]


@pytest.mark.parametrize("parts", [1, 7, 67])
def test_stages_of_sub_steps(parts):
    period, samples = 1e-3, 40
    wave = sample_disturbance(Sine(2.0, 3.0), period, samples, parts, ("a",)).reshape(samples, parts, 3)
    starts = np.arange(samples)[:, None] * period + np.arange(parts) * period / parts
    for stage, share in enumerate((0.0, 0.5, 1.0)):
        expected = 2.0 * np.sin(6 * np.pi * (starts + share * period / parts))
        np.testing.assert_allclose(wave[:, :, stage], expected, atol=1e-7)


@pytest.mark.parametrize("parts", [1, 7])
def test_a_jump_at_a_sample_divides_sub_steps(parts):
    jump = sample_disturbance(Step(1.0, at=0.017), 1e-3, 40, parts, ("a",)).reshape(40, parts * 3)
    assert np.all(jump[:17] == 0.0)
    assert np.all(jump[17:] == 1.0)


def test_too_many_numbers_are_refused_before_they_are_made():
    with refused_with(InvalidInput, 200000000, 1000000, 100000):
        sample_disturbance(None, 1e-3, 10**6, 10**5, TWO)


def test_noise_is_a_standard_deviation():
    z = sample_noise(0.1, 4, 20_000, TWO)
    np.testing.assert_allclose(z.std(axis=0), 0.1, rtol=0.03)
    each = sample_noise([0.0, 2.0], 4, 20_000, TWO)
    np.testing.assert_allclose(each, z * [0.0, 20.0], rtol=1e-15)
    np.testing.assert_array_equal(sample_noise(None, 4, 5, TWO), np.zeros((5, 2)))


@pytest.mark.oracle
@pytest.mark.parametrize("samples", [1, 7, 8, 9, 100])
@pytest.mark.parametrize("width", [1, 2, 5])
def test_noise_of_the_kernel_is_that_of_arrays(samples, width):
    deviation, seed = np.linspace(0.1, 0.3, width), 2**50 + 17
    expected = deviation * normal_numbers(seed, np.arange(samples)[:, None], np.arange(width), 3)
    found = sample_noise(deviation, seed, samples, tuple("abcde"[:width]), 3)
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("noise", [-1.0, np.nan, [1.0], [1.0, 2.0, 3.0], "loud", [[1.0, 2.0]]])
def test_bad_noise_is_refused(noise):
    with pytest.raises(InvalidInput):
        sample_noise(noise, 0, 5, TWO)


@pytest.mark.parametrize("seed", [-1, 1.5, True, None, "0", 2**64])
def test_bad_seeds_are_refused_with_and_without_noise(seed):
    for noise in (None, 1.0):
        with pytest.raises(InvalidInput, match="seed"):
            sample_noise(noise, seed, 5, TWO)


def test_names():
    assert signal_name(None) == "none"
    assert signal_name(2.0) == "constant 2.0"
    assert re.fullmatch(r"step .*1 .*2 s", signal_name(Step(1.0, at=2.0)))
    assert signal_name({"a": Step(1.0), "b": 2.0}) == f"a: {signal_name(Step(1.0))}; b: constant 2.0"
    assert signal_name(np.sin) == "sin"
    assert signal_name([1.0, None]) == "constant 1.0; none"


def test_disturbances_by_name_are_those_of_all_channels_with_room_behind():
    parts = {"b": Sine(2.0, 3.0), "a": 0.5}
    named = sample_disturbance(parts, 1e-3, 40, 3, ("a", "b"), room=4)
    whole = sample_disturbance((0.5, parts["b"]), 1e-3, 40, 3, ("a", "b"))
    assert named.shape == (40, 4, 3, 2)
    np.testing.assert_array_equal(named[:, :3], whole)
    assert not named[:, 3].any()


@pytest.mark.parametrize("kind", [list, tuple, dict])
def test_a_signal_that_contains_itself_is_refused(kind):
    inside: list = []
    inside.append(inside)
    signal = {"a": {"a": inside}} if kind is dict else kind([inside])
    with pytest.raises(InvalidInput):
        sample_signal(signal, np.zeros(2), ["a"], "disturbance")
    assert len(signal_name(signal)) < 20
