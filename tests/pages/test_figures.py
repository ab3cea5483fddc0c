"""What the frequency, pole and arm figures compute for drawing."""

from __future__ import annotations

import re
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.design import PoseEvidence
from flexhinf.pages.campaign import _arms
from flexhinf.pages.design.frequency import Loop, frequency_figures
from flexhinf.pages.design.law import poles_figure
from flexhinf.pages.design.step import arm_figure, instants
from flexhinf.pages.drawing import framed, joint_panel, thin
from flexhinf.report import new_figure

Make = Callable[[str], PoseEvidence]


def test_instants_are_where_parts_of_the_way_are_done() -> None:
    time = np.linspace(0.0, 1.0, 101)
    positions = np.column_stack([time, 2.0 * time])
    assert instants(positions, np.zeros(2), np.array([1.0, 2.0])) == [0, 25, 50, 75, 100]
    assert instants(positions[:40], np.zeros(2), np.array([1.0, 2.0])) == [0, 25, 39]
    assert instants(positions, np.ones(2), np.ones(2)) == [0]


def test_a_robot_without_lengths_is_not_drawn() -> None:
    time = np.linspace(0.0, 1.0, 5)
    for name, there in (("paper", True), ("quanser-rotflex", False)):
        robot = fh.load_robot(name)
        figure = arm_figure(robot, time, time[:, None], time[:, None] + 0.1, [0, 4])
        assert (figure is not None) is there


def test_a_horizontal_arm_with_links_at_several_heights_is_drawn_from_above() -> None:
    robot, time = fh.load_robot("scara"), np.linspace(0.0, 1.0, 2)
    links = np.array([robot.home, np.asarray(robot.home) + 0.1])
    figure = arm_figure(robot, time, links, links, [0, 1])
    assert figure is not None
    assert "above" in figure.svg


@pytest.mark.ci("draws two arms")
def test_the_figure_is_as_high_as_the_arm_needs() -> None:
    time = np.linspace(0.0, 1.0, 5)
    heights = {}
    for name, angle in (
        ("paper", 1.5),
        ("planar-two-link", 0.1),
    ):  # one is nearly level, the other hangs down
        robot = fh.load_robot(name)
        links = angle + 0.01 * np.outer(time, np.ones(len(robot.joint_names)))
        figure = arm_figure(robot, time, links, links, [0, 1, 2, 3, 4])
        assert figure is not None
        (box,) = re.findall(r'viewBox="([^"]+)"', figure.html())
        heights[name] = float(box.split()[3])
    assert heights["planar-two-link"] > 1.5 * heights["paper"]


@pytest.mark.ci("searches weights and noise of a law of degree 4")
def test_frequency_figures_draw_a_line_for_each_loop(report_design: Make) -> None:
    response = report_design("met").evaluation.frequency_response
    one = frequency_figures([Loop("a", response)], ["joint"], "rad/(N·m)")
    assert [figure.id for figure in one] == ["figure-bode", "figure-sensitivity", "figure-nyquist"]
    distance = np.abs(1.0 + response.input_loops[:, 0]).min()
    assert f"smallest distance, {distance:.2f}" in one[2].caption
    two = frequency_figures([Loop("a", response), Loop("b", response)], ["joint"], "rad/(N·m)")
    assert "smallest distance" not in two[2].caption
    assert "b</text>" in two[1].svg  # its name; what is drawn of every law stands in the caption
    assert "S: how much" in two[1].caption
    assert frequency_figures([], ["joint"], "rad/(N·m)") == []


def test_poles_of_every_group_are_drawn() -> None:
    groups = [
        ("open", np.array([0.0, -1.0 + 9.0j, -1.0 - 9.0j]), {"marker": "o", "markerfacecolor": "none"}),
        ("closed", np.array([-5.0, -3.0 + 3.0j]), {"marker": "x"}),
        ("none", np.array([]), {"marker": "^"}),
    ]
    svg = poles_figure(groups).svg
    assert "open" in svg
    assert "closed" in svg
    assert "none</text>" not in svg


def test_axes_show_every_finite_value() -> None:
    low, high = framed(np.array([1.0, 3.0, np.nan, np.inf]))
    assert (low, high) == pytest.approx((0.88, 3.12))
    _, (axes,) = new_figure()
    joint_panel("", "", np.arange(2.0), ["a"], np.array([[0.0], [0.1]]), min_span=1.0).draw(axes)
    assert axes.get_ylim() == pytest.approx((-0.45, 0.55))
    assert len(np.arange(10_000)[thin(np.arange(10_000))]) <= 1500


def test_arms_of_a_campaign_are_drawn_where_both_runs_are_finite(monkeypatch: pytest.MonkeyPatch) -> None:
    """A run whose links end in NaN has no place to draw them at."""
    robot = fh.load_robot("planar-two-link")
    rests = np.zeros((5, 8))
    broken = rests.copy()
    broken[3:, 1] = np.nan
    runs = dict(
        enumerate(SimpleNamespace(time=np.arange(5.0), signals={"state": x}) for x in (rests, broken, rests))
    )
    request = SimpleNamespace(request=SimpleNamespace(robot=robot))
    stored = SimpleNamespace(replay=runs.__getitem__), None
    monkeypatch.setattr("flexhinf.pages.campaign.stored_campaign", lambda folder: stored)
    monkeypatch.setattr("flexhinf.pages.campaign.stored_request", lambda journal: request)
    for worst, count in ((1, 0), (2, 1)):  # the median is of sample 0
        judged: Any = SimpleNamespace(
            worst_of_all=worst,
            main="overshoot",
            column=lambda name, worst=worst: np.where(
                np.arange(3) == worst, [2.0, 2.0, 2.0], [1.0, 0.0, 0.0]
            ),
            table=SimpleNamespace(journal=SimpleNamespace(folder="runs")),
        )
        assert len(_arms(judged)) == count
