"""``make bench-hji``: the Hamilton–Jacobi–Isaacs solver on random plants, each size in a process of its own.

The plants: A = Gaussian/√n − ½ I, quadratic and cubic terms at 60 n random places each with coefficients
0.05·N(0, 1), m = max(1, n/5) Gaussian columns of g1 and g2, h = x, R2 = I, γ = 2 γ*. Times are CPU seconds of a
warm call (tables of the size built, as in any second call), on one thread unless said. Beside them stands the time
of one 1000 × 1000 matrix product on the same machine, and every time as a multiple of it.

The peer's figures (PPR of NLbalancing under GNU Octave, as shipped and with its fastest solver) were measured once,
on another machine, and are printed for scale only.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

RESULTS = Path(".benchmarks") / "hji.json"


@dataclass(frozen=True)
class Case:
    """One row: size, what the plant is like, threads, targets (CPU s, or wall s on two threads; GB)."""

    n: int
    degree: int
    kind: str = "quadratic and cubic"
    threads: int = 1
    seconds: float | None = None
    gigabytes: float | None = None
    peer: str = ""


TARGETS = (
    Case(5, 4, seconds=0.002, peer="0.0185 / 0.0131"),
    Case(5, 6, seconds=0.004, peer="0.565 / 0.040"),
    Case(20, 4, seconds=0.02, peer="1.04 / 0.157"),
    Case(20, 6, seconds=1.0, gigabytes=0.5, peer="– / 135, 11 GB"),
    Case(35, 4, seconds=0.10, peer="5.7 / 1.4"),
    Case(35, 5, seconds=2.0, gigabytes=1.0, peer="– / 202, 8 GB"),
    Case(35, 6, threads=2, seconds=20.0, gigabytes=4.0, peer="cannot be stored"),
)
WITH_AND_WITHOUT = (
    Case(20, 6, kind="cubic only (odd: parity)"),
    Case(20, 6, kind="full f (no sparsity)"),
    Case(20, 6, threads=2),
    Case(35, 5, kind="cubic only (odd: parity)"),
    Case(35, 5, kind="full f (no sparsity)"),
    Case(35, 5, threads=2),
    Case(35, 6),
)
GROWTH = tuple(
    Case(n, degree)
    for degree in (4, 5, 6)
    for n in (3, 5, 8, 12, 16, 20, 25, 30, 35)
    if (n, degree) < (35, 6)
)


def random_plant(n: int, kind: str, seed: int = 0) -> Any:
    """The plant of the docstring; `kind` leaves out the quadratic terms, or fills f."""
    from flexhinf.plant import PolynomialPlant
    from flexhinf.polynomial import basis

    rng = np.random.default_rng(seed)
    m = max(1, n // 5)
    f = {1: rng.standard_normal((n, n)) / np.sqrt(n) - 0.5 * np.eye(n)}
    for k in (2, 3):
        size = basis.count(n, k)
        if kind.startswith("full"):
            part = 0.05 * rng.standard_normal((n, size)) * np.sqrt(60 / size)
        else:
            part = np.zeros((n, size))
            places = rng.integers(0, n, 60 * n), rng.integers(0, size, 60 * n)
            np.add.at(part, places, 0.05 * rng.standard_normal(60 * n))
        if k == 3 or not kind.startswith("cubic"):
            f[k] = part
    g1, g2 = rng.standard_normal((2, n, m, 1))
    return PolynomialPlant.from_parts(n, f, {0: g1}, {0: g2}, {1: np.eye(n)}, np.eye(m))


def run_case(n: int, degree: int, kind: str) -> dict[str, Any]:
    """Inside the process of one case: cold and warm call, memory at the peak, worst residual."""
    from flexhinf.hinf import smallest_gamma, solve_hji

    plant = random_plant(n, kind)
    gamma = 2 * smallest_gamma(plant)
    begin = time.process_time()
    solution = solve_hji(plant, gamma, degree)
    cold = time.process_time() - begin
    best_cpu = best_wall = np.inf
    for _ in range(1 if cold > 5 else 5 if cold > 0.5 else 40):
        cpu, wall = time.process_time(), time.perf_counter()
        solution = solve_hji(plant, gamma, degree)
        best_cpu = min(best_cpu, time.process_time() - cpu)
        best_wall = min(best_wall, time.perf_counter() - wall)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    return {
        "cold_cpu_s": cold,
        "cpu_s": best_cpu,
        "wall_s": best_wall,
        "peak_gb": peak / 1e9,
        "estimate_gb": solution.memory / 1e9,
        "residual": max(record.residual for record in solution.records),
        "methods": [record.method for record in solution.records],
        "condition": solution.condition,
    }


def measure(case: Case) -> dict[str, Any]:
    """Run one case in a fresh process with its number of threads."""
    environment = os.environ | {"OMP_NUM_THREADS": str(case.threads), "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "benchmarks.hji", "--case", str(case.n), str(case.degree), case.kind]
    done = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
    return {
        "n": case.n,
        "degree": case.degree,
        "kind": case.kind,
        "threads": case.threads,
        **json.loads(done.stdout),
    }


def matrix_product_seconds() -> float:
    """One 1000 × 1000 product of doubles, one thread, best of several."""
    a = np.random.default_rng(0).standard_normal((1000, 1000))
    best = np.inf
    for _ in range(8):
        begin = time.process_time()
        a @ a
        best = min(best, time.process_time() - begin)
    return best


def table(title: str, cases: tuple[Case, ...], rows: list[dict[str, Any]], product: float) -> Table:
    """Rows beside their targets and the peer."""
    result = Table(
        "n",
        "degree",
        "f",
        "threads",
        "CPU s",
        "wall s",
        "× product",
        "GB",
        "residual",
        "target",
        "met",
        "PPR, s",
    )
    result.title = title
    for case, row in zip(cases, rows, strict=True):
        judged = row["wall_s"] if case.threads > 1 else row["cpu_s"]
        target = "" if case.seconds is None else f"{case.seconds:g} s" + (" wall" if case.threads > 1 else "")
        target += "" if case.gigabytes is None else f", {case.gigabytes:g} GB"
        met = judged <= (case.seconds or np.inf) and row["peak_gb"] <= (case.gigabytes or np.inf)
        result.add_row(
            str(case.n), str(case.degree), case.kind, str(case.threads), f"{row['cpu_s']:.4g}", f"{row['wall_s']:.4g}",
            f"{judged / product:.3g}", f"{row['peak_gb']:.2f}", f"{row['residual']:.0e}", target,
            ("yes" if met else "NO") if target else "", case.peer,
        )  # fmt: skip
        row["target_s"], row["met"] = case.seconds, bool(met)
    return result


def figure(path: Path, rows: list[dict[str, Any]], product: float) -> None:
    """Growth with n and degree beside the targets, log-log, in seconds and in matrix products, as SVG."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import FixedLocator, NullLocator, StrMethodFormatter

    from flexhinf.report import SERIES, figure_to_svg, house_style

    with house_style():
        drawing = Figure(figsize=(7.2, 4.2), layout="constrained")
        axes = drawing.subplots()
        for degree, colour in zip((4, 5, 6), SERIES):
            line = [(row["n"], row["cpu_s"]) for row in rows if row["degree"] == degree]
            axes.loglog(*zip(*line), marker="o", ms=4, color=colour, label=f"V to degree {degree}")
            wanted = [(t.n, t.seconds) for t in TARGETS if t.degree == degree and t.threads == 1]
            axes.plot(
                *zip(*wanted), ls="", marker="_", ms=14, mew=2, color=colour, label=f"target, degree {degree}"
            )
        axes.set(xlabel="states n", ylabel="CPU time of one call, one thread (s)", xlim=(2.7, 39))
        axes.xaxis.set(
            major_locator=FixedLocator(sorted({row["n"] for row in rows})), minor_locator=NullLocator()
        )
        axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        products = axes.secondary_yaxis("right", functions=(lambda s: s / product, lambda p: p * product))
        products.set_ylabel(f"in 1000 × 1000 matrix products ({1e3 * product:.0f} ms each)")
        axes.legend(ncols=3, loc="lower left", bbox_to_anchor=(0.0, 1.0))
        drawing.set_facecolor("white")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(figure_to_svg(drawing), encoding="utf-8")


