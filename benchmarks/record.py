"""How a benchmark's figures are kept and shown."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

__all__ = ["FOLDER", "keep", "keep_rows", "kept_rows", "readable"]

FOLDER = Path(".benchmarks")


def keep(name: str, rows: list[dict[str, Any]]) -> None:
    """Write the rows with the machine they were measured on to `FOLDER`/`name`."""
    FOLDER.mkdir(exist_ok=True)
    machine = {
        "python": platform.python_version(),
        "machine": platform.machine(),
        "processors": os.cpu_count(),
        "load": os.getloadavg() if hasattr(os, "getloadavg") else None,
        "numpy": np.__version__,
    }
    (FOLDER / name).write_text(json.dumps({"machine": machine, "rows": rows}, indent=1, default=bool) + "\n")
    print(
        f"kept in {FOLDER / name}; load of the machine {machine['load']}, {machine['processors']} processors"
    )


def kept_rows(file: Path) -> list[dict[str, Any]]:
    """Rows that stand in a file of the repository; none where there is no file."""
    return json.loads(file.read_text(encoding="utf-8")) if file.exists() else []


def keep_rows(file: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows to a file of the repository."""
    file.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


def readable(microseconds: float) -> str:
    """A time with three digits in the unit that suits it."""
    for unit, size in (("s", 1e6), ("ms", 1e3)):
        if microseconds >= size:
            return f"{microseconds / size:.3g} {unit}"
    return f"{microseconds:.3g} µs"
