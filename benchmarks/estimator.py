"""``make bench-estimator``: what a step of a filter costs in both forms, and beside filterpy's.

    python -m benchmarks.estimator                   measures every row, and keeps them in benchmarks/estimator.json
    python -m benchmarks.estimator --rows 4 --rounds 9   measures the rows of so many states, and keeps nothing
    python -m benchmarks.estimator --table           prints the tables of the rows that are kept

A step is a correction and a prediction. All works of a row take turns, so that what slows the machine for a while slows
each of them; a ratio is the median of the ratios of the rounds. Times are those of the processor in this thread.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import flexhinf as fh
from benchmarks.filterpy_loop import FilterpyLoop
from benchmarks.measure import ratio, rounds
from flexhinf.codegen import Block, Buffer, Composer, Program, Repeat, Slice, compile_program
from flexhinf.estimation import shell
from flexhinf.identification.recursion import Recursion, rows_of

KEPT = Path(__file__).with_name("estimator.json")

PERIOD, NOISE = 1e-3, 1e-6

#: States, and the robot of the catalogue that has so many; the paper's arm has 4.
ROBOTS = {4: "paper", 8: "planar-two-link", 28: "seven-link"}

KINDS = {"unscented": fh.UnscentedKalmanFilter, "extended": fh.ExtendedKalmanFilter}

#: What is required of a row: the largest or the smallest number of a column.
AT_LEAST = {
    "from Python": 60.0,
    "compiled": 150.0,
    "fh.filter_log": 150.0,
}  # times as fast as filterpy, 4 states, square root
AT_MOST = {4: 1.15, 8: math.inf, 28: 1.8}  # square root over covariance form, compiled, by states
MICROSECONDS = {28: 40.0}  # a step of the square-root form, compiled

#: A compiled loop, a log without its table of results, and one call after the other.
WAYS = ("compiled", "fh.filter_log", "from Python")

Work = tuple[Callable[[], object], int]


def plant_of(states: int) -> tuple[fh.Plant, np.ndarray, np.ndarray]:
    """The plant of so many states that measures link positions, and where it stands."""
    if states == 4:
        return fh.paper_arm().plant(), np.zeros(4), np.zeros(1)
    robot = fh.load_robot(ROBOTS[states])
    x, u = robot.operating_point(robot.home)[:2]
    return robot.plant(("link_position",)), x, u


def filter_of(kind: str, form: Any, states: int) -> Any:
    """A filter at rest."""
    plant, x, _ = plant_of(states)
    return KINDS[kind](plant, PERIOD, NOISE, NOISE, x, 1e-4, form=form)


def standing(states: int) -> tuple[np.ndarray, np.ndarray]:
    """The input that holds the robot, and what is measured there."""
    plant, x, u = plant_of(states)
    return u, np.asarray(plant.evaluate_output(x, u, plant.parameters.vector()), dtype=float)


def from_python(filter: Any, steps: int) -> Work:
    """Corrections and predictions called one by one, after the calls that NumPy makes."""
    u, y = standing(filter.plant.n)
    for _ in range(shell.NUMPY_CALLS):
        filter.correct(y)

    def work() -> None:
        for _ in range(steps):
            filter.correct(y)
            filter.predict(u)

    return work, steps


def filtered_log(filter: Any, steps: int) -> Work:
    """The compiled pass of `fh.filter_log` over so many samples, without its table."""
    u, y = standing(filter.plant.n)
    times = PERIOD * np.arange(steps)
    noise = 1e-3 * np.random.default_rng(0).normal(size=(steps, len(y)))
    rows = rows_of(times, np.tile(u, (steps, 1)), y + noise, PERIOD)
    recursion = Recursion(filter)
    return lambda: recursion.passed(rows), steps


def looped(filter: Any, steps: int) -> Work:
    """Both updates in a compiled loop, and nothing else."""
    run, plant = Composer(), filter.plant
    u, y = standing(plant.n)
    kept = {name: np.array(part, dtype=float) for name, part in filter.initial._asdict().items()}
    fixed = {
        "y": y,
        "u": u,
        "p": plant.parameters.vector(),
        "q": filter.process_noise,
        "r": filter.measurement_noise,
    }
    blocks = {
        name: Block(Slice(name, size=part.size), part.shape) for name, part in {**kept, **fixed}.items()
    }
    belief = type(filter.initial)(*(blocks[name] for name in kept))
    y_, u_, p, q, r = (blocks[name] for name in fixed)
    belief = filter.measurement_update_on(run, belief, y_, u_, p, r)
    belief = filter.time_update_on(run, belief, u_, p, q)
    for name, part in belief._asdict().items():
        run.copy(part, blocks[name])
    buffers = [Buffer(name, block.size, "state" if name in kept else "in") for name, block in blocks.items()]
    program = Program("steps", (*buffers, *run.buffers), (Repeat("steps", tuple(run.body)),), ("steps",))
    return compile_program(program).bind({**kept, **fixed}, {"steps": steps}), steps


def peer(steps: int) -> Work:
    """filterpy's unscented filter of the paper's arm."""
    ukf = FilterpyLoop(PERIOD, NOISE, NOISE, np.zeros((1, 5)), np.zeros(1)).ukf
    y = np.zeros(1)

    def work() -> None:
        for _ in range(steps):
            ukf.update(y)
            ukf.predict(u=0.0)

    return work, steps


def measure(states: int, repetitions: int) -> list[dict[str, Any]]:
    """The rows of so many states."""
    works: dict[str, Work] = {"filterpy": peer(50)} if states == 4 else {}
    steps = max(20, 20_000 // states**2)
    for kind in KINDS:
        for form in ("covariance", "square_root"):
            filter = filter_of(kind, form, states)
            works[f"{kind} {form} compiled"] = looped(filter, steps)
            works[f"{kind} {form} fh.filter_log"] = filtered_log(filter, 8 * steps)
            works[f"{kind} {form} from Python"] = from_python(filter, steps)
    seconds = rounds(works, repetitions, warm=2, clock=time.thread_time)
    rows = []
    for kind in KINDS:
        for way in WAYS:
            root, plain = (seconds[f"{kind} {form} {way}"] for form in ("square_root", "covariance"))
            row: dict[str, Any] = {"states": states, "filter": kind, "way": way}
            row |= {
                "square_root_us": 1e6 * statistics.median(root),
                "covariance_us": 1e6 * statistics.median(plain),
            }
            row["ratio"] = ratio(root, plain)
            if "filterpy" in seconds:
                row["filterpy_us"] = 1e6 * statistics.median(seconds["filterpy"])
                row["times_filterpy"] = ratio(seconds["filterpy"], root)
            rows.append(row)
    return rows


def machine() -> dict[str, Any]:
    """What the rows were measured on."""
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0
    versions = {"python": platform.python_version(), "numpy": np.__version__}
    return {"processor": processor(), **versions, "load": round(load, 1), "processors": os.cpu_count()}


def processor() -> str:
    """Its name, where Linux says it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.machine()
    return next(
        (line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.machine()
    )


# The tables ---------------------------------------------------------------------------------------------
def table(kept: Path = KEPT) -> str:
    """What is kept, with what is required of it."""
    record = json.loads(kept.read_text(encoding="utf-8"))
    lines = [
        "| states | filter | called | square root | covariance | square root / covariance | filterpy / square root |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in record["rows"]:
        cells = [str(row["states"]), row["filter"], row["way"], time_text(row["square_root_us"])]
        cells += [time_text(row["covariance_us"]), f"{row['ratio']:.2f}"]
        cells.append(f"{row['times_filterpy']:.0f}" if "times_filterpy" in row else "")
        lines.append("| " + " | ".join(cells) + " |")
    on = record["machine"]
    said = f"Measured on {on['processor']} with Python {on['python']} and NumPy {on['numpy']}"
    busy = f"; {on['load']} processes at work on {on['processors']} processors" if on["load"] > 1.5 else ""
    return "\n".join([*lines, "", f"{said}{busy}.", "", *verdicts(record["rows"])])


def verdicts(rows: list[dict[str, Any]]) -> list[str]:
    """What is required, what it is, and whether that is enough."""
    found = []
    for row in rows:
        if row["filter"] != "unscented":
            continue
        if "times_filterpy" in row:
            found.append(
                _verdict(
                    f"{row['way']}, times as fast as filterpy",
                    row["times_filterpy"],
                    AT_LEAST[row["way"]],
                    True,
                )
            )
        if row["way"] == "compiled" and math.isfinite(AT_MOST[row["states"]]):
            found.append(
                _verdict(
                    f"{row['states']} states, square root / covariance",
                    row["ratio"],
                    AT_MOST[row["states"]],
                    False,
                )
            )
        if row["way"] == "compiled" and row["states"] in MICROSECONDS:
            found.append(
                _verdict(
                    f"{row['states']} states, µs a step",
                    row["square_root_us"],
                    MICROSECONDS[row["states"]],
                    False,
                )
            )
    return ["| unscented filter | required | measured | met |", "|---|---|---|---|", *found]


def _verdict(what: str, value: float, limit: float, least: bool) -> str:
    met = value >= limit if least else value <= limit
    return f"| {what} | {'≥' if least else '≤'} {limit:g} | {value:.3g} | {'yes' if met else 'no'} |"


def time_text(microseconds: float) -> str:
    """A time with three digits."""
    return f"{microseconds:.3g} µs"


def main() -> int:
    """Measure and keep, or print the tables."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.estimator", description=__doc__)
    parser.add_argument("--table", action="store_true", help="print the rows that are kept")
    parser.add_argument(
        "--rows", type=int, choices=[*ROBOTS], help="the rows of so many states; they are not kept"
    )
    parser.add_argument("--rounds", type=int, default=25, help="turns of all works")
    wanted = parser.parse_args()
    if wanted.table:
        print(table())
        return 0
    rows = [
        row for states in ROBOTS if wanted.rows in (None, states) for row in measure(states, wanted.rounds)
    ]
    print("\n".join(json.dumps(row) for row in rows))
    if wanted.rows is None:
        KEPT.write_text(json.dumps({"machine": machine(), "rows": rows}, indent=1) + "\n", encoding="utf-8")
        print(table())
    return 0


if __name__ == "__main__":
    sys.exit(main())
