"""Arguments of a `Controller` by name, for functions that pass them on."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias, TypedDict

from numpy.typing import ArrayLike

from flexhinf.arrays import Numbers
from flexhinf.loop.controller.backlash import Backlash
from flexhinf.loop.controller.friction import DryFriction
from flexhinf.loop.controller.governor import Governor
from flexhinf.loop.controller.options import Windup
from flexhinf.loop.controller.protection import Protection
from flexhinf.loop.controller.status import Supervision

#: A range: None, a number or one for each signal (±), or its lower and upper end.
Range: TypeAlias = Numbers | tuple[Numbers, Numbers]

#: The same of measurements, with their largest rate.
RangeAndRate: TypeAlias = tuple[ArrayLike, ArrayLike, ArrayLike] | None


class ControllerOptions(TypedDict, total=False):
    """Arguments of `flexhinf.Controller` beside law, estimator and period, those that are stated."""

    saturation: Range
    moving: bool
    start: str
    blend_time: float | None
    command_range: Range
    command_rate: Numbers
    input_rate: Numbers
    integral_dead_zone: Numbers
    before_first: ArrayLike
    latency: int | None
    supervision: Supervision | None
    offset_time: float | None
    windup: Windup | None
    compensate: Sequence[str] | str | None
    measurement_limits: RangeAndRate
    dry_friction: DryFriction | None
    backlash: Backlash | None
    governor: Governor | None
    protection: Protection | None
