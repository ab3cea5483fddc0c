"""The UKF reconstructs the four states from the link position alone.

Criterion: on the nominal 180° step, from a wrong initial estimate (5° off at link and motor), each state's
RMS error after the first second is below 2 % of that state's range in the run.
"""

from __future__ import annotations

import math

import numpy as np

from flexhinf.loop import Step
from flexhinf.paper.claims.damping import NOT_BY_THE_PENALTY
from flexhinf.paper.claims.judged import Judged
from flexhinf.paper.experiments import STEP_DURATION, Experiments
from flexhinf.report import Claim, Column, Table

__all__ = ["judge_reconstruction"]

WRONG = math.radians(5.0)
SHARE = 0.02
FROM = 1.0


def judge_reconstruction(experiments: Experiments) -> Judged:
    """ukf-reconstructs."""
    bench = experiments.bench
    start = np.array([WRONG, 0.0, WRONG, 0.0])
    ukf = bench.estimator("ukf", mean=start, covariance=np.array([WRONG**2, 0.1, WRONG**2, 0.1]))
    outcome = bench.run(bench.nonlinear, Step(math.pi), STEP_DURATION, estimator=ukf)
    text = (
        "The UKF reconstructs the four states from the link position alone (RMS error after the first second "
        "below 2 % of each state's range, from an initial estimate 5° off)."
    )
    if outcome.diverged_at is not None:
        evidence = f"The loop diverged at {outcome.diverged_at:.2f} s."
        return Judged(Claim("ukf-reconstructs", text, "fails", evidence, NOT_BY_THE_PENALTY, ("figure-03",)))
    run, rows, shares = outcome.run, [], []
    late = run.time >= FROM
    for name in run.names["estimate"]:
        true, guess = run.signal("state", name), run.signal("estimate", name)
        span = float(np.ptp(true))
        rmse = float(np.sqrt(np.mean((guess - true)[late] ** 2)))
        shares.append(rmse / span)
        rows.append((name.replace("_", " "), rmse, span, 100.0 * rmse / span))
    claim = Claim(
        "ukf-reconstructs",
        text,
        "holds" if max(shares) <= SHARE else "fails",
        "RMS errors in per cent of the range: "
        + ", ".join(f"{name} {100 * share:.2g}" for (name, *_), share in zip(rows, shares, strict=True))
        + ".",
        "" if max(shares) <= SHARE else NOT_BY_THE_PENALTY,
        ("figure-03", "table-reconstruction"),
    )
    table = Table(
        (
            "state",
            Column("RMS error (rad, rad/s)"),
            Column("range in the run (rad, rad/s)"),
            Column("share", "%", 3),
        ),
        rows,
        f"UKF on the nominal 180° step, link position measured with R^n = {bench.settings.measurement_noise:g} rad².",
        "table-reconstruction",
    )
    return Judged(claim, (table,))
