"""What a specification requires, against what the loop achieves: one line each.

Whether a requirement is met is decided here and nowhere else. What no requirement covers, such as a small delay margin,
is judged in `design.status`. Bandwidth, damping, peak sensitivity and gain margin are
judged on the running loop: sampled, with the estimator and the delay, and with the extras that can be linearised.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flexhinf.analysis import Margins, ToleranceCorners
from flexhinf.design.monte_carlo import MonteCarlo
from flexhinf.design.responses import Response, Worst
from flexhinf.design.specification import FIELDS, GAIN_MARGIN, PEAK_SENSITIVITY, Specification

__all__ = [
    "GAIN_MARGIN", "PEAK_SENSITIVITY", "TOLERANCE", "Requirement", "all_met", "behaviour_requirements",
    "corner_requirement", "gain_margin_limit", "margin_requirements", "peak_option", "peak_sensitivity_limit",
    "sample_requirements", "step_requirements",
]  # fmt: skip

#: A figure that misses its limit by less than this fraction of it meets it: the width of the searches.
TOLERANCE = 0.02

#: Where linear requirements are judged.
RUNNING = "running loop at the goal: sampled, with estimator and delay, nominal robot"


@dataclass(frozen=True)
class Requirement:
    """One line of a specification.

    Attributes
    ----------
    what : str
    limit, found : float
        In `unit`.
    unit : str
    at_most : bool
        Whether `limit` is an upper limit; otherwise a lower one.
    where : str
        What was looked at.
    criterion : str
        How `found` is defined.
    stated_by : str
        The option that states the limit, or "default".
    joint : str
        Of the worst value; empty where there is one joint, or where it has none.
    """

    what: str
    limit: float
    found: float
    unit: str
    at_most: bool
    where: str
    criterion: str
    stated_by: str = "default"
    joint: str = ""

    @property
    def met(self) -> bool:
        """Whether it is met, within `TOLERANCE`."""
        if self.at_most:
            return bool(self.found <= self.limit * (1.0 + TOLERANCE))
        return bool(self.found >= self.limit * (1.0 - TOLERANCE))


def all_met(lines: Sequence[Requirement]) -> bool:
    """Whether every requirement is met."""
    return all(line.met for line in lines)


def peak_sensitivity_limit(s: Specification) -> float:
    """Largest |S| that is allowed: as stated, or `PEAK_SENSITIVITY`."""
    return PEAK_SENSITIVITY if s.peak_sensitivity is None else s.peak_sensitivity


def gain_margin_limit(s: Specification) -> float:
    """Smallest gain margin that is allowed, a factor: as stated, or `GAIN_MARGIN`."""
    return GAIN_MARGIN if s.gain_margin is None else s.gain_margin


def _option(s: Specification, name: str) -> str:
    """The option that states a field, or "default" where it has its default."""
    field = FIELDS[name]
    return "default" if getattr(s, name) == field.default else field.options[0]


def peak_option(unit: str) -> str:
    """The option of the command line that limits an input of this unit."""
    return "--peak-voltage" if unit == "V" else "--peak-torque"


def margin_requirements(s: Specification, margins: Margins) -> list[Requirement]:
    """Peak sensitivity and gain margin of the running loop."""
    return [
        Requirement(
            "peak sensitivity", peak_sensitivity_limit(s), margins.peak_sensitivity, "", True, RUNNING,
            "largest singular value of S at the plant's inputs, over all frequencies", _option(s, "peak_sensitivity"),
        ),
        Requirement(
            "gain margin", gain_margin_limit(s), margins.gain_margin, "", False, RUNNING,
            "smallest factor, up or down, of one input's gain that makes the loop unstable", _option(s, "gain_margin"),
        ),
    ]  # fmt: skip


def behaviour_requirements(
    s: Specification, bandwidth: np.ndarray, damping: float, margins: Margins, joints: Sequence[str]
) -> list[Requirement]:
    """Bandwidth and damping of the running loop, where weights were searched for them.

    Parameters
    ----------
    bandwidth : (n,)
        Required of each joint, rad/s.
    damping : float
        Required of every oscillation.
    margins : Margins
    joints : sequence of str
    """
    fraction = np.nan_to_num(margins.bandwidth / bandwidth, nan=0.0)
    worst = int(np.argmin(fraction))
    found = float(np.nan_to_num(margins.bandwidth[worst], nan=0.0))
    return [
        Requirement(
            "bandwidth", float(bandwidth[worst]), found, "rad/s", False, RUNNING,
            "where |command → link position| is 3 dB below its value at rest", _option(s, "bandwidth"),
            joints[worst] if len(joints) > 1 else "",
        ),
        Requirement(
            "damping of oscillations", damping, margins.damping, "", False, RUNNING,
            "smallest damping ratio of every oscillation, the estimator's included", _option(s, "damping"),
        ),
    ]  # fmt: skip


def step_requirements(
    s: Specification, response: Response, unit: str, where: str, unlimited: Response | None = None
) -> list[Requirement]:
    """Overshoot and peak input of one run.

    Parameters
    ----------
    s : Specification
    response : Response
    unit : str
        Of the inputs.
    where : str
    unlimited : Response, optional
        The same run without limits of the inputs, for the peak that a limit would hide.
    """
    several = len(response.joints) > 1
    overshoot = response.overshoot
    lines = [
        Requirement(
            "overshoot", s.overshoot, overshoot.value, "%", True, where,
            "largest of all joints, per cent of the joint's own step", _option(s, "overshoot"),
            overshoot.joint if several else "",
        )
    ]  # fmt: skip
    if s.peak_effort is not None:
        demanded = response if unlimited is None else unlimited
        free = ", without limits of the inputs" if s.saturation is not None and unlimited is not None else ""
        lines.append(_peak(s, demanded.peak, unit, where, several, free))
    return lines


def _peak(s: Specification, found: Worst, unit: str, where: str, several: bool, how: str = "") -> Requirement:
    return Requirement(
        "peak input", float(s.peak_effort or np.inf), found.value, unit, True, where,
        f"largest |input| of all motors{how}", peak_option(unit), found.joint if several else "",
    )  # fmt: skip


def corner_requirement(corners: ToleranceCorners) -> Requirement:
    """That no corner of the tolerances is unstable with the design's own estimator."""
    which = f"all {corners.count} corners" if corners.complete else f"{corners.count} sampled corners"
    return Requirement(
        "unstable corners", 0.0, float(corners.unstable), "", True,
        f"{which} of the tolerances, running loop with this design's R^v",
        "corners with a pole outside the unit circle",
    )  # fmt: skip


def sample_requirements(s: Specification, samples: MonteCarlo, unit: str) -> list[Requirement]:
    """The worst of the robots sampled within their tolerances."""
    where = f"the worst of {len(samples)} robots sampled within their tolerances"
    lines = [
        Requirement(
            "runs that do not settle", 0.0, float(samples.unsettled), "", True, where,
            "runs that diverge, or are outside ±2 % of the step at their end",
        ),
        Requirement(
            "overshoot", s.overshoot, float(samples.overshoot.max()), "%", True, where,
            "largest of all joints, per cent of the joint's own step", _option(s, "overshoot"),
            samples.joint_of_worst_overshoot,
        ),
    ]  # fmt: skip
    if s.peak_effort is not None:
        worst = int(np.argmax(samples.peak))
        found = Worst(float(samples.peak[worst]), samples.peak_joints[worst])
        lines.append(_peak(s, found, unit, where, samples.positions.shape[2] > 1))
    return lines
