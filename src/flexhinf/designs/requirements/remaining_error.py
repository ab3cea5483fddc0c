"""Error of the links that remains at the end of a step or a move."""

from __future__ import annotations

from typing import TYPE_CHECKING

from flexhinf.designs.requirements.kinds import POSITION, Allowance, Limit, RequirementKind, Stating, register
from flexhinf.validation import late_package

if TYPE_CHECKING:
    import numpy as np

    from flexhinf.arrays import Vector
    from flexhinf.designs.requirements.measured import Motion
else:
    np = late_package("numpy")

#: Default of the largest remaining error, rad or m.
REMAINING_ERROR = 1e-3

#: Default remaining error of a run that ends soon after its motion, as a fraction of the joint's travel.
REMAINING_SHARE = 5e-3


def errors(motion: Motion) -> Vector | None:
    """Largest error of each link (n,) in the last 0.3 s, rad or m; None of a run that is too short."""
    from flexhinf.loop.simulation import metrics

    return metrics.remaining_error(motion.time, motion.positions, motion.planned) if motion.rests else None


def allowed(s: Stating, about: Allowance) -> Limit:
    """As stated; by default `REMAINING_ERROR`, but not less than the resolution, nor than `REMAINING_SHARE` of the
    joint's travel, of which a step of eight time constants keeps some."""
    share = 0.0 if about.rests else REMAINING_SHARE * np.asarray(about.travel)
    return REMAINING.stated(s) or np.maximum(max(REMAINING_ERROR, about.resolution), share)


REMAINING = register(
    RequirementKind(
        "remaining",
        "remaining error",
        "largest error of a true link position in the last 0.3 s, of the joint nearest to its limit",
        POSITION,
        field="remaining_error",
        help="Largest error of a link at the end of a move: 0.5e-3 (rad, m), or one per joint 0.05deg,1mm. It is "
        "looked at in the last 0.3 s, with the dead zone of the integrals.",
        example="1e-3",
        without="1e-3 rad, m, or what the sensors resolve; without dry friction 0.5 % of the travel if that is more",
        usual=True,
        place=5.0,
        of_motion=errors,
        key="remaining_error",
        allowed=allowed,
    )
)
