"""The smallest weights on the other states that make a failing claim hold.

The paper's penalty (11) leaves x2, x3 and x4 free. They get the weights s (9, 30, 9), as in `repair`; 60 x1
and 300 x5 stay.
"""

from __future__ import annotations

from collections.abc import Callable

from flexhinf.errors import FlexhinfError
from flexhinf.hinf import HJISolution
from flexhinf.paper.bench import PaperBench
from flexhinf.paper.claims.repair import DIRECTION, LARGEST, SMALLEST, scaled_weights
from flexhinf.paper.claims.smallest import smallest_change

__all__ = ["NOT_BY_THE_PENALTY", "damped_law", "repair_by_damping"]

NOT_BY_THE_PENALTY = (
    "no change of the penalty: the law does not enter here, only the estimator's model and noise do."
)


def damped_law(bench: PaperBench, scale: float, degree: int | None = None) -> HJISolution:
    """NL-H∞ for the paper's weights and s (9, 30, 9) on x2, x3, x4, at the same ratio of its own γ*."""
    return bench.law(scaled_weights(bench, scale), degree=degree)


def repair_by_damping(bench: PaperBench, holds: Callable[[float], bool]) -> str:
    """The smallest s, to one per cent, for which `holds(s)`; in words, also if there is none."""

    def safe(scale: float) -> bool:
        try:
            return holds(scale)
        except FlexhinfError:
            return False

    scale = SMALLEST if safe(SMALLEST) else smallest_change(safe, SMALLEST, LARGEST)
    names = "weights s (9, 30, 9) on x2, x3, x4"
    if scale is None:
        return f"no {names} with s up to {LARGEST:g} at these settings."
    w = [scale * DIRECTION[name] for name in ("link_velocity", "motor_position", "motor_velocity")]
    return f"{names}, smallest s by bisection {scale:.3g}: ({w[0]:.3g}, {w[1]:.3g}, {w[2]:.3g})."
