"""All commands; `run` executes one and returns its exit code.

A new command is a function that is named in `COMMANDS`. Where it takes a specification, its options are
made by `flexhinf.cli.arguments.with_options`.
"""

from __future__ import annotations

import atexit
import gc
import json
import sys
from collections.abc import Sequence
from functools import cached_property
from typing import Annotated, Any, Literal

import typer
from typer.exceptions import TyperException
from typer.main import get_command

from flexhinf import __version__, pages
from flexhinf.cli.arguments import Command, Group
from flexhinf.cli.campaign import app as campaign
from flexhinf.cli.check import check
from flexhinf.cli.design import certify, compare, design, paper, run_design
from flexhinf.cli.exports import app as export, compile_design
from flexhinf.cli.init import init
from flexhinf.cli.logs import estimate, identify
from flexhinf.cli.messages import (
    INTERRUPTED,
    error_text,
    interrupted,
    mistake,
    parser_error,
    show,
    system_error,
)
from flexhinf.cli.studio import studio
from flexhinf.errors import FlexhinfError, InvalidInput
from flexhinf.files import recorded
from flexhinf.validation import value_text

# At its end the interpreter would look for cycles of objects, for a fifth of a second after a page with figures.
atexit.register(gc.freeze)


def robots() -> None:
    """List the robots that ship with flexhinf, and published joints and gears, with where their numbers come from."""
    show(
        [pages.gears_table(), pages.actuators_table(), pages.robots_table()]
    )  # the robots stay on the screen


def schema(
    of: Annotated[
        Literal["request", "design"],
        typer.Argument(
            help="request: design.toml, what a design is made of. design: design.json, its numbers."
        ),
    ] = "request",
) -> None:
    """Print the JSON schema of a file of a design, for editors and other programs."""
    from flexhinf.designs import design_schema, numbers_schema

    encoding = str(getattr(sys.stdout, "encoding", None) or "utf-8")
    # JSON's own escapes, so that it stays JSON
    escaped = not encoding.lower().replace("-", "").startswith("utf")
    found = design_schema() if of == "request" else numbers_schema()
    typer.echo(json.dumps(found, indent=2, ensure_ascii=escaped))


#: Each with its function and its examples, in the order of the help.
COMMANDS = {
    "paper": (paper, "flexhinf paper", "flexhinf paper --gamma-ratio 1.5 --seed 1 --out second"),
    "robots": (robots, "flexhinf robots"),
    "design": (
        design,
        "flexhinf design planar-two-link",
        "flexhinf design paper --pose 90deg",
        "flexhinf design planar-two-link --pose 35deg,20deg --measured motor_position --bandwidth 3 --damping 0.3",
        "flexhinf design paper --pose home --preset robust --peak-effort 24 --unknown-delay 2ms --out robust",
        "flexhinf design planar-two-link --law lqg --estimator ekf",
        "flexhinf design flexhinf-design/design.toml --seed 1",
    ),
    "compare": (
        compare,
        "flexhinf compare planar-two-link --laws pid,torque-i",
        "flexhinf compare paper --pose 90deg",
        "flexhinf compare planar-two-link --pose 35deg,20deg --laws pd,pid,flatness-i --measured motor_position",
        "flexhinf compare flexhinf-design",
    ),
    "certify": (
        certify,
        "flexhinf certify paper --pose home --preset damped --degrees 2",
        "flexhinf certify design.toml --out proof",
        "flexhinf certify paper --pose 180deg --preset robust --degree 6",
        "flexhinf certify paper --pose 180deg --start 0 --preset damped --degrees 2 --tolerances",
        "flexhinf certify --check flexhinf-certificate/certificate.json",
    ),
    "compile": (compile_design, "flexhinf compile flexhinf-design --out arm.so"),
    "run": (
        run_design,
        "flexhinf run flexhinf-design --mujoco --log run.csv --record arm.gif",
        "flexhinf run flexhinf-design --mujoco --library arm.so --priority 80 --core 1",
        "flexhinf run flexhinf-design --mujoco --payload 2kg --perturb stiffness=-20% --duration 3s",
    ),
    "init": (init, "flexhinf init arm.urdf", "flexhinf init --joints 3 --drive current --out arm.toml"),
    "check": (
        check,
        "flexhinf check arm.urdf",
        "flexhinf check run.csv --robot arm.toml",
        'flexhinf check log.csv --robot arm.toml --column "motor_position=pos (deg)" --out checked',
    ),
    "estimate": (
        estimate,
        "flexhinf estimate run.csv --robot arm.toml",
        'flexhinf estimate log.csv --robot arm.toml --measured motor_position --column "motor_position=pos (deg)"',
        "flexhinf estimate bag.mcap --robot flexhinf-design --column motor_voltage=command/data --hold-inputs",
    ),
    "identify": (
        identify,
        "flexhinf identify run.csv --robot arm.toml --parameters stiffness,friction,motor_inertia",
        "flexhinf identify log.csv --robot arm.toml --parameters stiffness --measured motor_position,link_position",
    ),
    "studio": (studio, "flexhinf studio", "flexhinf studio planar-two-link --no-browser --port 8080"),
    "schema": (schema, "flexhinf schema > design.schema.json", "flexhinf schema design"),
}


