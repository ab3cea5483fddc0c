"""The way in and out: commands, help, exit codes."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

import flexhinf as fh
from flexhinf import report
from flexhinf.cli import commands, main
from flexhinf.cli.messages import INTERRUPTED


def test_help_lists_the_commands_and_the_exit_codes(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    shown = capsys.readouterr().out
    for text in ("paper", "robots", "design", "Exit codes"):
        assert text in shown
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("flexhinf ")


@pytest.mark.parametrize("stated", [None, "2"])
def test_blas_has_one_thread_unless_the_user_states_another_number(stated: str | None) -> None:
    """While a command runs, before NumPy is loaded."""
    program = (
        "import os, sys, types; told = lambda _: print(os.environ['OPENBLAS_NUM_THREADS'], 'numpy' in sys.modules)\n"
        "sys.modules['flexhinf.cli.commands'] = types.SimpleNamespace(run=told)\n"
        "from flexhinf.cli import main; main([])"
    )
    environment = {k: v for k, v in os.environ.items() if k != "OPENBLAS_NUM_THREADS"}
    told = {} if stated is None else {"OPENBLAS_NUM_THREADS": stated}
    shown = subprocess.run(
        [sys.executable, "-c", program], env=environment | told, capture_output=True, text=True, check=True
    )
    assert shown.stdout.split() == [stated or "1", "False"]


def test_an_unknown_command_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["papers"]) == 2
    assert "papers" in capsys.readouterr().err


def test_it_runs_as_a_module() -> None:
    outcome = subprocess.run(
        [sys.executable, "-m", "flexhinf", "paper", "--nope"], capture_output=True, text=True, check=False
    )
    assert outcome.returncode == 2
    assert "try:" in outcome.stderr


def test_the_catalogue_is_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["robots"]) == 0
    shown = capsys.readouterr().out
    for name in fh.catalogue():
        assert name in shown
    assert "84 assumed" in shown


@pytest.mark.parametrize("raised", [KeyboardInterrupt, commands.typer.Abort])
def test_an_interruption_has_the_shells_code(
    raised: type[BaseException], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def stop(*arguments: object) -> None:
        raise raised

    monkeypatch.setattr("flexhinf.pages.robots_table", stop)
    assert main(["robots"]) == 130
    assert "nothing" in capsys.readouterr().err


@pytest.mark.parametrize("how", ["raised", "caught by the option parser"])
def test_interrupted_right_after_a_report_got_its_name_it_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], how: str
) -> None:
    place = {name: getattr(os, name) for name in ("rename", "replace")}

    def publishing(**arguments: object) -> int:
        try:
            report.write(tmp_path / "r", {"index.html": "new"})
        except KeyboardInterrupt:
            if how == "raised":
                raise
        return INTERRUPTED

    for name, rename in place.items():

        def stopped(source: Path, destination: Path, rename: Any = rename) -> None:
            rename(source, destination)
            if destination == tmp_path / "r":
                raise KeyboardInterrupt

        monkeypatch.setattr(os, name, stopped)
    monkeypatch.setattr(commands, "app", publishing)
    assert main(["design", "paper"]) == 130
    told = capsys.readouterr().err
    assert "nothing" not in told
    assert str(tmp_path / "r") in told
    assert (tmp_path / "r" / "index.html").read_text() == "new"


def test_names_in_tables_are_no_markup() -> None:
    from flexhinf.report import Table

    table = Table(["[/red]"], [["[red]:cat:[/blue]"]]).terminal()
    console = Console(width=80, record=True, file=io.StringIO())
    console.print(table)
    assert "[red]:cat:[/blue]" in console.export_text(clear=False)
    assert "[/red]" in console.export_text()
