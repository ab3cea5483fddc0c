"""Figures 3–12 of the paper, made again: how each is drawn, and the numbers beside it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from flexhinf.loop import Trajectory
from flexhinf.paper.experiments import (
    FREQUENCY,
    LOAD_FROM,
    STEP_DURATION,
    TORQUE,
    TRACKING_DURATION,
    Experiments,
    ToleranceRun,
    load_numbers,
    step_numbers,
    tracking_numbers,
)
from flexhinf.report import (
    INK,
    SERIES,
    Column,
    Figure,
    Table,
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

NAMES = {"nonlinear": "NL-H∞", "linear": "L-H∞"}
COLOURS = {"nonlinear": SERIES[0], "linear": SERIES[1]}

#: The first part of a run on a sampled plant, s, shown in full; the rest is shown enlarged.
FIRST_PART = 6.0


@dataclass(frozen=True)
class PaperFigure:
    """One of the paper's figures, made again.

    Attributes
    ----------
    number : str
        "03" … "12".
    numbers : dict
        For ``metrics.json``.
    tables : tuple of Table
        What stands below the figure.
    """

    number: str
    title: str
    caption: str
    svg: str
    numbers: dict[str, Any] = field(default_factory=dict)
    tables: tuple[Table, ...] = ()

    @property
    def blocks(self) -> tuple[Figure | Table, ...]:
        """As blocks of the report."""
        caption = f"{self.title} {self.caption}"
        return (
            Figure(f"figure-{self.number}", self.svg, caption, f"Figure {int(self.number)}"),
            *self.tables,
        )


@dataclass(frozen=True)
class Recipe:
    """How one of the paper's figures is made from the experiments.

    Attributes
    ----------
    number, title : str
        As of `PaperFigure`.
    caption : str or callable
        A text, or from the runs.
    runs : callable
        The runs that the figure shows.
    draw, numbers, tables : callable
        From the runs: the drawing as SVG, the numbers, and what stands below the figure.
    """

    number: str
    title: str
    caption: str | Callable[[Experiments], str]
    runs: Callable[[Experiments], Any]
    draw: Callable[[Any], str]
    numbers: Callable[[Any], dict[str, Any]]
    tables: Callable[[Any], tuple[Table, ...]] = lambda runs: ()

    def __call__(self, experiments: Experiments) -> PaperFigure:
        """The figure."""
        runs = self.runs(experiments)
        caption = self.caption if isinstance(self.caption, str) else self.caption(experiments)
        numbers, tables = self.numbers(runs), self.tables(runs)
        return PaperFigure(self.number, self.title, caption, self.draw(runs), numbers, tables)


# Drawings ----------------------------------------------------------------------------------------------
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
    )  # alike at both places
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


# Numbers and tables ------------------------------------------------------------------------------------
def _each(numbers: Callable[[Trajectory], Any]) -> Callable[[Mapping[str, Trajectory]], dict[str, Any]]:
    """The numbers of every run by its name."""
    return lambda runs: {name: numbers(run) for name, run in runs.items()}


def _peak(run: Trajectory) -> dict[str, Any]:
    return {"peak_control_V": run.metrics()["peak_input"]}


def _load_numbers(runs: dict[str, Trajectory]) -> dict[str, Any]:
    return {
        "nonlinear": load_numbers(runs["link_torque"]),
        "nonlinear, torque at the motor": load_numbers(runs["motor_torque"]),
    }


def _sampled_numbers(runs: Sequence[ToleranceRun]) -> dict[str, Any]:
    return {"nonlinear": _ranges(runs)}


def _estimated_numbers(runs: Sequence[ToleranceRun]) -> dict[str, Any]:
    whole = [run.metrics["estimation_rmse"] for run in runs if run.diverged_at is None]
    columns = np.array(whole).T if whole else np.zeros((0, 0))
    return {"nonlinear": {**_ranges(runs), "estimation_rmse": [_spread(column) for column in columns]}}


def _sampled_caption(experiments: Experiments) -> str:
    runs = experiments.sampled_plants
    diverged = sum(run.diverged_at is not None for run in runs)
    return (
        f"{len(runs)} plants sampled uniformly, with coil inductance; below, the rest of the 30 s enlarged, with the "
        f"measurement's noise on it. {f'{diverged} runs diverged and are not drawn.' if diverged else ''}"
    )


def _estimated_caption(experiments: Experiments) -> str:
    if experiments.setup.settings.estimator == "none":
        return "The true state is fed back, so they are the same."
    return "The estimator believes in the nominal plant without coil."


def _spread(values: Iterable[float | None]) -> list[float | None]:
    """[smallest, median, largest] of the numbers among the values."""
    numbers = [float(value) for value in values if value is not None]
    return [min(numbers), float(np.median(numbers)), max(numbers)] if numbers else [None, None, None]


def _ranges(runs: Sequence[ToleranceRun]) -> dict[str, Any]:
    """Ranges over the plants, and how many did not settle (or diverged)."""
    metrics = [run.metrics for run in runs]
    return {
        "plants": len(runs),
        "overshoot_percent": _spread(m["overshoot_percent"] for m in metrics),
        "settling_time_s": _spread(m["settling_time_s"] for m in metrics),
        "steady_state_error_rad": _spread(m["steady_state_error"] for m in metrics),
        "unsettled": sum(m["settling_time_s"] is None for m in metrics),
        "diverged": sum(run.diverged_at is not None for run in runs),
    }


def _worst_table(runs: Sequence[ToleranceRun]) -> Table:
    rows = []
    for name, k in (("largest overshoot", worst_overshoot(runs)), ("settles last", slowest(runs))):
        m, error = runs[k].metrics, runs[k].metrics["steady_state_error"]
        error = None if error is None else math.degrees(error)
        rows.append(
            (name, m["overshoot_percent"], m["settling_time_s"], error, runs[k].changes.replace("-", "−"))
        )
    columns = (
        "run",
        Column("overshoot", "%", 2),
        Column("settling", "s", 2),
        Column("largest error in the last 3 s", "°", 3),
        "changes of the plant",
    )
    caption = (
        "The worst runs of Figures 9 and 10, of the true link; – where a run diverged or did not settle."
    )
    return Table(columns, rows, caption, "table-worst-runs", stacks=True)


#: In the order of the paper.
FIGURES = (
    Recipe(
        "03", "Step to 180°: link position.",
        "The paper shows NL-H∞ alone; the linear law of the same γ is added. Dotted: command; grey: ±2 % of the step.",
        lambda e: e.step_180, lambda runs: draw_responses(runs, STEP_DURATION, step=180.0), _each(step_numbers),
    ),
    Recipe(
        "04", "Step to 180°: motor voltage.", "The law is held between samples.",
        lambda e: e.step_180, lambda runs: draw_inputs(runs, STEP_DURATION), _each(_peak),
    ),
    Recipe(
        "05", "Step to 90°: link position by NL-H∞ and by L-H∞.",
        "The measured and the estimated curve lie on each other. Dotted: command; grey: ±2 % of the step.",
        lambda e: e.step_90, lambda runs: draw_responses(runs, STEP_DURATION, step=90.0), _each(step_numbers),
    ),
    Recipe(
        "06", "Step to 90°: motor voltage by NL-H∞ and by L-H∞.",
        "At rest at 90° the motor holds the full gravity torque M g L: 10.9 V.",
        lambda e: e.step_90, lambda runs: draw_inputs(runs, STEP_DURATION), _each(_peak),
    ),
    Recipe(
        "07", "Tracking π + sin(πt/10): link position.",
        "The law acts on the angle from hanging and on the integral of the error, so the arm follows a moving command "
        "with a delay.",
        lambda e: e.tracking, lambda runs: draw_responses(runs, TRACKING_DURATION), _each(tracking_numbers),
    ),
    Recipe(
        "08", "Tracking π + sin(πt/10): motor voltage.", "",
        lambda e: e.tracking, lambda runs: draw_inputs(runs, TRACKING_DURATION), _each(_peak),
    ),
    Recipe(
        "09", "Step to 90° under the tolerances of Tables 1 and 2: link position as measured.", _sampled_caption,
        lambda e: e.sampled_plants, lambda runs: draw_sampled(runs, "output"), _sampled_numbers,
        lambda runs: (_worst_table(runs),),
    ),
    Recipe(
        "10", "The runs of Figure 9 as estimated.", _estimated_caption,
        lambda e: e.sampled_plants, lambda runs: draw_sampled(runs, "estimate"), _estimated_numbers,
    ),
    Recipe(
        "11", "Step to 90° with a step disturbance: link position, and its error from one second before the torque on.",
        f"A torque of {TORQUE:g} N·m from t = {LOAD_FROM:g} s on, at the link or at the motor. "
        "The paper gives neither size nor place.",
        lambda e: e.step_disturbance, draw_loads, _load_numbers,
    ),
    Recipe(
        "12",
        "Step to 90° with a sinusoidal disturbance: link position, and its error from one second before the torque on.",
        f"A torque of {TORQUE:g} N·m at {FREQUENCY:g} Hz from t = {LOAD_FROM:g} s on, at the link or at the motor.",
        lambda e: e.sine_disturbance, draw_loads, _load_numbers,
    ),
)  # fmt: skip
