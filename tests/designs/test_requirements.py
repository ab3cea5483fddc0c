"""Which lines of a specification are met."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from tests.refusals import refused_with, unnamed

import flexhinf as fh
from flexhinf.cli.messages import error_text
from flexhinf.designs import Specification
from flexhinf.designs.about_pose import diverged_requirements
from flexhinf.designs.judge import (
    bandwidth_requirement,
    corner_requirement,
    damping_requirement,
    holding_requirement,
    margin_requirements,
    oscillation_requirements,
    sample_requirements,
    step_requirements,
)
from flexhinf.designs.monte_carlo import MonteCarlo
from flexhinf.designs.requirements import REQUIREMENTS, Requirement
from flexhinf.designs.requirements.delay_margin import DELAY_MARGIN
from flexhinf.designs.requirements.gain_margin import GAIN_MARGIN
from flexhinf.designs.requirements.overshoot import OVERSHOOT
from flexhinf.designs.requirements.peak_sensitivity import PEAK_SENSITIVITY
from flexhinf.designs.requirements.requirement import TOLERANCE
from flexhinf.designs.responses import ROBOT, JointLimits, joint_limits
from flexhinf.designs.specification import FIELDS, SpecificationError
from flexhinf.pages.page import requirement_table
from flexhinf.report import Cell


class Step:
    """As much of a response as is judged: a step to 1 of each joint that has an overshoot, per cent."""

    def __init__(self, overshoots: list[float | None], inputs: Any, diverged: bool = False) -> None:
        self.joints, self.start = tuple(f"j{k}" for k in range(len(overshoots))), np.zeros(len(overshoots))
        self.goal = np.array([float(value is not None) for value in overshoots])
        self.inputs = np.array(inputs, dtype=float)
        self.positions = np.tile(self.goal * [1.0 + 0.01 * (x or 0.0) for x in overshoots], (len(inputs), 1))
        self.velocities = 0.01 * self.inputs
        self.diverged_at = 0.1 if diverged else None
        self.run = SimpleNamespace(time=0.25 * np.arange(len(self.inputs)))


def limits_of(s: Specification, joints: int = 2, **robot: Any) -> JointLimits:
    """Of the catalogue's robot with so many joints, driven by voltages."""
    shipped = fh.load_robot("paper" if joints == 1 else "planar-two-link")
    return joint_limits(replace(shipped, **robot), s)


class Linear:
    """As much of the margins as is judged."""

    def __init__(self, bandwidth: Any = (), peak: float = 1.0, gain: float = 9.0) -> None:
        self.bandwidth = np.array(bandwidth, dtype=float)
        self.peak_sensitivity, self.gain_margin, self.delay_margin_s = peak, gain, 1.5e-3
        self.linear = SimpleNamespace(period=1e-3)


def line(limit: float, found: float, at_most: bool) -> Requirement:
    return Requirement("what", limit, found, "V", at_most, "where", "criterion")


def test_angles_are_shown_as_the_user_gave_them() -> None:
    error = Requirement("tracking error", math.radians(0.5), math.radians(0.1), "rad", True, "move", "")
    shown = error.converted(True)
    assert (shown.limit_text, shown.achieved_text) == ("≤ 0.5°", "0.1°")
    small = error.converted(False)
    assert (small.limit_text, small.achieved_text) == ("≤ 8.73 mrad", "1.75 mrad")
    large = Requirement("tracking error", 0.5, 0.1, "rad", True, "move", "")
    assert large.converted(False) is large
    speed = Requirement("link speed", math.pi, 1.0, "rad/s", True, "step", "").converted(True)
    assert (speed.limit_text, speed.achieved_text) == ("≤ 180 °/s", "57.3 °/s")
    bandwidth = Requirement("bandwidth", 4.0, 3.0, "rad/s", False, "running loop", "")
    assert bandwidth.converted(True) is bandwidth


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
    one = line(asked, found, at_most)
    assert one.met is holds
    exact = found <= asked if at_most else found >= asked
    assert one.judgement == ("NOT MET" if not holds else "met" if exact else "met within 2 %")
    assert one.within_tolerance is (holds and not exact)


