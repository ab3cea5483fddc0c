"""A law from a specification, tried on robots within their tolerances.

Asks for a bandwidth, a damping of the vibration and a peak voltage; prints each requirement with what was achieved. The
same on the command line, with a page of figures:

    flexhinf design paper --pose 90deg --start 0 --preset robust --bandwidth 3 --damping 0.2 --peak-voltage 60
"""

from __future__ import annotations

import numpy as np

import flexhinf as fh
from flexhinf.design import Design


def main(draws: int = 50) -> Design:
    """Design for the paper's arm, with the motor's coil in the true plant; returns the judged design."""
    robot = fh.paper_arm()  # Tables 1 and 2 with their tolerances
    specification = fh.Specification(
        pose=(np.pi / 2,),
        start=(0.0,),
        preset="robust",  # weights and noise levels that stand the largest tolerances
        bandwidth=3.0,  # rad/s
        damping=0.2,
        peak_effort=60.0,  # V
        extras=("inductance",),
        draws=draws,
        degrees=(2, 4),
        rays=500,
        compare_rigid=False,
    )
    found = fh.design(robot, specification)
    print(found.status.line)
    for line in found.requirements:
        limit = "at most" if line.at_most else "at least"
        print(f"{line.what}: {limit} {line.limit:g}, achieved {line.found:.3g} {line.unit} ({line.where})")
    return found


if __name__ == "__main__":
    main()
