"""Arguments and options of the commands, made from their declarations; options without effect; what commands say.

Errors in three parts in the command line's own syntax, notes and progress go to standard error; exit codes.
"""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import MISSING, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.exceptions import TyperException
from typer.models import OptionInfo

from flexhinf.cli.options import PEAKS, SELDOM, SEVERAL, USUAL_FIELDS, PointOptions
from flexhinf.design.specification import FIELDS, OF_WORKSPACE, SpecificationError
from flexhinf.errors import FlexhinfError, InvalidInput, refuse_if
from flexhinf.options import (
    ADVANCED,
    GROUPS,
    LIMITS,
    NO_LIMIT,
    About,
    FieldInfo,
    declared,
    option_name,
    refused,
)

if TYPE_CHECKING:
    from flexhinf.design import DesignRequest
    from flexhinf.design.specification import Specification
    from flexhinf.robot import Robot


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
    if len(parameters) > SEVERAL:
        seldom = {*SELDOM, *(name for name in fields if name not in own and name not in USUAL_FIELDS)}
        parameters.append(_shortened(parameters, seldom))

    def decorated(command: Callable[..., int | None]) -> Any:
        def run(context: typer.Context, **values: Any) -> int | None:
            stated = stated_options(context).items()
            read = {name: _value(own[name], value) for name, value in stated if name in own}
            return command(context, options(**{k: value for k, value in read.items() if value is not None}))

        run.__name__, run.__doc__, run.__module__ = command.__name__, command.__doc__, command.__module__
        run.__dict__.update(
            __signature__=inspect.Signature(parameters), options=known, fields=tuple(fields), own=options
        )
        return run

    return decorated


# `both`: also ``--no-…`` of a flag
def _parameter(field: FieldInfo, both: bool) -> inspect.Parameter:
    about, value = field.about, field.default
    kind: Any = (
        bool if isinstance(value, bool) else list[str] if field.several or field.name == "via" else str
    )
    if kind == list[str]:
        value = []
    elif kind is str and value is not MISSING:
        value = ",".join(value) if isinstance(value, tuple) else "" if value is None else str(value)
    help = about.text.replace("[", r"\[")
    shape = typer.Argument(help=help, metavar=about.unit or None, show_default=False)
    if about.group:
        shape = typer.Option(
            field.option if both else field.option.partition("/")[0],
            help=help,
            rich_help_panel=about.group,
            metavar=None if kind is bool else f"<{about.unit or 'value'}>",
            show_default=bool(value) or field.default == 0,
        )
    value = inspect.Parameter.empty if value is MISSING else value
    keyword = inspect.Parameter.KEYWORD_ONLY
    return inspect.Parameter(field.name, keyword, default=value, annotation=Annotated[kind, shape])


def _shortened(parameters: Iterable[inspect.Parameter], seldom: Collection[str]) -> inspect.Parameter:
    """Hide options that are seldom used, and all but the first sentence on the others; returns the option that shows
    everything."""
    options = {
        each.name: option
        for each in parameters
        for option in getattr(each.annotation, "__metadata__", ())
        if isinstance(option, OptionInfo)
    }
    texts = {name: option.help for name, option in options.items()}
    for name, option in options.items():
        option.hidden = name in seldom
        option.help = re.split(r"(?<=\.) (?=[A-Z])", str(option.help))[0]

    def show(context: typer.Context, value: bool) -> None:
        if value:
            for parameter in context.command.params:
                if parameter.name in texts:
                    vars(parameter).update(hidden=False, help=texts[parameter.name])
            typer.echo(context.get_help())
            raise typer.Exit()

    count = sum(option.hidden for option in options.values())
    text = f"Show all of this, and {count} more options."
    option = typer.Option("--help-all", help=text, is_eager=True, callback=show, rich_help_panel=ADVANCED)
    keyword = inspect.Parameter.KEYWORD_ONLY
    return inspect.Parameter("help_all", keyword, default=False, annotation=Annotated[bool, option])


