"""Lines of a robot file about drives with a loop of their own, as estimates.

A servo's loop of position has some 20 Hz, one of velocity some 60 Hz; fieldbuses take a command every 1 to 8 ms and act
on it one or two commands later (docs/drives.md).
"""

from __future__ import annotations

import json
from typing import Final, NamedTuple

from flexhinf.robot.parameters import ESTIMATE

#: Drives whose numbers are estimated here, with the bandwidth of their loops, Hz.
LOOPS: Final = {"velocity": 60.0, "position": 20.0}

#: Time between two commands, and from a command to the loop, s.
PERIOD, DELAY = 4e-3, 8e-3

#: Damping ratio of a position loop; the bandwidth's tolerance, per cent.
RATIO, TOLERANCE = 0.9, 30.0

#: Largest command over the joint's range or speed: what a law may add to the planned one.
ROOM = 1.2


class DriveLines(NamedTuple):
    """What stands in [[joint]], the line about its largest command, and in [joint.motor]."""

    limit: str
    motor: tuple[str, ...]


def drive_lines(
    drive: str,
    limits: tuple[float, float] | None,
    speed: float,
    slides: bool,
    torque: float | None = None,
    file: str = "",
) -> DriveLines:
    """Lines for a joint of a range, rad or m, and a speed, rad/s or m/s; no limit where none is stated. `torque`: the
    motor's largest, N·m or N, which `file` states."""
    length = "m" if slides else "rad"
    largest = {"velocity": speed, "position": max(map(abs, limits)) if limits else float("inf")}[drive]
    unit = {"velocity": f"{length}/s", "position": length}[drive]
    limit = (
        f"effort_limit = {ROOM * largest:.4g}  # {unit}, the largest command"
        if largest < float("inf")
        else ""
    )
    source = f'source = "{ESTIMATE}: of a usual servo"'
    ratio = (f"drive_damping_ratio = {{ value = {RATIO:g}, {source} }}",) if drive == "position" else ()
    text = json.dumps(file, ensure_ascii=False)
    limited = () if torque is None else (f"drive_torque_limit = {{ value = {torque:g}, source = {text} }}",)
    return DriveLines(
        limit,
        (
            f'drive = "{drive}"',
            f'drive_bandwidth = {{ value = "{LOOPS[drive]:g} Hz", tolerance = {TOLERANCE:g}, {source} }}',
            *ratio,
            *limited,
            f'drive_period = "{1e3 * PERIOD:g} ms"  # between two commands: that of your interface',
            f'drive_delay = "{1e3 * DELAY:g} ms"  # from a command to the loop: measure it',
        ),
    )


def loop_options(drive: str) -> str:
    """Options of a design that fit these lines; empty for other drives."""
    return f" --period {1e3 * PERIOD:g}ms --latency {round(DELAY / PERIOD)}" if drive in LOOPS else ""
