"""The criterion that laws are tuned for: stated before, relative to the design, never past a limit."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
from tests.refusals import refused_with, unnamed

from flexhinf.design.requirements.loop_margins import oscillation_requirements
from flexhinf.design.responses import joint_limits
from flexhinf.design.specification import Specification
from flexhinf.design.tuning import (
    Criterion,
    LawMetrics,
    criterion_for,
    metrics_of,
    pareto_front,
    stated_limits,
)
from flexhinf.errors import InvalidInput
from flexhinf.robot import load_robot

OWN = LawMetrics(1.8, 2.6, 0.2, 3.0, 3.0, 264.0, 1.5, 0.04, 0.009, 0.001)
STATED: dict[str, Any] = {"pose": "90deg", "peak_sensitivity": 2.0, "gain_margin": 2.0, "peak_effort": 264.0}


def limits_of(robot: str = "paper", **fields: Any) -> Any:
    arm, s = load_robot(robot), Specification(**{**STATED, **fields})
    return stated_limits(s, joint_limits(arm, s), "V")


def made(mode: str = "peak", own: LawMetrics = OWN, resolution: float = 0.0, **fields: Any) -> Criterion:
    return criterion_for(mode, own, 7.5, limits_of(**fields), resolution)


def value(criterion: Criterion, figure: str) -> float:
    return next(limit.value for limit in criterion.limits if limit.metric == figure)


def test_the_design_itself_has_one_and_keeps_its_own_limits() -> None:
    for mode in ("peak", "bandwidth", "none"):
        criterion = made(mode, bandwidth=3.0)
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
    criterion = made("peak", replace(OWN, remaining_error=1.5e-6), 1e-4)
    kept = replace(OWN, settling=0.5 * OWN.settling, move_error=0.5 * OWN.move_error, remaining_error=0.0466)
    assert criterion.ratios(kept)["remaining_error"] == pytest.approx(466.0)
    assert criterion.cost(kept) > 3.0
    assert criterion.cost(replace(kept, remaining_error=9e-5)) < 1.0


def test_an_error_that_no_sensor_shows_is_no_reason_to_win() -> None:
    """Behind an exact feedforward flatness had an error of 0.248 mrad and nl-hinf of 0.022: ten times in the mean."""
    criterion = made("peak", replace(OWN, move_error=2.3e-5), 1e-4)
    ratios = [
        criterion.ratios(replace(OWN, move_error=error))["move_error"] for error in (2e-6, 1e-4, 2.48e-4)
    ]
    assert ratios == pytest.approx([1.0, 1.0, 2.48])
    assert criterion.ratios(replace(OWN, load_deviation=0.02))["load_deviation"] == pytest.approx(0.5)
    assert math.isinf(criterion.cost(replace(OWN, move_error=math.inf)))
    assert unnamed(criterion.text, "0.1 mrad") == []


def test_every_limit_is_the_specification_s_whatever_the_design_does() -> None:
    """Old code took the noise, the peak and the margins of the design itself where they suited it: a PD was barred by a
    noise of 0.03 % of the motor's limit, of which 5 % are allowed."""
    stated = {"ripple": 1.0, "damping": 0.15, "delay_margin": 2.0, "bandwidth": 4.0}
    quiet, fragile = (
        replace(OWN, noise_percent=1e-3, peak_input=1.0, damping=0.9),
        LawMetrics(9.0, 1.1, 0.01, 80.0, 9.0),
    )
    for mode in ("peak", "bandwidth", "none"):
        assert made(mode, quiet, **stated).limits == made(mode, fragile, **stated).limits
    values = {limit.metric: (limit.value, limit.origin) for limit in limits_of(**stated).values()}
    assert values == {
        "peak_sensitivity": (2.0, "--set peak_sensitivity"), "gain_margin": (2.0, "--set gain_margin"),
        "damping": (0.15, "--damping"), "delay_margin": (2.0, "--set delay_margin"), "noise_percent": (1.0, "--ripple"),
        "peak_input": (264.0, "--peak-effort"), "bandwidth": (4.0, "--bandwidth"),
    }  # fmt: skip
    assert value(made(), "noise_percent") == 5.0
    assert value(made(), "damping") == 0.05  # as a requirement has it
    assert not any(limit.metric == "delay_margin" for limit in made(estimator="none").limits)
    unlimited = {limit.metric for limit in made(peak_effort=None).limits}
    assert unlimited == {"peak_sensitivity", "gain_margin", "damping", "delay_margin"}


