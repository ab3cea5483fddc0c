"""``make faults``: faults of sensors, drives, mechanics and clocks, and what an exported controller does about them.

``python -m benchmarks.faults`` draws a seed, prints it, and runs every fault on four arms; ``--seed`` repeats. What was
run is kept, and an interrupted call goes on with the same seed. ``--repeat ARM FAULT SEED`` makes one run again, and
``--trace`` keeps its samples. ``--file robot.toml --design FOLDER`` is an arm of your own, with its design.
"""

from __future__ import annotations

import argparse
import json
import secrets
import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from benchmarks.faults.arms import ARMS, BUILD, Program, Source, program_of
from benchmarks.faults.kinds import FAULTS
from benchmarks.faults.runs import ALL, Campaign, Planned, keep_smallest, one
from benchmarks.faults.tables import KEPT, TABLES, failures, kept, summary, trips
from benchmarks.faults.verdict import judged
from flexhinf import export

__all__ = ["main"]

#: What ``safety.md`` of every export shows.
SAFETY = Path(export.__file__).parent / "templates" / "faults_tried.md"
#: How this is called.
PROGRAM = ["python", "-m", "benchmarks.faults"]
#: Runs of each fault and moves of each arm, as stated, and where it must be quick.
RUNS, MOVES, QUICK_RUNS, QUICK_MOVES = 10, 1000, 1, 50


def parser() -> argparse.ArgumentParser:
    """The options."""
    found = argparse.ArgumentParser(prog="python -m benchmarks.faults", description=__doc__)
    found.add_argument("--arms", nargs="+", choices=list(ARMS), default=list(ARMS), metavar="NAME")
    found.add_argument("--seed", type=int, help="of all that is random; drawn where it is not stated")
    found.add_argument("--runs", type=int, default=RUNS, help=f"of each fault and arm (default: {RUNS})")
    found.add_argument(
        "--moves", type=int, default=MOVES, help=f"of each arm without a fault (default: {MOVES})"
    )
    found.add_argument("--quick", action="store_true", help=f"--runs {QUICK_RUNS} --moves {QUICK_MOVES}")
    found.add_argument("--file", type=Path, metavar="ROBOT.toml", help="an arm of your own")
    found.add_argument("--design", type=Path, metavar="FOLDER", help="its design")
    found.add_argument(
        "--real", choices=("double", "float"), default="double", help="how your own is exported"
    )
    found.add_argument(
        "--no-brakes", action="store_true", help="joints of your own that do not say so have none"
    )
    found.add_argument("--repeat", nargs=3, metavar=("ARM", "FAULT", "SEED"), help="one run")
    found.add_argument("--trace", type=Path, metavar="FILE.csv", help="its samples")
    found.add_argument(
        "--smallest", action="store_true", help="look for the smallest sizes that matter, and keep them"
    )
    found.add_argument("--keep", action="store_true", help="keep the results for the docs")
    found.add_argument("--table", choices=list(TABLES), help="print a table of the results that are kept")
    found.add_argument(
        "--build", type=Path, default=BUILD, metavar="FOLDER", help="where designs and programs are kept"
    )
    return found


def programs_of(given: argparse.Namespace) -> dict[str, Program]:
    """What is run: the arms, or the one of the caller."""
    if given.file is None:
        names = [given.repeat[0]] if given.repeat else given.arms
        return {name: program_of(ARMS[name], given.build) for name in names}
    name = given.file.stem
    own = Source(
        name,
        "your own",
        given.file.resolve(),
        real=given.real,
        brakes=not given.no_brakes,
        design=given.design,
    )
    return {name: program_of(own, given.build)}


def main(arguments: list[str] | None = None) -> int:
    """Make the runs; exit code 1 where one fails the rule, or something harmless stopped an arm."""
    given = parser().parse_args(arguments)
    if given.table:
        print(TABLES[given.table](kept()))
        return 0
    if given.quick:
        given.runs, given.moves = QUICK_RUNS, QUICK_MOVES
    programs = programs_of(given)
    if given.repeat:
        return repeat(programs[given.repeat[0]], given.repeat[1], int(given.repeat[2]), given.trace)
    if given.smallest:
        for program in programs.values():
            keep_smallest(program)
        return 0
    return run(given, programs)


def run(given: argparse.Namespace, programs: Mapping[str, Program]) -> int:
    """All runs, with their tables."""
    seed = secrets.randbits(31) if given.seed is None else given.seed
    print(f"--seed {seed}", flush=True)
    campaign = Campaign(programs, seed, given.runs, given.moves, given.build / "rows")
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    try:
        with Progress(*columns) as progress:
            task = progress.add_task("runs", total=len(campaign.planned()))
            campaign.make(lambda count: progress.advance(task, count))
    except KeyboardInterrupt:
        print(f"interrupted; what was run is kept: go on with --seed {seed}")
        return 130
    rows, words = (
        campaign.rows(),
        ["--seed", str(seed), "--runs", str(given.runs), "--moves", str(given.moves)],
    )
    results = {"command": shlex.join([*PROGRAM, *words]), "arms": summary(rows)}
    if given.keep:
        KEPT.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
        SAFETY.write_text(TABLES["tried"](results) + "\n", encoding="utf-8")
    tell(rows, results, own_words(given))
    return 1 if failures(rows) or trips(rows) else 0


def own_words(given: argparse.Namespace) -> list[str]:
    """The command with the options that say which arm of the caller's own is meant."""
    if given.file is None:
        return PROGRAM
    brakes = ["--no-brakes"] if given.no_brakes else []
    return [*PROGRAM, "--file", str(given.file), "--design", str(given.design), "--real", given.real, *brakes]


def repeat(program: Program, fault: str, seed: int, trace: Path | None) -> int:
    """One run again."""
    if fault not in ALL:
        raise SystemExit(f"there is no fault {fault!r}; try one of {list(ALL)}")
    row = one(program, Planned(program.arm.name, fault, seed), trace)
    print(json.dumps(row, indent=1))
    print(judged(row) if fault in FAULTS else "stopped" if row["noticed"] else "not stopped")
    return 0


def tell(rows: Sequence[Mapping[str, Any]], results: Mapping[str, Any], words: Sequence[str]) -> None:
    """Print the tables, and each run that fails, with the command that repeats it."""
    print(TABLES["faults"](results))
    print(f"\n{TABLES['harmless'](results)}\n")
    for row in (*failures(rows), *trips(rows)):
        verdict = judged(row) if row["fault"] in FAULTS else "stopped"
        again = [*words, "--repeat", row["arm"], row["fault"], str(row["seed"])]
        print(f"{verdict}: {shlex.join(again)}")


if __name__ == "__main__":
    sys.exit(main())
