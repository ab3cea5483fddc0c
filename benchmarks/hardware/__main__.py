"""``make bench-hardware``: an arm with a payload that the model does not know, and designs of one pose.

Each row is kept as a file when it is whole, so that an interrupted run goes on where it was: ``python -m
benchmarks.hardware`` makes those that are missing, ``python -m benchmarks.hardware planar-link arm-untold`` makes these
anew, and ``--table robots`` prints a table of those that are kept.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.hardware.robots import ROBOTS, files_of
from benchmarks.hardware.tables import FINE, LIMITED, MASSES, PAYLOADS, ROWS, SENSORS, TABLES

ROOT = Path(__file__).resolve().parents[2]


def tasks() -> dict[str, dict[str, Any]]:
    """Every row's task, by name; see `rows.measure`."""
    found: dict[str, dict[str, Any]] = {}
    options = {"measured": SENSORS["link"], "measurement_noise": FINE}
    for name, (payload, _, judged) in PAYLOADS.items():
        task = {"name": "arm", "options": options, "payload": payload, "masses": MASSES, "judged": judged}
        found[f"arm-{name}"] = task
    for robot, (sensors, measured) in itertools.product(ROBOTS, SENSORS.items()):
        if robot == "arm":
            continue
        found[f"{robot}-{sensors}"] = {"name": robot, "options": {"measured": measured}}
        if robot in LIMITED:
            options = {"measured": measured, "measurement_noise": FINE}
            found[f"{robot}-{sensors}-fine"] = {"name": robot, "options": options}
    return found


def made(row: str, task: dict[str, Any]) -> dict[str, Any]:
    """The row, measured by a process of its own with an empty cache of kernels."""
    import flexhinf as fh

    file, elastic = files_of(task["name"])
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        whole = {**task, "robot": str(file), "elastic": str(elastic or "")}
        (place / "task.json").write_text(json.dumps(whole), encoding="utf-8")
        paths = [str(ROOT / "src"), str(ROOT), os.environ.get("PYTHONPATH", "")]
        environment = {
            **os.environ, "FLEXHINF_CACHE": str(place / "cache"), "OMP_NUM_THREADS": "1",
            "PYTHONPATH": os.pathsep.join(paths),
        }  # fmt: skip
        files = [str(place / name) for name in ("task.json", "row.json")]
        subprocess.run(
            [sys.executable, "-m", "benchmarks.hardware.rows", *files], cwd=ROOT, env=environment, check=True
        )
        name = fh.load_robot(file, elastic=elastic).name
        return {"robot": name, "row": row, **json.loads((place / "row.json").read_text("utf-8"))}


def main() -> int:
    """Make the rows that are named or missing, one after the other, or print a table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.hardware", description=__doc__)
    parser.add_argument("rows", nargs="*", help="made anew; by default all that are missing")
    parser.add_argument("--kept", type=Path, default=ROWS, metavar="FOLDER", help="where the rows are kept")
    parser.add_argument("--table", choices=sorted(TABLES), help="print the rows that are kept")
    given = parser.parse_args()
    if given.table:
        print(TABLES[given.table](given.kept))
        return 0
    known = tasks()
    if unknown := [row for row in given.rows if row not in known]:
        parser.error(f"no such row: {unknown[0]}; expected some of {', '.join(known)}")
    given.kept.mkdir(parents=True, exist_ok=True)
    for row in given.rows or known:
        place = given.kept / f"{row}.json"
        if place.exists() and row not in given.rows:
            continue
        print(f"{row} ...", flush=True)
        try:
            text = json.dumps(made(row, known[row]), indent=1) + "\n"
        except FileNotFoundError as error:
            print(error)
            continue
        except KeyboardInterrupt:
            print("interrupted; the rows that are whole are kept")
            return 130
        part = place.with_suffix(".part")
        part.write_text(text, encoding="utf-8")
        part.replace(place)
        print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
