"""Error of the links that remains at the end of a step or a move."""

from __future__ import annotations

import numpy as np

from flexhinf.arrays import Vector
from flexhinf.design.requirements.kinds import POSITION, Allowance, Limit, Motion, RequirementKind, register
from flexhinf.design.specification import REMAINING_ERROR, Specification
from flexhinf.loop.simulation import metrics

#: Default remaining error of a run that ends soon after its motion, as a fraction of the joint's travel.
REMAINING_SHARE = 5e-3


def errors(motion: Motion) -> Vector | None:
    """Largest error of each link (n,) in the last 0.3 s, rad or m; None of a run that is too short."""
    return metrics.remaining_error(motion.time, motion.positions, motion.planned) if motion.rests else None


def allowed(s: Specification, about: Allowance) -> Limit:
    """As stated; by default `REMAINING_ERROR`, but not less than the resolution, nor than `REMAINING_SHARE` of the
    joint's travel, of which a step of eight time constants keeps some."""
    share = 0.0 if about.rests else REMAINING_SHARE * np.asarray(about.travel)
    return s.remaining_error or np.maximum(max(REMAINING_ERROR, about.resolution), share)


register(
    RequirementKind(
        "remaining",
        "remaining error",
        "largest error of a true link position in the last 0.3 s, of the joint nearest to its limit",
        POSITION,
        field="remaining_error",
        of_motion=errors,
        key="remaining_error",
        allowed=allowed,
    )
)
