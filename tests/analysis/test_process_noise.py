"""Which R^v keeps four designs of the paper's arm stable: all 2048 corners, and how far tolerances may grow.

The gains are those of four laws with which "no corner is unstable" was reported, from two forms of R^v and 400 sampled
corners: presets damped and robust at 90° and 180°, coil in the plant, R^v = 1e-7 on the velocities, R^n = 1e-8.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from tests.analysis.conftest import filter_of
from tests.builders import linear_law
from tests.tiers import ci_and_night

from flexhinf.analysis import (
    FORMS,
    LINK_VELOCITIES,
    MOTOR_VELOCITIES,
    EquilibriumLoop,
    ProcessNoise,
    ToleranceBox,
    corners,
    tolerance_corners,
)
from flexhinf.robot import Robot

#: By preset and goal in degrees: u = u* + gain (x1 … x5 − x*).
GAINS = {
    ("damped", 90): (27.31948686, -8.59476928, -140.47314683, -18.89780068, -185.19100677),
    ("damped", 180): (8.16732217, -13.61480865, -179.82471434, -21.0843096, -251.26470158),
    ("robust", 90): (36.34442232, -16.39987827, -209.0933195, -23.55420508, -296.50173998),
    ("robust", 180): (63.57290307, -27.65218009, -376.76197025, -32.55062682, -485.7355053),
}

#: Of R^v, in the order of the plant's states: as designed; mostly on the link's torque; on it alone; on the motor's.
DESIGNED, MOSTLY_LINK, LINK_ALONE, MOTOR_ALONE = (
    np.diag(q) for q in ([0, 1e-7, 0, 1e-7], [0, 1e-7, 0, 1e-8], [0, 1e-7, 0, 0.0], [0, 0.0, 0, 2e-8])
)


def loop_of(arm: Robot, preset: str, degrees: int) -> EquilibriumLoop:
    goal = math.radians(degrees)
    x, u = arm.operating_point([goal])
    law = linear_law(arm.plant(), GAINS[preset, degrees], x, u, ("link_position",))
    filter = filter_of(arm.plant(), x, "ukf", (DESIGNED, 1e-8))
    return EquilibriumLoop(law, filter, arm.plant(inductance=True), 1e-3, goal, latency=0)


def unstable(loop: EquilibriumLoop, arm: Robot, noise: np.ndarray) -> int:
    """How many of all corners are unstable with an R^v."""
    plants = [arm.corner(signs.tolist()) for signs in corners(11, 2048)]
    return int((loop.modes(plants, noise).rate >= 0.0).sum())


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize(
    ("preset", "goal", "mostly_link", "motor_alone"),
    [("damped", 90, 64, 0), ("damped", 180, 256, 0), ("robust", 90, 256, 0), ("robust", 180, 256, 2)],
)
def test_unstable_corners_by_the_direction_of_the_noise(
    arm: Robot, preset: str, goal: int, mostly_link: int, motor_alone: int
) -> None:
    loop = loop_of(arm, preset, goal)
    assert unstable(loop, arm, DESIGNED) == 0
    assert unstable(loop, arm, MOSTLY_LINK) == mostly_link
    assert unstable(loop, arm, LINK_ALONE) == 768
    assert unstable(loop, arm, MOTOR_ALONE) == motor_alone


#: R^v over R^n, as in the report of a design; None: the standard grid.
REPORTED = (1e-4, 1.0, 1e4, 1e8)


@pytest.mark.parametrize(
    ("preset", "goal", "ratios"),
    ci_and_night(
        "sweeps 2048 corners over two dozen levels of the noise",
        [("robust", 180, None), ("damped", 90, REPORTED)],
        [(*law, None) for law in GAINS if law != ("robust", 180)] + [("robust", 180, REPORTED)],
    ),
)
def test_the_sweep_finds_these_corners_and_names_their_form(
    arm: Robot, preset: str, goal: int, ratios: tuple[float, ...] | None
) -> None:
    """The two corners of robust at 180° lie between two levels of either grid."""
    noises = (
        None if ratios is None else [ProcessNoise(form, 1e-8 * ratio) for form in FORMS for ratio in ratios]
    )
    found = tolerance_corners(loop_of(arm, preset, goal), arm.corner, arm.uncertain, noises)
    assert found.unstable == 0
    assert max(swept.unstable for swept in found.of_form(LINK_VELOCITIES).values()) >= 768
    assert LINK_VELOCITIES not in found.retunable
    between = [(r, swept.unstable) for r, swept in found.of_form(MOTOR_VELOCITIES).items() if swept.unstable]
    assert between == ([(pytest.approx(10**0.25), 2)] if (preset, goal) == ("robust", 180) else [])
    assert (MOTOR_VELOCITIES in found.retunable) == (not between)


@pytest.mark.ci("looks for the edge of 2048 corners")
@pytest.mark.parametrize(("preset", "scale"), [("damped", 1.784), ("robust", 1.575)])
def test_robust_stands_less_of_a_common_factor_of_the_tolerances(
    arm: Robot, preset: str, scale: float
) -> None:
    """At 90°: the preset robust covers the tolerances as they are, and need not stand more of them than damped does."""
    loop = loop_of(arm, preset, 90)
    found, corner = ToleranceBox.of(loop, arm.corner, arm.uncertain).edge(loop)
    assert found == pytest.approx(scale, abs=2e-3)
    middle, end = loop.plant.parameters.vectors(
        [arm.corner(signs) for signs in ([0.0] * 11, corners(11, 2048)[corner].tolist())]
    )
    moved = np.array([middle + factor * (end - middle) for factor in (found - 0.01, found + 0.01)])
    below, above = loop.modes(moved).rate
    assert below < 0.0 < above
