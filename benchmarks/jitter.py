"""``python -m benchmarks.jitter --steps N --robot NAME``: how late samples begin, how long a controller's step takes.

The step of `Controller` and that of the library that ``flexhinf compile`` makes of it are called at the period of the
loop, on recorded measurements. Both are looked at for what a real-time loop must not do: a child process counts the
calls of malloc, calloc and realloc in the steps, the collections of the garbage collector, which stays on, and what is
left allocated after them.
"""

from __future__ import annotations

import argparse
import ctypes
import gc
import json
import math
import os
import resource
import subprocess
import sys
import tempfile
import time
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

import flexhinf as fh
from benchmarks.record import keep
from flexhinf.export.compiled import shared_library
from flexhinf.export.realtime import PERCENTILES, percentiles, undisturbed, wait_until

#: Of the robots' filters and laws: as `benchmarks.arm` has them for seven links.
PERIOD, Q, R, P0, GAMMA_RATIO = 1e-3, 1e-8, 1e-8, 1e-6, 1.5

#: Recorded samples, which are used again and again, and steps before anything is looked at.
RECORDED, WARM = 1024, 200

#: Counts calls by standing in front of the C library's functions.
COUNTER = """
#include <stddef.h>
static long calls;
extern void *__libc_malloc(size_t);
extern void *__libc_calloc(size_t, size_t);
extern void *__libc_realloc(void *, size_t);
__attribute__((visibility("default"))) long counted_allocations(void) { return calls; }
__attribute__((visibility("default"))) void *malloc(size_t n) { ++calls; return __libc_malloc(n); }
__attribute__((visibility("default"))) void *calloc(size_t k, size_t n) { ++calls; return __libc_calloc(k, n); }
__attribute__((visibility("default"))) void *realloc(void *p, size_t n) { ++calls; return __libc_realloc(p, n); }
"""


class Stream:
    """A controller of a robot about its home, and measurements and commands to feed it."""

    def __init__(self, robot: str, degree: int) -> None:
        self.robot = fh.load_robot(robot)
        plant = self.robot.plant()
        point, _ = self.robot.operating_point()
        weights = {"link_position": 60.0, "link_position_integral": 300.0}
        problem = self.robot.problem() if self.robot.penalty else self.robot.problem(weights)
        gamma = GAMMA_RATIO * fh.smallest_gamma(problem)
        solution = fh.solve_hji(problem, gamma=gamma if gamma > 0.0 else math.inf, degree=degree)
        ukf = fh.UnscentedKalmanFilter(plant, PERIOD, Q, R, point, P0, form="covariance")
        self.controller = fh.Controller(solution, ukf, PERIOD, latency=0)
        n = len(self.robot.joint_names)
        noise = math.sqrt(R) * np.random.default_rng(0).normal(size=(RECORDED, n))
        self.measured = list(point[:n] + noise - noise.mean(axis=0))
        self.command = np.array(point[:n])

    def stepped(self, kind: str, library: Path) -> Any:
        """``Controller.step`` or that of the compiled library."""
        if kind == "controller":
            return self.controller.fresh().step
        return fh.load_compiled(library).step


KINDS = {"controller": "Controller.step", "library": "compiled library"}


# On the clock --------------------------------------------------------------------------------------
def timed(stream: Stream, step: Any, steps: int, priority: int | None, core: int | None) -> dict[str, Any]:
    """Percentiles of `steps` samples at the period, in µs."""
    measured, command, now = stream.measured, stream.command, time.perf_counter_ns
    late, took = np.full((2, steps), 0)  # written now, so that no page is missing later
    for k in range(WARM):
        step(measured[k % RECORDED], command)
    period = round(1e9 * PERIOD)
    with undisturbed(priority, core) as told:
        used = resource.getrusage(resource.RUSAGE_SELF)
        due = now() + 10 * period
        for k in range(steps):
            y = measured[k % RECORDED]
            woken = wait_until(due)
            step(y, command)
            end = now()
            late[k], took[k] = woken - due, end - woken
            due += period
        after = resource.getrusage(resource.RUSAGE_SELF)
    return {
        "lateness_us": {name: 1e-3 * value for name, value in percentiles(late).items()},
        "step_us": {name: 1e-3 * value for name, value in percentiles(took).items()},
        "missed": int(np.sum(late + took > period)),
        "preempted": after.ru_nivcsw - used.ru_nivcsw,
        "page_faults": after.ru_minflt - used.ru_minflt,
        "scheduling": list(told),
    }


