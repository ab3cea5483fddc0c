"""CONTRIBUTING.md: what it tells to add works as it is printed. `test_commands.py` runs its programs."""

from __future__ import annotations

import importlib
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import flexhinf as fh

FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
EDIT = re.compile(r"^(\S+\.py), before `(.+)`:\n((?:    .*\n)+)", re.MULTILINE)


def blocks(repository: Path, section: str) -> list[tuple[str, str]]:
    """Language and text of each fenced block of a section."""
    text = (repository / "CONTRIBUTING.md").read_text(encoding="utf-8")
    (found,) = re.findall(rf"^## {section}\n(.*?)^## ", text, re.DOTALL | re.MULTILINE)
    return FENCE.findall(found)


@pytest.mark.parametrize("what", ["a law", "an estimator", "a metric", "a requirement", "a robot format"])
def test_an_example_has_at_most_twenty_lines_of_code(repository: Path, what: str) -> None:
    found = blocks(repository, f"Add {what}")
    assert found
    assert all(sum(bool(line) for line in text.splitlines()) <= 20 for _, text in found)


def test_files_that_are_named_exist(repository: Path) -> None:
    text = (repository / "CONTRIBUTING.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`?((?:tests/|docs/|design/|cli/|src/)[\w/]+\.py)", text))
    assert len(named) > 4
    assert [
        n for n in named if not ((repository / n).is_file() or (repository / "src/flexhinf" / n).is_file())
    ] == []


def edited(repository: Path, folder: Path) -> Path:
    """A copy of src with the printed lines of a requirement."""
    shutil.copytree(repository / "src", folder / "src", ignore=shutil.ignore_patterns("__pycache__"))
    ((_, text),) = blocks(repository, "Add a requirement")
    edits = EDIT.findall(text)
    assert EDIT.sub("", text) == ""
    for name, before, new in edits:
        file = folder / "src" / "flexhinf" / name
        lines = file.read_text(encoding="utf-8").splitlines(keepends=True)
        at = next(k for k, line in enumerate(lines) if line.strip().startswith(before))
        margin = lines[at][: len(lines[at]) - len(lines[at].lstrip())]
        lines[at:at] = [f"{margin}{line[4:]}" for line in new.splitlines(keepends=True)]
        file.write_text("".join(lines), encoding="utf-8")
    return folder / "src"


def test_printed_edits_of_a_requirement_find_their_lines(repository: Path, tmp_path: Path) -> None:
    package, before = edited(repository, tmp_path) / "flexhinf", repository / "src" / "flexhinf"
    files = {file.relative_to(package) for file in package.rglob("*.py")}
    changed = {file for file in files if (package / file).read_bytes() != (before / file).read_bytes()}
    assert len(changed) > 1
    for file in changed:
        compile((package / file).read_text(encoding="utf-8"), str(file), "exec")


@pytest.mark.ci("designs with a copy of the package")
def test_a_requirement_is_judged_after_the_printed_edits(repository: Path, tmp_path: Path) -> None:
    source = edited(repository, tmp_path)
    options = "--pose 20deg --preset damped --degrees 2 --draws 0 --set rays=0 --set proof_seconds=0"
    words = options.split()
    done = subprocess.run(
        [sys.executable, "-m", "flexhinf", "design", "paper", *words, "--rise-time", "0.1", "--out", "arm"],
        cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(source)}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 1, done.stderr
    requirements = json.loads((tmp_path / "arm" / "design.json").read_text(encoding="utf-8"))["specification"]
    (line,) = [each for each in requirements if each["what"] == "rise time"]
    assert line["asked"] == 0.1
    assert 0.1 < line["found"] < 5.0


def test_a_robot_format_is_read_after_the_printed_lines(
    repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (_, program), (_, project) = blocks(repository, "Add a robot format")
    ((group, points),) = tomllib.loads(project)["project"]["entry-points"].items()
    ((ending, target),) = points.items()
    monkeypatch.chdir(tmp_path)
    (tmp_path / f"{target.partition(':')[0]}.py").write_text(program, encoding="utf-8")
    about = tmp_path / "my_package-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: my-package\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(f"[{group}]\n{ending} = {target}\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    importlib.invalidate_caches()
    (tmp_path / f"other.{ending}").write_text("paper 28")
    assert fh.load_robot(tmp_path / f"other.{ending}").nominal["stiffness"] == 28.0
