"""Other settings than the default ones give a whole report too."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest

from flexhinf.pages import paper_files
from flexhinf.paper import PaperSettings, reproduce

pytestmark = [
    pytest.mark.paper,
    pytest.mark.nightly(
        "the whole paper with each setting; tests/paper/test_claims.py judges claims with others"
    ),
]

#: Each setting away from its default.
OTHERS = [
    {"estimator": "none"},
    {"estimator": "ekf"},
    {"degree": 2},
    {"degree": 5},
    {"degree": 6},
    {"period": 1e-2},
    {"period": 0.05},
    {"gamma_ratio": 1.01},
    {"gamma_ratio": 100.0},
    {"process_noise": 1e-2},
    {"process_noise": 0.0},
    {"measurement_noise": 1e-2},
    {"seed": 7},
    {"estimator": "none", "degree": 3},
    {"measurement_noise": 1.0, "gamma_ratio": 1.01, "period": 0.05},
    {"estimator": "ekf", "degree": 3, "period": 0.05},
]


@pytest.mark.parametrize("options", OTHERS, ids=str)
def test_other_settings_give_a_report_too(options: dict[str, Any]) -> None:
    def refuse(constant: str) -> None:
        raise AssertionError(f"metrics.json holds {constant}")

    result = reproduce(PaperSettings(**options))
    metrics = json.loads(paper_files(result)["metrics.json"], parse_constant=refuse)
    for claim in metrics["claims"]:
        assert claim["verdict"] in {"holds", "fails", "ties", "not judged"}
        assert not re.search(r"\b(inf|nan|None)\b", claim["evidence"]), claim["evidence"]
    if options.get("estimator", "ukf") != "ukf":
        tracking = [claim for claim in metrics["claims"] if claim["id"].startswith("tracks")]
        assert tracking
        assert not any("UKF" in claim["text"] + claim["evidence"] for claim in tracking)
