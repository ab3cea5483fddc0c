"""Laws beside each other: the table of their metrics, their errors in the same runs, and input against deviation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from flexhinf.design.laws import NL_HINF
from flexhinf.design.result import ComparedLaw, Comparison
from flexhinf.design.tuning import TunedLaw, pareto_front
from flexhinf.pages.design.requirements import limit_text
from flexhinf.pages.drawing import (
    Line,
    Panel,
    figure_block,
    framed,
    legend_above,
    line_style,
    panels,
    pose_text,
    thin,
    units_of,
)
from flexhinf.report import Cell, Column, Figure, Table, house_style, label, number
from flexhinf.report.blocks import WIDTH

#: Two values are equally good within this relative difference, or the smallest difference that counts.
SHARED = 0.005

#: Points of a line in small panels.
POINTS = 600

#: A panel shows so many times the median law's range; lines may leave it.
AXIS_RANGES = 2.5

#: A panel ends this much after the last law has settled.
AFTER = 1.3

#: A trade-off figure shows so many times the smallest finite value of each axis.
RANGE = 30.0


class LawMetric(NamedTuple):
    """A metric of a law, by its key of `LawEvaluation.metrics`.

    `unit` "input" is V or N·m; shown in thousandths are "small input", "length" (of rad or m) and "ms" (of s).
    `better`: −1 where less is better, 1 where more is, 0 for neither. `least`: the smallest difference that counts, in
    the unit of the value. `brief`: whether a terminal shows it too.
    """

    key: str
    group: str
    label: str
    unit: str
    better: int = -1
    least: float = 0.0
    brief: bool = True


STEP, LOAD, MOVE, SAMPLES, LINEAR, COST = "step", "load", "move", "samples", "linear", "cost"

#: In the order of the table.
METRICS = (
    LawMetric("step_peak_input", STEP, "peak input", "input"),
    LawMetric("step_overshoot_percent", STEP, "overshoot", "%", least=0.5),
    LawMetric("step_settling_s", STEP, "settling time", "s", least=0.01),
    LawMetric("step_remaining", STEP, "remaining error", "length", least=1e-4),
    LawMetric("load_deviation", LOAD, "largest deviation", "length"),
    LawMetric("load_recovery_s", LOAD, "recovered after", "s", least=0.01),
    LawMetric("load_remaining", LOAD, "remaining deviation", "length", least=1e-4),
    LawMetric("move_error", MOVE, "largest error", "length", least=1e-4),
    LawMetric("move_remaining", MOVE, "remaining error", "length", least=1e-4, brief=False),
    LawMetric("move_peak_input", MOVE, "peak input", "input"),
    LawMetric("drawn_unsettled", SAMPLES, "steps not settled", "", least=0.5),
    LawMetric("drawn_overshoot_percent", SAMPLES, "median overshoot", "%", least=0.5, brief=False),
    LawMetric("drawn_worst_overshoot_percent", SAMPLES, "worst overshoot", "%", least=0.5),
    LawMetric("drawn_settling_s", SAMPLES, "median settling time", "s", least=0.01, brief=False),
    LawMetric("drawn_worst_settling_s", SAMPLES, "worst settling time", "s", least=0.01),
    LawMetric("drawn_worst_peak_input", SAMPLES, "worst peak input", "input", brief=False),
    LawMetric("drawn_move_error", SAMPLES, "median move error", "length", least=1e-4, brief=False),
    LawMetric("drawn_worst_move_error", SAMPLES, "worst move error", "length", least=1e-4),
    LawMetric("unstable_corners", LINEAR, "unstable corners", "", least=0.5),
    LawMetric("peak_sensitivity", LINEAR, "peak sensitivity", "", least=0.01),
    LawMetric("gain_margin", LINEAR, "gain margin, ×", "", 1, 0.01),
    LawMetric("delay_margin_s", LINEAR, "delay margin", "ms", 1),
    LawMetric("damping", LINEAR, "smallest damping ratio", "", 1, 0.0005),
    LawMetric("input_noise", LINEAR, "input noise, rms", "small input"),
    LawMetric("bandwidth_rad_s", LINEAR, "bandwidth", "rad/s", 0, brief=False),
    LawMetric("operations", COST, "operations per sample", ""),
)

#: Groups of metrics, with their titles where there is little room.
GROUPS = {
    STEP: "step as deployed", LOAD: "torque on the links", MOVE: "planned move", SAMPLES: "sampled robots",
    LINEAR: "running loop, linearised", COST: "cost",
}  # fmt: skip


def _titles(comparison: Comparison) -> dict[str, str]:
    s, synthesis, runs = comparison.specification, comparison.synthesis, comparison.scenario
    loads = ", ".join(number(float(value), 3) for value in runs.load)
    slides = comparison.robot.links.slides
    start, goal = (pose_text(pose, slides, s.in_degrees) for pose in (synthesis.start, synthesis.goal))
    moved = "the same way" if s.move is None else "the stated waypoints"
    return {
        STEP: f"Step {start} → {goal} as the controller is deployed, the run of flexhinf design",
        LOAD: f"Torque of {loads} {comparison.units()['torque']} on the links, at the goal",
        MOVE: f"Planned move of {number(float(runs.plan.duration), 3)} s over {moved}, with feedforward",
        SAMPLES: f"{len(runs.robots)} robots sampled within their tolerances: step and move",
        LINEAR: "Running loop, linearised at the goal, with its estimator and delay",
        COST: "Cost",
    }


def unit_of(metric: LawMetric, comparison: Comparison) -> str:
    """Unit of a metric as it is printed."""
    units, own = comparison.units(), comparison.own.evaluation
    if metric.key == "drawn_unsettled":
        return f"of {len(comparison.scenario.robots)}"
    if metric.key == "unstable_corners" and own is not None and own.corners is not None:
        return f"of {own.corners.count}"
    known = {"input": units["input"], "small input": f"m{units['input']}", "length": units["error"]}
    return known.get(metric.unit, metric.unit)


def cell(metric: LawMetric, value: float | None, comparison: Comparison) -> str:
    """Value of a metric as text, without its unit."""
    if value is None:
        return "–"
    if np.isinf(value):
        if "settling" in metric.key:
            return f"> {comparison.scenario.step_duration:g}"
        return "never" if metric.key == "load_recovery_s" else "∞" if metric.better > 0 else "diverges"
    if metric.unit in ("length", "ms", "small input"):
        value *= 1e3
    if metric.unit == "%":
        return number(value, decimals=1)
    if abs(value) >= 1e3 or (not metric.unit and value == round(value)):
        return number(round(value))
    if 0.0 < abs(value) < 1e-2:
        return number(value, 2)
    size = 0 if value == 0.0 else int(np.floor(np.log10(abs(value))))
    return number(value, decimals=min(max(2 - size, 0), 3))


def best_of(metric: LawMetric, values: Sequence[float | None]) -> tuple[bool, ...]:
    """Which values are the best or as good; none where all are alike."""
    known, best = [value for value in values if value is not None], [False for _ in values]
    if metric.better and len(known) > 1:
        top = min(known) if metric.better < 0 else max(known)
        width = max(SHARED * abs(top), metric.least) if np.isfinite(top) else 0.0
        best = [value is not None and (value == top or abs(value - top) <= width) for value in values]
    return tuple(tied and sum(best) < len(known) for tied in best)


def metric_table(
    comparison: Comparison, laws: Sequence[ComparedLaw], short: bool = False, title: str = ""
) -> Table:
    """Metrics of some laws, each with an evaluation: one column for each law; the best of a row is that of all laws.
    `short` and `title` are for a terminal."""
    own = comparison.own.evaluation
    assert own is not None
    costs = [law.tuned.cost if law.tuned else np.nan for law in laws]
    rows: list[Any] = [
        "criterion" if short else "Criterion and limits",
        ("criterion, design = 1", *(number(c, 3) if np.isfinite(c) else "diverges" for c in costs)),
    ]
    judged = [{(line.what, line.where): line for line in law.requirements} for law in laws]
    for key, first in {key: line for law in judged for key, line in law.items()}.items():
        sampled = ", sampled" if "robots sampled" in first.where else ""
        name = f"{first.what} {limit_text(first.converted(units_of(own).degrees))}{sampled}"
        rows.append((name, *(law[key].judgement if key in law else "–" for law in judged)))
    for group, heading in (GROUPS if short else _titles(comparison)).items():
        entries = []
        for metric in (metric for metric in METRICS if metric.group == group and (metric.brief or not short)):
            values = {law.name: law.metrics.get(metric.key) for law in comparison.compared}
            if set(values.values()) == {None}:
                continue
            marks = zip(values, best_of(metric, list(values.values())))
            best = {name: "best" if there else "" for name, there in marks}
            cells = (Cell(cell(metric, values[law.name], comparison), best[law.name]) for law in laws)
            entries.append((", ".join(filter(None, (metric.label, unit_of(metric, comparison)))), *cells))
        rows += [heading, *entries] if entries else []
    hyphen = "\u2011"  # at which no line breaks
    return Table(
        ("", *(Column(law.name.replace("-", hyphen), brief=law.name, right=True) for law in laws)), rows,
        "The same commands, load, move, robots and seeds for all. “best”: of its row, or as good", "figures-of-merit",
        title=title,
    )  # fmt: skip


def comparison_tables(comparison: Comparison, width: int = WIDTH) -> list[Any]:
    """Tables for a terminal of `width` columns, as many laws as fit, the design's own in each; * marks the best."""
    from rich.console import Console

    first, parts = comparison.tuned_design, []
    legend = "* best of its row, or as good as the best"
    title = f"{comparison.robot.name}: laws in the same runs; {legend}"
    order = sorted(comparison.compared, key=lambda law: law.tuned.cost if law.tuned else np.inf)
    part, table = [first], metric_table(comparison, [first], True, title).terminal(wide=True)
    for law in (law for law in order if law is not first):
        wider = metric_table(comparison, [*part, law], True, title).terminal(wide=True)
        if len(part) > 1 and Console(width=10 * width).measure(wider).maximum > width:
            parts.append(table)
            part, title = [first], legend
            wider = metric_table(comparison, [first, law], True, title).terminal(wide=True)
        part, table = [*part, law], wider
    return [*parts, table]


