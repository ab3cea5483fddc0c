"""The interval of a success rate: Clopper's and Pearson's, by its definition in exact rationals."""

from __future__ import annotations

import math
import tracemalloc
from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from flexhinf.campaign import sensitivity, success_interval
from flexhinf.campaign.metrics import MetricLimit
from flexhinf.campaign.results import CampaignJudgement
from flexhinf.errors import InvalidInput


def tail(count: int, p: float, least: int) -> Fraction:
    """Probability of `least` successes or more of so many, exactly."""
    q = Fraction(p)
    return sum(
        (math.comb(count, k) * q**k * (1 - q) ** (count - k) for k in range(least, count + 1)), Fraction(0)
    )


@pytest.mark.parametrize(
    ("successes", "count"), [(1, 2), (3, 7), (9, 10), (19, 20), (17, 64), (1, 64), (63, 64)]
)
@pytest.mark.parametrize("confidence", [0.95, 0.8])
def test_each_end_is_the_rate_at_which_such_a_count_has_half_of_the_doubt(successes, count, confidence):
    found, half = success_interval(successes, count, confidence), 0.5 * (1.0 - confidence)
    assert float(tail(count, found.low, successes)) == pytest.approx(half, rel=1e-10)
    assert float(1 - tail(count, found.high, successes + 1)) == pytest.approx(half, rel=1e-10)
    assert (found.low, found.high) == pytest.approx(
        (
            stats.beta.ppf(half, successes, count - successes + 1),
            stats.beta.ppf(1.0 - half, successes + 1, count - successes),
        ),
        rel=1e-10,
    )
    assert found.low < found.rate < found.high


@pytest.mark.parametrize("count", [1, 7, 100, 2000, 100_000])
def test_the_ends_without_and_with_nothing_but_successes(count):
    """(α/2)^(1/n), in closed form; Wilson's interval begins at 1/(1 + z²/n) instead."""
    low = 0.025 ** (1.0 / count)
    every, none = success_interval(count, count), success_interval(0, count)
    assert (every.low, every.high) == pytest.approx((low, 1.0), rel=1e-12)
    assert (none.low, none.high) == pytest.approx((0.0, 1.0 - low), rel=1e-9)
    assert every.confidence == 0.95


@pytest.mark.parametrize("count", [5, 12, 30])
def test_it_covers_every_rate_as_often_as_it_says(count):
    """For each rate: the probability of the counts whose interval holds it is at least 95 %, exactly."""
    ends = [success_interval(k, count) for k in range(count + 1)]
    for p in [0.001, 0.02, 0.1, 0.27, 0.5, 0.731, 0.95, 0.9999]:
        inside = [k for k in range(count + 1) if ends[k].low <= p <= ends[k].high]
        assert sum(stats.binom.pmf(inside, count, p)) >= 0.95 - 1e-12


@pytest.mark.parametrize(("successes", "count"), [(-1, 3), (4, 3), (0, 0)])
def test_what_is_no_fraction_is_refused(successes, count):
    with pytest.raises(InvalidInput, match=f"fraction(?s:.)* {successes} of {count}"):
        success_interval(successes, count)


@pytest.mark.parametrize(("weights", "offset"), [((1.0,), 0.0), ((1.0, 3.0), 0.0), ((2.0, -1.0, 3.0), 1e3)])
def test_a_sum_has_the_sensitivities_of_its_weights(weights, offset):
    """Independent numbers of one distribution: shares of the squares of their weights, whatever is added."""
    numbers, names = np.random.default_rng(0).uniform(-1.0, 1.0, (400, len(weights))), "abc"[: len(weights)]
    found = sensitivity(names, numbers, offset + numbers @ weights)
    shares = dict(zip(names, np.square(weights) / np.square(weights).sum()))
    assert found.names == tuple(sorted(names, key=lambda name: -shares[name]))
    expected = [shares[name] for name in found.names]
    assert found.first == pytest.approx(expected, abs=0.03)
    assert found.total == pytest.approx(expected, abs=0.03)
    assert found.r_squared == pytest.approx(1.0)
    assert sensitivity(names, numbers, np.full(400, offset)) is None


def test_any_number_of_samples_is_fitted_in_the_same_memory_as_by_all_rows_at_once():
    """R² of the folds by NumPy's least squares over all rows, whose terms take 11 MB more for 6,000 rows more."""
    rng, names, peaks = np.random.default_rng(1), [f"n{k}" for k in range(20)], list[int]()
    x = rng.standard_normal((9000, 20))
    y = 5.0 + x[:, 0] + 0.3 * x[:, 1] ** 2 + 0.2 * x[:, 2] * x[:, 3] + 0.1 * rng.standard_normal(9000)
    for count in (3000, 9000):
        tracemalloc.start()
        found = sensitivity(names, x[:count], y[:count])
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] - peaks[0] < 4 * 8 * 6000 * 20  # the numbers themselves, a few times
    z = (x - x.mean(axis=0)) / x.std(axis=0)
    pairs = np.triu_indices(20, 1)
    terms = np.hstack([np.ones((9000, 1)), z, z**2, z[:, pairs[0]] * z[:, pairs[1]]])
    fold, errors = np.arange(9000) % 5, np.empty(9000)
    for k in range(5):
        here = fold == k
        errors[here] = y[here] - terms[here] @ np.linalg.lstsq(terms[~here], y[~here], rcond=None)[0]
    assert found.r_squared == pytest.approx(1.0 - np.mean(errors**2) / np.var(y), abs=1e-12)


@pytest.mark.parametrize(("limit", "worst"), [("damping<=0.5", 3), ("damping>=0.5", 1), ("other>=0.5", 3)])
def test_the_worst_sample_is_the_farthest_from_what_is_required(limit, worst):
    columns = {
        "sample": np.arange(4), "status": np.array(["completed"] * 4), "other": np.zeros(4),
        "damping": np.array([0.5, 0.1, np.nan, 0.9]),
    }  # fmt: skip
    table = SimpleNamespace(
        columns=columns,
        settings={},
        journal=SimpleNamespace(about={}),
        names=lambda kind: ["damping", "other"],
    )
    judged = CampaignJudgement(table, (MetricLimit.of(limit, ["damping", "other"]),))
    assert judged.worst("damping") == judged.worst_of_all == worst
