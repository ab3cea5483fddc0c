"""The law of a pair against SciPy's Riccati equations, its γ against a frequency response, gains between the grid."""

import numpy as np
import pytest
from scipy.linalg import expm, solve_continuous_are
from tests.refusals import refused_with

from flexhinf.errors import InvalidInput, NumericalFailure
from flexhinf.hinf import linear_law, smallest_gamma
from flexhinf.modal import Pair, PairWeights, pair_gains
from flexhinf.modal.pair import smallest_damping

PERIOD = 1e-3
PAIRS = [Pair(60.0**2, 185.0**2, 18.0), Pair(350.0**2, 80.0**2, 7.0), Pair(1400.0**2, 185.0**2, 18.0)]
PAIRS += [
    Pair(60.0**2, 40.0**2, 226.0, 125.0**2, 40.0**2),
    Pair(60.0**2, 0.0, 226.0, 125.0**2, 40.0**2),
]  # positions


def by_hand(pair):
    """A, B, G written out from z″ = λ(w − z + d_z), w″ = −κ(w − z) − βw′ − νw + b(f + d_w), ė = z."""
    lam, kappa, beta, nu, stated = pair
    gain = stated or kappa
    a = np.array([
        [0, 1, 0, 0, 0], [-lam, 0, lam, 0, 0], [0, 0, 0, 1, 0], [kappa, 0, -kappa - nu, -beta, 0], [1, 0, 0, 0, 0],
    ])  # fmt: skip
    return a, np.array([[0, 0, 0, gain, 0]]).T, np.array([[0, lam, 0, 0, 0], [0, 0, 0, gain, 0]]).T


