"""What a command loads before it begins: help, version and mistakes in options need no library of numbers."""

from __future__ import annotations

import subprocess
import sys

import pytest

#: Libraries whose import takes longer than a help is printed in.
HEAVY = {"numpy", "scipy", "casadi", "matplotlib", "llvmlite", "pydantic", "flexhinf.design.pipeline"}


@pytest.mark.parametrize(
    "words",
    [
        ["--help"],
        ["--version"],
        ["design", "--help"],
        ["design", "--help-all"],
        ["paper", "--help"],
        ["campaign", "--help"],
        ["export", "c", "--help"],
        ["desing"],
    ],
    ids=" ".join,
)
def test_help_loads_no_library_of_numbers(words: list[str]) -> None:
    code = (
        f"import sys; from flexhinf.cli import main; main({words!r}); heavy = {HEAVY!r} & set(sys.modules);"
        "print(*sorted(heavy), file=sys.stderr); sys.exit(bool(heavy))"
    )
    outcome = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert outcome.returncode == 0, outcome.stderr


def test_the_help_of_all_commands_declares_no_option() -> None:
    code = "import sys; from flexhinf.cli import main; main(['--help']); print('flexhinf.cli.options' in sys.modules)"
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert shown.split()[-1] == "False"
