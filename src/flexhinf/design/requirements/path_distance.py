"""Distance of the links from the path, whenever they are there."""

from __future__ import annotations

import numpy as np

from flexhinf.arrays import Vector
from flexhinf.design.requirements.kinds import POSITION, STILL, Motion, RequirementKind, register
from flexhinf.loop.simulation import metrics


def distances(motion: Motion) -> Vector:
    """Largest distance of each link (n,) from the nearest point of the path, rad or m."""
    units = np.where(motion.largest > STILL, motion.largest, 1.0)
    return metrics.path_distance(motion.positions, motion.path, units)


register(
    RequirementKind(
        "path",
        "distance from the path",
        "largest distance of a true link position from the path, of the joint nearest to its limit",
        POSITION,
        field="path_distance",
        of_motion=distances,
        key="path_distance",
    )
)