@pytest.mark.oracle
@pytest.mark.parametrize("gamma", [np.inf, 2.0, 1.2])
@pytest.mark.parametrize("pair", PAIRS)
def test_the_law_is_that_of_scipys_riccati_equation(pair, gamma):
    weights = PairWeights(gamma=gamma)
    problem = weights.problem(pair, 0.4)
    level = gamma * smallest_gamma(problem) if np.isfinite(gamma) else np.inf
    a, b, g = by_hand(pair)
    h = problem.h_parts[1]
    speed = (18.0**-4 + (0.5 * np.sqrt(pair.link)) ** -4) ** -0.25
    gain = pair.gain or pair.motor
    masses = np.array([pair.motor / gain / pair.link, 1 / gain])
    taken = np.linalg.norm([speed * masses.sum(), pair.damping / gain, pair.holding / gain / speed])
    rate = 0.4 / np.sqrt(gain)
    slow = 1 / (1 + (np.sqrt(pair.link) / 350.0) ** 4)
    centre = masses / masses.sum()
    y = slow * np.array([1.0, 0.0]) + (1 - slow) * centre
    np.testing.assert_allclose(h[0, [0, 2]], taken * speed * y, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(h[1, [1, 3]], taken * y, rtol=1e-12, atol=1e-12)
    expected = [rate, -rate, taken * speed**2]
    np.testing.assert_allclose([h[2, 3], h[2, 1], h[3, 4]], expected, rtol=1e-12)
    scale = np.array([1.0, speed, 1.0, speed, 1.0 / speed])
    a, b, g, h = a * scale / scale[:, None], b / scale[:, None], g / scale[:, None], h * scale
    both = np.hstack([b, g]) if np.isfinite(level) else b
    signs = np.diag([1.0, -(level**2), -(level**2)]) if np.isfinite(level) else np.eye(1)
    p = solve_continuous_are(a, both, h.T @ h, signs)
    found = -linear_law(problem, level).law(np.eye(5))[:, 0]
    np.testing.assert_allclose(found, (b.T @ p)[0] / scale, rtol=1e-6)


@pytest.mark.oracle
@pytest.mark.parametrize("pair", PAIRS)
def test_the_frequency_response_stays_below_gamma(pair):
    weights = PairWeights()
    problem = weights.problem(pair, 0.4)
    gamma = 2.0 * smallest_gamma(problem)
    k = -linear_law(problem, gamma).law(np.eye(5))[:, 0]
    a, b, g = by_hand(pair)
    output = np.vstack([problem.h_parts[1], -k])
    omega = np.geomspace(0.1, 1e4, 2000)
    resolvent = np.linalg.solve(
        1j * omega[:, None, None] * np.eye(5) - (a - b * k), np.broadcast_to(g, (2000, 5, 2))
    )
    peak = np.linalg.norm(output @ resolvent, 2, axis=(1, 2)).max()
    assert 0.5 * gamma < peak < gamma


@pytest.mark.oracle
def test_an_input_that_is_held_is_that_of_the_middle_of_its_hold():
    pair, weights = PAIRS[1], PairWeights(gamma=np.inf, damping=1e-6)
    k = -linear_law(weights.problem(pair, 0.02), np.inf).law(np.eye(5))[:, 0]
    a, b, _ = by_hand(pair)
    np.testing.assert_allclose(weights.gains(pair, PERIOD), k @ expm((a - b * k) * PERIOD / 2), rtol=1e-9)


@pytest.mark.oracle
def test_the_wanted_damping_is_that_of_the_modes():
    weights = PairWeights(gamma=np.inf)
    for pair in PAIRS[:2]:
        k = weights.gains(pair, PERIOD)
        a, b, _ = by_hand(pair)
        held = expm(np.block([[a, b], [np.zeros((1, 6))]]) * PERIOD)
        s = np.log(np.linalg.eigvals(held[:5, :5] - held[:5, 5:] * k).astype(complex)) / PERIOD
        s = s[np.abs(s.imag) > 2.0]
        wanted = 0.36 / (1 + (pair.link / 350.0**2) ** 2)
        np.testing.assert_allclose((-s.real / np.abs(s)).min(), wanted, rtol=0.02)


def test_damping_is_that_of_its_definition():
    s = np.array([-30 + 40j, -30 - 40j, -5 + 500j, -5 - 500j, -1.0, -0.1 + 1j, -0.1 - 1j])
    z = np.append(np.exp(s * PERIOD), 0.0)
    assert smallest_damping(z, PERIOD) == pytest.approx(5 / abs(-5 + 500j))
    assert smallest_damping(z, PERIOD, 350.0) == pytest.approx(0.6)
    assert smallest_damping(z, PERIOD, 40.0) == 1.0


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("case", [(13.7, 102.0, 38.6**2, 105.0), (45.0, 1743.0, 185.0**2, 18.0)])
def test_gains_between_the_grid_are_those_of_a_pair(case):
    low, high, motor, damping = case
    gains, weights = pair_gains((low**2, high**2), motor, damping, PERIOD), PairWeights()
    links = np.geomspace(low**2, high**2, 9)[1:-1]
    expected = np.array([weights.gains(Pair(link, motor, damping), PERIOD) for link in links])
    assert (np.abs(gains(links)[:, :5] - expected) / np.abs(expected).max(axis=0)).max() < 0.05
    selected = 1 / (1 + (links / 350.0**2) ** 2)
    assert np.abs(gains(links)[:, 5] - selected).max() < 0.05
    np.testing.assert_allclose([gains(link) for link in links], gains(links), rtol=1e-12)
    modulus, least = gains.sweep
    modes = [np.abs(gains.pair(link).modes(gains(link)[:5], PERIOD)).max() for link in links]
    assert max(modes) <= modulus + 1e-4 < 1.0
    assert least > 0.2


def test_gains_that_no_sampling_carries_are_refused_with_what_a_user_can_state():
    with refused_with(NumericalFailure, "pair", "shorter period", "rigid = true"):
        pair_gains((45.0**2, 60.0**2), 185.0**2, 18.0, 0.1)


def test_what_is_no_pair_is_refused():
    with refused_with(InvalidInput, "range", "0 < low < high"):
        pair_gains((4.0, 1.0), 1e4, 1.0, PERIOD)
    with refused_with(InvalidInput, "gamma", 0.9):
        PairWeights(gamma=0.9)
    with refused_with(InvalidInput, "bandwidth", -1.0):
        PairWeights(bandwidth=-1.0)
