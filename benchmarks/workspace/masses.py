"""Errors of masses by proof and by search: ``python -m benchmarks.workspace.masses`` writes a row for each robot.

The law is the one that a design tries first, with the true state and one sample of latency. All errors are those of the
inverse inertia matrix of the links, in the coordinates of its square root and over all vibrations, so that the columns
can be compared: without Popov's multiplier (small gain), with it, proved, and found to destabilise. A second row has
the same of the stiffness alone, and what is shown of the file's robots at every pose.
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
from flexhinf.certify.checker.pair_claim import pair_claim
from flexhinf.certify.checker.pairs import CheckedPairs, check_pairs
from flexhinf.designs import Specification
from flexhinf.designs.workspace.everywhere import everywhere
from flexhinf.designs.workspace.masses import stated_errors
from flexhinf.designs.workspace.pair_proof import largest_certificate
from flexhinf.designs.workspace.proof import proved_errors
from flexhinf.designs.workspace.search import BANDWIDTHS, RANDOM, pair_weights
from flexhinf.designs.workspace.setup import WorkspaceSetup
from flexhinf.modal import ModalLaw
from flexhinf.modal.multipliers import small_gain_tolerance
from flexhinf.modal.pair_errors import EXACT, SYMMETRIC, Errors, Sector
from flexhinf.modal.sampled_pairs import SampledPairs
from flexhinf.modal.unstable import smallest_unstable
from flexhinf.numerals import at_most
from flexhinf.plant import Penalty
from flexhinf.robot import Robot
from flexhinf.robot.workspace import workspace_of

__all__ = ["pairs_of", "row", "springs_row", "table"]


def pairs_of(robot: Robot) -> tuple[ModalLaw, SampledPairs]:
    """The law that a design tries first, and its sampled pairs."""
    problem = robot.problem(penalty=Penalty({"link_position": 1.0}))
    sampled = workspace_of(robot).sample(POSES, SEED)
    law = ModalLaw.tuned(problem, PERIOD, pair_weights(robot, BANDWIDTHS[0]), sampled)
    return law, SampledPairs(law.gains, LATENCY)


def row(robot: Robot) -> dict[str, Any]:
    """Errors as shares, and CPU seconds of the search and of the check."""
    law, pairs = pairs_of(robot)
    small_gain = small_gain_tolerance(pairs).masses.lower
    setup = WorkspaceSetup(robot, Specification(), workspace_of(robot), law, RANDOM[0])
    stated = stated_errors(setup)
    others = {"stated": [*stated.errors.masses], "poses": stated.poses}
    return {"small_gain": small_gain, **_limits(robot, pairs, SYMMETRIC), **others}


def _limits(robot: Robot, pairs: SampledPairs, shape: Errors) -> dict[str, Any]:
    """How large errors of a shape are that a grid tolerates, that are proved, and that are found to destabilise."""
    begun = time.process_time()
    tolerance, numbers = largest_certificate(pairs, shape, lambda text: None)
    searched = time.process_time()
    checked = None if numbers is None else check_pairs(pair_claim(numbers))
    done = time.process_time()
    proved = checked if isinstance(checked, CheckedPairs) else None
    found = smallest_unstable(pairs, len(robot.joint_names) > 1, of_springs=shape.of_springs_alone)
    return {
        "grid": tolerance.errors.largest,
        "proved": None if proved is None else proved_errors(proved).largest,
        "intervals": None if proved is None else proved.intervals,
        "rate": None if proved is None else proved.rate,
        "found": found.size,
        "rates": np.sqrt(found.links).tolist(),
        "radius": found.radius,
        "search": searched - begun,
        "check": done - searched,
    }


def springs_row(robot: Robot) -> dict[str, Any]:
    """The same of errors of the stiffness alone; and the file's masses at every pose."""
    law, pairs = pairs_of(robot)
    setup = WorkspaceSetup(robot, Specification(), workspace_of(robot), law, RANDOM[0])
    everywhere_found = everywhere(setup, Sector(0.9, 9.0), pairs.gains.ends)
    arm = None if everywhere_found is None else everywhere_found.checked._asdict()
    return {**_limits(robot, pairs, Errors(EXACT, Sector(1.0, 1.0))), "everywhere": arm}


def _cost(row: dict[str, Any]) -> str:
    return f"{row['search']:.0f} s, check {row['check']:.0f} s"


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
        "springs: proved, found, ratio",
        "CPU",
    )
    lines = [f"| robot | {' | '.join(heads)} |", "|---" * (1 + len(heads)) + "|"]
    for robot in ROBOTS:
        if (one := kept(folder, f"{robot}.masses")) is not None:
            proved = one["proved"] or 0.0
            at = " and ".join(f"{rate:.0f}" for rate in one["rates"])
            needs = ", ".join(f"{sign}{100 * size:.1f}" for sign, size in zip("−+", one["stated"]))
            where = f"{one['poses']} sampled poses" if one["poses"] else "by the form of M"
            springs = "not measured | –"
            if (other := kept(folder, f"{robot}.springs")) is not None:
                stiffness, size = other["proved"] or 0.0, other["found"]
                springs = (
                    f"{100 * stiffness:.0f} %, {100 * size:.0f} %, {stiffness / size:.2f} | {_cost(other)}"
                )
                if (arm := other["everywhere"]) is not None:
                    needs = ", ".join(
                        f"{sign}{at_most(100.0 * arm[end], 3)}" for sign, end in zip("−+", ("lower", "upper"))
                    )
                    where = "every pose" if arm["low"] is None else "every pose, all vibrations"
            lines.append(
                f"| {robot} | {100 * one['small_gain']:.2g} % | {100 * one['grid']:.0f} % | {100 * proved:.0f} % | "
                f"{100 * one['found']:.0f} % at {at} rad/s, {one['radius']:.6f} | {proved / one['found']:.2f} | "
                f"{needs} % ({where}) | {_cost(one)} | {springs} |"
            )
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(make_missing("masses", row) or make_missing("springs", springs_row))
