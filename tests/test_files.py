"""Files are written whole: what killed processes began is cleared away, and an interruption stays one."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from tests.refusals import refused_with

from flexhinf import files
from flexhinf.errors import InvalidInput
from flexhinf.files import part_file, write_arrays, write_file

posix = pytest.mark.skipif(os.name != "posix", reason="locks and signals of the kernel")

KILLED = """
import os, sys
from flexhinf.files import write_file
write_file(sys.argv[1], "run", lambda name: os.kill(os.getpid(), 9))
"""


def write(path: Path, text: str) -> None:
    write_file(path, "run", lambda name: Path(name).write_text(text))


@posix
def test_what_a_killed_process_began_is_cleared_away_by_the_next_one_that_writes_there(
    tmp_path: Path,
) -> None:
    command = [sys.executable, "-c", KILLED, str(tmp_path / "run.nc")]
    assert subprocess.run(command, check=False).returncode == -9
    theirs = tmp_path / ".run.nc.notes.part"
    theirs.touch()
    assert len(list(tmp_path.iterdir())) == 2
    write(tmp_path / "run.nc", "whole")
    assert set(tmp_path.iterdir()) == {tmp_path / "run.nc", theirs}


@posix
def test_what_another_process_is_writing_is_not_cleared_away(tmp_path: Path) -> None:
    with part_file(tmp_path, ".run.nc.") as writing:
        write(tmp_path / "run.nc", "other")
        assert os.path.exists(writing)
    assert list(tmp_path.iterdir()) == [tmp_path / "run.nc"]


@posix
def test_a_part_that_is_a_pipe_or_a_link_is_neither_waited_for_nor_followed(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / ".run.nc.aaaaaaaa.part")
    (tmp_path / ".run.nc.bbbbbbbb.part").symlink_to(tmp_path / "precious")
    (tmp_path / "precious").write_text("mine")
    write(tmp_path / "run.nc", "whole")
    assert (tmp_path / "precious").read_text() == "mine"


def test_without_locks_only_old_parts_are_cleared_away(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(files, "fcntl", None)
    old, new = (tmp_path / f".run.nc.{letter * 8}.part" for letter in "on")
    for path in (old, new):
        path.touch()
    os.utime(old, (0, 0))
    write(tmp_path / "run.nc", "whole")
    assert set(tmp_path.iterdir()) == {tmp_path / "run.nc", new}


def test_an_interruption_while_an_archive_is_written_is_no_refusal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An archive that Ctrl-C leaves half-way raises an error of its own when it is closed."""

    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(np.lib.format, "write_array", interrupted)
    monkeypatch.setattr(np.lib._format_impl, "write_array", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_arrays(tmp_path / "file", "solution", {"a": np.zeros(3)})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="a folder that takes no files")
def test_a_folder_that_takes_no_files_has_no_locks() -> None:
    """The kernel says there that no such file exists, though the folder does."""
    with files.locked(Path("/proc/self/.flexhinf.lock")) as state:
        assert state == "none"


def test_files_of_a_folder_are_written_all_or_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "out"
    files.write_folder(folder, {"a": b"1", "b/c": b"2"})
    assert ((folder / "a").read_bytes(), (folder / "b" / "c").read_bytes()) == (b"1", b"2")
    (folder / "mine").write_text("stays")
    publish = files.publish

    def fails_at(name: str, error: type[BaseException]) -> None:
        def failing(temporary: object, path: Path) -> None:
            if path.name == name:
                raise error
            publish(temporary, path)  # type: ignore[arg-type]

        monkeypatch.setattr(files, "publish", failing)

    for name, error in (("c", KeyboardInterrupt), ("d", OSError), ("a", OSError)):
        fails_at(name, error)
        with pytest.raises(error):
            files.write_folder(folder, {"a": b"3", "d": b"4", "b/c": b"5"})
        assert (folder / "a").read_bytes() == b"1"
        assert (folder / "b" / "c").read_bytes() == b"2"
        assert sorted(path.name for path in folder.iterdir()) == ["a", "b", "mine"]
    fails_at("new", BlockingIOError)
    with pytest.raises(BlockingIOError):
        files.write_folder(tmp_path / "new", {"a": b"1"})
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    monkeypatch.setattr(files, "publish", publish)
    files.write_folder(folder, {"a": b"3", "d": b"4"})
    assert sorted(path.name for path in folder.iterdir()) == ["a", "b", "d", "mine"]


def test_only_a_file_of_the_same_kind_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "controller"

    def checked() -> None:
        files.check_replaceable(path, "library", lambda content: b"of ours" in content)

    checked()
    path.write_bytes(b"one of ours")
    checked()
    path.write_bytes(b"another one")
    with refused_with(InvalidInput, "library", str(path)):
        checked()
