"""Errors of masses by proof and by search: ``python -m benchmarks.workspace.masses`` writes a row for each robot.

The law is the one that a design tries first, with the true state and one sample of latency. All errors are those of the
inverse inertia matrix of the links, in the coordinates of its square root and over all vibrations, so that the columns
can be compared: without Popov's multiplier (small gain), with it, proved, and found to destabilise.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.workspace.arm import LATENCY, PERIOD
from benchmarks.workspace.gamma import POSES, SEED
from benchmarks.workspace.robots import ROBOTS
from benchmarks.workspace.rows import kept, make_missing
from flexhinf.certify.checker.pairs import CheckedPairs, check_pairs, pair_claim
from flexhinf.design import Specification
from flexhinf.design.workspace.masses import stated_errors
from flexhinf.design.workspace.pair_proof import largest_certificate
from flexhinf.design.workspace.search import BANDWIDTHS, RANDOM, pair_weights
from flexhinf.design.workspace.setup import WorkspaceSetup
from flexhinf.modal import ModalLaw
from flexhinf.modal.popov import SYMMETRIC, SampledPairs, small_gain_tolerance
from flexhinf.modal.unstable import smallest_unstable
from flexhinf.plant import Penalty
from flexhinf.robot import Robot
from flexhinf.robot.workspace import workspace_of

__all__ = ["pairs_of", "row", "table"]


def pairs_of(robot: Robot) -> tuple[ModalLaw, SampledPairs]:
    """The law that a design tries first, and its sampled pairs."""
    problem = robot.problem(penalty=Penalty({"link_position": 1.0}))
    sampled = workspace_of(robot).sample(POSES, SEED)
    law = ModalLaw.tuned(problem, PERIOD, pair_weights(robot, BANDWIDTHS[0]), sampled)
    return law, SampledPairs(law.gains, LATENCY)


def row(robot: Robot) -> dict[str, Any]:
    """Errors as shares, and CPU seconds of the search and of the check."""
    law, pairs = pairs_of(robot)
    begun = time.process_time()
    tolerance, numbers = largest_certificate(pairs, SYMMETRIC, lambda text: None)
    searched = time.process_time()
    checked = None if numbers is None else check_pairs(pair_claim(numbers))
    done = time.process_time()
    proved = checked if isinstance(checked, CheckedPairs) else None
    found = smallest_unstable(pairs, len(robot.joint_names) > 1)
    setup = WorkspaceSetup(robot, Specification(), workspace_of(robot), law, RANDOM[0])
    stated = stated_errors(setup)
    return {
        "small_gain": small_gain_tolerance(pairs).masses.lower,
        "grid": tolerance.errors.masses.lower,
        "proved": None if proved is None else proved.lower,
        "intervals": None if proved is None else proved.intervals,
        "rate": None if proved is None else proved.rate,
        "found": found.size,
        "rates": np.sqrt(found.links).tolist(),
        "radius": found.radius,
        "stated": [*stated.errors.masses],
        "poses": stated.poses,
        "search": searched - begun,
        "check": done - searched,
    }


def table(folder: Path) -> str:
    """The errors of each robot."""
    heads = (
        "small gain, before",
        "grid",
        "proved",
        "found, with the pole",
        "proved / found",
        "the file needs",
        "CPU",
    )
    lines = [f"| robot | {' | '.join(heads)} |", "|---" * (1 + len(heads)) + "|"]
    for robot in ROBOTS:
        if (one := kept(folder, f"{robot}.masses")) is not None:
            proved = one["proved"] or 0.0
            at = " and ".join(f"{rate:.0f}" for rate in one["rates"])
            needs = ", ".join(f"{sign}{100 * size:.1f}" for sign, size in zip("−+", one["stated"]))
            where = f"{one['poses']} sampled poses" if one["poses"] else "by the form of M"
            lines.append(
                f"| {robot} | {100 * one['small_gain']:.2g} % | {100 * one['grid']:.0f} % | {100 * proved:.0f} % | "
                f"{100 * one['found']:.0f} % at {at} rad/s, {one['radius']:.6f} | {proved / one['found']:.2f} | "
                f"{needs} % ({where}) | {one['search']:.0f} s, check {one['check']:.0f} s |"
            )
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(make_missing("masses", row))
