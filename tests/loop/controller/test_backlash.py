"""Backlash that is taken out of what is measured, against its formula and a loop of two links without weight."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.designs.plans import stated_backlash
from flexhinf.designs.workspace.setup import WorkspaceSetup
from flexhinf.errors import InvalidInput
from flexhinf.loop import Backlash
from flexhinf.loop.controller.backlash import engaged
from flexhinf.modal import ModalLaw
from flexhinf.modal.pair import PairWeights
from flexhinf.robot import Parameter
from flexhinf.robot.workspace import workspace_of

ARM = fh.load_robot("planar-two-link")
GAP = 5e-4
LINKS, MOTORS = ([f"{side}_position_{joint}" for joint in ARM.joint_names] for side in ("link", "motor"))
BOTH = {"measured": ("link_position", "motor_position")}


def test_the_arm_without_a_gap_has_the_same_torques_and_is_where_the_command_has_it() -> None:
    places, width, rng = (((0, 2), (0, 4)), ((1, 3), (1, 5))), np.array([0.1, 0.4]), np.random.default_rng(1)
    whole = partial(engaged, places, (0, 1, 2, 3))
    for _ in range(50):
        link, twist, planned = rng.uniform(-3.0, 3.0, 2), rng.normal(size=2), rng.normal(size=2)
        command = np.concatenate([link, np.zeros(2), link + planned, np.zeros(4)])
        y, added = whole(np.concatenate([link, link + twist + 2.0 * np.pi]), command, width)
        beyond = twist - np.clip(twist, -0.5 * width, 0.5 * width)
        np.testing.assert_allclose(np.cos(y[2:] - y[:2] - beyond), 1.0, atol=1e-12)
        same = np.clip(planned, -0.5 * width, 0.5 * width) == np.clip(twist, -0.5 * width, 0.5 * width)
        np.testing.assert_allclose(added[:2][same], 0.0, atol=1e-12)
        np.testing.assert_allclose(-added[2:], np.clip(planned, -0.5 * width, 0.5 * width))
    for missing in (np.nan, np.inf):
        y, added = whole(np.array([missing, 0.0, 1.0, 1.0]), np.zeros(10), width)
        assert (added[0], added[2], y[2]) == (0.0, 0.0, 1.0)
        assert not np.isfinite(y[0])
        assert added[1] == 0.2


@pytest.mark.ci("a long run")
def test_links_without_weight_rest_in_their_gaps() -> None:
    """No friction holds them. A controller that takes the gap for twist throws each from side to side of its gap."""
    level = replace(ARM, links=replace(ARM.links, down=(0.0, 0.0, 1.0)))
    level = replace(level, parameters=[p for p in level.parameters if not p.name.startswith("coulomb")])
    robot = level.with_parameters(*(Parameter(f"backlash_{joint}", GAP) for joint in ARM.joint_names))
    law = ModalLaw.tuned(
        robot.problem(fh.Penalty({"link_position": 1.0})), weights=PairWeights(bandwidth=20.0)
    )
    s, space = fh.Specification(workspace="limits", **BOTH), workspace_of(robot, "limits")
    ends = np.array([[0.2, 0.3], [0.6, -0.4]])
    move = WorkspaceSetup(robot, s, space, law).move(ends, dwell=3.0)
    assert np.all(move.swing < 0.3 * GAP)
    state = partial(move.response.run.signal, "state")
    for joint, goal in zip(ARM.joint_names, ends[1]):
        assert np.abs(state(f"link_position_{joint}")[-500:] - goal).max() < GAP


def test_it_is_of_gaps_that_are_seen_from_both_sides_saved_copied_and_refused(tmp_path: object) -> None:
    robot = ARM.with_parameters(Parameter("backlash_elbow", GAP))
    gap = stated_backlash(robot, [*LINKS, *MOTORS])
    assert gap == Backlash([GAP], LINKS[1:], MOTORS[1:])
    assert stated_backlash(robot, LINKS) is None
    assert stated_backlash(ARM, [*LINKS, *MOTORS]) is None
    law = ModalLaw.tuned(ARM.problem(fh.Penalty({"link_position": 1.0})))
    state = ARM.operating_point()[0]
    filters = [
        fh.ExtendedKalmanFilter(ARM.plant(names), 1e-3, 1e-6, 1e-8, state, 1e-6)
        for names in (BOTH["measured"], "link_position")
    ]
    controller = fh.Controller(law, filters[0], moving=True, backlash=gap)
    controller.save(f"{tmp_path}/controller")
    for same in (fh.load_controller(f"{tmp_path}/controller"), controller.fresh()):
        assert same.backlash == gap
    assert "backlash" in repr(controller)
    for estimator, moving in ((filters[0], False), (filters[1], True), (None, True)):
        with refused_with(InvalidInput, "backlash", "motor_position_elbow", f"moving={moving}"):
            fh.Controller(law, estimator, moving=moving, backlash=gap)
    with refused_with(InvalidInput, "backlash", "-1.0"):
        Backlash([-1.0], LINKS[1:], MOTORS[1:])
