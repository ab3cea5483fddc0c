"""Figures of a comparison: the laws by the criterion, their errors in the same runs, and input against deviation."""

# Not checked strictly: parts of Matplotlib have no types.
# pyright: reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from flexhinf.design.laws import DESIGN, NL_HINF, is_hinf
from flexhinf.design.pipeline import Comparison
from flexhinf.design.tuning import RATIOS, TunedLaw, pareto_front
from flexhinf.pages.arm_film import two_arms
from flexhinf.pages.drawing import (
    DASHED,
    Line,
    Panel,
    Units,
    figure_block,
    framed,
    legend_above,
    line_style,
    plain_mark,
    thin,
    units_of,
)
from flexhinf.report import INK, MUTED, SERIES, Figure, LineStyle, house_style, label, legend, panels

if TYPE_CHECKING:
    from matplotlib.axis import Axis

#: Largest ratio that the figure of the criterion shows: a law that diverges has none.
FARTHEST = 20.0


@house_style()
def ranking_figure(comparison: Comparison, laws: Sequence[tuple[TunedLaw, bool]]) -> Figure:
    """Laws beside each other: a bar for the criterion of each, marks for the ratios that it is the mean of.

    `laws`: in the order of the bars, from above, each with whether it keeps every limit.
    """
    figure, ((axes,),) = panels(1, 1, 1.4 + 0.36 * len(laws))
    places = np.arange(len(laws))[::-1]
    ratios = [comparison.criterion.ratios(law.metrics) for law, _ in laws]

    def clipped(values: Sequence[float]) -> np.ndarray:
        return np.nan_to_num(np.asarray(values, dtype=float), nan=FARTHEST, posinf=FARTHEST).clip(
            1.0 / FARTHEST, FARTHEST
        )

    costs = clipped([law.cost for law, _ in laws])
    for place, cost, (law, is_ranked) in zip(places, costs, laws):
        color = SERIES[0] if is_hinf(law.name) or law.name == DESIGN else MUTED
        axes.barh(place, cost, 0.62, color=color, alpha=0.55 if is_ranked else 0.2, zorder=1)
    for k, (key, name) in enumerate(RATIOS.items()):
        style: LineStyle = {"color": line_style(k + 1)["color"], "markersize": 5.5, "zorder": 3.0}
        axes.plot(clipped([each[key] for each in ratios]), places, "os^D"[k], label=name, **style)
    axes.axvline(1.0, color=INK, linewidth=1.0, dashes=DASHED, zorder=2)
    every = clipped([*costs, *(each[key] for each in ratios for key in RATIOS)])
    axes.set(xscale="log", xlim=(min(0.45, 0.7 * every.min()), max(2.2, 1.3 * every.max())))
    axes.set_yticks(places, [f"{law.name}{'' if is_ranked else ' (not ranked)'}" for law, is_ranked in laws])
    _plain_log(axes.xaxis)
    axes.grid(axis="y", visible=False)
    axes.set_xlabel("relative to the design; less is better")
    legend(axes)
    return figure_block(
        "ranking",
        figure,
        "Bars: the criterion, the geometric mean of the four ratios that the marks show. Blue: nonlinear H∞. Dashed: "
        "the design as it is. A law that is not ranked misses a limit, or has an unstable corner of the tolerances. "
        f"What is further than {FARTHEST:g} times off stands at {FARTHEST:g} times.",
        "Laws side by side",
    )


def _plain_log(ruler: Axis, few: bool = False) -> None:
    """Marks of a logarithmic axis as plain numbers; `few`: powers of ten alone."""
    from matplotlib.ticker import FuncFormatter

    def minor(value: float, place: object) -> str:
        return plain_mark(value) if f"{value:.0e}"[0] in "25" * (not few) else ""

    ruler.set_minor_formatter(FuncFormatter(minor))
    ruler.set_major_formatter(FuncFormatter(plain_mark))


