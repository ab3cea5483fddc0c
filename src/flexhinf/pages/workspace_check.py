"""What the checker says of the proof.json of a workspace, for a terminal."""

from __future__ import annotations

import numpy as np

from flexhinf.certify.checker.arm import CheckedArm
from flexhinf.certify.checker.moves import CheckedMoves, MovesClaim
from flexhinf.designs.workspace.proof import PairVerdict, of_controller, proved_errors
from flexhinf.modal.pair_errors import EXACT, Errors, Sector
from flexhinf.numerals import at_least, count_text, number
from flexhinf.pages.workspace_proof import FROZEN, delay_text, errors_text, unlike_text


def pair_text(verdict: PairVerdict) -> str:
    """What the checker says of the pairs of a proof.json, and of nothing else in it."""
    if verdict.failed is not None:
        low, high = np.sqrt(verdict.failed)
        return f"Not proved: the check fails for vibrations of {number(low, 4)} to {number(high, 4)} rad/s."
    if verdict.beyond:
        return f"Not proved: the file says {verdict.beyond}, which is more than its certificate of pairs."
    if verdict.claim is None or verdict.checked is None:
        return "Not proved: this file has no certificate of pairs."
    found = verdict.checked
    low, high = np.sqrt([found.low, found.high])
    latency = count_text(verdict.claim.latency, "sample")
    filter = "no estimator" if verdict.claim.seen is None else "the estimator"
    arm = _arm_text(verdict.arm, max(found.falling, found.holding_up) > 0.0)
    return (
        f"Proved: vibrations of {number(low, 3)} to {number(high, 3)} rad/s are stable with "
        f"{errors_text(proved_errors(found))}, with {latency} of latency and {filter} of the file"
        f"{delay_text(found, verdict.claim.period)}, for motors {unlike_text(found) or 'that are alike'}, in "
        f"{count_text(found.intervals, 'interval')}. It is of {of_controller(verdict.claim.seen is not None)}. "
        f"{arm}{_checked_moves_text(verdict.moves)}"
    )


def _checked_moves_text(moves: tuple[MovesClaim, CheckedMoves] | None) -> str:
    """What the checker says of the moves of a proof.json."""
    if moves is None:
        return ""
    claim, found = moves
    rate = f"{at_least(found.rate, 3)} per second"
    text = f" Along moves they stay stable while the inertia matrix changes by less than {rate}"
    if claim.turnings:
        speeds, most = claim.turnings[0]
        together = ", ".join(at_least(found.rate / most * speed, 3) for speed in speeds.tolist())
        text += (
            f"; it does at every pose of the arm with its joints at up to ({together}) rad/s, or m/s, at once"
        )
    return f"{text} ({FROZEN})."


def _arm_text(arm: CheckedArm | None, with_slope: bool) -> str:
    """What the checker says of the arm of a proof.json; of gravity's slope where its pairs have one."""
    if arm is None:
        return "Robot, poses and hypotheses in the file are not checked."
    slope = (arm.slope or 0.0) * with_slope
    errors = Errors(Sector(arm.lower, arm.upper), EXACT, Sector(slope, slope))
    masses = f"All bodies and payloads of its arm have {errors_text(errors, True)} at every pose"
    if arm.low is None:
        return f"{masses}; the vibrations of poses and other hypotheses in the file are not checked."
    return f"{masses}, and these vibrations alone. Other hypotheses in the file are not checked."
