"""Which lines of a specification are met."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from flexhinf.design import Specification
from flexhinf.design.draws import Draws
from flexhinf.design.met import CLOSE, Met, all_hold, corners_met, linear_met, step_met, within_tolerances
from flexhinf.design.weights.search import TargetBehaviour


class Step:
    """As much of a response as is judged."""

    def __init__(self, overshoots: list[float | None], inputs: Any, diverged: float | None = None) -> None:
        self.diverged = diverged
        self.metrics = [{} if diverged else {"overshoot_percent": value} for value in overshoots]
        self.run = type("Run", (), {"signals": {"input": np.array(inputs)}})()


def line(asked: float, found: float, at_most: bool) -> Met:
    return Met("what", asked, found, "V", at_most, "where")


@pytest.mark.parametrize(
    ("asked", "found", "at_most", "holds"),
    [
        (5.0, 4.0, True, True),
        (5.0, 5.0 * (1.0 + CLOSE), True, True),
        (5.0, 5.2, True, False),
        (5.0, np.inf, True, False),
        (5.0, np.nan, True, False),
        (0.0, 0.0, True, True),
        (0.0, 1.0, True, False),
        (3.0, 4.0, False, True),
        (3.0, 3.0 * (1.0 - CLOSE), False, True),
        (3.0, 2.9, False, False),
        (0.3, -np.inf, False, False),
        (0.3, np.inf, False, True),
        (0.3, np.nan, False, False),
    ],
)
def test_a_line_holds_up_to_the_width_of_the_search(
    asked: float, found: float, at_most: bool, holds: bool
) -> None:
    assert line(asked, found, at_most).holds is holds


def test_all_hold_when_each_does() -> None:
    good, bad = line(5.0, 4.0, True), line(5.0, 6.0, True)
    assert all_hold([good, good])
    assert not all_hold([good, bad])
    assert all_hold([])


def test_of_a_step_the_worst_joint_counts() -> None:
    step: Any = Step([1.0, 7.0, None], [[1.0, -30.0], [2.0, 3.0]])
    (overshoot,) = step_met(Specification(), step, "V", "here")
    assert (overshoot.found, overshoot.asked, overshoot.asked_for, overshoot.holds) == (
        7.0,
        5.0,
        False,
        False,
    )
    asked = Specification(overshoot=8.0, peak_effort=25.0)
    overshoot, peak = step_met(asked, step, "V", "here")
    assert (overshoot.asked_for, overshoot.holds) == (True, True)
    assert (peak.found, peak.unit, peak.at_most, peak.holds) == (30.0, "V", True, False)
    still: Any = Step([None], [[1.0]])
    assert step_met(Specification(), still, "V", "here")[0].found == 0.0


def test_a_step_that_diverges_meets_nothing() -> None:
    step: Any = Step([1.0], [[1.0]], diverged=0.3)
    assert [m.found for m in step_met(Specification(peak_effort=60.0), step, "V", "here")] == [np.inf, np.inf]


def test_of_the_bandwidths_the_joint_that_lags_most_is_told() -> None:
    wanted = TargetBehaviour(np.array([4.0, 2.0, 10.0]), 0.2)
    asked = Specification(bandwidth=[4.0, 2.0, 10.0], damping=0.2)
    band, damping = linear_met(asked, wanted, np.array([4.2, 1.9, 7.0]), 0.25)
    assert (band.asked, band.found, band.holds, band.asked_for) == (10.0, 7.0, False, True)
    assert (damping.asked, damping.found, damping.holds, damping.asked_for) == (0.2, 0.25, True, True)
    band, damping = linear_met(Specification(), wanted, np.array([4.2, 2.1, 11.0]), 0.1)
    assert (band.asked_for, damping.asked_for, damping.holds) == (False, False, False)
    assert linear_met(Specification(), None, np.array([4.2, 2.1, 11.0]), 0.1) == []


def test_of_the_tolerances_the_worst_robot_counts() -> None:
    merits = np.array([1.0, 4.0, 2.0]), np.array([1.0, np.inf, 1.0]), np.array([9.0, 8.0, 70.0])
    draws = Draws([{}] * 3, *merits, np.zeros(1), np.zeros((3, 1, 1)))
    unsettled, overshoot, peak = within_tolerances(Specification(peak_effort=60.0), draws, "V")
    assert (unsettled.found, unsettled.holds, unsettled.asked_for) == (1.0, False, False)
    assert (overshoot.found, overshoot.holds) == (4.0, True)
    assert (peak.found, peak.holds) == (70.0, False)
    assert "3 robots" in peak.where
    assert corners_met(400, 0).holds
    assert not corners_met(400, 1).holds
    assert "400 corners" in corners_met(400, 1).where
