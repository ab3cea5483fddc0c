"""The runs behind Figs. 3–12, each made once, and the numbers read off them, as in metrics.json."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.loop import Sine, Step, Trajectory, load_metrics
from flexhinf.paper.loop_setup import GOALS, SAMPLED_PLANTS, PaperSetup
from flexhinf.plant import Law

#: Length of a step response, s.
STEP_DURATION = 8.0
#: Length of the tracking run: two periods of sin(πt/10), s.
TRACKING_DURATION = 40.0
#: Tracking is judged after the start from rest has died out, s.
TRACKING_FROM = 10.0
#: Length of the runs under tolerances, s; slow growth does not show in 8 s.
TOLERANCE_DURATION = 30.0
#: Samples kept of each of these runs.
SAMPLES = 1500
#: The command of Figs. 11 and 12 comes after 2 s (Sec. 6); the disturbance once the step has settled.
COMMAND_AT, LOAD_FROM, LOAD_DURATION = 2.0, 6.0, 14.0
#: Size of the disturbance torque, N·m: a fifth of the largest gravity torque. The paper gives none.
TORQUE = 2.0
#: Frequency of the sinusoidal disturbance, Hz. The paper gives none.
FREQUENCY = 0.5
#: The command of Figs. 7 and 8, π + sin(πt/10).
SINE = Sine(1.0, 1.0 / 20.0, offset=math.pi)
#: Where a torque can act; the paper does not say.
CHANNELS = ("link_torque", "motor_torque")


@dataclass(frozen=True)
class ToleranceRun:
    """A plant sampled within the tolerances, and what is kept of its run.

    Attributes
    ----------
    metrics : dict
        Of the whole run, as `Trajectory.metrics`.
    diverged_at : float or None
        s.
    time, output, estimate : ndarray
        About `SAMPLES` samples of the link position as measured and as estimated, degrees.
    changes : str
        From the nominal plant, in per cent.
    """

    metrics: dict[str, Any]
    diverged_at: float | None
    time: np.ndarray
    output: np.ndarray
    estimate: np.ndarray
    changes: str


class Experiments:
    """Runs of the laws by name: "nonlinear" (the paper's) and "linear"."""

    def __init__(self, setup: PaperSetup) -> None:
        self.setup = setup

    def _both(self, reference: Any, duration: float) -> dict[str, Trajectory]:
        laws = {"nonlinear": self.setup.nonlinear, "linear": self.setup.linear}
        return {name: self.setup.run(law, reference, duration) for name, law in laws.items()}

    @cached_property
    def step_180(self) -> dict[str, Trajectory]:
        """Figs. 3 and 4."""
        return self._both(Step(math.pi), STEP_DURATION)

    @cached_property
    def step_90(self) -> dict[str, Trajectory]:
        """Figs. 5 and 6."""
        return self._both(Step(math.pi / 2), STEP_DURATION)

    @cached_property
    def about_goal(self) -> dict[tuple[float, str, str], Trajectory]:
        """Steps by laws about the hanging rest and about the goal, by goal (rad), pose and name of the law."""
        setup, found = self.setup, {}
        for goal in GOALS:
            for about, pose in (("the hanging rest", 0.0), ("the goal", goal)):
                for name, degree in (("nonlinear", setup.settings.degree), ("linear", 2)):
                    law = setup.law(degree=degree, pose=pose)
                    found[goal, about, name] = setup.deployed_step(law, goal, STEP_DURATION)
        return found

    @cached_property
    def tracking(self) -> dict[str, Trajectory]:
        """Figs. 7 and 8: π + sin(πt/10)."""
        return self._both(SINE, TRACKING_DURATION)

    def track(self, law: Law) -> Trajectory:
        """Follow π + sin(πt/10) from the hanging rest."""
        return self.setup.run(law, SINE, TRACKING_DURATION)

    @cached_property
    def sampled_plants(self) -> list[ToleranceRun]:
        """Figs. 9 and 10: plants sampled uniformly within Tables 1 and 2, coil included, 90° step."""
        setup, period = self.setup, self.setup.settings.period
        population, stride = setup.population, max(1, round(TOLERANCE_DURATION / period / SAMPLES))
        kept = np.arange(0, round(TOLERANCE_DURATION / period) + 1, stride)
        names, plants = ("output.link_position", "estimate.link_position"), range(SAMPLED_PLANTS)
        ensemble = setup.ensemble(
            setup.nonlinear, Step(math.pi / 2), TOLERANCE_DURATION, inductance=True, kept=names, instants=kept
        )
        found = ensemble.run([dict(population.values[k]) for k in plants], [setup.seed(k) for k in plants])
        runs = []
        for k in plants:
            whole = ~np.isnan(found.kept[k]).any(axis=1)
            diverged_at = None if found.completed[k] else float(found.diverged_at[k])
            output, estimate = np.degrees(found.kept[k, whole].T)
            metrics, changes = found.metrics_of(k), population.describe(k)
            runs.append(ToleranceRun(metrics, diverged_at, period * kept[whole], output, estimate, changes))
        return runs

    def load_response(
        self, law: Law, signal: Any, channel: str = "link_torque", estimator: Any = "settings"
    ) -> Trajectory:
        """90° commanded after 2 s, then a disturbance torque."""
        command = Step(math.pi / 2, at=COMMAND_AT)
        return self.setup.run(law, command, LOAD_DURATION, disturbance={channel: signal}, estimator=estimator)

    def _loads(self, signal: Any) -> dict[str, Trajectory]:
        return {c: self.load_response(self.setup.nonlinear, signal, c) for c in CHANNELS}

    @cached_property
    def step_disturbance(self) -> dict[str, Trajectory]:
        """Fig. 11, by channel."""
        return self._loads(Step(TORQUE, at=LOAD_FROM))

    @cached_property
    def sine_disturbance(self) -> dict[str, Trajectory]:
        """Fig. 12, by channel."""
        return self._loads(Sine(TORQUE, FREQUENCY, at=LOAD_FROM))


# Numbers of a run, named as in metrics.json ------------------------------------------------------------
def step_numbers(run: Trajectory) -> dict[str, Any]:
    """Numbers of a step response."""
    m = run.metrics()
    return {
        "overshoot_percent": m["overshoot_percent"],
        "settling_time_s": m["settling_time_s"],
        "rise_time_s": m["rise_time_s"],
        "steady_state_error_rad": m["steady_state_error"],
        "peak_control_V": m["peak_input"],
        "estimation_rmse": m["estimation_rmse"],
        **({} if run.diverged_at is None else {"diverged_at_s": run.diverged_at}),
    }


def tracking_numbers(run: Trajectory) -> dict[str, Any]:
    """RMS error over the run, and the largest error after the start from rest."""
    if run.diverged_at is not None:
        return {"tracking_rmse_rad": None, "largest_error_rad": None, "diverged_at_s": run.diverged_at}
    error = run.tracked("link_position") - run.signals["reference"][:, 0]
    late = np.abs(error[run.time >= TRACKING_FROM])
    return {"tracking_rmse_rad": run.metrics()["tracking_rmse"], "largest_error_rad": float(late.max())}


def load_numbers(run: Trajectory) -> dict[str, Any]:
    """Peak deviation from the command and time of recovery (±2 % of the step) after the disturbance started."""
    if run.diverged_at is not None:
        return {"peak_deviation_rad": None, "recovery_time_s": None, "diverged_at_s": run.diverged_at}
    goal = float(run.signals["reference"][-1, 0])
    m = load_metrics(run.time, run.tracked("link_position"), command=goal, step=goal, start=LOAD_FROM)
    return {"peak_deviation_rad": m["peak_deviation"], "recovery_time_s": m["recovery_time_s"]}


def peak_numbers(run: Trajectory) -> dict[str, Any]:
    """Largest voltage."""
    return {"peak_control_V": run.metrics()["peak_input"]}


def tolerance_numbers(runs: Sequence[ToleranceRun]) -> dict[str, Any]:
    """[smallest, median, largest] over the plants, and how many did not settle (or diverged)."""
    metrics = [run.metrics for run in runs]
    return {
        "plants": len(runs),
        "overshoot_percent": _spread(m["overshoot_percent"] for m in metrics),
        "settling_time_s": _spread(m["settling_time_s"] for m in metrics),
        "steady_state_error_rad": _spread(m["steady_state_error"] for m in metrics),
        "unsettled": sum(m["settling_time_s"] is None for m in metrics),
        "diverged": sum(run.diverged_at is not None for run in runs),
    }


def estimation_numbers(runs: Sequence[ToleranceRun]) -> dict[str, Any]:
    """The same, with the RMS error of each estimated state."""
    errors = [run.metrics["estimation_rmse"] for run in runs if run.diverged_at is None]
    return {
        **tolerance_numbers(runs),
        "estimation_rmse": [_spread(state) for state in zip(*errors, strict=True)],
    }


def _spread(values: Iterable[float | None]) -> list[float | None]:
    """[smallest, median, largest] of the numbers among the values."""
    numbers = [float(value) for value in values if value is not None]
    return [min(numbers), float(np.median(numbers)), max(numbers)] if numbers else [None, None, None]


def _each(
    numbers: Callable[[Trajectory], dict[str, Any]], runs: Mapping[str, Trajectory]
) -> dict[str, dict[str, Any]]:
    names = {"link_torque": "nonlinear", "motor_torque": "nonlinear, torque at the motor"}
    return {names.get(name, name): numbers(run) for name, run in runs.items()}


#: By the figure's number in the paper, from the runs.
FIGURE_NUMBERS: dict[str, Callable[[Experiments], dict[str, Any]]] = {
    "03": lambda e: _each(step_numbers, e.step_180),
    "04": lambda e: _each(peak_numbers, e.step_180),
    "05": lambda e: _each(step_numbers, e.step_90),
    "06": lambda e: _each(peak_numbers, e.step_90),
    "07": lambda e: _each(tracking_numbers, e.tracking),
    "08": lambda e: _each(peak_numbers, e.tracking),
    "09": lambda e: {"nonlinear": tolerance_numbers(e.sampled_plants)},
    "10": lambda e: {"nonlinear": estimation_numbers(e.sampled_plants)},
    "11": lambda e: _each(load_numbers, e.step_disturbance),
    "12": lambda e: _each(load_numbers, e.sine_disturbance),
}
