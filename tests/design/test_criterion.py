"""The criterion that laws are tuned for: stated before, relative to the design, never past a limit."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest
from tests.refusals import refused_with, unnamed

from flexhinf.design.tuning import Criterion, LawMetrics, criterion_for, pareto_front
from flexhinf.errors import InvalidInput

OWN = LawMetrics(1.8, 2.6, 0.2, 0.03, 3.0, 264.0, 1.5, 0.04, 0.009, 0.001)
LIMITS: dict[str, Any] = {"peak_sensitivity": (2.0, "default"), "gain_margin": (2.0, "default")}


def made(mode: str = "peak", own: LawMetrics = OWN, **limits: Any) -> Criterion:
    return criterion_for(mode, own, 7.5, {**LIMITS, **limits}, "V")


def value(criterion: Criterion, figure: str) -> float:
    return next(limit.value for limit in criterion.limits if limit.metric == figure)


def test_the_design_itself_has_one_and_keeps_its_own_limits() -> None:
    for mode in ("peak", "bandwidth", "none"):
        criterion = made(mode)
        assert criterion.cost(OWN) == pytest.approx(1.0)
        assert criterion.judge(OWN).excess == 0.0


def test_the_cost_is_the_geometric_mean_of_four_ratios() -> None:
    other = replace(OWN, load_deviation=0.02, settling=3.0, move_error=0.018, remaining_error=0.008)
    criterion = made()
    assert criterion.ratios(other) == pytest.approx(
        {"load_deviation": 0.5, "settling": 2.0, "move_error": 2.0, "remaining_error": 8.0}
    )
    assert criterion.cost(other) == pytest.approx(2.0)


def test_an_error_that_a_law_keeps_for_ever_counts() -> None:
    """Old code left it out: a PD that kept 46.6 mrad for ever tied with a law that kept none."""
    criterion = criterion_for("peak", replace(OWN, remaining_error=1.5e-6), 7.5, LIMITS, "V", 1e-4)
    kept = replace(OWN, settling=0.5 * OWN.settling, move_error=0.5 * OWN.move_error, remaining_error=0.0466)
    assert criterion.ratios(kept)["remaining_error"] == pytest.approx(466.0)
    assert criterion.cost(kept) > 3.0
    assert criterion.cost(replace(kept, remaining_error=9e-5)) < 1.0


def test_an_error_that_no_sensor_shows_is_no_reason_to_win() -> None:
    """Behind an exact feedforward flatness had an error of 0.248 mrad and nl-hinf of 0.022: ten times in the mean."""
    criterion = criterion_for("peak", replace(OWN, move_error=2.3e-5), 7.5, LIMITS, "V", 1e-4)
    ratios = [
        criterion.ratios(replace(OWN, move_error=error))["move_error"] for error in (2e-6, 1e-4, 2.48e-4)
    ]
    assert ratios == pytest.approx([1.0, 1.0, 2.48])
    assert criterion.ratios(replace(OWN, load_deviation=0.02))["load_deviation"] == pytest.approx(0.5)
    assert math.isinf(criterion.cost(replace(OWN, move_error=math.inf)))
    assert unnamed(criterion.text, "0.1 mrad") == []


def test_a_limit_is_the_wider_of_the_stated_one_and_the_design_s_own() -> None:
    """Rivals get what the design takes for itself, and no less than the specification allows."""
    criterion = made(peak_input=(60.0, "--peak-voltage"))
    assert (value(criterion, "peak_sensitivity"), value(criterion, "gain_margin")) == (2.0, 2.0)
    assert value(criterion, "peak_input") == 264.0
    assert "--peak-voltage: 60" in criterion.text
    fragile = made(own=replace(OWN, peak_sensitivity=3.7, gain_margin=1.4))
    assert (value(fragile, "peak_sensitivity"), value(fragile, "gain_margin")) == (3.7, 1.4)
    assert value(made(peak_input=(400.0, "--peak-voltage")), "peak_input") == 400.0
    assert value(made(), "input_noise") == 0.03
    assert value(made(), "damping") == 0.1
    assert value(made(own=replace(OWN, damping=0.001)), "damping") == 0.001
    assert value(made(damping=(0.15, "--damping")), "damping") == 0.15
    late, limit = replace(OWN, delay_margin=0.7), {"delay_margin": (1.0, "default")}
    assert value(made(own=late, **limit), "delay_margin") == 0.7
    assert value(made(own=replace(late, delay_margin=1.0), **limit), "delay_margin") == 1.0
    assert made(own=late, **limit).judge(replace(late, delay_margin=0.6)).excess > 0.0
    assert not any(each.metric == "delay_margin" for each in made(own=late).limits)


def test_the_mode_says_what_is_shared() -> None:
    assert [limit.metric for limit in made("peak").shared] == ["peak_input"]
    assert [limit.metric for limit in made("bandwidth", bandwidth=(2.0, "--bandwidth")).shared] == [
        "bandwidth"
    ]
    assert value(made("bandwidth"), "bandwidth") == 3.0
    assert made("none").shared == ()
    with refused_with(InvalidInput, "peak", "bandwidth", "'overshoot'"):
        made("overshoot")


def test_a_design_that_diverges_gives_nothing_to_share() -> None:
    lost = replace(OWN, peak_input=math.inf)
    with pytest.raises(InvalidInput, match="--start"):
        made(own=lost)
    assert value(made(own=lost, peak_input=(60.0, "--peak-voltage")), "peak_input") == 60.0


@pytest.mark.parametrize(
    ("changed", "name"),
    [
        ({"peak_sensitivity": 2.1}, "peak sensitivity"),
        ({"gain_margin": 1.9}, "gain margin"),
        ({"damping": 0.026}, "damping ratio"),
        ({"damping": -0.1}, "damping ratio"),
        ({"input_noise": 0.031}, "noise at the motor"),
        ({"peak_input": 265.0}, "peak input"),
        ({"settling": math.inf}, "settles"),
        ({"peak_input": math.inf}, "peak input"),
        ({"load_deviation": math.inf}, "diverges"),
        ({"peak_sensitivity": math.inf}, "peak sensitivity"),
    ],
)
def test_no_limit_may_be_exceeded_by_any_amount(changed: dict[str, float], name: str) -> None:
    """Old code drove a loop to a peak sensitivity of 20, and had none at all for one it could not linearise."""
    judgement = made().judge(replace(OWN, **changed))
    assert judgement.excess > 0.0
    assert name in judgement.reason


def test_a_loop_without_a_gain_limit_is_not_held_against_a_law() -> None:
    assert made().judge(replace(OWN, gain_margin=math.inf)).excess == 0.0
    assert made().judge(replace(OWN, damping=math.nan)).excess == 0.0


def test_only_what_is_far_beyond_a_limit_is_not_run_further() -> None:
    criterion = made()
    assert not criterion.is_far(replace(OWN, peak_sensitivity=2.4))
    assert criterion.is_far(replace(OWN, peak_sensitivity=2.6))
    assert not criterion.is_far(replace(OWN, peak_input=math.nan))  # before the step is run
    assert not criterion.is_far(replace(OWN, peak_input=1.2 * OWN.peak_input))
    assert criterion.is_far(replace(OWN, peak_input=1.3 * OWN.peak_input))
    assert criterion.is_far(replace(OWN, peak_input=math.inf))
    assert made("bandwidth").is_far(replace(OWN, bandwidth=math.nan))
    assert made("bandwidth").is_far(replace(OWN, bandwidth=6.1))
    linear = LawMetrics(9.0, 1.1, 0.2, 0.02, 3.0)
    assert criterion.judge(linear).excess > 0.0
    assert math.isfinite(criterion.judge(linear).excess)


def test_what_does_not_settle_costs_more_than_what_does() -> None:
    criterion = made()
    late, never = replace(OWN, settling=7.4), replace(OWN, settling=math.inf)
    assert criterion.cost(OWN) < criterion.cost(late) < criterion.cost(never) < math.inf


def test_a_front_has_what_no_other_beats_within_the_linear_limits() -> None:
    def at(volts: float, sag: float, **changed: float) -> LawMetrics:
        return replace(OWN, peak_input=volts, load_deviation=sag, **changed)

    kept = [at(100.0, 0.05), at(300.0, 0.03), at(200.0, 0.06), at(50.0, 0.08)]
    beyond = [
        at(90.0, 0.01, peak_sensitivity=9.0),
        at(math.inf, math.inf),
        LawMetrics(1.5, 3.0, 0.3, 0.01, 3.0),
    ]
    front = pareto_front([*kept, *beyond], made())
    assert [(f.peak_input, f.load_deviation) for f in front] == [(50.0, 0.08), (100.0, 0.05), (300.0, 0.03)]


def test_the_text_states_the_criterion_and_every_limit() -> None:
    criterion = made()
    for word in ("load", "settling time", "jerk-limited", "peak sensitivity", "gain margin"):
        assert word in criterion.text
    assert all(limit.text in criterion.text for limit in criterion.limits)
