"""Which lines of a specification are met."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from flexhinf.design import Specification
from flexhinf.design.monte_carlo import MonteCarlo
from flexhinf.design.requirements import (
    Requirement,
    all_met,
    behaviour_requirements,
    corner_requirement,
    margin_requirements,
    sample_requirements,
    step_requirements,
)
from flexhinf.design.responses import Worst, worst_of
from flexhinf.design.specification import GAIN_MARGIN, PEAK_SENSITIVITY, TOLERANCE


class Step:
    """As much of a response as is judged."""

    def __init__(self, overshoots: list[float | None], inputs: Any, diverged: bool = False) -> None:
        self.joints = tuple(f"j{k}" for k in range(len(overshoots)))
        largest = np.abs(inputs).max(axis=0)
        self.peak = Worst(np.inf, "") if diverged else Worst(float(largest.max()), f"j{largest.argmax()}")
        rows = [{"joint": f"j{k}", "overshoot_percent": v} for k, v in enumerate(overshoots) if v is not None]
        self.metrics = [] if diverged else rows or [{"joint": "j0"}]

    @property
    def overshoot(self) -> Worst:
        return worst_of(self.metrics, "overshoot_percent")


class Linear:
    """As much of the margins as is judged."""

    def __init__(
        self, bandwidth: Any = (), damping: float = 1.0, peak: float = 1.0, gain: float = 9.0
    ) -> None:
        self.bandwidth, self.damping = np.array(bandwidth, dtype=float), damping
        self.peak_sensitivity, self.gain_margin = peak, gain


def line(limit: float, found: float, at_most: bool) -> Requirement:
    return Requirement("what", limit, found, "V", at_most, "where", "criterion")


@pytest.mark.parametrize(
    ("asked", "found", "at_most", "holds"),
    [
        (5.0, 4.0, True, True),
        (5.0, 5.0 * (1.0 + TOLERANCE), True, True),
        (5.0, 5.2, True, False),
        (5.0, np.inf, True, False),
        (5.0, np.nan, True, False),
        (0.0, 0.0, True, True),
        (0.0, 1.0, True, False),
        (3.0, 4.0, False, True),
        (3.0, 3.0 * (1.0 - TOLERANCE), False, True),
        (3.0, 2.9, False, False),
        (0.3, -np.inf, False, False),
        (0.3, np.inf, False, True),
        (0.3, np.nan, False, False),
    ],
)
def test_a_line_holds_up_to_the_width_of_the_search(
    asked: float, found: float, at_most: bool, holds: bool
) -> None:
    assert line(asked, found, at_most).met is holds


def test_all_hold_when_each_does() -> None:
    good, bad = line(5.0, 4.0, True), line(5.0, 6.0, True)
    assert all_met([good, good])
    assert not all_met([good, bad])
    assert all_met([])


def test_of_a_step_the_worst_joint_counts_and_is_named() -> None:
    step: Any = Step([1.0, 7.0, None], [[1.0, -30.0], [2.0, 3.0]])
    (overshoot,) = step_requirements(Specification(), step, "V", "here")
    assert (overshoot.found, overshoot.limit, overshoot.stated_by, overshoot.met) == (
        7.0,
        5.0,
        "default",
        False,
    )
    assert overshoot.joint == "j1"
    asked = Specification(overshoot=8.0, peak_effort=25.0)
    overshoot, peak = step_requirements(asked, step, "V", "here")
    assert (overshoot.stated_by, overshoot.met) == ("--overshoot", True)
    assert (peak.found, peak.unit, peak.at_most, peak.met) == (30.0, "V", True, False)
    still: Any = Step([None], [[1.0]])
    assert step_requirements(Specification(), still, "V", "here")[0].found == 0.0


def test_a_step_that_diverges_meets_nothing() -> None:
    step: Any = Step([1.0], [[1.0]], diverged=True)
    lines = step_requirements(Specification(peak_effort=60.0), step, "V", "here")
    assert [line.found for line in lines] == [np.inf, np.inf]


def test_of_the_bandwidths_the_joint_that_lags_most_is_named() -> None:
    required, joints = np.array([4.0, 2.0, 10.0]), ("a", "b", "c")
    stated = Specification(bandwidth=(4.0, 2.0, 10.0), damping=0.2)
    found: Any = Linear([4.2, 1.9, 7.0], 0.25)
    band, damping = behaviour_requirements(stated, required, 0.2, found, joints)
    assert (band.limit, band.found, band.met, band.stated_by) == (10.0, 7.0, False, "--bandwidth")
    assert band.joint == "c"
    assert (damping.limit, damping.found, damping.met, damping.stated_by) == (0.2, 0.25, True, "--damping")
    found = Linear([4.2, 2.1, 11.0], 0.1)
    band, damping = behaviour_requirements(Specification(), required, 0.2, found, joints)
    assert (band.stated_by, damping.stated_by, damping.met) == ("default", "default", False)


def test_an_unstable_loop_has_no_bandwidth() -> None:
    found: Any = Linear([np.nan, np.nan], -0.1)
    band, damping = behaviour_requirements(Specification(), np.array([1.0, 1.0]), 0.2, found, ("a", "b"))
    assert (band.found, band.met, damping.met) == (0.0, False, False)


def test_margins_have_stated_defaults_and_stated_limits_win() -> None:
    found: Any = Linear(peak=2.2, gain=1.9)
    peak, gain = margin_requirements(Specification(), found)
    assert (peak.limit, gain.limit) == (PEAK_SENSITIVITY, GAIN_MARGIN)
    assert (peak.met, gain.met, peak.stated_by) == (True, True, "default")
    peak, gain = margin_requirements(Specification(peak_sensitivity=2.0, gain_margin=2.0), found)
    assert (peak.met, gain.met) == (False, False)
    assert (peak.stated_by, gain.stated_by) == ("--peak-sensitivity", "--gain-margin")
    assert "running loop" in peak.where


def test_of_the_tolerances_the_worst_robot_counts() -> None:
    figures = np.array([1.0, 4.0, 2.0]), np.array([1.0, np.inf, 1.0]), np.array([9.0, 8.0, 70.0])
    names = ("a", "b", "a")
    samples = MonteCarlo(({}, {}, {}), *figures, names, names, names, np.zeros(1), np.zeros((3, 1, 2)))
    unsettled, overshoot, peak = sample_requirements(Specification(peak_effort=60.0), samples, "V")
    assert (unsettled.found, unsettled.met, unsettled.stated_by) == (1.0, False, "default")
    assert (overshoot.found, overshoot.met, overshoot.joint) == (4.0, True, "b")
    assert (peak.found, peak.met) == (70.0, False)
    assert "3 robots" in peak.where


def test_one_unstable_corner_is_too_many() -> None:
    class Corners:
        count, complete, unstable = 400, True, 0

    corners: Any = Corners()
    assert corner_requirement(corners).met
    assert "all 400 corners" in corner_requirement(corners).where
    corners.unstable, corners.complete = 1, False
    assert not corner_requirement(corners).met
    assert "400 sampled corners" in corner_requirement(corners).where
