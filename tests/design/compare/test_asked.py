"""Every law is tuned to what was asked for, and judged by it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.design import Specification
from flexhinf.design.compare import Comparison, compare, verdict
from flexhinf.design.compare.asked import NOMINAL, WITHIN, specification_met
from flexhinf.design.compare.table import lines


@pytest.fixture(scope="module")
def arm() -> Comparison:
    """The paper's arm turned by a quarter within 60 V."""
    s = Specification(
        pose=(np.pi / 2,),
        start=(0.0,),
        degrees=(2,),
        rays=0,
        draws=4,
        extras=("inductance",),
        peak_effort=60.0,
    )
    return compare(fh.load_robot("paper"), s, ["pd", "lqr", "flatness"])


def test_the_target_is_the_asked_peak_and_every_law_is_there_or_told_to_miss_it(arm: Comparison) -> None:
    assert (arm.target.value, arm.target.origin) == (60.0, "peak_effort")
    for row in arm.others:
        assert row.tuned is not None
        peak = row.figures["step_peak_input"]
        assert row.tuned.response == pytest.approx(peak, rel=1e-6)
        assert row.tuned.met == (peak == pytest.approx(60.0, rel=0.02))
    assert "60 V (the limit that was asked for" in verdict(arm)


def test_the_reference_is_not_tuned(arm: Comparison) -> None:
    own = arm.reference.bench.step(arm.reference.step_duration).run.signals["input"]
    assert arm.first.figures["step_peak_input"] == pytest.approx(float(np.abs(own).max()), rel=1e-6)
    assert arm.first.figures["step_peak_input"] < 55.0  # type: ignore[operator]


def test_a_pd_within_the_limit_is_a_good_one(arm: Comparison) -> None:
    pd = arm.row("pd")
    assert pd is not None
    assert pd.tuned is not None
    assert pd.tuned.met
    assert pd.figures["step_overshoot_percent"] < 2.0  # type: ignore[operator]
    assert pd.figures["step_settling_s"] == pytest.approx(1.45, abs=0.1)
    assert pd.figures["unstable_corners"] == 0.0


def test_every_law_is_judged_by_overshoot_and_limit(arm: Comparison) -> None:
    for row in arm.compared:
        mets = specification_met(arm, row)
        assert [(met.what, met.where, met.asked) for met in mets] == [
            ("overshoot", NOMINAL, 5.0), ("peak input", NOMINAL, 60.0),
            ("overshoot", WITHIN, 5.0), ("peak input", WITHIN, 60.0),
        ]  # fmt: skip
        keys = (
            "step_overshoot_percent", "step_peak_input", "drawn_worst_overshoot_percent", "drawn_worst_peak_input",
        )  # fmt: skip
        for met, key in zip(mets, keys):
            assert met.found == row.figures[key]
            assert met.holds == (met.found <= 1.02 * met.asked)


def test_the_table_has_the_lines_of_the_specification(
    arm: Comparison, made: Callable[..., Comparison]
) -> None:
    labels = {line.label: line.cells for line in lines(arm, arm.compared)}
    assert set(labels["peak input ≤ 60 V"]) == {"met"}
    assert len(labels["overshoot ≤ 5 %, worst within the tolerances"]) == len(arm.compared)
    pd = arm.compared[1]
    assert pd.runs is not None
    tight = replace(arm.reference, specification=replace(arm.reference.specification, peak_effort=50.0))
    labels = {line.label: line.cells for line in lines(replace(arm, reference=tight), arm.compared)}
    assert labels["peak input ≤ 50 V"][1] == "not met"
    plain = made(["pd"], draws=0)
    assert [met.where for met in specification_met(plain, plain.rows[1])] == [NOMINAL]
