"""The paired trials of filters: consistent where model and noise match, equal on a linear plant."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from flexhinf.paper.estimators import Trial, run_trial
from flexhinf.paper.loop_setup import PaperSettings, PaperSetup

RUNS = 60
VOLTS = 20.0 * np.sin(np.arange(300)[:, None] * 0.02)


@pytest.fixture(scope="module")
def trial() -> Trial:
    model = PaperSetup(PaperSettings()).model
    return Trial("matched", model, 0.01, 1e-6, (1e-6,), (0.1, 0.1, 0.1, 0.1), {})


def test_right_covariances_where_everything_matches(trial: Trial) -> None:
    for scores in run_trial(trial, VOLTS, RUNS, seed=1):
        spread = scores.nees.std(ddof=1) / math.sqrt(RUNS)
        assert abs(scores.nees.mean() - 4.0) < 4.0 * spread < 1.0


def test_a_wrong_stiffness_shows(trial: Trial) -> None:
    wrong = replace(trial, changes={"stiffness": 112.0})
    for right, off in zip(run_trial(trial, VOLTS, 20, 1), run_trial(wrong, VOLTS, 20, 1), strict=True):
        assert off.nees.mean() > 2.0 * right.nees.mean()
        assert off.squared[:, 1].mean() > 2.0 * right.squared[:, 1].mean()


def test_both_are_the_kalman_filter_without_gravity(trial: Trial) -> None:
    linear = replace(trial, model=trial.model.with_parameters(gravity=0.0))
    ukf, ekf = run_trial(linear, VOLTS, 5, seed=2)
    assert np.allclose(ukf.squared, ekf.squared, rtol=1e-9, atol=0.0)
    assert np.allclose(ukf.nees, ekf.nees, rtol=1e-6)


def test_seeds_are_paired_and_matter(trial: Trial) -> None:
    one, again, other = (run_trial(trial, VOLTS, 3, seed)[0].squared for seed in (1, 1, 2))
    assert np.array_equal(one, again)
    assert not np.allclose(one, other)
    assert not np.allclose(one[0], one[1])
