"""Motion of a link the wrong way, such as that of a heavy arm that is started by its motor."""

from __future__ import annotations

from typing import TYPE_CHECKING

from flexhinf.designs.requirements.kinds import RequirementKind, register
from flexhinf.validation import late_package

if TYPE_CHECKING:
    import numpy as np

    from flexhinf.arrays import Vector
    from flexhinf.designs.requirements.measured import Motion
else:
    np = late_package("numpy")

#: Default of the largest motion the wrong way, per cent of the travel.
UNDERSHOOT = 5.0


def wrong_way(motion: Motion) -> Vector:
    """How far each link (n,) leaves the range of its command, per cent; NaN of a joint that does not travel."""
    from flexhinf.loop.simulation import metrics

    travel = np.maximum(motion.travel, metrics.MIN_TRAVEL * motion.largest)
    columns = zip(motion.moves, motion.positions.T, motion.path.T, travel)
    return np.array([metrics.wrong_way(q, path, way) if moves else np.nan for moves, q, path, way in columns])


register(
    RequirementKind(
        "undershoot",
        "motion the wrong way",
        "how far a link leaves the range of its command on the start's side, per cent of its travel",
        "%",
        help="Largest motion of a link the wrong way, in per cent of its travel. Where a link travels little, 5 % of "
        "the largest travel counts instead.",
        example="2",
        default=UNDERSHOOT,
        place=2.0,
        of_motion=wrong_way,
        key="wrong_way_percent",
    )
)
