"""Exported C where sensors give nothing at times, or jump by a turn: the bits of `Controller.step`."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.builders import FILTERS
from tests.estimation import test_angles
from tests.tiers import ci_and_night

import flexhinf as fh
from flexhinf.baselines import lqr
from flexhinf.export import compile_controller

# What is compiled makes some hundred samples: two thirds of the time.
pytestmark = pytest.mark.usefixtures("unoptimised")

ARM = fh.paper_arm()
NOISE = np.array([[1e-6, 6e-7], [6e-7, 4e-6]])
GIVEN = {"process_noise": 1e-8, "measurement_noise": NOISE, "mean": np.zeros(4), "covariance": 1e-4}
KINDS = ("ukf", "ukf, rows", "ekf", "ekf, rows")


def controller(kind: str, gate: float | None = None, **options: Any) -> fh.Controller:
    """Integral action on a link that has an encoder, as its motor has."""
    filter = FILTERS[kind](ARM.plant(("link_position", "motor_position")), 1e-3, **GIVEN, gate=gate)
    return fh.Controller(lqr(ARM.problem()), filter, 1e-3, 48.0, **options)


def samples(count: int, gap: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Measurements of which each element is missing at times, sometimes both, or the whole sample."""
    rng = np.random.default_rng(4)
    time = 1e-3 * np.arange(count)[:, None]
    y = 0.1 * np.sin(3.0 * time) + 1e-3 * rng.normal(size=(count, 2))
    y[rng.random((count, 2)) < 0.3] = gap
    y[:3], y[3, 0] = gap, gap
    return y, np.full((count, 1), 0.1), (rng.random(count) > 0.1).astype(int)


@pytest.mark.ci("compiles a step for each kind")
@pytest.mark.oracle
@pytest.mark.parametrize(
    ("kind", "offset_time"), [("ukf", None), ("ukf, rows", 0.05), ("ekf", 0.05), ("ekf, rows", None)]
)
def test_the_exported_step_does_without_what_is_missing(
    kind: str, offset_time: float | None, build: Callable[..., Any]
) -> None:
    stepped = controller(kind, offset_time=offset_time)
    y, r, measured = samples(400, np.nan)
    y[np.isnan(y)] = np.resize([np.nan, np.inf, -np.inf], np.isnan(y).sum())
    u, x, codes = build(stepped).replay(y, r, measured, 1, 4)
    assert set(codes.tolist()) == {0, 5, 7}
    assert codes[:4].tolist() == [7, 7, 7, 0]
    for k, there in enumerate(measured):
        expected = stepped.step(np.where(np.isfinite(y[k]), y[k], np.nan) if there else None, r[k])
        np.testing.assert_array_equal(u[k], expected)
        if k >= 3:
            np.testing.assert_allclose(x[k], stepped.estimate, rtol=1e-9, atol=1e-12)


@pytest.mark.ci("compiles and steps four filters in float")
@pytest.mark.parametrize("kind", KINDS)
def test_in_float_it_does_without_them_too(kind: str, build: Callable[..., Any]) -> None:
    stepped = controller(kind)
    y, r, measured = samples(400, np.nan)
    u, _, codes = build(stepped, "float").replay(y, r, measured, 1, 4)
    expected = [stepped.step(value if there else None, 0.1) for value, there in zip(y, measured, strict=True)]
    assert set(codes.tolist()) == {0, 5, 7}
    assert np.abs(u - expected).max() < 1e-2 * np.abs(expected).max()


@pytest.mark.ci("compiles a controller of each filter")
@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.parametrize("kind", ["ukf", "ukf, rows", "ekf"])
def test_the_exported_step_counts_the_turns_of_an_angle(kind: str, build: Callable[..., Any]) -> None:
    stepped = test_angles.controller(FILTERS[kind], 3.0)
    y = test_angles.wrapped(3.0 + 0.02 * np.arange(400.0))[:, None]
    y[::9] = np.nan
    r = np.full((400, 1), 4.0)
    u, x, _ = build(stepped).replay(y, r, np.ones(400, dtype=int), 1, 2)
    assert x[-1, 0] > 3.0 * np.pi
    for k in range(400):
        np.testing.assert_array_equal(u[k], stepped.step(y[k], 4.0))


@pytest.mark.oracle
@pytest.mark.parametrize(
    "kind", ci_and_night("compiles a step and a library", ["ukf, rows", "ekf"], ["ukf", "ekf, rows"])
)
def test_the_exported_step_rejects_and_counts_outliers(
    kind: str, build: Callable[..., Any], compiler: str, tmp_path: Path
) -> None:
    stepped = controller(kind, gate=0.9999)
    y, r, measured = samples(400, np.nan)
    rng = np.random.default_rng(1)
    wild = rng.random((400, 2)) < 0.05
    y[wild] = rng.choice([-1.0, 1.0], wild.sum()) * 10.0 ** rng.uniform(0, 6, wild.sum())
    compiled = build(stepped)
    u, _, _ = compiled.replay(y, r, measured, 1, 4)
    library = fh.load_compiled(compile_controller(stepped, tmp_path / "arm.so"))
    for k, there in enumerate(measured):
        expected = stepped.step(y[k] if there else None, r[k])
        np.testing.assert_array_equal(u[k], expected)
        np.testing.assert_array_equal(library.step(y[k] if there else None, r[k]), expected)
        np.testing.assert_array_equal(library.rejected, stepped.rejected)
    assert stepped.rejected.min() >= 5
    (tmp_path / "counts.c").write_text(
        """
#include <stdio.h>
#include "arm.h"
int main(void)
{
    static arm_state state;
    arm_output output;
    const arm_input first = {.y = {0, 0}, .measured = 1}, wild = {.y = {0, 1e3}, .measured = 1};
    output.rejected[1] = 7;
    arm_step(&state, &arm_defaults, &first, &output);
    printf("%d ", output.rejected[1]);
    arm_init(&state);
    arm_step(&state, &arm_defaults, &first, &output);
    arm_step(&state, &arm_defaults, &wild, &output);
    arm_step(&state, &arm_defaults, &wild, &output);
    printf("%d %d", output.rejected[0], output.rejected[1]);
    return 0;
}
"""
    )
    folder = compiled.folder
    flags = ("-std=c99", "-Wall", "-Wextra", "-Werror", f"-I{folder}")
    subprocess.run(
        [compiler, *flags, "counts.c", folder / "arm.c", "-lm", "-o", "counts"], cwd=tmp_path, check=True
    )
    shown = subprocess.run(["./counts"], cwd=tmp_path, check=True, capture_output=True, text=True).stdout
    assert shown == "0 0 2"
