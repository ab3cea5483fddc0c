"""What a notebook asks of a design: margins, poles, Bode diagram, a step and a move, with python-control as oracle."""

from __future__ import annotations

import pydoc
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.designs import PoseEvidence


@pytest.fixture(scope="module")
def in_a_workspace() -> Any:
    from tests import workspaces

    with pytest.MonkeyPatch.context() as patch:
        workspaces.few(patch, POSES=2, GOALS=2, CHOSEN_POSES=2, MODAL_POSES=10, BANDWIDTHS=(28.0,))
        s = fh.Specification(measured=("link_position", "motor_position"), draws=0)
        yield fh.design(fh.load_robot("planar-two-link"), s)


@pytest.fixture(params=["at_a_pose", "in_a_workspace"])
def design(request: pytest.FixtureRequest) -> Any:
    made = request.getfixturevalue(request.param)
    return made.design if request.param == "at_a_pose" else made


def opened(design: Any, i: int = 0) -> Any:
    """L_i of python-control, with negative feedback."""
    control = pytest.importorskip("control")
    system = design.linear().opened(i=i)
    return control.ss(system.a, system.b, -system.c, -system.d, system.period)


@pytest.mark.ci("a whole design")
@pytest.mark.oracle
def test_margins_and_poles_are_those_of_python_control(design: Any) -> None:
    control = pytest.importorskip("control")
    margins, linear = design.margins(), design.linear()
    whole = linear.closed_loop
    closed = control.ss(whole.a, whole.b, whole.c, whole.d, whole.period)
    with np.errstate(divide="ignore", invalid="ignore"):
        theirs = np.log(control.poles(closed).astype(complex)) / whole.period
    for pole in design.poles():
        assert np.abs(theirs - pole).min() < 1e-3 * max(1.0, abs(pole))
    grid = np.geomspace(0.1, np.pi / whole.period, 20_000)
    for i in range(len(linear.inputs)):
        # by the response on a grid: as polynomials these loops are beyond double precision
        response = control.frd(opened(design, i), grid)
        factors, _, distances, *_ = control.stability_margins(response, returnall=True)
        above = min((factor for factor in factors if factor > 1.0), default=np.inf)
        assert margins.gain_margins[i, 1] == pytest.approx(above, rel=1e-3)
        if len(linear.inputs) == 1:
            assert margins.peak_sensitivity == pytest.approx(1.0 / min(distances), rel=1e-3)


@pytest.mark.costs("a whole design, which other tests share, and python-control")
@pytest.mark.quick_cases(1)
@pytest.mark.oracle
def test_frequency_response_and_bode_are_those_of_python_control(design: Any) -> None:
    control = pytest.importorskip("control")
    frequencies = np.geomspace(0.3, 300.0, 25)
    response = design.frequency_response(frequencies)
    for i in range(len(design.linear().inputs)):
        theirs = np.squeeze(control.frequency_response(opened(design, i), frequencies).complex)
        np.testing.assert_allclose(response.input_loops[:, i], theirs, rtol=1e-5)
    figure = design.bode(frequencies)
    above, below = figure.axes
    np.testing.assert_allclose(above.lines[0].get_xdata(), frequencies / (2.0 * np.pi))
    np.testing.assert_allclose(
        above.lines[0].get_ydata(), 20.0 * np.log10(np.abs(response.input_loops[:, 0])), rtol=1e-9
    )
    turns = (below.lines[0].get_ydata() - np.degrees(np.angle(response.input_loops[:, 0]))) / 360.0
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-9)
    assert (below.get_xscale(), below.get_xlim()) == (above.get_xscale(), above.get_xlim())
    assert "<svg" in figure._repr_html_()
    assert above.get_ylabel().endswith("(dB)")
    assert below.get_xlabel().endswith("(Hz)")


