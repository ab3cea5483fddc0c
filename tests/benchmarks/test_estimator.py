"""Rows of ``make bench-estimator``: what is kept, how it is shown, and one of them measured again."""

from __future__ import annotations

import json

import pytest
from benchmarks.estimator import KEPT, KINDS, ROBOTS, WAYS, measure, table, verdicts


def test_every_row_is_kept_and_shown() -> None:
    rows = json.loads(KEPT.read_text(encoding="utf-8"))["rows"]
    names = [(row["states"], row["filter"], row["way"]) for row in rows]
    assert names == [(states, kind, way) for states in ROBOTS for kind in KINDS for way in WAYS]
    text = table()
    assert all(f"| {row['ratio']:.2f} |" in text for row in rows)


def test_a_step_is_as_much_faster_than_filterpys_as_is_required() -> None:
    rows = json.loads(KEPT.read_text(encoding="utf-8"))["rows"]
    faster = [line for line in verdicts(rows) if "filterpy" in line]
    assert len(faster) == len(WAYS)
    assert all(line.endswith("| yes |") for line in faster)


@pytest.mark.ci("measures steps of ours and of filterpy")
def test_rows_measured_again() -> None:
    rows = measure(4, repetitions=3)
    assert len(rows) == len(KINDS) * len(WAYS)
    assert min(row["times_filterpy"] for row in rows) > 20.0
