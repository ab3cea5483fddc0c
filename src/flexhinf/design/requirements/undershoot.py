"""Motion of a link the wrong way, such as that of a heavy arm that is started by its motor."""

from __future__ import annotations

import numpy as np

from flexhinf.arrays import Vector
from flexhinf.design.requirements.kinds import Motion, RequirementKind, register
from flexhinf.design.specification import UNDERSHOOT
from flexhinf.loop.simulation import metrics


def wrong_way(motion: Motion) -> Vector:
    """How far each link (n,) leaves the range of its command, per cent; NaN of a joint that does not travel."""
    travel = np.maximum(motion.travel, metrics.MIN_TRAVEL * motion.largest)
    columns = zip(motion.moves, motion.positions.T, motion.path.T, travel)
    return np.array([metrics.wrong_way(q, path, way) if moves else np.nan for moves, q, path, way in columns])


register(
    RequirementKind(
        "undershoot",
        "motion the wrong way",
        "how far a link leaves the range of its command on the start's side, per cent of its travel",
        "%",
        field="undershoot",
        default=UNDERSHOOT,
        of_motion=wrong_way,
        key="wrong_way_percent",
    )
)
