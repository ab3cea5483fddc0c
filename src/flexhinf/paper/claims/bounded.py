"""The UKF is bounded, and it reconstructs the four states from the link position alone.

The abstract speaks of a "bounded UKF" and never says what is bounded, so the word is judged in one stated
reading: the estimation error stays bounded, in nominal runs of 30 s (180° and 90° steps, the tracking command of
Fig. 7, a disturbance torque the filter does not know). This looks at runs and proves nothing.

The other reading, bounds on states in the filter, is ours: `bounds=` clips sigma points and estimate to intervals.
Its effect is shown on starts with a bad estimate, and has no part in the verdict.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from flexhinf.hinf import HJISolution
from flexhinf.loop import Sine, Step, Trajectory
from flexhinf.paper.claims.judgement import NOT_BY_THE_PENALTY, Judged, damped_law, repair_by_damping
from flexhinf.paper.experiments import STEP_DURATION, Experiments
from flexhinf.paper.loop_setup import LONG, PaperSetup, affordable
from flexhinf.report import Claim, Column, Table, number

TEXT = "The UKF is bounded."

#: Seeds of each run, and how much larger the last ten seconds' error may be than that of the ten before.
SEEDS, GROWS = 5, 1.5

CRITERION = (
    "The paper does not define the word; it is read as: the estimation error stays bounded. In nominal runs of "
    f"{LONG:g} s of four commands, each with several seeds, no run diverges, and no state's largest error in the "
    f"last ten seconds is more than {GROWS:g} times that of the ten before. This looks at runs and proves nothing."
)

#: Bad starts of the estimate: x̂(0|−1), rad and rad/s, with the standard deviations of a P0 that admits them.
STARTS = {"off by 17°": (0.3, -0.5, -0.1, -0.5), "off by 86°, moving": (0.0, 5.0, 1.5, 5.0)}
SPREAD = (1.0, 20.0, 3.0, 20.0)

#: Bounds of the unmeasured states, as multiples of the largest values in the nominal 180° step.
ROOM = 1.5

COMMANDS: tuple[tuple[str, Any, Any], ...] = (
    ("180° step", Step(math.pi), None),
    ("90° step", Step(math.pi / 2), None),
    ("π + sin(πt/10)", Sine(1.0, 1.0 / 20.0, offset=math.pi), None),
    ("90° step, 2 N·m at the link from 6 s", Step(math.pi / 2), {"link_torque": Step(2.0, at=6.0)}),
)

RECONSTRUCTS = "The UKF reconstructs the four states from the link position alone."
RECONSTRUCTS_CRITERION = (
    "On the nominal 180° step, from an initial estimate 5° off at link and motor, each state's RMS error after the "
    "first second is below 2 % of that state's range in the run."
)

WRONG = math.radians(5.0)
RECONSTRUCTED_FRACTION = 0.02
RECONSTRUCTED_FROM = 1.0


def judge(setup: PaperSetup) -> Judged:
    """ukf-bounded."""
    rows, grown, diverged, count = [], 0, 0, affordable(SEEDS, setup.settings.period)
    largest = np.zeros(setup.model.n)
    for name, command, disturbance in COMMANDS:
        runs = _runs(setup, command, disturbance, count)
        errors = [_errors(run) for run in runs if run.diverged_at is None]
        diverged += len(runs) - len(errors)
        worst = np.max([late for _, late in errors], axis=0) if errors else None
        ratios = [np.max(late / np.maximum(early, 1e-300)) for early, late in errors]
        grown += sum(r > GROWS for r in ratios)
        shown = [None] * setup.model.n if worst is None else [float(w) for w in worst]
        rows.append((name, len(runs), *shown, max(map(float, ratios), default=None)))
        largest = largest if worst is None else np.maximum(largest, worst)
    bounds = _bounds(setup)
    clipped = _bounded_rows(setup, bounds)
    claim = Claim(
        "ukf-bounded",
        TEXT,
        "fails" if grown or diverged else "holds",
        f"{count} seeds of {len(COMMANDS)} commands, {LONG:g} s each: {diverged} diverged, in {grown} an error grew by "
        f"more than a factor of {GROWS:g}. Bounds on states in the filter are ours and have no part in this verdict.",
        "" if not (grown or diverged) else repair_by_damping(setup, lambda s: _stays(setup, s, count)),
        ("table-bounded", "table-bounds"),
        CRITERION,
    )
    numbers = {
        "runs": count * len(COMMANDS),
        "diverged": diverged,
        "grown": grown,
        "largest_error": largest.tolist(),
    }
    return Judged(claim, (_error_table(setup, rows), _bounds_table(clipped, bounds)), numbers)


def _stays(setup: PaperSetup, scale: float, count: int) -> bool:
    """No run diverges and no error grows with the damped law."""
    law = damped_law(setup, scale)
    for _, command, disturbance in COMMANDS:
        for run in _runs(setup, command, disturbance, count, law):
            if run.diverged_at is not None:
                return False
            early, late = _errors(run)
            if np.max(late / np.maximum(early, 1e-300)) > GROWS:
                return False
    return True


def _runs(
    setup: PaperSetup, command: Any, disturbance: Any, count: int, law: HJISolution | None = None
) -> list[Trajectory]:
    law = setup.nonlinear if law is None else law
    ukf = setup.estimator("ukf")
    ensemble = setup.ensemble(law, command, LONG, disturbance=disturbance, estimator=ukf)
    return list(ensemble.trajectories([{}] * count, [setup.seed(k) for k in range(count)]))


def _errors(run: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Largest |estimation error| of each state in the middle and in the last third."""
    error = np.abs(run.signals["estimate"] - run.signals["state"])
    middle = (run.time >= LONG / 3) & (run.time < 2 * LONG / 3)
    return error[middle].max(axis=0), error[run.time >= 2 * LONG / 3].max(axis=0)