def request_of(context: typer.Context, o: PointOptions, source: str, elastic: str = "") -> DesignRequest:
    """Robot and specification of a command, whose options win over a design file; prints notes."""
    stated, names = stated_options(context), ("peak_effort", *PEAKS)
    peaks = [name for name in names if name in stated]
    refuse_if(
        len(peaks) > 1,
        "The peak of the input is given twice.",
        f"expected one of {', '.join(map(option_name, names))}, got {', '.join(map(option_name, peaks))}",
        "leave out one of them",
    )
    if peaks:
        stated["peak_effort"] = stated.pop(peaks[0])
    request = read_source(source, elastic, _stated_fields(context, stated), o.payload, o.pose_xyz, o.tool)
    if context.info_name != "run":  # which needs both: the workspace of its controller, and a goal
        request = _of_pose_stated(request, stated)
    robot, right = request.robot, f"--peak-{request.robot.drive}"
    for name in peaks[:1]:  # volts for a robot that is driven by torques, and so on
        refuse_if(
            name in PEAKS and option_name(name) != right,
            f"{option_name(name)} does not fit the robot {robot.name!r}, whose motors are driven by {robot.drive}.",
            f"expected {right} or --peak-effort, got {option_name(name)} {context.params[name]}",
            f"{right} …",
        )
    return request


def stated_fields(context: typer.Context) -> dict[str, Any]:
    """Fields of a specification that options of a command state, as texts; see `read_source`."""
    return _stated_fields(context, stated_options(context))


def _stated_fields(context: typer.Context, stated: Mapping[str, Any]) -> dict[str, Any]:
    return {name: _text(FIELDS[name], stated[name]) for name in _command(context).fields if name in stated}


def _of_pose_stated(request: DesignRequest, stated: Collection[str]) -> DesignRequest:
    """The request of one pose where an option that only a design of one pose reads is stated and a design file is for
    a workspace."""
    s = request.specification
    own = [name for name in s.pose_fields_stated if {name, *("pose_xyz",) * (name == "pose")} & {*stated}]
    if s.workspace is None or not own or "workspace" in stated:
        return request
    note(f"{'design.toml' if request.file is None else request.file.name}: workspace gives way to `{own[0]}`")
    return replace(request, specification=replace(s, workspace=None))


def refuse_idle(context: typer.Context, request: DesignRequest, **options: bool) -> None:
    """Refuse options that cannot change what a command computes of this request; `options` as for `without_effect`."""
    command = str(context.info_name)
    refuse_stated(context, without_effect(command, request.robot, request.specification, **options))


def refuse_stated(context: typer.Context, idle: Mapping[str, str]) -> None:
    """Refuse options that are stated and have no effect; `idle`: by name, what each would act on."""
    for name in stated_options(context):
        refuse_if(
            needs := idle.get("peak_effort" if name in PEAKS else name, ""),
            f"{option_name(name)} has no effect on this {context.info_name}.",
            f"expected it with {needs}; got it without",
            f"leave out {option_name(name)}",
        )


# Options without effect. What is switched off (0, false, nothing) asks for nothing, and is never among them.
#: Fields of an estimator alone.
NOISES = ("process_noise", "torque_noise", "measurement_noise")

#: Fields that choose a law by the runs of its step alone, and those by which weights are searched for too.
STEPPED = ("shaping", "quantisation", "friction_model", "integral_dead_zone")
SEARCHED = (
    "start", "peak_effort", "peak_speed", "saturation", "peak_sensitivity", "gain_margin", "delay_margin",
    "estimator", *NOISES, "extras", "latency", "unknown_delay",
)  # fmt: skip

#: What fields of a step would act on, where no step is run.
RUNS = "several --degrees or a search for weights, by which runs of the step choose the law"


