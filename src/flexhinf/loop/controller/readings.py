"""Readings of sensors: which of them a step believes, how fast they move, when a frame is a repeated one.

A reading is believed within its range, and where it moved since it was last believed by no more than its largest rate.
One that moved further is refused, for a sensor that jumps. A blow moves a link as far, but goes on from where it was:
so a refused sensor is believed again where three of its readings in a row move alike, and that motion leads back to the
last believed one. Where the time since the last step is known, a pause of the loop is no jump.

Field buses repeat a frame when the next one is late. Such a frame is equal to the last one, bit by bit, in all of its
sensors, although two of them or more should have moved by `MOVED` steps of their values since it changed: by the
estimator's prediction, which stands still where something blocks a joint. It counts as missing, as what the caller
says is not fresh. One sensor alone that repeats itself may be a joint that stands.

The speed of a sensor is the change of its readings, averaged over a window, in which the median of three changes leaves
out a jump.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from typing import NamedTuple

import numpy as np

from flexhinf.arrays import Element, Elements
from flexhinf.codegen import gives
from flexhinf.plant import chosen, known, turned
from flexhinf.scalars import absolute, maximum, minimum, where

#: Steps of its values by which a sensor should have moved where a frame is taken for a repeated one, and how many
#: should.
MOVED, SENSORS = 2.0, 2

#: Share of a refused sensor's largest rate by which its changes may differ from one sample to the next, and of the way
#: since it was last believed by which it may be off: a link behind a spring is not accelerated by more.
ALIKE, OFF = 0.25, 0.5

#: A refused reading counts one towards the longest time without a sensor, a believed one takes back so much.
FORGOTTEN = 1.0


class Readings(NamedTuple):
    """What is remembered of the sensors, (p,) each; changes are per sample.

    `last`: The last believed reading. `since`: Samples since then, 0 before the first one. `refused`: How many readings
    were refused. `raw`: The last reading, believed or not. `change`, `before`: The last change of the readings, and the
    one before. `speed`: The mean change. `predicted`: The estimator's prediction when the frame changed last. `still`:
    Samples since the reading itself changed. `lost`: Refused and repeated readings that count. `fresh`: 1 where the
    caller says that the next reading was measured since the last step, else 0.
    """

    last: Elements
    since: Elements
    refused: Elements
    raw: Elements
    change: Elements
    before: Elements
    speed: Elements
    predicted: Elements
    still: Elements
    lost: Elements
    fresh: Elements


def first_readings(sensors: int) -> np.ndarray:
    """The memory of readings before the first one, (11, p)."""
    return np.zeros((len(Readings._fields), sensors))


@gives("believed", "readings_seen", "is_there", "is_repeated")
def believed_readings(
    turns: Sequence[int],
    y: Elements,
    predicted: Elements,
    readings: Elements,
    period: Elements,
    lower: Elements,
    upper: Elements,
    rate: Elements,
    steps: Elements,
    windows: Elements,
) -> tuple[Elements, Elements, Elements, Elements]:
    """A measurement (p,) without the elements that are not believed, which are infinite; what is remembered (11, p);
    which elements are there (p,), 1 or 0; and whether the frame is a repeated one (1,).

    `predicted` (p,) is what the estimator predicts. `steps` (p,) are those of the values, infinite for sensors whose
    prediction tells nothing; `windows` (p,) shares of a change that go into the speed. Of angles, which stand at
    `turns`, the shorter way counts.
    """
    now = Readings(*readings)
    present = known(y)
    changes = turned(y, now.raw, turns) - now.raw
    changed = present * np.array([where(absolute(change) > 0.0, 1.0, 0.0) for change in changes])
    anew, repeated = _new_frame(turns, present, maximum(changed, now.fresh), predicted, now, steps)
    there = present * (1.0 - repeated)
    change = chosen(there, changes, now.change)
    possible = _possible(turns, y, now, change, period[0] * rate)
    good = there * _within(y, lower, upper) * possible
    middle = maximum(minimum(change, now.change), minimum(maximum(change, now.change), now.before))
    after = Readings(
        last=chosen(good, y, now.last),
        since=chosen(good, 1.0, now.since + minimum(now.since, 1.0)),
        refused=now.refused,
        raw=chosen(there, y, now.raw),
        change=change,
        before=chosen(there, now.change, now.before),
        speed=now.speed + there * windows * (middle - now.speed),
        predicted=now.predicted + anew * (predicted - now.predicted),
        still=(1.0 - changed) * (now.still + there),
        lost=now.lost,
        fresh=0.0 * now.fresh,
    )
    return chosen(good, y, np.full(len(good), np.inf)), np.array(after), there, np.array([repeated])


def _new_frame(
    turns: Sequence[int],
    present: Elements,
    changed: Elements,
    predicted: Elements,
    now: Readings,
    steps: Elements,
) -> tuple[Element, Element]:
    """Whether the frame is a new one, and whether it is a repeated one, 1 or 0: there is something in it (`present`),
    nothing has `changed` (p,), and `SENSORS` should have."""
    anew = reduce(maximum, changed)
    moved = absolute(turned(predicted, now.predicted, turns) - now.predicted)
    should = sum(where(way > MOVED * step, 1.0, 0.0) for way, step in zip(moved, steps, strict=True))
    late = where(should > SENSORS - 0.5, 1.0, 0.0)
    return anew, (1.0 - anew) * reduce(maximum, present) * late


def _possible(turns: Sequence[int], y: Elements, now: Readings, change: Elements, most: Elements) -> Elements:
    """1 where a sensor moved since it was last believed by its largest change a sample (p,) at most, or where its last
    changes are alike and lead back to that, else 0."""
    way = turned(y, now.last, turns) - now.last
    rows = zip(way, now.since, change, now.change, now.before, most, strict=True)
    found: list[Element] = []
    for far, since, latest, second, third, largest in rows:
        excess = absolute(far) - since * largest
        alike = maximum(absolute(latest - second), absolute(second - third)) - ALIKE * largest
        leads = absolute(far - since * latest) - OFF * absolute(since * latest)
        found.append(where(minimum(excess, maximum(alike, leads)) > 0.0, where(since > 0.5, 0.0, 1.0), 1.0))
    return np.array(found)


def _within(y: Elements, lower: Elements, upper: Elements) -> Elements:
    """1 for every element of a measurement (p,) that is in its range, else 0."""
    rows = zip(y, lower, upper, strict=True)
    return np.array([where(v < low, 0.0, where(v > high, 0.0, 1.0)) for v, low, high in rows])


def believable(y: Elements, lower: Elements, upper: Elements) -> Elements:
    """1 for every element of a measurement (p,) that is there and in its range, else 0."""
    return known(y) * _within(y, lower, upper)


def refusals(readings: Elements, y: Elements, there: Elements, believed: Elements) -> Elements:
    """What is remembered (11, p), with counts of the elements that are not `believed`, by their limits or by a filter's
    gate: of those of a new frame, which are `there` (p,), 1 or 0, and of all that y (p,) has."""
    now, good = Readings(*readings), known(believed)
    lost = maximum(now.lost + known(y) - good - FORGOTTEN * good, 0.0)
    return np.array(now._replace(refused=now.refused + there - good, lost=lost))
