"""Every claim at the default settings and at others: criterion, verdict, and what shows it."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import pytest

from flexhinf.paper.claims import attained_gain, bounded, electrical_pole, tolerances, ukf_against_ekf
from flexhinf.paper.loop_setup import PaperSettings, PaperSetup
from flexhinf.report import Table, to_json

pytestmark = pytest.mark.paper

MODULES = (electrical_pole, attained_gain, tolerances, bounded, ukf_against_ekf)


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
    judged = module.judge(PaperSetup(PaperSettings(period=0.02, **options)))
    assert judged.claim.verdict in ("holds", "fails", "ties", "not judged")
    assert judged.claim.criterion
    assert all(block.html() for block in judged.blocks)
    assert to_json(judged.numbers)


@pytest.mark.slow
def test_the_gain_stays_below_gamma_near_rest_only(setup: PaperSetup) -> None:
    judged = attained_gain.judge(setup)
    rows: list[Any] = list(next(block for block in judged.blocks if isinstance(block, Table)).rows)
    inside = [row for row in rows if row[2] is not None and row[2] <= 180.0]
    assert max(row[5] for row in inside) == pytest.approx(1.43, abs=0.02)
    assert all(row[3] <= setup.gamma for row in inside)
    assert any(row[3] is None or row[3] > setup.gamma for row in rows)
