"""Whether the units of a log can be right: its times beside the robot's vibrations, its positions beside the joints'.

A wrong unit is no mistake that a filter can see: it takes the log for that of another robot, or works for hours.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from flexhinf.errors import refuse_if
from flexhinf.identification.log import Log
from flexhinf.robot import Robot
from flexhinf.robot.table import name_and_unit

#: Rows further apart than so many periods of the slowest vibration show nothing of it; a link that moves faster, rad/s
#: or m/s, is none; and nor are positions that span so many times a joint's range.
APART, FAST, BEYOND = 5.0, 100.0, 4.0

#: Whole numbers that span so many are no rad; so many first values are looked at for different ones.
COUNTS, COUNTED = 30.0, 100_000


def vibration_periods(robot: Robot) -> np.ndarray:
    """Periods of the vibrations at the home, s, the shortest first; 0.1 s where there are none."""
    x, _ = robot.operating_point()
    modes = np.linalg.eigvals(robot.plant().linearise(x)[0])
    fast = np.abs(modes.imag)[np.abs(modes.imag) > 1.0]
    return np.sort(2.0 * np.pi / fast) if fast.size else np.array([0.1])


def check_plausible(robot: Robot, log: Log, columns: Mapping[str, str] | None = None) -> None:
    """Refuse a log of named columns whose times or positions cannot be in the units that they are taken in.

    `columns`: the file's names by signal, for the advice.
    """
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
        column = name_and_unit((columns or {}).get(name, name))[0]
        _check_counts(name, values[known], column, fast)
        refuse_if(
            fast > FAST,
            "The times of the log do not fit its positions.",
            f"expected a {kind} that moves by less than {FAST:g} rad/s or m/s, got {fast:.3g} in {name!r}",
            f"{unit}; or that of the positions, as columns={{{name!r}: '{column} [deg]'}}",
        )
        joints = robot.joint_names
        limits = robot.links.limits[joints.index(joint[1:]) if joint[1:] in joints else 0]
        span, range_ = float(np.ptp(values[known])) if known.any() else 0.0, np.ptp(limits or (0.0, np.inf))
        refuse_if(
            span > BEYOND * range_,
            f"{name!r} goes too far for its joint.",
            f"expected a span within the joint's range of {range_:.4g} rad or m, got {span:.4g}",
            "its unit, or what one of it is behind the gear: encoder degrees of a motor before a gear of 80 are "
            f"columns={{{name!r}: '{column} [0.000218166]'}}, π/180/80",
        )


def _check_counts(name: str, values: np.ndarray, column: str, fast: float) -> None:
    """Refuse positions (N,) that are whole numbers and go far, or as `fast`, rad/s, as no joint does."""
    whole = np.array_equal(values, np.rint(values)) and len(np.unique(values[:COUNTED])) > 2
    low, high = (float(end) for end in (values.min(), values.max())) if values.size else (0.0, 0.0)
    refuse_if(
        whole and (fast > FAST or high - low > COUNTS),
        f"{name!r} has whole numbers alone: counts of an encoder, or degrees, and no rad or m.",
        f"expected positions in rad or m, got whole numbers from {low:g} to {high:g}",
        f"what a count is: columns={{{name!r}: '{column} [0.00306796]'}} of 2048 counts a turn, 2π/2048 (over the "
        f"ratio of a gear that comes after the encoder); or '{column} [deg]'",
    )