def without_effect(
    command: str, robot: Robot, s: Specification, *, tolerances: bool = False, observer: bool = False
) -> dict[str, str]:
    """Fields on which the result of ``design``, ``compare`` or ``certify`` does not depend, by name: what they act on.

    `tolerances`, `observer`: of ``certify``.
    """
    from flexhinf.design.problem.presets import preset_of
    from flexhinf.design.synthesis.by_step import STATES, rays_of

    if command == "design" and not s.pose_fields_stated:
        return _active(s, _of_workspace(robot, s))
    idle, preset, joints = _of_loop(robot, s), preset_of(robot, s), len(robot.joint_names)
    sampled = command == "design" and rays_of(STATES * joints, s.rays) > 0
    if s.estimator == "none" and not sampled and (not robot.uncertain or s.draws == 0):
        idle["seed"] = "an estimator, robots within their tolerances (--draws) or a sampled region (--rays)"
    if command == "design" and preset != "proved":
        if not sampled:
            idle |= dict.fromkeys(("checked_gamma_ratio", "checked_penalty"), "a sampled region (--rays)")
        if not sampled or joints > 1 or s.via:
            idle["proof_seconds"] = "a robot of one joint, one law (no --via) and a sampled region (--rays)"
    elif command == "compare" and preset != "proved":
        idle |= dict.fromkeys(("checked_penalty", "proof_seconds"), "--preset proved")
    elif command == "certify":
        idle |= _of_certificate(robot, s, preset, tolerances)
        if observer:
            idle.pop("measured", None)
    return _active(s, idle)


def without_effect_on_run(
    s: Specification, robot: Robot, noise: bool, commanded: bool, moving: bool = False
) -> dict[str, str]:
    """Fields on which a run of a finished controller does not depend, as `without_effect`.

    `noise`: whether measurements have noise. `commanded`: whether the controller takes a command. `moving`: whether it
    is for a workspace.
    """
    idle, random = _of_loop(robot, s), noise and s.estimator != "none"
    if not random:
        idle |= dict.fromkeys(("measurement_noise", "seed"), "noise of the measurements")
    if s.move is not None:
        idle |= dict.fromkeys(("pose", "start", "overshoot"), 'a step (--move "" takes back the move)')
    elif not commanded:
        idle["shaping"] = "a controller that takes a command: its penalty weighs link_position_integral"
    of_pose = dict.fromkeys(("shaping", "overshoot", "feedforward"), "a controller of one pose")
    return _active(s, idle) | (of_pose if moving else {})


def _active(s: Specification, idle: Mapping[str, str]) -> dict[str, str]:  # a seed of 0 is a seed
    return {name: needs for name, needs in idle.items() if name == "seed" or getattr(s, name)}


def _of_workspace(robot: Robot, s: Specification) -> dict[str, str]:
    kept = {"ripple"} | ({"estimator"} if s.estimator == "none" else set())
    idle = dict.fromkeys({*FIELDS} - {*OF_WORKSPACE} | {"estimator"}, "a design of one pose (--pose)")
    return {k: v for k, v in (_of_loop(robot, s) | idle).items() if k not in kept}


def _of_loop(robot: Robot, s: Specification) -> dict[str, str]:
    from flexhinf.design.responses import joint_limits
    from flexhinf.robot.elastic import DRY

    idle = {} if joint_limits(robot, s).limits_effort else {"ripple": "limits of the motors (--saturation)"}
    if s.move is None:
        idle["tracking_error"] = "a move (--move)"
    if s.disturbances is None:
        idle["command"] = "--disturbances: without them the command is the disturbance anyway"
    if s.estimator == "none":
        idle |= dict.fromkeys(("measured", *NOISES), "an estimator")
    if s.estimator not in ("ukf", "ekf") or not set(s.extras) & set(DRY):
        idle["friction_model"] = "the estimator ukf or ekf, and dry friction among --extras"
    if not robot.uncertain:
        idle["draws"] = "tolerances in the robot's file"
    if all(robot.links.slides):
        idle["angle_unit"] = "a joint that turns"
    return idle


