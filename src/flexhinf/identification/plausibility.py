"""Whether the units of a log can be right: its times beside the robot's vibrations, its positions beside the joints'.

A wrong unit is no mistake that a filter can see: it takes the log for that of another robot, or works for hours.
"""

from __future__ import annotations

import numpy as np

from flexhinf.errors import refuse_if
from flexhinf.identification.log import Log
from flexhinf.robot import Robot

#: Rows further apart than so many periods of the slowest vibration show nothing of it; a link that moves faster, rad/s
#: or m/s, is none; and nor are positions that span so many times a joint's range.
APART, FAST, BEYOND = 5.0, 100.0, 4.0


def vibration_periods(robot: Robot) -> np.ndarray:
    """Periods of the vibrations at the home, s, the shortest first; 0.1 s where there are none."""
    x, _ = robot.operating_point()
    modes = np.linalg.eigvals(robot.plant().linearise(x)[0])
    fast = np.abs(modes.imag)[np.abs(modes.imag) > 1.0]
    return np.sort(2.0 * np.pi / fast) if fast.size else np.array([0.1])


def check_plausible(robot: Robot, log: Log) -> None:
    """Refuse a log of named columns whose times or positions cannot be in the units that they are taken in."""
    step, slowest = log.period, float(vibration_periods(robot)[-1])
    unit = "the unit of the times, as time='stamp [us]' or time='stamp [ms]'"
    refuse_if(
        step > APART * slowest,
        "The times of the log do not fit the robot.",
        f"expected rows at most {APART * slowest:.3g} s apart, five periods of its slowest vibration, got {step:.3g} s",
        unit,
    )
    for name, values in zip(log.names.get("output", ()), log.outputs.T):
        kind, _, joint = name.partition("_position")
        if not name.startswith(("link_position", "motor_position")):
            continue
        known = np.isfinite(values)
        speed = np.abs(np.diff(values[known])) / np.diff(log.times[known])
        moving = speed[speed > 0.0]
        fast = float(np.median(moving)) if moving.size else 0.0
        refuse_if(
            fast > FAST,
            "The times of the log do not fit its positions.",
            f"expected a {kind} that moves by less than {FAST:g} rad/s or m/s, got {fast:.3g} in {name!r}",
            unit,
        )
        joints = robot.joint_names
        limits = robot.links.limits[joints.index(joint[1:]) if joint[1:] in joints else 0]
        span, range_ = float(np.ptp(values[known])) if known.any() else 0.0, np.ptp(limits or (0.0, np.inf))
        refuse_if(
            span > BEYOND * range_,
            f"{name!r} goes too far for its joint.",
            f"expected a span within the joint's range of {range_:.4g} rad or m, got {span:.4g}",
            "its unit, or what one of it is behind the gear: encoder degrees of a motor before a gear of 80 are "
            f"columns={{{name!r}: 'COLUMN [0.000218166]'}}, π/180/80",
        )