# What a step must not do ----------------------------------------------------------------------------
def counted(stream: Stream, step: Any, steps: int) -> dict[str, Any]:
    """Allocations and collections of `steps` steps; calls of malloc where the counter is loaded, else None."""
    measured, command = stream.measured, stream.command
    for k in range(WARM):
        step(measured[k % RECORDED], command)
    library: Any = ctypes.CDLL(None)
    calls = getattr(library, "counted_allocations", None)
    collections: list[str] = []
    noted = lambda phase, info: collections.append(phase)  # noqa: E731
    gc.collect()
    gc.callbacks.append(noted)
    order = range(steps)
    for look in range(2):  # the first round is the warm one of this very loop
        blocks, before = sys.getallocatedblocks(), 0 if calls is None else calls()
        for k in order:
            step(measured[k % RECORDED], command)
        after = 0 if calls is None else calls()
        left = sys.getallocatedblocks() - blocks
        if not look:
            collections.clear()
    gc.callbacks.remove(noted)
    tracemalloc.start()
    step(measured[0], command)
    tracemalloc.reset_peak()
    least, _ = tracemalloc.get_traced_memory()
    for k in range(WARM):
        step(measured[k % RECORDED], command)
    grown, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return {
        "steps": steps,
        "malloc_calls": None if calls is None else after - before,
        "collections": len(collections),
        "blocks_left": left,
        "bytes_grown": grown - least,
        "bytes_at_once": peak - least,
    }


def counted_apart(robot: str, degree: int, kind: str, library: Path, steps: int) -> dict[str, Any]:
    """`counted` in a process of its own, under the counter of malloc where there is one for this system."""
    environment = dict(os.environ)
    with tempfile.TemporaryDirectory() as folder:
        if sys.platform == "linux":
            counter = Path(folder) / "counter.so"
            counter.write_bytes(shared_library({"counter.c": COUNTER}, ("-O1", "-fno-builtin")))
            environment["LD_PRELOAD"] = str(counter)
        words = [
            "--robot",
            robot,
            "--degree",
            str(degree),
            "--steps",
            str(steps),
            "--count",
            kind,
            str(library),
        ]
        words = [sys.executable, "-m", "benchmarks.jitter", *words]
        done = subprocess.run(words, env=environment, capture_output=True, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


# Together -------------------------------------------------------------------------------------------
def measure(
    robot: str,
    steps: int,
    degree: int,
    kinds: list[str],
    counted_steps: int,
    priority: int | None,
    core: int | None,
) -> list[dict[str, Any]]:
    """One row for each kind of step."""
    stream, rows = Stream(robot, degree), []
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "controller.so"
        if "library" in kinds:
            fh.compile_controller(stream.controller, library)
        for kind in kinds:
            figures = timed(stream, stream.stepped(kind, library), steps, priority, core)
            counts = counted_apart(robot, degree, kind, library, counted_steps)
            rows.append(
                {"robot": robot, "degree": degree, "step": kind, "steps": steps, **figures, "counted": counts}
            )
    return rows


def show(rows: list[dict[str, Any]]) -> None:
    """Percentiles as a table, the rest as sentences."""
    first = rows[0]
    table = Table(
        title=f"{first['robot']}, V of degree {first['degree']}: {first['steps']} steps at {1 / PERIOD:g} Hz, µs"
    )
    for name in ("", *PERCENTILES):
        table.add_column(name, justify="right" if name else "left")
    for row in rows:
        for what, key in (("takes", "step_us"), ("begins late by", "lateness_us")):
            table.add_row(f"{KINDS[row['step']]} {what}", *(f"{value:.1f}" for value in row[key].values()))
    Console().print(table)
    for row in rows:
        c = row["counted"]
        calls = "not counted here" if c["malloc_calls"] is None else c["malloc_calls"]
        print(
            f"{KINDS[row['step']]}: {row['missed']} inputs after the next sample was due; preempted {row['preempted']} "
            f"times; {row['page_faults']} page faults. In {c['steps']} steps: calls of malloc, calloc and realloc "
            f"{calls}; collections {c['collections']}; blocks of Python left {c['blocks_left']}; at most "
            f"{c['bytes_at_once']} bytes at once, {c['bytes_grown']} bytes left."
        )
        for text in row["scheduling"]:
            print(text)


def main(words: list[str] | None = None) -> None:
    """Measure, show and keep."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.jitter", description=__doc__)
    parser.add_argument("--steps", type=int, default=10_000)
    parser.add_argument("--robot", default="seven-link")
    parser.add_argument("--degree", type=int, default=4, help="of V")
    parser.add_argument("--only", choices=list(KINDS), help="of the two steps")
    parser.add_argument("--counted-steps", type=int, default=5_000)
    parser.add_argument("--priority", type=int, help="of SCHED_FIFO, where permitted")
    parser.add_argument("--core", type=int, help="that the loop is kept on")
    parser.add_argument("--count", nargs=2, metavar=("KIND", "LIBRARY"), help=argparse.SUPPRESS)
    given = parser.parse_args(words)
    if given.count:
        stream, (kind, library) = Stream(given.robot, given.degree), given.count
        print(json.dumps(counted(stream, stream.stepped(kind, Path(library)), given.steps)))
        return
    kinds = [given.only] if given.only else list(KINDS)
    rows = measure(
        given.robot, given.steps, given.degree, kinds, given.counted_steps, given.priority, given.core
    )
    show(rows)
    keep("jitter.json", rows)


if __name__ == "__main__":
    main()
