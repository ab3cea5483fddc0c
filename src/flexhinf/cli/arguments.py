"""Arguments and options of ``flexhinf design`` and ``flexhinf compare``, made from the fields of a specification."""

from __future__ import annotations

import functools
import inspect
import math
import warnings
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from flexhinf.cli.messages import note
from flexhinf.design.specification import BEHAVIOUR, FIELDS, NO_LIMIT, FieldInfo
from flexhinf.errors import InvalidInput

if TYPE_CHECKING:
    from flexhinf.design import DesignRequest

Robot = Annotated[
    str,
    typer.Argument(
        help="A robot file (arm.toml), a URDF, an MJCF file (arm.xml), a name that `flexhinf robots` lists, or a "
        "design file (design.toml); options win over a design file."
    ),
]
Out = Annotated[Path, typer.Option(help="Folder of the report; an earlier report there is replaced whole.")]
Elastic = Annotated[
    str, typer.Option(help="With a URDF or MJCF: the robot file with spring and motor of each joint.")
]

Payload = Annotated[
    str,
    typer.Option(
        help="What the robot carries: 2kg, a range 0..3kg (nominal at its lower end) or 0..1..3kg; @LINK where, "
        ":x,y,z its centre of mass there (m). Default: the file's own.",
        metavar="<kg@link>",
    ),
]

PoseXyz = Annotated[
    str,
    typer.Option(
        "--pose-xyz",
        help="Goal of a point of the robot in the world, instead of --pose: 0.4,0,0.3 (m) or 400mm,0,300mm. The joints "
        "are found for it; out of reach is refused, a pose near a singular one told.",
        metavar="<x,y,z>",
    ),
]
Tool = Annotated[
    str,
    typer.Option(
        help="The point that --pose-xyz, and waypoints with columns x, y, z, are for: LINK:x,y,z, by the name of the "
        "link's joint, in the link's frame (m). Default: the origin of the last link.",
        metavar="<link:x,y,z>",
    ),
]

#: Options for the largest input, and the drive that each is for.
PEAKS = {"peak_effort": "", "peak_voltage": "voltage", "peak_current": "current", "peak_torque": "torque"}
PEAK_HELP = {
    "peak_voltage": "--peak-effort of voltage-driven motors, V.",
    "peak_current": "--peak-effort of current-driven motors, A.",
    "peak_torque": "--peak-effort of torque-driven motors, N·m or N.",
}


