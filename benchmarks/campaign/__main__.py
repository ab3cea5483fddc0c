"""``make bench-campaign``: many plants with noise of their own, against numba, JAX and filterpy, in one run."""

from __future__ import annotations

import argparse
import itertools
import json
import math
import resource
import shutil
import statistics
import subprocess
import tempfile
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

import flexhinf as fh
from benchmarks import firmware_tools, peers
from benchmarks.arm import Arm
from benchmarks.campaign.floating_point import LANES, peak, work_of
from benchmarks.campaign.on_gpu import on_gpu
from benchmarks.filterpy_loop import FilterpyLoop
from benchmarks.measure import Timing, alternate, ratio, rounds
from benchmarks.record import keep
from flexhinf.campaign import Campaign
from flexhinf.campaign.batches import TRACED
from flexhinf.processors import limited_threads, thread_count

PERIOD, GOAL, Q, R, THREADS = 1e-3, math.pi / 2, 1e-6, 1e-6, 2
#: The environment of numba and JAX, which are in no lock of ours: `make peers`.


class PaperArm:
    """The loop of the paper's arm, its plants, and the same numbers for the peers."""

    def __init__(self, plants: int, steps: int) -> None:
        self.steps, robot = steps, fh.paper_arm()
        problem, self.plant = robot.problem(), robot.plant()
        solution = fh.solve_hji(problem, gamma=2 * fh.smallest_gamma(problem), degree=4)
        ukf = fh.UnscentedKalmanFilter(self.plant, PERIOD, Q, R, np.zeros(4), 1e-4, form="covariance")
        self.controller = fh.Controller(solution, ukf, PERIOD, latency=0)
        self.law = solution.law_polynomial()
        rng = np.random.default_rng(0)
        rows = [self.plant.parameters.known(robot.draw(rng)) for _ in range(plants)]
        self.parameters = self.plant.parameters.vectors(rows)
        self.seeds = np.arange(plants)

    def ensemble(self, sub_steps: int | None, noise: float | None = math.sqrt(R)) -> Any:
        """Prepared, with compiled code."""
        prepared = fh.Loop(self.plant, self.controller, sub_steps).ensemble(
            fh.Step(GOAL), noise=noise, duration=(self.steps - 1) * PERIOD
        )
        prepared.run(self.parameters[:LANES], self.seeds[:LANES], threads=1)
        return prepared

    def peer_plants(self, count: int) -> np.ndarray:
        """Gravity, stiffness over both inertias, input gain and damping of plants, (count, 5)."""
        found = []
        for row in self.parameters[:count]:
            named = vars(self.plant.parameters.named(row))
            a, b, _, _ = self.plant.with_parameters(**named).linearise()
            found.append([-a[1, 0] - a[1, 2], a[1, 2], a[3, 0], b[3, 0], -a[3, 3]])
        return np.array(found)

    def task(self, threads: int = THREADS) -> dict[str, Any]:
        """What peers need to know of the loop."""
        terms = {
            tuple(np.repeat(range(5), row)): value
            for row, value in zip(self.law.exponents, self.law.coefficients[0])
        }
        known = {1: list(itertools.combinations_with_replacement(range(5), 1))}
        known[3] = list(itertools.combinations_with_replacement(range(5), 3))
        others = [value for term, value in terms.items() if term not in known[1] + known[3]]
        assert not np.any(others), "the law is not odd: the peers would compute another one"
        first, third = ([float(terms.get(term, 0.0)) for term in known[degree]] for degree in (1, 3))
        nominal = fh.paper_arm().plant().parameters.vector()[None]
        kept, self.parameters = self.parameters, nominal
        model, self.parameters = self.peer_plants(1)[0].tolist(), kept
        return {
            "period": PERIOD, "q": Q, "r": R, "goal": GOAL, "noise": math.sqrt(R), "threads": threads,
            "model": model, "first": first, "third": third,
        }  # fmt: skip


class Peer:
    """A peer's process; `processor` are the seconds of processor time that its last run took."""

    def __init__(self, name: str, task: dict[str, Any]) -> None:
        self.name = name
        command = [str(peers.PYTHON), str(Path(__file__).parent / "peer.py"), name]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self._write(task)
        self.versions = json.loads(self._read())

    def run(self, plants: np.ndarray, steps: int, given: np.ndarray | None = None) -> np.ndarray:
        """Results of the first three plants."""
        noise = [] if given is None else given.tolist()
        self._write({"plants": plants.tolist(), "steps": steps, "given": noise})
        answer = json.loads(self._read())
        self.processor = float(answer["processor"])
        return np.array(answer["found"])

    def _write(self, message: dict[str, Any]) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(message) + "\n")
        self.process.stdin.flush()

    def _read(self) -> str:
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            raise SystemExit(f"the peer {self.name} ended; its own message is above")
        return line

    def close(self) -> None:
        """End it."""
        assert self.process.stdin is not None
        self.process.stdin.close()
        self.process.wait()


