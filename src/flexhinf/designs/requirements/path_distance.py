"""Distance of the links from the path, whenever they are there."""

from __future__ import annotations

from typing import TYPE_CHECKING

from flexhinf.designs.requirements.kinds import POSITION, RequirementKind, register
from flexhinf.designs.requirements.measured import STILL
from flexhinf.validation import late_package

if TYPE_CHECKING:
    import numpy as np

    from flexhinf.arrays import Vector
    from flexhinf.designs.requirements.measured import Motion
else:
    np = late_package("numpy")


def distances(motion: Motion) -> Vector:
    """Largest distance of each link (n,) from the nearest point of the path, rad or m."""
    from flexhinf.loop.simulation import metrics

    units = np.where(motion.largest > STILL, motion.largest, 1.0)
    return metrics.path_distance(motion.positions, motion.path, units)


register(
    RequirementKind(
        "path",
        "distance from the path",
        "largest distance of a true link position from the path, of the joint nearest to its limit",
        POSITION,
        field="path_distance",
        help="Largest distance of a link from the path, at any time: 1deg, or one per joint 1deg,2mm.",
        example="1deg",
        place=3.0,
        of_motion=distances,
        key="path_distance",
    )
)
