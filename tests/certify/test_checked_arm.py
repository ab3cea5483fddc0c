"""What the search proves of the paper's arm is proved again by the checker, and refused where it is not so."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from tests.tiers import ci_and_night

import flexhinf as fh
from flexhinf.certify import Certificate
from flexhinf.certify.box import parameter_ranges
from flexhinf.certify.proof import certify_tolerances
from flexhinf.designs.problem.presets import choose
from flexhinf.designs.specification import Specification

#: A little below the largest for a half turn.
LEVEL = 16_970.0


@pytest.mark.parametrize(
    ("goal", "level", "sample"),
    ci_and_night("proves a law of degree 4 twice", [(180, LEVEL, 1)], [(90, None, 10), (180, None, 10)]),
)
def test_what_the_search_proves_is_proved_again_for_the_paper_s_arm(
    goal: int, level: float | None, sample: int
) -> None:
    """At a stated level, or at the largest, which is searched."""
    arm = fh.paper_arm()
    problem = arm.problem(fh.Penalty((75, 27, 90, 27, 330), effort=10.0), pose=(np.radians(goal),))
    smallest = fh.smallest_gamma(problem)
    solution = fh.solve_hji(problem, gamma=1.5 * smallest, degree=4)
    certificate = solution.certify(gamma=1.6 * smallest, penalty=(60, 0, 0, 0, 300), level=level)
    found = certificate.check(sample=sample)
    assert found.proved, found.reason
    assert found.gradient_law
    assert found.starts > 0
    assert not replace(certificate, level=certificate.level * 1.002).check(sample=0).proved


@cache
def proved_for_all_tolerances() -> Certificate:
    """90° without a jump of the input: what `search_proved_step` finds by default, without its search."""
    arm, pose = fh.paper_arm(), np.array([np.pi / 2])
    settings = Specification(pose=(np.pi / 2,), start=(0.0,), preset="robust")
    chosen = choose(arm, pose, np.zeros(1), settings)
    solution = fh.solve_hji(chosen.problem, gamma=1.3 * chosen.gamma_star, degree=2)
    box = parameter_ranges(arm, chosen.nominal.plant)
    return certify_tolerances(solution, arm.problem(pose=pose), box, 280.3, step=np.pi / 2, scale=9.4794)


@pytest.mark.ci("cells of a box of parameters")
def test_the_search_s_own_proof_for_all_tolerances_is_proved_again_with_room() -> None:
    """Twice the γ for all tolerances by definite matrices, and γ itself for half of them by cells; γ itself for all
    takes 71 s of CPU."""
    proved = proved_for_all_tolerances()
    assert proved.step_amplitude == np.nextafter(np.pi / 2, np.inf)  # at least 90°, which no double is
    found = replace(proved, gamma=2.0 * proved.gamma).check(threads=1, sample=1)
    assert found.proved, found.reason
    assert found.starts > 0
    half = tuple(
        replace(p, low=(p.low + p.middle) / 2, high=(p.high + p.middle) / 2) for p in proved.parameters
    )
    assert replace(proved, parameters=half).check(threads=1, sample=1, by_cells=True).proved
    assert not replace(proved, gamma=0.7 * proved.gamma).check(sample=0).proved
