"""How runs are drawn in the paper's figures: responses, voltages, load responses, and runs of many plants."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from flexhinf.loop import Trajectory
from flexhinf.paper.experiments import LOAD_FROM, ToleranceRun
from flexhinf.report import (
    INK,
    SERIES,
    figure_to_svg,
    house_style,
    label,
    legend,
    new_figure,
    quantile_band,
    reference_line,
    settling_band,
    time_response,
)

__all__ = ["draw_inputs", "draw_loads", "draw_responses", "draw_sampled", "slowest", "worst_overshoot"]

NAMES = {"nonlinear": "NL-H∞", "linear": "L-H∞"}
COLOURS = {"nonlinear": SERIES[0], "linear": SERIES[1]}

#: The first part of a run on a sampled plant, s, shown in full; the rest is shown enlarged.
FIRST_PART = 6.0


def degrees(run: Trajectory, kind: str, name: str = "link_position") -> np.ndarray:
    """A signal in degrees, as the paper's figures have it."""
    return np.degrees(run.signal(kind, name))


def estimated(run: Trajectory, name: str = "link_position") -> np.ndarray | None:
    """The estimate in degrees; None when the true state is fed back."""
    return None if run.names["output"] == run.names["estimate"] else degrees(run, "estimate", name)


def draw_inputs(runs: Mapping[str, Trajectory], until: float) -> str:
    """Motor voltages of several laws over time."""
    figure, (axes,) = new_figure(1)
    for name, run in runs.items():
        shown = run.time <= until
        volts = run.signal("input", "motor_voltage")[shown]
        time_response(axes, run.time[shown], volts, name=NAMES[name], colour=COLOURS[name])
    label(axes, "motor voltage", "V")
    legend(axes)
    return figure_to_svg(figure)


def draw_responses(runs: Mapping[str, Trajectory], until: float, *, step: float | None = None) -> str:
    """Link positions of several laws in degrees, measured and estimated, with the command.

    Parameters
    ----------
    runs : mapping of law to Trajectory
    until : float
        Last time shown, s.
    step : float, optional
        Height of the step in degrees, for the settling band.
    """
    figure, (axes,) = new_figure(1, height=3.6)
    first = next(iter(runs.values()))
    shown = first.time <= until
    command = degrees(first, "reference")[shown]
    reference_line(axes, first.time[shown], command)
    if step is not None:
        settling_band(axes, float(command[-1]), step)
    for name, run in runs.items():
        shown = run.time <= until
        estimate = estimated(run)
        time_response(
            axes, run.time[shown], degrees(run, "output")[shown], None if estimate is None else estimate[shown],
            name=NAMES[name], colour=COLOURS[name],
        )  # fmt: skip
    label(axes, "link position", "°")
    legend(axes)
    return figure_to_svg(figure)


def draw_loads(runs: Mapping[str, Trajectory]) -> str:
    """Link position, its error enlarged from the disturbance on, and the torque; one colour per place of the torque."""
    figure, (position, error, torque) = new_figure(3, height=6.6)
    longest = max(runs.values(), key=lambda run: len(run.time))
    reference_line(position, longest.time, degrees(longest, "reference"))
    goal, largest = float(degrees(longest, "reference")[-1]), 0.0
    settling_band(error, 0.0, goal)
    for colour, (channel, run) in zip(SERIES, runs.items(), strict=False):
        name = f"torque at the {channel.removesuffix('_torque')}"
        measured, estimate = degrees(run, "output"), estimated(run)
        time_response(position, run.time, measured, estimate, name=name, colour=colour)
        late = run.time >= LOAD_FROM - 1.0
        off = None if estimate is None else estimate[late] - goal
        time_response(error, run.time[late], measured[late] - goal, off, colour=colour)
        largest = max(largest, float(np.abs(measured[late] - goal).max(initial=0.0)))
    torque.plot(
        longest.time, longest.signals["disturbance"].sum(axis=1), color=SERIES[3]
    )  # the same at both places
    reach = 1.1 * min(max(largest, 1.0), 180.0)
    error.set_ylim(-reach, reach)
    label(position, "link position", "°")
    label(error, "link − command", "°")
    label(torque, "disturbance torque", "N·m")
    figure.align_ylabels([position, error, torque])
    legend(position)
    return figure_to_svg(figure)


# Many plants -------------------------------------------------------------------------------------------
def worst_overshoot(runs: Sequence[ToleranceRun]) -> int:
    """Which run overshoots most; one that diverged comes before all others."""
    return max(range(len(runs)), key=lambda k: _key(runs[k].metrics["overshoot_percent"]))


def slowest(runs: Sequence[ToleranceRun]) -> int:
    """Which run settles last; of those that never settle, the one that ends farthest from the command."""
    return max(
        range(len(runs)),
        key=lambda k: (_key(runs[k].metrics["settling_time_s"]), _key(runs[k].metrics["steady_state_error"])),
    )


def _key(value: float | None) -> float:
    return math.inf if value is None else value


@house_style()
def draw_sampled(runs: Sequence[ToleranceRun], kind: str) -> str:
    """All runs on sampled plants, the two worst drawn apart; the first seconds above, the rest enlarged below."""
    whole = [run for run in runs if run.diverged_at is None]
    figure, _ = new_figure(2, height=5.6)
    figure.clear()
    above, below = figure.subplots(2, 1)
    if not whole:
        above.text(0.5, 0.5, "every run diverged", ha="center", transform=above.transAxes)
        return figure_to_svg(figure)
    time, command = whole[0].time, whole[0].command
    values = np.array([getattr(run, kind) for run in whole])
    apart = ((worst_overshoot(whole), INK, "largest overshoot"), (slowest(whole), SERIES[1], "settles last"))
    for axes, part in ((above, time <= FIRST_PART), (below, time >= FIRST_PART)):
        if axes is above:
            settling_band(axes, command, command)
        quantile_band(axes, time[part], values[:, part])
        for k, colour, name in apart:
            axes.plot(time[part], values[k, part], color=colour, linewidth=1.1, dashes=(5.0, 1.5), label=name)
        label(axes, "link position", "°")
        axes.set_xlabel("time (s)")
    figure.align_ylabels([above, below])
    legend(above)
    return figure_to_svg(figure)
