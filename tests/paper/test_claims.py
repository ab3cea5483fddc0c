"""Every claim at the default settings and at others: criterion, verdict, and what shows it."""

from __future__ import annotations

from typing import Any

import pytest

from flexhinf.paper.estimators import UKF
from flexhinf.paper.loop_setup import PaperSettings, PaperSetup, StatedClaim, judge
from flexhinf.paper.responses import GAIN, attained_gain
from flexhinf.paper.tolerances import COIL, TOLERANCES
from flexhinf.report import to_json

pytestmark = pytest.mark.paper


OPTIONS = {
    "true-state": {"estimator": "none", "process_noise": 0.0},
    "diverging": {"gamma_ratio": 1.0001, "measurement_noise": 1.0},
}
in_ci = pytest.mark.ci("judges claims in hundreds of runs")
in_nightly = pytest.mark.nightly(
    "runs of 2048 corners that diverge; the claim is judged of other runs in `make ci`"
)


@pytest.mark.parametrize(
    ("claim", "options"),
    [
        pytest.param(
            claim,
            options,
            id=f"{name}-{claim.id}",
            marks=in_nightly if (name, claim) == ("diverging", TOLERANCES) else in_ci,
        )
        for name, options in OPTIONS.items()
        for claim in (COIL, GAIN, TOLERANCES, *UKF[1:])
    ],
)
def test_any_settings_are_judged(claim: StatedClaim, options: dict) -> None:
    judged = judge(PaperSetup(PaperSettings(period=0.02, **options)), claim)
    assert judged.verdict in ("holds", "fails", "ties", "not judged")
    assert judged.criterion
    assert all(table.html() for table in judged.blocks)
    assert to_json(judged.as_dict())


@pytest.mark.ci("searches the worst disturbances of many energies")
def test_the_gain_stays_below_gamma_near_rest_only(setup: PaperSetup) -> None:
    table: Any = attained_gain(setup).table
    rows: list[Any] = list(table.rows)
    inside = [row for row in rows if row[2] is not None and row[2] <= 180.0]
    assert max(row[5] for row in inside) == pytest.approx(1.43, abs=0.02)
    assert all(row[3] <= setup.gamma for row in inside)
    assert any(row[3] is None or row[3] > setup.gamma for row in rows)
