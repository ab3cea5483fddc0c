"""Margins of the running loop at poses along the stated move, and which law acts where."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from flexhinf.design.along_move import MOST_LAWS, AlongMove
from flexhinf.design.result import Design
from flexhinf.pages.drawing import figure_block, pose_text, reference_line, units_of
from flexhinf.report import SERIES, Column, Figure, Paragraph, Table, house_style, label, new_figure, number

FIGURES = (
    ("damping", "smallest damping ratio"),
    ("peak_sensitivity", "peak sensitivity"),
    ("gain_margin", "gain margin"),
)


def blocks(design: Design) -> list[Any]:
    """What was looked at, the curves, and the worst poses; nothing without a stated move."""
    along = design.synthesis.along
    if along is None:
        return []
    return [Paragraph(_text(along)), _figure(along), _table(design, along)]


def remarks(design: Design) -> Iterator[str]:
    """Limits that are exceeded with every law that was tried."""
    along = design.synthesis.along
    if along is None or along.share <= 1.0:
        return
    k = along.worst_pose
    tried = (
        "with the poses of `--via`"
        if design.specification.via
        else f"with up to {MOST_LAWS} laws scheduled along it, of which {along.count} "
        f"{'is' if along.count == 1 else 'are'} used: more did not help"
    )
    yield (
        f"At {number(float(along.times[k]), 3)} s of the move the margins of the running loop are not as required, "
        f"{tried}. Try a lower `--bandwidth`, another sensor, or poses of your own (`--via`)."
    )


def along_rows(along: AlongMove | None) -> list[dict[str, Any]] | None:
    """Time, pose, law and margins at each pose; None without a stated move."""
    if along is None:
        return None
    return [
        {
            "time_s": float(time),
            "pose": pose,
            "law": law,
            "stable": found.stable,
            **{name: getattr(found, name) for name, _ in FIGURES},
        }
        for time, pose, law, found in zip(along.times, along.poses, along.laws, along.margins)
    ]


def _text(along: AlongMove) -> str:
    laws = "one law acts everywhere"
    if along.count > 1:
        added = (
            f", {along.added} of them at poses where one law did not keep the limits" if along.added else ""
        )
        laws = f"{along.count} laws are scheduled{added}; the one whose pose is nearest to the command acts"
    return (
        f"The running loop, estimator included, linearised about the robot at rest at {len(along.times)} poses that "
        f"are evenly apart on the way of the move: {laws}. Velocities along the move are not in it."
    )


def _figure(along: AlongMove) -> Figure:
    figure, axes = new_figure(3, height=5.4)
    limits = (along.least.damping, along.least.peak_sensitivity, along.least.gain_margin)
    for axis, (name, text), limit in zip(axes, FIGURES, limits):
        values = np.array([getattr(one, name) for one in along.margins], dtype=float)
        with house_style():
            for law in sorted(set(along.laws)):
                at = np.array(along.laws) == law
                axis.plot(along.times[at], values[at], "o", color=SERIES[law % len(SERIES)], markersize=4.5)
            axis.plot(along.times, values, color=SERIES[0], linewidth=1.0, zorder=1)
        if limit:
            reference_line(axis, limit)
        label(axis, text, "")
    colours = " The colour of a point is that of the law that acts there." if along.count > 1 else ""
    return figure_block(
        "along", figure,
        f"Least damping ratio of all oscillations, peak of |S| and gain margin at poses along the move. Dotted: what "
        f"is required, with its tolerance.{colours}",
        "Margins along the move",
    )  # fmt: skip


def _table(design: Design, along: AlongMove) -> Table:
    slides, degrees = design.robot.links.slides, units_of(design.evaluation).degrees
    rows = []
    for name, text in FIGURES:
        values = np.array([getattr(one, name) for one in along.margins], dtype=float)
        k = int(np.argmax(values) if name == "peak_sensitivity" else np.argmin(values))
        pose = pose_text(along.poses[k], slides, degrees)
        rows.append((text, float(values[k]), float(along.times[k]), pose))
    columns = ("figure", Column("worst", "", 3), Column("at", "s", 3), "pose")
    return Table(columns, rows, "The worst pose of each figure", "table-along")
