"""The UKF reconstructs the four states from the link position alone."""

from __future__ import annotations

import math

import numpy as np

from flexhinf.loop import Step
from flexhinf.paper.claims.judgement import NOT_BY_THE_PENALTY, Judged
from flexhinf.paper.experiments import STEP_DURATION, Experiments
from flexhinf.report import Claim, Column, Table, number

__all__ = ["judge_reconstruction"]

TEXT = "The UKF reconstructs the four states from the link position alone."
CRITERION = (
    "On the nominal 180° step, from an initial estimate 5° off at link and motor, each state's RMS error after the "
    "first second is below 2 % of that state's range in the run."
)

WRONG = math.radians(5.0)
FRACTION = 0.02
FROM = 1.0


def judge_reconstruction(experiments: Experiments) -> Judged:
    """ukf-reconstructs."""
    setup = experiments.setup
    start = np.array([WRONG, 0.0, WRONG, 0.0])
    ukf = setup.estimator("ukf", mean=start, covariance=np.array([WRONG**2, 0.1, WRONG**2, 0.1]))
    run = setup.run(setup.nonlinear, Step(math.pi), STEP_DURATION, estimator=ukf)
    if run.diverged_at is not None:
        evidence = f"The loop diverged at {run.diverged_at:.2f} s."
        claim = Claim(
            "ukf-reconstructs", TEXT, "fails", evidence, NOT_BY_THE_PENALTY, ("figure-03",), CRITERION
        )
        return Judged(claim)
    rows, fractions = [], []
    late = run.time >= FROM
    for name in run.names["estimate"]:
        true, guess = run.signal("state", name), run.signal("estimate", name)
        span = float(np.ptp(true))
        rmse = float(np.sqrt(np.mean((guess - true)[late] ** 2)))
        fractions.append(rmse / span)
        rows.append((name.replace("_", " "), rmse, span, 100.0 * rmse / span))
    claim = Claim(
        "ukf-reconstructs",
        TEXT,
        "holds" if max(fractions) <= FRACTION else "fails",
        f"The largest RMS error is {100 * max(fractions):.2g} % of its state's range.",
        "" if max(fractions) <= FRACTION else NOT_BY_THE_PENALTY,
        ("figure-03", "table-reconstruction"),
        CRITERION,
    )
    variance = number(setup.settings.measurement_noise)
    table = Table(
        (
            "state",
            Column("RMS error", "rad or rad/s"),
            Column("range in the run", "rad or rad/s"),
            Column("error / range", "%", 3),
        ),
        rows,
        f"UKF on the nominal 180° step, link position measured with Rⁿ = {variance} rad².",
        "table-reconstruction",
    )
    return Judged(claim, (table,))
