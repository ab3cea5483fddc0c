"""The drawing of a comparison: step, load and move, one row for each kind of laws, the reference in all of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from flexhinf.design.compare.names import REFERENCE
from flexhinf.design.compare.result import Comparison, Row
from flexhinf.report import MUTED, SERIES, Figure, figure_to_svg, house_style

__all__ = ["comparison_figure"]

#: More points than this per line say nothing more.
POINTS = 600

#: A panel shows so many times the median law's largest error; lines may leave it.
SHOWN = 2.5

#: A panel ends this much after the last law has settled.
AFTER = 1.3

Signal = tuple[np.ndarray, np.ndarray]


def comparison_figure(comparison: Comparison) -> Figure:
    """Errors of one joint in step, load and move; a law has the same colour in all panels."""
    from matplotlib.figure import Figure as Canvas

    groups = _groups(comparison)
    panels = (_step(comparison), _load(comparison), _move(comparison))
    with house_style():
        figure = Canvas(figsize=(9.6, 0.6 + 2.25 * len(groups)), layout="constrained")
        axes = figure.subplots(len(groups), 3, sharex="col", sharey="col", squeeze=False)
        for row, (name, laws) in zip(axes, groups):
            for axis, panel in zip(row, panels):
                for law, style in _styles(comparison, laws):
                    time, error = panel.signals[law.name]
                    thin = slice(None, None, max(1, len(time) // POINTS))
                    axis.plot(time[thin], error[thin], label=law.name, **style)
                axis.axhline(0.0, color=MUTED, linewidth=0.8, linestyle=(0, (1.0, 1.6)), zorder=0.5)
            row[0].set_title(name)
            row[2].legend(loc="center left", bbox_to_anchor=(1.0, 0.5), handlelength=1.6)
        for axis, panel in zip(axes[0], panels):
            axis.set_xlim(*panel.times)
            axis.set_ylim(*panel.limits)
        for row in axes:
            for axis, panel in zip(row, panels):
                axis.set_ylabel(panel.label)
        for axis, panel in zip(axes[-1], panels):
            axis.set_xlabel(panel.time)
    joints = comparison.reference.robot.joint_names
    which = (
        ""
        if len(joints) == 1
        else " Joints: "
        + ", ".join(f"{panel.what} {joints[panel.joint]}" for panel in panels)
        + ", where the errors are largest."
    )
    return Figure(
        "figure-laws",
        figure_to_svg(figure),
        "Error of the true link position in the nonlinear loop, estimator and noise included. Left: the step. "
        "Middle: the torque on the links at the goal. Right: the planned move, link position minus plan. "
        f"{REFERENCE} is in every row (thick). Axes are the same down a column; lines that leave a panel go on.{which}",
        "Laws on the same loop",
    )


class _Panel:
    """One column: error of one joint over time, of every law."""

    def __init__(
        self,
        what: str,
        label: str,
        time: str,
        errors: dict[str, Signal],
        scale: float,
        times: tuple[float, float],
    ) -> None:
        self.what, self.label, self.time, self.times = what, label, time, times
        self.joint = _worst_joint(errors)
        self.signals = {name: (t, scale * error[:, self.joint]) for name, (t, error) in errors.items()}

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


def _worst_joint(errors: dict[str, Signal]) -> int:
    """Where the median law has the largest error, root mean square."""
    sizes = [
        np.sqrt(np.nanmean(np.where(np.isfinite(error), error, np.nan) ** 2, axis=0))
        for _, error in errors.values()
    ]
    return int(np.argmax(np.median(sizes, axis=0)))


def _errors(comparison: Comparison, of: Callable[[Row], Signal]) -> dict[str, Signal]:
    return {row.name: of(row) for row in comparison.compared}


def _step(comparison: Comparison) -> _Panel:
    def error(row: Row) -> Signal:
        assert row.runs is not None
        return row.runs.step.run.time, row.runs.step.positions - row.runs.step.goal

    duration = comparison.reference.step_duration
    settled = [row.figures["step_settling_s"] for row in comparison.compared]
    last = max((value for value in settled if value is not None and np.isfinite(value)), default=duration)
    end = min(duration, max(AFTER * last, 0.1 * duration))
    return _Panel(
        "step",
        f"position − goal ({comparison.reference.units['position']})",
        "time (s)",
        _errors(comparison, error),
        1.0,
        (0.0, end),
    )


def _load(comparison: Comparison) -> _Panel:
    def error(row: Row) -> Signal:
        assert row.runs is not None
        loaded = row.runs.loaded
        return loaded.response.run.time - loaded.at, loaded.response.positions - loaded.response.goal

    end = _step(comparison).times[1]
    label = f"position − goal ({comparison.reference.units['error']})"
    return _Panel(
        "load", label, "time after the load (s)", _errors(comparison, error), 1e3, (-0.05 * end, end)
    )


def _move(comparison: Comparison) -> _Panel:
    def error(row: Row) -> Signal:
        assert row.runs is not None
        return row.runs.move.response.run.time, row.runs.move.error

    end = 1.5 * float(comparison.reference.plan.duration)
    label = f"position − plan ({comparison.reference.units['error']})"
    return _Panel("move", label, "time (s)", _errors(comparison, error), 1e3, (0.0, end))


def _groups(comparison: Comparison) -> list[tuple[str, list[Row]]]:
    """Laws of each kind that were compared, without the reference; at least one row."""
    found: dict[str, list[Row]] = {}
    for row in comparison.others:
        found.setdefault(row.kind.group, []).append(row)
    return list(found.items()) or [(comparison.first.kind.group, [])]


def _styles(comparison: Comparison, laws: Sequence[Row]) -> list[tuple[Row, dict[str, Any]]]:
    """The reference thick, the others in the colours that follow; dashed when the colours start again."""
    found: list[tuple[Row, dict[str, Any]]] = [
        (comparison.first, {"color": SERIES[0], "linewidth": 2.2, "zorder": 2.5})
    ]
    for k, row in enumerate(laws):
        style: dict[str, Any] = {"color": SERIES[1 + k % (len(SERIES) - 1)], "linewidth": 1.2, "zorder": 3.0}
        if k >= len(SERIES) - 1:
            style["dashes"] = (4.0, 2.0)
        found.append((row, style))
    return found
