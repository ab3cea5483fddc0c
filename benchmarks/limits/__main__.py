"""``make bench-limits``: arms at the limits of their motors, and how exactly they follow paths, beside their rivals.

``python -m benchmarks.limits`` makes the designs and rows that are missing, and goes on where it was interrupted.
``--rows limits --laws flexhinf --again`` makes those rows anew, with the designs that are there; ``--table`` prints a
table of docs/limits.md from the rows that are kept. Files of others are read from ``--files``.
"""

from __future__ import annotations

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # before NumPy is imported
    os.environ.setdefault(_name, "1")

import argparse  # noqa: E402
import sys  # noqa: E402
from pathlib import Path  # noqa: E402

from benchmarks.limits.arms import SOURCES, designed  # noqa: E402
from benchmarks.limits.laws import LAWS, TITLES  # noqa: E402
from benchmarks.limits.rows import GROUPS, ROWS, Bench, named_rows  # noqa: E402
from benchmarks.limits.tables import TABLES  # noqa: E402

#: Where designs are made, beside the repository's other builds.
DESIGNS = Path(__file__).resolve().parents[2] / "build" / "limits"


def main(arguments: list[str] | None = None) -> int:
    """Make the rows that are missing, or print a table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.limits", description=__doc__)
    known = [*GROUPS, *(row for rows in GROUPS.values() for row in rows)]
    parser.add_argument("--arms", nargs="+", choices=list(SOURCES), default=list(SOURCES), metavar="NAME")
    parser.add_argument("--rows", nargs="+", choices=known, default=list(GROUPS), metavar="NAME")
    parser.add_argument("--laws", nargs="+", choices=list(TITLES), default=list(LAWS), metavar="NAME")
    parser.add_argument("--again", action="store_true", help="make rows anew that are there")
    parser.add_argument(
        "--designs", type=Path, default=DESIGNS, metavar="FOLDER", help="where designs are kept"
    )
    parser.add_argument(
        "--files", type=Path, metavar="FOLDER", help="robot files that are no part of the repository"
    )
    parser.add_argument("--kept", type=Path, default=ROWS, metavar="FOLDER", help="where the rows are kept")
    parser.add_argument("--no-designs", action="store_true", help="run the designs that are there, make none")
    parser.add_argument("--table", choices=sorted(TABLES), help="print a table of the rows that are kept")
    given = parser.parse_args(arguments)
    if given.table:
        print(TABLES[given.table](given.kept))
        return 0
    try:
        for name in given.arms:
            try:
                for said in [] if given.no_designs else designed(given.designs, name, given.files):
                    print(said, flush=True)
                bench = Bench(name, given.kept, given.designs, given.files)
            except FileNotFoundError as error:
                print(error)
                continue
            for said in bench.make(named_rows(given.rows), given.laws, given.again):
                print(said, flush=True)
    except KeyboardInterrupt:
        print("interrupted; the rows that are whole are kept")
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
