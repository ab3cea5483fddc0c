"""Arguments and options of the commands, made from their declarations; options without effect."""

# Values of options have no types before they are read, and typer's classes narrow those of click.
# pyright: reportUnknownArgumentType=false, reportUnknownVariableType=false, reportUnknownMemberType=false
# pyright: reportIncompatibleMethodOverride=false, reportIncompatibleVariableOverride=false

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import MISSING, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command
from typer.models import OptionInfo

from flexhinf.cli.messages import note, options, show as show_tables, specification
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.options import (
    ADVANCED,
    GROUPS,
    NO_LIMIT,
    FieldInfo,
    declared,
    option_name,
    refused,
    with_value,
)
from flexhinf.processors import available, limited_threads
from flexhinf.validation import nearest, value_text

if TYPE_CHECKING:
    from flexhinf.designs import DesignRequest
    from flexhinf.designs.specification import Specification
    from flexhinf.robot import Robot


class Group(TyperGroup):
    """A group of commands."""

    def get_help_option(self, ctx: typer.Context) -> Any:
        """Option --help, false where it is not stated: for anything that is no bool typer makes an adapter of pydantic,
        whose import takes as long as the help of a command."""
        option = super().get_help_option(ctx)
        if option is not None:
            option.default = False
        return option


#: The parameter that every command has.
CONTEXT = inspect.Parameter("context", inspect.Parameter.KEYWORD_ONLY, annotation=typer.Context)


def plain(text: str | None) -> str:
    """A text of help, in which rich takes what stands in brackets for a style and drops it."""
    return (text or "").replace("[", r"\[")


def with_options(declarations: Callable[[], tuple[type, Collection[str]]]) -> Callable[[Any], Any]:
    """A decorator for ``command(context, o)``: its options are those of a class and of fields of a specification.

    All of them are read as text; the command gets the values of the class. An empty text takes back what a design
    file says.

    `declarations`: gives a dataclass of `flexhinf.cli.options`, and the fields of a specification that the command
        computes with; asked when the options are first needed. Where the class declares a field again, its help is
        shown.
    """

    def decorated(command: Callable[..., int | None]) -> Any:
        def run(context: typer.Context, **values: Any) -> int | None:
            kind: Any = vars(run)["own"]
            stated, own = stated_options(context).items(), declared(kind)
            read = {name: _value(own[name], value) for name, value in stated if name in own}
            threads, processors = read.get("threads"), available()
            if threads is not None and threads > processors:
                note(
                    f"--threads {threads}: more than the {processors} processors of this process are no faster"
                )
            with limited_threads(threads):
                return command(context, kind(**{k: value for k, value in read.items() if value is not None}))

        run.__name__, run.__doc__, run.__module__ = (
            command.__name__,
            plain(command.__doc__),
            command.__module__,
        )
        known: dict[str, Any] = {"declarations": declarations, "__signature__": inspect.Signature([CONTEXT])}
        run.__dict__.update(known)
        return run

    return decorated


class Command(TyperCommand):
    """A command of `with_options`; its options are made when they are asked for: the help of all commands has none."""

    def __init__(self, name: str | None, **settings: Any) -> None:
        self._function, self._whole = inspect.unwrap(settings["callback"]), None
        super().__init__(name, **settings)

    @property
    def params(self) -> list[Any]:
        """Arguments and options."""
        return self._built().params

    @params.setter
    def params(self, none_yet: list[Any]) -> None: ...

    @property
    def callback(self) -> Any:
        """The function of `with_options`, to which `_declare` has given its options."""
        return self._built().callback

    @callback.setter
    def callback(self, without_options: Any) -> None: ...

    def _built(self) -> Any:
        if self._whole is None:
            if "own" not in vars(self._function):
                _declare(self._function)
            alone = typer.Typer(add_completion=False)
            alone.command()(self._function)
            self._whole = get_command(alone)
        return self._whole


