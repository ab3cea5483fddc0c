"""Loops of a workspace's controller on robots at corners of their tolerances and payloads."""

from __future__ import annotations

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.design.workspace import (
    PoseLoop,
    WorkspaceSetup,
    corner_requirements,
    random_corners,
)
from flexhinf.modal import ModalLaw
from flexhinf.modal.pair import PairWeights
from flexhinf.robot.workspace import workspace_of

BOTH = ("link_position", "motor_position")
GOOD = PoseLoop(
    growth=0.98, damping=0.3, fast_damping=0.1, damped_fast=0.12, late=0.99, damped_late=0.995, louder=0.985,
    softer=0.985, ripple=0.8,
)  # fmt: skip


def setup_of(payload: str) -> WorkspaceSetup:
    robot = fh.load_robot("planar-two-link", payload=payload)
    law = ModalLaw.tuned(
        robot.problem(fh.Penalty({"link_position": 1.0})), weights=PairWeights(bandwidth=20.0)
    )
    s = fh.Specification(workspace="limits", measured=BOTH)
    return WorkspaceSetup(robot, s, workspace_of(robot, "limits"), law)


def test_every_number_is_at_an_end_of_its_interval() -> None:
    robot = fh.load_robot("planar-two-link", payload="0..0.5..1kg")
    corners = random_corners(robot, 40, 3)
    between = {p.name: p.interval for p in robot.uncertain}
    for k, joint in enumerate(robot.joint_names):
        assert {corner["stiffness"][k] for corner in corners} == set(between[f"stiffness_{joint}"])
    carried = {round(corner["mass"][1], 9) for corner in corners}
    assert carried == {link + load for link in between["mass_elbow"] for load in (0.0, 1.0)}
    assert len({tuple(corner["mass"]) for corner in corners}) == 8  # links and payload apart
    assert random_corners(fh.load_robot("scara"), 0, 3) == []


@pytest.mark.oracle
def test_the_loop_at_a_corner_has_the_plant_of_a_robot_that_is_so() -> None:
    """A robot with half a kilogram in its model that carries one, against the robot whose model has one."""
    unknown, known = setup_of("0..0.5..1kg"), setup_of("1kg")
    ends = [1.0 if "payload" in p.name else 0.0 for p in unknown.robot.uncertain]
    assert sum(ends) == 1.0
    heavy, q = unknown.robot.corner(ends), np.array([0.4, -0.9])
    found, light, expected = unknown.linear(q, heavy), unknown.linear(q), known.linear(q)
    np.testing.assert_allclose(found.a, expected.a, rtol=1e-9, atol=1e-7)
    np.testing.assert_allclose(found.memory, light.memory)  # the controller does not know it
    assert np.abs(found.a - light.a).max() > 1.0


@pytest.mark.parametrize(
    ("changes", "missed"),
    [
        ({}, []),
        ({"growth": 1.01}, [0]),
        ({"damping": 0.15}, []),
        ({"damping": 0.09}, [1]),
        ({"late": 1.01}, []),
    ],
)
def test_they_are_stable_and_do_not_ring(changes: dict[str, float], missed: list[int]) -> None:
    s = fh.Specification(workspace="limits", measured=BOTH)
    lines = corner_requirements(s, [GOOD, GOOD._replace(**changes), GOOD])
    assert [k for k, line in enumerate(lines) if not line.met] == missed
    assert corner_requirements(s, []) == []
