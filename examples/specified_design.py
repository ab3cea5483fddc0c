"""A law from a specification, tried on robots within their tolerances.

Asks for a bandwidth, a damping of the vibration and a peak voltage; prints what was asked and what was found. The
same on the command line, with a page of figures:

    flexhinf design paper --goal 90deg --from-pose 0 --preset robust --bandwidth 3 --damping 0.2 --peak-voltage 60
"""

from __future__ import annotations

import numpy as np

import flexhinf as fh
from flexhinf.design import Design, Specification, design


def main(draws: int = 50) -> Design:
    """Design for the paper's arm, with the motor's coil in the true plant; returns everything that was found."""
    robot = fh.paper_arm()  # Tables 1 and 2 with their tolerances
    asked = Specification(
        pose=[np.pi / 2],
        start=[0.0],
        preset="robust",  # every tolerance a disturbance channel
        bandwidth=3.0,  # rad/s
        damping=0.2,
        peak_effort=60.0,  # V
        extras=("inductance",),
        draws=draws,
        degrees=(2, 4),
        rays=500,
        compare_rigid=False,
    )
    found = design(robot, asked)
    for line in found.met:
        limit = "at most" if line.at_most else "at least"
        print(f"{line.what}: {limit} {line.asked:g}, found {line.found:.3g} {line.unit} ({line.where})")
    tolerances = found.tolerances
    assert tolerances is not None
    print(
        f"unstable at the worst R^v: {tolerances.unstable_anywhere} of {len(tolerances.population)} corners"
    )
    return found


if __name__ == "__main__":
    main()
