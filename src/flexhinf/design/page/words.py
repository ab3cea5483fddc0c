"""What a design comes to, in a few words, for the terminal and the top of the report."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from flexhinf.design.comparison import RigidLoop
from flexhinf.design.met import Met
from flexhinf.design.page.units import units_of
from flexhinf.design.response import Response
from flexhinf.design.result import Design
from flexhinf.report import number

__all__ = [
    "ESTIMATORS",
    "HARDLY_DAMPED",
    "LAW_NAMES",
    "compared",
    "fed_words",
    "headline",
    "joint_words",
    "largest_overshoot",
    "law_name",
    "mujoco_words",
    "peak_input",
    "range_of",
    "rigid_words",
    "slowest_settling",
    "specification_words",
    "verdict",
    "vibrations",
]

LAW_NAMES = {2: "linear", 3: "quadratic", 4: "cubic", 5: "quartic", 6: "quintic"}

ESTIMATORS = {
    "ukf": "the unscented Kalman filter",
    "ekf": "the extended Kalman filter",
    "observer": "the output-injection observer",
    "none": "the true state fed back",
}

#: A vibration with less damping than this rings.
HARDLY_DAMPED = 0.1


def law_name(degree: int) -> str:
    """Of the law for a V of this degree."""
    return LAW_NAMES.get(degree, f"degree {degree - 1}")


def joint_words(count: int) -> str:
    """How many elastic joints."""
    return "one elastic joint" if count == 1 else f"{count} elastic joints"


def range_of(values: Any, digits: int = 3) -> str:
    """Smallest and largest of some numbers."""
    values = sorted(values)
    if not values:
        return "–"
    ends = number(values[0], digits), number(values[-1], digits)
    return ends[0] if ends[0] == ends[1] else " to ".join(ends)


def vibrations(modes: Any) -> list[float]:
    """Damping ratios of the vibrations among some modes."""
    return [mode.damping for mode in modes if mode.vibration]


def fed_words(design: Design) -> str:
    """What the law is fed with in the runs."""
    s = design.specification
    if s.estimator == "none":
        return ESTIMATORS["none"]
    return (
        f"with {ESTIMATORS[s.estimator]} on {', '.join(s.measured).replace('_', ' ')} and measurement noise"
    )


def _moved(response: Response) -> list[dict[str, Any]]:
    return [m for m in response.metrics if m.get("overshoot_percent") is not None]


def largest_overshoot(response: Response) -> float | None:
    """Of all joints that were to move, per cent; None where there is none, or the run diverged."""
    return max((m["overshoot_percent"] for m in _moved(response)), default=None)


def slowest_settling(response: Response) -> float | None:
    """Of all joints that were to move, s; None where one does not settle, or the run diverged."""
    times = [m["settling_time_s"] for m in _moved(response)]
    return None if not times or None in times else max(times)


def peak_input(response: Response) -> float:
    """Largest of all inputs, until the run ended or diverged."""
    return float(np.abs(response.run.signals["input"]).max())


def settled(design: Design) -> str:
    """The step response in words."""
    response = design.response
    if response.diverged is not None:
        return f"the step response diverges at {number(response.diverged, 3)} s"
    overshoot, settling = largest_overshoot(response), slowest_settling(response)
    if overshoot is None:
        return "nothing was to move"
    passed = f"{number(overshoot, 2)} % overshoot"
    if settling is None:
        return f"not every joint settles within {design.duration:g} s, {passed}"
    peak = f"{number(peak_input(response), 3)} {units_of(design).effort} at most"
    return f"the step settles in {number(settling, 3)} s with {passed} and takes {peak}"


def rigid_words(loop: RigidLoop) -> str:
    """What the rigid design does, fed from one side."""
    damping = vibrations(loop.modes)
    if not loop.stable:
        worst = max(loop.modes, key=lambda mode: mode.eigenvalue.real)
        return f"unstable (a mode at {worst.frequency:.3g} Hz grows by e in {worst.time_constant:.2g} s)"
    if damping and min(damping) < HARDLY_DAMPED:
        return f"stable, and rings (damping ratio {min(damping):.2g})"
    return "stable" + (f", vibrations damped by {range_of(damping, 2)}" if damping else "")


def mujoco_words(design: Design) -> str:
    """How far the run on MuJoCo's plant is from ours."""
    assert design.mujoco is not None
    if design.mujoco.diverged is not None or design.response.diverged is not None:
        return "it diverges" if design.mujoco.diverged is not None else "it does not diverge"
    apart = float(np.abs(design.mujoco.positions - design.response.positions).max())
    return f"link positions within {number(apart, 2)} {units_of(design).position} of these"