def started_peers(
    task: dict[str, Any], names: Sequence[str] = ("numba", "numba_lanes", "jax")
) -> dict[str, Peer]:
    """Those that are installed; the others are named."""
    found = {}
    for name in names:
        if why := peers.missing(name.partition("_")[0]):
            print(f"{name} is left out: {why}")
            continue
        found[name] = Peer(name, task)
    return found


def check_peer(arm: PaperArm, peer: Peer, steps: int = 2_000) -> float:
    """The peer's plant with our noise does what ours does, or there is nothing to compare."""
    plants = arm.peer_plants(1)
    named = vars(arm.plant.parameters.named(arm.parameters[0]))
    loop = fh.Loop(arm.plant.with_parameters(**named), arm.controller, 1)
    run = loop.run(fh.Step(GOAL), noise=math.sqrt(R), duration=(steps - 1) * PERIOD)
    position = run.signals["state"][:, 0]
    noise = run.signals["output"][:, 0] - position
    ours = np.array([position.max(), np.abs(run.signals["input"]).max(), np.sum((position - GOAL) ** 2)])
    difference = float(np.max(np.abs(peer.run(plants, steps, noise)[0] / ours - 1.0)))
    assert difference < 1e-6, f"{peer.name} differs by {difference}: nothing to compare"
    return difference


def _row(
    what: str, timing: Timing, target: str = "", met: bool | None = None, note: str = ""
) -> dict[str, Any]:
    return {"what": what, "rate": 1.0 / timing.median, "best": 1.0 / timing.best, "target": target, "met": met,
            "note": note}  # fmt: skip


