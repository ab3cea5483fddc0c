"""What is refused before a controller leaves for a machine: inputs that nothing limits, too little room."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np

from flexhinf.errors import refuse_if
from flexhinf.export.compiled import cortex_m4_bytes
from flexhinf.export.contract import unlimited_inputs
from flexhinf.export.controller_c import code_of
from flexhinf.loop import Controller
from flexhinf.validation import value_text

if TYPE_CHECKING:
    from flexhinf.robot import Robot


def check_limits(controller: Controller) -> None:
    """Refuse a controller with an input that lacks a limit: nothing would stand between an error and the drives."""
    estimator = controller.estimator
    refuse_unlimited(unlimited_inputs(controller), {} if estimator is None else estimator.plant.units)


def refuse_unlimited(free: Sequence[str], units: Mapping[str, str]) -> None:
    """Refuse inputs of these names, if there are any, as ones that nothing limits; `units`: by signal."""
    refuse_if(
        free,
        f"Nothing limits {', '.join(free)}: the controller may ask for any value.",
        "expected a lower and an upper limit of every input, which the drives can take; the robot file and the design "
        "state none",
        f"effort_limit = 48.0, in {' or '.join(sorted({units.get(name, 'V or N·m') for name in free}))}, in each "
        "[[joint]] of the robot file, or saturation=48.0, and design again; --no-limits "
        "(limits=False) exports without",
    )


#: How many standard deviations of a sensor's noise a plausible measurement may be beyond a limit.
NOISE = 6.0


def with_measurement_limits(controller: Controller, robot: Robot | None) -> Controller:
    """The same controller, for which a measurement beyond the robot's ranges or speed limits is missing.

    Positions of links are within the joints' ranges, positions of links and motors no faster than the speed limits, and
    velocities within these; with room for `NOISE` standard deviations of the estimator's measurement noise.

    Raises InvalidInput: without a robot or an estimator, or where the robot states no limit of what is measured.
    """
    rows, estimator = [(-np.inf, np.inf, np.inf)] * len(controller.measured), controller.estimator
    if robot is not None and estimator is not None and robot.speed_limits is not None:
        noise = NOISE * np.sqrt(np.diag(np.atleast_2d(estimator.measurement_noise)))
        rows = [
            _plausible(name, room, robot, controller.period) for name, room in zip(controller.measured, noise)
        ]
    refuse_if(
        not np.isfinite(rows).any(),
        "Nothing says which measurements are plausible.",
        "expected an estimator, and a robot file that states limits or a speed_limit of a joint that is measured; got "
        + (
            "no estimator"
            if estimator is None
            else "no robot"
            if robot is None
            else f"none of {robot.name!r}"
        ),
        "speed_limit = 4.0 and limits = [-3.0, 3.0] in each [[joint]] of the robot file; in Python "
        "Controller(..., measurement_limits=(lower, upper, rate)); or leave out --check-measurements",
    )
    return controller.fresh(measurement_limits=tuple(np.transpose(rows)))


def _plausible(name: str, noise: float, robot: Robot, period: float) -> tuple[float, float, float]:
    """Least and largest measurement, and largest change per s."""
    from flexhinf.robot.parameters import per_joint

    joints = robot.joint_names
    low, high = robot.plant().limits.get(name, (-np.inf, np.inf))
    for part in ("link", "motor"):
        for joint, speed in zip(joints, robot.speed_limits or (), strict=True):
            limit = np.inf if speed is None else speed
            if name == per_joint(f"{part}_velocity", joint, len(joints)):
                return -limit - noise, limit + noise, np.inf
            if name == per_joint(f"{part}_position", joint, len(joints)):
                return low - noise, high + noise, limit + np.sqrt(2.0) * noise / period
    return low, high, np.inf


def check_room(controller: Controller, real: str, period: str = "", flash: str = "", ram: str = "") -> str:
    """Refuse a controller that does not fit a firmware; a note on what could not be counted, or "".

    `period`: Of the firmware's loop, such as "1ms"; empty for any. `flash`, `ram`: Room for
    code and constants, and for the state, such as "32kB"; empty for any. The code is counted for a Cortex-M4F where
    arm-none-eabi-gcc is installed. Raises InvalidInput: if the period is another one, or code, constants or state are
    larger.
    """
    refuse_if(
        period and abs(_quantity(period, SECONDS) - controller.period) > 1e-9 * controller.period,
        "The firmware's period is not the controller's.",
        f"expected {controller.period:g} s, for which law and estimator are made, got {value_text(period)}",
        "a design with --period of that length",
    )
    code = code_of(controller, "controller", real)
    whole, constants = cortex_m4_bytes(code) if flash else None, code.constants * code.real.bytes
    kind, where = (
        ("constants", "") if whole is None else ("code and constants", ", compiled for a Cortex-M4F")
    )
    rows = (
        ("--flash", flash, f"{kind} need", constants if whole is None else whole, where,
         "--degrees 2 at the design, --real float"),
        ("--ram", ram, "state needs", code.state_bytes, "",
         "--real float, an extended Kalman filter (--estimator ekf), --degrees 2"),
    )  # fmt: skip
    for option, stated, what, needed, where, advice in rows:
        refuse_if(
            stated and needed > _quantity(stated, BYTES),
            f"The controller does not fit: its {what} more room.",
            f"expected at most {value_text(stated)} ({option}), got {needed} bytes in the type {real}{where}",
            advice,
        )
    return NOT_COUNTED.format(constants) if flash and whole is None else ""


#: What --flash says where the code cannot be compiled.
NOT_COUNTED = (
    "--flash was compared with the constants alone, {} bytes: the code is counted where arm-none-eabi-gcc is "
    "installed, and is usually several times as large."
)


#: Units of times and sizes.
SECONDS = {"": 1.0, "s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6}
BYTES = {"": 1.0, "b": 1.0, "kb": 1e3, "kib": 1024.0, "mb": 1e6, "mib": 1024.0**2}


def _quantity(text: str, units: Mapping[str, float]) -> float:
    match = re.fullmatch(r"\s*([0-9.]+(?:e[-+]?[0-9]+)?)\s*([a-zµ]*)\s*", text.lower())
    value = -1.0
    with suppress(ValueError, KeyError):
        value = float(match.group(1)) * units[match.group(2)] if match else value
    refuse_if(
        not 0.0 < value < 1e30,
        "This is no positive quantity.",
        f"expected a number and one of {', '.join(unit for unit in units if unit)}, got {value_text(text)}",
        f"1{list(units)[2]}",
    )
    return value