def with_specification(*without: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """A decorator that gives a command an option for every field of a specification except those in `without`.

    The command's last parameter is ``**options``. All options hold text, flags and lists of text; `request_of` reads
    them. An empty text takes back what a design file says.
    """
    options = [one for name, field in FIELDS.items() if name not in without for one in _parameters(field)]

    def decorated(command: Callable[..., None]) -> Callable[..., None]:
        own = inspect.signature(command, eval_str=True)
        kept = [p for p in own.parameters.values() if p.kind is not inspect.Parameter.VAR_KEYWORD]

        @functools.wraps(command, updated=())
        def run(**values: Any) -> None:
            command(**values)

        del run.__dict__["__wrapped__"]
        run.__annotations__ = {}
        run.__dict__["__signature__"] = own.replace(parameters=[*kept, *options])
        return run

    return decorated


def _parameters(field: FieldInfo) -> list[inspect.Parameter]:
    about, default = field.about, field.default
    texts = [about.help.replace("[", r"\["), f"0: {about.zero}." if about.zero else ""]
    texts.append(f"Default: {about.default}." if about.default else "")
    kind: Any = bool if isinstance(default, bool) else list[str] if field.name == "via" else str
    option = typer.Option(
        field.option,
        help=" ".join(text for text in texts if text),
        rich_help_panel=about.group,
        metavar=None if kind is bool else f"<{about.unit or 'value'}>",
        show_default=default is not None and default != (),
    )
    text = ",".join(default) if isinstance(default, tuple) else "" if default is None else str(default)
    value = default if kind is bool else [] if kind is not str else text
    found = [_parameter(field.name, kind, option, value)]
    if field.name == "peak_effort":
        found += [
            _parameter(name, str, typer.Option(help=text, rich_help_panel=BEHAVIOUR, show_default=False), "")
            for name, text in PEAK_HELP.items()
        ]
    return found


def _parameter(name: str, kind: Any, option: Any, default: Any) -> inspect.Parameter:
    keyword = inspect.Parameter.KEYWORD_ONLY
    return inspect.Parameter(name, keyword, default=default, annotation=Annotated[kind, option])


# Reading --------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class CommandRequest:
    """What a command is asked for.

    Attributes
    ----------
    warnings : list of str
        Of the robot's file; they belong into the report.
    """

    request: DesignRequest
    warnings: list[str]


def request_of(
    context: typer.Context, source: str, elastic: str, payload: str, goal: str = "", tool: str = ""
) -> CommandRequest:
    """Robot and specification of a command; prints notes.

    Raises
    ------
    InvalidInput
        For a file or an option that cannot be used.
    """
    read = read_source(source, elastic, _fields(context), payload, goal, tool)
    _check_drive(context, read.request.robot)
    return read


def read_source(
    source: str, elastic: str, fields: Mapping[str, Any], payload: str = "", goal: str = "", tool: str = ""
) -> CommandRequest:
    """Robot and specification of a file and of fields that win over it; prints notes, raises as `request_of`.

    Of a report's folder its design file is meant.
    """
    from flexhinf.design import read_request
    from flexhinf.design.cartesian import with_joints
    from flexhinf.design.design_file import meant_file
    from flexhinf.robot import RobotFileWarning

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", RobotFileWarning)
        request = with_joints(
            read_request(meant_file(source), elastic or None, fields, payload or None), goal, tool
        )
    found = [str(one.message) for one in caught if issubclass(one.category, RobotFileWarning)]
    for text in (*found, *request.notes):
        note(text)
    return CommandRequest(request, found)


def design_file_of(source: str) -> Path | None:
    """The design file that a source means, where it means one: beside it may be a controller."""
    from flexhinf.design.design_file import meant_file

    path = meant_file(source)
    return Path(path) if path.endswith(".toml") else None


def _fields(context: typer.Context) -> dict[str, Any]:
    """Fields of the specification by name, of the options that were given."""
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
    return {name: _value(FIELDS[name], value) for name, value in stated.items() if name in FIELDS}


def _value(field: FieldInfo, value: Any) -> Any:
    """The value of an option; None for an empty text and for a zero that stands for the default, infinity for one that
    stands for no limit."""
    if isinstance(value, bool):
        return value
    if isinstance(value, list):
        return [text for text in value if text]
    try:
        zero = bool(field.about.zero) and float(value) == 0.0
    except ValueError:
        zero = False
    if zero and field.about.zero == NO_LIMIT:
        return math.inf
    return None if zero or not value.strip() else value


def _check_drive(context: typer.Context, robot: Any) -> None:
    """Refuse volts for a robot that is driven by torques, and so on."""
    fitting = next(name for name, drive in PEAKS.items() if drive == robot.drive)
    for name, drive in PEAKS.items():
        if drive and drive != robot.drive and name in _stated(context):
            raise InvalidInput(
                f"--peak-{drive} does not fit the robot {robot.name!r}, whose motors are driven by {robot.drive}.",
                f"expected {_options([fitting])} or --peak-effort, got --peak-{drive} {context.params[name]}",
                f"{_options([fitting])} …",
            )


def reproduce_command(context: typer.Context, without: Collection[str] = ()) -> list[str]:
    """The words of the command that makes the same report again; without some parameters, by name."""
    found = context.command_path.split()
    stated = _stated(context)
    for parameter in context.command.params:
        value = stated.get(str(parameter.name))
        if value is None or parameter.name in without:
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