def campaigns(plants: int, steps: int, repetitions: int, robots: int) -> list[dict[str, Any]]:
    """The paper's arm: ours on one and two threads, then each peer, in turns."""
    arm = PaperArm(plants, steps)
    single, accurate = arm.ensemble(1), arm.ensemble(None)
    parts = int(accurate.run(arm.parameters[:LANES]).sub_steps.max())
    peers, few = started_peers(arm.task()), max(2, plants // 10)
    agreed = {name: check_peer(arm, peer) for name, peer in peers.items()}
    filterpy = FilterpyLoop(PERIOD, Q, R, arm.law.exponents, arm.law.coefficients[0])
    noise = math.sqrt(R) * np.random.default_rng(0).normal(size=500)
    works: dict[str, tuple[Any, int]] = {
        "ours": (lambda: single.run(arm.parameters, arm.seeds, threads=THREADS), plants * steps),
        "one thread": (lambda: single.run(arm.parameters, arm.seeds, threads=1), plants * steps),
        "accurate": (lambda: accurate.run(arm.parameters, arm.seeds, threads=THREADS), plants * steps),
        "filterpy": (lambda: filterpy.run(noise, GOAL), len(noise)),
    }
    for name, peer in peers.items():
        some = arm.peer_plants(few)
        works[name] = (lambda peer=peer, some=some: peer.run(some, steps), len(some) * steps)
    t = alternate(works, repetitions)
    for peer in peers.values():
        peer.close()
    rate, two = 1.0 / t["ours"].median, t["one thread"].median / t["ours"].median
    work = work_of(single.kernel(1).program, {"parts": 1})
    rows = [
        _row(f"paper's arm, {THREADS} threads, 1 sub-step", t["ours"], ">= 40 M/s", rate >= 40e6,
             f"{plants:,} plants x {steps:,} steps, noise of each its own"),
        _row("the same, 1 thread", t["one thread"], f"{THREADS} threads >= 1.8 x", two >= 1.8, f"{two:.2f} x"),
        _row(f"{THREADS} threads, {parts} sub-steps: right to 1e-9", t["accurate"]),
    ]  # fmt: skip
    for name, least in (("numba", 10.0), ("numba_lanes", 10.0), ("jax", 20.0), ("filterpy", 5000.0)):
        if name not in t:
            continue
        ratio = t[name].median / t["ours"].median
        note = f"ours is {ratio:,.1f} x" + (
            f"; results agree to {agreed[name]:.0e}" if name in agreed else ""
        )
        rows.append(_row(name, t[name], f"ours >= {least:,.0f} x", ratio >= least, note))
    rows += [*_limit(work, t["one thread"]), _memory(arm), *end_to_end(arm, robots, 500, repetitions)]
    return rows


def end_to_end(arm: PaperArm, samples: int, steps: int, repetitions: int) -> list[dict[str, Any]]:
    """What `flexhinf.run_campaign` adds to its runs, in memory and with a journal: draws, metrics, the table.

    All take turns, by the clock and by processor time, which other programs disturb less.
    """
    robot, options = fh.paper_arm(), {"noise": math.sqrt(R), "duration": (steps - 1) * PERIOD}
    loop = fh.Loop(arm.plant, arm.controller, 1)
    campaign = Campaign(loop, robot.draw, samples, options={**options, "reference": fh.Step(GOAL)})
    plants = campaign.plants(range(samples), campaign.draw.samples(range(samples), samples, 0))
    truth, seeds = arm.plant.parameters.vectors(plants["parameters"]), plants["seeds"]
    ensemble, numbers = campaign.ensemble, itertools.count()
    assert ensemble is not None

    def run(folder: Path | None) -> object:
        return fh.run_campaign(loop, robot.draw, samples, reference=fh.Step(GOAL), folder=folder, **options)

    with tempfile.TemporaryDirectory() as place:
        works: dict[str, tuple[Any, int]] = {
            "ensemble": (lambda: ensemble.run(truth, seeds, traced=min(samples, TRACED)), samples * steps),
            "in memory": (lambda: run(None), samples * steps),
            "with a journal": (lambda: run(Path(place) / str(next(numbers))), samples * steps),
        }
        clocks = rounds_by_both(works, repetitions)
    what = f"{samples:,} robots x {steps:,} steps"
    timings = {name: Timing(min(wall), statistics.median(wall)) for name, (wall, _) in clocks.items()}
    rows = [_row(f"ensemble of {what}, {thread_count()} threads", timings["ensemble"])]
    for name in ("in memory", "with a journal"):
        share, processor = (ratio(clocks["ensemble"][k], clocks[name][k]) for k in (0, 1))
        note = f"{share:.2f} x by the clock, {processor:.2f} x by processor time"
        rows.append(_row(f"run_campaign of them, {name}", timings[name], ">= 0.8 x", share >= 0.8, note))
    return rows


def rounds_by_both(
    works: dict[str, tuple[Any, int]], repetitions: int
) -> dict[str, tuple[list[float], list[float]]]:
    """Seconds per unit of several works in turns, by the clock and of the processor."""
    found: dict[str, tuple[list[float], list[float]]] = {name: ([], []) for name in works}
    for turn in range(repetitions + 1):
        for name, (work, units) in works.items():
            start = time.perf_counter(), time.process_time()
            work()
            for seconds, before, now in zip(found[name], start, (time.perf_counter(), time.process_time())):
                seconds.extend([(now - before) / units] if turn else [])  # the first one compiles
    return found


#: Whole campaigns that are measured: robots, and steps of 1 ms.
WHOLE = ((300_000, 500), (10_000, 4_000))


def whole(share: float, repetitions: int) -> list[dict[str, Any]]:
    """`end_to_end` of a share of the robots of `WHOLE`."""
    return [
        row
        for robots, steps in WHOLE
        for row in end_to_end(PaperArm(LANES, steps), max(LANES, round(share * robots)), steps, repetitions)
    ]


def rival(plants: int, steps: int, turns: int) -> list[dict[str, Any]]:
    """One thread beside numba's loop for vector registers, with noise and without: the least processor time of all
    turns, which other programs disturb less than the clock."""
    arm = PaperArm(plants, steps)
    peer, own = (
        started_peers(arm.task(threads=1), ["numba_lanes"]).get("numba_lanes"),
        arm.peer_plants(plants),
    )
    if peer is None:
        return []
    check_peer(arm, peer)
    cases = (
        ("noise of each plant", arm.ensemble(1), None),
        ("no noise", arm.ensemble(1, None), np.zeros(steps)),
    )
    least = {case[0]: [math.inf, math.inf] for case in cases}
    for _, (name, ensemble, given) in itertools.product(range(turns), cases):
        start = time.process_time()
        ensemble.run(arm.parameters, arm.seeds, threads=1, lanes=LANES)
        ours = time.process_time() - start
        peer.run(own, steps, given)
        least[name] = [min(pair) for pair in zip(least[name], (ours, peer.processor))]
    peer.close()
    return [
        {"what": f"one thread, {name}", "rate": plants * steps / ours, "best": None, "target": ">= 1.5 x numba_lanes",
         "met": theirs / ours >= 1.5, "note": f"{theirs / ours:.2f} x {plants * steps / theirs:,.0f}"}
        for name, (ours, theirs) in least.items()
    ]  # fmt: skip


def single_run(steps: int) -> list[dict[str, Any]]:
    """One run of the paper's arm against C++ written for it by hand, with the same sub-steps and the same noise, by
    processor time: our kernel against its loop, both with the noise given; and whole runs, which draw it too and keep
    all signals."""
    arm = PaperArm(1, steps)
    named = vars(arm.plant.parameters.named(arm.parameters[0]))
    loop = fh.Loop(arm.plant.with_parameters(**named), arm.controller)
    command = (fh.Step(GOAL), None, math.sqrt(R), (steps - 1) * PERIOD)
    run, prepared, task = loop.run(*command), loop.prepared(*command), arm.task()
    position, inputs = run.signals["state"][:, 0], run.signals["input"]
    ours = np.array([position.max(), np.abs(inputs).max(), np.sum((position - GOAL) ** 2)])
    numbers = [
        steps, loop.sub_steps, PERIOD, Q, R, GOAL, math.sqrt(R), *task["model"], *arm.peer_plants(1)[0],
        *task["first"], *task["third"], *(run.signals["output"][:, 0] - position),
    ]  # fmt: skip
    works = {
        "run": (partial(loop.run, *command), steps),
        "new": (lambda: fh.Loop(loop.true_plant, loop.controller, loop.sub_steps).run(*command), steps),
        "kernel": (prepared.code.kernel().bind(*prepared.buffers()), steps),
        "noise": (partial(prepared.with_seed, 0), steps),
    }
    source, least = Path(__file__).parent / "hand_written.cpp", dict[str, float]()
    with tempfile.TemporaryDirectory() as folder:
        program = str(Path(folder) / "hand_written")
        build = ["g++", "-std=c++17", "-O3", "-march=native", "-o", program, str(source)]
        if shutil.which(build[0]) is None:
            print(f"C++ by hand is left out: {build[0]} is not installed")
            return []
        firmware_tools.run(*build, folder=Path.cwd())
        text = " ".join(repr(float(number)) for number in numbers)
        for _ in range(TURNS):
            done = subprocess.run([program], input=text, text=True, capture_output=True, check=True)
            times, *results = (np.array(line.split(), dtype=float) for line in done.stdout.splitlines())
            seconds = rounds(works, 15, clock=time.thread_time)
            now = dict(zip(("loop by hand", "run by hand"), times.tolist()))
            now |= {name: 1e9 * min(values) for name, values in seconds.items()}
            least = {name: min(value, least.get(name, value)) for name, value in now.items()}
    difference = float(np.max(np.abs(np.array(results) / ours - 1.0)))
    assert difference < 1e-6, f"C++ by hand differs by {difference}: nothing to compare"
    return [
        _against_hand("one run's kernel, noise given", least["kernel"], least["loop by hand"]),
        _against_hand(
            f"one run, {loop.sub_steps} sub-steps", least["run"], least["run by hand"],
            f", {least['noise']:.0f} of them for noise; {least['new']:.0f} for the first run of a loop; "
            f"{least['run'] / least['loop by hand']:.2f} x the loop alone by hand; results agree to {difference:.0e}",
        ),
    ]  # fmt: skip


#: Turns of C++ and of ours.
TURNS = 4


def _against_hand(what: str, ours: float, by_hand: float, more: str = "") -> dict[str, Any]:
    ratio = ours / by_hand
    note = f"{ratio:.2f} x; C++ by hand: {by_hand:.0f} ns a step, ours {ours:.0f}{more}"
    return {
        "what": what,
        "rate": 1e9 / ours,
        "best": None,
        "target": "<= 1.3 x C++",
        "met": ratio <= 1.3,
        "note": note,
    }


def _limit(work: Any, timing: Timing) -> list[dict[str, Any]]:
    """How near to the processor's own limit one thread is."""
    most, steps = peak(), 1.0 / timing.best / LANES
    share, full = work.instructions * steps / most, work.operations * steps / (2.0 * most)
    kinds = ", ".join(
        f"{number:.0f} {kind}" for kind, number in sorted(work.items(), key=lambda kind: -kind[1])
    )
    return [
        {"what": f"operations of a plant-step: {work.operations:.0f}", "rate": None, "note": kinds},
        {"what": "of the processor's floating-point limit, 1 thread", "rate": None,
         "note": f"{100 * full:.0f} % of {2e-9 * LANES * most:.0f} Gflop/s (fused multiply-adds alone); "
                 f"{100 * share:.0f} % counted as instructions"},
    ]  # fmt: skip


def _memory(arm: PaperArm) -> dict[str, Any]:
    """What ten times as many plants add to the largest memory of this process, in shorter runs."""
    short = fh.Loop(arm.plant, arm.controller, 1).ensemble(noise=math.sqrt(R), duration=200 * PERIOD)
    largest = []
    for times in (1, 10):
        short.run(np.tile(arm.parameters, (times, 1)), np.tile(arm.seeds, times), threads=THREADS)
        largest.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)  # kB
    each = 1024.0 * (largest[1] - largest[0]) / (9.0 * len(arm.parameters))
    note = f"{each:.0f} bytes a plant, for its parameters and results: nothing of the run"
    return {
        "what": "memory for ten times the plants", "rate": None, "target": "<= 1 kB a plant", "met": each <= 1024.0,
        "note": note,
    }  # fmt: skip


