"""Lines of a robot file about drives: of those with a loop of their own, as estimates, and of motors with constants.

A servo's loop of position has some 20 Hz, one of velocity some 60 Hz; fieldbuses take a command every 1 to 8 ms and act
on it one or two commands later (docs/drives.md).
"""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import NamedTuple

from flexhinf.robot.drives import DRIVES, DriveKind
from flexhinf.robot.estimates import EstimatedJoint
from flexhinf.robot.mjcf_actuators import DcMotor
from flexhinf.robot.parameters import ESTIMATE

#: Time between two commands, and from a command to the loop, s.
PERIOD, DELAY = 4e-3, 8e-3

#: Damping ratio of a position loop; the bandwidth's tolerance, per cent.
RATIO, TOLERANCE = 0.9, 30.0

#: Largest command over the joint's range or speed: what a law may add to the planned one.
ROOM = 1.2


class DriveLines(NamedTuple):
    """What stands in [[joint]], the line about its largest command, and in [joint.motor]; whether the constants there
    are those before the gear, whose ratio is stated too."""

    limit: str
    motor: tuple[str, ...]
    before_gear: bool = False


def drive_lines(
    drive: DriveKind,
    limits: tuple[float, float] | None,
    speed: float,
    slides: bool,
    torque: float | None = None,
    file: str = "",
) -> DriveLines:
    """Lines for a joint of a range, rad or m, and a speed, rad/s or m/s; no limit where none is stated. `torque`: the
    motor's largest, N·m or N, which `file` states."""
    largest = speed if drive.takes_velocities else float("inf")
    if drive.takes_positions and limits:
        largest = max(map(abs, limits))
    unit = drive.units[slides]
    limit = (
        f"effort_limit = {ROOM * largest:.4g}  # {unit}, the largest command"
        if largest < float("inf")
        else ""
    )
    source = f'source = "{ESTIMATE}: of a usual servo"'
    stated = "drive_damping_ratio" in drive.loop
    ratio = (f"drive_damping_ratio = {{ value = {RATIO:g}, {source} }}",) if stated else ()
    text = json.dumps(file, ensure_ascii=False)
    limited = () if torque is None else (f"drive_torque_limit = {{ value = {torque:g}, source = {text} }}",)
    return DriveLines(
        limit,
        (
            f'drive = "{drive.name}"',
            f'drive_bandwidth = {{ value = "{drive.usual_bandwidth:g} Hz", tolerance = {TOLERANCE:g}, {source} }}',
            *ratio,
            *limited,
            f'drive_period = "{1e3 * PERIOD:g} ms"  # between two commands: that of your interface',
            f'drive_delay = "{1e3 * DELAY:g} ms"  # from a command to the loop: measure it',
        ),
    )


def electrical_lines(
    motor: DcMotor, drive: DriveKind, guess: EstimatedJoint, file: str, coils: bool
) -> DriveLines:
    """Lines for a joint whose motor takes a voltage or a current; `file` states its constants, `coils` inductances too.

    Its largest voltage is the one that holds the largest torque at rest, where no smaller one is stated.
    """
    constant, resistance = motor.electrical["torque_constant"], motor.electrical["resistance"]
    torque = min(motor.torque, motor.voltage * constant / resistance)
    p = SimpleNamespace(**motor.electrical)
    limit, guessed = (
        float(drive.holding_input(load, p)) for load in (torque, guess.effort / motor.gear_ratio)
    )
    known = limit < float("inf")
    why = f"of {file}" if known else f"{ESTIMATE}: twice what weight asks for"
    usable = (*drive.constants, *(("inductance",) if coils and drive.coil else ()))
    names = [name for name in motor.electrical if name in usable]
    source = f"source = {json.dumps(file, ensure_ascii=False)}"
    return DriveLines(
        f"effort_limit = {limit if known else guessed:.4g}  # {drive.units[0]}, {why}",
        tuple(f"{name} = {{ value = {motor.electrical[name]:.6g}, {source} }}" for name in names),
        before_gear=True,
    )


def loop_options(drive: str) -> str:
    """Options of a design that fit these lines; empty for other drives."""
    return f" --period {1e3 * PERIOD:g}ms --latency {round(DELAY / PERIOD)}" if DRIVES[drive].inner else ""
