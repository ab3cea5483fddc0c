"""Peak of the sensitivity of the running loop."""

from __future__ import annotations

from typing import TYPE_CHECKING

from flexhinf.designs.requirements.kinds import RequirementKind, register
from flexhinf.options import AboveOne

if TYPE_CHECKING:
    from flexhinf.designs.requirements.measured import RestingLoop

#: Default of the largest |S|; docs/decisions.md has the cost if only the link is measured.
PEAK_SENSITIVITY = 2.5


def peak(loop: RestingLoop) -> float:
    """Largest singular value of S at the plant's inputs."""
    return loop.margins.peak_sensitivity


register(
    RequirementKind(
        "peak_sensitivity",
        "peak sensitivity",
        "largest singular value of S at the plant's inputs, over all frequencies",
        help="Largest peak of |S| of the running loop, with estimator, sampling and delay.",
        example="2",
        default=PEAK_SENSITIVITY,
        within=AboveOne | None,
        searched=True,
        place=7.0,
        of_loop=peak,
    )
)
