"""Distance of the links from where a move is at the same time."""

from __future__ import annotations

from flexhinf.arrays import Vector
from flexhinf.design.requirements.kinds import POSITION, Allowance, Limit, Motion, RequirementKind, register
from flexhinf.design.requirements.remaining_error import allowed as allowed_to_remain
from flexhinf.design.specification import Specification, per_joint
from flexhinf.loop.simulation import metrics

#: Default largest error on the way of a move of a workspace, as a multiple of the remaining error that is allowed.
TRACKING_TIMES = 5.0


def errors(motion: Motion) -> Vector | None:
    """Largest error of each link (n,) along a plan, rad or m; None of a step."""
    return metrics.peak_of(motion.positions - motion.planned) if motion.plans else None


def allowed(s: Specification, about: Allowance) -> Limit:
    """Of a move that rests: as stated, or `TRACKING_TIMES` the remaining error of each joint."""
    if not about.rests:
        return None
    remaining = per_joint(about.joints, "remaining_error", allowed_to_remain(s, about))
    return s.tracking_error or TRACKING_TIMES * remaining


register(
    RequirementKind(
        "tracking",
        "tracking error",
        "largest distance of a true link position from the move, of the joint nearest to its limit",
        POSITION,
        field="tracking_error",
        of_motion=errors,
        key="tracking_error",
        allowed=allowed,
    )
)
