"""Exported C where sensors give nothing at times: the bits of `Controller.step`."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.baselines import lqr
from flexhinf.codegen.machine import host

ARM = fh.paper_arm()
NOISE = np.array([[1e-6, 6e-7], [6e-7, 4e-6]])
GIVEN = {"process_noise": 1e-8, "measurement_noise": NOISE, "mean": np.zeros(4), "covariance": 1e-4}
KINDS = {
    "ukf": fh.UnscentedKalmanFilter,
    "ukf, rows": partial(fh.UnscentedKalmanFilter, form="square_root"),
    "ekf": fh.ExtendedKalmanFilter,
    "ekf, rows": partial(fh.ExtendedKalmanFilter, form="square_root"),
}


def controller(kind: str, **options: Any) -> fh.Controller:
    """Integral action on a link that has an encoder, as its motor has."""
    filter = KINDS[kind](ARM.plant(("link_position", "motor_position")), 1e-3, **GIVEN)
    return fh.Controller(lqr(ARM.problem()), filter, 1e-3, 48.0, **options)


def samples(count: int, gap: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Measurements of which each element is missing at times, sometimes both, or the whole sample."""
    rng = np.random.default_rng(4)
    time = 1e-3 * np.arange(count)[:, None]
    y = 0.1 * np.sin(3.0 * time) + 1e-3 * rng.normal(size=(count, 2))
    y[rng.random((count, 2)) < 0.3] = gap
    y[:3], y[3, 0] = gap, gap
    return y, np.full((count, 1), 0.1), (rng.random(count) > 0.1).astype(int)


@pytest.mark.oracle
@pytest.mark.parametrize("gap", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("kind", KINDS)
def test_the_exported_step_does_without_what_is_missing(
    kind: str, gap: float, build: Callable[..., Any]
) -> None:
    stepped = controller(kind, offset_time=0.05 if gap == np.inf else None)
    y, r, measured = samples(400, gap)
    u, x, codes = build(stepped).replay(y, r, measured, 1, 4)
    assert set(codes.tolist()) == {0, 5, 7}
    assert codes[:4].tolist() == [7, 7, 7, 0]
    for k, there in enumerate(measured):
        expected = stepped.step(np.where(np.isfinite(y[k]), y[k], np.nan) if there else None, r[k])
        np.testing.assert_allclose(u[k], expected, rtol=1e-9, atol=1e-9)
        if host().fused:
            np.testing.assert_array_equal(u[k], expected)
        if k >= 3:
            np.testing.assert_allclose(x[k], stepped.estimate, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_in_float_it_does_without_them_too(kind: str, build: Callable[..., Any]) -> None:
    stepped = controller(kind)
    y, r, measured = samples(400, np.nan)
    u, _, codes = build(stepped, "float").replay(y, r, measured, 1, 4)
    expected = [stepped.step(value if there else None, 0.1) for value, there in zip(y, measured, strict=True)]
    assert set(codes.tolist()) == {0, 5, 7}
    assert np.abs(u - expected).max() < 1e-2 * np.abs(expected).max()