class App(typer.Typer):
    """The group of all commands; an error in an option names the command that has the option."""

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        """Parse the arguments and run their command."""
        return self._command(*arguments, **options)

    @cached_property
    def _command(self) -> Any:
        command = get_command(self)
        _refine(command)
        return command


# Some errors of the parser, such as that of a missing value, lack their command.
def _refine(command: Any) -> None:
    for inner in getattr(command, "commands", {}).values():
        _refine(inner)
    parse = command.parse_args

    def parsed(context: Any, arguments: list[str]) -> list[str]:
        try:
            return parse(context, arguments)
        except TyperException as error:
            if getattr(error, "ctx", None) is None:
                setattr(error, "ctx", context)  # noqa: B010  pyright
            raise

    command.parse_args = parsed


app = App(name="flexhinf", cls=Group, add_completion=False, pretty_exceptions_enable=False)


def _version(value: bool) -> None:
    if value:
        typer.echo(f"flexhinf {__version__}")
        raise typer.Exit()


@app.callback()
def root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    """Design, test and export controllers for robot arms with elastic joints; prove bounds for one joint.

    Exit codes: 0 done; 1 done, and the loop does not meet its specification;
    2 a mistake that can be put right, nothing written; 130 interrupted,
    143 terminated, 141 nobody reads the output.
    """


for name, (command, *examples) in COMMANDS.items():
    kind = Command if hasattr(command, "declarations") else None
    app.command(name, cls=kind, epilog="\n\n".join(["Examples:", *(f"  {line}" for line in examples)]))(
        command
    )


app.add_typer(campaign, name="campaign")
app.add_typer(export, name="export")


def without_ros(command: Sequence[str]) -> list[str]:
    """The words of a command, but for those of a node that ROS reads: from ``--ros-args`` to ``--``, or to the end."""
    stated = list(command)
    while "--ros" in stated and "--ros-args" in stated:
        begin = stated.index("--ros-args")
        behind = stated[begin:]
        stated[begin:] = behind[behind.index("--") + 1 :] if "--" in behind else []
    return stated


def run(arguments: Sequence[str] | None = None) -> int:
    """Run a command as `flexhinf.cli.main` does, without its handling of signals other than Ctrl-C."""
    command = list(sys.argv[1:] if arguments is None else arguments) or ["--help"]
    with recorded() as written:
        try:
            for word in command:  # what is no text could be printed nowhere
                if any("\ud800" <= character <= "\udfff" for character in word):
                    raise InvalidInput(
                        "A word of the command is no text in UTF-8.",
                        f"got {value_text(word)}",
                        "names and folders in UTF-8",
                    )
            code = app(args=without_ros(command), prog_name="flexhinf", standalone_mode=False)
            if code == INTERRUPTED:  # the option parser has caught Ctrl-C
                return interrupted(written())
            return code if isinstance(code, int) else 0
        except FlexhinfError as error:
            return mistake(error_text(error))
        except TyperException as error:
            return mistake(parser_error(error, command))
        except BrokenPipeError:
            raise
        except (OSError, MemoryError) as error:
            return mistake(system_error(error, written()))
        except (KeyboardInterrupt, typer.Abort):
            return interrupted(written())
