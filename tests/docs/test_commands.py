"""Every command and every program of README.md and docs/*.md runs as it is printed.

Each block runs in an empty folder that holds the files that its page shows. A command may end with exit code 1 (a
report is written, and the loop does not meet its specification), never with 2. Commands that set up an environment need
a network: make's are looked up in the Makefile, pip's extras in pyproject.toml.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path

import pytest

_FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
_FILE = re.compile(r"^(?:#|<!--) file: (\S+)")


@dataclass(frozen=True)
class Block:
    """One fenced block.

    Attributes
    ----------
    page : str
        Its file, from the repository's folder.
    number : int
        Of all fenced blocks of the page, from 1.
    language, text : str
    """

    page: str
    number: int
    language: str
    text: str

    @property
    def name(self) -> str:
        """For the list of tests."""
        return f"{self.page}-{self.number}"

    @property
    def file(self) -> str | None:
        """The name of the file that the block shows, from its first line ``# file: NAME``."""
        match = _FILE.match(self.text)
        return match[1] if match else None

    @property
    def lines(self) -> list[str]:
        """Commands, one a line; a backslash at the end continues one."""
        joined = self.text.replace("\\\n", " ")
        return [line for line in joined.splitlines() if line.strip() and not line.startswith("#")]


def blocks(repository: Path) -> list[Block]:
    """Every fenced block with a language, page by page."""
    pages = [repository / "README.md", *sorted((repository / "docs").glob("*.md"))]
    return [
        Block(page.relative_to(repository).as_posix(), number, language, text)
        for page in pages
        for number, (language, text) in enumerate(_FENCE.findall(page.read_text(encoding="utf-8")), 1)
    ]


def write_files(page: str, folder: Path) -> None:
    """Write the files that a page shows into a folder."""
    for block in BLOCKS:
        if block.page == page and block.file:
            (folder / block.file).write_text(block.text, encoding="utf-8")


REPOSITORY = Path(__file__).resolve().parents[2]
BLOCKS = blocks(REPOSITORY)
LONG = {"design", "compare", "paper", "campaign"}
SHIM = '#!/bin/sh\nexec "{python}" -m flexhinf "$@"\n'


def words(line: str) -> list[str]:
    return shlex.split(line, comments=True)


def commands() -> list[object]:
    found = []
    for block in BLOCKS:
        for line in block.lines if block.language == "sh" else []:
            long = any(word in LONG for word in words(line)[1:2]) and "--help" not in line
            marks = [pytest.mark.slow] if long else []
            found.append(pytest.param(block, line, id=f"{block.name}-{line[:60]}", marks=marks))
    return found


def programs() -> list[object]:
    return [pytest.param(block, id=block.name) for block in BLOCKS if block.language == "python"]


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    """Where ``flexhinf`` is the tree that is tested."""
    (tmp_path / "bin").mkdir()
    shim = tmp_path / "bin" / "flexhinf"
    shim.write_text(SHIM.format(python=sys.executable), encoding="utf-8")
    shim.chmod(0o755)
    paths = [str(REPOSITORY / "src"), os.environ.get("PYTHONPATH", "")]
    return {
        **os.environ,
        "PATH": os.pathsep.join([str(tmp_path / "bin"), os.environ["PATH"]]),
        "PYTHONPATH": os.pathsep.join(path for path in paths if path),
        "MPLBACKEND": "Agg",
    }


def run(arguments: list[str], folder: Path, environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(arguments, cwd=folder, env=environment, capture_output=True, text=True, check=False)


@pytest.mark.parametrize(("block", "line"), commands())
def test_a_command_runs_as_it_is_printed(
    block: Block, line: str, tmp_path: Path, environment: dict[str, str]
) -> None:
    program, *arguments = words(line)
    if program == "make":
        targets = re.findall(
            r"^([\w-]+):", (REPOSITORY / "Makefile").read_text(encoding="utf-8"), re.MULTILINE
        )
        assert set(arguments) <= set(targets), line
        return
    if program == "pip":
        extras = {extra for word in arguments for extra in re.findall(r"\[([\w,]+)\]", word)}
        known = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
        assert {name for extra in extras for name in extra.split(",")} <= set(known["optional-dependencies"])
        return
    assert program.removeprefix(".venv/bin/") == "flexhinf", line
    folder = tmp_path / "work"
    folder.mkdir()
    write_files(block.page, folder)
    command = line.removeprefix(".venv/bin/")
    outcome = run(["bash", "-c", command], folder, environment)
    assert outcome.returncode in (0, 1), outcome.stderr
    assert "Traceback" not in outcome.stderr


@pytest.mark.parametrize("block", programs())
def test_a_program_runs_as_it_is_printed(block: Block, tmp_path: Path, environment: dict[str, str]) -> None:
    folder = tmp_path / "work"
    folder.mkdir()
    write_files(block.page, folder)
    outcome = run([sys.executable, "-W", "error", "-c", block.text], folder, environment)
    assert outcome.returncode == 0, outcome.stderr


def test_no_block_is_left_out() -> None:
    known = {"sh", "python", "toml", "xml", "csv", "c", "text"}
    assert {block.language for block in BLOCKS} <= known
    assert len(commands()) > 10
    assert len(programs()) >= 4
    nameless = [block.name for block in BLOCKS if block.language in ("toml", "xml", "csv") and not block.file]
    assert nameless == []
