"""The UKF estimates better than the EKF.

Both filters run on the same data with the same model, noises and start, the EKF with the exact Jacobian of the
sampled model: at the period of the settings, at 10 and at 50 ms, with a stiffness error of 12 % and with a large
initial error, the link position measured as in the paper. Each run gives one number per filter: its RMS error,
each state relative to the EKF's RMS error of that state over all runs. Criterion, on the paired difference of
these: "better" in a trial needs a 95 % interval without 0 and a mean difference of at least 1 %; the claim holds
if the UKF is better in all trials, fails if it is worse in one, and else ties. Other sensors are shown beside it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.loop import Step
from flexhinf.paper.claims.judgement import NOT_BY_THE_PENALTY, Judged
from flexhinf.paper.filter_trials import Scores, Trial, run_trial
from flexhinf.paper.loop_setup import INITIAL_VARIANCE, PaperSetup, affordable
from flexhinf.plant import Plant
from flexhinf.report import Claim, Column, Paragraph, Table, number

TEXT = "The UKF estimates the arm's state better than the EKF."

#: Length of a trial, s, and how many runs; a difference below MATTERS (relative) is a tie whatever its interval.
DURATION, RUNS, MATTERS = 4.0, 200, 0.01

#: Pairs of closed loops with the same noise.
LOOPS = 10

CRITERION = (
    f"In {DURATION:g} s of matched noises with the link position measured, up to {RUNS} pairs in each trial, the RMS "
    "error of the states is smaller with the UKF in every trial: by more than the 95 % confidence interval of the "
    f"paired difference, and by more than {100 * MATTERS:g} %. Otherwise they tie."
)

REASON = (
    "With the link position measured, sin x1 is the arm's only nonlinearity and a function of what is measured: "
    "the spread of x1 is always small, and over it the sine is straight. So both filters compute the same."
)


@dataclass(frozen=True)
class Paired:
    """A trial's outcome.

    Attributes
    ----------
    difference, half : float
        Mean of the paired relative difference (UKF − EKF) and half its 95 % interval; NaN with fewer than two pairs.
    bias : pair of float
        Largest |mean error| over the RMS error, UKF's and EKF's.
    nees : pair of float
    pairs : int
        In which neither filter failed.
    """

    trial: Trial
    difference: float
    half: float
    bias: tuple[float, float]
    nees: tuple[float, float]
    pairs: int

    @property
    def verdict(self) -> str:
        """better, worse or tie; unknown without pairs."""
        if not math.isfinite(self.difference):
            return "unknown"
        if abs(self.difference) <= self.half or abs(self.difference) < MATTERS:
            return "tie"
        return "better" if self.difference < 0.0 else "worse"


def judge(setup: PaperSetup) -> Judged:
    """ukf-better-than-ekf."""
    own = [_paired(setup, trial) for trial in _trials(setup)]
    others = [_paired(setup, trial) for trial in _other_sensors(setup)]
    verdicts = {p.verdict for p in own}
    if "worse" in verdicts:
        verdict = "fails"
    elif verdicts == {"better"}:
        verdict = "holds"
    else:
        verdict = "not judged" if verdicts == {"unknown"} else "ties"
    known = [p for p in own if p.verdict != "unknown"]
    largest = max((abs(p.difference) for p in known), default=math.nan)
    wins = [p for p in others if p.verdict == "better"]
    evidence = (
        f"With the link position measured the RMS errors differ by at most {number(100 * largest, 1)} %. "
        f"{_loops(setup)} "
        + (
            f"The UKF wins with other sensors: {'; '.join(_win(p) for p in wins)}."
            if wins
            else "The UKF wins with no other sensor tried."
        )
    )
    claim = Claim(
        "ukf-better-than-ekf",
        TEXT,
        verdict,
        evidence,
        repair="" if verdict != "fails" else NOT_BY_THE_PENALTY,
        figures=("table-ukf-ekf",),
        criterion=CRITERION,
    )
    numbers = {
        "largest_difference": _known(largest),
        "trials": {
            p.trial.name: [_known(v) for v in (p.difference, p.half, *p.nees)] for p in (*own, *others)
        },
    }
    return Judged(claim, (_table((*own, *others)), Paragraph(REASON)), numbers)


# Trials --------------------------------------------------------------------------------------------
def _trials(setup: PaperSetup) -> list[Trial]:
    """The link position measured."""
    s, model = setup.settings, setup.model
    q, r, near = s.process_noise, (s.measurement_noise,), (math.sqrt(INITIAL_VARIANCE),) * model.n
    stiff = {"stiffness": setup.arm["stiffness"].interval[1]}
    found = [
        Trial(f"{1e3 * t:g} ms", model, t, q, r, near, {}) for t in dict.fromkeys((s.period, 0.01, 0.05))
    ]
    found.append(Trial("10 ms, stiffness +12 %", model, 0.01, q, r, near, stiff))
    found.append(Trial("10 ms, start off by 30°, 1 rad/s", model, 0.01, q, r, (0.5, 1.0, 0.5, 1.0), {}))
    return found


def _other_sensors(setup: PaperSetup) -> list[Trial]:
    """Sensors of which sin x1 is no function, far start."""
    s, model, far = setup.settings, setup.model, (0.5, 1.0, 0.5, 1.0)
    motor = setup.arm.plant(measured=("motor_position",))
    imu = Plant(
        model.flow,
        _imu,
        states=model.states,
        inputs=model.inputs,
        disturbances=model.disturbances,
        parameters=model.parameters,
        outputs=("tangential_acceleration", "radial_acceleration", "angular_rate"),
    )
    q = s.process_noise
    return [
        Trial("motor position, 10 ms, start off by 30°", motor, 0.01, q, (s.measurement_noise,), far, {}),
        Trial("IMU on the link, 10 ms, start off by 17°", imu, 0.01, q, (1e-2, 1e-2, 1e-4), (0.3,) * 4, {}),
    ]


def _imu(x: Any, u: Any, p: Any) -> Any:
    """What an inertial sensor at the link's end feels: specific force along and across the link, rate of turn."""
    torque = -p.mass * p.gravity * p.length * np.sin(x[0]) - p.stiffness * (x[0] - x[2])
    tangential = p.length * torque / p.link_inertia + p.gravity * np.sin(x[0])
    return np.array([tangential, p.length * x[1] ** 2 + p.gravity * np.cos(x[0]), x[1]])


