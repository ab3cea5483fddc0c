"""The step on robots sampled within their tolerances, with the controller as it was designed."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from flexhinf.design.evaluation import LawEvaluation
from flexhinf.design.monte_carlo import MonteCarlo
from flexhinf.design.result import Design
from flexhinf.pages.drawing import (
    DASHED,
    Units,
    changes_text,
    figure_block,
    panels,
    reference_line,
    units_of,
)
from flexhinf.report import (
    INK,
    SERIES,
    Figure,
    Paragraph,
    Table,
    house_style,
    label,
    legend,
    new_figure,
    number,
    quantile_band,
    settling_band,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Panels of link positions: of the joints whose robots differ most, relative to the largest step.
PANELS = 3

#: Fewer robots than this get no histograms.
FEW = 15

#: Half height of the panel about the goal, relative to the step.
CLOSE = 0.12


def blocks(design: Design) -> list[Any]:
    """Bands, histograms, table; none where no robot was sampled."""
    e = design.evaluation
    samples = e.step_samples
    if samples is None or not len(samples):
        return []
    units = units_of(e)
    figures = [*_bands(e, samples, units), *_histograms(e, samples, units)]
    return [Paragraph(_text(e, samples)), *figures, _table(e, samples, units)]


def remarks(design: Design) -> Iterator[str]:
    """Runs that diverge."""
    samples = design.evaluation.step_samples
    if samples is not None and samples.diverged:
        yield (
            f"{samples.diverged} of {len(samples)} robots within their tolerances diverge with this controller. "
            "--preset robust includes the tolerances in the synthesis."
        )


def _text(e: LawEvaluation, samples: MonteCarlo) -> str:
    count = len(e.setup.robot.uncertain)
    text = (
        f"{count} parameters of the robot are sampled uniformly within their tolerances, {len(samples)} times. "
        "Controller and estimator stay as designed for the nominal robot; every robot has its own measurement noise. "
        "A sample says nothing about the robots between."
    )
    worst = [("largest overshoot", samples.worst), ("slowest settling", samples.slowest)]
    if samples.worst == samples.slowest:
        worst = [("largest overshoot and slowest settling", samples.worst)]
    found = (f" {what.capitalize()}: robot {k + 1} ({_changes(e, samples, k)})." for what, k in worst)
    return text + "".join(found)


def _changes(e: LawEvaluation, samples: MonteCarlo, k: int) -> str:
    """Robot k by its largest changes."""
    return changes_text(samples.values[k], e.setup.robot, e.setup.specification.extras)


def _bands(e: LawEvaluation, samples: MonteCarlo, units: Units) -> list[Figure]:
    """Link positions of all robots that reached the end; none if there is none."""
    ended = np.flatnonzero(np.isfinite(samples.positions).all(axis=(1, 2)))
    if not len(ended):
        return []
    away = units.scale * (samples.positions[ended] - e.setup.goal)
    steps = units.scale * np.abs(e.setup.goal - e.setup.start)
    shown, close, names = _most_spread(away), _last_apart(away, steps), e.setup.joints
    figure, axes = new_figure(len(shown) + 1)
    for axis, joint in zip(axes, [*shown, close]):
        quantile_band(axis, samples.time, away[:, :, joint])
        _worst_lines(axis, samples, ended, away[:, :, joint])
        reference_line(axis)
        label(axis, f"{names[joint]} − goal" if len(names) > 1 else "link − goal", units.angle)
    settling_band(axes[-1], 0.0, float(steps[close]))
    axes[-1].set_ylim(-CLOSE * steps[close] or -1e-3, CLOSE * steps[close] or 1e-3)
    legend(axes[0])
    some = f", the {len(shown)} joints that differ most" if len(shown) < len(names) else ""
    closer = f"{names[close]}, close to its goal" if len(names) > 1 else "the same, close to the goal"
    missing = len(samples) - len(ended)
    gone = f" {missing} that diverged are left out." if missing else ""
    return [
        figure_block(
            "draws", figure,
            f"Link positions as distance from the goal{some}, of {len(ended)} sampled robots.{gone} Bottom: {closer}, "
            "with the band of ±2 % of the step.",
            "Sampled robots",
        )
    ]  # fmt: skip


def _worst_lines(axis: Axes, samples: MonteCarlo, ended: np.ndarray, away: np.ndarray) -> None:
    """The runs with the largest overshoot and the slowest settling, where they reached the end."""
    which = {samples.worst: "largest overshoot"}
    which[samples.slowest] = (
        "largest overshoot, slowest settling" if samples.slowest in which else "slowest settling"
    )
    with house_style():
        for k, (robot, name) in enumerate(which.items()):
            if robot in ended:
                line = away[int(np.flatnonzero(ended == robot)[0])]
                style = {"color": INK if k == 0 else SERIES[1], "linewidth": 1.1}
                axis.plot(
                    samples.time, line, label=name, dashes=(5.0, 1.5) if k == 0 else (2.0, 1.2), **style
                )


def _most_spread(away: np.ndarray) -> list[int]:
    """Joints whose robots are furthest apart at any time, at most `PANELS`, in the robot's order."""
    spread = np.ptp(away, axis=0).max(axis=0)
    return sorted(np.argsort(-spread)[:PANELS].tolist())


