"""Two campaigns on the same samples: differences, intervals, extremes, success and failure; what is refused."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from tests.campaign.conftest import OPTIONS, made_loop, tolerances
from tests.refusals import refused_with

from flexhinf.campaign import Campaign, McNemar, Sample, compare, drive, run_campaign
from flexhinf.campaign.journal import Journal
from flexhinf.campaign.results import PairedMetric
from flexhinf.errors import InvalidInput

STIFF = (90.0, 14.0, 100.0)


def found(gain=(60.0, 12.0, 100.0), samples: Any = 40, **changes: Any):
    options = {"seed": 1, **OPTIONS, **changes}
    return run_campaign(made_loop(gain), options.pop("draw", tolerances()), samples, **options)


def test_two_laws_on_the_same_samples():
    a, b = found(), found(STIFF)
    limit = float(np.median(a.peak_input))
    paired = compare(a, b, [f"peak_input<={limit!r}"])
    one = paired.metric("peak_input")
    expected = b.peak_input.values - a.peak_input.values
    np.testing.assert_array_equal(one.differences, expected)
    assert one.median == np.sort(expected)[19]
    assert one.extremes == (None, expected.argmin())  # the stiffer law never needs more here
    fails = a.peak_input.values > limit, b.peak_input.values > limit
    assert paired.success.failures == (fails[0].sum(), fails[1].sum())
    assert 0 < paired.success.only_a == (fails[0] & ~fails[1]).sum()
    assert {name: paired.a.columns[name][3] for name in paired.a.names("parameter")} == {
        "mass": float(a.mass[3]), "stiffness": float(a.stiffness[3]),
    }  # fmt: skip


def test_tables_on_disk_say_what_datasets_say(tmp_path):
    sides = []
    for name, gain in (("a", (60.0, 12.0, 100.0)), ("b", STIFF)):
        campaign = Campaign(made_loop(gain), tolerances(), 40, 1, OPTIONS, batch=16)
        sides.append(drive(campaign, Journal.opened(tmp_path / name, campaign)))
    one, other = compare(*sides), compare(found(), found(STIFF))
    assert one.success == other.success
    for name in other.metrics:
        np.testing.assert_array_equal(one.metric(name).differences, other.metric(name).differences)


@pytest.mark.oracle
def test_the_interval_of_the_median_is_that_of_the_sign_test():
    """Ten differences: the second and the ninth, with 97.85 % (Conover, Practical Nonparametric Statistics, A3)."""
    differences = np.array([3.0, -1.0, 0.5, 2.5, 7.0, -math.inf, 4.0, 1.0, math.inf, 2.0])
    one = PairedMetric("m", "", np.zeros(10), differences)
    assert one.interval == (-1.0, 7.0)
    assert one.median == 2.0
    assert PairedMetric("m", "", np.zeros(5), differences[:5]).interval == pytest.approx(
        (math.nan,) * 2, nan_ok=True
    )


@pytest.mark.oracle
def test_mcnemar_counts_pairs_in_which_one_fails():
    assert McNemar(5, 1, 9, 85).p_value == pytest.approx(2 * (1 + 10) / 2**10)
    assert McNemar(5, 0, 0, 95).p_value == 1.0
    assert McNemar(5, 1, 9, 85).failures == (6, 14)


@pytest.mark.ci("many random samples")
def test_the_interval_holds_as_often_as_it_says():
    """Skewed differences: 400 samples of 40, each with its median 0 in the interval or not."""
    rng = np.random.default_rng(0)
    draws = rng.exponential(size=(400, 40)) - math.log(2.0)
    ends = np.array([PairedMetric("m", "", np.zeros(40), row).interval for row in draws])
    assert ((ends[:, 0] <= 0.0) & (ends[:, 1] >= 0.0)).mean() > 0.93


def test_runs_without_an_end_are_worse_and_never_is_equal_to_never():
    inf, nan = math.inf, math.nan
    one = PairedMetric(
        "settling_time_s", "s", np.array([1.0, inf, inf, nan, 2.0]), np.array([2.0, 3.0, inf, 1.0, inf])
    )
    assert one.pairs.tolist() == [0, 1, 2, 4]
    assert one.differences.tolist() == [1.0, -inf, 0.0, inf]
    assert [share.successes for share in one.better] == [2, 1]
    assert one.extremes == (4, 1)
    upside = PairedMetric("m", "", one.a, one.b, largest_is_best=True)
    assert [share.successes for share in upside.better] == [1, 2]


def test_what_nobody_would_see_is_no_difference():
    a = np.array([1.0, 2e-9, 3.0, 0.0])
    one = PairedMetric("m", "", a, a + np.array([5e-5, 1e-9, -1e-3, 0.0]))
    assert one.differences == pytest.approx([0.0, 1e-9, -1e-3, 0.0], rel=1e-6)


def test_a_run_that_diverges_loses_against_one_that_does_not():
    a, b = found(), found().copy(deep=True)
    b["status"][4] = "diverged"
    b["peak_input"][4] = math.nan
    paired = compare(a, b)
    one = paired.metric("peak_input")
    assert one.differences[4] == math.inf
    assert (np.delete(one.differences, 4) == 0.0).all()
    assert one.extremes == (4, None)
    assert paired.success == McNemar(0, 0, 1, 39)
    a["status"][4] = "diverged"
    assert 4 not in compare(a, b).metric("peak_input").pairs


def test_a_run_that_diverges_is_the_worst_for_metrics_of_which_more_is_better_too():
    a, b = found(), found().copy(deep=True)
    b["status"][4] = "diverged"
    one = compare(a, b, ["peak_input>=0"]).metric("peak_input")
    assert one.differences[4] == -math.inf
    assert one.extremes == (None, 4) or one.extremes == (4, None)
    assert (np.delete(one.differences, 4) == 0.0).all()


def test_samples_that_are_not_the_same_are_refused():
    a = found()
    for changes, what in (
        ({"seed": 2}, "seed: 1 ↔ 2"),
        ({"samples": 30}, "samples: 40 ↔ 30"),
        ({"noise": 2e-3}, "noise: 0.001 ↔ 0.002"),
        ({"duration": 0.3}, "duration: 0.4 ↔ 0.3"),
        ({"draw": tolerances("sobol")}, "method: random ↔ sobol"),
        ({"draw": lambda rng: Sample({"mass": 1.0 + 0.1 * rng.uniform()})}, "numbers|draw"),
    ):
        with pytest.raises(InvalidInput, match=what):
            compare(a, found(**changes))
    with refused_with(InvalidInput, "campaigns", "Dataset", 3):
        compare(a, 3)  # type: ignore[arg-type]
    with pytest.raises(InvalidInput, match="metric 'overshot'"):
        compare(a, a, ["overshot<=3"])
    with refused_with(InvalidInput, "campaigns", "'mass'"):
        compare(a, a).metric("mass")
