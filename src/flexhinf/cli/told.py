"""What goes to standard error: mistakes in three parts, and notes; and the exit codes that belong to them."""

from __future__ import annotations

from collections.abc import Sequence

import typer
from typer.exceptions import TyperException

from flexhinf.errors import FlexhinfError

__all__ = ["INTERRUPTED", "NOT_MET", "USER_ERROR", "mistake", "note", "three_parts"]

#: Exit codes: the report is written and says that the specification is not met; everything the user can put right;
#: the shells' code for an interruption.
NOT_MET, USER_ERROR, INTERRUPTED = 1, 2, 130


def mistake(text: str, code: int = USER_ERROR) -> int:
    """Tell what is wrong; returns the exit code."""
    typer.secho("error: ", fg="red", err=True, nl=False)
    typer.echo(text, err=True)
    return code


def note(text: str) -> None:
    """Tell what must not be missed."""
    typer.secho(f"note: {text}", fg="yellow", err=True)


def three_parts(error: TyperException, words: Sequence[str]) -> str:
    """What the option parser found wrong, in the house's form."""
    context = getattr(error, "ctx", None)
    path = context.command_path if context is not None else "flexhinf"
    known = getattr(error, "possibilities", None)
    advice = ", ".join(known) if known else f"{path} --help"
    what = error.format_message().split(" (Possible")[0].rstrip(".")
    return str(
        FlexhinfError(f"{what}.", f"expected what `{path} --help` lists, got: {' '.join(words)}", advice)
    )