def _of_certificate(robot: Robot, s: Specification, preset: str, tolerances: bool) -> dict[str, str]:
    from flexhinf.design.responses import joint_limits

    limits, proved = joint_limits(robot, s), preset == "proved"
    several = not proved and (s.degrees is None or len(s.degrees) > 1)
    chosen = several and not s.via  # the step chooses the degree
    searched = preset in ("damped", "robust", "proved")
    limited = limits.limits_effort if proved else searched and (limits.limits_peak or limits.limits_speed)
    run = chosen or limited or preset == "robust"
    names = [] if run else [*STEPPED, "seed"]
    if not run and (proved or not searched):
        left = {"start"} if tolerances or proved else set()
        left |= {"saturation"} if len(robot.joint_names) > 1 else set()  # the units of R2
        names += ["measured", *(name for name in SEARCHED if name not in left)]
    names += [] if chosen or (limited and not proved) else ["draws", "duration"]
    names += [] if chosen else ["overshoot"]
    idle = dict.fromkeys(names, RUNS)
    if s.move is None:
        idle["damped_below"] = "a move (--move), along which laws are scheduled"
    if not several:
        idle["via"] = "several --degrees, of which a law of several poses uses the lowest"
    if not proved:
        idle["proof_seconds"] = "--preset proved"
    elif limited:
        idle["peak_speed"] = "a preset that keeps limits of speeds"
    if tolerances:
        idle["checked_gamma_ratio"] = "a region of the nominal robot (without --tolerances)"
    return idle


def read_source(
    source: str, elastic: str, fields: Mapping[str, Any], payload: str = "", goal: str = "", tool: str = ""
) -> DesignRequest:
    """Robot and specification of a file and of fields that win over it; prints notes, raises as `request_of`.

    Of a report's folder its design file is meant.
    """
    from flexhinf.design.design_file import meant_file, read_request, with_joints
    from flexhinf.robot.parts import file_warnings

    with file_warnings(note) as texts:
        request = read_request(meant_file(source), elastic or None, fields, payload or None)
        request = with_joints(request, goal, tool)
    for text in request.notes:
        note(text)
    return replace(request, warnings=tuple(texts))


def _text(field: FieldInfo, value: Any) -> Any:
    """The text of an option; None for an empty one and for a zero that stands for the default, infinity for one that
    stands for no limit."""
    if isinstance(value, bool):
        return value
    if isinstance(value, list):
        return [text for text in value if text]
    zero = False
    with suppress(ValueError):
        zero = bool(field.about.zero) and float(value) == 0.0
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
    """The command that makes the same report again, as a list of arguments; `without` the parameters of these names,
    and without --verbose."""
    parts, options, stated = context.command_path.split(), _command(context).options, stated_options(context)
    for parameter in context.command.params:
        name = str(parameter.name)
        value = stated.get(name)
        if value is None or name in (*without, "verbose"):
            continue
        values = value if isinstance(value, (list, tuple)) else [value]
        if name in options and options[name].is_path and options[name].about.group:
            values = [Path(path).name for path in values]
        if isinstance(value, bool):
            parts.append((parameter.opts if value else parameter.secondary_opts)[0])
        else:
            flag = [] if parameter.param_type_name == "argument" else [parameter.opts[0]]
            parts += [text for entry in values for text in (*flag, str(entry))]
    return parts


def _command(context: typer.Context) -> Any:
    return inspect.unwrap(context.command.callback)  # type: ignore[arg-type]


def stated_options(context: typer.Context) -> dict[str, Any]:
    """Values of the options that the user stated, by the name of the parameter."""
    sources = {name: context.get_parameter_source(name) for name in context.params}
    return {
        name: context.params[name] for name, source in sources.items() if source and source.name != "DEFAULT"
    }


#: Exit codes: the report is written and says that the specification is not met; everything the user can put right;
#: the shells' code for an interruption.
NOT_MET, USER_ERROR, INTERRUPTED = 1, 2, 130

#: Options of earlier versions, and what they are called now: an option has the name of its field.
RENAMED = {
    "--goal": "--pose", "--goal-xyz": "--pose-xyz", "--from-pose": "--start", "--friction": "--friction-model",
    "--no-friction": "--no-friction-model", "--dead-zone": "--integral-dead-zone",
}  # fmt: skip

