"""All commands, and the way in and out.

A new command is a function in a file of its own, named in `COMMANDS`. Where it takes a specification, its options are
made by `flexhinf.cli.arguments.with_specification`.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Annotated

import typer
from typer.exceptions import TyperException

from flexhinf import __version__
from flexhinf.cli.compare import EXAMPLES as COMPARE_EXAMPLES
from flexhinf.cli.compare import compare
from flexhinf.cli.design import EXAMPLES as DESIGN_EXAMPLES
from flexhinf.cli.design import design
from flexhinf.cli.messages import INTERRUPTED, error_text, mistake, parser_error
from flexhinf.cli.paper import EXAMPLES as PAPER_EXAMPLES
from flexhinf.cli.paper import paper
from flexhinf.cli.robots import EXAMPLES as ROBOTS_EXAMPLES
from flexhinf.cli.robots import robots
from flexhinf.cli.schema import EXAMPLES as SCHEMA_EXAMPLES
from flexhinf.cli.schema import schema
from flexhinf.errors import FlexhinfError

__all__ = ["COMMANDS", "app", "main"]

#: Each with its examples, in the order of the help.
COMMANDS = {
    paper: PAPER_EXAMPLES,
    robots: ROBOTS_EXAMPLES,
    design: DESIGN_EXAMPLES,
    compare: COMPARE_EXAMPLES,
    schema: SCHEMA_EXAMPLES,
}

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


for command, examples in COMMANDS.items():
    app.command(epilog="\n\n".join(["Examples:", *(f"  {line}" for line in examples)]))(command)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns its exit code. A user's mistake is printed in three parts, without a traceback."""
    words = list(sys.argv[1:] if arguments is None else arguments) or ["--help"]
    try:
        code = app(args=words, prog_name="flexhinf", standalone_mode=False)
        if code == INTERRUPTED:  # the option parser has caught Ctrl-C
            return mistake("Interrupted; nothing was written.", INTERRUPTED)
        return code if isinstance(code, int) else 0
    except FlexhinfError as error:
        return mistake(error_text(error, words))
    except TyperException as error:
        return mistake(parser_error(error, words))
    except (KeyboardInterrupt, typer.Abort):
        return mistake("Interrupted; nothing was written.", INTERRUPTED)
