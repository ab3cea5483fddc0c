"""The step drawn, and its estimation error."""

from __future__ import annotations

from typing import Any

import numpy as np

from flexhinf.design.page.drawing import framed, joint_lines, limit_lines, thin, zero_line
from flexhinf.design.page.units import units_of
from flexhinf.design.page.words import fed_words
from flexhinf.design.result import Design
from flexhinf.report import Figure, figure_to_svg, label, legend, new_figure

__all__ = ["effort_limit", "estimation_figure", "response_figure", "spring_torques"]


def spring_torques(design: Design, run: Any) -> np.ndarray:
    """Torque of the nominal springs along a run (N, n)."""
    n = len(design.goal)
    p = design.problem.plant.parameters
    stiffness = np.atleast_1d(p.named(p.vector()).stiffness)
    state = run.signals["state"]
    return stiffness * (state[:, 2 * n : 3 * n] - state[:, :n])


def effort_limit(design: Design) -> tuple[float | None, str]:
    """The tighter of the asked peak and the saturation, and its name."""
    s, unit = design.specification, units_of(design).effort
    limits = [(s.peak_effort, "asked: at most"), (s.saturation, "saturation at")]
    known = [(limit, name) for limit, name in limits if limit is not None]
    if not known:
        return None, ""
    limit, name = min(known)
    return limit, f"{name} ±{limit:g} {unit}"


def response_figure(design: Design) -> Figure:
    """Distance from the goal, spring torques and inputs of every joint."""
    response, joints, units = design.response, design.robot.joint_names, units_of(design)
    figure, axes = new_figure(3, height=7.2)
    panels = (
        response.positions - design.goal,
        spring_torques(design, response.run),
        response.run.signals["input"],
    )
    for axis, panel in zip(axes, panels):
        joint_lines(axis, response.run.time, panel, joints)
    few = thin(response.run.time)
    for axis, panel in zip(axes[:2], panels):
        axis.set_ylim(*framed(panel[few]))
    zero_line(axes[0])
    limit, name = effort_limit(design)
    drawn = limit_lines(axes[2], limit, panels[2], name)
    label(axes[0], "link position − goal", units.position)
    label(axes[1], "spring torque", units.spring)
    label(axes[2], "input", units.effort)
    if len(joints) > 1:
        legend(axes[0])
    bound = "" if limit is None else (f" (dashed: {name})" if drawn else f" ({name}, beyond the panel)")
    return Figure(
        "figure-step",
        figure_to_svg(figure),
        f"The step from the start pose to the goal in the nonlinear closed loop, {fed_words(design)}: link positions "
        f"as distance from the goal (dotted), torques of the springs, inputs as applied{bound}.",
        "Step response",
    )


def estimation_figure(design: Design) -> Figure | None:
    """True minus estimated positions and velocities of links and motors; None without an estimator."""
    run, joints, units = design.response.run, design.robot.joint_names, units_of(design)
    if design.specification.estimator == "none":
        return None
    n = len(joints)
    error = run.signals["state"][:, : 4 * n] - run.signals["estimate"]
    figure, axes = new_figure(4, height=8.0)
    titles = ("link position", "link velocity", "motor position", "motor velocity")
    for k, axis in enumerate(axes):
        joint_lines(axis, run.time, error[:, k * n : (k + 1) * n], joints, linewidth=0.9)
        label(axis, titles[k], units.speed if k % 2 else units.position)
    if n > 1:
        legend(axes[0])
    return Figure(
        "figure-estimate",
        figure_to_svg(figure),
        "True minus estimated state of every joint.",
        "Estimation error",
    )
