"""``flexhinf export``: from a report, from a controller's file, from a design file alone."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import pytest
from tests.refusals import unnamed

import flexhinf as fh
from flexhinf import report
from flexhinf.cli import main


@pytest.fixture
def controller(tmp_path: Path) -> Path:
    law = fh.linear_law(fh.paper_arm().problem(), gamma=math.inf)
    fh.Controller(law, None, 1e-3, 48.0).save(tmp_path / "controller")
    return tmp_path / "controller"


def test_the_file_of_a_controller(
    controller: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", "c", str(controller), "--out", str(tmp_path / "c"), "--name", "arm"]) == 0
    assert {"arm.c", "arm.h", "arm_test.c", "README.md"} <= {path.name for path in (tmp_path / "c").iterdir()}
    assert "make -C" in capsys.readouterr().out


def test_a_controller_that_is_there_needs_neither_a_synthesis_nor_pages(controller: Path) -> None:
    code = (
        f"import sys; from flexhinf.cli.design import controller_of; controller_of({str(controller)!r});"
        "print({'flexhinf.design.pipeline', 'flexhinf.pages.page', 'scipy', 'matplotlib'} & set(sys.modules))"
    )
    outcome = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert outcome.stdout.strip() == "set()"


def test_the_report_of_a_design(controller: Path, tmp_path: Path) -> None:
    """The controller of a report is taken while the design file beside it is the one that it was made of."""
    design = '[design]\nrobot = "paper"\n'
    folder = report.write(tmp_path / "arm", {"design.toml": design, "controller": controller.read_bytes()})
    assert report.unchanged(folder, ("design.toml", "controller"))
    for source in (folder, folder / "design.toml"):
        out = tmp_path / f"of-{source.name}"
        assert main(["export", "c", str(source), "--out", str(out)]) == 0
        assert (out / "paper.c").exists() or len(list(out.glob("*.c"))) == 3
    (folder / "design.toml").write_text(design + "bandwidth = 2.0\n")
    assert not report.unchanged(folder, ("design.toml", "controller"))
    assert not report.unchanged(folder, ("design.toml", "missing"))
    assert not report.unchanged(tmp_path, ("controller",))


@pytest.mark.parametrize("changed", ["design.toml", "controller"])
def test_what_was_changed_since_the_report_is_named(
    changed: str,
    controller: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A damaged controller is not told as a design file that was changed."""

    def stop(*given: object) -> None:
        raise fh.InvalidInput("A design begins.")

    monkeypatch.setattr(fh, "design", stop)
    files = {"design.toml": b'[design]\nrobot = "paper"\n', "controller": controller.read_bytes()}
    folder = report.write(tmp_path / "arm", files)
    (folder / changed).write_bytes(files[changed] + b"\n")
    assert main(["export", "c", str(folder), "--out", str(tmp_path / "c")]) == 2
    told = capsys.readouterr().err
    assert "A design begins." in told
    assert [name for name in files if f"{name} was changed" in told] == [changed]


@pytest.mark.parametrize("source", ["paper", "arm.toml"])
def test_a_robot_is_told_from_a_controller(
    source: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.toml").write_text('[[joint]]\nname = "shoulder"\n')
    for words in (["export", "c"], ["export", "fmu"], ["compile"]):
        assert main([*words, source, "--out", "made"]) == 2
        told = capsys.readouterr().err
        assert "controller" in told
        assert f"flexhinf design {source}" in told
    assert not (tmp_path / "made").exists()


def test_a_folder_with_files_needs_force(
    controller: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "c"
    out.mkdir()
    (out / "mine.txt").write_text("mine")
    words = ["export", "c", str(controller), "--out", str(out)]
    assert main(words) == 2
    assert "--force" in capsys.readouterr().err
    assert main([*words, "--force"]) == 0
    assert (out / "mine.txt").read_text() == "mine"


def test_a_stored_law_is_called_what_it_was(controller: Path, tmp_path: Path) -> None:
    assert main(["export", "c", str(controller), "--out", str(tmp_path / "c")]) == 0
    assert "| law | HJISolution |" in (tmp_path / "c" / "README.md").read_text()


def test_the_gear_ratios_of_the_robot_are_stated(
    controller: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The robot of a report's design file; the file of a controller has none."""
    found = fh.load_controller(controller), fh.load_robot("quanser-rotflex")
    for k, (one, text) in enumerate([(found, "(motor angle / 70)"), ((found[0], None), "after the gear")]):
        monkeypatch.setattr("flexhinf.cli.design.controller_of", lambda source, one=one: one)
        assert main(["export", "c", "report", "--out", str(tmp_path / str(k))]) == 0
        assert text in (tmp_path / str(k) / "README.md").read_text()


def test_it_says_that_only_constants_were_counted(
    controller: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["export", "c", str(controller), "--out"]
    monkeypatch.setattr("flexhinf.export.package.cortex_m4_bytes", lambda code: None)
    assert main([*words, str(tmp_path / "a"), "--flash", "64kB"]) == 0
    assert unnamed(capsys.readouterr().err, "note", "--flash", "constants", "arm-none-eabi-gcc") == []
    monkeypatch.setattr("flexhinf.export.package.cortex_m4_bytes", lambda code: 1)
    assert main([*words, str(tmp_path / "b"), "--flash", "64kB"]) == 0
    assert "note" not in capsys.readouterr().err


@pytest.mark.slow
def test_a_design_file_alone_is_designed_first(tmp_path: Path) -> None:
    (tmp_path / "design.toml").write_text('[design]\nrobot = "paper"\ndegrees = [2]\ndraws = 0\n')
    out = tmp_path / "c"
    assert main(["export", "c", str(tmp_path / "design.toml"), "--out", str(out), "--name", "arm"]) == 0
    assert (out / "arm.c").exists()


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["nothing-here"], "'nothing-here'"),
        ([], "DESIGN"),
        (["CONTROLLER", "--name", "while"], "arm_while"),
        (["CONTROLLER", "--real", "half"], "'half'"),
        (["CONTROLLER", "--period", "1 s"], "0.001 s"),
        (["CONTROLLER", "--flash", "10B"], "'10B' (--flash)"),
    ],
)
def test_a_mistake_writes_nothing(
    words: list[str], text: str, controller: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [str(controller) if word == "CONTROLLER" else word for word in words]
    assert main(["export", "c", *words, "--out", str(tmp_path / "c")]) == 2
    assert text in capsys.readouterr().err
    assert not (tmp_path / "c").exists()
