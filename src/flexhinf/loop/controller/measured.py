"""What a step makes of a measurement: offsets taken in slowly, the corrected estimate, the tracked positions.

An element that is no finite number is missing: its sensor gave nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from flexhinf.plant import Estimator, chosen, known, turned
from flexhinf.scalars import absolute, maximum, where


class Source(NamedTuple):
    """Where a tracked state is read (in the measurement if it is measured, else in the estimate), and its place among
    the states of the plant. So integral action removes the error of the measured signal, whatever the estimator's model
    gets wrong."""

    measured: bool
    place: int
    state: int
    turns: bool = False  # an angle, of which the measurement may jump by 2π


def corrected(run: Any, estimator: Estimator, belief: Any, y: Any, u: Any, data: Any) -> Any:
    """x(k|k); x(k|k−1) itself where nothing was measured."""
    some = run.call(_some, y)
    with run.when(some):
        after = estimator.measurement_update_on(run, belief, y, u, data.parameters, data.measurement_noise)
    return type(belief)(
        *(old if new is old else _either(run, some, new, old) for new, old in zip(after, belief, strict=True))
    )


def _some(y: Any) -> Any:
    """1 (1,) where at least one element is there, else 0."""
    return np.array([where(sum(known(y)) > 0.5, 1.0, 0.0)])


def _either(run: Any, flag: Any, new: Any, old: Any) -> Any:
    """New numbers where the flag (1,) is 1, else the old ones, which are those of a vector or of columns."""
    if len(new.shape) == 1:
        return run.call(_by_flag, new, old, flag)
    return run.columns(_by_flag, (new, old), flag)


def _by_flag(new: Any, old: Any, flag: Any) -> Any:
    return where(flag[0] > 0.5, new, old)


def faded(
    turns: Sequence[int], y: Any, expected: Any, offset: Any, before: Any, decay: Any
) -> tuple[Any, Any, Any]:
    """The measurement (p,) less its offset, which is taken where an element is first there, and decays; the offset, and
    flags of elements that have one. Of angles, which stand at `turns`, it is the shorter way round."""
    there = known(y)
    offset = chosen(before, decay * offset, chosen(there, turned(y, expected, turns) - expected, 0.0))
    return y - offset, offset, maximum(before, there)


def positions(tracked: Sequence[Source], y: Any, estimate: Any) -> np.ndarray:
    """Of the measurement where they are in it and it is there, else of the estimate. An angle is the turn nearest to
    the estimate, which goes on where the measurement jumps."""
    positions = [estimate[source.state] for source in tracked]
    for k, source in enumerate(tracked):
        if source.measured:
            (seen,) = turned([y[source.place]], [positions[k]], [0] if source.turns else [])
            positions[k] = where(absolute(seen) < np.inf, seen, positions[k])
    return np.array(positions)
