"""Bytes of the C that a controller is exported to: code and constants of its object file."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from typing import Any

import flexhinf as fh
from benchmarks.firmware_tools import run
from flexhinf.codegen.program import Unsupported

__all__ = ["FLAGS", "object_bytes"]

#: Of gcc: a PC stands for the processors of firmware. What a step needs is counted, without the command that rests
#: and the check of parameters.
FLAGS = ("-std=c99", "-Os", "-march=x86-64", "-DLAW_WITHOUT_REST", "-DLAW_WITHOUT_CHECK")


def object_bytes(controller: Any) -> int | None:
    """Code, constants and initialised data of the exported source; None without gcc, without a controller, or of one
    that has no form in C."""
    if controller is None or shutil.which("gcc") is None or shutil.which("size") is None:
        return None
    with tempfile.TemporaryDirectory() as work:
        try:
            folder = fh.export_c(controller, Path(work) / "c", "law", limits=False)
        except Unsupported:
            return None
        run("gcc", *FLAGS, "-c", "law.c", "-o", "law.o", folder=folder)
        said = run("size", "law.o", folder=folder)
    code, data, *_ = said.splitlines()[1].split()
    return int(code) + int(data)