def seven_links(plants: int, steps: int, repetitions: int) -> list[dict[str, Any]]:
    """The catalogue's arm of seven links: 28 states, a cubic law in 35, all joints noisy."""
    arm, rows = Arm(), []
    for period in (1e-3, 2e-4):
        estimator = fh.UnscentedKalmanFilter(
            arm.plant, period, 1e-8, 1e-8, arm.point, 1e-6, form="covariance"
        )
        loop = fh.Loop(arm.plant, fh.Controller(arm.solution, estimator, period, latency=0), 1)
        ensemble = loop.ensemble(noise=1e-5, duration=(steps - 1) * period)
        run = partial(
            ensemble.run,
            np.tile(arm.plant.parameters.vector(), (plants, 1)),
            np.arange(plants),
            threads=1,
            lanes=LANES,
        )
        t = alternate({"": (run, plants * steps)}, repetitions)[""]
        work = work_of(ensemble.kernel(1).program, {"parts": 1})
        share = 100.0 * work.instructions / t.best / LANES / peak()
        note = (
            f"UKF of 57 points, {estimator.sub_steps} sub-steps of {estimator.stages} stages: "
            f"{work.instructions:,.0f} instructions, {share:.0f} % of the limit"
        )
        name = f"seven links, 1 thread, period {1e3 * period:g} ms"
        rows.append(_row(name, t, ">= 100,000/s", 1.0 / t.median >= 1e5, note))
    return rows


