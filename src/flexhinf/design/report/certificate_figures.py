"""The figures of a certificate's page: where steps start, the largest steps, and steps with the worst disturbance."""

from __future__ import annotations

import numpy as np

from flexhinf.certify import Certificate
from flexhinf.certify.pictures import StartSurface
from flexhinf.design.certification import CertifiedDegree, Evidence
from flexhinf.design.report.drawing import DASHED, figure_block, reference_line, thin
from flexhinf.design.report.proof import RULES
from flexhinf.report import INK, MUTED, SERIES, Figure, label, legend, new_figure

__all__ = ["disturbance_unit", "largest_figure", "surface_figure", "worst_figures"]

#: A run is drawn until |x1| has stayed below this share of the step, and half as long again.
SETTLED, LONGER = 0.01, 1.5


def surface_figure(given: Certificate, surface: StartSurface) -> Figure:
    """The slice of the region where steps start."""
    scale = 180.0 / np.pi if given.states[0].unit == "rad" else 1.0
    unit = "°" if scale != 1.0 else given.states[0].unit
    a, e = scale * surface.amplitude, surface.integral
    figure, (axis,) = new_figure(1, height=4.4)
    axis.contourf(a, e, surface.value, levels=[-np.inf, given.level], colors=[SERIES[0]], alpha=0.18)
    axis.contourf(a, e, surface.residual, levels=[0.0, np.inf], colors=[SERIES[1]], alpha=0.30)
    axis.contour(a, e, surface.value, levels=[given.level], colors=[SERIES[0]], linewidths=1.8)
    if given.sampled_level is not None:
        axis.contour(
            a,
            e,
            surface.value,
            levels=[given.sampled_level],
            colors=[INK],
            linewidths=1.0,
            linestyles="dashed",
        )
    axis.plot([], [], color=SERIES[0], label="proved: V ≤ c")
    axis.plot([], [], color=INK, linewidth=1.0, dashes=DASHED, label="sampled level")
    violated = surface.residual > 0.0
    if violated.any():
        axis.fill_between([], [], [], color=SERIES[1], alpha=0.30, linewidth=0, label="r > 0")
    for path, start, colour in zip(surface.paths, given.starts, SERIES[2:]):
        axis.plot(
            scale * path[:, 0], path[:, 1], color=colour, label=f"starts: {RULES.get(start.rule, start.rule)}"
        )
        axis.plot(scale * path[-1, 0], path[-1, 1], "o", color=colour, markersize=5)
    axis.plot(0.0, 0.0, "+", color=INK, markersize=8)
    axis.set_xlabel(f"step to the goal ({unit})")
    label(axis, "integral of the error", next(x.unit for x in given.states if x.name.endswith("_integral")))
    legend(axis)
    return figure_block(
        "starts", figure,
        "Equilibria at a distance from the goal, with each value of the integrator. The set is a slice of the proved "
        "region; the proof covers the part that is connected to the goal (+). "
        + ("Where r > 0, nothing is proved." if violated.any() else "On what is drawn, r is nowhere positive."),
        "Starts of steps",
    )  # fmt: skip


def _until(time: np.ndarray, x: np.ndarray) -> float:
    """Until where a run is drawn, s."""
    moving = np.flatnonzero(np.abs(x) > SETTLED * np.abs(x[0]))
    return float(min(time[-1], LONGER * time[moving[-1]])) if moving.size else float(time[-1])


def largest_figure(one: CertifiedDegree, given: Certificate) -> Figure:
    """The largest proved steps, without disturbance."""
    scale = 180.0 / np.pi if given.states[0].unit == "rad" else 1.0
    figure, axes = new_figure(3, height=6.4)
    for step, colour in zip(one.steps, SERIES[2:]):
        few, x = thin(step.time), scale * step.state
        name = RULES.get(step.rule, step.rule)
        axes[0].plot(step.time[few], x[few, 0], color=colour, label=f"starts: {name}")
        inputs = one.choice.solution.operating_input + one.choice.solution.inputs(step.state[few])
        axes[1].plot(step.time[few], inputs[:, 0], color=colour)
        axes[2].plot(step.time[few], one.choice.solution.value(step.state[few]) / given.level, color=colour)
    axes[2].axhline(1.0, color=SERIES[0], dashes=DASHED, linewidth=1.2)
    axes[0].set_xlim(0.0, max(_until(step.time, step.state[:, 0]) for step in one.steps))
    reference_line(axes[0])
    label(axes[0], "position − goal", "°" if scale != 1.0 else given.states[0].unit)
    label(axes[1], "input", given.inputs[0].unit)
    label(axes[2], "V / c", "")
    legend(axes[0])
    return figure_block(
        "largest", figure,
        "The largest proved step for each start of the integrator, without disturbance. V falls all the way.",
        "Largest steps",
    )  # fmt: skip


def worst_figures(shown: Evidence) -> list[Figure]:
    """Smaller steps with the worst disturbance; none where no step is stated."""
    if not shown.worst:
        return []
    given, runs = shown.certificate, shown.worst
    scale = 180.0 / np.pi if given.states[0].unit == "rad" else 1.0
    figure, axes = new_figure(3, height=6.4)
    for run, colour in zip(runs, SERIES[2:]):
        few, name = thin(run.time), RULES.get(run.rule, run.rule)
        axes[0].plot(run.time[few], scale * run.state[few, 0], color=colour, label=f"starts: {name}")
        axes[1].plot(run.time[few], np.linalg.norm(run.disturbance[few], axis=1), color=colour)
        axes[2].plot(run.time[few], run.value[few] / given.level, color=colour)
        bound = (run.value[0] + run.spent[few]) / given.level
        axes[2].plot(run.time[few], bound, color=MUTED, linewidth=1.0, dashes=(2.0, 1.5))
    axes[2].axhline(1.0, color=SERIES[0], dashes=DASHED, linewidth=1.2)
    axes[0].set_xlim(0.0, max(_until(run.time, run.state[:, 0]) for run in runs))
    reference_line(axes[0])
    label(axes[0], "position − goal", "°" if scale != 1.0 else given.states[0].unit)
    label(axes[1], "|d|", disturbance_unit(given))
    label(axes[2], "V / c", "")
    legend(axes[0])
    return [
        figure_block(
            "worst", figure,
            "Steps of 0.8 of the largest ones with the disturbance that V says is worst, d = g1ᵀV_xᵀ/γ², until the "
            "budget is spent. Thin lines: V(x0) + ½γ²∫|d|², which V stays below.",
            "Worst disturbance",
        )
    ]  # fmt: skip


def disturbance_unit(given: Certificate) -> str:
    """The unit of all disturbances; empty where they differ."""
    units = {d.unit for d in given.disturbances}
    return units.pop() if len(units) == 1 else ""
