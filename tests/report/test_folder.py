"""A report's folder: replaced whole, and nothing else is ever touched."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from tests.refusals import refused_with

from flexhinf import report
from flexhinf.errors import InvalidInput
from flexhinf.report import folder as report_folder
from flexhinf.report.folder import MARKER

posix = pytest.mark.skipif(os.name != "posix", reason="locks of the kernel")

FILES = {"index.html": "<p>γ</p>", "figures/a.svg": b"\x00\xff"}


@pytest.fixture(params=["in one act", "in two renamings"])
def exchanged(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """How a report takes the place of an earlier one: some systems cannot exchange two names."""
    if request.param == "in two renamings":
        monkeypatch.setattr("flexhinf.report.folder.exchange", lambda *_: False)
    return request.param


def names(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


def dead_process() -> int:
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


def test_a_new_folder_holds_the_files_and_the_marker_and_nothing_is_left_beside_it(tmp_path: Path) -> None:
    target = report.write(tmp_path / "parents" / "too" / "r", FILES)
    assert names(target) == {*FILES, MARKER}
    assert (target / "index.html").read_text(encoding="utf-8") == "<p>γ</p>"
    assert (target / "figures/a.svg").read_bytes() == b"\x00\xff"
    assert list(target.parent.iterdir()) == [target]
    assert report.is_report(target)


def test_an_earlier_report_is_replaced_whole(tmp_path: Path) -> None:
    target = report.write(tmp_path / "r", FILES)
    (target / ".DS_Store").touch()  # nobody's
    report.write(target, {"index.html": "new"})
    assert names(target) == {"index.html", MARKER}
    assert list(tmp_path.iterdir()) == [target]


def test_a_report_into_which_somebody_put_files_is_left_alone(tmp_path: Path) -> None:
    target = report.write(tmp_path / "r", FILES)
    (target / "figures" / "my notes.txt").write_text("hours of work")
    for act in (report.check, lambda path: report.write(path, {"index.html": "new"})):
        with refused_with(InvalidInput, "files", "report") as caught:
            act(target)
        assert "'figures/my notes.txt'" in caught.value.found
        assert "move" in caught.value.advice
    assert names(target) == {*FILES, MARKER, "figures/my notes.txt"}
    (target / "figures" / "my notes.txt").rename(tmp_path / "my notes.txt")
    assert names(report.write(target, {"index.html": "new"})) == {"index.html", MARKER}


def test_a_report_that_somebody_edited_or_that_holds_a_folder_of_theirs_is_left_alone(tmp_path: Path) -> None:
    target = report.write(tmp_path / "r", FILES)
    (target / "mine").mkdir()
    with pytest.raises(InvalidInput, match="'mine'"):
        report.write(target, FILES)
    (target / "mine").rmdir()
    (target / "index.html").write_text("hours of work")
    for act in (report.check, lambda path: report.write(path, FILES)):
        with pytest.raises(InvalidInput, match="changed") as caught:
            act(target)
        assert "'index.html'" in caught.value.found
    assert (target / "index.html").read_text() == "hours of work"
    (target / "index.html").unlink()
    (target / "index.html").symlink_to(tmp_path)
    with refused_with(InvalidInput, "changed", "'index.html'"):
        report.check(target)
    (target / "index.html").unlink()
    assert names(report.write(target, FILES)) == {*FILES, MARKER}


def test_a_report_of_the_first_version_is_replaced(tmp_path: Path) -> None:
    target = report.write(tmp_path / "r", FILES)
    (target / MARKER).write_text(json.dumps({"what": "flexhinf report", "version": 1, "files": [*FILES]}))
    assert names(report.write(target, {"index.html": "new"})) == {"index.html", MARKER}


@posix
def test_a_pipe_or_a_link_in_place_of_marker_or_lock_is_neither_waited_for_nor_followed(
    tmp_path: Path,
) -> None:
    target = tmp_path / "r"
    target.mkdir()
    os.mkfifo(target / MARKER)
    with pytest.raises(InvalidInput, match=MARKER):
        report.check(target)
    lock = tmp_path / ".other.flexhinf-lock"
    lock.symlink_to(tmp_path / "victim")
    with pytest.raises(InvalidInput, match="flexhinf-lock"):
        report.write(tmp_path / "other", FILES)
    assert not (tmp_path / "victim").exists()


@posix
def test_a_pipe_or_a_link_with_the_name_of_a_left_over_is_neither_waited_for_nor_followed(
    tmp_path: Path,
) -> None:
    precious = tmp_path / "precious"
    precious.mkdir()
    (precious / "thesis.tex").touch()
    script = "import sys; from flexhinf import report; report.write(sys.argv[1], {'index.html': ''})"
    for kind in ("new", "old"):
        os.mkfifo(tmp_path / f".r.flexhinf-{kind}-00ff")
        (tmp_path / f".r.flexhinf-{kind}-00fe").symlink_to(precious)
    subprocess.run([sys.executable, "-c", script, str(tmp_path / "r")], check=True, timeout=300.0)
    assert report.is_report(tmp_path / "r")
    assert (precious / "thesis.tex").exists()


@pytest.mark.parametrize("path", [None, 3, b"r", "", "a\0b"], ids=repr)
def test_what_is_no_path_is_refused(path: Any) -> None:
    for act in (report.check, lambda place: report.write(place, FILES)):
        with pytest.raises(InvalidInput, match=r"pathlib\.Path|folder cannot"):
            act(path)


def test_a_file_put_into_a_report_while_it_is_replaced_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, exchanged: str
) -> None:
    target = report.write(tmp_path / "r", FILES)
    exchange, rename = report_folder.exchange, os.rename

    def put_before(act: Any, *names: Path) -> Any:
        if target in names and not (tmp_path / "put").exists():
            (tmp_path / "put").touch()
            (target / "late.txt").touch()
        return act(*names)

    monkeypatch.setattr(os, "rename", lambda *names: put_before(rename, *names))
    monkeypatch.setattr(report_folder, "exchange", lambda *names: put_before(exchange, *names))
    with pytest.raises(InvalidInput, match=r"'late.txt'"):
        report.write(target, {"index.html": "new"})
    (tmp_path / "put").unlink()
    assert names(target) == {*FILES, MARKER, "late.txt"}
    assert list(tmp_path.iterdir()) == [target]


def test_the_same_files_give_the_same_folder(tmp_path: Path) -> None:
    first, second = (report.write(tmp_path / name, FILES) for name in "ab")
    assert {name: (first / name).read_bytes() for name in names(first)} == {
        name: (second / name).read_bytes() for name in names(second)
    }


def test_an_empty_folder_is_taken(tmp_path: Path) -> None:
    (tmp_path / "r").mkdir()
    assert names(report.write(tmp_path / "r", FILES)) == {*FILES, MARKER}


@pytest.mark.parametrize("content", ["", "not json", '"flexhinf report"', '{"what": "something else"}'])
def test_a_folder_that_is_no_report_is_left_alone(tmp_path: Path, content: str) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    (tmp_path / MARKER).write_text(content)
    for act in (report.check, lambda path: report.write(path, FILES)):
        with pytest.raises(InvalidInput, match=MARKER):
            act(tmp_path)
    assert names(tmp_path) == {"thesis.tex", MARKER}


def test_a_file_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "r").write_text("mine")
    with refused_with(InvalidInput, "file", "/r"):
        report.check(tmp_path / "r")
    with pytest.raises(InvalidInput, match="file"):
        report.check(tmp_path / "r" / "below")
    assert (tmp_path / "r").read_text() == "mine"


@pytest.mark.parametrize("path", ["", "x" * 300, "nul\0byte"])
def test_a_path_that_cannot_be_is_refused(tmp_path: Path, path: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InvalidInput):
        report.check(path)


def test_where_nothing_can_be_written_the_check_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "mkdir", refuse)  # the user of the tests may be one who is never refused
    with pytest.raises(InvalidInput, match="Permission denied"):
        report.check(tmp_path / "r")


def test_the_working_folder_and_those_above_it_are_not_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = report.write(tmp_path / "r", {**FILES, "sub/file": ""})
    for here in (target, target / "sub"):
        monkeypatch.chdir(here)
        with refused_with(InvalidInput, "above", str(target)):
            report.check(target)


def test_checking_changes_nothing(tmp_path: Path) -> None:
    assert report.check(tmp_path / "a" / "r") == tmp_path / "a" / "r"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "name", ["", "/etc/x", "../x", "a/../../x", "a\\b", "a\0b", "a\ud800", "a\nb", MARKER]
)
def test_a_file_that_would_leave_the_folder_is_refused(tmp_path: Path, name: str) -> None:
    with refused_with(InvalidInput, "relative", repr(name)):
        report.write(tmp_path / "r", {name: "x"})
    assert list(tmp_path.iterdir()) == []


def test_a_path_of_very_many_folders_is_refused_at_once(tmp_path: Path) -> None:
    """Half a million of them took 20 GB."""
    with refused_with(InvalidInput, "relative", "1000004 characters"):
        report.write(tmp_path / "r", {"a/" * 500_000 + "text": "text"})
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("failing", [1, 2])
@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError])
def test_interrupted_it_leaves_the_earlier_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failing: int, error: type[BaseException]
) -> None:
    """Whichever of the two renames is cut short, the earlier report stands and nothing lies beside it."""
    monkeypatch.setattr(report_folder, "exchange", lambda *_: False)
    target = report.write(tmp_path / "r", FILES)
    calls: list[object] = []
    rename = os.rename

    def cut_short(source: object, destination: object) -> None:
        calls.append(source)
        if len(calls) == failing:
            raise error
        rename(source, destination)  # type: ignore[arg-type]

    monkeypatch.setattr(os, "rename", cut_short)
    monkeypatch.setattr(os, "replace", cut_short)
    with pytest.raises(KeyboardInterrupt if error is KeyboardInterrupt else InvalidInput):
        report.write(target, {"index.html": "new"})
    assert names(target) == {*FILES, MARKER}
    assert list(tmp_path.iterdir()) == [target]


@pytest.mark.skipif(sys.platform not in ("linux", "darwin"), reason="two names cannot be exchanged")
def test_there_is_a_report_at_every_moment_while_another_takes_its_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = report.write(tmp_path / "r", {"index.html": "old"})
    places = ["flexhinf/files.py", "report/folder.py"]
    missing: list[str] = []

    def look(frame: Any, event: str, argument: Any) -> Any:
        if not frame.f_code.co_filename.endswith(tuple(places)):
            return None
        if not (target / "index.html").exists():
            missing.append(f"{frame.f_code.co_name}:{frame.f_lineno}")
        return look

    before = sys.gettrace()
    sys.settrace(look)
    try:
        report.write(target, {"index.html": "new"})
    finally:
        sys.settrace(before)
    assert missing == []
    assert (target / "index.html").read_text() == "new"
    assert list(tmp_path.iterdir()) == [target]


def test_what_a_killed_run_left_is_cleared_away(tmp_path: Path) -> None:
    process = dead_process()  # versions before this one had process numbers in the names
    for left_over in ("new-00ff", "old-00ff", f"new-{process}-00ff", f"old-{process}-00ff"):
        (tmp_path / f".r.flexhinf-{left_over}").mkdir()
        (tmp_path / f".r.flexhinf-{left_over}" / "half").touch()
    (tmp_path / ".r.flexhinf-lock").touch()
    other = tmp_path / ".other.flexhinf-new-00ff"
    other.mkdir()
    report.write(tmp_path / "r", FILES)
    assert set(tmp_path.iterdir()) == {tmp_path / "r", other}


def test_a_report_that_a_killed_run_had_set_aside_comes_back(tmp_path: Path) -> None:
    target = report.write(tmp_path / "r", FILES)
    target.rename(tmp_path / ".r.flexhinf-old-00ff")
    report.check(target)
    assert names(target) == {*FILES, MARKER}
