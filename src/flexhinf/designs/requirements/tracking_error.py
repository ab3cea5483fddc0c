"""Distance of the links from where a move is at the same time."""

from __future__ import annotations

from typing import TYPE_CHECKING

from flexhinf.designs.requirements.kinds import POSITION, Allowance, Limit, RequirementKind, Stating, register
from flexhinf.designs.requirements.remaining_error import REMAINING
from flexhinf.validation import late_package

if TYPE_CHECKING:
    import numpy as np

    from flexhinf.arrays import Vector
    from flexhinf.designs.requirements.measured import Motion
else:
    np = late_package("numpy")

#: Default largest error on the way of a move of a workspace, as a multiple of the remaining error that is allowed.
TRACKING_TIMES = 5.0


def errors(motion: Motion) -> Vector | None:
    """Largest error of each link (n,) along a plan, rad or m; None of a step."""
    from flexhinf.loop.simulation import metrics

    return metrics.peak_of(motion.positions - motion.planned) if motion.plans else None


def allowed(s: Stating, about: Allowance) -> Limit:
    """Of a move that rests: as stated, or `TRACKING_TIMES` the remaining error of each joint."""
    if not about.rests:
        return None
    if stated := TRACKING.stated(s):
        return stated
    remaining = np.atleast_1d(np.asarray(REMAINING.limit(s, about), dtype=float))
    # A remaining error that does not fit the joints is refused as such, where it is judged itself.
    return TRACKING_TIMES * remaining if len(remaining) in (1, len(about.joints)) else None


TRACKING = register(
    RequirementKind(
        "tracking",
        "tracking error",
        "largest distance of a true link position from the move, of the joint nearest to its limit",
        POSITION,
        field="tracking_error",
        help="Largest distance of a link from where the move is at the same time: 1deg, or one per joint 1deg,2mm.",
        example="0.5deg",
        without="5 % of the joint's way along the move; in a workspace 5 times the remaining error",
        usual=True,
        place=4.0,
        of_motion=errors,
        key="tracking_error",
        allowed=allowed,
    )
)