def main() -> None:
    """Measure, print, keep the figures as JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--case", nargs=3, metavar=("N", "DEGREE", "KIND"), help="one case, in this process")
    parser.add_argument("--figure", type=Path, help="also measure growth and draw it to this SVG file")
    parser.add_argument("--kept", action="store_true", help="with --figure: draw what was measured last")
    arguments = parser.parse_args()
    if arguments.case:
        n, degree, kind = arguments.case
        print(json.dumps(run_case(int(n), int(degree), kind)))
        return
    if arguments.figure and arguments.kept:
        kept = json.loads(RESULTS.read_text())
        figure(arguments.figure, kept["growth"], kept["machine"]["matrix_product_1000_s"])
        return
    product = matrix_product_seconds()
    machine = {
        "python": platform.python_version(), "numpy": np.__version__, "processor": platform.machine(),
        "cores": os.cpu_count(), "matrix_product_1000_s": product, "gflops": 2e9 / product / 1e9,
    }  # fmt: skip
    console = Console(width=170)
    console.print(
        f"one 1000 × 1000 product: {1e3 * product:.1f} ms, {machine['gflops']:.0f} Gflop/s, one thread"
    )
    kept: dict[str, Any] = {"machine": machine}
    for name, title, cases in (
        ("targets", "solve_hji, random plants, warm call", TARGETS),
        ("with_and_without", "what parity, sparsity and the second core give", WITH_AND_WITHOUT),
    ):
        rows = [measure(case) for case in cases]
        console.print(table(title, cases, rows, product))
        kept[name] = rows
    if arguments.figure:
        kept["growth"] = [measure(case) for case in GROWTH]
        figure(arguments.figure, kept["growth"], product)
        console.print(f"drawn to {arguments.figure}")
    RESULTS.parent.mkdir(exist_ok=True)
    RESULTS.write_text(json.dumps(kept, indent=1) + "\n")
    console.print(f"kept in {RESULTS}")


if __name__ == "__main__":
    main()
