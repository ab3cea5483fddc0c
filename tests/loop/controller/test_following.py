"""Joints that do not follow their command, and joints that hunt: said at once, and held without a jump of the input."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from tests.loop.conftest import LinearLaw, arm_law, arm_ukf, two_inputs

import flexhinf as fh

# Kernels that run once each.
pytestmark = pytest.mark.usefixtures("unoptimised")

#: Two joints with integrals, as positions, velocities and integrals; the velocities are zero at rest.
JOINTS = LinearLaw(
    ("a", "b", "a_velocity", "b_velocity", "a_integral", "b_integral"),
    ("u", "v"),
    [[-30.0, 2.0, -8.0, 0.5, -40.0, 1.0], [1.0, -20.0, 0.0, -5.0, 0.0, -30.0]],
)


def commands(moving: bool, samples: int) -> np.ndarray:
    """Positions that move and come to rest; of a moving reference with velocities and inputs."""
    time = np.minimum(1e-3 * np.arange(samples), 0.3)
    going = (np.arange(samples) < 300).astype(float)
    if not moving:
        return 0.5 * time[:, None]
    return np.stack([time, -time, going, -going, 3.0 + time, 1.0 - time], axis=1)


def made(moving: bool, **options: Any) -> fh.Controller:
    watch = fh.Supervision(**options) if options else None
    return fh.Controller(
        JOINTS if moving else two_inputs()[1], None, 1e-3, 60.0, moving=moving, supervision=watch
    )


@pytest.mark.parametrize("moving", [False, True])
def test_a_following_error_holds_the_robot_where_it_is_without_a_jump(moving: bool) -> None:
    """Joints stand still while the command goes on: from the sample after the error exceeds its limit, the input is
    that of a controller that is told the pose, and a part that continues the last input and decays."""
    limit, samples = 0.1, 500
    held = made(moving, following=limit, reactions={"following": "hold"}, braking_time=0.2)
    plain = made(moving)
    rng, frozen, ease, last, first = np.random.default_rng(2), None, np.zeros(2), np.zeros(2), None
    for k, r in enumerate(commands(moving, samples)):
        x = np.array([0.02, 0.01, 0.0, 0.0]) + 1e-4 * rng.standard_normal(4)
        lost = bool(held.status & fh.Status.FOLLOWING_ERROR)
        if lost and frozen is None:
            first = k
            frozen = np.concatenate([x[:2], np.zeros(2), r[4:]]) if moving else x[:1]
            other = plain.step(x, frozen)
            ease = last - other
        else:
            other, ease = plain.step(x, r if frozen is None else frozen), math.exp(-1e-3 / 0.2) * ease
        u = held.step(x, r)
        assert u == pytest.approx(other + ease, abs=1e-12)
        assert np.array_equal(u, other) or frozen is not None
        apart = np.abs(
            x[: 2 if moving else 1]
            - (r[: 2 if moving else 1] if frozen is None else frozen[: 2 if moving else 1])
        )
        assert bool(held.status & fh.Status.FOLLOWING_ERROR) == bool((apart > limit).any())
        assert bool(held.status & fh.Status.REACTING) == (frozen is not None)
        if k == first:
            assert np.array_equal(u, last)
        last = u
    assert first is not None
    held.reset()
    assert held.step(np.zeros(4), commands(moving, 1)[0]) is not None
    assert held.status == fh.Status(0)


def test_a_robot_that_is_not_where_the_controller_begins_is_noticed_at_the_first_sample() -> None:
    """The offset that is taken in slowly hides it from the law, not from the status."""
    for away, said in ((0.19, False), (0.21, True)):
        one = fh.Controller(
            arm_law(), arm_ukf(), 1e-3, latency=1, offset_time=0.5, supervision=fh.Supervision(following=0.2)
        )
        one.step([away], 0.0)
        assert bool(one.status & fh.Status.FOLLOWING_ERROR) == said


@pytest.mark.parametrize(("size", "said"), [(1.5e-3, True), (0.9e-3, False)])
def test_a_joint_that_hunts_is_a_limit_cycle_whatever_its_input(size: float, said: bool) -> None:
    """±1.5 mrad at 5 Hz, which is some per cent of a tenth of the input's limit; ±0.9 mrad is less than is stated."""
    watch = fh.Supervision(position_swing=2e-3, reactions={})
    one = fh.Controller(two_inputs()[1], None, 1e-3, 100.0, supervision=watch)
    bits = []
    for k in range(6000):
        one.step([0.2 + size * math.sin(10.0 * math.pi * 1e-3 * k), 0.0, 0.0, 0.0], 0.2)
        bits.append(bool(one.status & fh.Status.LIMIT_CYCLE))
    assert any(bits) == said
    most = watch.data(one.limits, 1, 1e-3)["swings"][2, -1]
    assert not any(bits[: int(100 * (most - 2))])
