"""What a step makes of a measurement: offsets taken in slowly, the corrected estimate, the tracked positions.

An element that is no finite number is missing: its sensor gave nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from flexhinf.codegen import gives
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


def corrected(run: Any, estimator: Estimator, belief: Any, y: Any, u: Any, data: Any) -> tuple[Any, Any]:
    """x(k|k), x(k|k−1) itself where nothing was measured; and y without the elements that a gate has rejected."""
    run.section("Where something was measured, the estimate is corrected by it")
    some = run.call(_some, y)
    with run.when(some):
        after = estimator.measurement_update_on(run, belief, y, u, data.parameters, data.measurement_noise)
    after = type(belief)(
        *(
            old if new is old else _either(run, name, some, new, old)
            for name, new, old in zip(belief._fields, after, belief, strict=True)
        )
    )
    if "rejected" in belief._fields:
        y = run.call(_passed, y, belief.rejected, after.rejected)
    return after, y


def _passed(y: Any, before: Any, after: Any) -> Any:
    """A measurement (p,), infinite where a count has grown."""
    counts = zip(y, before, after, strict=True)
    return np.array([where(now > then, np.inf, element) for element, then, now in counts])


def _some(y: Any) -> Any:
    """Whether something was measured: 1 (1,), else 0."""
    return np.array([where(sum(known(y)) > 0.5, 1.0, 0.0)])


def _either(run: Any, name: str, flag: Any, new: Any, old: Any) -> Any:
    """New numbers where the flag (1,) is 1, else the old ones, which are those of a vector or of columns."""
    either = gives(name)(partial(by_flag))
    return run.call(either, new, old, flag) if len(new.shape) == 1 else run.columns(either, (new, old), flag)


def by_flag(new: Any, old: Any, flag: Any) -> Any:
    """New numbers where the flag (1,) is 1, else the old ones."""
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


def standing(tracked: Sequence[Source], velocities: Sequence[int], y: Any, estimate: Any, r: Any) -> Any:
    """The moving reference (n + m,) that rests where the joints are: their measured positions, the other estimated
    states, no velocities, and the input of the reference r."""
    still = list(estimate)
    for place in velocities:
        still[place] = 0.0
    for source, seen in zip(tracked, positions(tracked, y, estimate)):
        still[source.state] = seen
    return np.array([*still, *r[len(still) :]])


def as_measured(tracked: Sequence[Source], y: Any, offset: Any, estimate: Any) -> Any:
    """The tracked positions (k,) with the offset (p,) that was taken from their measurement."""
    return positions(tracked, y + offset, estimate)
