"""Arguments and options of the commands, made from their declarations, and what they say."""

from __future__ import annotations

import inspect
import math
import warnings
from collections.abc import Callable, Collection, Mapping
from dataclasses import MISSING, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from flexhinf.cli.messages import note
from flexhinf.cli.options import PEAKS, PointOptions
from flexhinf.design.options import GROUPS, LIMITS, NO_LIMIT, About, FieldInfo, declared, option_name, refused
from flexhinf.design.specification import FIELDS
from flexhinf.errors import InvalidInput

if TYPE_CHECKING:
    from flexhinf.design import DesignRequest


def with_options(options: type, fields: Collection[str] = ()) -> Callable[[Any], Any]:
    """A decorator for ``command(context, o)``: its options are those of a class and of fields of a specification.

    All of them are read as text; the command gets the values of the class. An empty text takes back what a design
    file says.

    `options`: A dataclass of `flexhinf.cli.options`. Where it declares a field of a specification again, its help is
        shown.
    `fields`: fields of a specification that the command computes with.
    """
    own = declared(options)
    known = {name: FIELDS[name] for name in fields} | own
    order = {group: k for k, group in enumerate(("", *GROUPS))}
    parameters = [inspect.Parameter("context", inspect.Parameter.KEYWORD_ONLY, annotation=typer.Context)]
    for field in sorted(known.values(), key=lambda field: order[field.about.group]):
        parameters.append(_parameter(field, both=field.name not in own or field.default is True))
        for name, (drive, unit) in PEAKS.items() if field.name == "peak_effort" else ():
            about = About(LIMITS, f"--peak-effort of {drive}-driven motors.", unit=unit)
            parameters.append(_parameter(FieldInfo(name, about, str, "", "", option_name(name)), both=True))

    def decorated(command: Callable[..., None]) -> Any:
        def run(context: typer.Context, **values: Any) -> None:
            stated = stated_options(context).items()
            read = {name: _value(own[name], value) for name, value in stated if name in own}
            command(context, options(**{name: value for name, value in read.items() if value is not None}))

        run.__name__, run.__doc__, run.__module__ = command.__name__, command.__doc__, command.__module__
        run.__dict__.update(
            __signature__=inspect.Signature(parameters), options=known, fields=tuple(fields), own=options
        )
        return run

    return decorated


def _parameter(field: FieldInfo, both: bool) -> inspect.Parameter:
    """The parameter of a field; of a flag with ``--no-…`` where `both` is wanted."""
    about, default = field.about, field.default
    kind: Any = (
        bool if isinstance(default, bool) else list[str] if field.several or field.name == "via" else str
    )
    value: Any = [] if kind == list[str] else default
    if kind is str and default is not MISSING:
        value = ",".join(default) if isinstance(default, tuple) else "" if default is None else str(default)
    help = about.text.replace("[", r"\[")
    if not about.group:
        shape = typer.Argument(help=help, metavar=about.unit or None, show_default=False)
    else:
        shape = typer.Option(
            field.option if both else field.option.partition("/")[0], help=help, rich_help_panel=about.group,
            metavar=None if kind is bool else f"<{about.unit or 'value'}>", show_default=bool(value) or default == 0,
        )  # fmt: skip
    value = inspect.Parameter.empty if value is MISSING else value
    keyword = inspect.Parameter.KEYWORD_ONLY
    return inspect.Parameter(field.name, keyword, default=value, annotation=Annotated[kind, shape])


