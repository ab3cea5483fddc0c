"""Figures 3–12 of the paper, made again."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from flexhinf.loop import Trajectory
from flexhinf.paper.drawing import (
    draw_inputs,
    draw_loads,
    draw_responses,
    draw_sampled,
    slowest,
    worst_overshoot,
)
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
from flexhinf.report import Column, Figure, Table

__all__ = ["FIGURES", "PaperFigure"]


@dataclass(frozen=True)
class PaperFigure:
    """One of the paper's figures, made again.

    Attributes
    ----------
    number : str
        "03" … "12".
    title, caption : str
    svg : str
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


# Steps and tracking ------------------------------------------------------------------------------------
def figure_03(experiments: Experiments) -> PaperFigure:
    """Step response to 180° by NL-H∞, measured and estimated; the linear law beside it."""
    runs = experiments.step_180
    return PaperFigure(
        "03",
        "Step to 180°: link position.",
        "The paper shows NL-H∞ alone; the linear law of the same γ is added. Dotted: command; grey: ±2 % of the step.",
        draw_responses(runs, STEP_DURATION, step=180.0),
        {name: step_numbers(run) for name, run in runs.items()},
    )


def figure_04(experiments: Experiments) -> PaperFigure:
    """The control signal of Fig. 3."""
    runs = experiments.step_180
    return PaperFigure(
        "04",
        "Step to 180°: motor voltage.",
        "The law is held between samples.",
        draw_inputs(runs, STEP_DURATION),
        _peaks(runs),
    )


def figure_05(experiments: Experiments) -> PaperFigure:
    """Step response to 90°, NL-H∞ against L-H∞."""
    runs = experiments.step_90
    return PaperFigure(
        "05",
        "Step to 90°: link position by NL-H∞ and by L-H∞.",
        "The measured and the estimated curve lie on each other. Dotted: command; grey: ±2 % of the step.",
        draw_responses(runs, STEP_DURATION, step=90.0),
        {name: step_numbers(run) for name, run in runs.items()},
    )


def figure_06(experiments: Experiments) -> PaperFigure:
    """The control signals of Fig. 5."""
    runs = experiments.step_90
    return PaperFigure(
        "06",
        "Step to 90°: motor voltage by NL-H∞ and by L-H∞.",
        "At rest at 90° the motor holds the full gravity torque M g L: 10.9 V.",
        draw_inputs(runs, STEP_DURATION),
        _peaks(runs),
    )


def figure_07(experiments: Experiments) -> PaperFigure:
    """Tracking π + sin(πt/10), NL-H∞; the linear law beside it."""
    runs = experiments.tracking
    return PaperFigure(
        "07",
        "Tracking π + sin(πt/10): link position.",
        "The law acts on the angle from hanging and on the integral of the error, so the arm follows a moving command "
        "with a delay.",
        draw_responses(runs, TRACKING_DURATION),
        {name: tracking_numbers(run) for name, run in runs.items()},
    )


def figure_08(experiments: Experiments) -> PaperFigure:
    """The control signal of Fig. 7."""
    runs = experiments.tracking
    return PaperFigure(
        "08",
        "Tracking π + sin(πt/10): motor voltage.",
        "",
        draw_inputs(runs, TRACKING_DURATION),
        _peaks(runs),
    )


def _peaks(runs: dict[str, Trajectory]) -> dict[str, Any]:
    return {name: {"peak_control_V": run.metrics()["peak_input"]} for name, run in runs.items()}


# Tolerances --------------------------------------------------------------------------------------------
def figure_09(experiments: Experiments) -> PaperFigure:
    """The 90° step on plants sampled within Tables 1 and 2, coil included: link position as measured."""
    runs = experiments.sampled_plants
    diverged = sum(run.diverged_at is not None for run in runs)
    return PaperFigure(
        "09",
        "Step to 90° under the tolerances of Tables 1 and 2: link position as measured.",
        f"{len(runs)} plants sampled uniformly, with coil inductance; below, the rest of the 30 s enlarged, with the "
        f"measurement's noise on it. {f'{diverged} runs diverged and are not drawn.' if diverged else ''}",
        draw_sampled(runs, "output"),
        {"nonlinear": _ranges(runs)},
        (_worst_table(runs),),
    )


def figure_10(experiments: Experiments) -> PaperFigure:
    """The runs of Fig. 9, as estimated."""
    runs = experiments.sampled_plants
    whole = [run.metrics["estimation_rmse"] for run in runs if run.diverged_at is None]
    columns = np.array(whole).T if whole else np.zeros((0, 0))
    return PaperFigure(
        "10",
        "The runs of Figure 9 as estimated.",
        "The estimator believes in the nominal plant without coil."
        if experiments.setup.settings.estimator != "none"
        else "The true state is fed back, so they are the same.",
        draw_sampled(runs, "estimate"),
        {"nonlinear": {**_ranges(runs), "estimation_rmse": [_spread(column) for column in columns]}},
    )


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
        rows.append((name, m["overshoot_percent"], m["settling_time_s"], error, runs[k].changes))
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


# Disturbances ------------------------------------------------------------------------------------------
def figure_11(experiments: Experiments) -> PaperFigure:
    """A torque step at the link (the paper's figure) and, in a second run, at the motor."""
    return PaperFigure(
        "11",
        "Step to 90° with a step disturbance: link position, and its error from one second before the torque on.",
        f"A torque of {TORQUE:g} N·m from t = {LOAD_FROM:g} s on, at the link or at the motor. "
        "The paper gives neither size nor place.",
        draw_loads(experiments.step_disturbance),
        _load_numbers(experiments.step_disturbance),
    )


def figure_12(experiments: Experiments) -> PaperFigure:
    """A sinusoidal torque at the link (the paper's figure) and, in a second run, at the motor."""
    return PaperFigure(
        "12",
        "Step to 90° with a sinusoidal disturbance: link position, and its error from one second before the torque on.",
        f"A torque of {TORQUE:g} N·m at {FREQUENCY:g} Hz from t = {LOAD_FROM:g} s on, at the link or "
        "at the motor.",
        draw_loads(experiments.sine_disturbance),
        _load_numbers(experiments.sine_disturbance),
    )


def _load_numbers(runs: dict[str, Trajectory]) -> dict[str, Any]:
    return {
        "nonlinear": load_numbers(runs["link_torque"]),
        "nonlinear, torque at the motor": load_numbers(runs["motor_torque"]),
    }


#: In the order of the paper.
FIGURES: tuple[Callable[[Experiments], PaperFigure], ...] = (
    figure_03, figure_04, figure_05, figure_06, figure_07, figure_08, figure_09, figure_10, figure_11, figure_12,
)  # fmt: skip
