"""How consistent unscented and extended filters are on the paper's arm, and who estimates better.

NEES is eᵀ P⁻¹ e after a correction [barshalom2001, section 5.4]. Where a filter's covariance is right, its sum over 200
runs is χ² with 200 n degrees of freedom: of 20 sets of 200 runs 19 are to be expected within the 95 % band at the last
sample. Both filters see the same data: the truth moves by the filters' own F and noises, along the voltage of a 180°
step. A difference of RMS errors is a tie where its 95 % interval contains 0, or where it is below 1 %.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import fields
from typing import Any

import numpy as np
from scipy.stats import chi2

from flexhinf.loop import Step
from flexhinf.paper.estimators import (
    DURATION,
    RUNS,
    FilterTrial,
    Scores,
    driving,
    inertial_plant,
    outcome_of,
    run_trial,
)
from flexhinf.paper.loop_setup import PaperSetup
from flexhinf.paper.settings import PaperSettings

#: Periods, s; standard deviation of the true start, rad and rad/s; sets of runs.
PERIODS, START, SETS = (1e-3, 1e-2, 5e-2), 1e-2, 20

#: Of the stiffness that is estimated, in parts of it.
UNKNOWN_STIFFNESS = 0.3


def trials(setup: PaperSetup) -> Iterator[FilterTrial]:
    """All cases, with filters of the default form."""
    s, model, stiff = setup.settings, setup.model, setup.arm["stiffness"]
    q, r, form = s.process_noise, (s.measurement_noise,), "square_root"
    for name, changes in (("", {}), (", stiffness 12 % larger", {"stiffness": stiff.interval[1]})):
        for period in PERIODS:
            title = f"link position, {1e3 * period:g} ms{name}"
            yield FilterTrial(title, model, period, q, r, (START,) * 4, changes, form=form)
    imu = inertial_plant(model)
    yield FilterTrial(
        "IMU on the link alone, 10 ms, start unknown by 0.3",
        imu,
        0.01,
        q,
        (1e-2, 1e-2, 1e-4),
        (0.3,) * 4,
        {},
        form=form,
    )
    augmented = model.augmented(parameters=("stiffness",))
    for start in (START, 0.3):
        yield FilterTrial(
            f"link position, 10 ms, start unknown by {start:g}, stiffness estimated and unknown by 30 %", augmented,
            0.01,
            (q, q, q, q, 0.0), r, (start,) * 4 + (UNKNOWN_STIFFNESS * stiff.value,), {},
            (0.0,) * 4 + (stiff.value,), form,
        )  # fmt: skip


def within(nees: np.ndarray, n: int) -> bool:
    """Whether the sum of the NEES (R,) of R runs is within the 95 % interval of χ²."""
    low, high = chi2.ppf((0.025, 0.975), len(nees) * n)
    return bool(low < nees.sum() < high)


def row_of(setup: PaperSetup, trial: FilterTrial, step: Any, sets: int = SETS) -> dict[str, Any]:
    """A row of the table."""
    volts, n = driving(step, trial.period), trial.model.n
    both = [run_trial(trial, volts, RUNS, seed) for seed in range(sets)]
    ukf, ekf = (_joined([scores[k] for scores in both]) for k in (0, 1))
    found = outcome_of(ukf, ekf)
    return {
        "case": trial.name, "states": n, "pairs": found.pairs, "nees": found.nees,
        "within": [sum(within(scores[k].nees_of_samples[:, -1], n) for scores in both) for k in (0, 1)],
        "difference_percent": 100.0 * found.difference, "half_percent": 100.0 * found.half, "bias": found.bias,
        "rmse": [np.sqrt(score.squared.mean(axis=0)).tolist() for score in (ukf, ekf)], "verdict": found.verdict,
    }  # fmt: skip


def _joined(scores: Sequence[Scores]) -> Scores:
    return Scores(*(np.concatenate([getattr(s, f.name) for s in scores]) for f in fields(Scores)))


def counted() -> dict[str, Any]:
    """Rows of the table."""
    setup = PaperSetup(PaperSettings())
    step = setup.run(setup.nonlinear, Step(np.pi), DURATION, estimator=None)
    rows = []
    for trial in trials(setup):
        rows.append(row_of(setup, trial, step))
        print(rows[-1], flush=True)
    return {"runs": RUNS, "sets": SETS, "seconds": DURATION, "rows": rows}


def table(found: dict[str, Any]) -> str:
    """The table of ``docs/estimators_accuracy.md``."""
    lines = [
        "| case | NEES of unscented, extended (right: number of states) | sets of 20 within the 95 % band | "
        "RMS error, unscented − extended | verdict on the unscented filter |",
        "|---|---|---|---|---|",
    ]
    for row in found["rows"]:
        nees, inside = (
            ", ".join(f"{v:.3g}" for v in row["nees"]),
            ", ".join(map(str, row["within"])),
        )
        gap = f"{row['difference_percent']:+.2g} ± {row['half_percent']:.1g} %"
        cells = (row["case"], f"{nees} ({row['states']})", inside, gap, row["verdict"])
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(
        [*lines, "", f"{found['sets']} sets of {found['runs']} runs of {found['seconds']:g} s in each case."]
    )
