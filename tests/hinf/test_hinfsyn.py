"""γ* against python-control's `hinfsyn`, which wants a noisy measurement: y = x + ε n, in the limit ε → 0."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from flexhinf.hinf.linear_part import LinearPart, linear_smallest_gamma

pytestmark = [pytest.mark.oracle, pytest.mark.ci("imports python-control; mpmath says γ* too")]


def _hinfsyn(linear: LinearPart, noise: float) -> float:
    """The level `hinfsyn` reaches with inputs (d, n, v) and outputs (h, v, y)."""
    pytest.importorskip("slycot", reason="missing: slycot, which has no wheel for every machine")
    control = pytest.importorskip("control")
    n, md, m, s = len(linear.a), linear.b1.shape[1], linear.b2.shape[1], len(linear.c)
    inputs = np.hstack([linear.b1, np.zeros((n, n)), linear.b2])
    outputs = np.vstack([linear.c, np.zeros((m, n)), np.eye(n)])
    direct = np.zeros((s + m + n, md + n + m))
    direct[s : s + m, md + n :], direct[s + m :, md : md + n] = np.eye(m), noise * np.eye(n)
    return control.hinfsyn(control.ss(linear.a, inputs, outputs, direct), n, m)[2]


@pytest.mark.parametrize("pose", ["hanging", "upright"])
def test_limit_of_vanishing_noise_is_our_level(arm, pose):
    """The excess is proportional to ε; extrapolated from two levels of noise it agrees to 1e-7."""
    linear = LinearPart.of(arm.expand(1))
    if pose == "upright":
        gravity = np.zeros_like(linear.a)
        gravity[1, 0] = 2 * 9.8
        linear = replace(linear, a=linear.a + gravity)
    expected = linear_smallest_gamma(linear)
    coarse, fine = _hinfsyn(linear, 1e-3), _hinfsyn(linear, 1e-4)
    assert 1e-3 < coarse / expected - 1 < 2e-3
    assert fine / expected - 1 == pytest.approx((coarse / expected - 1) / 10, rel=1e-2)
    assert (10 * fine - coarse) / 9 == pytest.approx(expected, rel=1e-7)


def test_random_plant(random_plant):
    linear = LinearPart.of(random_plant(np.random.default_rng(0), 3).expand(1))
    expected = linear_smallest_gamma(linear)
    coarse, fine = _hinfsyn(linear, 1e-3), _hinfsyn(linear, 1e-4)
    assert fine == pytest.approx(expected, rel=2e-4)
    assert abs(fine - expected) <= abs(coarse - expected) + 1e-8 * expected
