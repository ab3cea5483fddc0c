"""Norms against closed forms and python-control's (slycot)."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import block_diag

from flexhinf.analysis import DiscreteSystem
from flexhinf.analysis.linear_loop import Modes


def lag(pole: float) -> DiscreteSystem:
    one = np.ones((1, 1))
    return DiscreteSystem(pole * one, one, one, 0.0 * one, 0.01)


def random(seed: int, radius: float = 0.98) -> DiscreteSystem:
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(7, 7))
    a *= radius / np.abs(np.linalg.eigvals(a)).max()
    return DiscreteSystem(
        a, rng.normal(size=(7, 2)), rng.normal(size=(3, 7)), 0.3 * rng.normal(size=(3, 2)), 0.01
    )


def test_a_lag_has_its_norm_at_rest_or_at_half_the_sampling_frequency() -> None:
    assert lag(0.9).norm() == pytest.approx((10.0, 0.0))
    norm, at = lag(-0.9).norm()
    assert norm == pytest.approx(10.0)
    assert at == pytest.approx(np.pi / 0.01)
    assert lag(0.9).rms()[0, 0] == pytest.approx(1.0 / np.sqrt(1.0 - 0.81))
    assert lag(0.9).response(0.0)[0, 0, 0] == pytest.approx(10.0)


def test_a_resonance_between_any_grid() -> None:
    """z² − 2ρ cos(θ) z + ρ² with ρ within 1e-7 of one: the peak is 1/|(z − p)(z − p̄)| at z = e^{jθ} to 1e-6."""
    rho, theta = 1.0 - 1e-7, 0.7123456
    a = np.array([[2.0 * rho * np.cos(theta), -(rho**2)], [1.0, 0.0]])
    norm, at = DiscreteSystem(a, np.eye(2, 1), np.array([[0.0, 1.0]]), np.zeros((1, 1)), 1.0).norm()
    z, p = np.exp(1j * theta), rho * np.exp(1j * theta)
    assert norm == pytest.approx(1.0 / abs((z - p) * (z - p.conjugate())), rel=1e-5)
    assert at == pytest.approx(theta, rel=1e-6)


@pytest.mark.oracle
@pytest.mark.parametrize("seed", range(6))
def test_norm_is_that_of_slycot(seed: int) -> None:
    control, _ = pytest.importorskip("control"), pytest.importorskip("slycot")
    system = random(seed)
    expected, at = control.linfnorm(control.ss(system.a, system.b, system.c, system.d, system.period))
    norm, frequency = system.norm()
    assert norm == pytest.approx(expected, rel=1e-6)
    assert np.linalg.norm(system.response(frequency)[0], 2) == pytest.approx(norm, rel=1e-8)
    assert frequency == pytest.approx(at, rel=1e-3, abs=1e-6)


@pytest.mark.oracle
def test_rms_is_that_of_the_impulse_response() -> None:
    system = random(11, 0.8)
    total, state = system.d**2, system.b
    for _ in range(400):
        total, state = total + (system.c @ state) ** 2, system.a @ state
    assert np.allclose(system.rms(), np.sqrt(total), rtol=1e-9)


def test_rms_of_what_is_small_beside_the_rest() -> None:
    """Down a chain of weakly coupled modes: solved as a whole, the Lyapunov equation gives 0 or far too much."""
    rng, turn = np.random.default_rng(3), np.array([[0.0, 1.0], [-1.0, 0.0]])
    sizes, angles = [0.99, 0.999] * 6, 0.3 + np.arange(12)
    a = block_diag(
        *(r * (np.cos(w) * np.eye(2) + np.sin(w) * turn) for r, w in zip(sizes, angles, strict=True))
    )
    for k in range(0, 22, 2):
        a[k + 2 : k + 4, k : k + 2] = 1e-4 * rng.normal(size=(2, 2))
    system = DiscreteSystem(a, np.eye(24, 1), np.eye(24)[22:], np.zeros((2, 1)), 1e-3)
    total, state = np.zeros((2, 1)), system.b
    for _ in range(40_000):
        total, state = total + (system.c @ state) ** 2, system.a @ state
    assert np.allclose(system.rms(), np.sqrt(total), rtol=1e-9, atol=0.0)


def test_what_grows_is_infinite() -> None:
    assert np.isinf(lag(1.1).rms()).all()


def test_a_pole_on_the_circle_that_noise_does_not_reach_leaves_the_others_as_they_are() -> None:
    """Without a warning of SciPy on the terminal."""
    one = np.array([[0.0], [1.0]])
    system = DiscreteSystem(np.diag([1.0, 0.5]), one, one.T, np.zeros((1, 1)), 0.01)
    assert system.rms()[0, 0] == pytest.approx(1.0 / np.sqrt(1.0 - 0.25))


@pytest.mark.parametrize("size", [1e-250, 1e250])
def test_the_norm_of_a_system_that_hardly_passes_anything_scales(size: float) -> None:
    """The square of such a level is no number: an estimator told of a process noise of 1e-300 has such a loop."""
    system = lag(0.9)
    scaled = DiscreteSystem(system.a, size * system.b, system.c, size * system.d, system.period)
    assert scaled.norm()[0] == pytest.approx(10.0 * size, rel=1e-9)


def test_an_unstable_system_has_no_norm() -> None:
    norm, at = lag(1.01).norm()
    assert np.isinf(norm)
    assert np.isnan(at)


@pytest.mark.parametrize("limit", [np.inf, 60.0])
def test_the_damping_of_many_loops_at_once_is_that_of_each(limit: float) -> None:
    """Loops that grow, that are gone within a sample, drift, or oscillate below and above the limit."""
    rng, b = np.random.default_rng(7), np.zeros((6, 1))
    loops = rng.normal(size=(60, 6, 6)) * np.geomspace(1e-2, 0.6, 60)[:, None, None]
    loops[:30] += 0.7 * np.eye(6)
    each = [DiscreteSystem(a, b, b.T, np.zeros((1, 1)), 0.01).damping_about(limit) for a in loops]
    expected = np.array([min(slow, fast if fast < 0.0 else 1.0) for slow, fast in each])
    multipliers = np.linalg.eigvals(loops).astype(complex)
    modes = Modes(0.01, np.zeros((60, 6)), multipliers)
    np.testing.assert_allclose(modes.damping_about(limit), expected, rtol=1e-9)
    assert len(set(expected.tolist())) > 20
    assert expected.min() < 0.0 < expected.max()
    multipliers[3, 0] = np.inf  # no equilibrium
    assert modes.damping_about(limit)[3] == -np.inf