@pytest.mark.ci("whole designs, and their campaigns")
def test_any_design_has_campaigns_and_more(design: Any) -> None:
    assert isinstance(design, fh.Design)
    few = design.campaign(3, seed=2)
    assert few.sizes["sample"] == 3
    assert set(few.status.values.tolist()) == {"completed"}
    again = design.campaign(2, seed=2, batch=1)
    for name in few.data_vars:
        if few[name].dims == ("sample",):
            np.testing.assert_array_equal(few[name].values[:2], again[name].values)
    if isinstance(design.evidence, PoseEvidence):
        short = design.campaign(1, duration=0.5)
        assert short.time[-1] == pytest.approx(0.5, abs=0.02)
    with refused_with(fh.InvalidInput, "samples_each", "'samples'"):
        design.campaign(2, samples_each=3)


def test_the_help_of_a_design_fits_on_two_screens() -> None:
    """Of 66 lines each."""
    assert len(pydoc.plain(pydoc.render_doc(fh.Design)).splitlines()) <= 132


def test_a_design_of_one_pose_has_one_loop(at_a_pose: Any) -> None:
    design = at_a_pose.design
    evidence = design.evidence
    assert design.margins().delay_margin_s == evidence.evaluation.margins.delay_margin_s
    assert design.margins(evidence.goal).damping == pytest.approx(design.margins().damping)
    for ask in (design.linear, design.move, partial(design.move, None)):
        with refused_with(fh.InvalidInput, 0.25, "workspace"):
            ask(0.25)
    assert design.step() is evidence.evaluation.step.run
    assert design.move().tracked("link_position")[-1] == pytest.approx(np.radians(30.0), abs=2e-3)


@pytest.mark.ci("a whole design for a workspace")
def test_a_design_of_a_workspace_has_a_loop_at_each_pose(in_a_workspace: Any) -> None:
    design, goal = in_a_workspace, (0.3, -0.5)
    poses = design.evidence.poses
    for loop, pose in zip(design.evidence.loops, poses):
        multipliers = np.exp(design.poles(pose) * design.specification.period)
        assert np.abs(multipliers).max() == pytest.approx(loop.growth, rel=1e-6)
    assert not np.allclose(design.poles(poses[0])[:3], design.poles(poses[1])[:3])
    by_name = dict(zip(design.robot.joint_names, goal))
    assert design.margins(by_name).peak_sensitivity == design.margins(goal).peak_sensitivity
    moved, stepped = design.move(goal), design.step(goal, start=(0.2, -0.4), duration=3.0)
    for run in (moved, stepped):
        end = run.signals["state"][-200:, :2].mean(axis=0)
        np.testing.assert_allclose(end, goal, atol=2e-3)
    np.testing.assert_allclose(stepped.signals["state"][0, :2], (0.2, -0.4), atol=1e-12)
    np.testing.assert_allclose(moved.signals["state"][0, :2], design.robot.home, atol=1e-3)


# Modes ------------------------------------------------------------------------------------------------
@pytest.mark.oracle
@pytest.mark.parametrize("name", ["paper", "planar-two-link", "scara"])
def test_modes_are_the_poles_of_python_control(robot_of: Callable[[str], Any], name: str) -> None:
    control = pytest.importorskip("control")
    robot = robot_of(name)
    pose = np.array(robot.home) + 0.2 * np.array([not slide for slide in robot.links.slides])
    a, b, _, c = robot.plant().linearise(*robot.operating_point(pose))
    system = control.ss(a, b, c, np.zeros((len(c), b.shape[1])))
    frequencies, damping, poles = control.damp(system, doprint=False)
    for mode in robot.modes(pose):
        near = int(np.argmin(np.abs(poles - mode.eigenvalue)))
        assert mode.frequency == pytest.approx(frequencies[near] / (2.0 * np.pi), rel=1e-6, abs=1e-6)
        if mode.vibration:
            assert mode.damping == pytest.approx(damping[near], rel=1e-4, abs=1e-8)
            assert mode.name in repr(mode)
            assert mode.joint in repr(mode)


def test_modes_depend_on_the_parameters(robot_of: Callable[[str], Any]) -> None:
    robot = robot_of("paper")
    soft, own = robot.modes(0.5, {"stiffness": 0.25 * robot.nominal["stiffness"]}), robot.modes(0.5)
    assert soft[-1].frequency < own[-1].frequency
    with pytest.raises(fh.InvalidInput):
        robot.modes((0.1, 0.2))