def _declare(command: Any) -> None:
    """Give a command of `with_options` its signature, its class of options as `own`, its `fields`, all `options`."""
    own_class, fields = command.declarations()
    own = declared(own_class)
    known = {name: specification.FIELDS[name] for name in fields} | own
    order = {group: k for k, group in enumerate(("", *GROUPS))}
    parameters = [CONTEXT]
    settings = [name for name, field in known.items() if field.about.setting]
    for field in sorted(known.values(), key=lambda field: order[field.about.group]):
        if field.about.setting:
            continue
        parameters.append(_parameter(field, both=field.name not in own or field.default is True))
    if settings:
        parameters.append(_setting())
    if len(parameters) > options.SEVERAL:
        rare = (name for name in fields if name not in own and name not in options.USUAL_FIELDS)
        parameters.append(
            _shortened(parameters, {*options.SELDOM, *rare}, [known[name] for name in settings])
        )
    signature = inspect.Signature(parameters)
    vars(command).update(__signature__=signature, options=known, fields=tuple(fields), own=own_class)


def _setting() -> inspect.Parameter:
    """The option of all fields that are seldom stated."""
    help = "A setting that is seldom stated, as in design.toml; --help-all lists them. Repeat the option for more."
    option = typer.Option("--set", help=help, rich_help_panel=ADVANCED, metavar="<name=value>")
    kind = Annotated[list[str], option]
    return inspect.Parameter("set", inspect.Parameter.KEYWORD_ONLY, default=[], annotation=kind)


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
    help = plain(about.text)
    shape = typer.Argument(help=help, metavar=about.unit or None, show_default=False)
    if about.group:
        shape = typer.Option(
            field.option if both else field.switch,
            help=help,
            rich_help_panel=about.group,
            metavar=None if kind is bool else f"<{about.unit or 'value'}>",
            show_default=bool(value) or field.default == 0,
        )
    value = inspect.Parameter.empty if value is MISSING else value
    keyword = inspect.Parameter.KEYWORD_ONLY
    return inspect.Parameter(field.name, keyword, default=value, annotation=Annotated[kind, shape])


def _shortened(
    parameters: Iterable[inspect.Parameter], seldom: Collection[str], settings: Sequence[FieldInfo]
) -> inspect.Parameter:
    """Hide options that are seldom used, and all but the first sentence on the others; returns the option that shows
    everything, and the settings."""
    declared_options = {
        each.name: option
        for each in parameters
        for option in getattr(each.annotation, "__metadata__", ())
        if isinstance(option, OptionInfo)
    }
    texts = {name: option.help for name, option in declared_options.items()}
    for name, option in declared_options.items():
        option.hidden = name in seldom
        option.help = re.split(r"(?<=\.) (?=[A-Z])", str(option.help))[0]

    def show(context: typer.Context, value: bool) -> None:
        if value:
            for parameter in context.command.params:
                if parameter.name in texts:
                    vars(parameter).update(hidden=False, help=texts[parameter.name])
            typer.echo(context.get_help())
            show_tables([_settings_table(settings)] if settings else [])
            raise typer.Exit()

    count = sum(option.hidden for option in declared_options.values())
    text = f"Show all of this, and {count} more options."
    option = typer.Option("--help-all", help=text, is_eager=True, callback=show, rich_help_panel=ADVANCED)
    keyword = inspect.Parameter.KEYWORD_ONLY
    return inspect.Parameter("help_all", keyword, default=False, annotation=Annotated[bool, option])


def _settings_table(settings: Iterable[FieldInfo]) -> Any:
    from rich.markup import escape
    from rich.table import Table

    table = Table(
        "Setting", "What it states", title="Settings, by --set NAME=VALUE or in design.toml", box=None
    )
    for field in settings:
        default = "yes" if field.default is True else field.default or ""
        table.add_row(field.name, escape(field.about.text + f" [default: {default}]" * bool(default)))
    return table


