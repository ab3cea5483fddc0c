"""Where the output goes: encodings that lack a letter, pipes without a reader, full disks, refusals."""

from __future__ import annotations

import errno
import io
import json
import math
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import TextIO

import pytest
from rich.console import Console
from tests.refusals import unnamed

from flexhinf import cli
from flexhinf.cli import commands, main, messages
from flexhinf.designs import design_schema
from flexhinf.progress import time_left


def _output(raw: io.BytesIO, encoding: str) -> io.TextIOWrapper:
    return io.TextIOWrapper(raw, encoding=encoding)


@pytest.fixture
def unread() -> Iterator[TextIO]:
    """A pipe without a reader."""
    end, start = os.pipe()
    os.close(end)
    with open(start, "w", encoding="utf-8") as stream:
        yield stream


@pytest.fixture
def full() -> Iterator[TextIO]:
    """A disk without room."""
    if not os.path.exists("/dev/full"):
        pytest.skip("no /dev/full")
    with open("/dev/full", "w", encoding="utf-8") as stream:
        yield stream


@pytest.mark.quick_cases(5)
@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "cp1252", "utf-16"])
@pytest.mark.parametrize("words", [["robots"], ["schema"], ["design", "--help"]], ids=" ".join)
def test_a_letter_that_an_encoding_lacks_is_escaped(
    encoding: str, words: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    content = io.BytesIO()
    out = _output(content, encoding)
    monkeypatch.setattr(sys, "stdout", out)
    assert main(words) == 0
    assert out.errors == "strict"
    out.flush()
    text = content.getvalue().decode("utf-8" if encoding == "ascii" else encoding)
    assert len(text) > 500
    if words == ["schema"]:
        assert json.loads(text) == design_schema()


@pytest.mark.parametrize("words", [["robots"], ["schema"], ["--version"], ["--help"]], ids=" ".join)
def test_a_pipe_without_a_reader_has_the_shells_code(
    words: list[str], unread: TextIO, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Not 1, which says that a loop does not meet its specification."""
    monkeypatch.setattr(sys, "stdout", unread)
    assert main(words) == 141
    assert not capsys.readouterr().err


@pytest.mark.parametrize("words", [["robots"], ["schema"], ["--version"], ["--help"]], ids=" ".join)
def test_an_output_on_a_full_disk_is_an_error(
    words: list[str], full: TextIO, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "stdout", full)
    assert main(words) == 2
    told = capsys.readouterr().err
    assert told.startswith("error: ")
    assert os.strerror(errno.ENOSPC) in told
    assert "\n  try:" in told


def test_an_error_that_cannot_be_told_has_its_exit_code(
    full: TextIO, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stderr", full)
    assert main(["desing"]) == 2


@pytest.mark.parametrize("error", [MemoryError(), OSError(errno.EMFILE, "Too many open files")], ids=repr)
def test_what_the_system_refuses_is_told_in_three_parts(
    error: Exception, folder: Path, monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]
) -> None:
    def command(**_: object) -> int:
        raise error

    monkeypatch.setattr(commands, "app", command)
    refused(["robots"], "system", folder)


def test_a_library_that_cannot_be_loaded_is_told(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "flexhinf.cli.commands", None)
    assert cli.main(["robots"]) == 2
    told = capsys.readouterr().err
    assert told.startswith("error: ")
    assert "system" in told


def test_drawings_need_no_backend_of_windows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Matplotlib raises on a name that it does not know, after all the work was done."""
    monkeypatch.setenv("MPLBACKEND", "nonsense")
    monkeypatch.setattr(commands, "app", lambda **_: int("MPLBACKEND" in os.environ))
    assert main(["robots"]) == 0
    assert os.environ["MPLBACKEND"] == "nonsense"


class Bar(nullcontext[None]):
    """A bar that keeps the shares that it was moved to."""

    disable = False

    def add_task(self, text: str, total: float | None) -> int:
        self.total, self.shares = total, list[float]()
        return 0

    def update(self, task: int, completed: float, description: str) -> None:
        self.shares.append(completed / (self.total or math.inf))


def test_a_bar_says_how_long_the_rest_takes() -> None:
    """A quarter took 10 s, and the next step has run for 5 s: 25 s of 40 are left."""
    assert unnamed(time_left(0.25, 10.0, 15.0), "25 s") == []
    assert unnamed(time_left(0.25, 10.0, 60.0), "5 s") == []
    assert unnamed(time_left(0.1, 60.0, 60.0), "9 min") == []
    assert time_left(0.0, 0.0, 3.0) == time_left(1.0, 9.0, 9.0) == ""
    with messages.progress_bar("Bar", "Left") as bar:
        task = bar.add_task("runs", total=4.0)
        bar.tasks[0].start_time = bar.get_time() - 10.0
        bar.update(task, completed=1.0)
        stream = io.StringIO()
        Console(file=stream, width=90).print(bar.get_renderable())
    assert unnamed(stream.getvalue(), "30 s", "left runs") == []


def test_a_bar_moves_with_the_work(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not with the number of steps: tries that are not needed are done at once, and a long step has its part."""
    bar = Bar()
    monkeypatch.setattr(messages, "progress_bar", lambda *columns: bar)
    with messages.step_progress([("try", 1.0), ("try", 1.0), ("runs", 2.0), ("report", 4.0)]) as begin:
        for text in ("try 1", "20 runs", "something else", "report"):
            begin(text)
    assert bar.shares == [0.0, 0.25, 0.25, 0.5]
    with messages.step_progress(4) as begin:
        for text in "abcd":
            begin(text)
    assert bar.shares == [0.0, 0.25, 0.5, 0.75]
