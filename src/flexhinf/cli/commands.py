"""All commands, and the way in and out.

A new command is a function in a file of its own, named in `COMMANDS`. What it shares with ``flexhinf design`` is there
already: the options of a specification in `flexhinf.cli.options`, those that were given in `flexhinf.cli.given`, and a
robot or a design file as its argument in `flexhinf.cli.asked`.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Annotated

import typer
from typer.exceptions import TyperException

from flexhinf import __version__
from flexhinf.cli.compare import compare
from flexhinf.cli.design import design
from flexhinf.cli.paper import paper
from flexhinf.cli.robots import robots
from flexhinf.cli.told import INTERRUPTED, mistake, three_parts
from flexhinf.errors import FlexhinfError

__all__ = ["COMMANDS", "app", "main"]

#: In the order of the help.
COMMANDS = (paper, robots, design, compare)

app = typer.Typer(name="flexhinf", add_completion=False, pretty_exceptions_enable=False)


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
    """Robust nonlinear H∞ control of robots with elastic joints.

    Exit codes: 0 done; 1 done, and the loop does not meet its specification;
    2 a mistake that can be put right, nothing written; 130 interrupted.
    """


for command in COMMANDS:
    app.command()(command)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns its exit code. A user's mistake is told in three parts, without a traceback."""
    words = list(sys.argv[1:] if arguments is None else arguments) or ["--help"]
    try:
        code = app(args=words, prog_name="flexhinf", standalone_mode=False)
        if code == INTERRUPTED:  # the option parser has caught Ctrl-C
            return mistake("Interrupted; nothing was written.", INTERRUPTED)
        return code if isinstance(code, int) else 0
    except FlexhinfError as error:
        return mistake(str(error))
    except TyperException as error:
        return mistake(three_parts(error, words))
    except (KeyboardInterrupt, typer.Abort):
        return mistake("Interrupted; nothing was written.", INTERRUPTED)
