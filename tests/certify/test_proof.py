"""Proofs of the paper's arm: what sampling finds is proved just below it and refused just above."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from tests.tiers import ci_and_night

import flexhinf as fh
from flexhinf.certify.certificate import persistent_bound
from flexhinf.certify.problem_to_claim import statement_of
from flexhinf.certify.proof import NotProved
from flexhinf.certify.starts import SMALLEST_VALUE, UNCHANGED_INPUT, proved_steps
from flexhinf.errors import InvalidInput
from flexhinf.hinf.sampled import step_amplitude
from flexhinf.polynomial import basis

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
QUICK = [(180, 4, LIGHT, False)]
LIGHTEST, LIGHTER = (65.0, 9.0, 30.0, 9.0, 310.0), (70.0, 18.0, 60.0, 18.0, 320.0)
STANDSTILL = [(0, degree, weights, False) for degree in (2, 4, 6) for weights in (LIGHTEST, LIGHTER)]
ROWS = [
    (goal, degree, weights, torques)
    for goal in (90, 180)
    for degree in (2, 4, 6)
    for weights in (LIGHTEST, LIGHTER, LIGHT, HEAVY)
    for torques in (False, True)
    if (goal, degree, weights, torques) not in QUICK and not (torques and weights != HEAVY)
] + STANDSTILL


def check(goal: int, degree: int, weights: tuple[float, ...], torques: bool) -> fh.HJISolution:
    found, gamma = solution(goal, degree, weights, torques)
    sampled = found.sampled_region(gamma=gamma, penalty=PENALTY)
    assert sampled is not None
    certificate = found.certify(gamma=gamma, penalty=PENALTY, level=0.999 * sampled.level)
    assert certificate.level == 0.999 * sampled.level
    assert certificate.gamma == gamma
    assert certificate.step_amplitude == pytest.approx(step_amplitude(found, certificate.level), rel=0.02)
    with pytest.raises(NotProved) as refused:
        found.certify(gamma=gamma, penalty=PENALTY, level=1.001 * sampled.level)
    point = refused.value.point
    assert point is not None
    if refused.value.reason == "r > 0":
        f, g1, g2, _ = found.exact_fields(point[None])
        fields = f, g1, g2, point[None] * PENALTY
        slope = found.gradient(point[None])
        assert found.hamiltonian_terms(slope, fields, gamma).sum() > 0
        assert found.value(point) < 1.001 * sampled.level
    return found


@pytest.mark.ci("solves, samples and proves for the paper's arm")
@pytest.mark.parametrize(("goal", "degree", "weights", "torques"), QUICK)
def test_a_sampled_level_is_proved_just_below_it_and_refused_just_above(
    goal: int, degree: int, weights: tuple[float, ...], torques: bool
) -> None:
    check(goal, degree, weights, torques)


@pytest.mark.nightly(
    "proves and refuses 35 laws, the published table; some of its rows are proved in `make ci`"
)
@pytest.mark.parametrize(("goal", "degree", "weights", "torques"), ROWS)
def test_every_row_of_the_table(goal: int, degree: int, weights: tuple[float, ...], torques: bool) -> None:
    check(goal, degree, weights, torques)


def test_the_paper_s_own_weights_have_no_margin_to_prove() -> None:
    """What is checked is what the law was designed for: r is a remainder of either sign."""
    found, gamma = solution(0, 2, PENALTY, False)
    assert found.sampled_region(gamma=gamma, penalty=PENALTY) is None
    with pytest.raises(InvalidInput, match="margin"):
        found.certify(gamma=gamma, penalty=PENALTY)


@pytest.mark.parametrize(
    ("goal", "torque"), ci_and_night("proofs of degree six", [(90, 10.8)], [(180, 22.9)])
)
def test_the_region_is_not_left_under_disturbances_that_persist(goal: int, torque: float) -> None:
    found, gamma = solution(goal, 6, HEAVY, True)
    sampled = found.sampled_region(gamma=gamma, penalty=PENALTY)
    assert sampled is not None
    nothing = np.zeros(5)
    level = 0.999 * sampled.level
    certificate = found.certify(gamma=gamma, penalty=nothing, level=level, decay=0.2)
    assert persistent_bound(certificate) == pytest.approx(torque, rel=0.01)
    with pytest.raises(NotProved):
        found.certify(gamma=gamma, penalty=nothing, level=level, decay=0.3)


@pytest.mark.ci("a proof of degree four and its runs")
def test_runs_from_the_largest_steps_go_to_the_goal() -> None:
    found, gamma = solution(180, 4, LIGHT, False)
    certificate = found.certify(gamma=gamma, penalty=PENALTY, level=15_000.0)
    smallest, unchanged = proved_steps(found, certificate)
    assert smallest.amplitude == certificate.step_amplitude > unchanged.amplitude
    for step in (smallest, unchanged):
        assert step.state[0, 0] == -step.amplitude
        assert found.value(step.state[0]) < certificate.level
        assert found.value(step.state[-1]) < 1e-5 * certificate.level
        beyond = max(0.0, *step.state[:, 0].tolist())  # the goal is at 0, the start at −amplitude
        assert step.overshoot_percent == pytest.approx(100.0 * beyond / step.amplitude, rel=1e-12)
        assert step.overshoot_percent < 10.0
        inputs = found.operating_input + np.reshape(found.law(step.state), (len(step.state), -1))
        assert step.peak_input[0] == pytest.approx(max(map(abs, inputs[:, 0].tolist())), rel=1e-12)
    held = 9.8 * np.sin(np.pi - unchanged.amplitude) / 0.9
    assert unchanged.first_input[0] == pytest.approx(held, rel=1e-6)
    assert smallest.peak_input[0] > 3 * unchanged.peak_input[0]
    assert [start.rule for start in certificate.starts] == [SMALLEST_VALUE, UNCHANGED_INPUT]


@pytest.mark.ci("a proof of degree six")
def test_a_half_turn_whose_input_does_not_jump_is_proved() -> None:
    """Weights chosen for it; 4 s of CPU."""
    arm = fh.paper_arm()
    problem = arm.problem(fh.Penalty((105.0, 90.0, 65.0, 2.0, 330.0), effort=10.0), pose=(np.pi,))
    star = fh.smallest_gamma(problem)
    found = fh.solve_hji(problem, gamma=1.2 * star, degree=6)
    certificate = found.certify(gamma=1.3 * star, penalty=PENALTY)
    (unchanged,) = (step for step in proved_steps(found, certificate) if step.rule == UNCHANGED_INPUT)
    assert unchanged.amplitude > 3.4
    assert unchanged.peak_input[0] < 34.0
    held = 9.8 * np.sin(np.pi - unchanged.amplitude) / 0.9
    assert unchanged.first_input[0] == pytest.approx(held, rel=1e-6)


def test_the_law_of_a_certificate_is_the_controllers() -> None:
    found, gamma = solution(90, 4, LIGHT, True)
    statement = statement_of(found, gamma, PENALTY)
    table = found.law_polynomial()
    numbers = dict(statement.law[0])
    kept = [key for k in table.degrees for key in map(tuple, basis.exponents(5, k).tolist())]
    assert [numbers.get(key, 0.0) for key in kept] == table.coefficients[0].tolist()
