"""What the command line states: fields of a specification, and the words that make the same report again."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import typer

from flexhinf.cli.values import angles, bandwidths, names, numbers, unless, weights
from flexhinf.errors import InvalidInput

__all__ = ["PEAKS", "check_drive", "fields", "words"]

#: How a field is read from what its option holds; options that are not here hold what the field does.
READ: dict[str, Callable[[Any], Any]] = {
    "pose": lambda text: angles("pose", text) if text else None,
    "start": lambda text: angles("start pose", text) if text else None,
    "via": lambda texts: tuple(angles("pose on the way", text) for text in texts if text),
    "preset": lambda text: text or None,
    "bandwidth": bandwidths,
    "peak_effort": lambda value: unless(0.0, value),
    "penalty": lambda text: weights("penalty", text),
    "effort": lambda value: unless(0.0, value),
    "checked_penalty": lambda text: weights("checked penalty", text),
    "degrees": lambda text: numbers("degrees", text, int, "2,4,6") if text else None,
    "measured": names,
    "disturbances": lambda text: names(text) or None,
    "saturation": lambda value: unless(0.0, value),
    "extras": names,
    "draws": lambda value: unless(-1, value),
    "rays": lambda value: unless(-1, value),
    "duration": lambda value: unless(0.0, value),
}

#: Options for the peak of the input, and the drive that each is for.
PEAKS = {"peak_effort": "", "peak_voltage": "voltage", "peak_torque": "torque"}


def fields(context: typer.Context) -> dict[str, Any]:
    """Fields of the specification by name, of the options that were given.

    Raises
    ------
    InvalidInput
        If a value cannot be read, or the peak of the input is given twice.
    """
    from flexhinf.design.specification import Specification

    stated = _stated(context)
    peaks = [name for name in PEAKS if name in stated]
    if len(peaks) > 1:
        raise InvalidInput(
            "The peak of the input is given twice.",
            f"expected one of {_options(PEAKS)}, got {_options(peaks)}",
            "leave out one of them",
        )
    if peaks:
        stated["peak_effort"] = stated.pop(peaks[0])
    known = Specification.__dataclass_fields__
    return {name: READ.get(name, _same)(value) for name, value in stated.items() if name in known}


def check_drive(context: typer.Context, robot: Any) -> None:
    """Refuse volts for a robot that is driven by torques, and torques for one that is driven by volts.

    Raises
    ------
    InvalidInput
        With the option that fits.
    """
    fitting = next(name for name, drive in PEAKS.items() if drive == robot.drive)
    for name, drive in PEAKS.items():
        if drive and drive != robot.drive and name in _stated(context):
            raise InvalidInput(
                f"--peak-{drive} does not fit the robot {robot.name!r}, whose motors are driven by {robot.drive}.",
                f"expected {_options([fitting])} or --peak-effort, got --peak-{drive} {context.params[name]:g}",
                f"{_options([fitting])} …",
            )


def words(context: typer.Context) -> list[str]:
    """The words that make the same report again."""
    found = context.command_path.split()
    stated = _stated(context)
    for parameter in context.command.params:
        value = stated.get(str(parameter.name))
        if value is None:
            continue
        if parameter.param_type_name == "argument":
            found.append(str(value))
        elif isinstance(value, bool):
            found.append((parameter.opts if value else parameter.secondary_opts)[0])
        else:
            for one in value if isinstance(value, (list, tuple)) else [value]:
                found += [parameter.opts[0], one.name if isinstance(one, Path) else str(one)]
    return found


def _stated(context: typer.Context) -> dict[str, Any]:
    """What is not a default, by the name of the parameter."""
    found = {}
    for name, value in context.params.items():
        source = context.get_parameter_source(name)
        if source is not None and source.name != "DEFAULT":
            found[name] = value
    return found


def _options(parameters: Any) -> str:
    return ", ".join(f"--{name.replace('_', '-')}" for name in parameters)


def _same(value: Any) -> Any:
    return value
