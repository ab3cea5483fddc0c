"""How a solution was found, as text: method, residual, conditioning, time and memory."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flexhinf.hinf.accuracy import DOUBTFUL
from flexhinf.hinf.recursion import DegreeRecord
from flexhinf.hinf.value_function import ValueFunction
from flexhinf.polynomial.basis import count
from flexhinf.polynomial.homological import HOPELESS


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
        _columns("degree", "coefficients", "method", "relative residual", "error about", "time"),
        *(_row(n, record) for record in records),
        _columns("total", total, "", "", "", _time(seconds)),
        "",
        *_warning(records),
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
    if star == 0:
        return f"gamma = {solution.gamma:.10g}, gamma* = 0"
    excess = solution.gamma / star - 1
    ratio = f"{1 + excess:.4g}" if abs(excess) >= 1e-3 else f"(1 + {excess:.1e})"
    return f"gamma = {solution.gamma:.10g} = {ratio} gamma*, gamma* = {star:.10g}"


def _counted(number: int, name: str) -> str:
    return f"{number} {name}" + ("" if number == 1 else "s")


def _row(n: int, record: DegreeRecord) -> str:
    solved = record.method != "zero by parity"
    residual = f"{record.residual:.1e}" if solved else "–"
    error = f"{record.error:.1e}" if solved and not np.isnan(record.error) else "–"
    time = _time(record.seconds) if solved else "–"
    return _columns(record.degree, count(n, record.degree), record.method, residual, error, time)


def _columns(degree: object, size: object, method: str, residual: str, error: str, time: str) -> str:
    return f"{degree:>6}  {size:>12}  {method:<19}  {residual:>17}  {error:>11}  {time:>8}"


def _warning(records: Sequence[DegreeRecord]) -> list[str]:
    """Which degrees hold few digits, and what to do."""
    doubtful = [record for record in records if record.error > DOUBTFUL]
    if not doubtful:
        return []
    worst = max(doubtful, key=lambda record: record.error)
    degrees = ", ".join(str(record.degree) for record in doubtful)
    return [
        f"warning: few digits are determined by the data in degree {degrees}: in degree {worst.degree}",
        f"         each holds to about {worst.error:.0e} of the largest; a gamma further above gamma* gives more",
        "",
    ]


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