def request_of(
    context: typer.Context, o: options.PointOptions, source: str, elastic: str = ""
) -> DesignRequest:
    """Robot and specification of a command, whose options win over a design file; prints notes."""
    fields = _stated_fields(context, stated_options(context))
    return read_source(source, elastic, fields, o.payload, o.pose_xyz, o.tool, context.info_name == "run")


def stated_fields(context: typer.Context) -> dict[str, Any]:
    """Fields of a specification that options of a command state, as texts; see `read_source`."""
    return _stated_fields(context, stated_options(context))


def _stated_fields(context: typer.Context, stated: Mapping[str, Any]) -> dict[str, Any]:
    known = specification.FIELDS
    return {name: _text(known[name], stated[name]) for name in _command(context).fields if name in stated}


def refuse_idle(context: typer.Context, request: DesignRequest, **options: bool) -> None:
    """Refuse options that cannot change what a command computes of this request; `options` as for `without_effect`."""
    command = str(context.info_name)
    refuse_stated(context, without_effect(command, request.robot, request.specification, **options))


def refuse_stated(context: typer.Context, idle: Mapping[str, str]) -> None:
    """Refuse options that are stated and have no effect; `idle`: by name, what each would act on."""
    known = fields_of(context)
    for name in stated_options(context):
        option = known[name].switch
        refuse_if(
            needs := idle.get(name, ""),
            f"{option} has no effect on this {context.info_name}.",
            f"expected it with {needs}; got it without",
            f"leave out {option}",
        )


def refuse_existing(out: Path, force: bool) -> None:
    """Refuse to write where there is something already, unless it may be replaced."""
    refuse_if(
        out.exists() and not force,
        f"{out.name} is there already.",
        f"expected a new name, got {out.absolute()}",
        "another name, or --force, which replaces it",
    )


# Options without effect. What is switched off (0, false, nothing) asks for nothing, and is never among them.
#: Fields of an estimator alone.
NOISES = ("process_noise", "torque_noise", "measurement_noise")

#: Fields that choose a law by the runs of its step alone, and those by which weights are searched for too.
STEPPED = ("shaping", "quantisation", "friction_model", "integral_dead_zone")
SEARCHED = (
    "start",
    "peak_effort",
    "peak_speed",
    "saturation",
    "peak_sensitivity",
    "gain_margin",
    "delay_margin",
    "estimator",
    *NOISES,
    "extras",
    "latency",
    "unknown_delay",
)

#: What fields of a step would act on, where no step is run.
RUNS = "several --degrees or a search for weights, by which runs of the step choose the law"


def without_effect(
    command: str, robot: Robot, s: Specification, *, tolerances: bool = False, observer: bool = False
) -> dict[str, str]:
    """Fields on which the result of ``design``, ``compare`` or ``certify`` does not depend, by name: what they act on.

    `tolerances`, `observer`: of ``certify``.
    """
    from flexhinf.designs.fields import law_of
    from flexhinf.designs.problem.presets import preset_of
    from flexhinf.designs.synthesis.by_step import STATES, rays_of

    designs = command in ("design", "compare")
    if designs and law_of(s).any_pose:
        return _active(s, _of_any_pose(robot, s))
    idle, preset, joints = _of_loop(robot, s), preset_of(robot, s), len(robot.joint_names)
    sampled = designs and rays_of(STATES * joints, s.rays) > 0
    if s.estimator == "none" and not sampled and (not robot.uncertain or s.draws == 0):
        idle["seed"] = (
            "an estimator, robots within their tolerances (--draws) or a sampled region (--set rays)"
        )
    if designs and preset != "proved":
        if not sampled:
            idle |= dict.fromkeys(("checked_gamma_ratio", "checked_penalty"), "a sampled region (--set rays)")
        if not sampled or joints > 1 or s.via:
            idle["proof_seconds"] = (
                "a robot of one joint, one law (no --via) and a sampled region (--set rays)"
            )
    elif command == "certify":
        idle |= _of_certificate(robot, s, preset, tolerances)
        if observer:
            idle.pop("measured", None)
    return _active(s, idle)


