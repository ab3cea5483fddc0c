"""``make bench-compared``: laws compared over the workspaces of robots, and campaigns of their designs.

``python -m benchmarks.compared`` makes the rows that are missing, at most 30 processor minutes a robot; ``--again``
makes those of the robots that are named anew. ``--table`` prints a table of
docs/comparison_workspaces.md from the rows that are kept.
"""

from __future__ import annotations

import argparse
import sys

from benchmarks.compared.rows import KINDS, ROBOTS, kept, make
from benchmarks.compared.tables import TABLES


def main(arguments: list[str] | None = None) -> int:
    """Make the rows of the robots that are named, or print a table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.compared", description=__doc__)
    parser.add_argument("robots", nargs="*", default=list(ROBOTS), metavar="ROBOT")
    parser.add_argument("--rows", nargs="+", choices=list(KINDS), default=list(KINDS), metavar="NAME")
    parser.add_argument("--again", action="store_true", help="make rows anew that are there")
    parser.add_argument("--table", choices=list(TABLES), help="print a table of the rows that are kept")
    chosen = parser.parse_args(arguments)
    if chosen.table:
        print(TABLES[chosen.table]())
        return 0
    for name in chosen.robots:
        for kind in chosen.rows:
            if ROBOTS[name].has(kind) and (chosen.again or kept(f"{name}.{kind}") is None):
                print(make(name, kind), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
