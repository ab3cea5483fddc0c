"""What γ buys the law for the workspace: ``python -m benchmarks.workspace.gamma`` writes a row for each robot.

The law of pairs that a design tries first, for several γ, as multiples of γ*, up to the LQR (γ = ∞): the errors of the
model's accelerations that small gain covers (`flexhinf.modal.tolerance`), with the state known and over one sample of
latency, and the damping of the sampled pairs.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.workspace.arm import LATENCY, PERIOD
from benchmarks.workspace.robots import ROBOTS
from benchmarks.workspace.rows import kept, make_missing
from flexhinf.designs.workspace.search import BANDWIDTHS, pair_weights
from flexhinf.modal import ModalLaw
from flexhinf.modal.tolerance import tolerated_error
from flexhinf.plant import Penalty
from flexhinf.robot.workspace import workspace_of

__all__ = ["GAMMAS", "row", "table"]

#: Multiples of γ*; poses by which the range of λ is found, and their seed.
GAMMAS = (1.2, 1.5, 2.0, 4.0, np.inf)
POSES, SEED = 500, 17


def row(robot: Any, gammas: tuple[float, ...] = GAMMAS, poses: int = POSES) -> dict[str, Any]:
    """Tolerances, in parts of the accelerations, and damping, for each γ."""
    problem = robot.problem(penalty=Penalty({"link_position": 1.0}))
    sampled, found = workspace_of(robot).sample(poses, SEED), []
    for gamma in gammas:
        gains = ModalLaw.tuned(problem, PERIOD, pair_weights(robot, BANDWIDTHS[0], gamma), sampled).gains
        one = {"gamma": gamma if np.isfinite(gamma) else None, "damping": gains.sweep[1]}
        found.append(one | {"known": tolerated_error(gains), "late": tolerated_error(gains, latency=LATENCY)})
    return {"bandwidth": BANDWIDTHS[0], "laws": found}


def table(folder: Path) -> str:
    """Tolerances of each robot by γ."""
    rows = {robot: kept(folder, f"{robot}.gamma") for robot in ROBOTS}
    heads = [f"{gamma:g} γ\\*" if np.isfinite(gamma) else "∞ (LQR)" for gamma in GAMMAS]
    lines = [f"| robot | {' | '.join(heads)} |", "|---" * (1 + len(heads)) + "|"]
    for robot, found in rows.items():
        if found is not None:
            cells = (
                f"{100 * one['known']:.1f} %, {100 * one['late']:.1f} %; {one['damping']:.2f}"
                for one in found["laws"]
            )
            lines.append(f"| {robot} | {' | '.join(cells)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(make_missing("gamma", row))