# Bounds on states ----------------------------------------------------------------------------------
def _bounds(setup: PaperSetup) -> dict[str, tuple[float, float]]:
    """Of the states that are not measured."""
    run = setup.run(setup.nonlinear, Step(math.pi), 8.0, estimator=None)
    names = [name for name in setup.model.states if name not in setup.model.outputs]
    reach = {name: ROOM * float(np.abs(run.signal("state", name)).max()) for name in names}
    return {name: (-max(r, 2.0), max(r, 2.0)) for name, r in reach.items()}


def _bounded_rows(setup: PaperSetup, bounds: Mapping[str, tuple[float, float]]) -> list[tuple[Any, ...]]:
    """Start, whether bounded, largest errors of the unmeasured states, peak voltage, overshoot."""
    rows, low, high = [], *(np.full(setup.model.n, e) for e in (-np.inf, np.inf))
    for name, (lower, upper) in bounds.items():
        low[setup.model.index(name)], high[setup.model.index(name)] = lower, upper
    unmeasured = [setup.model.index(name) for name in bounds]
    for start, mean in STARTS.items():
        for chosen in (None, bounds):
            ukf = setup.estimator(
                "ukf", mean=np.clip(mean, low, high), covariance=np.array(SPREAD) ** 2, bounds=chosen
            )
            run = setup.run(setup.nonlinear, Step(math.pi), 8.0, estimator=ukf)
            kept = "yes" if chosen else "no"
            if run.diverged_at is not None:
                rows.append(
                    (start, kept, *[None] * len(bounds), None, None, f"diverged at {run.diverged_at:g} s")
                )
                continue
            m = run.metrics()
            error = np.abs(run.signals["estimate"] - run.signals["state"]).max(axis=0)[unmeasured]
            rows.append((start, kept, *map(float, error), m["peak_input"], m["overshoot_percent"], "finite"))
    return rows


def _error_table(setup: PaperSetup, rows: list[tuple[Any, ...]]) -> Table:
    states = [Column(name.replace("_", " "), _unit(setup, name)) for name in setup.model.states]
    columns = ("command", "runs", *states, Column("last over middle third", "", 2))
    caption = "Largest |estimation error| of the UKF in the last ten seconds, nominal arm."
    return Table(columns, rows, caption, "table-bounded")


def _unit(setup: PaperSetup, name: str) -> str:
    return setup.model.unit(name)


def _bounds_table(rows: list[tuple[Any, ...]], bounds: Mapping[str, tuple[float, float]]) -> Table:
    errors = [Column(f"largest error of {name.replace('_', ' ')}", "", 2) for name in bounds]
    columns = (
        "estimate starts",
        "bounds",
        *errors,
        Column("peak", "V", 1),
        Column("overshoot", "%", 2),
        "run",
    )
    limits = ", ".join(f"{name.replace('_', ' ')} ±{upper:.3g}" for name, (_, upper) in bounds.items())
    caption = (
        "Bounds on the sigma points of the unmeasured states, on the 180° step from a bad estimate with a P0 of "
        f"{', '.join(f'{s:g}²' for s in SPREAD)}: {limits}."
    )
    return Table(columns, rows, caption, "table-bounds")


# Reconstruction of the states from the link position alone ----------------------------------------------
def judge_reconstruction(experiments: Experiments) -> Judged:
    """ukf-reconstructs."""
    setup = experiments.setup
    start = np.array([WRONG, 0.0, WRONG, 0.0])
    ukf = setup.estimator("ukf", mean=start, covariance=np.array([WRONG**2, 0.1, WRONG**2, 0.1]))
    run = setup.run(setup.nonlinear, Step(math.pi), STEP_DURATION, estimator=ukf)
    if run.diverged_at is not None:
        evidence = f"The loop diverged at {run.diverged_at:.2f} s."
        claim = Claim(
            "ukf-reconstructs",
            RECONSTRUCTS,
            "fails",
            evidence,
            NOT_BY_THE_PENALTY,
            ("figure-03",),
            RECONSTRUCTS_CRITERION,
        )
        return Judged(claim)
    rows, fractions = [], []
    late = run.time >= RECONSTRUCTED_FROM
    for name in run.names["estimate"]:
        true, guess = run.signal("state", name), run.signal("estimate", name)
        span = float(np.ptp(true))
        rmse = float(np.sqrt(np.mean((guess - true)[late] ** 2)))
        fractions.append(rmse / span)
        rows.append((name.replace("_", " "), rmse, span, 100.0 * rmse / span))
    claim = Claim(
        "ukf-reconstructs",
        RECONSTRUCTS,
        "holds" if max(fractions) <= RECONSTRUCTED_FRACTION else "fails",
        f"The largest RMS error is {100 * max(fractions):.2g} % of its state's range.",
        "" if max(fractions) <= RECONSTRUCTED_FRACTION else NOT_BY_THE_PENALTY,
        ("figure-03", "table-reconstruction"),
        RECONSTRUCTS_CRITERION,
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
