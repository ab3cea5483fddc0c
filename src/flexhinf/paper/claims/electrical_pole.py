"""The motor coil's pole is negligible, as the design assumes.

The design takes the current as (V − k_b θ̇)/R at once; the true coil of Table 2 has its pole at R/L = 100 rad/s.
Judged on the nominal arm with and without the coil, at 90° and at 180°.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.analysis import EquilibriumLoop
from flexhinf.hinf import HJISolution
from flexhinf.loop import Step
from flexhinf.paper.claims.judgement import Judged, damped_law, repair_by_damping
from flexhinf.paper.loop_setup import GOALS, PaperSetup, name_goal
from flexhinf.report import Claim, Column, Table, number

TEXT = "The motor's electrical pole is negligible in the design."

#: Changes that still count as negligible: overshoot in per cent of the step, settling as a share.
OVERSHOOT, SETTLING = 1.0, 0.10

CRITERION = (
    f"With the true state fed back and with the estimator, the coil changes the overshoot of a step to 90° or 180° "
    f"by at most {OVERSHOOT:g} % of the step and the settling time by at most {100 * SETTLING:g} %, and leaves the "
    "loop stable in equilibrium there."
)

DURATION = 8.0


@dataclass(frozen=True)
class Compared:
    """One loop without and with the coil.

    Attributes
    ----------
    metrics : pair of dict
    exponents : pair of complex arrays
        Slowest modes in equilibrium, 1/s; NaN without one.
    """

    feedback: str
    goal: float
    metrics: tuple[dict[str, Any], dict[str, Any]]
    exponents: tuple[np.ndarray, np.ndarray]

    @property
    def overshoot_change(self) -> float | None:
        """Per cent of the step; None where a run has no overshoot to speak of."""
        return _difference(*(m["overshoot_percent"] for m in self.metrics))

    @property
    def settling_change(self) -> float | None:
        """Relative; None where a run did not settle."""
        before, after = (m["settling_time_s"] for m in self.metrics)
        change = _difference(before, after)
        return None if change is None else change / before if before else math.inf

    @property
    def growth(self) -> float:
        """Rate of the slowest mode with the coil, 1/s."""
        return float(self.exponents[1][0].real)

    @property
    def negligible(self) -> bool:
        """The criterion; what diverges or does not settle is not negligible."""
        over, settle = self.overshoot_change, self.settling_change
        if over is None or settle is None:
            return False
        return abs(over) <= OVERSHOOT and abs(settle) <= SETTLING and self.growth < 0.0


def _difference(before: float | None, after: float | None) -> float | None:
    return None if before is None or after is None else float(after) - float(before)


def judge(setup: PaperSetup) -> Judged:
    """electrical-pole-negligible."""
    found = list(_compare(setup, setup.nonlinear))
    holds = all(c.negligible for c in found)
    worst = max((abs(c.overshoot_change or 0.0) for c in found), default=0.0)
    slower = max((abs(c.settling_change or 0.0) for c in found), default=0.0)
    lost = sum(c.overshoot_change is None or c.settling_change is None for c in found)
    evidence = (
        f"The coil changes the overshoot by at most {worst:.2f} % of the step and the settling time by at most "
        f"{100 * slower:.1f} %; " + _growth_text(found)
    )
    if lost:
        evidence += (
            f" In {lost} of {len(found)} cases a run diverges or does not settle, so no change is known."
        )
    claim = Claim(
        "electrical-pole-negligible",
        TEXT,
        "holds" if holds else "fails",
        evidence,
        "" if holds else repair_by_damping(setup, lambda s: _negligible_with(setup, damped_law(setup, s))),
        ("table-electrical-pole",),
        CRITERION,
    )
    numbers = {"largest_overshoot_change_percent": worst}
    return Judged(claim, (_table(found),), numbers)


def _negligible_with(setup: PaperSetup, law: HJISolution) -> bool:
    return all(c.negligible for c in _compare(setup, law))


def _compare(setup: PaperSetup, law: HJISolution) -> Iterator[Compared]:
    period, kind = setup.settings.period, setup.settings.estimator
    for name in dict.fromkeys(("none", kind)):
        for goal in GOALS:
            metrics, modes = [], []
            for coil in (False, True):
                estimator = setup.estimator(name)
                run = setup.run(law, Step(goal), DURATION, inductance=coil, estimator=estimator, noise=False)
                metrics.append(run.metrics())
                loop = EquilibriumLoop(law, estimator, setup.arm.plant(inductance=coil), period, goal)
                modes.append(loop.modes([setup.arm.nominal]).slowest(5)[0])
            feedback = "true state" if name == "none" else name.upper()
            yield Compared(feedback, goal, (metrics[0], metrics[1]), (modes[0], modes[1]))


def _growth_text(found: list[Compared]) -> str:
    growth = max(c.growth for c in found)
    if not math.isfinite(growth):
        return "with it some loop has no equilibrium."
    return f"with it the slowest mode of any loop has a rate of {number(growth, decimals=3)}/s."


def _mode(exponents: np.ndarray) -> str:
    """The slowest mode."""
    mode = complex(exponents[0])
    if not math.isfinite(mode.real):
        return "no equilibrium"
    return f"{mode.real:.3f}" + (f" ± {abs(mode.imag):.2f}i" if abs(mode.imag) > 1e-9 else "")


def _table(found: list[Compared]) -> Table:
    rows = []
    for c in found:
        for coil, metrics, exponents in zip(("no", "yes"), c.metrics, c.exponents, strict=True):
            kept = [mode for mode in exponents if math.isfinite(mode.real) and mode.imag >= 0.0]
            rows.append(
                (
                    c.feedback,
                    name_goal(c.goal),
                    coil,
                    metrics["overshoot_percent"],
                    metrics["settling_time_s"],
                    metrics["peak_input"],
                    ", ".join(_mode(np.array([mode])) for mode in kept) or "no equilibrium",
                )
            )
    columns = (
        "feedback",
        "step",
        "coil",
        Column("overshoot", "%", 3),
        Column("settling", "s", 3),
        Column("peak", "V", 2),
        Column("slowest modes", "1/s"),
    )
    caption = "Steps and slowest modes in equilibrium, without and with the coil; nominal arm, no noise."
    return Table(columns, rows, caption, "table-electrical-pole", stacks=True)
