"""Flags and commands that the benchmarks of exported C share."""

from __future__ import annotations

import subprocess
from pathlib import Path

#: How C is compiled for a PC.
PC = ("-std=c99", "-O3", "-march=x86-64-v3")


def run(*words: object, folder: Path) -> str:
    """What a command prints; it must end well."""
    done = subprocess.run([*map(str, words)], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(map(str, words))}\n{done.stdout}{done.stderr}"
    return done.stdout + done.stderr