def without_effect_on_run(
    s: Specification, robot: Robot, noise: bool, commanded: bool, workspace: bool = False
) -> dict[str, str]:
    """Fields on which a run of a finished controller does not depend, as `without_effect`.

    `noise`: whether measurements have noise. `commanded`: whether the controller takes a command. `workspace`: whether
    it is for one.
    """
    idle, random = _of_loop(robot, s), noise and s.estimator != "none"
    if not random:
        idle |= dict.fromkeys(("measurement_noise", "seed"), "noise of the measurements")
    if s.move is not None:
        idle |= dict.fromkeys(("pose", "start", "overshoot"), 'a step (--move "" takes back the move)')
    elif not commanded:
        idle["shaping"] = "a controller that takes a command: its penalty weighs link_position_integral"
    of_pose = dict.fromkeys(("shaping", "overshoot", "feedforward"), "a controller of one pose")
    return _active(s, idle) | (of_pose if workspace else {})


def _active(s: Specification, idle: Mapping[str, str]) -> dict[str, str]:  # a seed of 0 is a seed
    return {name: needs for name, needs in idle.items() if name == "seed" or getattr(s, name)}


def of_workspace_proof(request: DesignRequest) -> dict[str, str]:
    """Options of ``certify`` that a proof of a controller for a workspace does not read, and what they act on."""
    idle = dict.fromkeys(("degree", "decay", "observer", "tolerances"), "a design of one pose (--pose)")
    moved = dict.fromkeys(("draws", "seed"), "flexhinf design, which tests the controller")
    s = request.specification
    return _active(s, _of_any_pose(request.robot, s) | moved) | idle


def _of_any_pose(robot: Robot, s: Specification) -> dict[str, str]:
    """As `_of_loop`, of a law with gains at any pose: noise is judged by what a motor needs, and moves are made. A
    field that it does not read may be stated at its default."""
    from flexhinf.designs.fields import unread

    judged = ("ripple", "tracking_error")
    idle = {name: needs for name, needs in _of_loop(robot, s).items() if name not in judged}
    return idle | unread(s)


def _of_loop(robot: Robot, s: Specification) -> dict[str, str]:
    from flexhinf.designs.estimators import is_kalman
    from flexhinf.designs.responses import joint_limits
    from flexhinf.robot.elastic import DRY, with_dry_friction

    idle = {} if joint_limits(robot, s).limits_effort else {"ripple": "limits of the motors (--saturation)"}
    if s.move is None:
        idle["tracking_error"] = "a move (--move), or a workspace"
    if s.disturbances is None:
        idle["command"] = "--set disturbances: without them the command is the disturbance anyway"
    if s.estimator == "none":
        idle |= dict.fromkeys(("measured", *NOISES), "an estimator")
    dry = set(with_dry_friction(s.extras, robot.plant_parameters())) & set(DRY)
    if not is_kalman(s) or not dry:
        idle["friction_model"] = "a Kalman filter (ukf, ekf), and dry friction in the robot's file"
    if not robot.uncertain:
        idle["draws"] = "tolerances in the robot's file"
    if all(robot.links.slides):
        idle["angle_unit"] = "a joint that turns"
    return idle


def _of_certificate(robot: Robot, s: Specification, preset: str, tolerances: bool) -> dict[str, str]:
    from flexhinf.designs.responses import joint_limits

    limits, proved = joint_limits(robot, s), preset == "proved"
    several = not proved and (s.degrees is None or len(s.degrees) > 1)
    chosen = several and not s.via  # the step chooses the degree
    searched = preset in ("damped", "robust", "proved")
    limited = limits.limits_effort if proved else searched and (limits.limits_peak or limits.limits_speed)
    run = chosen or limited or preset == "robust"
    names = [] if run else [*STEPPED, "seed"]
    if not run and (proved or not searched):
        left = {"start": tolerances or proved, "saturation": len(robot.joint_names) > 1}  # the units of R2
        names += ["measured", *(name for name in SEARCHED if not left.get(name))]
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
    source: str,
    elastic: str,
    fields: Mapping[str, Any],
    payload: str = "",
    goal: str = "",
    tool: str = "",
    of_run: bool = False,
) -> DesignRequest:
    """Robot and specification of a file and of fields that win over it; prints notes, raises as `request_of`.

    Of a report's folder its design file is meant. `of_run`: as for `read_request`.
    """
    from flexhinf.designs.design_file import meant_file
    from flexhinf.designs.request import read_request
    from flexhinf.robot.parts import file_warnings

    with file_warnings(note) as texts:
        file = meant_file(source)
        request = read_request(
            file, elastic or None, fields, payload or None, goal=goal, tool=tool, of_run=of_run
        )
    for text in request.notes:
        note(text)
    return replace(request, warnings=tuple(texts))


