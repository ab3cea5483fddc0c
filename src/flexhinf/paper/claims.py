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

#: What the paper says and no claim here judges, and why.
NOT_JUDGED = (
    (
        "Secs. 1–2, 5–7: the equations and the loop of n links (Figs. 1 and 2)",
        "the single link of Sec. 6 is computed alone; the paper has no numbers of another arm",
    ),
    (
        "Sec. 1: feedback linearisation is not useful for elastic joints",
        "it is no part of the paper's figures; `flexhinf compare paper --pose 90deg --laws flatness-i` runs one",
    ),
    (
        "Sec. 1: a rigid model does not allow fine control, and a linear Kalman filter is not convenient",
        "neither is run here; `flexhinf design` and `flexhinf compare` (lqg) run both",
    ),
    (
        "Abstract, Secs. 1, 4 and 7: the UKF has a lower bias than the EKF, whose bias forbids high precision",
        "RMS errors are judged; the bias, a mean over many runs, is not",
    ),
    (
        "Sec. 4: the UKF suits work points farther from x = 0",
        "its errors are not judged by the distance from x = 0",
    ),
    ("Sec. 4: the UKF needs no derivatives", "a property of Algorithm 1; nothing depends on it"),
    (
        "Sec. 3: stability and attenuation on a neighbourhood of x = 0",
        "runs, searches and growth rates are looked at; nothing is proved, see `flexhinf certify`",
    ),
    ("Figs. 3–12: the printed curves", "the scan has none; what is said about them is judged"),
)

#: The claims with those that take longest first.
BY_LENGTH = tuple(dict.fromkeys((TOLERANCES, GAIN, BETTER_THAN_EKF, ABOUT_THE_GOAL, *CLAIMS)))
