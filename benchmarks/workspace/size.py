"""Bytes of the C that a controller is exported to: code and constants of its object file."""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path
from typing import Any

import flexhinf as fh

__all__ = ["FLAGS", "object_bytes"]

#: Of gcc: a PC stands for the processors of firmware. What a step needs is counted, without the command that rests
#: and the check of parameters.
FLAGS = ("-std=c99", "-Os", "-march=x86-64", "-DLAW_WITHOUT_REST", "-DLAW_WITHOUT_CHECK")


def object_bytes(controller: Any) -> int | None:
    """Code, constants and initialised data of the exported source; None without gcc, or where no export is possible."""
    with tempfile.TemporaryDirectory() as work:
        try:
            folder = fh.export_c(controller, Path(work) / "c", "law", limits=False)
            for words in (("gcc", *FLAGS, "-c", "law.c", "-o", "law.o"), ("size", "law.o")):
                said = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=True).stdout
        except (fh.FlexhinfError, FileNotFoundError, subprocess.CalledProcessError):
            return None
    code, data, *_ = said.splitlines()[1].split()
    return int(code) + int(data)