def request_of(context: typer.Context, o: PointOptions, source: str, elastic: str = "") -> DesignRequest:
    """Robot and specification of a command, whose options win over a design file; prints notes."""
    stated = stated_options(context)
    peaks = [name for name in ("peak_effort", *PEAKS) if name in stated]
    if len(peaks) > 1:
        names, got = (", ".join(map(option_name, some)) for some in (("peak_effort", *PEAKS), peaks))
        raise InvalidInput(
            "The peak of the input is given twice.",
            f"expected one of {names}, got {got}",
            "leave out one of them",
        )
    if peaks:
        stated["peak_effort"] = stated.pop(peaks[0])
    fields = {name: _text(FIELDS[name], stated[name]) for name in _command(context).fields if name in stated}
    request = read_source(source, elastic, fields, o.payload, o.pose_xyz, o.tool)
    robot, fitting = request.robot, {drive: name for name, (drive, _) in PEAKS.items()}
    drive = PEAKS[peaks[0]][0] if peaks and peaks[0] in PEAKS else robot.drive
    if drive != robot.drive:  # volts for a robot that is driven by torques, and so on
        right = option_name(fitting[robot.drive])
        raise InvalidInput(
            f"--peak-{drive} does not fit the robot {robot.name!r}, whose motors are driven by {robot.drive}.",
            f"expected {right} or --peak-effort, got --peak-{drive} {context.params[peaks[0]]}",
            f"{right} …",
        )
    return request


def read_source(
    source: str, elastic: str, fields: Mapping[str, Any], payload: str = "", goal: str = "", tool: str = ""
) -> DesignRequest:
    """Robot and specification of a file and of fields that win over it; prints notes, raises as `request_of`.

    Of a report's folder its design file is meant.
    """
    from flexhinf.design import read_request
    from flexhinf.design.design_file import meant_file, with_joints
    from flexhinf.robot import RobotFileWarning

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", RobotFileWarning)
        request = read_request(meant_file(source), elastic or None, fields, payload or None)
        request = with_joints(request, goal, tool)
    texts = [str(record.message) for record in caught if issubclass(record.category, RobotFileWarning)]
    for text in (*texts, *request.notes):
        note(text)
    return replace(request, warnings=tuple(texts))


def design_file_of(source: str) -> Path | None:
    """The design file that a source names, beside which a controller may be; None where it names no such file."""
    from flexhinf.design.design_file import meant_file

    path = meant_file(source)
    return Path(path) if path.endswith(".toml") else None


def _text(field: FieldInfo, value: Any) -> Any:
    """The text of an option; None for an empty one and for a zero that stands for the default, infinity for one that
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


def _value(field: FieldInfo, value: Any) -> Any:
    """Value of a command's own option; a refusal is in the syntax of the command line."""
    text = value if field.is_path or not field.about.group else _text(field, value)
    try:
        return None if text is None else field.read(text)
    except InvalidInput as error:
        if error.what != refused(field.name):
            raise
        name = option_name(field.name)
        raise InvalidInput(f"{name} cannot be used.", error.found, f"{name} {error.advice}") from None


def reproduce_command(context: typer.Context, without: Collection[str] = ()) -> list[str]:
    """The command that makes the same report again, as a list of arguments; `without` the parameters of these names."""
    parts, options, stated = context.command_path.split(), _command(context).options, stated_options(context)
    for parameter in context.command.params:
        name = str(parameter.name)
        value = stated.get(name)
        if value is None or name in without:
            continue
        values = value if isinstance(value, (list, tuple)) else [value]
        if name in options and options[name].is_path and options[name].about.group:
            values = [Path(path).name for path in values]
        if isinstance(value, bool):
            parts.append((parameter.opts if value else parameter.secondary_opts)[0])
        elif parameter.param_type_name == "argument":
            parts += map(str, values)
        else:
            parts += [text for entry in values for text in (parameter.opts[0], str(entry))]
    return parts


def _command(context: typer.Context) -> Any:
    return inspect.unwrap(context.command.callback)  # type: ignore[arg-type]


def stated_options(context: typer.Context) -> dict[str, Any]:
    """Values of the options that the user stated, by the name of the parameter."""
    sources = {name: context.get_parameter_source(name) for name in context.params}
    return {
        name: context.params[name] for name, source in sources.items() if source and source.name != "DEFAULT"
    }
