"""A reproduced figure: drawing, caption, numbers; and what most of them share."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from flexhinf.loop import Trajectory, load_metrics
from flexhinf.paper.bench import Outcome
from flexhinf.paper.experiments import DISTURBED_FROM
from flexhinf.report import Figure, figure_to_svg, label, legend, new_figure, time_response

__all__ = [
    "COLOURS",
    "NAMES",
    "Drawn",
    "degrees",
    "disturbance_numbers",
    "draw_inputs",
    "estimated",
    "step_numbers",
]

NAMES = {"nonlinear": "NL-H∞", "linear": "L-H∞"}
COLOURS = {"nonlinear": 0, "linear": 1}


@dataclass(frozen=True)
class Drawn:
    """One of the paper's figures, made again.

    Attributes
    ----------
    number : str
        "03" … "12".
    title, caption : str
    svg : str
    numbers : dict
        For ``metrics.json``.
    """

    number: str
    title: str
    caption: str
    svg: str
    numbers: dict[str, Any] = field(default_factory=dict)

    @property
    def block(self) -> Figure:
        """As a block of the report."""
        return Figure(
            f"figure-{self.number}", self.svg, f"{self.title} {self.caption}", f"Figure {int(self.number)}"
        )


def degrees(run: Trajectory, kind: str, name: str = "link_position") -> np.ndarray:
    """A signal in degrees, as the paper's figures have it."""
    return np.degrees(run.signal(kind, name))


def estimated(run: Trajectory, name: str = "link_position") -> np.ndarray | None:
    """The estimate in degrees; None when the true state is fed back."""
    return None if run.names["output"] == run.names["estimate"] else degrees(run, "estimate", name)


def step_numbers(outcome: Outcome) -> dict[str, Any]:
    """Numbers of a step response, named as in ``metrics.json``."""
    m = outcome.metrics
    return {
        "overshoot_percent": m["overshoot_percent"],
        "settling_time_s": m["settling_time_s"],
        "steady_state_error_rad": m["steady_state_error"],
        "peak_control_V": m["peak_input"],
        "estimation_rmse": m["estimation_rmse"],
        **({} if outcome.diverged_at is None else {"diverged_at_s": outcome.diverged_at}),
    }


def disturbance_numbers(outcome: Outcome) -> dict[str, Any]:
    """Peak deviation from the command and recovery after the disturbance started."""
    run = outcome.run
    if outcome.diverged_at is not None:
        return {"peak_deviation_rad": None, "recovery_time_s": None, "diverged_at_s": outcome.diverged_at}
    goal = float(run.signals["reference"][-1, 0])
    m = load_metrics(run.time, run.tracked("link_position"), command=goal, step=goal, start=DISTURBED_FROM)
    return {"peak_deviation_rad": m["peak_deviation"], "recovery_time_s": m["recovery_time_s"]}


def draw_inputs(outcomes: dict[str, Outcome], until: float) -> str:
    """Motor voltages of several laws over time."""
    from flexhinf.report import SERIES

    figure, (axes,) = new_figure(1)
    for name, outcome in outcomes.items():
        run = outcome.run
        shown = run.time <= until
        time_response(
            axes, run.time[shown], run.signal("input", "motor_voltage")[shown],
            name=NAMES[name], colour=SERIES[COLOURS[name]],
        )  # fmt: skip
    label(axes, "motor voltage", "V")
    legend(axes)
    return figure_to_svg(figure)
