"""The search for a law's parameters against problems whose answer is known, and against a loop."""

from __future__ import annotations

import re
from collections.abc import Mapping
from math import inf, log

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.analysis import Judgement, excess, minimise
from flexhinf.analysis.optimiser import bisected
from flexhinf.baselines import MotorPD, lqr
from flexhinf.errors import InvalidInput, NumericalFailure
from flexhinf.loop import Controller, Loop

BOUNDS = {"a": (0.01, 100.0), "b": (0.01, 100.0)}


@pytest.mark.oracle
def test_the_smallest_cost_is_found_over_all_parameters() -> None:
    """(ln a − 1)² + (ln b + 0.5)²: a tuning of one parameter alone ends at 0.25 or more."""
    found = minimise(
        lambda p: Judgement((log(p["a"]) - 1.0) ** 2 + (log(p["b"]) + 0.5) ** 2), {"a": 1.0, "b": 1.0}, BOUNDS,
        96,
    )  # fmt: skip
    assert found.best.feasible
    np.testing.assert_allclose(
        [log(found.best.parameters["a"]), log(found.best.parameters["b"])], [1.0, -0.5], atol=0.02
    )


@pytest.mark.oracle
def test_a_limit_is_approached_and_never_exceeded() -> None:
    """min 1/a + 1/b with a·b ≤ 9: a = b = 3."""

    def judge(p: Mapping[str, float]) -> Judgement:
        return Judgement(1.0 / p["a"] + 1.0 / p["b"], {"a b > 9": excess(p["a"] * p["b"], 9.0)})

    found = minimise(judge, {"a": 1.0, "b": 1.0}, BOUNDS, 136)
    a, b = found.best.parameters["a"], found.best.parameters["b"]
    assert a * b <= 9.0
    assert found.best.judgement.cost == pytest.approx(2.0 / 3.0, rel=0.03)


def test_a_candidate_without_an_answer_is_infeasible_and_keeps_its_reason() -> None:
    """A loop that cannot be linearised is no loop with the smallest sensitivity."""

    reason = "The loop does not rest with this plant."

    def judge(p: Mapping[str, float]) -> Judgement:
        if p["a"] < 1.0:
            raise NumericalFailure(reason, "", "")
        return Judgement(p["a"])

    found = minimise(judge, {"a": 2.0}, {"a": (0.01, 100.0)})
    assert found.best.parameters["a"] >= 1.0
    assert found.best.judgement.cost == pytest.approx(1.0, rel=0.05)
    failed = [c for c in found.candidates if not c.feasible]
    assert failed
    assert {c.judgement.reason for c in failed} == {reason}


def test_where_no_limit_can_be_kept_the_nearest_is_told() -> None:
    found = minimise(
        lambda p: Judgement(1.0, {"too large": excess(p["a"] + 1.0 / p["a"], 0.5)}),
        {"a": 5.0},
        {"a": (0.1, 10.0)},
    )
    assert not found.best.feasible
    assert found.best.judgement.reason == "too large"
    assert found.best.parameters["a"] == pytest.approx(1.0, rel=0.05)


def test_bounds_hold_and_the_start_is_the_first_candidate() -> None:
    found = minimise(lambda p: Judgement(-p["a"]), {"a": 2.0}, {"a": (1.0, 3.0)})
    assert found.candidates[0].parameters == {"a": 2.0}
    assert all(1.0 - 1e-12 <= c.parameters["a"] <= 3.0 + 1e-12 for c in found.candidates)
    assert found.best.parameters["a"] == pytest.approx(3.0)


def test_a_search_is_the_same_each_time_and_within_its_counts() -> None:
    runs = [
        minimise(lambda p: Judgement(p["a"] / p["b"]), {"a": 1.0, "b": 1.0}, BOUNDS, 18) for _ in range(2)
    ]
    assert [c.parameters for c in runs[0].candidates] == [c.parameters for c in runs[1].candidates]
    assert len(runs[0].candidates) <= 1 + 18
    alone = minimise(lambda p: Judgement(1.0), {}, {})
    assert len(alone.candidates) == 1


def test_excess_is_in_logarithms_above_the_limit_only() -> None:
    assert excess(1.9, 2.0) == 0.0
    assert excess(2.0 * np.e, 2.0) == pytest.approx(1.0)
    assert excess(inf, 2.0) == excess(np.nan, 2.0) == inf
    assert excess(0.0, 2.0) == excess(1.8, inf) == 0.0
    assert excess(2.0 * (1.0 + 1e-12), 2.0) == 0.0  # a limit that is the design's own value, computed again
    assert excess(2.0 * (1.0 + 1e-6), 2.0) == pytest.approx(1e-6, rel=1e-5)


