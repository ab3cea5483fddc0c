"""What the pair of γ and penalty that is checked may be given as."""

from __future__ import annotations

import pytest
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput


@pytest.mark.parametrize("name", ["paper", "planar-two-link"])
def test_a_penalty_of_a_robot_is_taken_as_its_weights_are(name: str) -> None:
    """`robot.penalty` weighs groups of states; the alias of the same name took weights alone."""
    robot = fh.load_robot(name)
    problem = robot.problem()
    solution = fh.linear_law(problem, 2.0 * fh.smallest_gamma(problem))
    found = solution.checked_margin(gamma=1.2 * solution.gamma, penalty=robot.penalty)
    weights = {
        state: robot.penalty.states[group]
        for state in solution.state_names
        for group in robot.penalty.states
        if state.replace("_shoulder", "").replace("_elbow", "") == group
    }
    assert weights
    expected = solution.checked_margin(gamma=1.2 * solution.gamma, penalty=weights)
    assert (found.rate, found.fastest) == (expected.rate, expected.fastest)


def test_a_penalty_with_another_effort_or_of_code_is_refused() -> None:
    problem = fh.paper_arm().problem()
    solution = fh.linear_law(problem, 2.0 * fh.smallest_gamma(problem))
    with refused_with(InvalidInput, "R2", "[[10.0]]", "[[1.0]]"):
        solution.checked_margin(penalty=fh.Penalty({"link_position": 50.0}, effort=1.0))
    with refused_with(InvalidInput, "penalty", "parameters", "<lambda>"):
        solution.checked_margin(penalty=fh.Penalty(lambda x, p: x, effort=10.0))
    with refused_with(InvalidInput, "penalty", "state", "link_speed"):
        solution.checked_margin(penalty={"link_speed": 1.0})
