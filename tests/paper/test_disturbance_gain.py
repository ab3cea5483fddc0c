"""The search for the worst disturbance of the paper's problem, with the norm of the linear loop as a bound."""

from __future__ import annotations

import numpy as np
import pytest

from flexhinf.analysis import DisturbanceSearch
from flexhinf.paper.loop_setup import PaperSettings, PaperSetup
from flexhinf.paper.responses import HORIZON


@pytest.fixture(scope="module")
def setup() -> PaperSetup:
    return PaperSetup(PaperSettings())


@pytest.fixture(scope="module")
def search(setup: PaperSetup) -> DisturbanceSearch:
    return DisturbanceSearch(setup.problem, setup.nonlinear, None, setup.settings.period, HORIZON)


def wave(t: np.ndarray) -> np.ndarray:
    return np.exp(-t / 3.0) * np.sin(2.0 * t)


@pytest.mark.ci("climbs sixty times to the worst disturbance")
@pytest.mark.oracle
def test_small_disturbances_attain_the_norm_of_the_linear_loop(
    setup: PaperSetup, search: DisturbanceSearch
) -> None:
    part = setup.problem.expand(1)
    a, b1, b2, c = part.f_parts[1], part.g1_parts[0][..., 0], part.g2_parts[0][..., 0], part.h_parts[1]
    k = setup.linear.law(np.eye(5)).T
    closed, z = a + b2 @ k, np.vstack([c, np.sqrt(float(setup.problem.r2[0, 0])) * k])
    norm = max(
        np.linalg.norm(z @ np.linalg.solve(1j * w * np.eye(5) - closed, b1)) for w in np.logspace(-3, 3, 2001)
    )
    d = search.ascend(wave(search.search_runs.times)[:, None], 1e-4, 60)
    assert d is not None
    attained = search.attained(d)
    assert attained.energy == pytest.approx(1e-4, rel=1e-9)
    assert 0.98 * norm < attained.gain < 1.001 * norm < setup.gamma


def test_the_search_beats_its_start(search: DisturbanceSearch) -> None:
    start = search.scaled(wave(search.search_runs.times)[:, None], 3.0)
    d = search.ascend(start, 3.0, 10)
    assert d is not None
    assert search.attained(d).gain > 1.01 * search.attained(start).gain
