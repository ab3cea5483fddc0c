"""Decaying oscillations from runs: closed forms, what is hidden, and what is no oscillation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from flexhinf.loop.simulation.ring_down import FITS, VISIBLE, ring_down

PERIOD = 1e-3


def struck(frequency: float, damping: float, samples: int = 1500) -> np.ndarray:
    """Position and velocity of an oscillator after a blow, closed form."""
    time, rate = PERIOD * np.arange(samples), frequency * np.sqrt(1.0 - damping**2)
    decay, angle = np.exp(-damping * frequency * time), rate * time
    position = decay * np.sin(angle) / rate
    return np.column_stack([position, decay * np.cos(angle) - damping * frequency * position])


@pytest.mark.oracle
@pytest.mark.parametrize("damping", [0.002, 0.07, 0.3, 0.9])
def test_an_oscillator_has_its_damping_and_the_logarithmic_decrement(damping: float) -> None:
    run = struck(40.0, damping)
    found = ring_down([run], [[1]], PERIOD)
    assert found.damping == pytest.approx(damping, rel=1e-6)
    assert found.oscillations[0][0].frequency == pytest.approx(40.0 / (2.0 * np.pi), rel=1e-6)
    assert found.error < 1e-6
    extremes = np.flatnonzero(np.diff(np.sign(np.diff(np.abs(run[:, 0])))) < 0) + 1
    if len(extremes) > 1:  # ln(a1/a2) = π ζ/√(1 − ζ²) from one extreme to the next
        heights = np.abs(run[extremes, 0])
        decrement = np.log(heights[0] / heights[1])
        assert decrement / np.hypot(np.pi, decrement) == pytest.approx(damping, rel=0.02)


@pytest.mark.oracle
def test_of_several_modes_each_has_its_own_and_only_what_is_seen_counts() -> None:
    """A slow well damped mode outlasts a fast one that rings, and hides it from any envelope."""
    slow, fast = struck(5.0, 0.7), struck(90.0, 0.1)
    mixed = np.hstack([slow + fast, fast @ np.array([[1.0, 2.0], [0.0, 1.0]])])
    found = ring_down([mixed], [[1]], PERIOD)
    assert [round(one.damping, 6) for one in found.oscillations[0]] == [0.1, 0.7]
    faint = np.hstack([slow + 0.1 * VISIBLE * fast, fast])
    assert [round(one.damping, 6) for one in ring_down([faint], [[1]], PERIOD).oscillations[0]] == [0.7]
    assert ring_down([faint], [[1, 3]], PERIOD).damping == pytest.approx(0.1, rel=1e-6)


def test_each_run_is_judged_by_what_is_seen_in_it() -> None:
    one, other = struck(20.0, 0.4), struck(60.0, 0.05)
    runs = [np.hstack([one, 0.0 * other]), np.hstack([0.0 * one, other])]
    found = ring_down(runs, [[1], [3]], PERIOD)
    assert found.damping_of(0) == pytest.approx(0.4, rel=1e-6)
    assert found.damping_of(1) == pytest.approx(0.05, rel=1e-6)
    assert (found.worst, found.rests) == (1, True)
    assert found.damping_of(1, below=60.0 * 0.9) == 1.0


def test_a_growing_oscillation_has_a_negative_damping() -> None:
    a = expm(PERIOD * np.array([[0.0, 1.0], [-900.0, 3.0]]))
    run = np.array([np.linalg.matrix_power(a, k) @ [0.0, 1.0] for k in range(1000)])
    found = ring_down([run], [[1]], PERIOD)
    assert found.damping == found.damping_of(0, below=1.0) == pytest.approx(-0.05, rel=1e-6)
    assert not found.rests


def test_what_neither_decays_nor_fits_is_not_damped() -> None:
    """A limit cycle: |velocity| is kept by a relay, as dry friction and integral action keep it."""
    run, x = np.zeros((3000, 2)), np.array([0.0, 1.0])
    for k in range(len(run)):
        run[k] = x
        force = -900.0 * x[0] + 4.0 * np.sign(x[1]) * (abs(x[1]) < 1.0) - 30.0 * np.sign(x[0])
        velocity = x[1] + PERIOD * force
        x = np.array([x[0] + PERIOD * velocity, velocity])
    found = ring_down([run], [[1]], PERIOD)
    assert not found.rests
    assert found.error > FITS
    assert found.damping == 0.0


def test_nothing_that_oscillates_is_fully_damped() -> None:
    time = PERIOD * np.arange(500)
    run = np.column_stack([np.exp(-20.0 * time), np.exp(-50.0 * time)])
    assert ring_down([run], [[0, 1]], PERIOD).damping == 1.0


def test_one_signal_that_does_not_come_to_rest_is_enough() -> None:
    gone, stays = struck(40.0, 0.4), struck(40.0, 0.001)
    run = np.hstack([gone, stays])
    assert ring_down([run], [[1]], PERIOD).rests
    assert not ring_down([run], [[1, 3]], PERIOD).rests
    assert not ring_down([run], [[3, 1]], PERIOD).rests


@pytest.mark.parametrize(("samples", "seen"), [(1.5, 0), (2.5, 1)])
def test_what_is_gone_within_two_samples_is_no_oscillation(samples: float, seen: int) -> None:
    """Poles of modulus e^(−1/samples) at an angle of one radian a sample."""
    k = np.arange(60)
    run = np.exp(-k / samples)[:, None] * np.column_stack([np.cos(k), np.sin(k)])
    assert len(ring_down([run], [[0]], PERIOD).oscillations[0]) == seen


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e4])
def test_the_distance_of_the_fit_is_relative_and_silent_signals_do_not_matter(unit: float) -> None:
    rng = np.random.default_rng(2)
    run = struck(30.0, 0.2) * (1.0 + 0.03 * rng.standard_normal((1500, 1)))
    expected = ring_down([run], [[1]], PERIOD)
    assert 1e-3 < expected.error < 1.0
    silent = np.hstack([unit * run, np.zeros((1500, 1))])
    found = ring_down([silent], [[1]], PERIOD)
    assert found.error == pytest.approx(expected.error, rel=1e-6)
    assert found.damping == pytest.approx(expected.damping, rel=1e-6)
