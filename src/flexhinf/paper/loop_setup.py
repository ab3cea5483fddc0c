"""The paper's arm, problem, laws, estimators and runs, each made once, the numbers read off the runs, and what a claim
is: its criterion is fixed first, its verdict is computed from it.

What the paper leaves open or misprints, and what was taken instead; the report states all of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.analysis import Population, corner_population
from flexhinf.errors import InfeasibleGamma
from flexhinf.estimation import ExtendedKalmanFilter, UnscentedKalmanFilter
from flexhinf.hinf import HJISolution, smallest_gamma, solve_hji
from flexhinf.loop import Controller, Loop, Sine, Step, Trajectory, load_metrics
from flexhinf.loop.signals.references import Signal, SignalLike
from flexhinf.loop.simulation.metrics import RunMetrics, peak_of
from flexhinf.paper.settings import PaperSettings
from flexhinf.plant import Estimator, GeneralisedPlant, Law, Penalty, Plant
from flexhinf.report import JudgedClaim, Table, Verdict
from flexhinf.robot import Robot, paper_arm

#: R2 of Eq. (11).
EFFORT = 10.0
#: P0 = 1e-4 I: the arm starts at rest, known to about half a degree.
INITIAL_VARIANCE = 1e-4
#: The paper's two commands, rad; that of Figs. 7 and 8, π + sin(πt/10).
GOALS, SINE = (math.pi / 2, math.pi), Sine(1.0, 1.0 / 20.0, offset=math.pi)
#: Length of a step response and of the tracking run (two periods of sin(πt/10)), s.
STEP_DURATION, TRACKING_DURATION = 8.0, 40.0
#: Tracking is judged after the start from rest has died out, s.
TRACKING_FROM = 10.0
#: Plants sampled uniformly within the tolerances: those of Figs. 9 and 10.
SAMPLED_PLANTS = 100
#: Length of a long run, s: a growth of 0.07/s makes a factor of 8 in it, and 1.7 in the 8 s of a step response.
LONG = 30.0
#: Samples kept of each run of Figs. 9 and 10, and samples that may be spent on a set of runs: 130 of 30 s at 1 kHz.
KEPT, SAMPLES = 1500, 4_000_000
#: The command of Figs. 11 and 12 comes after 2 s (Sec. 6); the disturbance once the step has settled.
COMMAND_AT, LOAD_FROM, LOAD_DURATION = 2.0, 6.0, 14.0
#: Size of the disturbance torque, N·m: a fifth of the largest gravity torque; and the frequency of the sinusoidal one,
#: Hz. The paper gives neither.
TORQUE, FREQUENCY = 2.0, 0.5
#: Where a torque can act; the paper does not say.
CHANNELS = ("link_torque", "motor_torque")
#: By the figure's number: command and length of the runs of both laws, and the torques on the loop at 90°.
COMMANDS: dict[str, tuple[Signal, float]] = {
    "03": (Step(math.pi), STEP_DURATION),
    "05": (Step(math.pi / 2), STEP_DURATION),
    "07": (SINE, TRACKING_DURATION),
}
LOADS: dict[str, Signal] = {"11": Step(TORQUE, at=LOAD_FROM), "12": Sine(TORQUE, FREQUENCY, at=LOAD_FROM)}


@dataclass(frozen=True)
class ToleranceRun:
    """A plant sampled within the tolerances, by its changes from the nominal plant in per cent, and what is kept of
    its run: metrics as `Trajectory.metrics`, when it diverged (s), and about `KEPT` samples of the link position as
    measured and as estimated, degrees."""

    metrics: RunMetrics
    diverged_at: float | None
    time: np.ndarray
    output: np.ndarray
    estimate: np.ndarray
    changes: str


class PaperSetup:
    """Problem, laws, estimators and runs of all figures and claims, each computed once, on first use.

    `nonlinear` is NL-H∞, the paper's law (degree as set), `linear` L-H∞, the same problem with degree 2; `model` the
    plant that the estimators believe in, nominal and without coil; `true_plants` are by whether they have a coil.

    Raises InfeasibleGamma: if γ is not above γ*.
    """

    def __init__(self, settings: PaperSettings) -> None:
        self.settings = settings
        self.arm: Robot = paper_arm()
        self.problem: GeneralisedPlant = self.arm.problem()
        self.gamma_star: float = smallest_gamma(self.problem)
        self.gamma: float = settings.gamma_ratio * self.gamma_star
        if self.gamma <= self.gamma_star:
            raise InfeasibleGamma(self.gamma, self.gamma_star)
        self.nonlinear, self.linear = (
            solve_hji(self.problem, gamma=self.gamma, degree=degree) for degree in (settings.degree, 2)
        )
        self.model: Plant = self.arm.plant()
        self.true_plants = {coil: self.arm.plant(inductance=coil) for coil in (False, True)}
        self._laws: dict[object, HJISolution] = {}
        self._runs: dict[str, dict[str, Trajectory]] = {}

    # Laws, estimators and plants --------------------------------------------------------------------------------
    def law(
        self,
        weights: Mapping[str, float] | None = None,
        *,
        degree: int | None = None,
        pose: float | None = None,
    ) -> HJISolution:
        """NL-H∞ at the settings' ratio of its own γ*; solved once each.

        `weights` by state stand for the paper's, R2 is kept; `degree` is that of V; `pose` the link position to
        expand about, rad (the hanging rest by default).
        """
        degree = self.settings.degree if degree is None else degree
        key = (None if weights is None else tuple(sorted(weights.items())), degree, pose)
        if key not in self._laws:
            problem = self.arm.problem(None if weights is None else Penalty(weights, effort=EFFORT), pose)
            self._laws[key] = solve_hji(
                problem, gamma=self.settings.gamma_ratio * smallest_gamma(problem), degree=degree
            )
        return self._laws[key]

    def estimator(
        self,
        kind: str | None = None,
        mean: ArrayLike | None = None,
        covariance: ArrayLike = INITIAL_VARIANCE,
        **options: Any,
    ) -> Estimator | None:
        """An estimator of this kind (the settings' by default) from rest or another mean; None for "none".

        It has the covariance form, the paper's.
        """
        s, kind = self.settings, self.settings.estimator if kind is None else kind
        if kind == "none":
            return None
        mean = np.zeros(self.model.n) if mean is None else mean
        return (UnscentedKalmanFilter if kind == "ukf" else ExtendedKalmanFilter)(
            self.model,
            s.period,
            s.process_noise,
            s.measurement_noise,
            mean,
            covariance,
            form="covariance",
            **options,
        )

    def seed(self, k: int) -> int:
        """Seed of the k-th of several runs (k < 1000): no two settings share one."""
        return 1000 * self.settings.seed + k

    @cached_property
    def population(self) -> Population:
        """Plants within Tables 1 and 2: sampled ones, all 2048 corners, each tolerance alone, and the nominal one."""
        arm, count = self.arm, len(self.arm.uncertain)
        return corner_population(arm.corner, count, 2**count, self.settings.seed, arm.draw, SAMPLED_PLANTS)

    @cached_property
    def population_vectors(self) -> np.ndarray:
        """Parameters (N, q) of the true plants with coil, of the whole population."""
        table = self.true_plants[True].parameters
        return table.vectors([table.known(values) for values in self.population.values])

    # Runs -------------------------------------------------------------------------------------------------------
    def loop(
        self, law: Law, inductance: bool = False, estimator: Estimator | str | None = "settings"
    ) -> Loop:
        """A loop around the true plant; "settings" is the estimator of the settings."""
        estimator = self.estimator() if isinstance(estimator, str) else estimator
        return Loop(self.true_plants[inductance], Controller(law, estimator, self.settings.period, latency=0))

    def deviation(self, loop: Loop) -> float | None:
        """Standard deviation of the simulated measurement noise, rad; None where the true state is fed back."""
        return None if loop.controller.estimator is None else math.sqrt(self.settings.measurement_noise)

    def run(
        self,
        law: Law,
        reference: SignalLike,
        duration: float,
        *,
        inductance: bool = False,
        disturbance: SignalLike = None,
        estimator: Estimator | str | None = "settings",
        noise: bool = True,
        seed: int | None = None,
    ) -> Trajectory:
        """Simulate one closed loop from the hanging rest; a run that diverges says so in its status."""
        loop = self.loop(law, inductance, estimator)
        seed = self.settings.seed if seed is None else seed
        return loop.run(reference, disturbance, self.deviation(loop) if noise else None, duration, None, seed)

    def runs(self, figure: str) -> dict[str, Trajectory]:
        """Runs of Figs. 3, 5, 7 ("03" …) by the name of the law, and of 11 and 12 by where the torque acts."""
        if figure not in self._runs:
            laws = {"nonlinear": self.nonlinear, "linear": self.linear}
            self._runs[figure] = (
                {name: self.run(law, *COMMANDS[figure]) for name, law in laws.items()}
                if figure in COMMANDS
                else {c: self.load_response(self.nonlinear, LOADS[figure], c) for c in CHANNELS}
            )
        return self._runs[figure]

    @cached_property
    def sampled_plants(self) -> list[ToleranceRun]:
        """Runs of Figs. 9 and 10: plants sampled uniformly within Tables 1 and 2, coil included, 90° step."""
        population, period, plants = self.population, self.settings.period, range(SAMPLED_PLANTS)
        kept = np.arange(0, round(LONG / period) + 1, max(1, round(LONG / period / KEPT)))
        names, loop = ("output.link_position", "estimate.link_position"), self.loop(self.nonlinear, True)
        batch = loop.ensemble(
            Step(math.pi / 2), None, self.deviation(loop), LONG, kept=names, instants=kept
        ).run([dict(population.values[k]) for k in plants], [self.seed(k) for k in plants])
        runs: list[ToleranceRun] = []
        for k in plants:
            whole = ~np.isnan(batch.kept[k]).any(axis=1)
            diverged_at = None if batch.completed[k] else float(batch.diverged_at[k])
            time, (output, estimate) = period * kept[whole], np.degrees(batch.kept[k, whole].T)
            runs.append(
                ToleranceRun(batch.metrics_of(k), diverged_at, time, output, estimate, population.describe(k))
            )
        return runs

    def load_response(
        self,
        law: Law,
        signal: Signal,
        channel: str = "link_torque",
        estimator: Estimator | str | None = "settings",
    ) -> Trajectory:
        """Simulate a command of 90° after 2 s, and then a disturbance torque."""
        return self.run(
            law,
            Step(math.pi / 2, at=COMMAND_AT),
            LOAD_DURATION,
            disturbance={channel: signal},
            estimator=estimator,
        )


# Numbers of a run, named as in metrics.json ------------------------------------------------------------
def tracking_numbers(run: Trajectory) -> dict[str, float | None]:
    """RMS error over the run, and the largest error after the start from rest."""
    if run.diverged_at is not None:
        return {"tracking_rmse_rad": None, "largest_error_rad": None, "diverged_at_s": run.diverged_at}
    error = run.tracked("link_position") - run.signals["reference"][:, 0]
    return {
        "tracking_rmse_rad": run.metrics()["tracking_rmse"],
        "largest_error_rad": float(peak_of(error[run.time >= TRACKING_FROM])),
    }


def load_numbers(run: Trajectory) -> dict[str, float | None]:
    """Peak deviation from the command and time of recovery (±2 % of the step) after the disturbance started."""
    if run.diverged_at is not None:
        return {"peak_deviation_rad": None, "recovery_time_s": None, "diverged_at_s": run.diverged_at}
    goal = float(run.signals["reference"][-1, 0])
    m = load_metrics(run.time, run.tracked("link_position"), command=goal, step=goal, start=LOAD_FROM)
    return {"peak_deviation_rad": m["peak_deviation"], "recovery_time_s": m["recovery_time_s"]}


def _step_numbers(run: Trajectory) -> dict[str, object]:
    m = run.metrics()
    return {
        **{key: m[key] for key in ("overshoot_percent", "settling_time_s", "rise_time_s")},
        "steady_state_error_rad": m["steady_state_error"],
        "peak_control_V": m["peak_input"],
        "estimation_rmse": m["estimation_rmse"],
        **({} if run.diverged_at is None else {"diverged_at_s": run.diverged_at}),
    }


def _spread(values: Iterable[float | None]) -> list[float | None]:
    """[smallest, median, largest] of the values that are numbers."""
    numbers = [float(value) for value in values if value is not None]
    return [min(numbers), float(np.median(numbers)), max(numbers)] if numbers else [None, None, None]


#: By the figure's number in the paper: whose runs, and what is read off each; of Figs. 9 and 10 off all plants.
_READ: dict[str, tuple[str, Callable[[Trajectory], Mapping[str, object]]]] = {
    "03": ("03", _step_numbers),
    "05": ("05", _step_numbers),
    "07": ("07", tracking_numbers),
    **{
        figure: (runs, lambda run: {"peak_control_V": run.metrics()["peak_input"]})
        for figure, runs in (("04", "03"), ("06", "05"), ("08", "07"))
    },
    "11": ("11", load_numbers),
    "12": ("12", load_numbers),
}

#: The paper's figures of runs.
FIGURE_NUMBERS = tuple(f"{number:02d}" for number in range(3, 13))


def figure_numbers(setup: PaperSetup, figure: str) -> dict[str, Mapping[str, object]]:
    """Metrics of a figure's runs, by law and by where a torque acts.

    Of Figs. 9 and 10 [smallest, median, largest] over the plants; how many did not settle; in Fig. 10 the RMS error of
    each estimated state too.
    """
    if figure in _READ:
        names = {"link_torque": "nonlinear", "motor_torque": "nonlinear, torque at the motor"}
        runs, numbers = _READ[figure]
        return {names.get(name, name): numbers(run) for name, run in setup.runs(runs).items()}
    plants = setup.sampled_plants
    metrics, whole = [run.metrics for run in plants], [run for run in plants if run.diverged_at is None]
    errors = zip(*(run.metrics["estimation_rmse"] for run in whole), strict=True)
    estimated = {"estimation_rmse": [_spread(state) for state in errors]}
    numbers = {
        "plants": len(plants),
        "overshoot_percent": _spread(m["overshoot_percent"] for m in metrics),
        "settling_time_s": _spread(m["settling_time_s"] for m in metrics),
        "steady_state_error_rad": _spread(m["steady_state_error"] for m in metrics),
        "unsettled": sum(m["settling_time_s"] is None for m in metrics),
        "diverged": len(plants) - len(whole),
    }
    return {"nonlinear": {**numbers, **(estimated if figure == "10" else {})}}


def known(value: float) -> float | None:
    """The value, or None for one that is not finite."""
    return float(value) if math.isfinite(value) else None


# Many runs -----------------------------------------------------------------------------------------------
def name_goal(goal: float) -> str:
    """A goal (rad) as text: ``90°``."""
    return f"{math.degrees(goal):.0f}°"


def affordable(wanted: int, period: float, duration: float = LONG) -> int:
    """Number of runs to make: `wanted`, or fewer if the period is far below 1 ms."""
    return max(1, min(wanted, int(SAMPLES * period / duration)))


# Claims --------------------------------------------------------------------------------------------------
class ClaimFinding(NamedTuple):
    """Result of computing one claim's criterion: whether it is met ("ties" or "not judged" where it cannot be said),
    the numbers behind that in a sentence, a table, numbers for ``metrics.json``, what the page draws, and whether it is
    met for each step alone."""

    verdict: bool | Verdict
    evidence: str
    table: Table | None = None
    numbers: Mapping[str, object] = MappingProxyType({})
    data: object = None
    steps: Mapping[str, bool] = MappingProxyType({})


class StatedClaim(NamedTuple):
    """A claim of the paper, or a question of ours, and what it is judged by."""

    id: str
    text: str  # one sentence; ``{feedback}`` stands for what is fed back to the law
    criterion: str
    compute: Callable[[PaperSetup], ClaimFinding]
    figures: tuple[str, ...] = ()  # anchors of the paper's figures that show it


_VERDICTS: dict[bool, Verdict] = {True: "holds", False: "fails"}


def judge(setup: PaperSetup, stated: StatedClaim) -> JudgedClaim:
    """Compute the criterion of a claim, and return the claim with its verdict."""
    verdict, evidence, table, numbers, data, steps = stated.compute(setup)
    if not isinstance(verdict, str):
        verdict = _VERDICTS[verdict]
    parts: dict[str, Verdict] = {step: _VERDICTS[met] for step, met in steps.items()}
    kind, tables = setup.settings.estimator, () if table is None else (table,)
    text = stated.text.format(feedback="the true state" if kind == "none" else f"the {kind.upper()}")
    return JudgedClaim(
        stated.id, text, verdict, evidence, stated.figures, stated.criterion, tables, numbers, data, parts
    )
