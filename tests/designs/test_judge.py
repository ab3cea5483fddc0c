"""The worst of rows and joints, whatever the rows are: poses, runs or robots."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.test_extensions import motion

from flexhinf.designs.judge import worst
from flexhinf.designs.requirements import REQUIREMENTS, RequirementKind

MOST = RequirementKind("most", "most", "", "V", of_motion=lambda motion: 1.0)
LEAST = RequirementKind("least", "least", "", "s", at_most=False, of_motion=lambda motion: 1.0)
NONE = np.nan


@pytest.mark.parametrize(
    ("kind", "rows", "value", "limit", "joint", "at"),
    [
        (MOST, [((1.0, 4.0), NONE), ((3.0, 5.0), NONE)], 3.0, 2.0, "a", None),  # 1.5 of its limit, and 0.5
        (MOST, [((1.0, 40.0), (0.1, 0.2)), ((3.0, 5.0), (0.3, 0.4))], 40.0, 10.0, "b", 0.2),
        (LEAST, [((1.0, 40.0), (0.1, 0.2)), ((3.0, 4.0), (0.3, 0.4))], 4.0, 10.0, "b", 0.4),
        (
            MOST,
            [((NONE, 1.0), NONE), ((NONE, 2.0), NONE)],
            2.0,
            10.0,
            "b",
            None,
        ),  # one that has no such number
        (LEAST, [((NONE, 1.0), NONE), ((1.9, 9.9), NONE)], 1.0, 10.0, "b", None),
        (
            MOST,
            [((9.0, 1.0), NONE), None],
            np.inf,
            2.0,
            "",
            None,
        ),  # a run that diverged, by the tightest limit
        (LEAST, [None, ((9.0, 1.0), NONE)], -np.inf, 10.0, "", None),
        (
            MOST,
            [(np.inf, NONE), (1.0, NONE)],
            np.inf,
            2.0,
            "a",
            None,
        ),  # that never settles is not one that diverges
    ],
)
def test_the_worst_is_nearest_to_its_own_limit(
    kind: RequirementKind, rows: Any, value: float, limit: float, joint: str, at: float | None
) -> None:
    found = worst(kind, rows, (2.0, 10.0), ("a", "b"))
    assert (found.value, found.limit, found.joint, found.at) == (value, limit, joint, at)
    assert found.unit == kind.unit
    assert worst(kind, rows, (2.0, 10.0), ("a", "b"), ("rad", "m")).unit == {2.0: "rad", 10.0: "m"}[limit]


def test_a_limit_of_nothing_counts_what_there_is() -> None:
    assert worst(REQUIREMENTS["corners"], [(0.0, NONE), (3.0, NONE)], 0.0).value == 3.0


def test_of_a_number_for_each_sample_the_largest_counts_at_its_time() -> None:
    """The speed of the ramp q = t is 1 throughout, its position is largest at the end, and lowest at the beginning."""
    run = motion(joints=1)
    most = RequirementKind("mine", "mine", "", of_motion=lambda motion: motion.positions)
    least = RequirementKind("mine", "mine", "", at_most=False, of_motion=lambda motion: motion.positions)
    assert [np.ravel(kind.located(run)).tolist() for kind in (most, least)] == [[1.0, 1.0], [0.0, 0.0]]
    speed = REQUIREMENTS["speed"].measured(run)
    assert speed is not None
    assert speed.tolist() == [1.0]


@pytest.mark.oracle
def test_an_overshoot_is_of_a_step_alone_and_of_joints_that_make_one() -> None:
    """q = 1 − e^(−ζωt) (cos ω_d t + ζ/√(1 − ζ²) sin ω_d t) overshoots by e^(−πζ/√(1 − ζ²))."""
    kind, ratio, run = REQUIREMENTS["overshoot"], 0.4, motion()
    assert kind.measured(run) is None
    time, root = np.linspace(0.0, 30.0, 30001), np.sqrt(1.0 - ratio**2)
    wave = np.cos(root * time) + ratio / root * np.sin(root * time)
    step = 1.0 - np.exp(-ratio * time) * wave
    columns = np.column_stack([step, 0.0 * step])
    made = replace(run, time=time, positions=columns, path=np.array([[0.0, 0.0], [1.0, 0.0]]), step=True)
    found = kind.measured(made)
    assert found is not None
    assert found[0] == pytest.approx(100.0 * np.exp(-np.pi * ratio / root), rel=1e-5)
    assert np.isnan(found[1])
