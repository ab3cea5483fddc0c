"""Ctrl-C, `kill` and a closed terminal end a command in order, whatever a library does with them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from flexhinf import cli, report
from flexhinf.cli import commands, main

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")


def signalled(number: int, lost: bool) -> Any:
    """A command that gets a signal; where it is lost, a library has swallowed the exception, and works until the next
    look."""

    def command(**_: object) -> int:
        try:
            signal.raise_signal(number)
        except KeyboardInterrupt:
            if not lost:
                raise
        if signal.getitimer(signal.ITIMER_REAL)[1] > 0.0:  # looks come again and again
            signal.pause()
        return 0

    return command


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("lost", [False, True], ids=["", "lost"])
def test_a_signal_ends_a_command_with_the_shells_code(
    number: int, lost: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    before = [signal.getsignal(one) for one in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGALRM)]
    monkeypatch.setattr(commands, "app", signalled(number, lost))
    monkeypatch.setattr(cli, "_LOOK_AGAIN", 0.05)
    assert main(["robots"]) == 128 + number
    (told,) = capsys.readouterr().err.splitlines()
    assert told.startswith("error: Interrupted")
    assert "nothing" in told
    after = [signal.getsignal(one) for one in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGALRM)]
    assert after == before


def test_an_interruption_that_is_on_its_way_is_not_given_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Clearing away outlasts two looks: what is interrupted there would be left half done."""
    cleared: list[str] = []

    def command(**_: object) -> int:
        try:
            signal.raise_signal(signal.SIGTERM)
        finally:
            for _look in range(2):
                signal.raise_signal(signal.SIGALRM)
            cleared.append("all")
        return 0

    monkeypatch.setattr(commands, "app", command)
    assert main(["robots"]) == 143
    assert cleared == ["all"]


def test_what_a_library_makes_of_an_interruption_is_no_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    def command(**_: object) -> int:
        with suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        raise NotImplementedError("no overload of this function")

    monkeypatch.setattr(commands, "app", command)
    assert main(["robots"]) == 130


def test_signals_that_are_ignored_stay_so_and_other_threads_leave_them_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(commands, "app", lambda **_: os.kill(os.getpid(), signal.SIGHUP) or 0)
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        assert main(["robots"]) == 0
    finally:
        signal.signal(signal.SIGHUP, before)
    codes: list[int] = []
    monkeypatch.setattr(commands, "app", lambda **_: 0)
    thread = threading.Thread(target=lambda: codes.append(main(["robots"])))
    thread.start()
    thread.join()
    assert codes == [0]


BUSY = """
import ctypes, signal, sys, threading
from concurrent.futures import ThreadPoolExecutor
from flexhinf import cli
from flexhinf.cli import commands, console
def wait():
    lock, mutex = ctypes.CDLL(None).pthread_mutex_lock, ctypes.create_string_buffer(64)
    while True:  # the second one waits for ever, and no signal ends it
        lock(mutex)
def command(**_):
    if "behind" in where:
        threading.Thread(target=wait).start()
    print("ready", flush=True)
    while "behind" in where:
        signal.pause()
    if "beside" in where:
        with ThreadPoolExecutor(1) as pool:
            pool.submit(wait)
    wait()
cli._PATIENCE, commands.app = 0.05, command
where, sys.argv[1:] = sys.argv[1:], ["robots"]
console()
"""


@pytest.mark.quick_cases(1)
@pytest.mark.skipif(sys.platform != "linux", reason="a lock of Linux")
@pytest.mark.costs("starts a process")
@pytest.mark.parametrize(
    ("number", "where"), [(signal.SIGTERM, "beside"), (signal.SIGINT, "here"), (signal.SIGTERM, "behind")]
)
def test_a_signal_ends_a_process_that_is_busy_in_compiled_code(number: int, where: str) -> None:
    """The compiler of a large design took 23 s, also beside or behind the main thread; a container waits for ten."""
    words = [sys.executable, "-c", BUSY, where]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"
            process.send_signal(number)
            _, told = process.communicate(timeout=60)
        finally:
            process.kill()
    assert process.returncode == 128 + number
    assert told.startswith("error: Interrupted")


def test_a_signal_that_a_command_handles_itself_does_not_end_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """As a run in real time, which then writes its log."""
    told: list[int] = []

    def command(**_: object) -> int:
        signal.signal(signal.SIGTERM, lambda number, frame: told.append(number))
        signal.raise_signal(signal.SIGTERM)
        return 0

    monkeypatch.setattr(commands, "app", command)
    monkeypatch.setattr(cli, "_PATIENCE", 0.0)
    assert main(["robots"]) == 0
    assert told == [signal.SIGTERM]


TERMINATED = """
import os, sys, pathlib
write = pathlib.Path.write_bytes
def ended(path, content):
    os.kill(os.getpid(), 15)
    return write(path, content)
pathlib.Path.write_bytes = ended
from flexhinf import report
from flexhinf.cli import commands, main
commands.app = lambda **_: report.write(sys.argv[1], {"index.html": "new"}) and 0
sys.exit(main(["robots"]))
"""


def test_a_terminated_command_leaves_the_earlier_report_and_nothing_beside_it(tmp_path: Path) -> None:
    target = report.write(tmp_path / "r", {"index.html": "old"})
    run = subprocess.run([sys.executable, "-c", TERMINATED, str(target)], capture_output=True, check=False)
    assert (run.returncode, run.stderr) == (143, b"error: Interrupted; nothing was written.\n")
    assert (target / "index.html").read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]
