"""``make bench-certificates``: our proofs beside matrix inequalities and sums of squares (docs/certificate_study.md).

    python -m benchmarks.certificates            measures every row, and keeps them in benchmarks/certificates/rows.json
    python -m benchmarks.certificates --table    prints the tables of the rows that are kept

CPU seconds of one process, not wall clock: the rivals' are those of cvxpy and Clarabel alone. "Exact" means that
rational arithmetic confirms it: for the rivals after rounding (`identities.proved`), for us the second program.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path
from typing import Any

from benchmarks.record import keep

KEPT = Path(__file__).parent / "rows.json"

#: Law, degree of V and goal of our rows.
OURS = [
    ("linear", 2, 180),
    ("linear", 2, 90),
    ("cubic", 4, 180),
    ("quintic", 6, 180),
    ("linear, all tolerances", 2, 180),
    ("linear, all tolerances", 2, 90),
]


def measured() -> dict[str, list[dict[str, Any]]]:
    """Every row, by table."""
    from benchmarks.certificates import arm, published
    from benchmarks.certificates.identities import Solver

    rows: list[dict[str, Any]] = []

    def add(row: dict[str, Any]) -> None:
        rows.append(row)
        print(json.dumps(row), flush=True)

    with Solver() as solver:
        for goal in (180, 90):
            add(arm.linear_inequalities(solver, goal))
            add(arm.tolerant_inequalities(solver, goal))
    with Solver() as solver:  # each for its own memory
        add(arm.given_storage(solver, 2))
    with Solver() as solver:
        add(arm.given_storage(solver, 4))
    with Solver() as solver:
        row, best = arm.free_storage(solver, 4, 0.85, 12)
        add(row)
        add(arm.confirmed(best, row["step"]))
    with Solver() as solver:
        add(arm.given_storage(solver, 4, 2, (0.999, 0.99, 0.97)))
    for law, degree, goal in OURS:
        add(arm.ours_alone(law, degree, goal))
        if "tolerances" in law:
            add(arm.ours_alone(law, degree, goal, arm.COMMON))
    with Solver() as solver:
        gains = published.rows(solver)
        return {"arm": rows, "published": gains, "versions": [solver.versions]}


def tables(kept: dict[str, list[dict[str, Any]]]) -> str:
    """Both tables as Markdown."""
    order = {"linear": 0, "linear, all tolerances": 1, "cubic": 2, "quintic": 3}
    rows = sorted(kept["arm"], key=lambda row: (order[row["law"]], -row["goal"], row["method"]))
    lines = [
        "| law, goal | method | γ proved | step proved | CPU | memory | exact |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        step = "every start" if row["step"] is None else f"{row['step']:.2f} rad"
        if "share" in row:
            step += f" ({row['share']:g} of V's level)"
        check = f", check {_seconds(row['check'])}" if "check" in row else ""
        if not math.isfinite(row["gamma"]):
            step = "none"
        lines.append(
            f"| {row['law']}, {row['goal']}° | {_method(row)} | {row['gamma']:.0f} | {step} | "
            f"{_seconds(row['seconds'])}{check} | {row['megabytes']:.0f} MB | {row['exact'] or 'yes'} |"
        )
    lines += ["", "| published plant, γ = 0.5 | degree of V | R | CPU | exact |", "|---|---|---|---|---|"]
    for row in sorted(kept["published"], key=lambda row: -row["radius"]):
        cost = "" if row["seconds"] is None else f"{_seconds(row['seconds'])} | {row['exact'] or 'yes'}"
        lines.append(
            f"| {row['method']} ({row['note']}) | {row['degree']} | {row['radius']:.3f} | {cost or ' |'} |"
        )
    return "\n".join(lines)


def _method(row: dict[str, Any]) -> str:
    """Who, with which V, and multipliers of which degree."""
    order = f", multiplier of degree {2 * row['order']}" if "order" in row else ""
    return f"{row['method']}, V of degree {row['degree']}{order}"


def _seconds(value: float) -> str:
    return f"{value:.2g} s" if value < 10 else f"{value:.0f} s"


def main() -> int:
    """Measure and keep, or print the tables."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.certificates", description=__doc__)
    parser.add_argument("--table", action="store_true", help="print the rows that are kept")
    parser.add_argument(
        "--ours", nargs=4, metavar=("LAW", "DEGREE", "GOAL", "V"), help="one row of ours, as JSON"
    )
    given = parser.parse_args()
    if given.ours:
        from benchmarks.certificates import arm

        law, degree, goal, value = given.ours
        print(json.dumps(arm.ours(law, int(degree), int(goal), value)))
        return 0
    if not given.table:
        from benchmarks.certificates.identities import Solver

        if missing := Solver.missing():
            print(missing, file=sys.stderr)
            return 2
        found = measured()
        keep("certificates.json", [*found["arm"], *found["published"]])
        KEPT.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    print(tables(json.loads(KEPT.read_text(encoding="utf-8"))))
    return 0


if __name__ == "__main__":
    sys.exit(main())
