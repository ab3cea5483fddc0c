"""How a solution was found, as text: method, residual, conditioning, time and memory."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flexhinf.hinf.recursion import DegreeRecord
from flexhinf.hinf.value_function import ValueFunction
from flexhinf.polynomial.basis import count
from flexhinf.polynomial.homological import HOPELESS

__all__ = ["solution_report"]


def solution_report(
    solution: ValueFunction, records: Sequence[DegreeRecord], condition: float, memory: int
) -> str:
    """Method, measured residual and time by degree; conditioning and memory of the whole."""
    n, md, m, s = solution.expansion.size
    total = sum(count(n, record.degree) for record in records)
    seconds = sum(record.seconds for record in records)
    sizes = (n, "state"), (md, "disturbance"), (m, "input"), (s, "penalised output")
    lines = [
        f"{_equation(solution)}, {', '.join(_counted(*size) for size in sizes)}",
        f"{_level(solution)}; V to degree {solution.degree}, the law to degree {solution.degree - 1}",
        "",
        f"{'degree':>6}  {'coefficients':>12}  {'method':<19}  {'relative residual':>17}  {'time':>8}",
        *(_row(n, record) for record in records),
        f"{'total':>6}  {total:>12}  {'':<19}  {'':>17}  {_time(seconds):>8}",
        "",
    ]
    if not np.isnan(condition):
        lines += _conditioning(solution.degree, condition)
    lines += [f"memory: about {_size(memory)} at the peak, estimated before the solve"]
    return "\n".join(lines)


def _equation(solution: ValueFunction) -> str:
    kind = "Isaacs" if np.isfinite(solution.gamma) else "Bellman"
    return f"Hamilton–Jacobi–{kind} equation"


def _level(solution: ValueFunction) -> str:
    if not np.isfinite(solution.gamma):
        return "gamma = inf: no disturbance"
    star = solution.gamma_star
    ratio = f" = {solution.gamma / star:.4g} gamma*" if star > 0 else ""
    return f"gamma = {solution.gamma:.10g}{ratio}, gamma* = {star:.10g}"


def _counted(number: int, name: str) -> str:
    return f"{number} {name}" + ("" if number == 1 else "s")


def _row(n: int, record: DegreeRecord) -> str:
    solved = record.method != "zero by parity"
    residual, time = (f"{record.residual:.1e}", _time(record.seconds)) if solved else ("–", "–")
    return (
        f"{record.degree:>6}  {count(n, record.degree):>12}  {record.method:<19}  {residual:>17}  {time:>8}"
    )


def _conditioning(degree: int, condition: float) -> list[str]:
    """Why the method was chosen; the error of the eigenbasis before refinement is about cond(T)^k ε."""
    growth = condition**degree * np.finfo(float).eps
    return [
        f"closed loop: cond(T) = {condition:.3g} for its eigenvectors in scaled states, "
        f"cond(T)^{degree} eps = {growth:.1e}",
        f"             (eigenbasis up to {HOPELESS:g} and where its residual is at rounding, Schur otherwise)",
    ]


def _time(seconds: float) -> str:
    return f"{seconds:.2f} s" if seconds >= 1 else f"{1e3 * seconds:.2f} ms"


def _size(memory: int) -> str:
    if memory >= 1e9:
        return f"{memory / 1e9:.2f} GB"
    return f"{memory / 1e6:.1f} MB" if memory >= 1e6 else f"{memory / 1e3:.1f} kB"
