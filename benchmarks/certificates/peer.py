"""Semidefinite programs by cvxpy and Clarabel, in an environment of their own: one line of JSON for each.

A program has free numbers y and symmetric matrices Q_k ⪰ 0, an objective that is linear in y, and sparse equations
A y + Σ_k B_k (upper triangle of Q_k) = b. Nothing of flexhinf is imported.
"""

from __future__ import annotations

import json
import resource
import sys
import time
from typing import Any

import clarabel  # pyright: ignore[reportMissingImports]
import cvxpy as cp  # pyright: ignore[reportMissingImports]
import numpy as np
from scipy.sparse import csc_array

#: Clarabel's own tolerances are 1e-8; these leave less to the rounding that follows.
SETTINGS = {"tol_gap_abs": 1e-9, "tol_gap_rel": 1e-9, "tol_feas": 1e-9, "max_iter": 200}


def solve(program: dict[str, Any]) -> dict[str, Any]:
    """Status, y, matrices, and CPU seconds with and without what cvxpy does before Clarabel starts."""
    start = time.process_time()
    y = cp.Variable(max(program["free"], 1))
    matrices = [cp.Variable((size, size), PSD=True) for size in program["sizes"]]
    rows, (at, columns, values) = len(program["right"]), program["linear"]
    total = csc_array((values, (at, columns)), shape=(rows, y.size)) @ y
    for matrix, size, (at, i, j, values) in zip(matrices, program["sizes"], program["quadratic"]):
        places = np.array(i, dtype=int) + size * np.array(j, dtype=int)
        total = total + csc_array((values, (at, places)), shape=(rows, size * size)) @ cp.vec(
            matrix, order="F"
        )
    cost = np.zeros(y.size)
    cost[: program["free"]] = program["objective"]
    problem = cp.Problem(cp.Minimize(cost @ y), [total == np.array(program["right"])])
    try:
        problem.solve(solver="CLARABEL", **SETTINGS)
    except cp.SolverError as reason:
        return {"status": f"solver error: {reason}", "seconds": time.process_time() - start}
    found = {"status": problem.status, "seconds": time.process_time() - start}
    if y.value is not None:
        found |= {"y": y.value[: program["free"]].tolist(), "matrices": [q.value.tolist() for q in matrices]}
    return found


def main() -> None:
    """Answer until there is nothing more to read."""
    print(json.dumps({"cvxpy": cp.__version__, "clarabel": clarabel.__version__}), flush=True)
    for line in sys.stdin:
        memory = {"megabytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0}
        answer = solve(json.loads(line))
        memory["megabytes"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
        print(json.dumps(answer | memory), flush=True)


if __name__ == "__main__":
    main()
