"""What the search proves of the paper's arm is proved again by the checker, and refused where it is not so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.certify.tolerances import certify_tolerances, parameter_ranges
from flexhinf.design.specification import Specification
from flexhinf.design.weights.choose import choose


@pytest.mark.slow
@pytest.mark.parametrize("goal", [90, 180])
def test_what_the_search_proves_is_proved_again_for_the_paper_s_arm(goal: int) -> None:
    """13 s of CPU each."""
    arm = fh.paper_arm()
    problem = arm.problem(fh.Penalty((75, 27, 90, 27, 330), effort=10.0), pose=(np.radians(goal),))
    smallest = fh.smallest_gamma(problem)
    solution = fh.solve_hji(problem, gamma=1.5 * smallest, degree=4)
    certificate = solution.certify(gamma=1.6 * smallest, penalty=(60, 0, 0, 0, 300))
    found = certificate.check()
    assert found.proved, found.reason
    assert found.gradient_law
    assert found.starts > 0
    assert not replace(certificate, level=certificate.level * 1.002).check(sample=0).proved


@pytest.mark.slow
def test_what_the_search_proves_for_all_tolerances_is_proved_again() -> None:
    """180° without a jump of the input, preset robust: 20 s of CPU."""
    arm, pose = fh.paper_arm(), np.array([np.pi])
    settings = Specification(pose=(np.pi,), start=(0.0,), preset="robust", damping=0.4)
    chosen = choose(arm, pose, np.zeros(1), settings)
    solution = fh.solve_hji(chosen.problem, gamma=chosen.gamma, degree=2)
    box = parameter_ranges(arm, arm.problem(pose=pose).plant)
    proved = certify_tolerances(solution, chosen.nominal, box, 380.0, step=np.pi, scale=4.0)
    found = proved.check()
    assert found.proved, found.reason
    assert found.starts > 0
    assert not found.gradient_law  # the input matrix is uncertain
    assert not replace(proved, gamma=0.5 * proved.gamma, starts=()).check(sample=0).proved
