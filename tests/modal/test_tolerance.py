"""Covered errors against random errors of full loops, and the norms behind them against a dense frequency response."""

import numpy as np
import pytest
from tests.modal.conftest import held, sampled_loop

from flexhinf.modal import error_tolerance, pair_gains, tolerated_error
from flexhinf.modal.tolerance import PIECES, _norms

PERIOD = 1e-3


@pytest.fixture(scope="module")
def gains():
    return pair_gains((45.0**2, 600.0**2), 110.0**2, 12.0, PERIOD)


def loop(gains, links, wrong_links, wrong_motors, latency):
    """The sampled loop of pairs λ (n,) whose accelerations are wrong by (1 + Δ₁) and (1 + Δ₂), (n, n) each; the law
    predicts with the pairs as they should be."""
    n, kappa, beta = len(links), gains.motor, gains.damping
    zero, one = np.zeros((n, n)), np.eye(n)

    def model(first, second):
        springs, rotors = first * links, kappa * second
        a = np.block([
            [zero, one, zero, zero], [-springs, zero, springs, zero],
            [zero, zero, zero, one], [rotors, zero, -rotors, -beta * one],
        ])  # fmt: skip
        return a, np.vstack([zero, zero, zero, rotors])

    k = gains(links)[:, :5]
    gain = -np.hstack([np.diag(k[:, i]) for i in range(5)])
    true, believed = model(one + wrong_links, one + wrong_motors), model(one, one)
    whole = sampled_loop(*believed, gain, latency, list(range(n)), PERIOD)
    for place, plant in ((slice(0, 4 * n), true),):
        f, g = held(*plant, PERIOD)
        f0, g0 = held(*believed, PERIOD)
        whole[place, : 4 * n] += f - f0
        if latency:
            whole[place, 6 * n : 7 * n] += g - g0
        else:
            integral = np.eye(n, 6 * n, 4 * n) + 0.5 * PERIOD * (np.eye(n, 6 * n, 5 * n) + np.eye(n, 6 * n))
            whole[place] += (g - g0) @ (gain[:, : 4 * n] @ np.eye(4 * n, 6 * n) + gain[:, 4 * n :] @ integral)
    return np.abs(np.linalg.eigvals(whole)).max()


@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.parametrize(("latency", "count"), [(0, 50), (0, 150), (1, 150)])
def test_errors_below_it_never_destabilise_and_larger_ones_do(gains, latency, count):
    covered, rng = tolerated_error(gains, 350.0, latency), np.random.default_rng(latency)
    assert 0.2 < covered < 0.4

    def turned(size, n):
        """Δ of the norm `size`: rotations, with one diagonal of signs."""
        u, _, v = np.linalg.svd(rng.normal(size=(n, n)))
        return size * u * rng.choice([-1.0, 1.0], n) @ v

    for _ in range(count):
        links = np.exp(rng.uniform(np.log(45.0**2), np.log(350.0**2), 3))
        assert loop(gains, links, turned(covered, 3), turned(covered, 3), latency) < 1.0
    worst = [
        loop(
            gains,
            np.array([a**2, 350.0**2]),
            turned(4.0 * covered, 2),
            turned(4.0 * covered, 2),
            latency,
        )
        for a in np.geomspace(45.0, 350.0, 100)
    ]
    assert max(worst) > 1.0


@pytest.mark.oracle
def test_norms_are_those_of_the_continuous_response_where_sampling_is_fast(gains):
    """At low frequencies, with the input delayed by half a period, as its hold delays it."""
    link, kappa, beta = 100.0**2, gains.motor, gains.damping
    k = gains(link)[:5]
    for omega in (5.0, 40.0, 110.0, 250.0):
        s = 1j * omega
        held = (1 - np.exp(-s * PERIOD)) / (s * PERIOD)
        output = np.array([1.0, s, 0.0, 0.0, 1.0 / s]), np.array([0.0, 0.0, 1.0, s, 0.0])
        f = [-held * (k @ row) for row in output]  # f = f[0] z + f[1] w
        equations = np.array([
            [s**2 + link, -link], [-kappa - kappa * f[0], s**2 + beta * s + kappa - kappa * f[1]],
        ])  # fmt: skip
        z = np.linalg.solve(equations, np.eye(2))
        expected = np.abs([link * (z[1] - z[0]), kappa * (z[0] - z[1] + f[0] * z[0] + f[1] * z[1])])
        found = _norms(gains, link, 0, np.array([np.exp(s * PERIOD)]), None)[0]
        np.testing.assert_allclose(found, expected, rtol=0.03, atol=0.02)
    assert PIECES > 1


@pytest.mark.ci("searches many tolerances")
def test_faster_pairs_and_latency_leave_less(gains):
    plain, slow, fast = (error_tolerance(gains, fastest) for fastest in (350.0, 200.0, 600.0))
    late, later = (error_tolerance(gains, latency=latency) for latency in (1, 2))
    assert slow.constant > plain.constant > fast.constant
    assert plain.constant > late.constant > later.constant > 0.1
    for each in (plain, slow, fast, late, later):
        assert 0.05 < each.error <= each.constant
    finer = error_tolerance(gains, count=90)
    assert abs(finer.error / plain.error - 1.0) < 0.02
    assert abs(finer.constant / plain.constant - 1.0) < 0.02
