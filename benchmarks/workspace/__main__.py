"""``make bench-workspace``: controllers judged as a robot is used, over its whole joint range, beside their rivals.

Each row (robot, law, plant, condition) is kept as a file when it is whole, so that an interrupted run goes on where it
was. ``python -m benchmarks.workspace`` makes what is missing, with ``--jobs 4`` four rows at a time; ``--goals`` other
than those of the kept rows makes them anew; ``--table`` prints the tables of docs/workspace.md from the rows that are
kept.
"""

from __future__ import annotations

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # before NumPy is imported
    os.environ.setdefault(_name, "1")

import argparse  # noqa: E402
import signal  # noqa: E402
import sys  # noqa: E402
from collections.abc import Iterator  # noqa: E402
from contextlib import suppress  # noqa: E402
from multiprocessing import get_context  # noqa: E402
from pathlib import Path  # noqa: E402
from typing import Any  # noqa: E402

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn  # noqa: E402

from benchmarks.workspace.laws import LAWS  # noqa: E402
from benchmarks.workspace.plants import PLANTS  # noqa: E402
from benchmarks.workspace.robots import ROBOTS  # noqa: E402
from benchmarks.workspace.rows import ROWS, Bench, law_name, row_name  # noqa: E402
from benchmarks.workspace.tables import TABLES  # noqa: E402
from benchmarks.workspace.trip import CONDITIONS  # noqa: E402

__all__ = ["main"]


def main(arguments: list[str] | None = None) -> int:
    """Make the rows that are missing, or print the tables."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.workspace", description=__doc__)
    for name, known in (("robots", ROBOTS), ("laws", LAWS), ("plants", PLANTS), ("conditions", CONDITIONS)):
        parser.add_argument(f"--{name}", nargs="+", choices=list(known), default=list(known), metavar="NAME")
    parser.add_argument("--goals", type=int, default=200, help="goals of each robot (default: 200)")
    parser.add_argument("--poses", type=int, default=200, help="poses of linear loops (default: 200)")
    parser.add_argument("--jobs", type=int, default=1, help="rows that are made at a time (default: 1)")
    parser.add_argument("--rows", type=Path, default=ROWS, metavar="FOLDER", help="where the rows are kept")
    parser.add_argument("--table", choices=sorted(TABLES), help="print a table of the rows that are kept")
    given = parser.parse_args(arguments)
    if min(given.goals, given.poses, given.jobs) < 1:
        parser.error("--goals, --poses and --jobs are at least 1")
    if given.table:
        print(TABLES[given.table](given.rows))
        return 0
    wanted = [
        (robot, law, plant, condition)
        for robot in given.robots
        for plant in given.plants
        for condition in given.conditions
        for law in given.laws
    ]
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    with Progress(*columns) as progress:
        rows = progress.add_task("rows", total=len(wanted))
        moves = progress.add_task("", total=given.goals)
        bench = Bench(given.rows, given.goals, given.poses, lambda: progress.advance(moves))
        missing = [one for one in wanted if not bench.has(*one)]
        progress.advance(rows, len(wanted) - len(missing))
        try:
            if given.jobs > 1:
                progress.update(moves, visible=False)
                for said in _by_processes(given, missing):
                    progress.print(said)
                    progress.advance(rows)
                return 0
            for one in missing:
                progress.reset(moves, description=row_name(*one))
                progress.print(_made(bench, *one))
                progress.advance(rows)
        except KeyboardInterrupt:
            progress.print("interrupted; the rows that are whole are kept")
            return 130
    return 0


# Several processes --------------------------------------------------------------------------------
_BENCH: list[Bench] = []  # of this process


def _by_processes(given: argparse.Namespace, missing: list[tuple[str, ...]]) -> Iterator[str]:
    """What is to be said of each row, as it is made; the laws that several rows share come first."""
    laws = dict.fromkeys((robot, law, CONDITIONS[name].links) for robot, law, _, name in missing)
    start = (given.rows, given.goals, given.poses)
    with get_context("spawn").Pool(given.jobs, _begun, start) as pool:  # its processes end with it
        for _ in pool.imap_unordered(_law_made, laws):
            pass
        yield from pool.imap_unordered(_row_made, missing)


def _begun(*options: Any) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the first process hears of it
    _BENCH[:] = [Bench(*options)]


def _law_made(task: tuple[str, str, bool]) -> None:
    with suppress(FileNotFoundError):  # the row says so
        _BENCH[0].law(*task)


def _row_made(task: tuple[str, str, str, str]) -> str:
    return _made(_BENCH[0], *task)


def _made(bench: Bench, robot: str, law: str, plant: str, condition: str) -> str:
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


if __name__ == "__main__":
    sys.exit(main())
