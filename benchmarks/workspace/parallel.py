"""Rows by several processes. They import this module: that of a package's `__main__` they could not."""

from __future__ import annotations

import signal
from collections.abc import Iterator, Sequence
from contextlib import suppress
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from benchmarks.workspace.rows import Bench, law_name, row_name
from benchmarks.workspace.trip import CONDITIONS

__all__ = ["by_processes", "row_text"]

_BENCH: list[Bench] = []  # of this process


def by_processes(
    jobs: int, folder: Path, goals: int, poses: int, missing: Sequence[tuple[str, ...]]
) -> Iterator[str]:
    """What is to be said of each row, as it is made; the laws that several rows share come first."""
    laws = dict.fromkeys((robot, law, CONDITIONS[name].links) for robot, law, _, name in missing)
    with get_context("spawn").Pool(jobs, _begun, (folder, goals, poses)) as pool:  # its processes end with it
        for _ in pool.imap_unordered(_law_made, laws):
            pass
        yield from pool.imap_unordered(_row_made, missing)


def row_text(bench: Bench, robot: str, law: str, plant: str, condition: str) -> str:
    """Make a row where it is missing, and say what came of it."""
    name = row_name(robot, law, plant, condition)
    try:
        row = bench.row(robot, law, plant, condition)
    except FileNotFoundError as error:  # a robot whose URDF is not installed
        return f"{name}: {error}"
    if row is None:
        record = bench.law(robot, law, CONDITIONS[condition].links)
        why = "needs encoders of the links" if record is None else record["refused"]
        return f"{law_name(robot, law, CONDITIONS[condition].links)}: {why}"
    return f"{name}: {row['arrived']} of {row['moves']} arrive"


def _begun(*options: Any) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the first process hears of it
    _BENCH[:] = [Bench(*options)]


def _law_made(task: tuple[str, str, bool]) -> None:
    with suppress(FileNotFoundError):  # the row says so
        _BENCH[0].law(*task)


def _row_made(task: tuple[str, str, str, str]) -> str:
    return row_text(_BENCH[0], *task)
