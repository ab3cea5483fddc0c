"""Damping ratios of the running loop's oscillations: of slow ones, of fast ones, and after an impulse."""

from __future__ import annotations

from typing import TYPE_CHECKING

from flexhinf.designs.requirements.kinds import RequirementKind, register

if TYPE_CHECKING:
    from flexhinf.designs.requirements.measured import RestingLoop


def slow(loop: RestingLoop) -> float:
    """Smallest damping ratio of the oscillations that have to be damped."""
    return loop.margins.damping_about(loop.damped_below)[0]


def fast(loop: RestingLoop) -> float:
    """Smallest damping ratio of faster ones; 1 where there is none."""
    return loop.margins.damping_about(loop.damped_below)[1]


register(
    RequirementKind(
        "damping",
        "damping of oscillations",
        "smallest damping ratio of every oscillation below {below:.3g} rad/s, the estimator's included",
        at_most=False,
        field="damping",
        searched=True,
        place=0.0,
        of_loop=slow,
    )
)
register(
    RequirementKind(
        "fast_damping",
        "damping of fast oscillations",
        "smallest damping ratio from {below:.3g} rad/s on, where the loop has to be stable",
        at_most=False,
        place=0.0,
        of_loop=fast,
    )
)
register(
    RequirementKind(
        "ring_down",
        "damping in the ring-down",
        "smallest damping ratio of every oscillation below {below:.3g} rad/s that makes up 5 % of the velocity or "
        "input of the joint with the impulse; faster ones only have to decay",
        at_most=False,
        field="damping",
        searched=True,
        place=0.0,
    )
)
