"""Poses, changes and weights in words."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from flexhinf.design import Design, verdict
from flexhinf.design.page.changes import change_words
from flexhinf.design.page.units import pose_words, step_words, units_of
from flexhinf.design.page.weights_of import effort_unit, state_weights

Make = Callable[[str], Design]


@pytest.mark.parametrize(
    ("values", "slides", "words"),
    [
        ([math.pi / 2], [False], "1.571 rad = 90°"),
        ([-0.0], [False], "0"),
        ([0.1], [True], "0.1 m"),
        ([0.1, -0.5], [True, False], "(0.1 m, −0.5 rad = −28.6°)"),
        ([0.1] * 4, [False] * 4, "(0.1, 0.1, 0.1, 0.1)"),
    ],
)
def test_poses(values: list[float], slides: list[bool], words: str) -> None:
    assert pose_words(values, slides) == words


def test_steps() -> None:
    assert step_words(math.pi, "rad") == "3.14 rad (180°)"
    assert step_words(0.5, "m") == "0.5 m"
    assert step_words(math.inf, "rad") == "any looked at"
    assert step_words(math.nan, "rad") == "–"


def test_a_robot_is_told_by_its_largest_changes(page_design: Make) -> None:
    design = page_design("met")
    nominal = design.bench.true_plant.parameters.values
    changed: dict[str, Any] = {**nominal, "stiffness": 0.9 * np.asarray(nominal["stiffness"])}
    assert change_words(design, changed) == "stiffness −10 %"
    changed["inductance"] = 2.0 * np.asarray(nominal["inductance"])  # no coil in this true plant
    assert change_words(design, changed) == "stiffness −10 %"
    assert change_words(design, nominal) == "the nominal one"


def test_weights_have_the_inverse_unit_of_what_they_weigh(page_design: Make) -> None:
    design = page_design("cart")
    units = {weight.signal: weight.unit for weight in state_weights(design)}
    assert units["link_position_belt"] == "1/m"
    assert units["link_position_arm_integral"] == "1/(rad·s)"
    assert units["joint_torque_rate_belt"] == "1/(N/s)"
    assert effort_unit(design) == "N⁻² or (N·m)⁻²"
    weights = np.array([weight.value for weight in state_weights(design)])
    assert np.count_nonzero(weights) == len(weights)


def test_units_of_both_kinds_of_joints_are_named(page_design: Make) -> None:
    units = units_of(page_design("cart"))
    assert (units.position, units.speed) == ("m or rad", "m/s or rad/s")
    assert (units.load, units.spring, units.effort) == ("N or N·m",) * 3
    assert units_of(page_design("met")).effort == "V"


def test_the_verdict_tells_the_rigid_design_too(page_design: Make) -> None:
    text = verdict(page_design("met"))
    assert text.startswith("Specification met")
    assert "The rigid design on the same robot" in text
    assert "the rigid design" not in verdict(page_design("robust")).lower()
