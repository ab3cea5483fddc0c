"""The search for the worst disturbance of the paper's problem, with the norm of the linear loop as a bound."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from flexhinf.paper.loop_setup import PaperSettings, PaperSetup
from flexhinf.paper.responses import GainRuns


@pytest.fixture(scope="module")
def runs() -> GainRuns:
    setup = PaperSetup(PaperSettings())
    return GainRuns(setup, setup.nonlinear)


def wave(t: np.ndarray) -> np.ndarray:
    return np.exp(-t / 3.0) * np.sin(2.0 * t)


def held(runs: GainRuns, d: np.ndarray) -> Any:
    """Samples of the search as a function of time."""
    return lambda t: runs.search.on(t, d[:, 0])


@pytest.mark.slow
@pytest.mark.oracle
def test_small_disturbances_attain_the_norm_of_the_linear_loop(runs: GainRuns) -> None:
    setup = runs.setup
    part = setup.problem.expand(1)
    a, b1, b2, c = part.f_parts[1], part.g1_parts[0][..., 0], part.g2_parts[0][..., 0], part.h_parts[1]
    k = setup.linear.law(np.eye(5)).T
    closed, z = a + b2 @ k, np.vstack([c, np.sqrt(float(setup.problem.r2[0, 0])) * k])
    norm = max(
        np.linalg.norm(z @ np.linalg.solve(1j * w * np.eye(5) - closed, b1)) for w in np.logspace(-3, 3, 2001)
    )
    d = runs.search.ascend(wave(runs.search.search_runs.times)[:, None], 1e-4, 60)
    assert d is not None
    attained = runs.attained(held(runs, d))
    assert attained.energy == pytest.approx(1e-4, rel=1e-9)
    assert 0.98 * norm < attained.gain < 1.001 * norm < setup.gamma


def test_the_search_beats_its_start(runs: GainRuns) -> None:
    start = runs.search.scaled(wave(runs.search.search_runs.times)[:, None], 3.0)
    d = runs.search.ascend(start, 3.0, 10)
    assert d is not None
    assert runs.attained(held(runs, d)).gain > 1.01 * runs.attained(held(runs, start)).gain
