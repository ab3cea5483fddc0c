"""What goes to standard error: errors in three parts in the command line's own syntax, notes, progress; exit codes."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import typer
from typer.exceptions import TyperException

from flexhinf.cli.options import PEAKS
from flexhinf.design.options import option_name
from flexhinf.design.specification import FIELDS, SpecificationError
from flexhinf.errors import FlexhinfError

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
_OPTIONS = {**{name: field.option for name, field in FIELDS.items()}, "laws": "--laws", "tune": "--tune"}
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

    `arguments`: words of the command: the limit of the input has a name for each drive beside ``--peak-effort``.
    """
    advice = error.advice
    if isinstance(error, SpecificationError) and error.field in FIELDS and error.example:
        advice = f"{_OPTIONS[error.field].partition('/')[0]} {error.example}"
    text = str(FlexhinfError(error.what, error.found, advice))
    for name in map(option_name, PEAKS):
        if any(word.split("=")[0] == name for word in arguments):
            text = text.replace("`peak_effort`", name)
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


def refused(error: OSError | MemoryError, written: Sequence[Path]) -> str:
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
    expected = f"what `{path} --help` lists"
    # a number and its unit in two words
    apart = next(
        (pair for pair in pairwise(arguments) if _NUMBERS.match(pair[0]) and _UNIT.fullmatch(pair[1])), ()
    )
    if path in commands and option != typed:
        what, expected, advice = f"{typed} is called {option}", option, f"{option} in the place of {typed}"
    elif commands and path not in commands:
        what = f"{path} does not take {option}, which would change nothing there"
        advice = f"without it; it is an option of {', '.join(commands)}"
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
def step_progress(total: int | None = None) -> Iterator[Callable[[str], None]]:
    """A progress bar of `total` steps around some work; a spinner where their number is unknown.

    It gives a function that is called with the name of each step before the step begins.
    """
    bar = progress_bar(*(("Spinner",) if total is None else ("Bar", "MofNComplete")), "TimeElapsed")
    task, begun = bar.add_task("", total=total), 0

    def begin(text: str) -> None:
        nonlocal begun
        bar.update(task, advance=min(begun, 1), description=text)
        begun += 1

    with bar:
        yield begin


class ProofProgress:
    """A bar of the estimated share of a proof, with the cells done; silent where standard error is not a terminal."""

    def __init__(self) -> None:
        self._bar = progress_bar("Bar", "TaskProgress", "TimeElapsed")
        self._task = self._bar.add_task("", total=None)
        self._text, self._cells = "", 0

    def __enter__(self) -> ProofProgress:
        self._bar.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._bar.stop()

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
