"""Overshoot of the links in a step."""

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

#: Default of the largest overshoot, per cent of the step.
OVERSHOOT = 5.0


def overshoots(motion: Motion) -> Vector:
    """Overshoot of each joint (n,), per cent of its own step; NaN of a joint that makes none beside one that does."""
    steps = zip(motion.positions.T, motion.path[0], motion.path[-1])
    found = [_overshoot(motion.time, q, begin, end) if begin != end else np.nan for q, begin, end in steps]
    return np.array(found) if np.any(np.isfinite(found) | np.isinf(found)) else np.zeros(len(found))


def _overshoot(time: Vector, position: Vector, begin: float, end: float) -> float:
    from flexhinf.loop.simulation import metrics

    shape = metrics.StepShape(float(begin), float(end), 0.0)
    found = metrics.step_metrics(time, position, shape)["overshoot_percent"]
    return np.inf if found is None else found


register(
    RequirementKind(
        "overshoot",
        "overshoot",
        "largest of all joints, per cent of the joint's own step",
        "%",
        help="Largest overshoot of every link position, in per cent of the step.",
        example="5",
        default=OVERSHOOT,
        steps=True,
        usual=True,
        searched=True,
        place=1.0,
        of_motion=overshoots,
        key="overshoot_percent",
    )
)
