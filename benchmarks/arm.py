"""``make bench-arm``: the seven-link elastic arm: one controller step, its law, its compile time, its closed loop."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

import flexhinf as fh
from benchmarks.measure import Timing, alternate
from benchmarks.pinocchio_loop import PinocchioController
from benchmarks.record import keep, readable
from flexhinf.codegen import Block, Buffer, Composer, Program, Slice, compile_program
from flexhinf.loop.controller.step import LawCode

PERIOD, GAMMA = 1e-3, 700.0
Q, R, P0 = 1e-8, 1e-8, 1e-6
STEPS, PEER_STEPS, AGREE = 200, 3, 5


class Arm:
    """The catalogue's arm, its cubic law in 35 states, its estimator of 28, and the controller of both."""

    def __init__(self) -> None:
        self.robot = fh.load_robot("seven-link")
        self.plant = self.robot.plant()
        self.point, _ = self.robot.operating_point()
        self.solution = fh.solve_hji(self.robot.problem(), gamma=GAMMA, degree=4)
        self.estimator = fh.UnscentedKalmanFilter(self.plant, PERIOD, Q, R, self.point, P0, form="covariance")
        self.controller = fh.Controller(self.solution, self.estimator, PERIOD, latency=0)

    def samples(self, count: int) -> list[tuple[np.ndarray, np.ndarray]]:
        """Measurements and commands about the pose."""
        rng, pose = np.random.default_rng(0), self.point[:7]
        return [(pose + 1e-4 * rng.normal(size=7), pose + 1e-3 * rng.normal(size=7)) for _ in range(count)]


def law_alone(arm: Arm) -> Any:
    """``law()`` evaluates the compiled law at one state: a kernel of nothing else."""
    code, run = LawCode(arm.solution, composed=True), Composer()
    assert code.table is not None
    n, m = len(arm.solution.state_names), len(arm.solution.input_names)
    data = code.data
    x, numbers = Block(Slice("x", 0, n), (n,)), Block(Slice("data", 0, data.size), (data.size,))
    run.copy(code.on(run, numbers)(x), Block(Slice("u", 0, m), (m,)))
    buffers = (Buffer("x", n, "in"), Buffer("data", data.size, "in"), Buffer("u", m, "out"), *run.buffers)
    x, u = 1e-2 * np.random.default_rng(0).normal(size=n), np.zeros(m)
    bound = compile_program(Program("law", buffers, tuple(run.body))).bind({"x": x, "data": data, "u": u})
    bound()
    expected = arm.solution.law(x)
    assert np.abs(u - expected).max() < 1e-9 * np.abs(expected).max(), (
        "the two laws differ: nothing to compare"
    )
    return bound, lambda: arm.solution.law(x)


def speed() -> list[dict[str, Any]]:
    """One controller step and the law, against filterpy with Pinocchio and against NumPy, in turns."""
    arm = Arm()
    steps = arm.estimator.stages, arm.estimator.sub_steps
    peer = PinocchioController(arm.robot, arm.solution, PERIOD, steps, Q, R, P0)
    samples = arm.samples(AGREE)
    difference = 0.0
    for y, r in samples:
        ours, theirs = arm.controller.step(y, r), peer.step(y, r)
        difference = max(difference, float(np.abs(ours - theirs).max() / np.abs(theirs).max()))
    assert difference < 1e-6, f"the two controllers differ by {difference}: nothing to compare"
    y, r = samples[0]
    step, law, numpy_law = arm.controller.step, *law_alone(arm)
    loop = fh.Loop(arm.plant, arm.controller)

    def repeated(work: Any, times: int) -> Any:
        return lambda: [work() for _ in range(times)]

    t = alternate(
        {
            "step": (repeated(lambda: step(y, r), STEPS), STEPS),
            "peer step": (repeated(lambda: peer.step(y, r), PEER_STEPS), PEER_STEPS),
            "law": (repeated(law, STEPS), STEPS),
            "numpy law": (repeated(numpy_law, STEPS // 10), STEPS // 10),
            "loop": (lambda: loop.run(duration=(STEPS - 1) * PERIOD, noise=1e-5), STEPS),
        },
        repetitions=9,
    )
    note = f"{steps[1]} sub-steps of {steps[0]} stages; inputs agree to {difference:.0e}"
    return [
        _row("controller.step from Python, 28 states, law in 35", t["step"], 80.0, t["peer step"],
             "filterpy + Pinocchio", note),
        _row("the cubic law alone, 8,435 monomials x 7", t["law"], 20.0, t["numpy law"],
             "NumPy (HJISolution.law)", "compiled, with its call from Python"),
        _row("closed-loop step", t["loop"], None, t["peer step"], "the peer's controller alone",
             f"with {loop.sub_steps} sub-steps of the true plant"),
    ]  # fmt: skip


def _row(
    what: str, ours: Timing, target: float | None, theirs: Timing, peer: str, note: str
) -> dict[str, Any]:
    return {
        "what": what, "ours_us": 1e6 * ours.median, "best_us": 1e6 * ours.best, "peer": peer,
        "peer_us": 1e6 * theirs.median, "ratio": theirs.median / ours.median,
        "target": "" if target is None else f"<= {target:g} µs",
        "met": None if target is None else 1e6 * ours.median <= target, "note": note,
    }  # fmt: skip


def first_step() -> None:
    """In a process of its own: seconds from the controller to its first input, on the clock and of this process."""
    arm = Arm()
    y, r = arm.samples(1)[0]
    start, used = time.perf_counter(), time.process_time()
    controller = fh.Controller(arm.solution, arm.estimator, PERIOD, latency=0)
    controller.step(y, r)
    print(json.dumps([time.perf_counter() - start, time.process_time() - used]))


def compile_times() -> list[dict[str, Any]]:
    """Tracing, compiling and loading: with an empty cache, and again with what it then holds."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for what, target, processes in (
            ("first step, empty cache", 10.0, 1),
            ("first step, from the cache", 0.2, 5),
        ):
            command = [sys.executable, "-c", "from benchmarks.arm import first_step; first_step()"]
            environment = {**os.environ, "FLEXHINF_CACHE": folder}
            taken = [
                json.loads(
                    subprocess.run(
                        command, check=True, capture_output=True, env=environment, text=True
                    ).stdout
                )
                for _ in range(processes)
            ]
            clock, used = np.median(taken, axis=0).tolist()
            rows.append(
                {"what": what, "ours_us": 1e6 * clock, "target": f"<= {target:g} s", "met": clock <= target,
                 "note": f"{used:.2f} s of processor time"}
            )  # fmt: skip
    return rows


def main() -> None:
    """Measure, print a table, keep the figures as JSON."""
    rows = [*speed(), *compile_times()]
    table = Table("what", "flexhinf", "best", "peer", "ratio", "target", "met", "note")
    for row in rows:
        peer = f"{row['peer']} {readable(row['peer_us'])}" if "peer" in row else ""
        table.add_row(
            row["what"], readable(row["ours_us"]), readable(row["best_us"]) if "best_us" in row else "", peer,
            f"{row['ratio']:.0f}" if "ratio" in row else "", row["target"],
            {True: "yes", False: "NO", None: ""}[row["met"]], row["note"],
        )  # fmt: skip
    Console(width=170).print(table)
    keep("arm.json", rows)


if __name__ == "__main__":
    main()
