"""Factor by which the gain of one input may grow or shrink."""

from __future__ import annotations

from typing import TYPE_CHECKING

from flexhinf.designs.requirements.kinds import RequirementKind, register
from flexhinf.options import AboveOne

if TYPE_CHECKING:
    from flexhinf.designs.requirements.measured import RestingLoop

#: Default of the least factor; docs/decisions.md has the cost if only the link is measured.
GAIN_MARGIN = 1.8


def factor(loop: RestingLoop) -> float:
    """Smallest factor, up or down, of one input's gain that makes the loop unstable."""
    return loop.margins.gain_margin


register(
    RequirementKind(
        "gain_margin",
        "gain margin",
        "smallest factor, up or down, of one input's gain that makes the loop unstable",
        at_most=False,
        help="Least factor by which the gain of the running loop may grow or shrink.",
        example="2",
        default=GAIN_MARGIN,
        without=f"{GAIN_MARGIN:g}; 2 for a workspace",
        within=AboveOne | None,
        searched=True,
        place=8.0,
        of_loop=factor,
    )
)
