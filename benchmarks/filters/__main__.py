"""``python -m benchmarks.filters``: count and keep the rows; ``--table NAME`` prints a table of what is kept."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from benchmarks.filters import consistency, hard

#: Tables by name: what makes their rows, and what prints them.
TABLES = {"hard": hard, "nees": consistency}

FOLDER = Path(__file__).parent


def main() -> None:
    """Count, or print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.filters", description=__doc__)
    parser.add_argument(
        "names", nargs="*", choices=[*TABLES, []], help="which rows are counted (default: all)"
    )
    parser.add_argument("--table", choices=list(TABLES))
    options = parser.parse_args()
    if options.table:
        found = json.loads((FOLDER / f"{options.table}.json").read_text(encoding="utf-8"))
        print(TABLES[options.table].table(found))
        return
    for name in options.names or TABLES:
        found = TABLES[name].counted()
        (FOLDER / f"{name}.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
        print(TABLES[name].table(found), flush=True)


if __name__ == "__main__":
    main()