#: Python's way to write a field: ``name=value``, or its name in backticks. A value is quoted text, a tuple, a list or
#: one word.
_OPTIONS = {name: field.option for name, field in FIELDS.items()} | {
    name: option_name(name)
    for name in ("laws", "tune", "samples", "batch", "workers", "starts", "elastic", "payload")
}
_NAMES = "|".join(_OPTIONS)
_KEYWORD = re.compile(rf"(?<![\w.])({_NAMES})=('[^']*'|\"[^\"]*\"|\([^()]*\)|\[[^\[\]]*\]|[^\s,;)]+)")
_NUMBERS = re.compile(r"[-+]?[\d.,]*\d\Z")
_UNIT = re.compile(r"deg|degrees|°|rad|rad/s|hz|m?s|µs|m?m|v|a|n·?m|n", re.IGNORECASE)
_FIELD = re.compile(rf"`({_NAMES})`")


def option_syntax(text: str) -> str:
    """A text with fields of a specification as Python writes them, in the syntax of the command line.

    Examples
    --------
    >>> option_syntax("`bandwidth` is too large; preset='damped', or via=(0.1, 0.2)")
    '--bandwidth is too large; --preset damped, or --via 0.1,0.2'
    """

    def option(match: re.Match[str]) -> str:
        positive, _, negative = _OPTIONS[match[1]].partition("/")
        if negative:
            return negative if match[2] == "False" else positive
        plain = re.sub(r"\s*,\s*", ",", match[2].strip("()[]'\"").rstrip(", "))
        return f"{positive} {plain.translate({ord(mark): None for mark in chr(39) + chr(34)})}"

    return _FIELD.sub(lambda match: _OPTIONS[match[1]].partition("/")[0], _KEYWORD.sub(option, text))


def error_text(error: FlexhinfError, arguments: Sequence[str] = ()) -> str:
    """An error in three parts, in the syntax of the command line, and with the option that was typed.

    `arguments`: those of the command; the limit of the input has a name for each drive beside ``--peak-effort``.
    """
    stated = [argument.split("=")[0] for argument in arguments]
    peak = next((name for name in PEAKS if option_name(name) in stated), "")
    advice = error.advice
    if isinstance(error, SpecificationError) and error.field in FIELDS and error.example:
        named = option_name(peak) if peak and error.field == "peak_effort" else _OPTIONS[error.field]
        advice = f"{named.partition('/')[0]} {error.example}"
    text = str(FlexhinfError(error.what, error.found, advice))
    if peak:
        text = text.replace("`peak_effort`", option_name(peak)).replace(
            "The peak effort ", f"The {peak.replace('_', ' ')} "
        )
        text = text.replace(FIELDS["peak_effort"].about.unit, PEAKS[peak][1])
    return option_syntax(text)


def mistake(text: str, code: int = USER_ERROR) -> int:
    """Print what is wrong; returns the exit code."""
    typer.secho("error: ", fg="red", err=True, nl=False)
    typer.echo(text, err=True)
    return code


def interrupted(written: Sequence[Path]) -> int:
    """Print that a command was interrupted, and which files and folders were complete by then."""
    names = ", ".join(map(str, written))
    whole = f"written and whole: {names}" if names else "nothing was written"
    return mistake(f"Interrupted; {whole}.", INTERRUPTED)


def system_error(error: OSError | MemoryError, written: Sequence[Path]) -> str:
    """An error of the operating system in three parts, with the files and folders that were complete by then."""
    whole = ", ".join(map(str, written)) or "nothing"
    return str(
        FlexhinfError(
            "The system refuses what this command needs.",
            "expected memory, and room for files and output, got: "
            f"{str(error) or 'a full memory'}; written and whole: {whole}",
            "more memory; an output, a working folder and a TMPDIR that can be written, with room",
        )
    )


def note(text: str) -> None:
    """Print a note on standard error."""
    typer.secho(f"note: {option_syntax(text)}", fg="yellow", err=True)


def show(tables: Iterable[Any], notes: Iterable[str] = ()) -> None:
    """Print tables, and then notes."""
    from rich.console import Console

    for table in tables:
        Console().print(table)
    for text in notes:
        note(text)


