"""Figures of a design's campaign: the worst of all joints, and of each one; what samples are not for."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.campaign import Campaign, run_batch
from flexhinf.designs import DesignRequest, PoseCampaign, Specification
from flexhinf.designs.campaign_options import CampaignOptions
from flexhinf.designs.deployed_run import DesignedLaw
from flexhinf.designs.loop_setup import LoopSetup
from flexhinf.designs.responses import Response
from flexhinf.loop.simulation.metrics import steady_state_error

ROBOT = "planar-two-link"


def asked(**fields: Any) -> PoseCampaign:
    specification = Specification(estimator="none", **fields)
    return PoseCampaign.of(
        DesignRequest(fh.load_robot(ROBOT), specification, ROBOT), CampaignOptions(8, batch=8)
    )


def campaign_of(one: PoseCampaign) -> Campaign:
    robot = one.request.robot
    law = fh.linear_law(robot.problem(pose=one.specification.pose), math.inf)
    return one.campaign(DesignedLaw(fh.Controller(law, None, 1e-3, start="bumpless"), 4.0))


def check_by_signals(one: PoseCampaign, campaign: Campaign, found: Mapping[str, np.ndarray]) -> None:
    """The same bits (a rise time to its rounding) by another route: of the signals of each run, in NumPy."""
    metrics, (start, goal) = one.metrics, one.ends
    limits = metrics.limits
    for sample, number in enumerate(found["sample"].tolist()):
        run = campaign.replay(number)
        response = Response(run, goal, start, limits.joints)
        expected: dict[str, float] = {}
        for k, row in enumerate(response.metrics):
            if one.plan is not None:
                name = f"link_position_{limits.joints[k]}"
                position, command = response.positions[:, k], run.signal("reference", name)
                row |= {
                    "tracking_error": np.abs(position - command).max(),
                    "final_error": steady_state_error(position, command),
                }
            expected |= {f"{kind}_{row['joint']}": value for kind, value in row.items()}
        checked = {name: expected[name] for name in found if name in expected}
        for kind, (_, joints) in metrics.joint_metrics.items():
            values = [expected.get(f"{kind}_{limits.joints[k]}", math.nan) for k in joints]
            checked[kind] = max((math.inf if value is None else value for value in values), default=math.nan)
        for kind in ("tracking_error_use", "final_error_use"):
            checked.pop(kind, None)
        uses = {
            "input_limit_use": (response.inputs, limits.peak),
            "speed_limit_use": (response.velocities, limits.speed),
        }
        checked |= {
            name: (np.abs(values) / most).max() for name, (values, most) in uses.items() if name in found
        }
        names = [
            f"link_position_{joint}" if len(limits.joints) > 1 else "link_position" for joint in limits.joints
        ]
        errors = [
            np.abs(run.signal("estimate", name) - run.signal("state", name)).max()
            for name in names
            if name in run.names["estimate"]
        ]
        checked["estimation_error"] = max(errors, default=math.nan)
        assert len(checked) > 6
        for name, value in checked.items():
            exact = not name.startswith("rise_time_s")
            value = math.inf if value is None else value
            np.testing.assert_allclose(found[name][sample], value, rtol=0.0 if exact else 1e-12, err_msg=name)
        assert all("_error_use" in name for name in set(metrics.units) - set(checked))


@pytest.mark.ci("a campaign of its own")
def test_each_joint_has_figures_of_its_own() -> None:
    one = asked(pose=(0.3, 0.2), start=(0.2, 0.1))
    campaign = campaign_of(one)
    found = run_batch(campaign, 0)
    kinds = {column.name: (column.kind, column.unit) for column in campaign.columns}
    assert kinds["overshoot_percent"] == ("metric", "%")
    assert kinds["peak_speed_elbow"] == ("part metric", "rad/s")
    for name in ("overshoot_percent", "settling_time_s", "steady_state_error", "peak_input", "peak_speed"):
        shoulder, elbow = (found[f"{name}_{joint}"] for joint in ("shoulder", "elbow"))
        np.testing.assert_array_equal(np.maximum(shoulder, elbow), found[name], name)
        assert name in ("overshoot_percent", "settling_time_s") or not np.array_equal(shoulder, elbow)
    check_by_signals(one, campaign, found)


def test_a_joint_that_does_not_move_has_no_step() -> None:
    names = asked(pose=(0.3, 0.2), start=(0.3, 0.1)).metrics.units
    assert "overshoot_percent_elbow" in names
    assert "overshoot_percent_shoulder" not in names
    assert "peak_input_shoulder" in names


MOVE = "time [s],shoulder [deg],elbow [deg]\n0,0,0\n1,10,10\n2,20,10\n"


@pytest.mark.parametrize("shaping", ["jump", "quintic"])
def test_the_damping_that_is_searched_is_that_of_the_design(shaping: str) -> None:
    """Of the law about its goal, or about a moving reference, on the plant of the design's margins."""
    one = asked(pose=(0.6, -0.4), shaping=shaping)
    campaign, s = campaign_of(one), one.specification
    setup = LoopSetup(one.request.robot, s, campaign.loop.controller.law, one.ends[1], one.ends[0])
    assert campaign.loop.controller.mode.moving == (shaping == "quintic")
    found = campaign.linear_damping(campaign.draw.samples([0, 1], 8, 0))[0]
    for k, ratio in enumerate(found.tolist()):
        values = setup.equilibrium_loop().plant.parameters.known(campaign.sample(k).parameters)
        linear = setup.equilibrium_loop().linear(values)
        assert ratio == pytest.approx(linear.closed_loop.damping_about(s.damped_below_limit)[0], rel=1e-6)


@pytest.fixture
def along(tmp_path: Path) -> PoseCampaign:
    file = tmp_path / "move.csv"
    file.write_text(MOVE)
    return asked(move=str(file))


@pytest.mark.ci("a kernel of moves")
def test_a_campaign_along_a_move_says_how_far_from_it_and_from_its_end(along: PoseCampaign) -> None:
    robot = along.request.robot
    np.testing.assert_allclose(np.degrees(along.ends), [[0.0, 0.0], [20.0, 10.0]], atol=1e-9)
    law = fh.linear_law(robot.problem(pose=along.ends[1]), math.inf)
    campaign = along.campaign(DesignedLaw(fh.Controller(law, None, 1e-3, moving=True), 2.5))
    found = run_batch(campaign, 0)
    again = campaign.replay(3)
    plan = along.plan
    assert plan is not None
    errors = again.signals["state"][:, :2] - plan(again.time)
    assert found["tracking_error_elbow"][3] > 1e-5
    np.testing.assert_allclose(found["tracking_error_elbow"][3], np.abs(errors[:, 1]).max(), rtol=1e-9)
    np.testing.assert_allclose(found["final_error_shoulder"][3], np.abs(errors[-251:, 0]).max(), rtol=1e-9)
    # 5 % and 2 % of the ways of both joints, 20 and 10 degrees.
    ways = np.radians([20.0, 10.0])
    np.testing.assert_allclose(
        found["tracking_error_use"][3], np.max(np.abs(errors).max(axis=0) / (0.05 * ways))
    )
    assert "overshoot_percent" not in found
    check_by_signals(along, campaign, found)
