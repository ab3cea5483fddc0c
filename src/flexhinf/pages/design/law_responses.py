"""Laws drawn together: their errors in step, load and move, and peak input against load deviation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.design.evaluation import LawEvaluation
from flexhinf.design.laws import NL_HINF
from flexhinf.design.result import ComparedLaw, Comparison
from flexhinf.design.tuning import TradeOff
from flexhinf.pages.drawing import figure_block, line_style, panels, reference_line, thin, units_of
from flexhinf.report import Figure, house_style, label

#: Points of a line in these small panels.
POINTS = 600

#: A panel shows so many times the median law's range; lines may leave it.
SHOWN = 2.5

#: A panel ends this much after the last law has settled.
AFTER = 1.3

#: A trade-off figure shows so many times the smallest finite value of each axis.
RANGE = 30.0

Signal = tuple[np.ndarray, np.ndarray]


def responses_figure(comparison: Comparison) -> Figure:
    """Errors of one joint in step, load and move: one row for each kind of laws, nonlinear H∞ in all."""
    groups = _groups(comparison)
    columns = _columns(comparison)
    figure, grid = panels(len(groups), 3, 0.6 + 2.25 * len(groups), 9.6, sharex="col", sharey="col")
    for axes, (name, laws) in zip(grid, groups):
        for axis, column in zip(axes, columns):
            for law, style in _styles(comparison, laws):
                time, error = column.signals[law.name]
                few = thin(time, POINTS)
                with house_style():
                    axis.plot(time[few], error[few], label=law.name, **style)
            reference_line(axis)
            label(axis, column.label, column.unit)
        with house_style():
            axes[0].set_title(name)
            axes[2].legend(loc="center left", bbox_to_anchor=(1.0, 0.5), handlelength=1.6)
    for axis, column in zip(grid[0], columns):
        axis.set_xlim(*column.times)
        axis.set_ylim(*column.limits)
    for axis, column in zip(grid[-1], columns):
        axis.set_xlabel(column.time)
    joints = comparison.robot.joint_names
    which = ", ".join(f"{column.what}: {joints[column.joint]}" for column in columns)
    return figure_block(
        "laws", figure,
        (
            "Errors of the true link position in the nonlinear loop with estimator and measurement noise. Left: the "
            "step as the controller is deployed. Middle: the torque on the links at the goal. Right: the planned move, "
            f"link position minus plan. {comparison.tuned_design.name} is in every row (thick). Axes are the same down "
            "a column; lines that leave a panel go on.",
            f"Joints, where the errors are largest: {which}." if len(joints) > 1 else "",
        ),
        "Laws in the same runs",
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Column:
    """Error of one joint over time, of every law."""

    what: str
    label: str
    unit: str
    time: str
    errors: dict[str, Signal]
    scale: float
    times: tuple[float, float]

    @cached_property
    def joint(self) -> int:
        """Where the median law has the largest error, root mean square."""
        sizes = [
            np.sqrt(np.nanmean(np.where(np.isfinite(error), error, np.nan) ** 2, axis=0))
            for _, error in self.errors.values()
        ]
        return int(np.argmax(np.median(sizes, axis=0)))

    @cached_property
    def signals(self) -> dict[str, Signal]:
        """Time and error of that joint, in the unit shown."""
        return {name: (t, self.scale * error[:, self.joint]) for name, (t, error) in self.errors.items()}

    @property
    def limits(self) -> tuple[float, float]:
        """Of the vertical axis: all of what most laws do."""
        inside = []
        for time, error in self.signals.values():
            shown = error[(time >= self.times[0]) & (time <= self.times[1]) & np.isfinite(error)]
            inside.append((float(shown.min(initial=0.0)), float(shown.max(initial=0.0))))
        low, high = (np.array(side) for side in zip(*inside))
        size = float(np.median(high - low))
        bottom, top = max(float(low.min()), -SHOWN * size), min(float(high.max()), SHOWN * size)
        margin = 0.06 * max(top - bottom, 1e-12)
        return bottom - margin, top + margin


def _columns(comparison: Comparison) -> tuple[_Column, _Column, _Column]:
    units, own = comparison.units(), comparison.own.evaluation
    assert own is not None
    assert own.scenario is not None
    duration = own.scenario.step_duration
    settled = [row.metrics.get("step_settling_s") for row in comparison.compared]
    last = max((value for value in settled if value is not None and np.isfinite(value)), default=duration)
    end = min(duration, max(AFTER * last, 0.1 * duration))

    def errors(of: Callable[[LawEvaluation], Signal]) -> dict[str, Signal]:
        return {row.name: of(row.evaluation) for row in comparison.compared if row.evaluation is not None}

    step = errors(lambda e: (e.step.run.time, e.step.positions - e.step.goal))
    load = errors(lambda e: (e.load_response.response.run.time - e.load_response.at, _deviation(e)))
    move = errors(lambda e: (e.move.response.run.time, e.move.error))
    shown = units_of(own)
    plan = float(own.move.response.run.time[-1])
    return (
        _Column("step", "position − goal", shown.angle, "time (s)", step, shown.scale, (0.0, end)),
        _Column(
            "load",
            "position − goal",
            units["error"],
            "time after the load (s)",
            load,
            1e3,
            (-0.05 * end, end),
        ),
        _Column("move", "position − plan", units["error"], "time (s)", move, 1e3, (0.0, plan)),
    )


def _deviation(e: LawEvaluation) -> np.ndarray:
    return e.load_response.response.positions - e.load_response.response.goal


def _groups(comparison: Comparison) -> list[tuple[str, list[ComparedLaw]]]:
    """Laws of each kind beside nonlinear H∞."""
    found: dict[str, list[ComparedLaw]] = {}
    for row in comparison.compared:
        if row is not comparison.tuned_design:
            found.setdefault(row.kind.group, []).append(row)
    return list(found.items()) or [(comparison.own.kind.group, [])]


def _styles(comparison: Comparison, laws: Sequence[ComparedLaw]) -> list[tuple[ComparedLaw, dict[str, Any]]]:
    """Nonlinear H∞ thick, the others thin above it; a law has the same style in every figure of the page."""
    styles = {row.name: line_style(k) for k, row in enumerate(comparison.rows)}
    thick = comparison.tuned_design
    own = (thick, {**styles[thick.name], "linewidth": 2.2, "zorder": 2.5})
    return [own, *((row, {**styles[row.name], "linewidth": 1.2, "zorder": 3.0}) for row in laws)]


def trade_off_figure(comparison: Comparison, offs: Sequence[TradeOff]) -> Figure | None:
    """Peak input against load deviation: a point for each law, and the curve of what its tuning reaches.

    None where fewer than two laws have finite figures.
    """
    finite = [one for one in offs if np.isfinite([one.point.peak_input, one.point.load_deviation]).all()]
    if len(finite) < 2:
        return None
    from matplotlib.ticker import FuncFormatter

    figure, ((axis,),) = panels(1, 1, 5.0)
    place = {row.name: k for k, row in enumerate(comparison.rows)}
    for one in finite:
        _trade_off(axis, one, place[one.name])
    with house_style():
        axis.set_xscale("log")
        axis.set_yscale("log")
        axis.set_xlabel(f"peak input of the step ({comparison.units()['input']})")
        figure.legend(
            *axis.get_legend_handles_labels(),
            loc="outside upper left",
            ncols=5,
            frameon=False,
            columnspacing=1.2,
        )
    peaks = [one.point.peak_input for one in finite]
    sags = [1e3 * one.point.load_deviation for one in finite]
    for which, values in ((axis.xaxis, peaks), (axis.yaxis, sags)):
        which.set_minor_formatter(
            FuncFormatter(lambda value, _: f"{value:g}" if f"{value:.0e}"[0] in "2357" else "")
        )
        which.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        low, high = max(0.7 * min(values), max(values) / RANGE), 1.4 * max(values)
        axis.set_xlim(low, high) if which is axis.xaxis else axis.set_ylim(low, high)
    label(axis, "largest deviation under the load", comparison.units()["error"])
    return figure_block(
        "trade-off", figure,
        "Peak input against load deviation; down and to the left is better. A marker is the law as it was tuned. A "
        "line joins the best of all candidates that the tuning of this law ran and that keep the limits of the linear "
        "loop.",
        "Trade-off",
    )  # fmt: skip


def _trade_off(axis: Any, one: TradeOff, k: int) -> None:
    style, own = line_style(k), one.name == NL_HINF
    with house_style():
        curve = np.array([[f.peak_input, 1e3 * f.load_deviation] for f in one.curve]).reshape(-1, 2)
        axis.plot(curve[:, 0], curve[:, 1], **{**style, "linewidth": 1.0, "alpha": 0.7})
        axis.plot(
            [one.point.peak_input], [1e3 * one.point.load_deviation], "*" if own else "os^Dv<>"[k % 7], label=one.name,
            color=style["color"], markersize=13.0 if own else 6.5, linestyle="none",
            zorder=4.0,
        )  # fmt: skip
