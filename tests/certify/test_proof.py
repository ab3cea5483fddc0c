"""Proofs of the paper's arm: what sampling finds is proved just below it and refused just above."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.certify.proof import NotProved
from flexhinf.hinf.step_amplitude import step_amplitude

PENALTY = (60.0, 0.0, 0.0, 0.0, 300.0)  # the paper's: checked
CHANNELS = ("link_torque", "motor_torque")


@cache
def solution(
    goal: int, degree: int, weights: tuple[float, ...], torques: bool
) -> tuple[fh.HJISolution, float]:
    """About the goal pose, with more than the paper's weights; and the γ that is checked."""
    arm, penalty, pose = fh.paper_arm(), fh.Penalty(weights, effort=10.0), (np.radians(goal),)
    if torques:
        problem = arm.plant().with_objective(
            penalty, integrate=("link_position",), pose=pose, disturbances=CHANNELS
        )
    else:
        problem = arm.problem(penalty, pose=pose)
    star = fh.smallest_gamma(problem)
    return fh.solve_hji(problem, gamma=1.5 * star, degree=degree), 1.6 * star


LIGHT, HEAVY = (75.0, 27.0, 90.0, 27.0, 330.0), (80.0, 36.0, 120.0, 36.0, 340.0)
QUICK = [(180, 2, LIGHT, False), (180, 4, LIGHT, False)]
ROWS = [
    (goal, degree, weights, torques)
    for goal in (90, 180)
    for degree in (2, 4, 6)
    for weights in ((65.0, 9.0, 30.0, 9.0, 310.0), (70.0, 18.0, 60.0, 18.0, 320.0), LIGHT, HEAVY)
    for torques in (False, True)
    if (goal, degree, weights, torques) not in QUICK
]


def check(goal: int, degree: int, weights: tuple[float, ...], torques: bool) -> fh.HJISolution:
    found, gamma = solution(goal, degree, weights, torques)
    sampled = found.sampled_region(gamma=gamma, penalty=PENALTY)
    certificate = found.certify(gamma=gamma, penalty=PENALTY, level=0.999 * sampled.level)
    assert certificate.level == 0.999 * sampled.level
    assert certificate.gamma == gamma
    assert certificate.step_amplitude == pytest.approx(step_amplitude(found, certificate.level), rel=0.02)
    with pytest.raises(NotProved) as refused:
        found.certify(gamma=gamma, penalty=PENALTY, level=1.001 * sampled.level)
    if refused.value.reason == "r > 0":
        f, g1, g2, _ = found.exact_fields(refused.value.point[None])
        fields = f, g1, g2, refused.value.point[None] * PENALTY
        slope = found.gradient(refused.value.point[None])
        assert found.hamiltonian_terms(slope, fields, gamma).sum() > 0
        assert found.value(refused.value.point) < 1.001 * sampled.level
    return found


@pytest.mark.parametrize(("goal", "degree", "weights", "torques"), QUICK)
def test_a_sampled_level_is_proved_just_below_it_and_refused_just_above(
    goal: int, degree: int, weights: tuple[float, ...], torques: bool
) -> None:
    check(goal, degree, weights, torques)


@pytest.mark.slow
@pytest.mark.parametrize(("goal", "degree", "weights", "torques"), ROWS)
def test_every_row_of_the_table(goal: int, degree: int, weights: tuple[float, ...], torques: bool) -> None:
    check(goal, degree, weights, torques)
