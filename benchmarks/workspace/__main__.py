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
import sys  # noqa: E402
from pathlib import Path  # noqa: E402

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn  # noqa: E402

from benchmarks.workspace.laws import LAWS  # noqa: E402
from benchmarks.workspace.parallel import by_processes, row_text  # noqa: E402
from benchmarks.workspace.plants import PLANTS  # noqa: E402
from benchmarks.workspace.robots import ROBOTS  # noqa: E402
from benchmarks.workspace.rows import ROWS, Bench, row_name  # noqa: E402
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
                for said in by_processes(given.jobs, given.rows, given.goals, given.poses, missing):
                    progress.print(said)
                    progress.advance(rows)
                return 0
            for one in missing:
                progress.reset(moves, description=row_name(*one))
                progress.print(row_text(bench, *one))
                progress.advance(rows)
        except KeyboardInterrupt:
            progress.print("interrupted; the rows that are whole are kept")
            return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
