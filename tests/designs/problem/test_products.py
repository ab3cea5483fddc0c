"""Products of tolerances: enlarged until the inequality holds at the corners themselves."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.analysis import dissipation_corners
from flexhinf.designs import Specification
from flexhinf.designs.problem.presets import ENLARGED, acting_corners, choose, enlarge_tolerances
from flexhinf.errors import NoFeasibleGamma

ARM = fh.paper_arm()


@pytest.mark.ci("channels of all tolerances, and 2048 corners")
def test_the_robust_preset_covers_products_at_180_degrees() -> None:
    """The inequality failed at 108 of 1024 corners, where m·g·l and k_t/R act."""
    found = choose(
        ARM, np.array([math.pi]), np.zeros(1), Specification(preset="robust", extras=("inductance",))
    )
    r = found.robustness
    assert r is not None
    assert (r.corners, r.failing_corners, r.all_corners) == (1024, 0, True)
    assert r.enlarged in ENLARGED[1:]
    assert r.fraction == 1.0
    assert r.gamma_star < 1.2 * r.nominal_gamma_star
    # Again with the law that is used, by the corners of all eleven tolerances: the coil's changes nothing.
    law = fh.solve_hji(found.problem, found.gamma, 4)
    again = dissipation_corners(
        law, found.nominal, ARM.corner, ARM.uncertain,
        lambda values: ARM.operating_point([math.pi], parameters=values),
    )  # fmt: skip
    assert (again.count, again.failing) == (2048, 0)


def test_tolerances_that_change_nothing_at_the_goal_make_no_corners() -> None:
    problem = ARM.problem(pose=[math.pi / 2])
    corners = acting_corners(ARM, np.array([math.pi / 2]), problem)
    assert len(corners.population) == 2**7 + 1  # the weight does not change with the position there; no coil


def made(factor: float, failing: int) -> Any:
    """A problem of enlarged tolerances, as far as its corners matter."""
    return SimpleNamespace(factor=factor, robustness=SimpleNamespace(failing_corners=failing))


@pytest.mark.parametrize(("failing", "expected"), [
    ((0,), 1.0), ((3, 0), ENLARGED[1]), ((3, 2, 0), ENLARGED[2]), ((3,) * len(ENLARGED), 1.0),
])  # fmt: skip
def test_the_least_enlargement_is_taken(failing: tuple[int, ...], expected: float) -> None:
    left = dict(zip(ENLARGED, failing))
    assert enlarge_tolerances(lambda factor: made(factor, left[factor])).factor == expected


def test_larger_tolerances_out_of_reach_leave_the_first_design() -> None:
    def covering(factor: float) -> Any:
        if factor > 1.0:
            raise NoFeasibleGamma("No level.", f"at {factor}", "less")
        return made(factor, 5)

    assert enlarge_tolerances(covering).factor == 1.0


def test_tolerances_without_any_level_are_refused() -> None:
    def covering(factor: float) -> Any:
        raise NoFeasibleGamma("No level.", f"at {factor}", "less")

    with pytest.raises(NoFeasibleGamma):
        enlarge_tolerances(covering)