@pytest.mark.parametrize(
    "wrong",
    [
        {"start": {"a": -1.0}},
        {"start": {"b": 1.0}},
        {"bounds": {"a": (2.0, 3.0)}},
        {"bounds": {"a": (0.0, 3.0)}},
        {"budget": -1},
    ],
)
def test_a_search_that_is_not_well_posed_is_refused(wrong: dict) -> None:
    settings = {"start": {"a": 1.0}, "bounds": {"a": (0.1, 10.0)}, **wrong}
    with pytest.raises(InvalidInput, match=re.escape(f"{settings['start']}, {settings['bounds']}, ")):
        minimise(lambda p: Judgement(1.0), **settings)


def test_what_a_search_ends_with_another_may_begin_with() -> None:
    """exp(ln(1e4)) is 1e4 and a rounding: old code refused it as a start outside its bounds."""
    bounds = {"a": (1e-4, 1e4)}
    found = minimise(lambda values: Judgement(1.0 / values["a"], {}), {"a": 1.0}, bounds, 40)
    assert found.best.parameters == {"a": 1e4}
    assert minimise(lambda values: Judgement(1.0, {}), dict(found.best.parameters), bounds, 1).candidates


def test_candidates_that_are_given_are_tried_within_the_bounds() -> None:
    others = [{"a": 7.0, "b": 0.3}, {"a": 1e6, "b": 1.0}]
    found = minimise(lambda p: Judgement(1.0), {"a": 1.0, "b": 1.0}, BOUNDS, 0, others)
    tried = [c.parameters for c in found.candidates]
    assert tried[0] == pytest.approx({"a": 1.0, "b": 1.0})
    assert tried[1:] == [pytest.approx(others[0]), pytest.approx({"a": 100.0, "b": 1.0})]


@pytest.mark.oracle
@pytest.mark.parametrize("kind", ["pd", "lqr"])
def test_two_laws_use_up_the_same_peak_voltage_and_no_more(kind: str) -> None:
    """With a cost that falls with the peak, the tuned law peaks just below the limit in a loop of our own."""
    robot = fh.load_robot("paper")
    problem, plant = robot.problem(), robot.plant()
    goal = np.concatenate(robot.operating_point([np.pi / 2]))

    def peak(k: float) -> float:
        law = MotorPD.tuned(problem, k, 0.7) if kind == "pd" else lqr(problem, effort=k)
        run = Loop(plant, Controller(law, None, moving=True)).run(goal, duration=1.0)
        return float(np.abs(run.signals["input"]).max())

    def judge(p: Mapping[str, float]) -> Judgement:
        value = peak(p["k"])
        return Judgement(1.0 / value, {f"peak {value:.3g} V": excess(value, 60.0)})

    start = 3.0 if kind == "pd" else 1.0
    found = minimise(judge, {"k": start}, {"k": (start / 1e4, start * 1e4)})
    assert found.best.feasible
    assert 57.0 < peak(found.best.parameters["k"]) <= 60.0


def test_the_path_has_every_candidate_that_was_the_best_when_tried() -> None:
    found = minimise(
        lambda p: Judgement(abs(log(p["a"] / 20.0)) + abs(log(p["b"]))), {"a": 1.0, "b": 3.0}, BOUNDS
    )
    best, path = inf, []
    for candidate in found.candidates:
        if candidate.judgement.cost < best:
            best = candidate.judgement.cost
            path.append(candidate)
    assert found.path == path
    assert found.best is path[-1]


def test_no_excess_is_traded_for_cost() -> None:
    """One limit is kept at a > 10 alone; the cost pulls the other way."""

    def judge(p: Mapping[str, float]) -> Judgement:
        return Judgement(p["a"] / 10.0, {"a < 10": excess(10.0, p["a"])})

    found = minimise(judge, {"a": 1.0}, {"a": (0.1, 100.0)})
    assert found.best.feasible
    assert found.best.parameters["a"] == pytest.approx(10.0, rel=0.05)
    assert [candidate.feasible for candidate in found.path] == sorted(c.feasible for c in found.path)


@pytest.mark.parametrize("relative", [True, False])
def test_bisection_ends_at_the_last_value_that_is_accepted(relative: bool) -> None:
    tried: list[float] = []

    def accepts(x: float) -> str:
        tried.append(x)
        return f"{x}" if x * x <= 2.0 else ""

    value, outcome = bisected(accepts, 1.0, 2.0, 1e-9, relative)
    assert value == pytest.approx(np.sqrt(2.0), rel=1e-9)
    assert value <= np.sqrt(2.0)
    assert outcome == f"{value}"
    assert len(tried) <= 31
    assert bisected(lambda x: False, 1.0, 2.0, 0.01, relative) == (1.0, None)
