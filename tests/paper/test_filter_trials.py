"""The paired trials of filters: consistent where model and noise match, equal on a linear plant."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2
from tests.tiers import ci_and_night

from flexhinf.paper.estimators import FilterTrial, run_trial
from flexhinf.paper.loop_setup import PaperSettings, PaperSetup

RUNS = 60
VOLTS = 20.0 * np.sin(np.arange(300)[:, None] * 0.02)


@pytest.fixture(scope="module")
def trial() -> FilterTrial:
    model = PaperSetup(PaperSettings()).model
    return FilterTrial("matched", model, 0.01, 1e-6, (1e-6,), (0.1, 0.1, 0.1, 0.1), {})


def test_right_covariances_where_everything_matches(trial: FilterTrial) -> None:
    for scores in run_trial(trial, VOLTS, RUNS, seed=1):
        spread = scores.nees.std(ddof=1) / math.sqrt(RUNS)
        assert abs(scores.nees.mean() - 4.0) < 4.0 * spread < 1.0


def test_a_wrong_stiffness_shows(trial: FilterTrial) -> None:
    wrong = replace(trial, changes={"stiffness": 112.0})
    for right, off in zip(run_trial(trial, VOLTS, 20, 1), run_trial(wrong, VOLTS, 20, 1), strict=True):
        assert off.nees.mean() > 2.0 * right.nees.mean()
        assert off.squared[:, 1].mean() > 2.0 * right.squared[:, 1].mean()


def test_both_are_the_kalman_filter_without_gravity(trial: FilterTrial) -> None:
    linear = replace(trial, model=trial.model.with_parameters(gravity=0.0))
    ukf, ekf = run_trial(linear, VOLTS, 5, seed=2)
    assert np.allclose(ukf.squared, ekf.squared, rtol=1e-9, atol=0.0)
    assert np.allclose(ukf.nees, ekf.nees, rtol=1e-6)


def test_seeds_are_paired_and_matter(trial: FilterTrial) -> None:
    one, again, other = (run_trial(trial, VOLTS, 3, seed)[0].squared for seed in (1, 1, 2))
    assert np.array_equal(one, again)
    assert not np.allclose(one, other)
    assert not np.allclose(one[0], one[1])


@pytest.mark.oracle
@pytest.mark.parametrize("period", ci_and_night("21 sets of 200 runs", [1e-2], [1e-3, 5e-2]))
def test_nees_of_200_runs_is_chi_squared(trial: FilterTrial, period: float) -> None:
    """At the end of 2 s within the 95 % band in 17 of 20 sets at least, and never with a wrong stiffness."""
    runs, n, steps = 200, 4, round(2.0 / period)
    volts = 20.0 * np.sin(np.arange(steps)[:, None] * 2.0 * period)
    low, high = chi2.ppf((0.025, 0.975), runs * n)
    right = replace(trial, period=period, initial=(0.01,) * n, form="square_root")
    totals = np.array([
        [scores.nees_of_samples[:, -1].sum() for scores in run_trial(right, volts, runs, seed)]
        for seed in range(20)
    ])  # fmt: skip
    assert np.all(np.sum((low < totals) & (totals < high), axis=0) >= 17)
    low, high = chi2.ppf((0.0005, 0.9995), 20 * runs * n)
    assert np.all((low < totals.sum(axis=0)) & (totals.sum(axis=0) < high))
    for scores in run_trial(replace(right, changes={"stiffness": 112.0}), volts, runs, seed=0):
        assert scores.nees_of_samples[:, -1].sum() > 1.1 * totals.max()


@pytest.mark.ci("a trial of both forms")
def test_both_forms_err_alike(trial: FilterTrial) -> None:
    for one, other in zip(
        run_trial(trial, VOLTS, 5, 1), run_trial(replace(trial, form="square_root"), VOLTS, 5, 1), strict=True
    ):
        np.testing.assert_allclose(other.squared, one.squared, rtol=1e-6)
        np.testing.assert_allclose(other.nees_of_samples, one.nees_of_samples, rtol=1e-6)
        np.testing.assert_allclose(one.nees, one.nees_of_samples.mean(axis=1), rtol=1e-12)


def test_a_start_elsewhere_is_that_of_truth_and_filters(trial: FilterTrial) -> None:
    """Without gravity errors depend on no position."""
    free = replace(trial, model=trial.model.with_parameters(gravity=0.0))
    ukf, _ = run_trial(free, VOLTS, 3, 4)
    moved, _ = run_trial(replace(free, mean=(1.0, 0.0, 1.0, 0.0)), VOLTS, 3, 4)
    np.testing.assert_allclose(moved.squared, ukf.squared, rtol=1e-9)
