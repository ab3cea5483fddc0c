"""A report's folder: replaced whole, and nothing else is ever touched."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from flexhinf import report
from flexhinf.errors import InvalidInput
from flexhinf.report.folder import MARKER

FILES = {"index.html": "<p>γ</p>", "figures/a.svg": b"\x00\xff"}


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
    (target / "left_over.svg").touch()
    report.write(target, {"index.html": "new"})
    assert names(target) == {"index.html", MARKER}
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
        with pytest.raises(InvalidInput, match="not a report of flexhinf"):
            act(tmp_path)
    assert names(tmp_path) == {"thesis.tex", MARKER}


def test_a_file_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "r").write_text("mine")
    with pytest.raises(InvalidInput, match="there is a file"):
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
        with pytest.raises(InvalidInput, match="the folder you are in"):
            report.check(target)


def test_checking_changes_nothing(tmp_path: Path) -> None:
    assert report.check(tmp_path / "a" / "r") == tmp_path / "a" / "r"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "name", ["", "/etc/x", "../x", "a/../../x", "a\\b", "a\0b", "a\ud800", "a\nb", MARKER]
)
def test_a_file_that_would_leave_the_folder_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(InvalidInput, match="stays inside its folder"):
        report.write(tmp_path / "r", {name: "x"})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("failing", [1, 2])
@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError])
def test_interrupted_it_leaves_the_earlier_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failing: int, error: type[BaseException]
) -> None:
    """Whichever of the two renames is cut short, the earlier report stands and nothing lies beside it."""
    target = report.write(tmp_path / "r", FILES)
    calls: list[object] = []
    rename = os.rename

    def cut_short(source: object, destination: object) -> None:
        calls.append(source)
        if len(calls) == failing:
            raise error
        rename(source, destination)  # type: ignore[arg-type]

    monkeypatch.setattr(os, "rename", cut_short)
    with pytest.raises(KeyboardInterrupt if error is KeyboardInterrupt else InvalidInput):
        report.write(target, {"index.html": "new"})
    assert names(target) == {*FILES, MARKER}
    assert list(tmp_path.iterdir()) == [target]


def test_what_a_killed_run_left_is_cleared_away(tmp_path: Path) -> None:
    process = dead_process()
    for left_over in (f".r.flexhinf-new-{process}-00ff", f".r.flexhinf-old-{process}-00ff"):
        (tmp_path / left_over).mkdir()
        (tmp_path / left_over / "half").touch()
    others = {f".r.flexhinf-new-{os.getpid()}-00ff", f".other.flexhinf-new-{process}-00ff"}
    for other in others:
        (tmp_path / other).mkdir()
    report.write(tmp_path / "r", FILES)
    assert {path.name for path in tmp_path.iterdir()} == {"r", *others}


def test_a_report_that_a_killed_run_had_set_aside_comes_back(tmp_path: Path) -> None:
    target = report.write(tmp_path / "r", FILES)
    target.rename(tmp_path / f".r.flexhinf-old-{dead_process()}-00ff")
    report.check(target)
    assert names(target) == {*FILES, MARKER}