#: Times (N,) and errors (N, n) of every law, by name.
Errors = dict[str, tuple[np.ndarray, np.ndarray]]


def _joint_and_limits(errors: Errors, span: tuple[float, float]) -> tuple[int, tuple[float, float]]:
    """Joint where the median law has the largest error, root mean square, and there the limits of the vertical axis:
    all of what most laws do in a span of time."""
    squares = (np.where(np.isfinite(error), error, np.nan) ** 2 for _, error in errors.values())
    joint = int(np.argmax(np.median([np.sqrt(np.nanmean(each, axis=0)) for each in squares], axis=0)))
    ends: list[tuple[float, float]] = []
    for time, values in errors.values():
        error = values[:, joint]
        visible = error[(time >= span[0]) & (time <= span[1]) & np.isfinite(error)]
        ends.append((float(visible.min(initial=0.0)), float(visible.max(initial=0.0))))
    low, high = np.array(ends).T
    most = 2.5 * float(np.median(high - low))  # lines of the other laws may leave the panel
    return joint, framed(np.clip([low.min(), high.max()], -most, most))


@house_style()
def responses_figure(comparison: Comparison) -> Figure:
    """Errors of one joint in step, load and move: one row for each kind of laws, nonlinear H∞ in all."""
    own, joints, thick = comparison.own.evaluation, comparison.robot.joint_names, comparison.tuned_design
    assert own is not None
    duration, angles = comparison.scenario.step_duration, units_of(own)
    small, scale = angles.small
    settled = [row.metrics.get("step_settling_s") for row in comparison.compared]
    last = max((value for value in settled if value is not None and np.isfinite(value)), default=duration)
    end = min(duration, max(1.3 * last, 0.1 * duration))  # some time after the last law has settled
    steps, loaded, moves = Errors(), Errors(), Errors()
    for name, e in ((row.name, row.evaluation) for row in comparison.compared if row.evaluation is not None):
        at, load = e.load_response.at, e.load_response.response
        steps[name] = e.step.run.time, angles.scale * (e.step.positions - e.step.goal)
        loaded[name] = load.run.time - at, scale * (load.positions - load.goal)
        moves[name] = e.move.response.run.time, scale * e.move.error
    others = [row for row in comparison.compared if row is not thick]
    groups = list(dict.fromkeys(row.kind.group for row in others)) or [comparison.own.kind.group]
    styles = {row.name: line_style(k) for k, row in enumerate(comparison.rows)}
    figure, grid = panels(len(groups), 3, 0.6 + 2.25 * len(groups), 9.6, sharex="col", sharey="col")
    columns = (
        ("step", "position − goal", angles.angle, steps, (0.0, end), "time (s)"),
        ("load", "position − goal", small, loaded, (-0.05 * end, end), "time after the load (s)"),
        ("move", "position − plan", small, moves, (0.0, float(own.move.response.run.time[-1])), "time (s)"),
    )
    where: list[str] = []
    for k, (run, quantity, unit, errors, span, across) in enumerate(columns):
        joint, limits = _joint_and_limits(errors, span)
        where.append(f"{run}: {joints[joint]}")
        for axes, group in zip(grid, groups):
            lines: list[Line] = []
            for name in (thick.name, *(row.name for row in others if row.kind.group == group)):
                time, error = errors[name]
                width, order = (2.2, 2.5) if name == thick.name else (1.2, 3.0)
                style: LineStyle = {**styles[name], "linewidth": width, "zorder": order}
                few = thin(time, 600)
                lines.append(Line(time[few], error[few, joint], name, style))
            Panel(quantity, unit, lines, (0.0,)).draw(axes[k])
            if not k:
                axes[0].set_title(group)
        grid[0][k].set(xlim=span, ylim=limits)
        grid[-1][k].set_xlabel(across)
    for axes in grid:
        axes[2].legend(loc="center left", bbox_to_anchor=(1.0, 0.5), handlelength=1.6)
    which = f" Joints, where the errors are largest: {', '.join(where)}."
    return figure_block(
        "laws",
        figure,
        "True link positions in the nonlinear loop with estimator and measurement noise. Left: the step. Middle: the "
        f"torque on the links at the goal. Right: the planned move. {thick.name} is in every row (thick). A law that "
        "misses a limit is shown too, by the tuning that exceeds the limits least."
        f"{which if len(joints) > 1 else ''}",
        "Laws in the same runs",
    )