#: Times (N,) and errors (N, n) of every law, by name.
Errors = dict[str, tuple[np.ndarray, np.ndarray]]


def _joint_and_limits(errors: Errors, span: tuple[float, float]) -> tuple[int, tuple[float, float]]:
    """Joint where the median law has the largest error, root mean square, and there the limits of the vertical axis:
    all of what most laws do in a span of time."""
    squares = (np.where(np.isfinite(error), error, np.nan) ** 2 for _, error in errors.values())
    joint = int(np.argmax(np.median([np.sqrt(np.nanmean(each, axis=0)) for each in squares], axis=0)))
    ends = []
    for time, values in errors.values():
        error = values[:, joint]
        visible = error[(time >= span[0]) & (time <= span[1]) & np.isfinite(error)]
        ends.append((float(visible.min(initial=0.0)), float(visible.max(initial=0.0))))
    low, high = np.array(ends).T
    size = float(np.median(high - low))
    return joint, framed(np.clip([low.min(), high.max()], -AXIS_RANGES * size, AXIS_RANGES * size))


@house_style()
def responses_figure(comparison: Comparison) -> Figure:
    """Errors of one joint in step, load and move: one row for each kind of laws, nonlinear H∞ in all."""
    own, joints, thick = comparison.own.evaluation, comparison.robot.joint_names, comparison.tuned_design
    assert own is not None
    duration, angles, small = comparison.scenario.step_duration, units_of(own), comparison.units()["error"]
    settled = [row.metrics.get("step_settling_s") for row in comparison.compared]
    last = max((value for value in settled if value is not None and np.isfinite(value)), default=duration)
    end = min(duration, max(AFTER * last, 0.1 * duration))
    steps, loaded, moves = Errors(), Errors(), Errors()
    for name, e in ((row.name, row.evaluation) for row in comparison.compared if row.evaluation is not None):
        at, load = e.load_response.at, e.load_response.response
        steps[name] = e.step.run.time, angles.scale * (e.step.positions - e.step.goal)
        loaded[name] = load.run.time - at, 1e3 * (load.positions - load.goal)
        moves[name] = e.move.response.run.time, 1e3 * e.move.error
    others = [row for row in comparison.compared if row is not thick]
    groups = list(dict.fromkeys(row.kind.group for row in others)) or [comparison.own.kind.group]
    styles = {row.name: line_style(k) for k, row in enumerate(comparison.rows)}
    figure, grid = panels(len(groups), 3, 0.6 + 2.25 * len(groups), 9.6, sharex="col", sharey="col")
    columns = (
        ("step", "position − goal", angles.angle, steps, (0.0, end), "time (s)"),
        ("load", "position − goal", small, loaded, (-0.05 * end, end), "time after the load (s)"),
        ("move", "position − plan", small, moves, (0.0, float(own.move.response.run.time[-1])), "time (s)"),
    )
    where = []
    for k, (run, quantity, unit, errors, span, across) in enumerate(columns):
        joint, limits = _joint_and_limits(errors, span)
        where.append(f"{run}: {joints[joint]}")
        for axes, group in zip(grid, groups):
            lines = []
            for name in (thick.name, *(row.name for row in others if row.kind.group == group)):
                time, error = errors[name]
                width, order = (2.2, 2.5) if name == thick.name else (1.2, 3.0)
                style, few = {**styles[name], "linewidth": width, "zorder": order}, thin(time, POINTS)
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
        "laws", figure,
        "True link positions in the nonlinear loop with estimator and measurement noise. Left: the step. Middle: the "
        f"torque on the links at the goal. Right: the planned move. {thick.name} is in every row (thick)."
        f"{which if len(joints) > 1 else ''}",
        "Laws in the same runs",
    )  # fmt: skip


