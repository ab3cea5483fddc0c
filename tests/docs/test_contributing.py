"""CONTRIBUTING.md: what it tells to add works as it is printed. `test_commands.py` runs its programs."""

from __future__ import annotations

import importlib
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


def blocks(repository: Path, section: str) -> list[tuple[str, str]]:
    """Language and text of each fenced block of a section."""
    text = (repository / "CONTRIBUTING.md").read_text(encoding="utf-8")
    (found,) = re.findall(rf"^## {section}\n(.*?)^## ", text, re.DOTALL | re.MULTILINE)
    return FENCE.findall(found)


@pytest.mark.parametrize(
    "what",
    [
        "a law",
        "an estimator",
        "a metric",
        "a requirement",
        "an export",
        "a robot format",
        "a sensor",
        "a drive",
    ],
)
def test_an_example_has_at_most_twenty_lines_of_code(repository: Path, what: str) -> None:
    found = blocks(repository, f"Add {what}")
    assert found
    assert all(sum(bool(line) for line in text.splitlines()) <= 20 for _, text in found)


def test_files_that_are_named_exist(repository: Path) -> None:
    text = (repository / "CONTRIBUTING.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`?((?:tests/|docs/|designs/|cli/|src/)[\w/]+\.py)", text))
    assert len(named) > 4
    assert [
        n for n in named if not ((repository / n).is_file() or (repository / "src/flexhinf" / n).is_file())
    ] == []


@pytest.mark.parametrize(
    "what", ["law", "estimator", "requirement", "export", "operation", "target", "sensor", "drive"]
)
def test_an_example_is_a_file_that_is_tested(repository: Path, what: str) -> None:
    """`tests/test_extensions.py` adds it to the program; `tests/codegen` has operation and target."""
    text = (repository / "tests" / f"example_{what}.py").read_text(encoding="utf-8")
    printed = [program for _, program in blocks(repository, f"Add an? {what}")]
    assert text.partition('"""\n\n')[2] in printed
    template = repository / "tests" / f"example_{what}.txt"
    assert not template.exists() or template.read_text(encoding="utf-8") in printed


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


def test_a_robot_key_takes_the_printed_edits_of_three_files(repository: Path, tmp_path: Path) -> None:
    """In a copy of the package the printed program runs, the number is saved, and what others call it is advice."""
    (_, edits), (_, program) = blocks(repository, "Add a robot key")
    shutil.copytree(repository / "src", tmp_path / "src", ignore=shutil.ignore_patterns("__pycache__"))
    found = re.findall(r"^(robot/\S+), before `(.+)`:\n(.*\n)", edits, re.MULTILINE)
    assert len(found) == edits.count(", before `") == 3
    for name, before, line in found:
        file = tmp_path / "src" / "flexhinf" / name
        text = file.read_text(encoding="utf-8")
        assert text.count(before) == 1
        file.write_text(text.replace(before, line + before), encoding="utf-8")
    more = """
changed = weak.with_values({"magnet_strength": 0.8})
changed.save("changed.toml")
assert fh.load_robot("changed.toml").nominal["magnet_strength"] == 0.8
text = Path("weak.toml").read_text(encoding="utf-8")
Path("wrong.toml").write_text(text.replace("magnet_strength", "magnetisation"), encoding="utf-8")
try:
    fh.load_robot("wrong.toml")
except fh.InvalidInput as error:
    print(error.advice)
"""
    done = subprocess.run(
        [sys.executable, "-c", program + more],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(tmp_path / "src")},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == "'magnet_strength'\n"


def test_subjects_of_commits_are_checked_as_told(repository: Path) -> None:
    """The hook takes the printed subject, and none without a room or of more than 72 characters."""
    hooks = (repository / ".pre-commit-config.yaml").read_text(encoding="utf-8")
    (pattern,) = re.findall(r"- id: subject\n.*\n +entry: '(.*)'", hooks)
    rules = (repository / "CONTRIBUTING.md").read_text(encoding="utf-8")
    (printed,) = re.findall(r"imperative.*`(\w+: \w[^`]*)`", rules)
    taken = [printed, printed.ljust(72, "s"), f"{printed}\n\nWhy: {80 * 'x'}"]
    refused = [printed.partition(": ")[2], printed.ljust(73, "s"), printed.replace(": ", ":")]
    found = [bool(re.search(pattern, text, re.MULTILINE | re.DOTALL)) for text in (*taken, *refused)]
    assert found == [True] * len(taken) + [False] * len(refused)
