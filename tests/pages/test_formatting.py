"""Poses, units, changes and numbers as text."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.refusals import unnamed

import flexhinf as fh
from flexhinf.campaign.batches import PART
from flexhinf.designs import PoseEvidence
from flexhinf.loop import Supervision
from flexhinf.loop.controller.governor import Governor
from flexhinf.pages.campaign_text import column_scale, unlike_parts, value_in
from flexhinf.pages.design.weights import effort_unit, state_weights
from flexhinf.pages.drawing import (
    Units,
    amplitude_text,
    changes_text,
    few_ticks,
    listed,
    note,
    pose_text,
    range_text,
    settling_text,
    small_panels,
    units_of,
)
from flexhinf.report import Column, finite

Make = Callable[[str], PoseEvidence]


@pytest.mark.parametrize(
    ("values", "slides", "text"),
    [
        ([math.pi / 2], [False], "1.571 rad = 90°"),
        ([-0.0], [False], "0"),
        ([0.1], [True], "0.1 m"),
        ([0.1, -0.5], [True, False], "(0.1 m, −0.5 rad = −28.6°)"),
        ([0.1] * 4, [False] * 4, "(0.1, 0.1, 0.1, 0.1)"),
    ],
)
def test_poses(values: list[float], slides: list[bool], text: str) -> None:
    assert pose_text(values, slides) == text


def test_poses_of_a_user_who_gave_degrees() -> None:
    assert pose_text([math.pi / 2], [False], degrees=True) == "90°"
    assert pose_text([0.1, math.pi], [True, False], degrees=True) == "(0.1 m, 180°)"


def test_steps_ranges_and_settling() -> None:
    assert amplitude_text(math.pi, "rad") == "3.14 rad (180°)"
    assert amplitude_text(0.5, "m") == "0.5 m"
    assert amplitude_text(0.5, "rad or m") == "0.5 rad (28.6°) and 0.5 m"
    assert amplitude_text(6.3, "rad", 2.0).startswith("2 rad (115°), ")
    assert amplitude_text(1.0, "rad", 2.0) == "1 rad (57.3°)"
    assert listed(["a"]) == "a"
    assert listed(["a", "b", "c"]) == "a, b and c"
    assert unnamed(amplitude_text(math.inf, "rad"), "any", "inf") == ["inf"]
    assert amplitude_text(math.nan, "rad") == "–"
    assert range_text([2.0, 1.0]) == "1 to 2"
    assert range_text([2.0, 2.0]) == "2"
    assert settling_text(1.234) == "1.23 s"
    assert settling_text(None, 7.5) == "> 7.5 s"
    assert settling_text(math.inf) == "not settled"


def test_what_is_not_finite_becomes_none() -> None:
    value = {"a": np.array([1.0, np.inf]), "b": (np.nan, {"c": np.float64(2.0)}), "d": True, "e": "text"}
    assert finite(value) == {"a": [1.0, None], "b": [None, {"c": 2.0}], "d": True, "e": "text"}


def test_a_robot_is_described_by_its_largest_changes() -> None:
    arm = fh.paper_arm()

    def text(robot: fh.Robot, extras: tuple[str, ...] = (), **changed: float) -> str:
        return changes_text(robot.plant_parameters({**robot.nominal, **changed}), robot, extras)

    assert text(arm, stiffness=90.0, mass=1.03) == "stiffness −10 %, mass +3 %"
    assert text(arm, stiffness=90.0, inductance=0.2) == "stiffness −10 %"  # no coil in this true plant
    assert text(arm, ("inductance",), stiffness=90.0, inductance=0.2).startswith("inductance +100 %, ")
    assert unnamed(text(arm), "nominal", "%") == ["%"]
    planar = fh.load_robot("planar-two-link")
    assert text(planar, inertia_zz_elbow=1.2 * planar.nominal["inertia_zz_elbow"]) == "inertia zz elbow +20 %"
    assert text(planar, damping_elbow=1.0) == text(planar)
    with pytest.raises(TypeError, match="numbers"):
        changes_text({"mass": 1.0}, arm, ())


def test_a_payload_is_no_heavier_link() -> None:
    """Old code: mass elbow +92 %, inertia yy elbow +87 %, centre of mass x elbow +49 %, …"""
    robot = fh.load_robot("spatial-three-link", payload="0..2kg")
    ends = {p.name: 1.0 if p.name.startswith("payload") else 0.0 for p in robot.uncertain}
    assert changes_text(robot.corner(ends), robot, ()) == "payload mass elbow 2 kg"
    assert changes_text(robot.draw(np.random.default_rng(0)), robot, ()).startswith("payload mass elbow ")


def test_options_are_code_once() -> None:
    found = note("Try `--extras a --set friction_model=yes`, `--set integral_dead_zone`, or --set rays.")
    assert (
        found.text
        == "Try `--extras a --set friction_model=yes`, `--set integral_dead_zone`, or `--set rays`."
    )


def test_units_of_joints_that_turn_and_slide(robot_of: Callable[[str], Any]) -> None:
    cart = robot_of("cart")
    units = Units(cart.plant(), cart.joint_names, degrees=True)
    assert (units.position, units.speed, units.angle) == ("rad or m", "rad/s or m/s", "° or m")
    assert (units.load, units.spring, units.effort) == ("N·m or N",) * 3
    belt, arm = cart.joint_names  # which slides, and which turns
    assert [units.factor_of(units.scale, joint) for joint in (belt, arm)] == [
        1.0,
        pytest.approx(180.0 / math.pi),
    ]
    assert units.small_text(2e-3, 3, belt) == "2 mm"
    assert units.text(72.3, units.effort, arm) == "72.3 N·m"
    columns = [Column("joint", key="joint"), Column("to", units.angle, key="to", scale=units.scale)]
    heads, rows = units.by_joint(
        columns, [{"joint": belt, "to": 0.06}, {"joint": arm, "to": math.radians(30.0)}]
    )
    assert heads[1].unit == ""
    assert [row["to"] for row in rows] == ["0.06 m", "30°"]
    arm = robot_of("paper")
    turned = Units(arm.plant(), arm.joint_names, degrees=True)
    assert (turned.angle, turned.rate, turned.effort) == ("°", "°/s", "V")
    assert turned.scale == pytest.approx(180.0 / math.pi)
    assert Units(arm.plant(), arm.joint_names).small == ("mrad", 1e3)


@pytest.mark.ci("searches weights and noise of a law of degree 4")
def test_degrees_are_those_of_the_specification(report_design: Make) -> None:
    assert units_of(report_design("met").evaluation).angle == "°"
    assert units_of(report_design("rings").evaluation).angle == "rad"


@pytest.mark.ci("designs for two joints")
def test_weights_have_the_inverse_unit_of_what_they_weigh(report_design: Make) -> None:
    problem = report_design("cart").problem
    found = state_weights(problem, ("belt", "arm"))
    units = {name: unit for name, _, unit in found}
    assert units["link_position_belt"] == "1/m"
    assert units["link_position_arm_integral"] == "1/(rad·s)"
    assert units["joint_torque_rate_belt"] == "1/(N/s)"
    assert effort_unit(problem) == "N⁻² or (N·m)⁻²"
    assert all(weight for _, weight, _ in found)


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize("ends", [(2e-5, 2.9e-4), (1.4e-4, 2.3e-4), (0.0, 0.03), (4.5, 11.0), (0.0, 2e4)])
def test_numbers_beside_a_small_panel_do_not_touch(ends: tuple[float, float]) -> None:
    figure, (axis, *_) = small_panels(3, 1.9)
    axis.set_xlim(*ends)
    few_ticks(axis, ends[1], "x")
    figure.draw_without_rendering()
    marks = [m.label1 for m in axis.xaxis.get_major_ticks() if ends[0] <= m.get_loc() <= ends[1]]
    boxes = [mark.get_window_extent() for mark in marks]
    assert len(boxes) > 1
    assert all(one.x1 + 2.0 < other.x0 for one, other in pairwise(boxes))


def test_a_number_of_unlike_joints_has_the_unit_of_its_joint() -> None:
    columns = {
        "error": [2e-3, 5e-2],
        "error_slide": [1e-3, 5e-2],
        "error_turn": [2e-3, 1e-2],
        "time": [1.0, 2.0],
    }
    units = {"error": "", "error_slide": "m", "error_turn": "rad", "time": "s"}
    kinds = {PART: ("error_slide", "error_turn"), "trace": ()}
    table = SimpleNamespace(names=kinds.get, unit=units.get, journal=SimpleNamespace(settings={}))
    judged: Any = SimpleNamespace(table=table, column=lambda name: np.array(columns[name]))
    assert unlike_parts(judged, "error") == ["error_slide", "error_turn"]
    assert value_in(judged, "error", 2e-3) == (2.0, "mrad")
    assert value_in(judged, "error", 5e-2) == (50.0, "mm")
    assert value_in(judged, "time", 2.0) == (2.0, "s")
    assert column_scale(judged, "error_turn") == (pytest.approx(1e3), "mrad")


def test_what_a_controller_says_of_joints_that_slide_has_their_units() -> None:
    watch = Supervision(
        (np.array([-1.0, -1e-6]), np.array([1.0, 0.2])),
        following=[0.1, 0.02],
        reactions={"following": "brake"},
    )
    assert watch.box_text(("rad", "m")) == "−1 to 1 rad, 0 to 0.2 m"
    assert unnamed(watch.reactions_text(("rad", "m")), "0.1 rad or 0.02 m") == []
    governor = Governor([0.1, 0.02], [2.0, 0.5], [3.0, 1.0], [-1.0, 0.0], [1.0, 0.2], resistance=[4.0, 5.0])
    said = governor.text_in(("rad", "m"))
    assert unnamed(said, "0.1 rad at 2 rad/s", "0.02 m at 0.5 m/s", "4 rad/s², 5 m/s²") == []
