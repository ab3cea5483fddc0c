"""What a log shows of itself: dead sensors, gaps, turns, rows that are too far apart."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tests.refusals import unnamed

import flexhinf as fh
from flexhinf.pages import log_remarks

ROBOT = fh.load_robot("paper")
NAMES = {"input": ("motor_voltage",), "output": ("motor_position", "link_position")}


def remarks(times: np.ndarray, **changes: Any) -> str:
    motor = changes.get("motor", 4.0 * np.sin(2.0 * times) + 2.0 * times)
    link = changes.get("link", np.sin(2.0 * times))
    noise = 1e-4 * np.random.default_rng(0).normal(size=len(times))
    return " ".join(
        log_remarks(ROBOT, fh.Log(times, np.sin(times), np.column_stack([motor + noise, link]), names=NAMES))
    )


TIMES = 2e-3 * np.arange(4000)


def test_nothing_is_said_of_a_good_log() -> None:
    assert remarks(TIMES) == ""
    assert remarks(TIMES, link=np.where(np.arange(4000) % 10, np.nan, np.sin(TIMES))) == ""
    toggling = np.random.default_rng(1).random(4000) < 0.3
    assert remarks(TIMES, link=1.5e-3 * toggling) == "", "an encoder at rest"


@pytest.mark.parametrize(
    ("times", "changes", "anchors"),
    [
        (TIMES, {"link": np.full(4000, 0.1)}, ("link position", 0.1, "rad")),
        (np.delete(TIMES, slice(700, 1100)), {}, ("gap", 0.802, "held")),
        (TIMES, {"motor": (4.0 * np.sin(2.0 * TIMES)) % (2.0 * np.pi)}, ("motor position", "unwrap")),
        (
            TIMES,
            {"link": np.where(np.arange(4000) == 900, -9999.0, np.sin(TIMES))},
            ("link position", -9999, "lost"),
        ),
        (300.0 * TIMES, {}, (600, "ms", "period")),
    ],
)
def test_what_is_conspicuous_is_named(
    times: np.ndarray, changes: dict[str, Any], anchors: tuple[Any, ...]
) -> None:
    assert unnamed(remarks(times, **changes), *anchors) == []
