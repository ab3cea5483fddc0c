"""What commands say: errors in three parts in the command line's own syntax, notes, progress; exit codes."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from itertools import dropwhile, islice, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from typer.exceptions import TyperException

from flexhinf.errors import FlexhinfError, InvalidInput
from flexhinf.options import option_name, with_value
from flexhinf.progress import Steps, time_left
from flexhinf.validation import late_package

if TYPE_CHECKING:
    from flexhinf.cli import options as options
    from flexhinf.designs import specification
else:  # the help of all commands takes no declaration of an option
    options = late_package("flexhinf.cli.options")
    specification = late_package("flexhinf.designs.specification")

#: Exit codes: the report is written and says that the specification is not met; everything the user can put right;
#: the shells' code for an interruption.
NOT_MET, USER_ERROR, INTERRUPTED = 1, 2, 130

#: Endings of logs.
LOG_ENDINGS = (".csv", ".txt", ".tsv", ".dat", ".parquet", ".mcap")


#: Python's way to write a field: ``name=value``, or its name in backticks. A value is quoted text, a tuple, a list or
#: one word.
@cache
def _syntax() -> tuple[dict[str, str], re.Pattern[str], re.Pattern[str]]:
    own = ("laws", "samples", "batch", "workers", "starts", "elastic", "payload")
    known = dict[str, str]()
    with suppress(InvalidInput):  # an extension that cannot be imported, which is what is said then
        known |= {name: field.option for name, field in specification.FIELDS.items()}
    known |= {name: option_name(name) for name in own}
    names = "|".join(known)
    keyword = rf"(?<![\w.])(?<!--set )({names})=('[^']*'|\"[^\"]*\"|\([^()]*\)|\[[^\[\]]*\]|[^\s,;)]+)"
    return known, re.compile(keyword), re.compile(rf"`({names})`")


_NUMBERS = re.compile(r"[-+]?[\d.,]*\d\Z")
_UNIT = re.compile(r"deg|degrees|°|rad|rad/s|hz|m?s|µs|m?m|v|a|n·?m|n", re.IGNORECASE)


def option_syntax(text: str) -> str:
    """A text with fields of a specification as Python writes them, in the syntax of the command line.

    Examples
    --------
    >>> option_syntax("`bandwidth` is too large; preset='damped', or via=(0.1, 0.2)")
    '--bandwidth is too large; --preset damped, or --via 0.1,0.2'
    """

    known, keyword, field = _syntax()

    def option(match: re.Match[str]) -> str:
        positive, _, negative = known[match[1]].partition("/")
        if negative:
            return negative if match[2] == "False" else positive
        plain = re.sub(r"\s*,\s*", ",", match[2].strip("()[]'\"").rstrip(", "))
        return with_value(positive, plain.translate({ord(mark): None for mark in chr(39) + chr(34)}))

    return field.sub(lambda match: known[match[1]].partition("/")[0], keyword.sub(option, text))


def error_text(error: FlexhinfError) -> str:
    """An error in three parts, in the syntax of the command line."""
    advice = error.advice
    if (
        isinstance(error, specification.SpecificationError)
        and error.field in specification.FIELDS
        and error.example
    ):
        advice = with_value(specification.FIELDS[error.field].switch, error.example)
    return option_syntax(str(FlexhinfError(error.what, error.found, advice)))


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
    then, now, _ = _field_of(typed)
    option = typed if then == now else option_name(now)
    setting, as_set = _as_setting(typed, arguments)
    root = None if context is None else context.find_root().command
    commands = [] if root is None else _with_option(root, "flexhinf", setting or option)
    whole = context is not None and any(entry.name == "help_all" for entry in context.command.params)
    expected = f"what `{path} --help{'-all' * whole}` lists"
    # a number and its unit in two words
    apart = next(
        (pair for pair in pairwise(arguments) if _NUMBERS.match(pair[0]) and _UNIT.fullmatch(pair[1])), ()
    )
    robot = _robot_of_log(path, arguments)
    if robot and "extra argument" in what:
        expected, advice = "one log, and the robot by --robot", robot
    elif setting and path in commands:
        what, expected, advice = f"{typed} is a setting", as_set, as_set
    elif path in commands and option != typed:
        what, expected, advice = f"{typed} is called {option}", option, f"{option} in the place of {typed}"
    elif commands and path not in commands:
        why, instead = "change nothing there", "without it"
        if option == "--workspace":
            why, instead = "say nothing of one pose", "--pose"
        what = f"{path} does not take {option}, which would {why}"
        advice = f"{instead}; {as_set or option} is an option of {', '.join(commands)}"
    elif known or meant:
        advice = ", ".join(known or ()) or meant.rstrip("?").strip("'")
    else:
        advice = f"write {''.join(apart)} or '{' '.join(apart)}', in one word" if apart else f"{path} --help"
    return str(
        FlexhinfError(f"{what.rstrip('.')}.", f"expected {expected}, got: {' '.join(arguments)}", advice)
    )


def _field_of(typed: str) -> tuple[str, str, bool]:
    """Of an option that is typed: the name of its field then and now, and whether it is ``--no-``."""
    bare = typed.removeprefix("--").replace("-", "_")
    name = bare.removeprefix("no_")
    return name, {"goal_xyz": "pose_xyz", **specification.FORMER}.get(name, name), name != bare


def _as_setting(typed: str, arguments: Sequence[str]) -> tuple[str, str]:
    """The name of a setting that is typed as an option, and how it is stated, with its value; empty for any other."""
    _, name, off = _field_of(typed)
    field = specification.FIELDS.get(name)
    if field is None or not field.about.setting:
        return "", ""
    if isinstance(field.default, bool):
        return name, field.option.split("/")[off]
    joined = next((word for word in arguments if word.startswith(f"{typed}=")), "").partition("=")[2]
    after = islice(dropwhile(lambda word: word != typed, arguments), 1, None)
    return name, with_value(field.option, joined or next(after, "") or field.about.example)


def _robot_of_log(path: str, arguments: Sequence[str]) -> str:
    """The command with the file that is no log as its robot, of a command that reads a log and got two files."""
    files = [word for word in arguments[:3] if not word.startswith("-")][1:]
    logs = [file for file in files if file.lower().endswith(LOG_ENDINGS)]
    if path.split()[-1] not in ("estimate", "identify") or len(files) != 2 or len(logs) != 1:
        return ""
    return f"{path} {logs[0]} --robot {next(file for file in files if file != logs[0])}"


def _with_option(command: Any, path: str, option: str) -> list[str]:
    """Commands that take an option, or a setting by its name."""
    settings = getattr(inspect.unwrap(command.callback or str), "fields", ())
    typed = [name for entry in command.params for name in (*entry.opts, *entry.secondary_opts)]
    own = [path] if option in (*typed, *settings) else []
    inner = getattr(command, "commands", {}).items()
    return own + [each for name, entry in inner for each in _with_option(entry, f"{path} {name}", option)]


def progress_bar(*columns: str) -> Any:
    """A bar on standard error that vanishes at its end, silent where that is no terminal: its columns of
    `rich.progress` by name, "Left" for the time that is left, then what is done."""
    from rich import progress
    from rich.console import Console
    from rich.text import Text

    begun = {"share": 0.0, "at": 0.0}

    class LeftColumn(progress.ProgressColumn):
        """Time that is left, by the share that was done when the present step began."""

        def render(self, task: progress.Task) -> Text:
            share, now = task.completed / task.total if task.total else 0.0, task.elapsed or 0.0
            if share != begun["share"]:
                begun.update(share=share, at=now)
            return Text(time_left(share, begun["at"], now))

    own = [LeftColumn() if name == "Left" else getattr(progress, f"{name}Column")() for name in columns]
    text, console = progress.TextColumn("{task.description}", markup=False), Console(stderr=True)
    return progress.Progress(*own, text, console=console, transient=True, disable=not console.is_terminal)


@contextmanager
def step_progress(
    steps: int | Sequence[tuple[str, float]] = (), lines: bool = False
) -> Generator[Callable[[str], None], None, None]:
    """A progress bar around some work; a spinner where nothing is known of its steps.

    It gives a function that is called with the name of each step before the step begins. `steps`: how many alike there
    are, or of each how its name begins or ends, and what part of the work it is: one that comes early, as others before
    it are not needed, moves the bar there. `lines`: steps take long, so each gets a line where standard error is no
    terminal.
    """
    work = Steps([("", 1.0)] * steps if isinstance(steps, int) else steps)
    bar = progress_bar(
        *(("Bar", "TaskProgress", "TimeElapsed", "Left") if work.known else ("Spinner", "TimeElapsed"))
    )
    task, begun = bar.add_task("", total=work.total or None), 0

    def begin(text: str) -> None:
        nonlocal begun
        bar.update(task, completed=work.begin(text), description=text)
        begun += 1
        if lines and bar.disable:
            typer.echo(f"step {begun} of about {len(work.known)}: {text}", err=True)

    with bar:
        yield begin


class ProofProgress(ExitStack):
    """A bar of the estimated share of a proof, with the cells done; silent where standard error is not a terminal."""

    def __init__(self) -> None:
        super().__init__()
        self._bar = self.enter_context(progress_bar("Bar", "TaskProgress", "TimeElapsed", "Left"))
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
