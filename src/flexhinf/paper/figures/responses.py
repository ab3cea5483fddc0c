"""How a step or tracking response is drawn: command, measured, estimated, settling band."""

from __future__ import annotations

import numpy as np

from flexhinf.paper.bench import Outcome
from flexhinf.paper.figures.drawn import COLOURS, NAMES, degrees, estimated
from flexhinf.report import (
    SERIES,
    figure_to_svg,
    label,
    legend,
    new_figure,
    reference_line,
    settling_band,
    time_response,
)

__all__ = ["draw_disturbed", "draw_responses"]


def draw_responses(outcomes: dict[str, Outcome], until: float, *, step: float | None = None) -> str:
    """Link positions of several laws in degrees, measured and estimated, with the command.

    Parameters
    ----------
    outcomes : dict of law to Outcome
    until : float
        Last time shown, s.
    step : float, optional
        Height of the step in degrees, for the settling band.
    """
    figure, (axes,) = new_figure(1, height=3.6)
    first = next(iter(outcomes.values())).run
    shown = first.time <= until
    command = degrees(first, "reference")[shown]
    reference_line(axes, first.time[shown], command)
    if step is not None:
        settling_band(axes, float(command[-1]), step)
    for name, outcome in outcomes.items():
        run = outcome.run
        shown = run.time <= until
        estimate = estimated(run)
        time_response(
            axes, run.time[shown], degrees(run, "output")[shown], None if estimate is None else estimate[shown],
            name=NAMES[name], colour=SERIES[COLOURS[name]],
        )  # fmt: skip
    label(axes, "link position", "°")
    legend(axes)
    return figure_to_svg(figure)


def draw_disturbed(outcomes: dict[str, Outcome]) -> str:
    """Link position above, disturbance torque below; one colour per channel where the torque acts."""
    figure, (above, below) = new_figure(2, height=4.6)
    runs = {channel: outcome.run for channel, outcome in outcomes.items()}
    first = next(iter(runs.values()))
    reference_line(above, first.time, degrees(first, "reference"))
    for place, (channel, run) in enumerate(runs.items()):
        where = channel.replace("_torque", "")
        time_response(
            above,
            run.time,
            degrees(run, "output"),
            estimated(run),
            name=f"torque at the {where}",
            colour=SERIES[place],
        )
    longest = max(runs.values(), key=lambda run: len(run.time))
    torque = np.abs(longest.signals["disturbance"]).argmax(axis=1)
    value = longest.signals["disturbance"][np.arange(len(torque)), torque]
    below.plot(longest.time, value, color=SERIES[3])
    label(above, "link position", "°")
    label(below, "torque", "N·m")
    legend(above)
    return figure_to_svg(figure)
