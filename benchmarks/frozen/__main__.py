"""``make bench-frozen``: designs, exports and help of an earlier commit beside those of the present tree.

``python -m benchmarks.frozen`` compares with the last commit before designs of one pose and of a workspace became one;
``python -m benchmarks.frozen COMMIT`` with another one, and ``--after COMMIT`` compares that one in place of the
present tree, which tells where a number changed. What a commit gives is kept in .benchmarks/frozen; rows of all designs
are kept in benchmarks/frozen.json, of which ``--table`` makes the table of docs/architecture.md. It needs the history
of the repository.

Compared to the bit are law, filter, γ and γ*; by name the limit, number and verdict of each requirement, gains and
poles at poses, numbers of design.toml and of the report, C with its test vectors; as text the help of each command. The
exit code is 1 where a law, a filter, γ or a verdict changed, or a number without an entry in
benchmarks/frozen/reasons.py.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from benchmarks.frozen.compare import TOLD, Difference, differences, help_diff, row_of, summary, table
from benchmarks.frozen.reasons import BEFORE
from benchmarks.frozen.tree import CASES, COMMANDS, ROOT, git, of_commit, of_tree

KEPT = ROOT / "benchmarks" / "frozen.json"


def compared(
    before: Mapping[str, Mapping[str, Any]], after: Iterable[tuple[str, Mapping[str, Any]]]
) -> list[dict[str, Any]]:
    """The rows of the designs; what differs is printed as soon as it is known."""
    rows = []
    for name, read in after:
        if name == COMMANDS:
            _tell_help(dict(help_diff(before[name]["help"], read["help"])), len(read["help"]))
            continue
        found = differences(name, before[name], read)
        rows.append(row_of(name, before[name], read, found))
        _tell(name, found)
    return rows


def _tell(name: str, found: list[Difference]) -> None:
    print(f"{name}: {'differs' if found else 'equal'}", flush=True)
    for each in found:
        if each.weight not in TOLD:
            print(
                f"  {'FAILS ' if each.fails else ''}{each.weight}: {each.text}  {each.why}".rstrip(),
                flush=True,
            )
    for weight, words in TOLD.items():
        if told := [each.text for each in found if each.weight == weight]:
            print(f"  {len(told)} {words}: {'; '.join(told)}", flush=True)


def _tell_help(found: Mapping[str, str], count: int) -> None:
    print(f"help of {count} commands: {f'{len(found)} differ' if found else 'equal'}", flush=True)
    for command, lines in found.items():
        print(f"  {command}\n{lines}", flush=True)


def main(arguments: list[str] | None = None) -> int:
    """Compare both trees and keep the rows, or print the table of those that are kept."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.frozen",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    every = [*CASES, COMMANDS]
    parser.add_argument("before", nargs="?", default=BEFORE, metavar="COMMIT")
    parser.add_argument("--after", metavar="COMMIT", help="in place of the present tree; nothing is kept")
    parser.add_argument(
        "--only",
        nargs="+",
        choices=every,
        default=every,
        metavar="NAME",
        help="designs, or 'commands' for help",
    )
    parser.add_argument("--kept", type=Path, default=KEPT, metavar="FILE")
    parser.add_argument("--table", action="store_true", help="print the table of the rows that are kept")
    chosen = parser.parse_args(arguments)
    if chosen.table:
        print(table(json.loads(chosen.kept.read_text(encoding="utf-8"))["rows"]))
        return 0
    before = dict(of_commit(chosen.before, chosen.only))
    after = of_commit(chosen.after, chosen.only) if chosen.after else of_tree(ROOT, chosen.only)
    present = git("describe", "--always", "--dirty")
    rows = compared(before, after)
    print(f"\n{table(rows)}\n\n{summary(rows)}")
    if not chosen.after and chosen.only == every and chosen.before == BEFORE:
        versions = {name: version(name) for name in ("numpy", "scipy", "llvmlite")}
        kept = {"before": BEFORE, "after": present, "versions": versions, "rows": rows}
        chosen.kept.write_text(json.dumps(kept, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    return int(any(Difference(**each).fails for row in rows for each in row["differences"]))


if __name__ == "__main__":
    sys.exit(main())
