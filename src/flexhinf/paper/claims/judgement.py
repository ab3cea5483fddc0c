"""A judged claim with what shows it, and the smallest change of a design that makes a failed claim hold.

The paper's penalty (11) leaves x2, x3 and x4 free, and with them the joint's vibration. Most repairs give them the
weights s (9, 30, 9), under which a motion at 3.3 rad/s, about the bandwidth of the loop, counts alike as position and
as velocity; 60 x1 and 300 x5 stay.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from flexhinf.errors import FlexhinfError
from flexhinf.hinf import HJISolution
from flexhinf.paper.loop_setup import PaperSetup
from flexhinf.report import Claim

#: What s multiplies, by state.
DAMPING_WEIGHTS = {"link_velocity": 9.0, "motor_position": 30.0, "motor_velocity": 9.0}

#: Where the search for s begins and ends.
SMALLEST_SCALE, LARGEST_SCALE = 0.05, 12.8

#: Relative width at which the bisection stops.
TOLERANCE = 0.01

NOT_BY_THE_PENALTY = (
    "no change of the penalty: the law does not enter here, only the estimator's model and noise do."
)


@dataclass(frozen=True)
class Judged:
    """A claim with its verdict, the tables and figures that show it, and numbers for ``metrics.json``.

    Attributes
    ----------
    blocks : tuple of blocks of a report
    ours : bool
        Whether the question is ours; otherwise the claim is the paper's.
    """

    claim: Claim
    blocks: tuple[Any, ...] = ()
    numbers: dict[str, Any] = field(default_factory=dict)
    ours: bool = False


def smallest_change(
    holds: Callable[[float], bool], start: float, limit: float, factor: float = 2.0
) -> float | None:
    """Smallest value above `start` for which `holds`, to one per cent; None if there is none up to `limit`.

    The value is first multiplied by `factor` until the claim holds, then bisected between the last two: the smallest
    one if the claim, once it holds, goes on holding.
    """
    low, high = start, start * factor
    while not holds(high):
        low, high = high, high * factor
        if low >= limit:
            return None
    while high - low > TOLERANCE * high:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if holds(middle) else (middle, high)
    return high


def scaled_weights(setup: PaperSetup, scale: float) -> dict[str, float]:
    """The paper's weights by state, with s (9, 30, 9) on x2, x3, x4."""
    names = setup.problem.state_names
    penalty = setup.arm.penalty
    assert penalty is not None  # the paper's arm has its own
    own = dict(zip(names, penalty.weights(names), strict=True))
    return {name: float(own[name] + scale * DAMPING_WEIGHTS.get(name, 0.0)) for name in names}


def damped_law(setup: PaperSetup, scale: float, degree: int | None = None) -> HJISolution:
    """NL-H∞ for the paper's weights and s (9, 30, 9) on x2, x3, x4, at the same ratio of its own γ*."""
    return setup.law(scaled_weights(setup, scale), degree=degree)


def repair_by_damping(setup: PaperSetup, holds: Callable[[float], bool]) -> str:
    """The smallest s, to one per cent, for which `holds(s)`, as a sentence; also if there is none."""

    def safe(scale: float) -> bool:
        try:
            return holds(scale)
        except FlexhinfError:
            return False

    found = SMALLEST_SCALE if safe(SMALLEST_SCALE) else smallest_change(safe, SMALLEST_SCALE, LARGEST_SCALE)
    names = "weights s (9, 30, 9) on x2, x3, x4"
    if found is None:
        return f"no {names} with s up to {LARGEST_SCALE:g} at these settings."
    w = [found * weight for weight in DAMPING_WEIGHTS.values()]
    return f"{names}, smallest s by bisection {found:.3g}: ({w[0]:.3g}, {w[1]:.3g}, {w[2]:.3g})."
