"""A report's folder that several processes and containers write at once, and that somebody clears meanwhile."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.refusals import refused_with

from flexhinf import report
from flexhinf.errors import InvalidInput
from flexhinf.report.folder import MARKER

posix = pytest.mark.skipif(os.name != "posix", reason="locks of the kernel")

#: Above the largest process number of the kernel.
NOBODY = 4194305

FILES = {"index.html": "<p>γ</p>", "figures/a.svg": b"\x00\xff"}


def names(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


HOLDER = """
import pathlib, sys
from flexhinf.files import locked
with locked(pathlib.Path(sys.argv[1])) as state:
    print(state, flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def holder(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """Another process that holds the lock of a report at ``r``."""
    command = [sys.executable, "-c", HOLDER, str(tmp_path / ".r.flexhinf-lock")]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.communicate()


@pytest.mark.ci("starts processes")
@posix
def test_what_another_run_is_writing_is_not_cleared_away(
    tmp_path: Path, holder: subprocess.Popen[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever the process numbers in the names say: those of another container mean nothing here."""
    live = [tmp_path / f".r.flexhinf-{kind}-{NOBODY}-00ff" for kind in ("new", "old")]
    for folder in live:
        folder.mkdir()
    report.check(tmp_path / "r")
    assert all(folder.is_dir() for folder in live)
    monkeypatch.setattr("flexhinf.report.folder._PATIENCE", 0.1)
    with refused_with(InvalidInput, "run", ".r.flexhinf-lock") as caught:
        report.write(tmp_path / "r", FILES)
    assert ".r.flexhinf-lock" in caught.value.found
    assert all(folder.is_dir() for folder in live)
    holder.kill()
    holder.wait()
    report.write(tmp_path / "r", FILES)  # the lock ended with its process
    assert list(tmp_path.iterdir()) == [tmp_path / "r"]


@posix
def test_what_another_run_is_about_to_publish_is_not_judged(
    tmp_path: Path, holder: subprocess.Popen[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between its first and its last renaming the folder may look like a report with foreign files."""
    target = tmp_path / "r"
    target.mkdir()
    (target / MARKER).write_text('{"what": "flexhinf report", "version": 2, "files": {}}')
    (target / "index.html").touch()

    def finish() -> None:
        (target / "index.html").unlink(missing_ok=True)
        holder.kill()
        holder.wait()

    monkeypatch.setattr("flexhinf.report.folder._BRIEFLY", 600.0)
    monkeypatch.setattr("flexhinf.files.time.sleep", lambda seconds: finish())  # where `check` waits
    assert report.check(target) == target
    monkeypatch.undo()
    (target / "index.html").touch()
    with pytest.raises(InvalidInput, match=r"'index.html'"):
        report.check(target)


PUBLISHER = """
import os, pathlib, sys
def foreign(*_):
    raise ProcessLookupError  # what asking after a process of another container says
os.kill = foreign
def counted(rename):
    def counting(source, target):
        if str(target) == sys.argv[1] and "flexhinf-new" in str(source):
            print(sum(path.is_file() for path in pathlib.Path(source).rglob("*")))
        rename(source, target)
    return counting
os.rename, os.replace = counted(os.rename), counted(os.replace)
from flexhinf import report
from flexhinf.report import folder
def exchanging(exchange):
    def counting(source, target):
        print(sum(path.is_file() for path in pathlib.Path(source).rglob("*")))
        return exchange(source, target)
    return counting
folder.exchange = exchanging(folder.exchange)
for turn in range(6):
    report.write(sys.argv[1], {f"runs/{k:03d}.txt": f"{sys.argv[2]} {turn}" for k in range(60)})
"""


def inside_a_container(command: list[str]) -> list[str]:
    """The command in a process namespace of its own, where the system allows that."""
    own = ["unshare", "--user", "--map-root-user", "--pid", "--fork", "--mount-proc"]
    if shutil.which("unshare") is None:
        return command
    done = subprocess.run([*own, "true"], capture_output=True, text=True, timeout=60.0)
    refused = re.search("not permitted|denied", done.stderr)
    assert done.returncode == 0 or refused, done.stderr
    return command if refused else [*own, *command]


@pytest.mark.ci("starts processes")
@posix
def test_two_containers_publish_whole_reports_at_one_place(tmp_path: Path) -> None:
    target = tmp_path / "r"
    report.write(target, {"index.html": "first"})
    commands = [inside_a_container([sys.executable, "-c", PUBLISHER, str(target), who]) for who in "ab"]
    runs = [
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        for command in commands
    ]
    for run in runs:
        counts, errors = run.communicate(timeout=300.0)
        assert (counts.split(), errors, run.returncode) == (["61"] * 6, "", 0)
    assert len(names(target)) == 61
    assert len({(target / f"runs/{k:03d}.txt").read_text() for k in range(60)}) == 1
    assert list(tmp_path.iterdir()) == [target]


@pytest.mark.parametrize("lost", ["folder", "file"])
def test_a_folder_that_somebody_clears_meanwhile_is_not_published(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lost: str
) -> None:
    target = report.write(tmp_path / "r", {"index.html": "first"})
    write_bytes = Path.write_bytes

    def cleared(path: Path, content: bytes) -> int:
        written = write_bytes(path, content)
        if path.name == "b.svg":
            if lost == "folder":
                shutil.rmtree(path.parents[1])
            else:
                path.unlink()
        return written

    monkeypatch.setattr(Path, "write_bytes", cleared)
    with pytest.raises(InvalidInput):
        report.write(target, {"index.html": "new", "figures/b.svg": "", "figures/c.svg": "", "runs/d": ""})
    assert names(target) == {"index.html", MARKER}
    assert (target / "index.html").read_text() == "first"
    assert list(tmp_path.iterdir()) == [target]
