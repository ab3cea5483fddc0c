"""Bandwidth of the running loop."""

from __future__ import annotations

from typing import TYPE_CHECKING

from flexhinf.designs.requirements.kinds import RequirementKind, register
from flexhinf.validation import late_package

if TYPE_CHECKING:
    import numpy as np

    from flexhinf.arrays import Vector
    from flexhinf.designs.requirements.measured import RestingLoop
else:
    np = late_package("numpy")


def bandwidths(loop: RestingLoop) -> Vector:
    """Bandwidth of each joint (n,), rad/s; 0 of an unstable loop, which has none."""
    return np.nan_to_num(loop.margins.bandwidth, nan=0.0)


register(
    RequirementKind(
        "bandwidth",
        "bandwidth",
        "where |command → link position| is 3 dB below its value at rest",
        "rad/s",
        at_most=False,
        field="bandwidth",
        searched=True,
        place=0.0,
        of_loop=bandwidths,
    )
)
