"""``python -m benchmarks.frozen``: what counts as a difference, and that each one that is kept has its reason."""

from __future__ import annotations

import json
from typing import Any

import pytest
from benchmarks import frozen


def design(found: float = 0.5, met: bool = True, law: float = 1.0, **more: float) -> dict[str, Any]:
    lines = {"overshoot": found, **more}
    numbers = {"coefficients of V": [1e-9, law], "γ": [2.0], "poles": [-1.0, 3.0]}
    stated = {"joint": "", "where": "the step", "limit": 1.0, "unit": "%", "met": met}
    return {
        "numbers": numbers,
        "requirements": [{"what": what, "found": value, **stated} for what, value in lines.items()],
    }


@pytest.mark.parametrize(
    ("after", "apart"),
    [
        (design(found=0.5 + 1e-9, law=1.0 + 1e-9), []),
        (design(law=1.0 + 1e-5), ["coefficients of V"]),
        (design(found=0.51), ["overshoot"]),
        (design(met=False), ["overshoot"]),
        (design(settling=0.1), ["settling"]),
    ],
)
def test_what_is_apart(after: dict[str, Any], apart: list[str]) -> None:
    row = frozen.compared(design(), after)
    assert frozen.differences(row) == apart
    assert frozen.differences(frozen.compared(after, design())) == apart


def test_a_verdict_that_changes_is_in_the_table() -> None:
    row = {"design": "x", **frozen.compared(design(), design(found=1.5, met=False))}
    cells = [cell.strip() for cell in frozen.table([row]).splitlines()[-1].split("|")]
    assert cells[1:3] == ["x", "equal"]
    assert "met → missed" in cells[3]


def test_every_difference_that_is_kept_has_its_reason() -> None:
    rows = json.loads(frozen.KEPT.read_text(encoding="utf-8"))["rows"]
    assert [row["design"] for row in rows] == list(frozen.DESIGNED)
    assert {row["before"] for row in rows} == {frozen.BEFORE}
    told = {
        reason
        for row in rows
        for what in frozen.differences(row)
        for reason in frozen.reasons(row["design"], what)
    }
    assert all(frozen.reasons(row["design"], what) for row in rows for what in frozen.differences(row))
    assert told == {(commit, text) for *_, commit, text in frozen.REASONS}
