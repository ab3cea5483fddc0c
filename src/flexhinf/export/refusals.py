"""What is refused before a controller leaves for a machine: inputs that nothing limits, too little room."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress

import numpy as np

from flexhinf.errors import refuse_if
from flexhinf.estimation import UnscentedKalmanFilter
from flexhinf.export.compiled import cortex_m4_bytes
from flexhinf.export.contract import unlimited_inputs
from flexhinf.export.controller_c import code_of
from flexhinf.loop import Controller
from flexhinf.modal import ModalLaw
from flexhinf.validation import value_text


def check_limits(controller: Controller) -> None:
    """Refuse a controller with an input that lacks a limit: nothing would stand between an error and the drives."""
    estimator = controller.estimator
    refuse_unlimited(unlimited_inputs(controller), {} if estimator is None else estimator.plant.units)


def narrowed(controller: Controller, limit: float) -> Controller:
    """The controller whose inputs all have this limit, in their unit, which is narrower than that of each.

    Raises InvalidInput where it is not, or where the input that holds the robot at the start is beyond it.
    """
    limits, held = controller.limits, np.abs(controller.input_before()).max()
    widest = float(np.minimum(-limits.lower, limits.upper).min())
    refuse_if(
        not held < limit < widest,
        "These limits of the inputs are not narrower, or do not hold the robot.",
        f"expected more than {held:g}, which holds it at the start, and less than the design's {widest:g}, "
        f"got {limit:g}",
        f"--narrower {0.5 * (held + widest) if np.isfinite(widest) else 2.0 * held:g}",
    )
    return controller.fresh(saturation=limit)


def refuse_unlimited(free: Sequence[str], units: Mapping[str, str]) -> None:
    """Refuse inputs of these names, if there are any, as ones that nothing limits; `units`: by signal."""
    refuse_if(
        free,
        f"Nothing limits {', '.join(free)}: the controller may ask for any value.",
        "expected a lower and an upper limit of every input, which the drives can take; the robot file and the design "
        "state none",
        f"{limiting(free, units)}, and design again; --no-limits (limits=False) exports without",
    )


def limiting(free: Sequence[str], units: Mapping[str, str]) -> str:
    """The ways to limit inputs of these names."""
    unit = " or ".join(sorted({units.get(name, "V or N·m") for name in free}))
    return f"effort_limit = 48.0, in {unit}, in each [[joint]] of the robot file, or saturation=48.0"


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
    if not (flash or ram):
        return ""
    code = code_of(controller, "controller", real)
    whole, constants = cortex_m4_bytes(code) if flash else None, code.constants * code.real.bytes
    kind, where = (
        ("constants", "") if whole is None else ("code and constants", ", compiled for a Cortex-M4F")
    )
    law = (
        [] if isinstance(controller.law, ModalLaw) else ["--degrees 2 at the design"]
    )  # that is linear already
    filter = (
        ["--estimator ekf at the design"] if isinstance(controller.estimator, UnscentedKalmanFilter) else []
    )
    smaller = [] if real == "float" else ["--real float"]
    code_advice, state_advice = (
        ", ".join([*smaller, *less]) or "a larger device" for less in (law, filter + law)
    )
    rows = (
        ("--flash", flash, f"{kind} need", constants if whole is None else whole, where, code_advice),
        ("--ram", ram, "state needs", code.state_bytes, "", state_advice),
    )
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
