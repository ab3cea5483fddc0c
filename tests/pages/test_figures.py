"""What the frequency, pole and arm figures compute for drawing."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.designs import PoseEvidence
from flexhinf.pages import campaign, certificate
from flexhinf.pages.design.frequency import LoopLine, _lines, frequency_figures
from flexhinf.pages.design.law import poles_figure
from flexhinf.pages.design.step import arm_figure, instants
from flexhinf.pages.drawing import (
    Line,
    Panel,
    Units,
    draw_figure,
    framed,
    joint_panel,
    joint_panels,
    thin,
)
from flexhinf.processors import limited_threads
from flexhinf.report import Figure, new_figure, with_figures

Make = Callable[[str], PoseEvidence]


def test_instants_are_where_parts_of_the_way_are_done() -> None:
    time = np.linspace(0.0, 1.0, 101)
    positions = np.column_stack([time, 2.0 * time])
    assert instants(positions, np.zeros(2), np.array([1.0, 2.0])) == [0, 25, 50, 75, 100]
    assert instants(positions[:40], np.zeros(2), np.array([1.0, 2.0])) == [0, 25, 39]
    assert instants(positions, np.ones(2), np.ones(2)) == [0]


def test_any_number_of_processes_draws_the_same_figures() -> None:
    """Three: the first is drawn here, and two processes share the others."""

    def figures(count: int) -> list[str]:
        with limited_threads(count):
            (blocks,) = with_figures(partial(curve, k) for k in (1, 2, 3))
        return [block.html() for block in blocks]

    def curve(k: int) -> Figure:
        x = np.linspace(0.0, 1.0, 20)
        return draw_figure(f"power-{k}", [Panel("way", "m", [Line(x, x**k, None, {})])], "way", "way")

    alone = figures(1)
    assert len(set(alone)) == 3
    assert figures(2) == alone


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
    one = frequency_figures([LoopLine("a", response)], ["joint"], ["rad/(N·m)"])
    assert [figure.id for figure in one] == ["figure-bode", "figure-sensitivity", "figure-nyquist"]
    distance = np.abs(1.0 + response.input_loops[:, 0]).min()
    assert f"smallest distance, {distance:.2f}" in one[2].caption
    two = frequency_figures([LoopLine("a", response), LoopLine("b", response)], ["joint"], ["rad/(N·m)"])
    assert "smallest distance" not in two[2].caption
    assert "b</text>" in two[1].svg  # its name; what is drawn of every law stands in the caption
    assert "S: how much" in two[1].caption
    assert frequency_figures([], ["joint"], ["rad/(N·m)"]) == []


def test_a_loop_has_a_line_for_each_joint_and_several_have_one_each() -> None:
    """Of the joint that a torque on its link moves most."""
    names = ("link_position_shoulder", "link_position_elbow")
    linear: Any = SimpleNamespace(names=names, disturbances=[n.replace("position", "torque") for n in names])
    response: Any = SimpleNamespace(linear=linear, disturbance=np.array([[[2.0, 9.0], [9.0, 4.0]]]))
    joints, loops = ("shoulder", "elbow"), [LoopLine("a", response), LoopLine("b", response, 1)]
    assert [(line[0], line[3]) for line in _lines(loops[:1], joints)] == [("shoulder", 0), ("elbow", 1)]
    assert [(line[0], line[3]) for line in _lines(loops[:1], joints[:1])] == [("a", 0)]
    assert [(line[0], line[3]) for line in _lines(loops, joints)] == [("a", 1), ("b", 1)]


def test_the_largest_proved_start_is_one_share_of_it_and_the_limit_one_of_the_limit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    lines: list[Any] = []
    monkeypatch.setattr(
        certificate, "_slice", lambda place, claim, cut, scales, points, *_, **__: lines.extend(points)
    )
    states = [SimpleNamespace(name="link_position", unit="rad")]
    claim = SimpleNamespace(sampled_level=2.0, states=states, level=1.0)
    plane = SimpleNamespace(limit="inequality", moved=None, point=[0.3])
    certificate._limit(SimpleNamespace(certificate=claim, limit=plane))  # type: ignore[arg-type]
    assert [tuple(line[:2]) for line in lines] == [(0.0, 1.0), (1.0, 0.0)]


def test_the_first_histogram_of_each_row_names_what_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    counted: list[tuple[bool, str]] = []
    monkeypatch.setattr(
        campaign, "histogram",
        lambda axis, judged, name, unit, values, what: counted.append((axis.get_subplotspec().is_first_col(), what)),
    )  # fmt: skip
    monkeypatch.setattr(campaign, "column_scale", lambda judged, name: (1.0, "s"))
    monkeypatch.setattr(campaign, "figure_block", lambda name, figure, *_: figure)
    judged: Any = SimpleNamespace(
        column=lambda name: np.array([1.0, 2.0, np.inf]),
        requirements=(),
        of_status=lambda status: 0,
    )
    campaign._histograms(judged, ["a", "b", "c", "d", "e"])
    assert len(counted) == 5
    assert {*counted} == {(True, "samples"), (False, "")}


# Others -------------------------------------------------------------------------------------------------
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


def test_a_legend_and_names_of_axes_beside_each_other_are_not_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    """In a figure of two panels, with a point that lies at the top of an axis from 0."""
    drawn = []
    monkeypatch.setattr("flexhinf.pages.drawing.figure_block", lambda _, figure, *texts: drawn.append(figure))
    points = np.array([0.0, 1.0])
    names = ("without control", "law on the true state", "running loop (sampled, estimator, delay)")
    lines = [Line(points, points, name, {"marker": "o"}) for name in names]
    panel = Panel("damping", "", lines, across="noise at the motor, rms (V)", y=(0.0, None))
    draw_figure("two", [panel, panel], "", "", 3.2, columns=2)
    (figure,) = drawn
    figure.draw_without_rendering()
    (legend,), (left, right) = figure.legends, figure.axes
    assert legend.get_window_extent().x1 <= figure.bbox.width
    assert left.xaxis.label.get_window_extent().x1 < right.xaxis.label.get_window_extent().x0
    assert right.xaxis.label.get_window_extent().x1 <= figure.bbox.width
    assert left.get_ylim() == pytest.approx((0.0, 1.1), abs=0.06)
    assert left.get_ylim()[1] > 1.04


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
    for worst, both in ((1, False), (2, True)):  # the median is of sample 0
        judged: Any = SimpleNamespace(
            worst_of_all=worst,
            main="overshoot",
            column=lambda name, worst=worst: np.where(
                np.arange(3) == worst, [2.0, 2.0, 2.0], [1.0, 0.0, 0.0]
            ),
            table=SimpleNamespace(journal=SimpleNamespace(folder="runs")),
        )
        assert (campaign._arms(judged) is not None) == both


def test_joints_that_turn_and_slide_have_panels_of_their_own() -> None:
    robot = fh.load_robot("scara")  # the third joint slides
    units, time = Units(robot.plant(), robot.joint_names, True), np.arange(2.0)
    values = np.array([[0.0, 0.0, 0.0, 0.0], [1.0, 2.0, 0.1, 3.0]])
    turns, slides = joint_panels(
        units, "link", units.angle, time, units.scale * values, limits=np.full(4, 0.1), limit_name="most",
        min_span=np.array([0.0, 0.0, 4.0, 0.0]),
    )  # fmt: skip
    assert (turns.unit, slides.unit) == ("°", "m")
    assert [line.name for line in turns.lines] == list(robot.joint_names)  # the legend has all of them
    assert [len(line.x) for line in turns.lines] == [2, 2, 0, 2]
    (line,) = slides.lines
    assert line.y.tolist() == [0.0, 0.1]
    assert line.style["color"] == turns.lines[2].style["color"]
    assert np.ptp(np.array(slides.y, dtype=float)) == pytest.approx(4.0)
    assert [name for _, _, name in slides.dashed] == [None]
    (alone,) = joint_panels(units, "input", "% of the limit", time, values)
    assert [len(line.x) for line in alone.lines] == [2, 2, 2, 2]
    said = units.each_text([4.0, 4.0, 1.0, np.inf], units.speed, "±").split(", ")
    assert said[2:] == ["quill ±1 m/s", "wrist none"]
    assert units.each_text(2.0, "%") == "2 %"
