"""Extra delay of all inputs together that the running loop tolerates."""

from __future__ import annotations

from typing import TYPE_CHECKING

from flexhinf.designs.requirements.kinds import Allowance, Limit, RequirementKind, Stating, register

if TYPE_CHECKING:
    from flexhinf.designs.requirements.measured import RestingLoop

#: Default of the least extra delay that a loop with an estimator tolerates, samples.
DELAY_MARGIN = 1.0


def extra_delay(loop: RestingLoop) -> float:
    """Smallest extra delay, in samples on top of the latency, that makes the loop unstable."""
    return loop.margins.delay_margin_s / loop.linear.period


def allowed(s: Stating, about: Allowance) -> Limit:
    """As stated, or `DELAY_MARGIN` with an estimator; None where the true state is fed back."""
    stated = DELAY.stated(s)
    return (DELAY_MARGIN if s.estimator != "none" else None) if stated is None else stated


DELAY = register(
    RequirementKind(
        "delay_margin",
        "delay margin",
        "smallest extra delay of all inputs together, on top of the latency, that makes the loop unstable",
        "samples",
        at_most=False,
        help="Least extra delay that the running loop tolerates, in samples on top of the latency.",
        example="1",
        without=f"{DELAY_MARGIN:g}, or no requirement where the true state is fed back",
        searched=True,
        place=9.0,
        of_loop=extra_delay,
        allowed=allowed,
    )
)
