"""``make bench``: the closed loop, one step from Python, the solver, the import and the whole report."""

from __future__ import annotations

import math
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

import flexhinf as fh
from benchmarks.filterpy_loop import FilterpyLoop
from benchmarks.measure import alternate, timed
from benchmarks.record import keep, readable

STEPS, PEER_STEPS, PERIOD, GOAL = 10_000, 1_000, 1e-3, math.pi / 2
Q, R = 1e-6, 1e-6


def loops() -> list[dict[str, Any]]:
    """Closed-loop step in a run of 10,000 steps, and one controller step called from Python, against filterpy."""
    robot = fh.paper_arm()
    problem = robot.problem()
    solution = fh.solve_hji(problem, gamma=2 * fh.smallest_gamma(problem), degree=4)
    ukf = fh.UnscentedKalmanFilter(robot.plant(), PERIOD, Q, R, np.zeros(4), 1e-4, form="covariance")
    controller = fh.Controller(solution, ukf, PERIOD, latency=0)
    loop = fh.Loop(robot.plant(), controller)
    law = solution.law_polynomial()
    peer = FilterpyLoop(PERIOD, Q, R, law.exponents, law.coefficients[0])

    run = loop.run(fh.Step(GOAL), noise=math.sqrt(R), duration=(STEPS - 1) * PERIOD)
    noise = (run.signals["output"] - run.signals["state"][:, :1])[:, 0]
    ours, theirs = run.signals["input"][:PEER_STEPS, 0], peer.run(noise[:PEER_STEPS], GOAL)
    difference = float(np.abs(ours - theirs).max())
    assert difference < 1e-6, f"the two loops differ by {difference} V: nothing to compare"

    y = np.array([0.3])
    step, peer_step = controller.step, peer.step

    def call_ours() -> None:
        for _ in range(PEER_STEPS):
            step(y, GOAL)

    def call_peer() -> None:
        for _ in range(PEER_STEPS // 10):
            peer_step(0.3, GOAL)

    controller.reset()
    peer.reset()
    t = alternate(
        {
            "run": (
                lambda: loop.run(fh.Step(GOAL), noise=math.sqrt(R), duration=(STEPS - 1) * PERIOD),
                STEPS,
            ),
            "peer run": (lambda: peer.run(noise[:PEER_STEPS], GOAL), PEER_STEPS),
            "step": (call_ours, PEER_STEPS),
            "peer step": (call_peer, PEER_STEPS // 10),
        }
    )
    return [
        _row(
            "closed-loop step, run of 10,000",
            t["run"],
            t["peer run"],
            300.0,
            f"inputs agree to {difference:.0e} V",
        ),
        _row("one controller.step from Python", t["step"], t["peer step"], 100.0, "measurement to input"),
    ]


def _row(what: str, ours: Any, theirs: Any, target: float, note: str) -> dict[str, Any]:
    ratio = theirs.median / ours.median
    return {
        "what": what, "ours_us": 1e6 * ours.median, "peer": "filterpy", "peer_us": 1e6 * theirs.median,
        "ratio": ratio, "target": f">= {target:g} times", "met": ratio >= target, "note": note,
    }  # fmt: skip


def solver() -> list[dict[str, Any]]:
    """solve_hji on the paper's arm, warm."""
    problem = fh.paper_arm().problem()
    gamma = 2 * fh.smallest_gamma(problem)
    rows = []
    for degree, target in ((4, 2e-3), (6, 5e-3)):
        t = timed(
            lambda degree=degree: fh.solve_hji(problem, gamma=gamma, degree=degree), repetitions=25, warm=3
        )
        rows.append(
            {"what": f"solve_hji, n = 5, degree {degree}", "ours_us": 1e6 * t.median,
             "target": f"<= {1e3 * target:g} ms", "met": t.median <= target, "note": "with the arm's expansion"}
        )  # fmt: skip
    return rows


def processes() -> list[dict[str, Any]]:
    """``import flexhinf``, and the whole ``flexhinf paper``, as processes."""
    rows = []
    t = timed(lambda: subprocess.run([sys.executable, "-c", "import flexhinf"], check=True), repetitions=7)
    rows.append(
        {
            "what": "import flexhinf, warm process",
            "ours_us": 1e6 * t.median,
            "target": "<= 0.5 s",
            "met": t.median <= 0.5,
        }
    )
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        command = [sys.executable, "-m", "flexhinf", "paper", "--out", str(Path(folder) / "report")]
        subprocess.run(command, check=True, capture_output=True)
        spent = time.perf_counter() - start
    rows.append(
        {
            "what": "flexhinf paper, whole command",
            "ours_us": 1e6 * spent,
            "target": "<= 30 s",
            "met": spent <= 30.0,
        }
    )
    return rows


def main() -> None:
    """Measure, print a table, keep the figures as JSON."""
    rows = [*loops(), *solver(), *processes()]
    table = Table("what", "flexhinf", "peer", "ratio", "target", "met", "note")
    for row in rows:
        peer = f"{row['peer']} {readable(row['peer_us'])}" if "peer" in row else ""
        ratio = f"{row['ratio']:.0f}" if "ratio" in row else ""
        met = "yes" if row["met"] else "NO"
        table.add_row(
            row["what"], readable(row["ours_us"]), peer, ratio, row["target"], met, row.get("note", "")
        )
    Console(width=150).print(table)
    keep("bench.json", rows)


if __name__ == "__main__":
    main()
