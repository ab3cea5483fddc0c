"""Backlash between motors and links, of which the estimator's model has none, taken out of what is measured.

A spring with a gap of total width b twists by what of θ − q lies beyond the gap. An estimator without one takes all of
it for twist: while a link is on its way through the gap, for a torque that is not there, of up to K b / 2. The law acts
against that torque, throws the link to the other side, and so on: an arm without weight never comes to rest. So the
estimator is shown an arm without a gap and with the same torques,

    q' = q + clip(θ − q) − g,    θ' = θ − g,    g = clip(θ_d − q_d),

where clip is to ±b/2. A link that rests in its gap is where its motor is, and rests for the law too. g is where in its
gap a joint is by the torque of the command (x_d, u_d): a joint that carries more than K b / 2 has q' = q, so that its
integral acts on the link; and where that torque turns round, the motor goes through the gap with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.codegen import gives
from flexhinf.errors import refuse_if
from flexhinf.loop.controller.options import Listed
from flexhinf.plant import Estimator, known, turned
from flexhinf.scalars import clip, where
from flexhinf.validation import real_array, value_text

#: Places of a link and its motor in the measurement, and in the state.
Place = tuple[tuple[int, int], tuple[int, int]]


@dataclass(frozen=True)
class Backlash(Listed):
    """Gaps of springs whose two ends are measured.

    Parameters
    ----------
    width : (k,)
        Of each gap, rad or m, from end to end, at least 0.
    links, motors : sequence of str
        The measured positions of its two sides, the motor's seen from the link.

    Raises
    ------
    InvalidInput
        If the three do not fit each other, or are no such numbers.
    """

    width: Sequence[float]
    links: Sequence[str]
    motors: Sequence[str]

    def __post_init__(self) -> None:
        width, count = real_array(self.width), len(self.links)
        refuse_if(
            width.shape != (count,)
            or len(self.motors) != count
            or not np.all(np.isfinite(width) & (width >= 0.0)),
            "The backlash does not fit the joints.",
            f"expected widths >= 0 for {list(self.links)} and {list(self.motors)}, got {value_text(self.width)}",
            "one number per joint, in its unit of position",
        )
        vars(self).update(width=tuple(width.tolist()), links=tuple(self.links), motors=tuple(self.motors))

    def places(self, estimator: Estimator | None, states: Sequence[str], moving: bool) -> tuple[Place, ...]:
        """Places of link and motor of each gap; refused where an estimator is not shown one, or nothing moves."""
        both, measured = (
            {*self.links, *self.motors},
            () if estimator is None else tuple(estimator.plant.outputs),
        )
        refuse_if(
            not moving or not both <= {*measured} or not both <= {*states},
            "The backlash does not fit the controller.",
            f"expected moving=True, and {sorted(both)} of an estimator's measurements, got moving={moving} "
            f"and {list(measured)}",
            "moving=True and an estimator with sensors of both sides of the spring, or backlash=None",
        )
        return tuple(
            ((measured.index(link), measured.index(motor)), (states.index(link), states.index(motor)))
            for link, motor in zip(self.links, self.motors)
        )


@gives("engaged", "gap")
def engaged(
    places: Sequence[Place], turns: Sequence[int], y: Any, command: Any, width: Any
) -> tuple[Any, Any]:
    """A measurement (p,) of the arm without gaps at a command (x_d, u_d), and what was added to the measured one (p,).

    Nothing is added where one of the two sides is missing. Of angles, which stand at `turns`, the shorter way counts.
    """
    there, added = known(y), [0.0] * len(y)
    for ((link, motor), (link_state, motor_state)), gap in zip(places, width, strict=True):
        both, half = there[link] * there[motor] > 0.5, 0.5 * gap
        near, far = (where(both, y[place], 0.0) for place in (link, motor))
        (far,) = turned([far], [near], [0] if link in turns else [])
        planned = where(both, clip(command[motor_state] - command[link_state], -half, half), 0.0)
        added[link], added[motor] = clip(far - near, -half, half) - planned, -planned
    return y + np.array(added), np.array(added)
