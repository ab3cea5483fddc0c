"""``make bench-compared``: what a command costs and where it stops, which requirement is searched, the tables."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from benchmarks.compared import tables
from benchmarks.compared.commands import Spent, Stopped, killed, ran
from benchmarks.compared.rows import nearest

from flexhinf.campaign import CampaignJudgement, MetricLimit


def test_a_command_says_what_it_cost_or_where_it_was_stopped(tmp_path: Path) -> None:
    whole = ran(["robots"], 60)
    assert 0.1 < whole.cpu_s < 60.0
    assert 20.0 < whole.memory_mb < 2000.0
    with pytest.raises(Stopped) as stopped:
        ran(["design", "planar-two-link", "--out", str(tmp_path / "design")], 1)
    assert 0.5 < stopped.value.spent.cpu_s < 3.0
    with pytest.raises(RuntimeError, match="ended with 2"):
        ran(["design", "no such robot"], 60)
    assert whole + Spent(1.0, 1e6) == Spent(whole.cpu_s + 1.0, 1e6)


def test_a_command_is_killed_when_something_is_due(tmp_path: Path) -> None:
    asked = iter((False, False, True))
    spent = killed(["design", "planar-two-link", "--out", str(tmp_path / "design")], 60, lambda: next(asked))
    assert spent.cpu_s < 10.0
    with pytest.raises(RuntimeError, match=r"ended \(0\) before"):
        killed(["robots"], 60, lambda: False)


@pytest.mark.parametrize("range_use", [0.0, 1e-8])
def test_the_requirement_nearest_to_its_limit_is_searched(range_use: float) -> None:
    """A run that did not end has no number; of what must be zero no share is meant."""
    columns = {
        "a_use": np.array([0.1, np.nan, 0.6]), "b_use": np.array([0.7, np.nan, 0.2]),
        "range_use": np.array([0.0, 0.0, range_use]), "none_use": np.full(3, np.nan),
    }  # fmt: skip
    limits = {"a_use": 1.0, "b_use": 1.0, "range_use": 1e-9, "none_use": 1.0}
    rules = [MetricLimit(name, limit) for name, limit in limits.items()]
    judged = SimpleNamespace(requirements=rules, column=columns.__getitem__)
    name, use = nearest(cast("CampaignJudgement", judged))
    assert (name, use) == ("b_use", 0.7)


def test_what_was_stopped_or_not_measured_has_a_row_that_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    rows: dict[str, Any] = {"scara.laws": {"cpu_s": 1800.0, "stopped": str(Stopped(Spent(1800.0)))}}
    monkeypatch.setattr(tables, "kept", rows.get)
    laws = tables.laws().splitlines()
    assert [line for line in laws if "scara" in line and "1800" in line]
    assert len([line for line in laws if tables.MISSING in line]) == len(tables.ROBOTS) - 1
    assert tables.campaigns().count(tables.MISSING) == len(tables.ROBOTS)
    assert tables.MISSING in tables.scale()
    assert {line.count("|") for line in laws} == {8}
