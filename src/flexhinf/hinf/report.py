"""The solver's account of itself."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from flexhinf.polynomial.basis import count

if TYPE_CHECKING:
    from flexhinf.hinf.solution import HJISolution

__all__ = ["solution_report"]


def solution_report(solution: HJISolution) -> str:
    """Method, measured residual and time by degree; conditioning and memory of the whole."""
    n, md, m, s = solution.expansion.size
    kind = "Hamilton–Jacobi–Isaacs" if np.isfinite(solution.gamma) else "Hamilton–Jacobi–Bellman"
    lines = [
        f"{kind} equation, {n} states, {md} disturbances, {m} inputs, {s} penalised outputs",
        f"gamma {solution.gamma:.10g}, V to degree {solution.degree}, the law to {solution.degree - 1}",
        "",
        f"{'degree':>6}  {'coefficients':>12}  {'method':<20}  {'relative residual':>17}  {'seconds':>9}",
    ]
    lines += [
        f"{record.degree:>6}  {count(n, record.degree):>12}  {record.method:<20}  "
        f"{record.residual:>17.1e}  {record.seconds:>9.4f}"
        for record in solution.records
    ]
    lines += [
        "",
        f"condition number of the closed loop's eigenvectors (scaled states): {solution.condition:.3g}",
        f"memory estimate: {solution.memory / 1e6:.3g} MB",
    ]
    return "\n".join(lines)
