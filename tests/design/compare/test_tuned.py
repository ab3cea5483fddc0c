"""Laws are tuned to what the reference costs, or does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.baselines import MotorPD
from flexhinf.design.compare import Comparison, tuned
from flexhinf.design.compare.linear import sensitivity_at_rest
from flexhinf.design.compare.makers import maker_of
from flexhinf.design.compare.reference import reference_of
from flexhinf.design.compare.tuned import Target, target_of, tuned_law
from flexhinf.errors import InvalidInput, NumericalFailure
from flexhinf.loop import Controller, Loop


@pytest.fixture(scope="module")
def reference(asked: Callable[..., Any]) -> Any:
    return reference_of(fh.load_robot("vertical-rig"), asked(saturation=0.25), lambda text: None)


def own_peak(reference: Any, law: Any) -> float:
    """Of the step as the law is commanded, by a loop of our own: the same noise, no limits."""
    bench = reference.bench
    begin = "bumpless" if any(name.endswith("_integral") for name in law.state_names) else "zero"
    estimator, s = bench.estimator(bench.start), bench.specification
    controller = Controller(law, estimator, s.period, moving=True, start=begin)
    x, u = bench.rest(bench.start)
    run = Loop(bench.true_plant, controller).run(
        duration=1.5, initial_state=x, initial_input=u, noise=bench.noise, seed=s.seed
    )  # fmt: skip
    return float(np.abs(run.signals["input"]).max())


def asking(reference: Any, **options: Any) -> Any:
    """The same reference, its specification with other limits."""
    return replace(reference, specification=replace(reference.specification, **options))


def test_the_target_is_the_asked_peak_or_the_limit_or_the_peak_of_the_reference(reference: Any) -> None:
    own = pytest.approx(own_peak(reference, reference.synthesis.law), rel=1e-9)
    cases = [
        ({"peak_effort": 0.3}, 0.3, "peak_effort"),
        ({}, 0.25, "saturation"),
        ({"saturation": None}, own, "reference"),
    ]
    for options, value, origin in cases:
        target = target_of("peak", asking(reference, **options))
        assert (target.value, target.origin, target.share) == (value, origin, 1.0)
        assert target.own == own


def test_the_bandwidth_is_the_asked_one_or_that_of_the_reference(reference: Any) -> None:
    own = target_of("bandwidth", reference)
    assert (own.origin, own.own) == ("reference", own.value)
    asked = target_of("bandwidth", asking(reference, bandwidth=(3.5,)))
    assert (asked.value, asked.origin, asked.own) == (3.5, "bandwidth", own.value)


@pytest.mark.parametrize(
    "name", ["hinf", "nlqr", "lqr", "lqr-gravity", "pd", "torque", "flatness", "nl-hinf-6"]
)
def test_every_law_gets_there(reference: Any, name: str) -> None:
    target = target_of("peak", reference)
    found = tuned_law(maker_of(name, reference), target)
    assert found.met
    assert found.response == pytest.approx(target.value, rel=0.02)
    assert own_peak(reference, found.law) == pytest.approx(target.value, rel=0.02)


def test_more_price_is_less_input_and_more_bandwidth_is_more(reference: Any) -> None:
    for name, sign in (("lqr", -1.0), ("hinf", -1.0), ("pd", 1.0), ("flatness", 1.0)):
        maker = maker_of(name, reference)
        low, high = (own_peak(reference, maker.law(maker.start * factor)) for factor in (0.7, 1.4))
        assert sign * (high - low) > 0.0


def test_at_price_one_a_law_of_the_design_s_degree_is_the_design_s(reference: Any) -> None:
    own = reference.synthesis.solution
    np.testing.assert_allclose(maker_of("nl-hinf-4", reference).law(1.0).law_data, own.law_data, rtol=1e-12)
    linear = maker_of("hinf", reference).law(1.0)
    np.testing.assert_allclose(linear.gain, own.gain, rtol=1e-9)


@pytest.mark.parametrize("preset", ["damped", "robust"])
def test_the_level_moves_with_the_price(asked: Callable[..., Any], preset: str) -> None:
    reference = reference_of(fh.load_robot("vertical-rig"), asked(preset=preset), lambda text: None)
    maker = maker_of("hinf", reference)
    near, own = maker.law(1.0 + 1e-6), maker.law(1.0)
    np.testing.assert_allclose(near.gain, own.gain, rtol=1e-4)  # type: ignore[attr-defined]
    assert maker.law(10.0).gamma > own.gamma > maker.law(0.1).gamma  # type: ignore[attr-defined]
    found = tuned_law(maker, Target("peak", 1.2 * own_peak(reference, own), 1.0, reference))
    assert found.met


def test_a_target_out_of_reach_is_said_with_the_best_found(reference: Any) -> None:
    """A PD must hold the arm up before it moves: less than that peak there is not."""
    near = target_of("peak", reference)
    out_of_reach = Target("peak", 0.05 * float(near.value or 0.0), 1.0, reference)
    found = tuned_law(maker_of("pd", reference), out_of_reach)
    assert not found.met
    assert found.reason
    assert found.response == pytest.approx(own_peak(reference, found.law), rel=1e-6)


def test_no_law_is_tuned_to_an_unstable_loop(asked: Callable[..., Any]) -> None:
    """With a long delay the peak of the reference asks for gains that the loop does not bear."""
    reference = reference_of(fh.load_robot("vertical-rig"), asked(delay=0.03), lambda text: None)
    target = Target("peak", 8.0, 1.0, reference)
    for name in ("pd", "flatness"):
        found = tuned_law(maker_of(name, reference), target)
        assert not found.met
        assert "unstable" in found.reason
        assert sensitivity_at_rest(reference.bench, found.law) <= max(20.0, target.sensitivity)


def test_no_law_is_tuned_to_the_edge_of_stability(reference: Any) -> None:
    """A PD with an integral takes little input until it is nearly unstable: it is told to miss, not driven there."""
    target = target_of("peak", asking(reference, peak_effort=2.0))
    assert target.sensitivity < 5.0
    maker = maker_of("pid", reference)
    found = tuned_law(maker, target)
    assert not found.met
    assert "unstable, or near it" in found.reason
    assert sensitivity_at_rest(maker.bench, found.law) <= 5.0


def test_by_bandwidth(made: Callable[..., Comparison]) -> None:
    """The weight moved with the command makes even a soft PD faster than the design: it is told to miss."""
    result = made(["pd", "flatness"], "bandwidth", draws=0)
    wanted = result.target.value
    assert wanted == pytest.approx(result.first.figures["bandwidth_rad_s"])
    for row in result.others:
        assert row.tuned is not None
        assert row.figures["bandwidth_rad_s"] == pytest.approx(row.tuned.response)
        near = row.tuned.response == pytest.approx(wanted, rel=0.02)
        assert row.tuned.met == near == (row.name == "flatness")


def test_untuned_laws_are_as_they_start(reference: Any) -> None:
    target = target_of("none", reference)
    found = tuned_law(maker_of("pd", reference), target)
    expected = MotorPD.tuned(reference.problem, float(reference.bandwidth[0]), 1.0)
    np.testing.assert_allclose(found.law.law_data, expected.law_data)
    assert found.response is None


def test_a_reference_that_does_not_survive_is_tuned_on_a_shorter_step(
    reference: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    reference = asking(reference, saturation=None)
    bench = reference.bench

    def peak(bench_: Any, law: Any, duration: float, begin: np.ndarray) -> float:
        return np.inf if abs(begin[0] - bench.goal[0]) > 0.3 else 2.0

    monkeypatch.setattr(tuned, "_peak", peak)
    target = target_of("peak", reference)
    assert target.share == 0.5
    np.testing.assert_allclose(target.begin, bench.goal + 0.5 * (bench.start - bench.goal))
    monkeypatch.setattr(tuned, "_peak", lambda *arguments: np.inf)
    with pytest.raises(NumericalFailure, match="--from-pose"):
        target_of("peak", reference)


def test_there_are_three_ways_to_tune(reference: Any) -> None:
    with pytest.raises(InvalidInput, match="peak, bandwidth, none"):
        target_of("overshoot", reference)


def test_with_many_states_the_linear_part_is_tuned_and_the_law_itself_is_told(
    reference: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    from flexhinf.design.compare import makers

    monkeypatch.setattr(makers, "MANY_STATES", 4)
    maker = maker_of("nlqr", reference)
    assert maker.by_linear_part
    found = tuned_law(maker, target_of("peak", reference))
    assert found.law.degree == 4
    assert found.response == pytest.approx(own_peak(reference, found.law), rel=1e-6)
    robust = replace(reference)
    assert not maker_of("lqr", robust).by_linear_part
