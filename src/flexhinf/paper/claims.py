"""The claims of the report, in its order and in that of their work."""

from __future__ import annotations

from flexhinf.paper.estimators import BETTER_THAN_EKF, UKF
from flexhinf.paper.loop_setup import StatedClaim
from flexhinf.paper.responses import ABOUT_THE_GOAL, GAIN, STEPS_AND_TRACKING, TORQUES
from flexhinf.paper.tolerances import COIL, TOLERANCES

#: The claims in the order of the report; the last one is a question of ours.
CLAIMS: tuple[StatedClaim, ...] = (
    *STEPS_AND_TRACKING,
    COIL,
    GAIN,
    TOLERANCES,
    *TORQUES,
    *UKF,
    ABOUT_THE_GOAL,
)

#: The claims with those that take longest first.
BY_LENGTH = tuple(dict.fromkeys((TOLERANCES, GAIN, BETTER_THAN_EKF, ABOUT_THE_GOAL, *CLAIMS)))
