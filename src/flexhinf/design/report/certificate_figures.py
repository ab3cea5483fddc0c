"""The figures of a certificate's page: slices of the region, steps with and without disturbance, the gain."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from flexhinf.certify import Certificate
from flexhinf.certify.pictures import LimitSlice, Slice, StartSurface
from flexhinf.certify.theorem import common_unit
from flexhinf.design.certification import CertifiedDegree, Evidence
from flexhinf.design.report.drawing import DASHED, figure_block, reference_line, thin
from flexhinf.design.report.proof import RULES
from flexhinf.report import INK, MUTED, SERIES, Figure, at_least, at_most, label, legend, new_figure, number

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

#: A run is drawn until |x1| has stayed below this share of the step, and half as long again.
SETTLED, LONGER = 0.01, 1.5

#: What ends a sampled level, in short.
_LIMITS = {"inequality": "r = 0", "V stops increasing": "V grows no more"}


def surface_figure(given: Certificate, surface: StartSurface) -> Figure:
    """The slice of the region where steps start."""
    scale = 180.0 / np.pi if given.states[0].unit == "rad" else 1.0
    unit = "°" if scale != 1.0 else given.states[0].unit
    figure, axis = _slice(given, surface, scale)
    for path, start, colour in zip(surface.paths, given.starts, SERIES[2:]):
        name = f"starts: {RULES.get(start.rule, start.rule)}"
        axis.plot(scale * path[:, 0], path[:, 1], color=colour, label=name)
        axis.plot(scale * path[-1, 0], path[-1, 1], "o", color=colour, markersize=5)
    axis.set_xlabel(f"step to the goal ({unit})")
    label(axis, "integral of the error", next(x.unit for x in given.states if x.name.endswith("_integral")))
    legend(axis)
    return figure_block(
        "starts", figure,
        ["Equilibria at a distance from the goal, with each value of the integrator: a slice of the proved region, "
         "which is the part that is connected to the goal (+).", *_said_of(given, surface)],
        "Starts of steps",
    )  # fmt: skip


def limit_figure(given: Certificate, plane: LimitSlice) -> Figure:
    """The plane in which the sampled level ends."""
    figure, axis = _slice(given, plane, 1.0)
    axis.plot(0.0, 1.0, "D", color=INK, markersize=5, label=f"limits the level: {_LIMITS[plane.limit]}")
    if plane.moved is None:
        other = "the largest proved start"
        axis.plot(1.0, 0.0, "o", color=SERIES[2], markersize=5, label=other)
        axis.set_xlabel(f"share of {other}")
    else:
        state = given.states[plane.moved]
        other = f"the {state.name.replace('_', ' ')} with the other states where V₂ is smallest"
        axis.set_xlabel(f"{state.name.replace('_', ' ')} ({state.unit})")
    label(axis, "share of the limiting point", "")
    legend(axis)
    where = ", ".join(
        f"{s.name.replace('_', ' ')} {number(float(v), 3)} {s.unit}".rstrip()
        for s, v in zip(given.states, plane.point, strict=True)
    )
    return figure_block(
        "limit", figure,
        [f"The plane through the goal (+), {other}, and the point at which the sampled level ends: "
         f"deviation {where}. A larger level would have it inside.", *_said_of(given, plane)],
        "Where the level ends",
    )  # fmt: skip


def _slice(given: Certificate, one: Slice, scale: float) -> tuple[Canvas, Axes]:
    """r/V in bands, the proved level's line and the sampled one's, the goal, and the worst point inside."""
    figure, (axis,) = new_figure(1, height=5.0)
    across, edges = scale * one.across, _edges(one, given.level)
    rate = np.where(one.value < 0.0, np.inf, np.nan_to_num(one.rate, nan=edges[-1]))  # V = 0: the goal
    bands = list(zip([-np.inf, *edges], [*edges, 0.0]))
    for (low, high), depth in zip(bands, np.linspace(0.62, 0.12, len(bands))):
        axis.contourf(across, one.up, rate, levels=[low, high], colors=[SERIES[0]], alpha=depth)
        name = f"r/V < {number(high, 2)}/s" if high else "r < 0"
        axis.fill_between([], [], [], color=SERIES[0], alpha=depth, linewidth=0, label=name)
    if (rate > 0.0).any():
        axis.contourf(
            across, one.up, np.minimum(rate, 1e300), levels=[0.0, np.inf], colors=[SERIES[1]], alpha=0.4
        )
        axis.fill_between([], [], [], color=SERIES[1], alpha=0.4, linewidth=0, label="r ≥ 0")
    axis.contour(across, one.up, one.value, levels=[given.level], colors=[INK], linewidths=1.8)
    axis.plot([], [], color=INK, linewidth=1.8, label="proved: V ≤ c")
    if given.sampled_level is not None:
        style = {"colors": [SERIES[1]], "linewidths": 1.2, "linestyles": [(0, (3.0, 3.0))]}
        axis.contour(across, one.up, one.value, levels=[given.sampled_level], **style)
        axis.plot([], [], color=SERIES[1], linewidth=1.2, dashes=(3.0, 3.0), label="sampled level")
    a, b, _ = one.worst(given.level)
    axis.plot(scale * a, b, "x", color=INK, markersize=8, markeredgewidth=1.8, label="worst point here")
    axis.plot(0.0, 0.0, "+", color=INK, markersize=9)
    axis.grid(False)
    return figure, axis


def _edges(one: Slice, level: float) -> list[float]:
    """Three values of r/V between the bands of a slice, round numbers from the fastest to the slowest."""
    inside = one.rate[(one.value <= level) & (one.rate < 0.0)]
    fast = float(np.quantile(inside, 0.15)) if inside.size else -1.0
    return [float(f"{share * fast:.1g}") for share in (1.0, 0.5, 0.2)]


def _said_of(given: Certificate, one: Slice) -> list[str]:
    """What a slice shows of r."""
    worst, inside = one.worst(given.level)[2], "r is negative wherever V ≤ c"
    decays = " with the proved decay in r" if given.decay else ""
    text = f"Colours: r/V{decays}, the rate at which V falls beyond what the gain asks for; "
    text += f"{inside}, least so at the cross, {number(worst, 2)}/s." if worst < 0.0 else "see the cross."
    return [text, "" if (one.residual <= 0.0).all() else "Where r ≥ 0 nothing is proved."]


def gain_figure(proved: float, attained: float) -> Figure:
    """The gain on a line: proved from above, attained from below."""
    figure, (axis,) = new_figure(1, height=1.5)
    axis.barh(0.0, attained, height=0.5, color=SERIES[2], alpha=0.55, label=f"attained: {at_least(attained)}")
    axis.barh(
        0.0,
        proved - attained,
        left=attained,
        height=0.5,
        color=MUTED,
        alpha=0.35,
        label="the largest lies here",
    )
    axis.axvline(proved, color=SERIES[0], linewidth=2.4, label=f"proved: γ = {at_most(proved)}")
    axis.set_yticks([])
    axis.set_xlim(0.0, 1.08 * proved)
    axis.set_xlabel("√(∫|z|²/∫|d|²)")
    legend(axis)
    return figure_block(
        "gain",
        figure,
        "A disturbance was found that attains the lower end; none exceeds the upper one.",
        "Gain",
    )


def _until(time: np.ndarray, x: np.ndarray) -> float:
    """Until where a run is drawn, s."""
    moving = np.flatnonzero(np.abs(x) > SETTLED * np.abs(x[0]))
    return float(min(time[-1], LONGER * time[moving[-1]])) if moving.size else float(time[-1])


def largest_figure(one: CertifiedDegree, given: Certificate) -> Figure:
    """The largest proved steps, without disturbance."""
    scale = 180.0 / np.pi if given.states[0].unit == "rad" else 1.0
    value = one.choice.solution.value if one.box is None else one.box.value
    figure, axes = new_figure(3, height=6.4)
    for step, colour in zip(one.steps, SERIES[2:]):
        few, x = thin(step.time), scale * step.state
        name = RULES.get(step.rule, step.rule)
        axes[0].plot(step.time[few], x[few, 0], color=colour, label=f"starts: {name}")
        inputs = one.choice.solution.operating_input + one.choice.solution.inputs(step.state[few])
        axes[1].plot(step.time[few], inputs[:, 0], color=colour)
        axes[2].plot(step.time[few], value(step.state[few]) / given.level, color=colour)
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
    label(axes[1], "|d|", common_unit(given.disturbances))
    label(axes[2], "V / c", "")
    legend(axes[0])
    return [
        figure_block(
            "worst", figure,
            "Steps of 0.8 of the largest ones with the disturbance that V says is worst, d = g1ᵀV_xᵀ/γ², as long as "
            "the budget lasts. Thin lines: V(x0) + ½γ²∫|d|², which V stays below.",
            "Worst disturbance",
        )
    ]  # fmt: skip
