"""Packages that `make peers` installs into an environment of their own."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

__all__ = ["PYTHON", "missing"]

PEERS = Path(os.environ.get("FLEXHINF_PEERS", ".venv-peers"))

#: The interpreter of that environment.
PYTHON = PEERS / "bin" / "python"

#: Names those of its arguments that are no package there.
_ABSENT = "import sys, importlib.util as u; print(*(n for n in sys.argv[1:] if u.find_spec(n) is None))"


def missing(*packages: str) -> str:
    """Which packages are not there, and how they come; "" where all are.

    Raises SystemExit: one is there and cannot be imported, in its own words.
    """
    absent = list(packages)
    if PYTHON.exists():
        absent = _run("-c", _ABSENT, *packages).split()
    if absent:
        return f"{' and '.join(absent)} not in {PEERS} (`make peers` installs what is compared)"
    _run("-c", f"import {', '.join(packages)}")
    return ""


def _run(*words: str) -> str:
    done = subprocess.run([str(PYTHON), *words], capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{PYTHON} {' '.join(words)} ended with {done.returncode}:\n{done.stderr}")
    return done.stdout