def test_the_limit_of_damping_exempts_the_oscillations_that_the_requirement_exempts() -> None:
    """A vibration of 147 Hz with a ratio of 0.009 is "met" as a fast one; the limit of tuning judges the slow ones."""
    s = Specification(damping=0.2)
    asked: list[float] = []

    def about(below: float) -> tuple[float, float]:
        asked.append(below)
        return 0.4, 0.009

    margins: Any = SimpleNamespace(
        stable=True, peak_sensitivity=1.5, gain_margin=3.0, slowest_bandwidth=9.0, damping_about=about,
        delay_margin_within=lambda seconds: seconds,
    )  # fmt: skip
    setup = SimpleNamespace(specification=s, limits=SimpleNamespace(effort=[264.0]))
    evaluation: Any = SimpleNamespace(margins=margins, setup=setup, input_noises=None)
    far: Any = SimpleNamespace(is_far=lambda metrics: True)  # nothing is run
    found = metrics_of(evaluation, far)
    slow, fast = oscillation_requirements(s, margins, 0.2, ("", ""))[:2]
    assert (slow.found, fast.found, found.damping) == (0.4, 0.009, 0.4)
    assert slow.met
    assert fast.met
    assert made(damping=0.2).judge(replace(OWN, damping=found.damping)).excess == 0.0
    assert set(asked) == {s.damped_below_limit}


def test_a_law_keeps_a_limit_that_a_requirement_counts_as_met() -> None:
    """Within 2 %; but the least damping of all is exact."""
    assert made().judge(replace(OWN, peak_sensitivity=2.03, gain_margin=1.97)).excess == 0.0
    assert made().judge(replace(OWN, damping=0.0499)).excess > 0.0
    assert made(damping=0.2).judge(replace(OWN, damping=0.197)).excess == 0.0


def test_the_mode_says_what_limits_beside_the_margins() -> None:
    assert [limit.metric for limit in made("peak").shared] == ["peak_input"]
    assert [limit.metric for limit in made("bandwidth", bandwidth=2.0).shared] == ["bandwidth"]
    assert made("none").shared == ()
    with refused_with(InvalidInput, "peak", "bandwidth", "'overshoot'"):
        made("overshoot")
    with refused_with(InvalidInput, "bandwidth", "--tune peak", "--bandwidth"):
        made("bandwidth")


@pytest.mark.parametrize(
    ("changed", "name"),
    [
        ({"peak_sensitivity": 2.1}, "peak sensitivity"),
        ({"gain_margin": 1.9}, "gain margin"),
        ({"damping": 0.026}, "damping ratio"),
        ({"damping": -0.1}, "damping ratio"),
        ({"noise_percent": 5.2}, "noise at the motor"),
        ({"peak_input": 270.0}, "peak input"),
        ({"peak_input": math.inf}, "peak input"),
        ({"load_deviation": math.inf}, "diverges"),
        ({"peak_sensitivity": math.inf}, "peak sensitivity"),
    ],
)
def test_no_limit_may_be_exceeded_beyond_its_tolerance(changed: dict[str, float], name: str) -> None:
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
    assert made("bandwidth", bandwidth=3.0).is_far(replace(OWN, bandwidth=math.nan))
    assert made("bandwidth", bandwidth=3.0).is_far(replace(OWN, bandwidth=6.1))
    linear = LawMetrics(9.0, 1.1, 0.2, 0.02, 3.0)
    assert criterion.judge(linear).excess > 0.0
    assert math.isfinite(criterion.judge(linear).excess)


def test_what_does_not_settle_costs_more_than_what_does_and_keeps_the_limits() -> None:
    """The run has the design's own length: old code barred what was still on its way."""
    criterion = made()
    late, never = replace(OWN, settling=7.4), replace(OWN, settling=math.inf)
    assert criterion.cost(OWN) < criterion.cost(late) < criterion.cost(never) < math.inf
    assert criterion.judge(never).excess == 0.0


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