def main() -> None:
    """Measure, print a table, keep the figures as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plants", type=int, default=10_000)
    parser.add_argument("--steps", type=int, default=10_000)
    parser.add_argument("--repetitions", type=int, default=5)
    parser.add_argument("--robots", type=int, default=40_000, help="of a whole campaign, drawn and kept")
    parser.add_argument("--rival", action="store_true", help="only one thread beside numba's best loop")
    parser.add_argument("--device", choices=("cpu", "gpu"), default="cpu", help="gpu: only what runs on one")
    parser.add_argument(
        "--whole", type=float, nargs="?", const=0.1, metavar="SHARE",
        help="only whole campaigns, in memory and with a journal, beside their ensemble: a share (a tenth; 1: all) "
        "of 300,000 robots x 0.5 s and of 10,000 x 4 s",
    )  # fmt: skip
    parser.add_argument("--threads", type=int, help="of whole campaigns; as many as processors by default")
    given = parser.parse_args()
    name = "whole.json" if given.whole else "rival.json" if given.rival else "campaign.json"
    if given.device == "gpu":
        arm, name = PaperArm(min(given.plants, 1024), min(given.steps, 4_000)), "gpu.json"
        rows = on_gpu(arm.ensemble(1), arm.parameters, GOAL, math.sqrt(R))
        if not rows:
            return
    elif given.whole:
        with limited_threads(given.threads):
            rows = whole(given.whole, given.repetitions)
    elif given.rival:
        rows = rival(given.plants, given.steps, given.repetitions)
    else:
        rows = campaigns(given.plants, given.steps, given.repetitions, given.robots)
        rows += single_run(given.steps)
        rows += seven_links(max(16, given.plants // 100), max(100, given.steps // 50), given.repetitions)
    table = Table("what", "plant-steps/s", "best", "target", "met", "note")
    for row in rows:
        rates = ["" if row.get(key) is None else f"{row[key]:,.0f}" for key in ("rate", "best")]
        met = {True: "yes", False: "NO", None: ""}[row.get("met")]
        table.add_row(row["what"], *rates, row.get("target", ""), met, row["note"])
    Console(width=190).print(table)
    keep(name, rows)


if __name__ == "__main__":
    main()
