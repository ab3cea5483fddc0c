"""What a design comes to, in a few words, for the terminal and the top of the report."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from flexhinf.design.comparison import RigidLoop
from flexhinf.design.result import Design
from flexhinf.report import number

__all__ = [
    "HARDLY_DAMPED",
    "LAW_NAMES",
    "law_name",
    "mujoco_words",
    "notes",
    "range_of",
    "rigid_words",
    "verdict",
]

LAW_NAMES = {2: "linear", 3: "quadratic", 4: "cubic", 5: "quartic", 6: "quintic"}

#: A vibration with less damping than this rings.
HARDLY_DAMPED = 0.1

#: An estimation error at a vibration with less damping than this is hardly corrected.
HARDLY_SEEN = 0.01


def law_name(degree: int) -> str:
    """Of the law for a V of this degree."""
    return LAW_NAMES.get(degree, f"degree {degree - 1}")


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


def settled(design: Design) -> str:
    """The step response in words."""
    response = design.response
    if response.diverged is not None:
        return f"the step response diverges at {response.diverged:.3g} s"
    times = [m["settling_time_s"] for m in response.metrics]
    overshoot = max((m["overshoot_percent"] or 0.0) for m in response.metrics)
    moved = [t for m, t in zip(response.metrics, times) if m["overshoot_percent"] is not None]
    if not moved:
        return "nothing was to move"
    if any(t is None for t in moved):
        return f"not every joint settles within {design.duration:g} s, overshoot {overshoot:.3g} %"
    return f"the step settles in {max(moved):.3g} s with {overshoot:.3g} % overshoot"


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
    unit = "m" if design.robot.links.slides[0] else "rad"
    return f"link positions within {number(apart, 2)} {unit} of these"


def verdict(design: Design) -> str:
    """One line."""
    stable = all(mode.stable for mode in design.closed_modes)
    before, after = vibrations(design.open_modes), vibrations(design.closed_modes)
    change = (
        f"; damping of the vibrations {range_of(before, 2)} without control, {range_of(after, 2)} with it"
        if after
        else ""
    )
    rings = bool(stable and after and min(after) < HARDLY_DAMPED)
    first = "Stable, but rings" if rings else ("Stable" if stable else "Unstable")
    text = f"{first}: {settled(design)}{change}."
    if design.mujoco is not None:
        text += f" On MuJoCo's plant: {mujoco_words(design)}."
    if design.rigid is not None:
        sides = "; ".join(
            f"fed from the {loop.side} side it is {rigid_words(loop)}" for loop in design.rigid.loops
        )
        text += f" The rigid design on the same robot: {sides}."
    return text


def notes(design: Design) -> list[str]:
    """What the reader must not miss."""
    found = []
    if design.response.diverged is not None:
        found.append(
            f"The step diverges at {design.response.diverged:.3g} s: start nearer to the goal, or change the penalty."
        )
    after = vibrations(design.closed_modes)
    if after and min(after) < HARDLY_DAMPED:
        found.append(
            f"A vibration keeps a damping ratio of {min(after):.2g}: these weights hardly act on it. "
            "Weights on motor_velocity or joint_torque damp it."
        )
    unseen = [mode for mode in design.estimator_modes if mode.vibration and mode.damping < HARDLY_SEEN]
    if unseen:
        worst = min(unseen, key=lambda mode: mode.damping)
        found.append(
            f"The estimator hardly sees {len(unseen)} vibration{'s' if len(unseen) > 1 else ''}: its error at "
            f"{worst.frequency:.3g} Hz ({worst.joint}) is damped by {worst.damping:.1g} only, and noise keeps it "
            "ringing, in the robot too. Measure link positions or joint torques, or raise --process-noise."
        )
    for low, high in design.shrinking:
        found.append(f"degree {high} allows a smaller step than degree {low}.")
    if design.inside is False:
        found.append(
            f"The step starts, with its integrals at zero, outside the region in which nothing was found against the "
            f"solution of degree {design.chosen.degree} (V there is above {design.chosen.level:.4g}); the "
            "simulation shows what happens. The table's steps start at the integrals where V is smallest."
        )
    if not design.chosen.looked:
        found.append(
            f"The regions were not looked at: {len(design.problem.state_names)} states take minutes. "
            "Ask for it with --rays 50."
            if design.specification.rays is None
            else "The regions were not looked at, as asked."
        )
    elif design.specification.rays is None and design.rays < 4000:
        found.append(
            f"The regions were looked at along {design.rays} rays only, for the number of states; --rays asks for more."
        )
    if design.specification.compare_rigid and design.rigid is None:
        found.append("No rigid design was made: a penalty that is code says nothing about a rigid robot.")
    return found


def step_words(amplitude: float, unit: str) -> str:
    """A rest-to-rest step."""
    if math.isnan(amplitude):
        return "–"
    if math.isinf(amplitude):
        return "any looked at"
    degrees = f" ({math.degrees(amplitude):.3g}°)" if unit == "rad" else ""
    return f"{amplitude:.3g} {unit}{degrees}"
