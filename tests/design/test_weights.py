"""Weights for robots that state none: one rule, all shipped robots."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.design import Specification
from flexhinf.design.modes import closed_loop, modes_of, stiffness_and_inertia
from flexhinf.design.penalty import chosen_penalty
from flexhinf.design.weights import scaled_weights


@pytest.mark.parametrize("name", list(fh.catalogue()))
def test_the_rule_gives_a_stable_damped_loop_of_about_its_bandwidth(name: str) -> None:
    robot = replace(fh.load_robot(name), penalty=None)
    scaled = scaled_weights(robot, None, None, None)
    problem = robot.problem(scaled.penalty)
    law = fh.linear_law(problem, gamma=1.5 * fh.smallest_gamma(problem))
    e = law.expansion
    gain = -np.linalg.solve(e.r2, e.g2_parts[0][:, :, 0].T @ law.P)
    energy = stiffness_and_inertia(problem.plant, robot.operating_point())
    before = modes_of(problem.plant.linearise(*robot.operating_point())[0], robot.joint_names, *energy)
    after = modes_of(closed_loop(problem, gain), robot.joint_names, *energy)
    assert all(mode.stable for mode in after)
    vibrations = sorted((mode for mode in after if mode.vibration), key=lambda mode: mode.frequency)
    assert vibrations[0].damping > 0.2
    assert min(m.damping for m in vibrations) > 2 * min(m.damping for m in before if m.vibration)
    others = [mode for mode in after if not mode.vibration]
    assert all(mode.damping > 0.8 for mode in others)
    slowest = min(mode.frequency for mode in after)
    assert 0.4 * scaled.bandwidth < slowest < 1.5 * scaled.bandwidth


def test_an_asked_bandwidth_moves_the_loop_with_it() -> None:
    robot = fh.load_robot("spatial-three-link")
    slowest = []
    for bandwidth in (0.5, 1.0, 2.0):
        problem = robot.problem(scaled_weights(robot, None, bandwidth, None).penalty)
        law = fh.linear_law(problem, gamma=1.5 * fh.smallest_gamma(problem))
        e = law.expansion
        a = closed_loop(problem, -np.linalg.solve(e.r2, e.g2_parts[0][:, :, 0].T @ law.P))
        slowest.append(np.abs(np.linalg.eigvals(a)).min())
    assert np.array(slowest[1:]) / np.array(slowest[:-1]) == pytest.approx([2.0, 2.0], rel=0.3)


def test_who_says_so_is_never_silent() -> None:
    robot = fh.load_robot("vertical-rig")
    own = chosen_penalty(robot, None, Specification())
    assert own.penalty is robot.penalty
    assert own.source == "the robot's file"
    asked = chosen_penalty(robot, None, Specification(penalty={"link_position": 3.0}, effort=2.0))
    assert (asked.source, asked.effort_source, asked.penalty.effort) == (
        "option --penalty",
        "option --effort",
        2.0,
    )
    ours = chosen_penalty(replace(robot, penalty=None), None, Specification())
    assert ours.source.startswith("ours: scaled for")
    with pytest.raises(fh.InvalidInput, match="contradict"):
        chosen_penalty(robot, None, Specification(penalty=[1, 1, 1, 1, 1], bandwidth=1.0))
