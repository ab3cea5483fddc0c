"""Programs that an export calls: one that is not there is told from one that fails."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from flexhinf.errors import InvalidInput, refuse_if

#: Names of the C compiler where CC states none.
COMPILERS = ("cc", "gcc", "clang")

#: What a program says, as far as a message repeats it, characters.
REPEATED = 400

#: A program with the headers of exported C, and with what that calls of the mathematical library.
TRIAL = """
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
int main(void) { volatile double one = 1.0; return (sqrt(one) < 2.0) ? 0 : 1; }
"""


def c_compiler() -> list[str] | None:
    """The C compiler with its flags, as CC states it, or the first of `COMPILERS`; None where there is none.

    Raises InvalidInput: CC names a program that is not there.
    """
    if stated := shlex.split(os.environ.get("CC", "")):
        refuse_if(
            shutil.which(stated[0]) is None,
            "The C compiler that CC names is not there.",
            f"expected a program on the PATH, got CC={shlex.join(stated)}",
            f"one that is installed; or an environment without CC, for the first of {', '.join(COMPILERS)}",
        )
        return stated
    return next(([name] for name in COMPILERS if shutil.which(name) is not None), None)


def required_compiler() -> list[str]:
    """As `c_compiler`. Raises InvalidInput: there is none."""
    compiler = c_compiler()
    if compiler is None:
        raise InvalidInput(
            "There is no C compiler.",
            f"expected the one that CC names, or one of {', '.join(COMPILERS)}, found none",
            "install one; or `flexhinf export c`, which needs none",
        )
    return compiler


def run(command: Sequence[str], folder: Path, what: str, advice: str) -> str:
    """What a program prints that runs in a folder.

    `what`, `advice`: The first and the last part of the error where it fails. Raises InvalidInput: it does; the
    program's own words are in it.
    """
    done = _done(command, folder)
    refuse_if(isinstance(done, str) or done.returncode, what, why(command, done), advice)
    assert not isinstance(done, str)
    return done.stdout


def why(command: Sequence[str], done: subprocess.CompletedProcess[str] | str) -> str:
    """How a program ended, in its own words; `done` is a text where it did not begin."""
    if isinstance(done, str):
        return f"{shlex.join(command)}: {done}"
    said = (done.stderr.strip() or done.stdout.strip() or "it said nothing")[:REPEATED]
    return f"{shlex.join(command)} ended with {done.returncode}: {said}"


def accepts(compiler: Sequence[str], flags: Sequence[str]) -> bool:
    """Whether a C compiler knows flags: an older one, or one of another machine, has no names of some processors."""
    return not unusable(compiler, (*flags, "-c"))


def unusable(compiler: Sequence[str], flags: Sequence[str], runs: bool = False) -> str:
    """Why a compiler cannot translate the smallest program with these flags, in its own words; "" where it can.

    It may lack a flag, a header or a library. `runs`: Also what it makes must run here: it may be one for another
    machine.
    """
    place = shutil.which(compiler[0]) or compiler[0]
    changed = os.stat(place).st_mtime_ns if os.path.exists(place) else 0
    return _trial((place, *compiler[1:]), tuple(flags), runs, changed)


@cache
def _trial(compiler: tuple[str, ...], flags: tuple[str, ...], runs: bool, changed: int) -> str:
    """As `unusable`; once for a file as it was `changed` last."""
    with TemporaryDirectory() as work:
        folder = Path(work)
        (folder / "trial.c").write_text(TRIAL, encoding="utf-8")
        library = () if "-c" in flags or "-S" in flags else ("-lm",)
        commands = [[*compiler, "-std=c99", *flags, "trial.c", *library, "-o", "trial"], ["./trial"]]
        for command in commands[: 1 + runs]:
            done = _done(command, folder)
            if isinstance(done, str) or done.returncode:
                return " ".join(why(command, done).split())
    return ""


def _done(command: Sequence[str], folder: Path) -> subprocess.CompletedProcess[str] | str:
    """How a program ended; why it did not begin."""
    try:
        return subprocess.run(
            command, cwd=folder, capture_output=True, text=True, check=False, errors="replace"
        )
    except OSError as error:
        return str(error.strerror or error)