@pytest.mark.parametrize(("found", "judged"), [(2.52, "met within 2 %"), (2.5, "met")])
def test_what_is_past_its_limit_and_counts_as_met_says_so_in_its_line(found: float, judged: str) -> None:
    """Old code printed 2.52, ≤ 2.5 and met."""
    one = Requirement("peak sensitivity", 2.5, found, "", True, "loop", "")
    table = requirement_table([one])
    assert str(list(table.terminal().columns[-1].cells)[-1]) == judged
    record = dict(zip((column.name for column in table.heads), table.rows[-1]))
    assert record["met"] == Cell(judged, "green" if judged == "met" else "yellow")


def test_a_line_is_met_on_its_side_of_the_limit() -> None:
    good, bad = line(5.0, 4.0, True), line(5.0, 6.0, True)
    assert [one.met for one in (good, bad)] == [True, False]


def test_of_a_step_the_worst_joint_counts_and_is_named() -> None:
    step: Any = Step([None, 7.0], [[1.0, -30.0], [2.0, 3.0]])
    (overshoot,) = step_requirements(Specification(), limits_of(Specification()), step, "here")
    assert (overshoot.found, overshoot.limit, overshoot.stated_by, overshoot.met) == (
        pytest.approx(7.0),
        5.0,
        "default",
        False,
    )
    assert overshoot.joint == "elbow"
    asked = Specification(overshoot=8.0, peak_effort=25.0)
    overshoot, peak = step_requirements(asked, limits_of(asked), step, "here")
    assert (overshoot.stated_by, overshoot.met) == ("--overshoot", True)
    assert (peak.found, peak.unit, peak.at_most, peak.met) == (30.0, "V", True, False)
    still: Any = Step([None], [[1.0]])
    assert step_requirements(Specification(), limits_of(Specification(), 1), still, "here")[0].found == 0.0


def test_a_step_that_diverges_meets_nothing() -> None:
    step: Any = Step([1.0], [[1.0]], diverged=True)
    asked = Specification(peak_effort=60.0)
    lines = step_requirements(asked, limits_of(asked, 1), step, "here")
    assert [line.found for line in lines] == [np.inf, np.inf]


def test_of_the_bandwidths_the_joint_that_lags_most_is_named() -> None:
    required, joints = np.array([4.0, 2.0, 10.0]), ("a", "b", "c")
    stated = Specification(bandwidth=(4.0, 2.0, 10.0))
    found: Any = Linear([4.2, 1.9, 7.0])
    band = bandwidth_requirement(stated, required, found, joints)
    assert (band.limit, band.found, band.met, band.stated_by) == (10.0, 7.0, False, "--bandwidth")
    assert band.joint == "c"
    found = Linear([4.2, 2.1, 11.0])
    assert bandwidth_requirement(Specification(), required, found, joints).stated_by == "default"


def test_an_unstable_loop_has_no_bandwidth() -> None:
    found: Any = Linear([np.nan, np.nan])
    band = bandwidth_requirement(Specification(), np.array([1.0, 1.0]), found, ("a", "b"))
    assert (band.found, band.met) == (0.0, False)


@pytest.mark.parametrize(
    ("required", "slow", "limit", "met"),
    [
        (None, 0.051, 0.05, True),
        (None, 0.0499, 0.05, False),
        (0.01, 0.0499, 0.05, False),
        (0.2, 0.197, 0.2, True),
    ],
)
def test_no_oscillation_below_the_frequency_is_met_below_a_twentieth(
    required: float | None, slow: float, limit: float, met: bool
) -> None:
    """Old code judged no damping where weights are stated, and called 0.0016 at 190 Hz met without a word."""
    stated = Specification(damping=required, damped_below="50Hz")

    def ratios(below: float, fast: float) -> tuple[float, float]:
        assert below == pytest.approx(100.0 * math.pi)
        return slow, fast

    own, still = (cast("Any", SimpleNamespace(damping_about=partial(ratios, fast=f))) for f in (0.0016, 1.0))
    damping, fast = oscillation_requirements(stated, own, required, ("a", "b"))
    assert (damping.limit, damping.found, damping.met, damping.joint) == (limit, slow, met, "a")
    assert (fast.limit, fast.found, fast.met, fast.joint) == (0.0, 0.0016, True, "b")
    assert "314" in fast.criterion
    assert len(oscillation_requirements(stated, still, required)) == 1


def test_what_has_to_be_damped_is_far_below_half_the_sampling_frequency() -> None:
    assert Specification().damped_below_limit == 350.0
    assert Specification(period=0.01).damped_below_limit == pytest.approx(math.pi / 0.03)
    with refused_with(SpecificationError, "1047", "1100"):
        Specification(damped_below=1100.0)