def parser_error(error: TyperException, arguments: Sequence[str]) -> str:
    """An error of the option parser, in three parts."""
    context = getattr(error, "ctx", None)
    path = context.command_path if context is not None else "flexhinf"
    known = getattr(error, "possibilities", None)
    what, _, meant = error.format_message().split(" (Possible")[0].partition(" Did you mean ")
    typed = getattr(error, "option_name", "")
    option = RENAMED.get(typed, typed)
    commands = _with_option(context.find_root().command, "flexhinf", option) if context is not None else []
    whole = context is not None and any(entry.name == "help_all" for entry in context.command.params)
    expected = f"what `{path} --help{'-all' * whole}` lists"
    # a number and its unit in two words
    apart = next(
        (pair for pair in pairwise(arguments) if _NUMBERS.match(pair[0]) and _UNIT.fullmatch(pair[1])), ()
    )
    if path in commands and option != typed:
        what, expected, advice = f"{typed} is called {option}", option, f"{option} in the place of {typed}"
    elif commands and path not in commands:
        why, instead = "change nothing there", "without it"
        if option == "--workspace":
            why, instead = "say nothing of one pose", "--pose"
        what = f"{path} does not take {option}, which would {why}"
        advice = f"{instead}; {option} is an option of {', '.join(commands)}"
    elif known or meant:
        advice = ", ".join(known or ()) or meant.rstrip("?").strip("'")
    else:
        advice = f"write {''.join(apart)} or '{' '.join(apart)}', in one word" if apart else f"{path} --help"
    return str(
        FlexhinfError(f"{what.rstrip('.')}.", f"expected {expected}, got: {' '.join(arguments)}", advice)
    )


def _with_option(command: Any, path: str, option: str) -> list[str]:
    own = [path] if any(option in (*entry.opts, *entry.secondary_opts) for entry in command.params) else []
    inner = getattr(command, "commands", {}).items()
    return own + [each for name, entry in inner for each in _with_option(entry, f"{path} {name}", option)]


def progress_bar(*columns: str) -> Any:
    """A bar on standard error that vanishes at its end, silent where that is no terminal: its columns of
    `rich.progress` by name, then what is done."""
    from rich import progress
    from rich.console import Console

    own = [getattr(progress, f"{name}Column")() for name in columns]
    text, console = progress.TextColumn("{task.description}", markup=False), Console(stderr=True)
    return progress.Progress(*own, text, console=console, transient=True, disable=not console.is_terminal)


@contextmanager
def step_progress(total: int | None = None, lines: bool = False) -> Iterator[Callable[[str], None]]:
    """A progress bar of `total` steps around some work; a spinner where their number is unknown.

    It gives a function that is called with the name of each step before the step begins. `lines`: steps take long, so
    each gets a line where standard error is no terminal.
    """
    bar = progress_bar(*(("Spinner",) if total is None else ("Bar", "MofNComplete")), "TimeElapsed")
    task, begun = bar.add_task("", total=total), 0

    def begin(text: str) -> None:
        nonlocal begun
        bar.update(task, advance=min(begun, 1), description=text)
        begun += 1
        if lines and bar.disable:
            typer.echo(f"step {begun} of about {total}: {text}", err=True)

    with bar:
        yield begin


class ProofProgress(ExitStack):
    """A bar of the estimated share of a proof, with the cells done; silent where standard error is not a terminal."""

    def __init__(self) -> None:
        super().__init__()
        self._bar = self.enter_context(progress_bar("Bar", "TaskProgress", "TimeElapsed"))
        self._task = self._bar.add_task("", total=None)
        self._text, self._cells = "", 0

    def step(self, text: str) -> None:
        """Begin another step, whose length is not known."""
        self._text, self._cells = text, 0
        self._bar.reset(self._task, total=None, description=text)

    def share(self, cells: int, share: float) -> None:
        """Report the number of cells of a proof that are done, and their estimated share."""
        self._bar.update(self._task, total=1.0, completed=share, description=f"{self._text}, {cells} cells")

    def cells(self, more: int) -> None:
        """Report that more cells of a check are done."""
        self._cells += more
        self._bar.update(self._task, description=f"{self._text}, {self._cells} cells")
