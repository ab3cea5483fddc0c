"""Payloads that are weighed by the motors at rest."""

from __future__ import annotations

import numpy as np
import pytest
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.robot import weigh_payload

POSE = (0.5, 0.4)


@pytest.fixture(scope="module")
def robot() -> fh.Robot:
    """Two links with DC motors and dry friction, and 0 to 3 kg at the end."""
    return fh.load_robot("planar-two-link", payload="0..3kg@elbow")


def held(robot: fh.Robot, **values: float) -> np.ndarray:
    """What the motors of a robot with these numbers give at `POSE`, V."""
    return robot.operating_point(POSE, (), robot.plant_parameters({**robot.nominal, **values}))[1]


def test_what_holds_a_payload_says_its_mass(robot: fh.Robot) -> None:
    found = weigh_payload(robot, POSE, held(robot, payload_mass_elbow=1.7))
    assert found.masses["payload_mass_elbow"] == pytest.approx(1.7, rel=1e-9)
    assert np.abs(found.unexplained).max() < 1e-9
    told = robot.with_values(found.masses)
    np.testing.assert_allclose(told.operating_point(POSE)[1], held(robot, payload_mass_elbow=1.7), rtol=1e-9)


def test_two_weighings_cancel_what_the_links_are_uncertain_by(robot: fh.Robot) -> None:
    other = {"mass_elbow": 1.1 * robot["mass_elbow"].value}
    loaded, empty = held(robot, payload_mass_elbow=1.0, **other), held(robot, **other)
    assert weigh_payload(robot, POSE, loaded).masses["payload_mass_elbow"] > 1.03
    found = weigh_payload(robot, POSE, loaded, empty)
    assert found.masses["payload_mass_elbow"] == pytest.approx(1.0, rel=1e-9)


def test_dry_friction_hides_no_more_than_is_told(robot: fh.Robot) -> None:
    """Each motor may give less or more by its friction, here 1 and 0.5 N·m."""
    p = robot.plant_parameters()
    volts = np.array([1.0, 0.5]) / (p["torque_constant"] / p["resistance"])
    held_up = held(robot, payload_mass_elbow=2.0)
    errors = []
    for signs in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        found = weigh_payload(robot, POSE, held_up + np.array(signs) * volts)
        errors.append(abs(found.masses["payload_mass_elbow"] - 2.0))
    assert max(errors) == pytest.approx(found.hidden["payload_mass_elbow"], rel=1e-9)


def test_what_cannot_be_weighed_is_refused(robot: fh.Robot) -> None:
    with refused_with(InvalidInput, "'payload_mass_elbow'", "(0.0, 0.0)"):
        weigh_payload(robot, (0.0, 0.0), held(robot))  # hanging
    with refused_with(InvalidInput, "'planar-two-link'", "[[payload]]"):
        weigh_payload(fh.load_robot("planar-two-link"), POSE, held(robot))
    for effort in ([1.0], [np.nan, 1.0], "heavy"):
        with pytest.raises(InvalidInput, match="joints"):
            weigh_payload(robot, POSE, effort)
