"""Electrical pole, attained gain, tolerances with their repair, bounded UKF, UKF against EKF."""

from __future__ import annotations

import math
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from flexhinf.loop import Step
from flexhinf.paper.bench import PaperBench
from flexhinf.paper.claims import attained_gain, bounded, electrical_pole, repair, tolerances, ukf_against_ekf
from flexhinf.paper.settings import PaperSettings
from flexhinf.paper.tolerance_sweep import ALL_STATES, GOALS, VELOCITIES, Case, ToleranceSweep, population_of
from flexhinf.report import Table, to_json

pytestmark = pytest.mark.paper

MODULES = (electrical_pole, attained_gain, tolerances, bounded, ukf_against_ekf)


@pytest.fixture(scope="module")
def bench() -> PaperBench:
    return PaperBench(PaperSettings())


@pytest.mark.parametrize(
    ("module", "claim", "verdict"),
    [
        (electrical_pole, "electrical-pole-negligible", "holds"),
        pytest.param(attained_gain, "gain-attained", "holds", marks=pytest.mark.slow),
        pytest.param(tolerances, "withstands-tolerances", "fails", marks=pytest.mark.slow),
        (bounded, "ukf-bounded", "holds"),
        (ukf_against_ekf, "ukf-better-than-ekf", "ties"),
    ],
)
def test_verdicts_at_the_default_settings(
    bench: PaperBench, module: ModuleType, claim: str, verdict: str
) -> None:
    judged = module.judge(bench)
    assert (judged.claim.id, judged.claim.verdict) == (claim, verdict)
    anchors = [name for block in judged.blocks for name in block.ids()]
    assert set(judged.claim.figures) == set(anchors)
    assert all(block.html() for block in judged.blocks)
    assert to_json(judged.numbers)


@pytest.mark.parametrize("module", MODULES)
@pytest.mark.parametrize(
    "options",
    [
        pytest.param({"estimator": "none", "process_noise": 0.0}, id="true-state"),
        pytest.param(
            {"gamma_ratio": 1.0001, "measurement_noise": 1.0}, id="diverging", marks=pytest.mark.slow
        ),
    ],
)
def test_any_settings_are_judged(module: ModuleType, options: dict) -> None:
    judged = module.judge(PaperBench(PaperSettings(period=0.02, **options)))
    assert judged.claim.verdict in ("holds", "fails", "ties", "not judged")
    assert all(block.html() for block in judged.blocks)
    assert to_json(judged.numbers)


@pytest.mark.slow
def test_the_gain_stays_below_gamma_near_rest_only(bench: PaperBench) -> None:
    judged = attained_gain.judge(bench)
    rows: list[Any] = list(next(block for block in judged.blocks if isinstance(block, Table)).rows)
    inside = [row for row in rows if row[2] is not None and row[2] <= 180.0]
    assert max(row[5] for row in inside) == pytest.approx(1.43, abs=0.02)
    assert all(row[3] <= bench.gamma for row in inside)
    assert any(row[3] is None or row[3] > bench.gamma for row in rows)


def test_the_two_forms_of_process_noise(bench: PaperBench) -> None:
    sweep = ToleranceSweep(bench, bench.nonlinear)
    stiff = [bench.arm.corner({"stiffness": 1.0})]
    assert sweep.rates(Case(ALL_STATES, 1e-6), math.pi / 2, stiff)[0] < -0.1
    assert sweep.rates(Case(VELOCITIES, 1e-6), math.pi / 2, stiff)[0] > 0.05
    assert sweep.rates(Case("true state fed back"), math.pi / 2, stiff)[0] < -0.1


def test_the_repair_withstands_other_plants_and_is_the_smallest(bench: PaperBench) -> None:
    weights = repair.repaired_penalty(bench)
    assert weights is not None
    found = repair.repairs(bench)["both forms of R^v"]
    assert found is not None
    assert found.weights == weights
    rng = np.random.default_rng(99)
    others = [bench.arm.corner(list(s)) for s in rng.choice([-1.0, 1.0], (200, 11))]
    repaired = ToleranceSweep(bench, bench.law(weights))
    weaker = ToleranceSweep(bench, bench.law(repair.scaled_weights(bench, 0.8 * found.scale)))
    cases = [
        (Case(form, q), goal)
        for form in (ALL_STATES, VELOCITIES)
        for q in (1e-8, 1e-7, 1e-2)
        for goal in GOALS
    ]
    assert max(repaired.rates(*case, others).max() for case in cases) < 0.0
    assert max(weaker.rates(*case, others).max() for case in cases) > 0.0


def test_the_repaired_arm_still_steps(bench: PaperBench) -> None:
    law = bench.law(repair.repaired_penalty(bench))
    for goal in GOALS:
        ours, paper = (bench.run(k, Step(goal), 8.0).metrics for k in (law, bench.nonlinear))
        assert ours["overshoot_percent"] < paper["overshoot_percent"]
        assert ours["peak_input"] < paper["peak_input"]
        assert ours["settling_time_s"] < 1.2 * paper["settling_time_s"]


def test_the_population_is_within_the_tolerances(bench: PaperBench) -> None:
    population = population_of(bench)
    assert [int((population.kinds == k).sum()) for k in ("draw", "corner", "single", "nominal")] == [
        100,
        400,
        22,
        1,
    ]
    for p in bench.arm.uncertain:
        low, high = p.interval
        values = np.array([v[p.name] for v in population.values])
        assert (values.min(), values.max()) == pytest.approx((low, high))
        drawn = values[population.kinds == "draw"]
        assert np.all((drawn > low) & (drawn < high))
        assert np.ptp(drawn) > 0.8 * (high - low)
    assert population.describe(522) == "nominal"
