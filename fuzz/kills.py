"""Processes that are killed while they write: what stood there is whole, old or new, and the next run is as the first.

A process that has everything loaded forks one child per attempt. Most children stop themselves by SIGKILL, SIGTERM or
SIGINT at a drawn line of the code that touches the disk, which a seed repeats exactly; the others, and whole commands
of the command line, are stopped from outside after a drawn time.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import flexhinf as fh
from flexhinf import report
from flexhinf.cli import main
from flexhinf.codegen import compiler as cache
from flexhinf.errors import FlexhinfError
from flexhinf.report.folder import MARKER
from fuzz.command_line import ARM, QUICK
from fuzz.tally import Tally

ATTEMPTS = 300
WHOLE = {0: signal.SIGTERM, 15: signal.SIGKILL, 100: signal.SIGINT, 200: signal.SIGKILL}
"""Of these, whole commands in processes of their own, and how they are stopped; a tenth of the attempts has two."""

SOON = 2.5
"""A command is stopped within so many seconds: it takes about as long."""

SIGNALS = (signal.SIGKILL, signal.SIGKILL, signal.SIGTERM, signal.SIGINT)

#: Files whose lines are counted: ours that write, and the standard library's that they write with.
WATCHED = (
    "flexhinf/files.py",
    "report/folder.py",
    "codegen/cache.py",
    "tempfile.py",
    "shutil.py",
    "zipfile.py",
)

#: More lines than any of the works goes through, and seconds that a child may take.
LINES, PATIENCE_S = 3000, 300.0

#: A frame of a command that has begun. Before that, while Python imports it, an interruption is Python's own.
BEGUN = re.compile(r"flexhinf/cli/[^\n]*, in (?!<module>)")

LEFT_OVERS = (".part", "flexhinf-new", "flexhinf-old", "flexhinf-lock")


@dataclass(frozen=True)
class Work:
    """Something that is written: `write(place, version)`, and `read(place)` that gives the version or raises."""

    name: str
    write: Callable[[Path, int], Any]
    read: Callable[[Path], int]


def run(attempts: int, seed: int) -> Tally:
    """Write version 1; be killed while version 2 is written; look; write version 3."""
    tally = Tally("kills: SIGKILL, SIGTERM, SIGINT while reports, files and caches are written")
    rng = np.random.default_rng([seed, 7])
    works = _works()
    with tempfile.TemporaryDirectory() as name:
        for attempt in range(attempts):
            folder = Path(name) / str(attempt)
            folder.mkdir()
            if attempt in WHOLE:
                number = WHOLE[attempt]
                how = f"seed {seed}, attempt {attempt}, a command, {number.name}"
                fault = _command(folder, number, float(rng.uniform(0.0, SOON)))
            else:
                number = SIGNALS[rng.integers(len(SIGNALS))]
                work = works[rng.integers(len(works))]
                line = int(rng.exponential(250.0)) if rng.random() < 0.9 else None
                delay = float(rng.uniform(0.0, 0.02))
                how = f"seed {seed}, attempt {attempt}, {work.name}, {number.name}, line {line}"
                fault = _attempt(work, folder, number, line, delay)
            tally.answered(fault, how)
            shutil.rmtree(folder)
    return tally


# What is written ------------------------------------------------------------------------------------
def _works() -> list[Work]:
    plant = fh.PolynomialPlant(
        f={(1, 0): [0, -1], (0, 1): [1, 0.5], (3, 0): [0, -0.3]}, g1=[[0], [1]], g2=[[0], [1]],
        h={(1, 0): [1, 0], (0, 1): [0, 1]}, r2=1.0,
    )  # fmt: skip
    solutions = {version: fh.solve_hji(plant, 2.0 + version, 4) for version in (1, 2, 3)}
    periods = {version: version * 1e-3 for version in (1, 2, 3)}
    controllers = {v: fh.Controller(solutions[1], None, period) for v, period in periods.items()}

    def version_of(value: float, values: dict[int, float]) -> int:
        return next(version for version, other in values.items() if other == value)

    def write_run(place: Path, version: int) -> None:
        runs[version].save(place.with_suffix(".csv"))

    def read_run(place: Path) -> int:
        lines = place.with_suffix(".csv").read_text().splitlines()
        return version_of(len(lines) - 1, lengths)

    runs, lengths = {}, {}
    arm = fh.Plant(
        lambda x, u, d, p: np.array([x[1], -x[0] + u[0]]), lambda x, u, p: x, solutions[1].state_names,
        solutions[1].input_names,
    )  # fmt: skip
    for version in (1, 2, 3):
        loop = fh.Loop(arm, fh.Controller(solutions[1], None, 1e-2))
        runs[version] = loop.run(duration=0.1 * version, initial_state=[0.1, 0.0])
        lengths[version] = float(len(runs[version].time))
    return [
        Work("report.write", _write_report, _read_report),
        Work("report.check and write", lambda place, v: (report.check(place), _write_report(place, v)), _read_report),
        Work(
            "HJISolution.save", lambda place, v: solutions[v].save(place),
            lambda place: version_of(fh.load_solution(place).gamma, {v: 2.0 + v for v in solutions}),
        ),
        Work(
            "Controller.save", lambda place, v: controllers[v].save(place),
            lambda place: version_of(fh.load_controller(place).period, periods),
        ),
        Work("Trajectory.save", write_run, read_run),
        Work("the cache of machine code", _write_cache, _read_cache),
    ]  # fmt: skip


def _write_report(place: Path, version: int) -> None:
    report.write(
        place, {"index.html": f"{version}", **{f"runs/{k}.txt": f"{version}" * 1000 for k in range(5)}}
    )


def _read_report(place: Path) -> int:
    """A report as its marker lists it, all of one version."""
    version = int((place / "index.html").read_text())
    listed = {MARKER, *json.loads((place / MARKER).read_text())["files"]}
    found = {path.relative_to(place).as_posix() for path in place.rglob("*") if path.is_file()}
    texts = {(place / f"runs/{k}.txt").read_text() for k in range(5)}
    if found != listed or len(found) != 7 or texts != {f"{version}" * 1000}:
        raise AssertionError(f"files {sorted(found)}")
    return version


def _write_cache(place: Path, version: int) -> None:
    os.environ["FLEXHINF_CACHE"] = str(place)
    cache.cached((str(version),), lambda: b"%d" % version * 5000)


def _read_cache(place: Path) -> int:
    """What is kept of any version is what was made of it; the newest that is kept."""
    os.environ["FLEXHINF_CACHE"] = str(place)
    kept = []
    for version in (1, 2, 3):
        code = cache._read(place / f"{cache._key((str(version),)).hex()}.o", cache._key((str(version),)))
        if code is not None:
            kept.append(version)
            if code != b"%d" % version * 5000:
                raise AssertionError("other code")
    return max(kept, default=0)


# How it is killed -----------------------------------------------------------------------------------
def _attempt(work: Work, folder: Path, number: signal.Signals, line: int | None, delay: float) -> str:
    """What is wrong after this child; empty if nothing is."""
    place = folder / "place"
    if line is None or line % 4:
        work.write(place, 1)
    signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS[1:])  # until the child can answer them
    child = os.fork()
    if not child:
        _child(work, place, number, line)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS[1:])
    if line is None:
        time.sleep(delay)
        os.kill(child, number)
    status = _waited(child)
    ended = status in (0, -number, 128 + number)
    if not ended:
        return f"the process ended with {status}"
    with_first = line is None or line % 4
    try:
        found = work.read(place)
    except Exception as error:
        if with_first or place.with_suffix(".csv").exists() or (place.exists() and any(place.iterdir())):
            return f"after it: {type(error).__name__}: {str(error)[:200]}"
        found = 0
    if status == 0 and found != 2:
        return f"a process that ended in order left version {found}"
    return _next(work, place)


def _next(work: Work, place: Path) -> str:
    """The next run succeeds and leaves nothing beside what it writes."""
    try:
        work.write(place, 3)
        if work.read(place) != 3:
            return "the next run wrote nothing"
    except Exception as error:
        return f"the next run: {type(error).__name__}: {str(error)[:200]}"
    left = [str(path) for path in place.parent.rglob("*") if any(one in path.name for one in LEFT_OVERS)]
    return f"after the next run there is still {left[0]}" if left else ""


def _child(work: Work, place: Path, number: signal.Signals, line: int | None) -> None:
    """Write version 2, as a command would; killed at this line, or from outside."""
    code = 1
    try:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        sys.unraisablehook = _quiet
        signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS[1:])
        if line is not None:
            sys.settrace(_Lines(line, number).call)
        work.write(place, 2)
        code = 0
    except KeyboardInterrupt:
        code = 128 + signal.SIGINT
    except FlexhinfError:
        code = 3
    finally:
        os._exit(code)


def _quiet(lost: Any) -> None:
    """What the interpreter cannot raise is no fault of what is written: archives that are closed half-way."""


class _Lines:
    """A tracer that sends a signal to its own process at a line of the watched files."""

    def __init__(self, line: int, number: int) -> None:
        self._rest, self._number = line, number

    def call(self, frame: Any, event: str, argument: Any) -> Any:
        """Of a new frame."""
        return self.line if frame.f_code.co_filename.endswith(WATCHED) else None

    def line(self, frame: Any, event: str, argument: Any) -> Any:
        """Of each line of a watched one."""
        self._rest -= 1
        if self._rest == 0:
            os.kill(os.getpid(), self._number)
        return self.line


def _waited(child: int) -> int:
    """Exit code of a child, negative for a signal; one that does not end is a fault."""
    until = time.monotonic() + PATIENCE_S
    while time.monotonic() < until:
        found, status = os.waitpid(child, os.WNOHANG)
        if found:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.001)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return 1000


def _command(folder: Path, number: signal.Signals, delay: float) -> str:
    """``flexhinf design`` as a process of its own, killed after some seconds; then once more, in this process."""
    (folder / "arm.toml").write_text(ARM, encoding="utf-8")
    words = ["design", str(folder / "arm.toml"), *QUICK, "--out", str(folder / "out")]
    script = "import sys; from flexhinf.cli import main; sys.exit(main(sys.argv[1:]))"
    process = subprocess.Popen(
        [sys.executable, "-c", script, *words], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    try:
        _, errors = process.communicate(timeout=delay)
    except subprocess.TimeoutExpired:
        process.send_signal(number)
        try:
            _, errors = process.communicate(timeout=PATIENCE_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            return f"the process did not end in {PATIENCE_S:g} s"
    code = process.returncode
    if code not in (0, 1, -number, 128 + number, -signal.SIGINT):
        return f"exit code {code}"
    if "Traceback" in errors and BEGUN.search(errors):
        return f"a traceback: {errors[-200:]!r}"
    written = (folder / "out").exists()
    if code in (0, 1) and not written:
        return f"exit code {code}, and no report"
    if written and (
        "nothing was written" in errors or (code == 128 + number and "written and whole" not in errors)
    ):
        return f"exit code {code}, a report, and {errors[-200:]!r}"
    if (folder / "out").exists() and not report.is_report(folder / "out"):
        return "half a report"
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        again = main(words)
    if again not in (0, 1) or not report.is_report(folder / "out"):
        return "the next run wrote no report"
    left = [path.name for path in folder.iterdir() if any(one in path.name for one in LEFT_OVERS)]
    return f"after the next run there is still {left[0]}" if left else ""