def _last_apart(away: np.ndarray, steps: np.ndarray) -> int:
    """The joint whose robots are furthest apart in the second half of the run, relative to its step."""
    late = np.ptp(away[:, away.shape[1] // 2 :], axis=0).max(axis=0)
    return int(np.argmax(np.where(steps > 0.0, late / np.where(steps > 0.0, steps, 1.0), -1.0)))


def _histograms(e: LawEvaluation, samples: MonteCarlo, units: Units) -> list[Figure]:
    """How overshoot, settling time and peak input spread; none for few robots, or where no run settles."""
    s, step = e.setup.specification, e.step
    figures = (
        ("overshoot", "%", samples.overshoot, step.overshoot.value, s.overshoot),
        ("settling time", "s", samples.settling, step.settling.value, None),
        ("peak input", units.effort, samples.peak, step.peak_input, _common(e.setup.limits.peak)),
    )
    if len(samples) < FEW or not any(np.isfinite(values).any() for _, _, values, _, _ in figures[:2]):
        return []
    figure, (axes,) = panels(1, 3, 2.5)
    for axis, (name, unit, values, nominal, limit) in zip(axes, figures):
        _histogram(axis, values[np.isfinite(values)], nominal, limit, s.period if unit == "s" else 0.0)
        axis.set_xlabel(f"{name} ({unit})")
        label(axis, "robots", "")
    return [
        figure_block(
            "spread", figure,
            "How many robots have which overshoot, settling time and peak input (the worst joint of each). The orange "
            "line is the nominal robot, the dashed one a limit that is near or exceeded.",
            "Spread of the sampled robots",
        )
    ]  # fmt: skip


def _common(limits: np.ndarray) -> float | None:
    """The limit that all motors have; None where they differ, or have none."""
    return float(limits[0]) if np.isfinite(limits[0]) and len(set(limits.tolist())) == 1 else None


def histogram_bins(values: np.ndarray, grain: float) -> np.ndarray:
    """Edges of bins over values; where these are multiples of a grain, such as the period, so is the bins' width.

    Bins that are not would hold now more, now fewer of the possible values, and look like a comb.
    """
    count = min(20, max(5, len(values) // 5))
    if not grain:
        return np.histogram_bin_edges(values, count)
    first, last = (round(float(end) / grain) for end in (values.min(), values.max()))
    wide = max(1, -(-(last - first + 1) // count))
    return grain * (np.arange(first, last + wide + 1, wide) - 0.5)


def _histogram(
    axis: Axes, values: np.ndarray, nominal: float, limit: float | None, grain: float = 0.0
) -> None:
    if not len(values):
        return
    with house_style():
        axis.hist(values, bins=histogram_bins(values, grain).tolist(), color=SERIES[0], alpha=0.55)
        axis.grid(axis="x", visible=False)
        if np.isfinite(nominal):
            axis.axvline(nominal, color=SERIES[1], linewidth=1.6)
        if limit is not None and float(values.max()) > 0.5 * limit:
            axis.axvline(limit, color=INK, linewidth=1.0, dashes=DASHED)


def spread_rows(e: LawEvaluation, units: Units) -> list[tuple[Any, ...]]:
    """Figure, unit, nominal, median, 95th percentile, worst, joint of the worst; infinite for runs without one."""
    samples, step, several = e.step_samples, e.step, len(e.setup.joints) > 1
    assert samples is not None
    figures = (
        ("overshoot", "%", samples.overshoot, step.overshoot.value, samples.overshoot_joints[samples.worst]),
        (
            "settling time",
            "s",
            samples.settling,
            step.settling.value,
            samples.settling_joints[samples.slowest],
        ),
        (
            "peak input",
            units.effort,
            samples.peak,
            step.peak_input,
            samples.peak_joints[int(np.argmax(samples.peak))],
        ),
    )
    return [
        (
            name, unit, value, *(float(np.quantile(found, q, method="higher")) for q in (0.5, 0.95, 1.0)),
            joint if several else "",
        )
        for name, unit, found, value, joint in figures
    ]  # fmt: skip


def _table(e: LawEvaluation, samples: MonteCarlo, units: Units) -> Table:
    several = len(e.setup.joints) > 1
    rows = [
        (name, unit, *(_cell(value) for value in values), *([joint or "–"] if several else []))
        for name, unit, *values, joint in spread_rows(e, units)
    ]
    settled = f"{len(samples) - samples.unsettled} of {len(samples)} settle, {samples.diverged} diverge"
    columns = (
        "",
        "unit",
        "nominal robot",
        "median",
        "95 % are below",
        "worst",
        *(["worst joint"] if several else []),
    )
    return Table(
        columns, rows, f"Worst joint of each robot: {settled}" if several else settled, "table-draws"
    )


def _cell(value: float) -> str:
    return "never" if np.isinf(value) else number(value, 3)
