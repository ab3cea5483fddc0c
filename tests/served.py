"""Runs commands and programs in forks of one interpreter, which has imported flexhinf and Matplotlib already.

Each has a process, folder, environment and output of its own, as one that is started anew; what it does not repeat is
half a second to a second of imports.

    with served.interpreter() as address:              # one for a file of tests
        served.ask(address, served.command, ("robots",), folder)
"""

from __future__ import annotations

import atexit
import gc
import importlib
import os
import subprocess
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing.connection import Client, Connection, Listener
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType
from typing import NamedTuple, NoReturn

REPOSITORY = Path(__file__).resolve().parents[1]
#: What most commands import sooner or later.
IMPORTED = (
    "flexhinf.cli.commands", "flexhinf.designs", "flexhinf.designs.workspace", "flexhinf.export", "flexhinf.campaign",
    "flexhinf.report", "llvmlite.binding", "matplotlib.figure", "matplotlib.backends.backend_agg",
    "matplotlib.backends.backend_svg", "scipy.optimize", "scipy.signal",
)  # fmt: skip


class Outcome(NamedTuple):
    """How a command or program ended: exit code, standard output and standard error."""

    code: int
    output: str
    errors: str


def command(words: Sequence[str]) -> int:
    """As ``flexhinf WORDS``."""
    from flexhinf.cli import main

    sys.argv = ["flexhinf", *words]
    return main(words)


def program(words: Sequence[str]) -> int:
    """As ``python -W error -c TEXT``; the only word is the text."""
    (text,) = words
    warnings.simplefilter("error")
    sys.modules["__main__"] = main = ModuleType("__main__")
    sys.argv = ["-c"]
    exec(compile(text, "<string>", "exec"), main.__dict__)
    return 0


@contextmanager
def interpreter() -> Iterator[str]:
    """Start one; its address. It ends after what it was asked for."""
    paths = [str(REPOSITORY / "src"), str(REPOSITORY), os.environ.get("PYTHONPATH", "")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))}
    with TemporaryDirectory() as folder:
        address = str(Path(folder) / "asked")
        words = [sys.executable, "-m", "tests.served", address]
        with subprocess.Popen(
            words, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE
        ) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == b"ready\n"
            try:
                yield address
            finally:
                Client(address).send(None)


def ask(address: str, call: Callable[[Sequence[str]], int], words: Sequence[str], work: Path) -> Outcome:
    """Have it call `command` or `program` in the folder `work`, with the environment of this process."""
    environment = {**os.environ, "MPLBACKEND": "Agg"}
    with TemporaryDirectory() as folder:
        streams = [Path(folder) / "output", Path(folder) / "errors"]
        with Client(address) as connection:
            connection.send((call.__name__, list(words), str(work), environment, [*map(str, streams)]))
            try:
                code = connection.recv()
            except EOFError:  # it was killed
                code = 137
        return Outcome(code, *(stream.read_text(encoding="utf-8") for stream in streams))


def _run(
    connection: Connection, name: str, words: list[str], work: str, told: dict[str, str], files: list[str]
) -> NoReturn:
    """In a fork: call it, and end this process."""
    code = 1
    try:
        for descriptor, file in enumerate(files, 1):
            os.dup2(os.open(file, os.O_WRONLY | os.O_CREAT | os.O_APPEND), descriptor)
        os.environ.clear()
        os.environ.update(told)
        os.chdir(work)
        code = {"command": command, "program": program}[name](words)
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException:
        traceback.print_exc()
    try:
        atexit._run_exitfuncs()
        sys.stdout.flush()
        sys.stderr.flush()
        connection.send(code)
    finally:
        os._exit(0)


def _serve(address: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for name in IMPORTED:
            importlib.import_module(name)
    gc.freeze()
    with Listener(address, family="AF_UNIX") as listener:
        os.write(1, b"ready\n")
        while True:
            with listener.accept() as connection:
                if (asked := connection.recv()) is None:
                    break
                if os.fork() == 0:
                    _run(connection, *asked)
            while _ended(os.WNOHANG):
                pass
    while _ended(0):
        pass


def _ended(options: int) -> bool:
    """Take leave of a fork that has ended; False where there is none."""
    try:
        return os.waitpid(-1, options)[0] > 0
    except ChildProcessError:
        return False


if __name__ == "__main__":
    _serve(sys.argv[1])