def test_margins_have_stated_defaults_and_stated_limits_win() -> None:
    found: Any = Linear(peak=2.2, gain=1.9)
    peak, gain, delay = margin_requirements(Specification(), found)
    assert (peak.limit, gain.limit, delay.limit) == (PEAK_SENSITIVITY, GAIN_MARGIN, DELAY_MARGIN)
    assert (peak.met, gain.met, delay.met, delay.stated_by) == (True, True, True, "default")
    assert len(margin_requirements(Specification(estimator="none"), found)) == 2
    stated = Specification(peak_sensitivity=2.0, gain_margin=2.0, delay_margin=2.0)
    peak, gain, delay = margin_requirements(stated, found)
    assert (peak.met, gain.met, delay.met) == (False, False, False)
    assert (delay.found, delay.unit, delay.limit) == (pytest.approx(1.5), "samples", 2.0)
    assert (peak.stated_by, gain.stated_by, delay.stated_by) == (
        "--set peak_sensitivity", "--set gain_margin", "--set delay_margin"
    )  # fmt: skip
    assert "running loop" in peak.where


@pytest.mark.parametrize(
    ("field", "limit"),
    [
        ("overshoot", OVERSHOOT),
        ("peak_sensitivity", PEAK_SENSITIVITY),
        ("gain_margin", GAIN_MARGIN),
        ("delay_margin", DELAY_MARGIN),
    ],
)
def test_a_limit_that_is_stated_as_its_default_is_stated(field: str, limit: float) -> None:
    for s, by in ((Specification(), "default"), (Specification(**{field: limit}), FIELDS[field].option)):
        line = REQUIREMENTS[field].judge(s, s.limit(field), 1.0, "the step")
        assert (line.limit, line.stated_by) == (limit, by)


def test_of_the_tolerances_the_worst_robot_counts() -> None:
    figures = np.array([1.0, 4.0, 2.0]), np.array([1.0, np.inf, 1.0]), np.array([9.0, 8.0, 70.0])
    joints = dict.fromkeys(("overshoot", "settling", "peak"), ("a", "b", "a"))
    inputs = np.array([[9.0, 1.0], [8.0, 1.0], [70.0, 1.0]])
    samples = MonteCarlo(
        ({}, {}, {}),
        *figures,
        joints,
        inputs,
        0.1 * inputs,
        np.zeros(1),
        np.zeros((3, 1, 2)),
    )
    asked = Specification(peak_effort=60.0)
    unsettled, overshoot, peak = sample_requirements(asked, limits_of(asked), samples)
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


def test_each_joint_is_judged_by_its_own_limit_and_the_moment_is_named() -> None:
    step: Any = Step([1.0, 1.0], [[50.0, -3.0], [60.0, -11.0], [10.0, 2.0]])
    asked = Specification(peak_effort=(87.0, 10.0), peak_speed=(0.5, 1.0))
    _, peak, speed = step_requirements(asked, limits_of(asked), step, "here")
    assert (peak.found, peak.limit, peak.joint, peak.at, peak.met) == (11.0, 10.0, "elbow", 0.25, False)
    assert (speed.found, speed.limit, speed.joint, speed.at) == (pytest.approx(0.6), 0.5, "shoulder", 0.25)
    assert (peak.stated_by, speed.stated_by, speed.unit) == ("--peak-effort", "--peak-speed", "rad/s")
    wide = Specification(peak_effort=(87.0, 12.0), peak_speed="40deg/s")  # type: ignore[arg-type]
    assert all(one.met for one in step_requirements(wide, limits_of(wide), step, "here"))


def test_a_peak_that_no_limit_hides_is_called_so() -> None:
    """Without an input's limit the step needs 9 V; with one it is clipped to 4 V."""
    asked = Specification(peak_effort=4.0)
    clipped, free = Step([0.0, 0.0], [[4.0, 0.0]]), Step([0.0, 0.0], [[9.0, 0.0]])
    for unlimited, found, words in (
        (None, 4.0, ("peak input",)),
        (free, 9.0, ("peak input", "without limits")),
    ):
        peak = step_requirements(
            asked, limits_of(asked), cast("Any", clipped), "here", cast("Any", unlimited)
        )[1]
        assert peak.found == found
        assert [word for word in words if word not in peak.what] == []
        assert ("without" in peak.what) == (unlimited is not None)


