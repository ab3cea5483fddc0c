"""Whether the nonlinear loop with its estimator does what was asked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flexhinf.design.draws import Draws
from flexhinf.design.presets.choose import DAMPING
from flexhinf.design.presets.search import Wanted
from flexhinf.design.response import Response
from flexhinf.design.specification import Specification

__all__ = ["CLOSE", "Met", "all_hold", "corners_met", "linear_met", "step_met", "within_tolerances"]

#: A figure that misses its limit by less than this share of it meets it: the width of the search.
CLOSE = 0.02


@dataclass(frozen=True)
class Met:
    """One line of the specification.

    Attributes
    ----------
    what : str
    asked : float
    found : float
    unit : str
    at_most : bool
        Whether `asked` is an upper limit; otherwise a lower one.
    where : str
        What was looked at.
    asked_for : bool
        Whether the user asked for it; otherwise it is a default of ours.
    """

    what: str
    asked: float
    found: float
    unit: str
    at_most: bool
    where: str
    asked_for: bool = True

    @property
    def holds(self) -> bool:
        """Whether it is met, within `CLOSE`."""
        if self.at_most:
            return bool(self.found <= self.asked * (1.0 + CLOSE))
        return bool(self.found >= self.asked * (1.0 - CLOSE))


def step_met(
    s: Specification, response: Response, unit: str, where: str, unlimited: Response | None = None
) -> list[Met]:
    """Overshoot and peak input of a step.

    Parameters
    ----------
    s : Specification
    response : Response
    unit : str
        Of the inputs.
    where : str
    unlimited : Response, optional
        The same step without limits of the inputs, for the peak.
    """
    moved = [m for m in response.metrics if m.get("overshoot_percent") is not None]
    diverged = response.diverged is not None
    overshoot = np.inf if diverged else max((m["overshoot_percent"] for m in moved), default=0.0)
    found = [
        Met("overshoot", s.overshoot, overshoot, "%", True, where, s.overshoot != Specification.overshoot)
    ]
    if s.peak_effort is not None:
        asking = response if unlimited is None else unlimited
        gone = asking.diverged is not None
        peak = np.inf if gone else float(np.abs(asking.run.signals["input"]).max())
        found.append(Met("peak input", s.peak_effort, peak, unit, True, where))
    return found


def linear_met(s: Specification, wanted: Wanted | None, bandwidth: np.ndarray, damping: float) -> list[Met]:
    """Bandwidth and damping of the linearised loop; lines only of what a preset looked for.

    Parameters
    ----------
    bandwidth : (n,)
        Of each joint, rad/s.
    damping : float
        Smallest of an oscillation; infinite where none is left.
    """
    if wanted is None:
        return []
    worst = int(np.argmin(bandwidth / wanted.bandwidth))
    asked = min(wanted.damping, DAMPING) if s.damping is None else s.damping
    where = "the law at the goal, nominal robot, true state"
    return [
        Met(
            "bandwidth", float(wanted.bandwidth[worst]), float(bandwidth[worst]), "rad/s", False, where,
            s.bandwidth is not None,
        ),
        Met("damping of oscillations", asked, damping, "", False, where, s.damping is not None),
    ]  # fmt: skip


def corners_met(plants: int, unstable: int) -> Met:
    """That no corner of the tolerances is unstable."""
    where = f"{plants} corners of the tolerances, linearised loop with the estimator"
    return Met("unstable loops", 0.0, float(unstable), "", True, where, asked_for=False)


def within_tolerances(s: Specification, draws: Draws, unit: str) -> list[Met]:
    """The worst of the robots drawn within their tolerances."""
    where = f"the worst of {len(draws)} robots within their tolerances"
    asked = s.overshoot != Specification.overshoot
    found = [
        Met("runs that do not settle", 0.0, float(draws.unsettled), "", True, where, asked_for=False),
        Met("overshoot", s.overshoot, float(draws.overshoot.max()), "%", True, where, asked),
    ]
    if s.peak_effort is not None:
        found.append(Met("peak input", s.peak_effort, float(draws.peak.max()), unit, True, where))
    return found


def all_hold(lines: Sequence[Met]) -> bool:
    """Whether the whole specification is met."""
    return all(line.holds for line in lines)