def _text(field: FieldInfo, value: Any) -> Any:
    """The text of an option; None for an empty one and for a zero that stands for the default, infinity for one that
    stands for no limit."""
    if isinstance(value, bool):
        return value
    if isinstance(field.default, bool):
        return _flag(field, value)
    if isinstance(value, list):
        texts: list[str] = value
        return [text for text in texts if text]
    zero = False
    with suppress(ValueError):
        zero = bool(field.about.zero) and float(value) == 0.0
    if zero and field.about.zero == NO_LIMIT:
        return math.inf
    return None if zero or not value.strip() else value


def _flag(field: FieldInfo, value: str) -> bool:
    known = {"yes": True, "true": True, "no": False, "false": False}
    refuse_if(
        value.lower() not in known,
        refused(field.name),
        f"expected yes or no, got {value_text(value)}",
        f"--set {field.name}={'no' if field.default else 'yes'}",
    )
    return known[value.lower()]


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
    and without --verbose, --threads and --device."""
    parts, options, stated = context.command_path.split(), fields_of(context), stated_options(context)
    for parameter in context.command.params:
        name = str(parameter.name)
        value = stated.get(name)
        if name == "set":
            pairs = [f"{n}={v}" for n, v in stated.items() if options[n].about.setting and n not in without]
            parts += [word for pair in pairs for word in ("--set", pair)]
        if value is None or name in (*without, "verbose", "threads", "device"):
            continue
        values: Sequence[Any] = value if isinstance(value, (list, tuple)) else [value]
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


def fields_of(context: typer.Context) -> dict[str, FieldInfo]:
    """What a command takes, by name: its own options, and fields of a specification."""
    return _command(context).options


def stated_options(context: typer.Context) -> dict[str, Any]:
    """Values of the options and settings that the user stated, by their names."""
    sources = {name: context.get_parameter_source(name) for name in context.params}
    stated = {
        name: context.params[name] for name, source in sources.items() if source and source.name != "DEFAULT"
    }
    return stated | _settings(context, stated.pop("set", ()))


def _settings(context: typer.Context, texts: Iterable[str]) -> dict[str, str]:
    """Values of ``--set``, by name; refused is what is no setting of the command, and what is stated twice."""
    known, found = fields_of(context), dict[str, str]()
    settings = [name for name, field in known.items() if field.about.setting]
    for text in texts:
        typed, equals, value = text.partition("=")
        name = typed.strip().replace("-", "_")
        refuse_if(
            not equals,
            "A setting has no value.",
            f"expected a name and a value, got {text!r}",
            f"--set {name if name in settings else settings[0]}=…",
        )
        meant = nearest(name, settings, settings[0]).strip("'")
        option = known[name].switch if name in known else f"--set {meant}"
        refuse_if(
            name not in settings,
            f"{typed!r} is no setting of {context.command_path}.",
            f"expected one of {', '.join(settings)}, got {typed!r}",
            with_value(option, value),
        )
        refuse_if(
            name in found,
            f"The setting {name!r} is given twice.",
            f"expected it once, got {found.get(name)!r} and {value!r}",
            f"--set {name}={value}",
        )
        found[name] = value
    return found
