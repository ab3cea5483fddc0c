"""Ripple of the motors' inputs by the noise of the sensors."""

from __future__ import annotations

import numpy as np

from flexhinf.arrays import Vector
from flexhinf.design.requirements.kinds import Motion, RequirementKind, register
from flexhinf.design.specification import RIPPLE
from flexhinf.loop.simulation import metrics


def ripples(motion: Motion) -> Vector | None:
    """Standard deviation of each input (n,) at rest, per cent of its limit; NaN of a motor without one."""
    if not motion.rests:
        return None
    share = metrics.ripple(motion.time, motion.inputs, motion.effort)
    return np.where(np.isfinite(motion.effort), share, np.nan)


register(
    RequirementKind(
        "ripple",
        "ripple of the motors",
        "largest standard deviation of an input in the last 0.3 s, per cent of its limit",
        "%",
        field="ripple",
        default=RIPPLE,
        of_motion=ripples,
        key="ripple_percent",
    )
)