def line_words(line: Met) -> str:
    """A line of the specification that is missed."""
    unit = f" {line.unit}" if line.unit else ""
    side = "at most" if line.at_most else "at least"
    found = "diverges" if np.isinf(line.found) and line.at_most else f"{number(line.found, 3)}{unit}"
    return f"{line.what} {found} ({side} {number(line.asked, 3)}{unit}; {line.where})"


def specification_words(lines: Sequence[Met]) -> str:
    """Whether the specification is met, and what is not."""
    missed = [line for line in lines if not line.holds]
    ours = "" if any(line.asked_for for line in lines) else ", all of them our defaults"
    if not missed:
        return f"Specification met ({len(lines)} of {len(lines)} lines{ours})"
    told = f"Specification NOT MET ({len(missed)} of {len(lines)} lines missed{ours})"
    more = f", and {len(missed) - 2} more" if len(missed) > 2 else ""
    return f"{told}: {'; '.join(line_words(line) for line in missed[:2])}{more}"


def verdict(design: Design) -> str:
    """The headline, then MuJoCo and the rigid design."""
    return " ".join([headline(design), *compared(design)])


def headline(design: Design) -> str:
    """The specification first, then the nominal loop and its tolerances."""
    return " ".join([f"{specification_words(design.met)}.", _nominal(design), *_tolerances(design)])


def compared(design: Design) -> list[str]:
    """The same on MuJoCo's plant, and by the rigid design."""
    found = [] if design.mujoco is None else [f"On MuJoCo's plant: {mujoco_words(design)}."]
    return [*found, *_rigid(design)]


def _nominal(design: Design) -> str:
    stable = all(mode.stable for mode in design.closed_modes) and design.margins.stable
    before, after = vibrations(design.open_modes), vibrations(design.closed_modes)
    change = ""
    if after:
        change = (
            f"; damping of the vibrations {range_of(before, 2)} without control, {range_of(after, 2)} with it"
        )
    rings = bool(stable and after and min(after) < HARDLY_DAMPED)
    first = "Stable, but rings" if rings else ("Stable" if stable else "Unstable")
    outside = "; it starts outside the sampled region" if design.inside is False else ""
    return f"{first}: {settled(design)}{change}{_estimated(design)}{outside}."


def _estimated(design: Design) -> str:
    """That the estimator's error rings more than the law was asked to."""
    wanted = HARDLY_DAMPED if design.game.wanted is None else design.game.wanted.damping
    error = vibrations(design.estimator_modes)
    if not error or min(error) >= wanted:
        return ""
    return f", but the error of its estimator is damped by {min(error):.2g} only"


def _tolerances(design: Design) -> list[str]:
    draws = design.draws
    if draws is None or not len(draws):
        return []
    among = f"Of {len(draws)} robots within their tolerances"
    if draws.unsettled:
        gone = f", {draws.diverged} of them diverge" if draws.diverged else ""
        return [f"{among} {draws.unsettled} do not settle{gone}."]
    worst = (
        f"{number(float(draws.settling.max()), 3)} s, {number(float(draws.overshoot.max()), 2)} % overshoot"
    )
    peak = f"{number(float(draws.peak.max()), 3)} {units_of(design).effort}"
    return [f"{among} all settle; the worst: {worst}, {peak}."]


def _rigid(design: Design) -> list[str]:
    if design.rigid is None:
        return []
    sides = (f"fed from the {loop.side} side it is {rigid_words(loop)}" for loop in design.rigid.loops)
    return [f"The rigid design on the same robot: {'; '.join(sides)}."]
