"""The motor coil's pole is negligible, as the design assumes.

The design takes the current as (V − k_b θ̇)/R at once; the true coil of Table 2 has its pole at R/L = 100 rad/s.
Judged on the nominal arm with and without the coil, at 90° and at 180°. Criterion, with the true state fed back
and with the estimator of the settings: the coil changes the overshoot of a step by at most one per cent of the
step and the settling time by at most 10 %, and leaves the loop at rest stable.
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
from flexhinf.paper.bench import PaperBench
from flexhinf.paper.claims.damping import damped_law, repair_by_damping
from flexhinf.paper.claims.judged import Judged
from flexhinf.paper.tolerance_sweep import GOALS, name_goal
from flexhinf.report import Claim, Column, Table

__all__ = ["judge"]

TEXT = "The motor's electrical pole is negligible in the design."

#: Changes that still count as negligible: overshoot in per cent of the step, settling as a share.
OVERSHOOT, SETTLING = 1.0, 0.10

DURATION = 8.0


@dataclass(frozen=True)
class Compared:
    """One loop without and with the coil.

    Attributes
    ----------
    metrics : pair of dict
    exponents : pair of complex arrays
        Slowest modes of the loop at rest, 1/s; NaN without a rest.
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


def judge(bench: PaperBench) -> Judged:
    """electrical-pole-negligible."""
    found = list(_compare(bench, bench.nonlinear))
    holds = all(c.negligible for c in found)
    worst = max((abs(c.overshoot_change or 0.0) for c in found), default=0.0)
    parts = [
        f"{c.feedback}, {name_goal(c.goal)}: overshoot {_signed(c.overshoot_change, 2, ' % of the step')}, "
        f"settling {_signed(_percent(c.settling_change), 1, ' %')}, slowest mode {_pair(c.exponents)}"
        for c in found
    ]
    claim = Claim(
        "electrical-pole-negligible",
        TEXT,
        "holds" if holds else "fails",
        f"What the coil changes. {'; '.join(parts)}.",
        "" if holds else repair_by_damping(bench, lambda s: _negligible_with(bench, damped_law(bench, s))),
        ("table-electrical-pole",),
    )
    numbers = {"largest_overshoot_change_percent": worst}
    return Judged(claim, (_table(found),), numbers)


def _negligible_with(bench: PaperBench, law: HJISolution) -> bool:
    return all(c.negligible for c in _compare(bench, law))


def _compare(bench: PaperBench, law: HJISolution) -> Iterator[Compared]:
    period, kind = bench.settings.period, bench.settings.estimator
    for name in dict.fromkeys(("none", kind)):
        for goal in GOALS:
            metrics, modes = [], []
            for coil in (False, True):
                estimator = bench.estimator(name)
                run = bench.run(law, Step(goal), DURATION, inductance=coil, estimator=estimator, noise=False)
                metrics.append(run.metrics)
                loop = EquilibriumLoop(law, estimator, bench.arm.plant(inductance=coil), period, goal)
                modes.append(loop.modes([bench.arm.nominal]).slowest(5)[0])
            feedback = "true state" if name == "none" else name.upper()
            yield Compared(feedback, goal, (metrics[0], metrics[1]), (modes[0], modes[1]))


def _percent(share: float | None) -> float | None:
    return None if share is None else 100.0 * share


def _signed(value: float | None, decimals: int, unit: str) -> str:
    return "not to compare" if value is None else f"{value:+.{decimals}f}{unit}"


def _pair(exponents: tuple[np.ndarray, np.ndarray]) -> str:
    return f"{_mode(exponents[0])} → {_mode(exponents[1])} 1/s"


def _mode(exponents: np.ndarray) -> str:
    """The slowest mode."""
    mode = complex(exponents[0])
    if not math.isfinite(mode.real):
        return "no rest"
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
                    ", ".join(_mode(np.array([mode])) for mode in kept) or "no rest",
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
    caption = "Steps and slowest modes of the loop at rest, without and with the coil; nominal arm, no noise."
    return Table(columns, rows, caption, "table-electrical-pole")
