"""What a command loads before it begins: help, version and mistakes in options need no library of numbers."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

#: Libraries whose import takes longer than a help is printed in.
HEAVY = {"numpy", "scipy", "casadi", "matplotlib", "llvmlite", "pydantic", "flexhinf.designs.pipeline"}


#: Commands that compute nothing.
HELP = [
    ["--help"], ["--version"], ["design", "--help"], ["design", "--help-all"], ["paper", "--help"],
    ["campaign", "--help"], ["export", "c", "--help"], ["desing"],
]  # fmt: skip


@pytest.fixture(scope="module")
def loaded() -> list[list[str]]:
    """What each of them loads in one process beyond what those before it have loaded."""
    code = f"""
import json, sys
from flexhinf.cli import main
found = []
for words in {HELP!r}:
    before = set(sys.modules)
    main(words)
    found.append(sorted({HEAVY!r} & (set(sys.modules) - before)))
print(json.dumps(found), file=sys.stderr)
"""
    outcome = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return json.loads(outcome.stderr.splitlines()[-1])


@pytest.mark.parametrize("words", HELP, ids=" ".join)
def test_help_loads_no_library_of_numbers(words: list[str], loaded: list[list[str]]) -> None:
    assert loaded[HELP.index(words)] == []


def test_the_help_of_all_commands_declares_no_option() -> None:
    code = "import sys; from flexhinf.cli import main; main(['--help']); print('flexhinf.cli.options' in sys.modules)"
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert shown.split()[-1] == "False"
