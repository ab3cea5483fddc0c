"""A blow on each joint at rest: how the running loop comes to rest, beside the decay that is asked for."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from flexhinf.design.impulse import AFTER, ImpulseRuns
from flexhinf.design.result import Design
from flexhinf.loop.simulation.ring_down import VISIBLE
from flexhinf.pages.drawing import (
    DASHED,
    figure_block,
    joint_lines,
    joint_table,
    reference_line,
    units_of,
)
from flexhinf.report import MUTED, Column, Figure, house_style, label, legend, new_figure, number

#: The figure ends after so many periods of the least damped oscillation.
SHOWN = 8.0


def blocks(design: Design) -> list[Any]:
    """Figure and table; nothing where a run diverged."""
    runs = design.evaluation.ring_down
    return [] if runs.ring_down is None else [_figure(runs), _table(design, runs)]


def remarks(design: Design) -> Iterator[str]:
    """A run that diverges, or that is no decaying oscillation."""
    runs = design.evaluation.ring_down
    if runs.ring_down is None:
        yield f"After a blow on {runs.responses[runs.worst].joints[runs.worst]} at the goal the loop diverges."
    elif not runs.exponential:
        left = "comes to rest" if runs.ring_down.rests else "does not come to rest"
        yield (
            "After a blow the loop does not decay as a linear one does (dry friction, backlash or limits), and "
            f"{left}; the damping ratios are those of the nearest decaying oscillations."
        )


def ring_down_rows(runs: ImpulseRuns) -> list[dict[str, Any]]:
    """Of each joint: impulse, largest deviation of its link, least damped oscillation, and what is left of it."""
    rows = []
    for k, response in enumerate(runs.responses):
        least = runs.least_damped(k)
        deviation = np.abs(response.positions[:, k] - response.goal[k]).max()
        rows.append(
            {
                "joint": response.joints[k],
                "impulse": float(runs.impulses[k]),
                "peak_deviation": None if runs.ring_down is None else float(deviation),
                "damping": None if runs.ring_down is None else runs.ring_down.damping_of(k),
                "frequency_Hz": None if least is None else least.frequency,
                "left": None if runs.ring_down is None else runs.left(k),
            }
        )
    return rows


def _figure(runs: ImpulseRuns) -> Figure:
    """Velocity of each struck link over its peak, and the envelope of the least damped oscillation."""
    joints, time = runs.responses[0].joints, runs.responses[0].run.time
    least, worst = runs.least_damped(runs.worst), runs.worst
    shown = time <= (time[-1] if least is None else SHOWN / least.frequency)
    figure, axes = new_figure(1, height=2.9)
    values = np.column_stack([runs.velocity(k)[shown] for k in range(len(joints))])
    joint_lines(axes[0], time[shown], values, joints)
    caption = (
        "Velocity of each link after a blow on it at the goal, over its peak; without measurement noise."
    )
    if least is not None and least.damping > 0.0:
        # The envelope begins at the peak: what decays slower is not the oscillation whose damping is told.
        envelope = np.exp(-2.0 * np.pi * least.frequency * least.damping * time[shown])
        with house_style():
            for sign in (1.0, -1.0):
                axes[0].plot(time[shown], sign * envelope, color=MUTED, linewidth=1.0, dashes=DASHED)
        where = f" ({joints[worst]})" if len(joints) > 1 else ""
        caption += (
            f" Dashed: the decay of the least damped oscillation{where}, {number(least.frequency, 3)} Hz with a "
            f"damping ratio of {number(least.damping, 2)}."
        )
    reference_line(axes[0])
    label(axes[0], "link velocity / peak", "")
    if len(joints) > 1:
        legend(axes[0])
    return figure_block("ringing", figure, caption, "After a blow")


def _table(design: Design, runs: ImpulseRuns) -> Any:
    units = units_of(design.evaluation)
    unit, scale = units.small
    rows = [
        (row["joint"], row["impulse"], scale * row["peak_deviation"], row["damping"], row["frequency_Hz"],
         None if row["left"] is None else 100.0 * row["left"])
        for row in ring_down_rows(runs)
    ]  # fmt: skip
    columns = (
        "joint", Column("impulse", f"{units.load}·s"), Column("largest deviation", unit),
        Column("least damping ratio", "", 3), Column("its frequency", "Hz", 3),
        Column(f"left after {AFTER:g} periods", "%", 2),
    )  # fmt: skip
    error = 0.0 if runs.ring_down is None else runs.ring_down.error
    caption = (
        "An impulse on the link, the loop at rest at the goal. Damping ratio: the least of the oscillations that make "
        f"up {100.0 * VISIBLE:g} % of the joint's own velocity or input, fitted to all samples of all runs; fit and "
        f"runs differ by {number(100.0 * error, 2)} % of the peak at most. Left: largest velocity of the link from "
        "then on, of its peak"
    )
    return joint_table(columns, rows, caption, "table-ring-down")