def arms_of(comparison: Comparison, laws: Sequence[tuple[TunedLaw, bool]]) -> list[Figure]:
    """The arm during the step, under the design and under its best rival; none where one of them has no such run."""
    own = comparison.own.evaluation
    others = [law for law, _ in laws if not is_hinf(law.name)]
    if own is None or not others:
        return []
    rival = others[0]
    assert rival.evaluation is not None
    runs = [own.step, rival.evaluation.step]
    if any(run.diverged_at is not None for run in runs):
        return []
    count = min(len(run.positions) for run in runs)
    figure = two_arms(
        "arms",
        comparison.robot,
        own.step.run.time[:count],
        [(DESIGN, own.step.positions[:count]), (rival.name, rival.evaluation.step.positions[:count])],
        f"The links during the step under the design and under {rival.name}, the best rival by the criterion.",
        "The arm under both laws",
    )
    return [] if figure is None else [figure]


def small_of(units: Units) -> tuple[str, float]:
    """Unit and factor of a small deviation of a joint that is not known: where joints turn and slide, thousandths."""
    unit, factor = units.small
    return ("mrad or mm", 1e3) if " or " in unit else (unit, units.factor_of(factor, units.joints[0]))


@house_style()
def trade_off_figure(comparison: Comparison, laws: Sequence[TunedLaw]) -> Figure | None:
    """Peak input against load deviation: a point for each law, and the curve of what its tuning reaches.

    None where fewer than two laws have finite figures.
    """
    finite = [law for law in laws if np.isfinite([law.metrics.peak_input, law.metrics.load_deviation]).all()]
    if len(finite) < 2:
        return None
    evaluation = comparison.own.evaluation
    assert evaluation is not None
    small, scale = small_of(units_of(evaluation))
    points = np.array([(law.metrics.peak_input, scale * law.metrics.load_deviation) for law in finite])
    figure, ((axis,),) = panels(1, 1, 5.0)
    place, units = {row.name: k for k, row in enumerate(comparison.rows)}, comparison.units()
    for law, point in zip(finite, points):
        k, own = place[law.name], law.name == NL_HINF
        style, marker = line_style(k), "*" if own else "os^Dv<>"[k % 7]
        front = pareto_front((*law.tried, law.metrics), comparison.criterion)
        curve = np.array([[m.peak_input, scale * m.load_deviation] for m in front]).reshape(-1, 2)
        thin_line: LineStyle = {**style, "linewidth": 1.0, "alpha": 0.7}
        axis.plot(*curve.T, **thin_line)
        axis.plot(
            *point[:, None],
            marker,
            label=law.name,
            color=style["color"],
            markersize=13.0 if own else 6.5,
            linestyle="none",
            zorder=4.0,
        )
    axis.set(xscale="log", yscale="log", xlabel=f"peak input of the step ({units['input']})")
    legend_above(figure, axis, 4)
    for ruler, limit, values in zip((axis.xaxis, axis.yaxis), (axis.set_xlim, axis.set_ylim), points.T):
        low, high = 0.7 * values.min(), 1.4 * values.max()
        limit(low, high)
        _plain_log(ruler, few=high > 100.0 * low)
    label(axis, "largest deviation under the load", small)
    return figure_block(
        "trade-off",
        figure,
        "Peak input against load deviation; down and to the left is better. A marker is the law as it was tuned; a "
        "line joins the best candidates of its tuning that keep the limits of the linear loop.",
        "Trade-off",
    )