@pytest.mark.parametrize(("stated", "limit"), [(None, 0.05), (0.04, 0.05), (0.05, 0.05), (0.2, 0.2)])
def test_a_damping_below_the_least_is_judged_by_that_and_says_so(stated: float | None, limit: float) -> None:
    line = damping_requirement(None, stated, 0.3, 350.0)
    assert line.limit == limit
    assert bool(line.detail) == (stated == 0.04)
    assert line.detail in line.achieved_text


def test_what_the_robot_states_is_judged_unless_an_option_does() -> None:
    step: Any = Step([1.0, 1.0], [[50.0, -3.0], [60.0, -11.0]])
    own = {"effort_limits": (55.0, None), "speed_limits": (None, 0.2)}
    plain = Specification()
    _, peak, speed = step_requirements(plain, limits_of(plain, **own), step, "here")
    assert (peak.found, peak.limit, peak.joint, peak.met, peak.stated_by) == (
        60.0,
        55.0,
        "shoulder",
        False,
        ROBOT,
    )
    assert (speed.joint, speed.met, speed.stated_by) == ("elbow", True, ROBOT)
    free = Specification(peak_effort=np.inf, peak_speed=np.inf)
    assert len(step_requirements(free, limits_of(free, **own), step, "here")) == 1
    limits = limits_of(free, **own)
    assert limits.saturation.tolist() == [55.0, np.inf]  # the motor still cannot give more
    assert limits.effort.tolist() == [55.0, np.inf]


def test_a_joint_that_leaves_its_range_is_named() -> None:
    step: Any = Step([1.0, 1.0], [[50.0, -3.0], [60.0, 271.0]])
    step.positions[1, 1] = 2.71  # rad, of at most 2.6
    (_, beyond) = step_requirements(Specification(), limits_of(Specification()), step, "here")
    assert (beyond.joint, beyond.unit, beyond.at, beyond.met) == ("elbow", "rad", 0.25, False)
    assert beyond.found == pytest.approx(0.11)


@pytest.mark.parametrize("name", ["peak_effort", "saturation", "peak_speed"])
def test_another_number_of_limits_than_joints_is_refused_in_the_syntax_of_the_user(name: str) -> None:
    asked: dict[str, Any] = {name: (87.0, 87.0, 12.0)}
    with pytest.raises(
        SpecificationError, match=rf"(?s){name.replace('_', ' ')}.*\['shoulder', 'elbow'\], got 3"
    ) as refused:
        limits_of(Specification(**asked))
    assert f"{name}=(87.0, 87.0)" in str(refused.value)
    assert error_text(refused.value).endswith(f"--{name.replace('_', '-')} 87,87")


@pytest.mark.parametrize(
    ("key", "value", "text"),
    [
        ("delay_margin", 1.0, " sample"),
        ("delay_margin", 2.0, " samples"),
        ("overshoot", 1.0, " %"),
        ("corners", 1.0, ""),
    ],
)
def test_one_sample_is_no_plural(key: str, value: float, text: str) -> None:
    assert REQUIREMENTS[key].judge(None, value, value, "here").unit_text(value) == text


@pytest.mark.parametrize("impulses", [True, False])
def test_runs_that_diverge_are_missed_by_name(impulses: bool) -> None:
    """Those on the links; impulses where no other requirement is on their damping."""
    kept: Any = SimpleNamespace(
        ring_down=SimpleNamespace(ring_down=object()), load_response=SimpleNamespace(metrics=[1])
    )
    assert diverged_requirements(kept, impulses) == []
    gone: Any = SimpleNamespace(
        ring_down=SimpleNamespace(ring_down=None), load_response=SimpleNamespace(metrics=[])
    )
    lines = diverged_requirements(gone, impulses)
    assert [line.missed for line in lines] == [True] * (1 + impulses)
    assert unnamed(str(lines), "torques", *["impulses"] * impulses) == []


def test_poses_that_the_motors_cannot_hold_are_missed_by_number() -> None:
    for needing in (0, 2):
        shares = np.array([0.2, 0.9, 1.0, 1.01, 3.0][: 3 + needing])
        lines = holding_requirement(shares)
        assert [(line.missed, line.found) for line in lines] == [(True, 2.0)] * (needing > 0)
        assert unnamed(str(lines), *["cannot hold", "5 random poses"] * (needing > 0)) == []