@house_style()
def trade_off_figure(comparison: Comparison, laws: Sequence[TunedLaw]) -> Figure | None:
    """Peak input against load deviation: a point for each law, and the curve of what its tuning reaches.

    None where fewer than two laws have finite figures.
    """
    finite = [law for law in laws if np.isfinite([law.metrics.peak_input, law.metrics.load_deviation]).all()]
    if len(finite) < 2:
        return None
    from matplotlib.ticker import FuncFormatter

    points = np.array([(law.metrics.peak_input, 1e3 * law.metrics.load_deviation) for law in finite])
    figure, ((axis,),) = panels(1, 1, 5.0)
    place, units = {row.name: k for k, row in enumerate(comparison.rows)}, comparison.units()
    for law, point in zip(finite, points):
        k, own = place[law.name], law.name == NL_HINF
        style, marker = line_style(k), "*" if own else "os^Dv<>"[k % 7]
        front = pareto_front((*law.tried, law.metrics), comparison.criterion)
        curve = np.array([[m.peak_input, 1e3 * m.load_deviation] for m in front]).reshape(-1, 2)
        axis.plot(*curve.T, **{**style, "linewidth": 1.0, "alpha": 0.7})
        axis.plot(
            *point[:, None], marker, label=law.name, color=style["color"], markersize=13.0 if own else 6.5,
            linestyle="none", zorder=4.0,
        )  # fmt: skip
    axis.set(xscale="log", yscale="log", xlabel=f"peak input of the step ({units['input']})")
    legend_above(figure, axis, 5, columnspacing=1.2)
    for ruler, limit, values in zip((axis.xaxis, axis.yaxis), (axis.set_xlim, axis.set_ylim), points.T):
        ruler.set_minor_formatter(FuncFormatter(lambda x, _: f"{x:g}" if f"{x:.0e}"[0] in "2357" else ""))
        ruler.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
        limit(max(0.7 * values.min(), values.max() / RANGE), 1.4 * values.max())
    label(axis, "largest deviation under the load", units["error"])
    return figure_block(
        "trade-off", figure,
        "Peak input against load deviation; down and to the left is better. A marker is the law as it was tuned; a "
        "line joins the best candidates of its tuning that keep the limits of the linear loop.",
        "Trade-off",
    )  # fmt: skip
