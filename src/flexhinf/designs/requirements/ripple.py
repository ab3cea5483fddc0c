"""Ripple of the motors' inputs by the noise of the sensors."""

from __future__ import annotations

from typing import TYPE_CHECKING

from flexhinf.designs.requirements.kinds import RequirementKind, register
from flexhinf.validation import late_package

if TYPE_CHECKING:
    import numpy as np

    from flexhinf.arrays import Vector
    from flexhinf.designs.requirements.measured import Motion
else:
    np = late_package("numpy")

#: Default of the largest ripple of a motor's input, per cent of its limit.
RIPPLE = 5.0


def ripples(motion: Motion) -> Vector | None:
    """Standard deviation of each input (n,) at rest, per cent of its limit; NaN of a motor without one."""
    from flexhinf.loop.simulation import metrics

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
        help="Largest ripple of a motor's input by noise: standard deviation in per cent of its limit. It is looked at "
        "in the last 0.3 s. Searched noise levels of the estimator keep a stated one.",
        example="1",
        default=RIPPLE,
        searched=True,
        place=6.0,
        of_motion=ripples,
        key="ripple_percent",
    )
)
