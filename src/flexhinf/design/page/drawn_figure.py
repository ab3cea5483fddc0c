"""Robots within their tolerances drawn: bands of their link positions, and how their figures of merit spread."""

from __future__ import annotations

import numpy as np

from flexhinf.design.page.drawing import side_by_side, zero_line
from flexhinf.design.page.units import units_of
from flexhinf.design.page.words import largest_overshoot, peak_input, slowest_settling
from flexhinf.design.result import Design
from flexhinf.report import (
    INK,
    SERIES,
    Figure,
    figure_to_svg,
    house_style,
    label,
    legend,
    new_figure,
    quantile_band,
    settling_band,
)

__all__ = ["fan_figure", "spread_figure"]

#: So many joints are drawn: those whose robots differ most, over the largest step.
PANELS = 3

#: Fewer robots than this have no histogram.
FEW = 15

#: What is shown close to the goal, over the step.
CLOSE = 0.12


def fan_figure(design: Design, worst: int) -> list[Figure]:
    """Link positions of all robots that reached the end, over time; none if there is none."""
    draws, units = design.draws, units_of(design)
    assert draws is not None
    ended = np.flatnonzero(np.isfinite(draws.positions).all(axis=(1, 2)))
    if not len(ended):
        return []
    away = draws.positions[ended] - design.goal
    joints = _most_spread(away)
    place = int(np.flatnonzero(ended == worst)[0]) if worst in ended else None
    steps, near = design.goal - design.start, _last_apart(away, design)
    figure, axes = new_figure(len(joints) + 1)
    names = design.robot.joint_names
    for axis, joint in zip(axes, [*joints, near]):
        quantile_band(
            axis,
            draws.time,
            away[:, :, joint],
            worst=place,
            worst_name=f"robot {worst + 1}, the last to settle",
        )
        zero_line(axis)
        label(axis, f"{names[joint]} − goal" if len(names) > 1 else "link − goal", units.position)
    settling_band(axes[-1], 0.0, float(steps[near]))
    axes[-1].set_ylim(-CLOSE * abs(steps[near]) or -1e-3, CLOSE * abs(steps[near]) or 1e-3)
    legend(axes[0])
    shown = f", of the {len(joints)} joints that differ most" if len(joints) < len(names) else ""
    closer = f"{names[near]} about its goal" if len(names) > 1 else "the same about the goal"
    left_out = len(draws) - len(ended)
    gone = f"; {left_out} that diverged are left out" if left_out else ""
    return [
        Figure(
            "figure-draws",
            figure_to_svg(figure),
            f"Link positions as distance from the goal{shown}: {len(ended)} robots within their tolerances{gone}. "
            f"Below {closer}, with the band of ±2 % of the step.",
            "The step within the tolerances",
        )
    ]


def _most_spread(away: np.ndarray) -> list[int]:
    """Joints by how far the robots are apart at any time, at most `PANELS`, in the robot's order."""
    spread = np.ptp(away, axis=0).max(axis=0)
    return sorted(np.argsort(-spread)[:PANELS].tolist())


def _last_apart(away: np.ndarray, design: Design) -> int:
    """The joint whose robots are furthest apart in the second half of the run, over its step."""
    steps = np.abs(design.goal - design.start)
    late = np.ptp(away[:, away.shape[1] // 2 :], axis=0).max(axis=0)
    return int(np.argmax(np.where(steps > 0.0, late / np.where(steps > 0.0, steps, 1.0), -1.0)))


def spread_figure(design: Design) -> list[Figure]:
    """Histograms of overshoot, settling time and peak input; none for a few robots, or where no run settled."""
    draws, s, units = design.draws, design.specification, units_of(design)
    assert draws is not None
    merits = (
        ("overshoot", "%", draws.overshoot, largest_overshoot(design.response), s.overshoot),
        ("settling time", "s", draws.settling, slowest_settling(design.response), None),
        ("peak input", units.effort, draws.peak, peak_input(design.response), s.peak_effort),
    )
    if len(draws) < FEW or not any(np.isfinite(values).any() for _, _, values, _, _ in merits[:2]):
        return []
    figure, axes = side_by_side(3, 2.5)
    with house_style():
        for axis, (name, unit, values, nominal, limit) in zip(axes, merits):
            _histogram(axis, values[np.isfinite(values)], nominal, limit)
            axis.set_xlabel(f"{name} ({unit})")
        axes[0].set_ylabel("robots")
    return [
        Figure(
            "figure-spread",
            figure_to_svg(figure),
            "How many robots have which overshoot, settling time and peak input (the worst joint of each); the nominal "
            "robot is the orange line, a limit that was passed or is near the dashed one.",
            "Spread",
        )
    ]


def _histogram(axis: object, values: np.ndarray, nominal: float | None, limit: float | None) -> None:
    if not len(values):
        return
    axis.hist(values, bins=min(20, max(5, len(values) // 5)), color=SERIES[0], alpha=0.55)  # type: ignore[attr-defined]
    axis.grid(axis="x", visible=False)  # type: ignore[attr-defined]
    if nominal is not None:
        axis.axvline(nominal, color=SERIES[1], linewidth=1.6)  # type: ignore[attr-defined]
    if limit is not None and float(values.max()) > 0.5 * limit:
        axis.axvline(limit, color=INK, linewidth=1.0, dashes=(6.0, 3.0))  # type: ignore[attr-defined]