def _paired(setup: PaperSetup, trial: Trial) -> Paired:
    """Run a trial: the voltage of the 180° step with the true state fed back, to every plant of the trial."""
    run = setup.run(setup.nonlinear, Step(math.pi), DURATION, estimator=None)
    times = np.arange(max(2, round(DURATION / trial.period))) * trial.period
    volts = np.interp(times, run.time, run.signals["input"][:, 0])
    volts = np.clip(np.nan_to_num(volts), -100.0, 100.0)  # of a step that diverged
    runs = affordable(RUNS, trial.period, DURATION)
    return _compare(trial, *run_trial(trial, volts[:, None], runs, setup.settings.seed))


def _compare(trial: Trial, ukf: Scores, ekf: Scores) -> Paired:
    kept = np.isfinite(ukf.squared).all(axis=1) & np.isfinite(ekf.squared).all(axis=1)
    pairs = int(kept.sum())
    if pairs < 2:
        unknown = (math.nan, math.nan)
        return Paired(trial, math.nan, math.nan, unknown, unknown, pairs)
    scale = np.sqrt(ekf.squared[kept].mean(axis=0))
    scores = [np.sqrt((s.squared[kept] / scale**2).mean(axis=1)) for s in (ukf, ekf)]
    gap = scores[0] - scores[1]
    half = 1.96 * float(gap.std(ddof=1)) / math.sqrt(pairs)
    bias = [float(np.abs(s.mean[kept].mean(axis=0) / scale).max()) for s in (ukf, ekf)]
    nees = [float(s.nees[kept].mean()) for s in (ukf, ekf)]
    return Paired(trial, float(gap.mean()), half, (bias[0], bias[1]), (nees[0], nees[1]), pairs)


# Words and table -----------------------------------------------------------------------------------
def _interval(p: Paired) -> str:
    if p.verdict == "unknown":
        return "unknown"
    return f"{100 * p.difference:+.1g} ± {100 * p.half:.1g} %"


def _win(p: Paired) -> str:
    return (
        f"{p.trial.name} ({_interval(p)}, NEES {p.nees[0]:.1f} against {p.nees[1]:.1f} of {p.trial.model.n})"
    )


def _loops(setup: PaperSetup) -> str:
    """How far the closed loops of the two filters differ, with the same noise."""
    count, gaps, diverged = affordable(LOOPS, setup.settings.period), [], 0
    for k in range(count):
        runs = []
        for kind in ("ukf", "ekf"):
            estimator = setup.estimator(kind)
            runs.append(
                setup.run(setup.nonlinear, Step(math.pi), 8.0, estimator=estimator, seed=setup.seed(k))
            )
        if any(r.diverged_at is not None for r in runs):
            diverged += 1
            continue
        positions = [r.signal("state", "link_position") for r in runs]
        gaps.append(float(np.degrees(np.abs(positions[0] - positions[1]).max())))
    if not gaps:
        return f"Closed loops: all {count} pairs diverged."
    largest = number(max(gaps), 1)
    return f"In {len(gaps)} pairs of closed loops (180° step, same noise) the link differs by at most {largest}°."


def _table(found: Sequence[Paired]) -> Table:
    rows = [
        (
            p.trial.name,
            p.pairs,
            *(_known(100.0 * v) for v in (p.difference, p.half)),
            *(_known(v) for v in (*p.bias, *p.nees)),
            p.verdict,
        )
        for p in found
    ]
    columns = (
        "trial",
        "pairs",
        Column("UKF − EKF", "% of RMS error"),
        Column("± (95 %)", "%"),
        Column("bias UKF", "of RMS", 3),
        Column("bias EKF", "of RMS", 3),
        Column("NEES UKF", "", 2),
        Column("NEES EKF", "", 2),
        "UKF is",
    )
    caption = (
        "UKF against an EKF with exact Jacobians on the same data, matched noises, open loop on the voltage of the "
        "180° step; the link position measured unless another sensor is named. NEES of a right covariance is 4."
    )
    return Table(columns, rows, caption, "table-ukf-ekf")


def _known(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
