"""``make bench-hardware``: designs of several robots, before and now, and a payload that the model does not know.

Each row is kept as a file when it is whole, so that an interrupted run goes on where it was: ``python -m
benchmarks.hardware`` makes those that are missing, ``python -m benchmarks.hardware planar-link arm-untold`` makes these
anew, and ``--table robots`` prints a table of those that are kept. ``--before FOLDER`` makes the rows of an older
version of flexhinf, checked out into FOLDER.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.hardware.robots import ROBOTS, files_of, without_new_keys
from benchmarks.hardware.tables import FINE, LIMITED, PAYLOADS, ROWS, SENSORS, TABLES

ROOT = Path(__file__).resolve().parents[2]


def tasks(before: Path | None = None) -> dict[str, dict[str, Any]]:
    """Every row's task, by name; see `rows.measure`. An older version knows no payloads."""
    found: dict[str, dict[str, Any]] = {}
    for robot in ROBOTS:
        for sensors, measured in SENSORS.items():
            found[f"{robot}-{sensors}"] = {"name": robot, "options": {"measured": measured}}
            if robot in LIMITED:
                options = {"measured": measured, "measurement_noise": FINE}
                found[f"{robot}-{sensors}-fine"] = {"name": robot, "options": options}
            if before is None:  # weights and noise levels alone, of this version
                task = {"name": robot, "options": {"measured": measured}, "linear": True}
                found[f"{robot}-{sensors}-linear"] = task
    if before is None:
        for name, (payload, _, masses) in PAYLOADS.items():
            options = {"measured": SENSORS["link"], "measurement_noise": FINE}
            found[f"arm-{name}"] = {"name": "arm", "options": options, "payload": payload, "masses": masses}
    return found


def made(row: str, task: dict[str, Any], before: Path | None) -> dict[str, Any]:
    """The row, measured by a process of its own with an empty cache of kernels."""
    import flexhinf as fh

    file, elastic = files_of(task["name"])
    robot = fh.load_robot(file, elastic=elastic)
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        if before is not None:
            own = place / "own.toml"
            own.write_text(without_new_keys(elastic or file), encoding="utf-8")
            file, elastic = (file, own) if elastic else (own, None)
        whole = {**task, "robot": str(file), "elastic": str(elastic or ""), "limits": robot.effort_limits}
        (place / "task.json").write_text(json.dumps(whole), encoding="utf-8")
        paths = [str((before or ROOT) / "src"), str(ROOT), os.environ.get("PYTHONPATH", "")]
        environment = {
            **os.environ, "FLEXHINF_CACHE": str(place / "cache"), "OMP_NUM_THREADS": "1",
            "PYTHONPATH": os.pathsep.join(paths),
        }  # fmt: skip
        command = [
            sys.executable,
            "-m",
            "benchmarks.hardware.rows",
            str(place / "task.json"),
            str(place / "row.json"),
        ]
        subprocess.run(command, cwd=ROOT, env=environment, check=True)
        return {"robot": robot.name, "row": row, **json.loads((place / "row.json").read_text("utf-8"))}


def main() -> int:
    """Make the rows that are named or missing, one after the other, or print a table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.hardware", description=__doc__)
    parser.add_argument("rows", nargs="*", help="made anew; by default all that are missing")
    parser.add_argument("--before", type=Path, metavar="FOLDER", help="an older version, checked out there")
    parser.add_argument("--kept", type=Path, default=ROWS, metavar="FOLDER", help="where the rows are kept")
    parser.add_argument("--table", choices=sorted(TABLES), help="print the rows that are kept")
    given = parser.parse_args()
    if given.table:
        print(TABLES[given.table](given.kept))
        return 0
    known, end = tasks(given.before), "" if given.before is None else "-before"
    if unknown := [row for row in given.rows if row not in known]:
        parser.error(f"no such row: {unknown[0]}; expected some of {', '.join(known)}")
    given.kept.mkdir(parents=True, exist_ok=True)
    for row in given.rows or known:
        place = given.kept / f"{row}{end}.json"
        if place.exists() and row not in given.rows:
            continue
        print(f"{row}{end} ...", flush=True)
        try:
            text = json.dumps(made(row, known[row], given.before), indent=1) + "\n"
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
